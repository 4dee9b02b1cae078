"""Whatever a guest, a local program or a node of the bus says: nothing is raised or grows, and what is refused is counted."""

import json
from random import Random
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.clock import ManualClock
from delfim.base.errors import FormatError
from delfim.base.frames import CAN_ERR, CAN_RTR, Frame, extended, standard
from delfim.canproxy.dsor.messages import SYSSTAT_SUBJECT, Node
from delfim.canproxy.dsor.protocol import Kind, dsor_arb
from delfim.config import Sysstat
from delfim.parts.dsor import sysstat
from delfim.vehicle import console
from delfim.vehicle.failsafe import nodehealth
from delfim.vehicle.grex import LINE_BYTES, LINES_A_CALL, Guest
from delfim.vehicle.state import State
from tests.mutations import BINARY, TEXT

LINES = 10_000
COMMANDS: list[dict[str, Any]] = [
    {"command": "alive"},
    {"command": "heading", "heading_deg": 90.0, "speed_mps": 1.5},
    {"command": "goto", "latitude_deg": 38.69, "longitude_deg": -9.21},
    {"command": "manual", "starboard": 0.5, "port": -0.25},
    {"command": "mode", "mode": "hold"},
    {"command": "mission", "text": 'version = 1\nname = "x"\n[[waypoint]]\nlatitude_deg = 38.6\nlongitude_deg = -9.2\n'},
    {"command": "rally", "points": [[38.69, -9.21], [38.68, -9.2]]},
    {"command": "set", "key": "control.speed.cruise_mps", "value": 1.0},
    {"command": "play", "leg": 3},
    {"command": "watch"},
]


def mutated(line: bytes, random: Random) -> bytes:
    """Without its end: that is where lines are told apart."""
    return random.choice((*BINARY, *TEXT))(line, random).replace(b"\n", b" ")


def test_ten_thousand_mutated_commands_are_understood_or_refused_in_a_line() -> None:
    understood, said = 0, list[str]()
    for number in range(LINES):
        random = Random(number)
        line = mutated(json.dumps(random.choice(COMMANDS)).encode(), random)
        try:
            command = console.parse(line)
        except FormatError as error:
            said.append(str(error))
        else:
            understood += 1
            assert msgspec.json.decode(msgspec.json.encode(command), type=console.EVERY) == command
    assert understood + len(said) == LINES
    assert min(understood, len(said)) > LINES / 100, "both happen"
    assert [words for words in said if not words.isprintable() or len(words) > 1000] == []


def test_ten_thousand_mutated_references_are_taken_or_counted(boat) -> None:
    there, state = boat.guest, boat.state
    taken = 0
    for number in range(LINES):
        random = Random(number)
        before = state.counts.get("guest_malformed", 0)
        there.data_received(mutated(b'{"heading_deg": 123.5, "speed_mps": 1.0}', random) + b"\n")
        taken += state.counts.get("guest_malformed", 0) == before
        asked = state.setpoint
        assert asked.guest_heading_rad is None or 0.0 <= asked.guest_heading_rad <= 6.2832
        assert 0.0 <= asked.guest_speed_mps < float("inf")
    assert taken + state.counts["guest_malformed"] >= LINES
    assert min(taken, state.counts["guest_malformed"]) > LINES / 100, "both happen"


@pytest.mark.parametrize("line", [b"", b"{}", b'{"heading_deg": 1}'])
def test_of_a_burst_the_guests_newest_words_are_read_and_no_others(boat, line: bytes) -> None:
    there, state = boat.guest, boat.state
    read = list[bytes]()
    on_line = there.on_line
    there.on_line = lambda words: (read.append(words), on_line(words))[1]
    there.data_received((line + b"\n") * 50_000 + b'{"heading_deg": 90}\n{"head')
    assert read == [*[line] * (LINES_A_CALL - 1), b'{"heading_deg": 90}']
    assert state.counts["guest_hasty"] == 1
    assert state.setpoint.guest_heading_rad == pytest.approx(1.5708, abs=1e-4)
    there.data_received(b'ing_deg": 180}\n')
    assert state.setpoint.guest_heading_rad == pytest.approx(3.1416, abs=1e-4)


@given(st.lists(st.binary(max_size=3000), max_size=30))
def test_no_bytes_of_a_guest_pile_up(pieces: list[bytes]) -> None:
    there = Guest(State(), ManualClock(100.0))
    for piece in pieces:
        there.data_received(piece)
        assert len(there._buffer) <= LINE_BYTES


class Bus:
    """Frames that wait, and nobody who takes the answers."""

    def __init__(self, frames: list[Frame]) -> None:
        self.frames = frames

    def receive(self) -> Frame | None:
        return self.frames.pop(0) if self.frames else None

    def sendmsg(self, frame: Frame) -> None:
        raise OSError("full")


NODES = st.sampled_from([*map(int, sysstat.NAMES), 0, 1, 0x7F])
PLAIN = st.builds(lambda node: extended(3 << 19 | node << 12 | SYSSTAT_SUBJECT), NODES)
SEGMENTED = st.builds(
    lambda kind, source, sequence: dsor_arb(1, kind, source, Node.VEHICLE, sequence),
    st.sampled_from(Kind),
    NODES,
    st.integers(0, 31),
)
ANY = st.builds(
    lambda number, bits: extended(number) | bits, st.integers(0, (1 << 29) - 1), st.sampled_from([0, CAN_RTR, CAN_ERR])
)
FRAMES = st.builds(Frame, PLAIN | SEGMENTED | ANY | st.builds(standard, st.integers(0, 0x7FF)), st.binary(max_size=8))


@given(st.lists(st.lists(FRAMES, max_size=80), max_size=8))
def test_no_status_frames_are_raised_or_kept(bursts: list[list[Frame]]) -> None:
    state, sensor = State(), sysstat.SystemStatus(Bus([]))  # type: ignore[arg-type]
    for number, burst in enumerate(bursts):
        sensor.input = Bus(burst)
        sensor.read(state, 0.5 * number)
        nodehealth.wrong(state, Sysstat(), 0.5 * number)
    assert state.sysstat.keys() <= set(sysstat.NAMES.values())
    assert set(state.counts) <= {"sysstat_malformed", "acknowledgements_unsent"}
    assert not sensor._segmented.replies
    assert len(sensor._segmented._open) <= 16
