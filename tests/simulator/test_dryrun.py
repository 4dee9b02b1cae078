"""The dry run: a survey day is sailed to its end, and what cannot be done is given up in words."""

import math
from pathlib import Path

import pytest

from delfim import config
from delfim.console.plans import dry_run
from delfim.simulator.scenarios import dryrun
from delfim.vehicle.plans.estimate import in_hours, mission_s
from delfim.vehicle.plans.mission import read_mission

SETTINGS = config.load(Path(__file__).parents[2] / "etc/delfimx.toml")
DEG_M = 111_111.0


def lines(count: int, length_m: float, hold_s: float = 0.0) -> str:
    """Parallel lines 20 m apart beside the Doca."""
    at = SETTINGS.simulation
    rows = [
        (at.latitude_deg + along_m / DEG_M, at.longitude_deg + 20.0 * line / DEG_M)
        for line in range(count)
        for along_m in ((0.0, length_m) if line % 2 == 0 else (length_m, 0.0))
    ]
    points = "".join(f"[[waypoint]]\nlatitude_deg = {a:.7f}\nlongitude_deg = {b:.7f}\nhold_s = {hold_s}\n" for a, b in rows)
    return f'version = 1\nname = "lines"\n{points}'


def test_the_estimate_is_length_over_speed_and_the_stays() -> None:
    mission = read_mission(lines(2, 1500.0, hold_s=30.0))
    assert mission_s(mission, 1.5) == pytest.approx(2 * 1000.0 + 20.0 * math.cos(math.radians(38.7)) / 1.5 + 120.0, rel=0.01)
    assert [in_hours(s) for s in (40.4, 754.0, 55_980.0)] == ["40 s", "13 min", "15 h 33 min"]


def test_a_mission_is_given_time_by_its_length(monkeypatch: pytest.MonkeyPatch) -> None:
    """84 km are more than six hours. The sailing itself would take a minute: here it ends at once."""
    given: list[float] = []

    def cycles(self: object, limit_s: float) -> list[None]:
        given.append(limit_s)
        return []

    monkeypatch.setattr(dryrun.Lockstep, "cycles", cycles)
    answer = dryrun.sail(SETTINGS, lines(42, 2000.0))
    assert given[0] > 1.5 * 84_000.0 / 1.5
    assert answer["end"] == f"not done after {in_hours(given[0])} at sea"
    assert dryrun.sail(SETTINGS, lines(400, 2000.0, hold_s=3600.0))["end"] == "not done after 48 h 00 min at sea"


@pytest.mark.long
def test_a_mission_that_takes_longer_than_six_hours_is_sailed_to_its_end() -> None:
    answer = dryrun.sail(SETTINGS, lines(1, 100.0, hold_s=11_000.0))
    assert (answer["well"], answer["time_s"] > 22_000.0) == (True, True)


def test_a_computer_that_is_too_slow_is_said_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(dry_run, "LIMIT_S", 0.05)
    plan = {"name": "dry", "waypoints": [{"latitude_deg": 38.69, "longitude_deg": -9.21}]}
    answer = dry_run.dry_run(tmp_path / "no.toml", plan, None)
    assert "this computer did not sail it in 0 s" in answer["end"]
