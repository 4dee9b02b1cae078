"""Ping echo sounders: frames against the maker's package, any bytes at all, a sounder that falls silent, pings in the log."""

import csv
import math
from pathlib import Path
from random import Random

import pytest
from brping import PingMessage, PingParser, definitions
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.lines.binaryframes import BinaryFrames
from delfim.logging.ashore import tree
from delfim.parts.ping import pingframes
from delfim.parts.ping.pingframes import FRAMING, PAYLOAD_MAX, PingDistance, PingFrame, asked, distance, packed, told, unpacked
from delfim.parts.ping.sensor import SILENT_S, PingSounder, open_sensor
from delfim.simulator.line import LockstepLine
from delfim.vehicle import console, sensors
from delfim.vehicle.links import Links
from delfim.vehicle.state import State
from tests.logging.sailing import Day, logged

ROOT = Path(__file__).parents[3]
frames = st.builds(PingFrame, st.integers(0, 0xFFFF), st.binary(max_size=PAYLOAD_MAX), st.integers(0, 255), st.integers(0, 255))


def fed(*pieces: bytes) -> list[PingFrame]:
    parser = BinaryFrames(FRAMING)
    return [unpacked(frame) for piece in pieces for frame in parser.feed(piece)]


def theirs(kind: int, mm: int, per_cent: int, number: int = 0) -> bytes:
    """A message as the maker's package makes it: its first two numbers are the distance and how sure it is."""
    message = PingMessage(kind)
    for name, value in zip(message.payload_field_names, (mm, per_cent, 100, number), strict=False):
        setattr(message, name, value)
    message.pack_msg_data()
    return bytes(message.msg_data)


def heard(data: bytes) -> list[PingMessage]:
    """What the maker's package reads."""
    parser = PingParser()
    return [parser.rx_msg for byte in data if parser.parse_byte(byte) == PingParser.NEW_MESSAGE]


@pytest.mark.parametrize("kind", [definitions.PING1D_DISTANCE, definitions.PING1D_DISTANCE_SIMPLE])
def test_what_the_makers_package_says_is_read(kind: int) -> None:
    chance, parser = Random(kind), BinaryFrames(FRAMING)
    for number in range(300):
        mm, per_cent = chance.randrange(0, 300_000), chance.randrange(0, 101)
        noise = bytes(chance.choices(b"BR\x00\xff", k=chance.randrange(4)))
        (frame,) = parser.feed(noise + theirs(kind, mm, per_cent, number) + b"\0" * PAYLOAD_MAX)
        counted = None if kind == definitions.PING1D_DISTANCE_SIMPLE else number
        assert distance(unpacked(frame)) == PingDistance(mm / 1e3, per_cent / 100, counted)


def test_the_makers_package_reads_what_is_asked_and_what_the_simulated_sounder_says() -> None:
    sound, interval, start = heard(asked(10.0, 1481.5))
    assert (sound.message_id, sound.sos_mm_per_sec) == (definitions.PING1D_SET_SPEED_OF_SOUND, 1_481_500)
    assert (interval.message_id, interval.ping_interval) == (definitions.PING1D_SET_PING_INTERVAL, 100)
    assert (start.message_id, start.id) == (definitions.PING1D_CONTINUOUS_START, definitions.PING1D_DISTANCE)
    assert len(heard(asked(0.001, None))) == 2
    (ping,) = heard(told(PingDistance(12.345, 0.97, 70_000)))
    assert (ping.message_id, ping.distance, ping.confidence, ping.ping_number) == (1212, 12_345, 97, 70_000)


@given(frames)
def test_a_frame_is_read_as_it_was_packed(frame: PingFrame) -> None:
    assert fed(packed(frame)) == [frame]
    data = packed(frame)
    assert fed(*(data[k : k + 1] for k in range(len(data)))) == [frame]


@given(st.lists(st.binary(max_size=200) | frames.map(packed) | st.just(b"BR\xff\xff"), max_size=20))
def test_any_bytes_raise_nothing_and_little_is_kept(pieces: list[bytes]) -> None:
    parser = BinaryFrames(FRAMING)
    for piece in pieces:
        for frame in parser.feed(piece):
            assert len(unpacked(frame).payload) <= PAYLOAD_MAX
        assert len(parser._rest) <= pingframes.HEAD.size + PAYLOAD_MAX + 2


@given(st.integers(0, 3000).map(lambda cut: cut), st.integers(0, 255))
def test_a_frame_that_was_damaged_is_refused_and_the_next_one_is_read(at: int, by: int) -> None:
    good = told(PingDistance(3.0, 1.0, 7))
    data = bytearray(good)
    data[at % len(good)] ^= by
    found = fed(bytes(data) + b"\0" * PAYLOAD_MAX + good)
    assert found[-1:] == fed(good)
    assert len(found) == (2 if not by else 1) or distance(found[0]) is None, "a sum of bytes finds one that is wrong"


class Bench:
    """A sounder on a line, and what becomes of it."""

    def __init__(self, *overrides: str) -> None:
        settings = config.load(ROOT / "etc/delfimx.toml", ['sensors.names=["sysstat", "ping"]', *overrides])
        self.line, self.state = LockstepLine(ManualClock()), State()
        self.sounder: PingSounder = open_sensor(settings, Links(lambda *_: None, lambda *_: self.line))

    def hear(self, data: bytes, now_s: float = 5.0) -> None:
        self.line.put(data)
        self.sounder.read(self.state, now_s)

    def attend(self, now_s: float) -> bool:
        """Whether it is asked now."""
        before = len(self.line.written)
        self.sounder.look(None, now_s)
        return len(self.line.written) > before


def test_a_ping_that_is_not_sure_is_no_depth_and_is_kept_all_the_same() -> None:
    bench = Bench()
    bench.hear(told(PingDistance(7.0, 0.9, 1)))
    bench.hear(told(PingDistance(0.4, 0.49, 2)), 5.1)
    bench.hear(told(PingDistance(0.0, 1.0, 3)), 5.2)
    assert bench.state.measured == {"depth_m": (7.0, 5.0)}
    assert [(each.depth_m, each.confidence, each.number) for each in bench.state.soundings] == [
        (7.0, 0.9, 1), (0.4, 0.49, 2), (0.0, 1.0, 3),
    ]  # fmt: skip
    assert Bench("sounder.confidence=0.4").sounder._confidence == 0.4


def test_what_is_no_ping_is_counted() -> None:
    bench = Bench()
    bench.hear(packed(PingFrame(1212, b"short")) + packed(PingFrame(5, b"1234")) + b"BR" + b"\0" * 8)
    bench.hear(packed(PingFrame(1211, b"\0\0\0\0\xff")))
    assert bench.state.counts == {"ping_malformed": 2, "ping_refused": 1}
    assert not bench.state.soundings


def test_a_sounder_is_asked_at_first_and_again_when_it_is_silent() -> None:
    bench = Bench("ping.sound_mps=1450.0")
    assert bench.attend(0.0)
    assert bench.line.written[0] == asked(10.0, 1450.0)
    assert not bench.attend(1.0)
    bench.hear(told(PingDistance(7.0, 0.1)), 2.0)
    assert not bench.attend(2.0 + SILENT_S - 0.1)
    assert bench.attend(2.0 + SILENT_S)


def test_a_boat_with_two_kinds_of_sounders_has_one_depth_in_its_log() -> None:
    more = ['sensors.names=["ping", "nmea0183"]', 'nmea0183.ports.a.device="/dev/ttyS9"']
    names = [each.name for each in sensors.values(config.load(ROOT / "etc/delfimx.toml", more))]
    assert len(names) == len(set(names))


def test_each_ping_of_a_voyage_is_in_the_log_once_raw_with_its_confidence(tmp_path) -> None:
    bed = "simulation.sea_bed={mean_m=7.0, seed=3, bad_echoes=0.1}"
    day = Day(tmp_path, 'sensors.names=["sysstat", "ping"]', "ping.rate_hz=5.0", bed)
    day.sail(1.0)
    assert day.command(console.Course(90.0, 1.5)) is None
    day.sail(39.0)
    depths = {value for value, _ in [day.sailing.state.measured["depth_m"]]}
    day.end()
    events = [
        each for each in tree.events([file for file in logged(tmp_path) if file.id == "state"]) if each["event"] == "sounding"
    ]
    assert 190 <= len(events) <= 201
    assert [each["number"] for each in events] == list(range(1, len(events) + 1)), "each once"
    assert {each["source"] for each in events} == {"ping"}
    unsure = [each for each in events if each["confidence"] < 0.5]
    assert 3 <= len(unsure) <= 40
    assert depths <= {each["depth_m"] for each in events if each["confidence"] >= 0.5}


def test_a_logbook_keeps_the_pings_of_the_boat_alone(tmp_path, capsys) -> None:
    """In lock step as at sea, and the table for charts says where each was."""
    from delfim.__main__ import main

    place = tmp_path / "run"
    overrides = ['sensors.names=["sysstat", "ping"]', "ping.rate_hz=4.0", "simulation.sea_bed.mean_m=7"]
    words = [word for each in overrides for word in ("--set", each)]
    mission = str(ROOT / "etc/missions/doca.toml")
    assert main(
        [
            "sim",
            str(ROOT / "etc/delfimx.toml"),
            "--mission",
            mission,
            "--lockstep",
            "--for",
            "30",
            "--output",
            str(place),
            *words,
        ]
    ) in (0, 1)
    assert main(["log", "export", "soundings", str(place), "--output", str(tmp_path / "s.csv")]) == 0
    with (tmp_path / "s.csv").open(newline="") as text:
        rows = list(csv.DictReader(text))
    assert 110 <= len(rows) <= 121
    known = [row for row in rows if row["latitude [deg]"]]
    assert len(known) >= len(rows) - 3
    assert all(0.0 <= float(row["heading [deg]"]) < 360.0 and abs(float(row["roll [deg]"])) < 45.0 for row in known)
    assert {row["source"] for row in rows} == {"ping"}
    assert math.isclose(float(known[-1]["latitude [deg]"]), 38.69, abs_tol=0.01)
