"""A payload program has the boat in lock step: the shipped example finds the warmest water, and its voyage is replayed."""

import json
import math
import sys
from pathlib import Path

import pytest

from delfim.base.errors import DelfimError
from delfim.base.modes import Mode
from delfim.simulator import payloadprogram
from delfim.simulator.payloadprogram import PayloadProgram
from delfim.simulator.replay.rerun import rerun
from delfim.vehicle import console
from delfim.vehicle.plans.mission import Mission, Waypoint
from tests.logging.sailing import Day, logged

UPHILL = Path(__file__).parents[2] / "etc/payloads/uphill.py"
PEAK = 38.69092, -9.2151
WIDTH_M = 25.0
RIGHTS = 'payload.uphill={command=["/usr/bin/python3"], may=["heading", "goto", "mission", "obstacles"]}'
NEAR = Mission(version=1, name="found", waypoint=(Waypoint(latitude_deg=38.6911, longitude_deg=-9.2150),))


class Sailing:
    """A day at sea with a program."""

    def __init__(self, place: Path, *words: str) -> None:
        self.day, self.refused = Day(place, RIGHTS), list[str | None]()
        self.run = self.day.sailing
        self.program = PayloadProgram("uphill", (sys.executable, *words), self.order)

    def order(self, command: console.Commands, operator: str) -> str | None:
        """As the doors of the boat do; at sea no two things happen in the same nanosecond."""
        self.day.clock.advance(0.001)
        refused = self.run.vehicle.on_command(command, operator)
        self.day.clock.advance(0.001)
        self.day.log.command(command, refused, self.run.state, operator)
        self.day.boxed()
        self.refused.append(refused)
        return refused

    def sail(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.2)):
            self.day.sail(0.2)
            self.program.turn(self.run)

    def away_m(self) -> float:
        """From the peak."""
        told = self.run.vehicle.report()
        assert told.latitude_deg is not None
        assert told.longitude_deg is not None
        north_m = (told.latitude_deg - PEAK[0]) * 111_120.0
        return math.hypot(north_m, (told.longitude_deg - PEAK[1]) * 111_120.0 * math.cos(math.radians(PEAK[0])))


def test_the_example_climbs_to_the_warmest_water_and_its_voyage_is_replayed_bit_by_bit(tmp_path: Path) -> None:
    sailing = Sailing(tmp_path, str(UPHILL), "--peak", *map(str, (*PEAK, WIDTH_M)))
    with sailing.program:
        sailing.sail(4.0)
        assert sailing.away_m() > 1.2 * WIDTH_M
        assert sailing.day.command(console.Entrust("uphill")) is None
        sailing.sail(85.0)
        state = sailing.run.state
        assert (state.mode, state.reason, state.helmsman) == (Mode.HOLD, "goto done", "uphill")
        assert sailing.away_m() < 6.0
        sailing.order(console.Goto(40.0, -9.0, end="hold"), "payload:uphill")
        sailing.order(
            console.parse(b'{"command": "sight", "target": {"id": "7", "latitude_deg": 38.7, "longitude_deg": -9.2}}'),
            "payload:uphill",
        )
        assert sailing.order(console.Upload(NEAR), "payload:uphill") is None
        assert sailing.order(console.Play(), "payload:uphill") is None
        sailing.sail(3.0)
    sailing.sail(8.0)  # it has ended
    assert sailing.run.state.relieved.startswith("failsafe: no word from payload uphill for 5.")
    sailing.day.end()
    sidecars = "".join(Path(file.sidecar).read_text() for file in logged(tmp_path) if file.id == "state")
    told = [json.loads(line) for line in sidecars.splitlines()]
    words = {each["value"]["command"] for each in told if each["event"] == "command" and each["operator"] == "payload:uphill"}
    assert words == {"heading", "goto", "sight", "upload", "play"}
    assert [each for each in sailing.refused if each] == ["goto refused: 146.5 km to go; up to 20 km are allowed"]
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()


@pytest.mark.parametrize(
    "says", ["import signal; signal.pause()", 'print(\'{"command": "alive"}\' * 5000, flush=True); input(); input()']
)
def test_a_program_that_does_not_end_its_turn_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, says: str) -> None:
    monkeypatch.setattr(payloadprogram, "HANGS_S", 0.05)
    sailing = Sailing(tmp_path, "-c", says)
    with sailing.program, pytest.raises(DelfimError, match="payload uphill does not end its turn"):
        sailing.sail(0.6)


def test_one_that_cannot_be_started_is_named() -> None:
    with pytest.raises(DelfimError, match="payload gone: No such file or directory: /nowhere"):
        PayloadProgram("gone", ["/nowhere"], lambda command, operator: None)
