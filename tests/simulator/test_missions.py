"""The missions that come with Delfim, sailed in lock step by the boats that come with it: each ends as its file says. With a
folder on its command line it draws the picture of docs/missions.md (`make pictures`).
"""

import math
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.plans.mission import Mission, load_mission
from delfim.vehicle.state import NoLog, State

ROOT = Path(__file__).parents[2]
MISSIONS = sorted((ROOT / "etc/missions").glob("*.toml"))
SAILED = [each for each in MISSIONS if each.stem not in ("doca", "lawnmower")]  # other tests sail those
BOATS = [*sorted((ROOT / "etc/boats").glob("*.toml")), ROOT / "etc/delfimx.toml"]
LIMIT_S = 3600.0
PATHS = {"patrol", "survey"}  # their files say so; the others are played
SAMPLER = 'payload.sampler={command=["/bin/true"], may=["samples"]}'
HOME_M = 8.0  # from where the boat lay to where it holds after its way home


class Sailed(NamedTuple):
    """What came of a mission: why it was refused, or how it ended, and where the boat was, degrees."""

    refused: str
    mode: Mode
    reason: str
    begin: tuple[float, float]
    track: list[tuple[float, float]]
    lines: set[int]
    samples: int
    seconds: float


def where(run: Lockstep) -> tuple[float, float]:
    return math.degrees(run.nodes.model.latitude_rad), math.degrees(run.nodes.model.longitude_rad)


def metres(one: tuple[float, float], other: tuple[float, float]) -> float:
    return math.hypot(one[0] - other[0], (one[1] - other[1]) * math.cos(math.radians(one[0]))) * 111_132.0


def samples(run: Lockstep, state: State) -> bool:
    """The sampler fails at each try but the last. Returns whether it has a sample."""
    asked = state.sample
    if not asked.number:
        return False
    ok = asked.attempt == asked.tries
    return run.vehicle.on_command(console.Sampled(asked.number, ok), "payload:sampler") is None and ok


def sail(mission: Path, boat: Path) -> Sailed:
    run = Lockstep(config.load(boat, (SAMPLER,)), 1, lambda clock: NoLog())
    try:
        return sailed(run, mission)
    finally:
        run.close()


def sailed(run: Lockstep, mission: Path) -> Sailed:
    begin, track, lines, taken = where(run), list[tuple[float, float]](), set[int](), 0
    refused = run.command(console.LoadMission(mission.read_text())) or ""
    go = console.SetMode("path") if mission.stem in PATHS else console.Play()
    under_way = False
    for state in run.cycles(0.0 if refused else LIMIT_S):
        under_way = under_way or run.command(go) is None
        if not under_way:
            continue
        track.append(where(run))
        lines.add(state.reference.line or 0)
        taken += samples(run, state)
        if state.mode in (Mode.HOLD, Mode.IDLE):
            break
    return Sailed(refused, run.state.mode, run.state.reason, begin, track, lines - {0}, taken, run.elapsed_s)


def ended(its: Sailed, mission: Mission, boat: config.Vehicle) -> None:
    """The mission ended as its file says, or the boat had a reason to refuse it."""
    most_mps = max([row.speed_mps for row in (*mission.waypoint, *mission.path)])
    assert bool(its.refused) is (most_mps > boat.control.speed.max_mps), its.refused
    if its.refused:
        assert "speed" in its.refused
        return
    assert its.mode is Mode.HOLD, its.reason
    assert its.reason.endswith(" done"), its.reason
    assert its.samples == sum(row.tries > 0 for row in mission.waypoint)
    assert its.lines == {row.line for row in mission.waypoint} - {0}
    if mission.then == "home":
        assert its.reason == "home done"
        assert metres(its.begin, its.track[-1]) < HOME_M
    else:
        last = (mission.path or mission.waypoint)[-1] if its.reason.startswith("path") else mission.waypoint[-1]
        assert metres((last.latitude_deg, last.longitude_deg), its.track[-1]) < HOME_M


def check(mission: Path, boat: Path) -> None:
    ended(sail(mission, boat), load_mission(str(mission)), config.load(boat))


@pytest.mark.parametrize("mission", SAILED, ids=lambda file: file.stem)
def test_a_mission_ends_as_it_says(mission: Path) -> None:
    check(mission, BOATS[-1])


@pytest.mark.parametrize("mission", MISSIONS, ids=lambda file: file.stem)
def test_a_mission_says_what_it_is_for(mission: Path) -> None:
    assert f"| `{mission.stem}.toml` |" in (ROOT / "docs/missions.md").read_text()
    assert [line[:2] for line in mission.read_text().splitlines()[:3]] == ["# ", "# ", "ve"]


@pytest.mark.long
@pytest.mark.parametrize("mission", SAILED, ids=lambda file: file.stem)
@pytest.mark.parametrize("boat", BOATS, ids=lambda file: file.stem)
def test_each_boat_sails_each_mission(mission: Path, boat: Path) -> None:
    check(mission, boat)


def draw(folder: Path) -> Path:
    """The tracks of DelfimX, side by side on one scale."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 6.6), layout="constrained")
    for axes, file in zip(figure.subplots(2, 3).flat, [*SAILED, ROOT / "etc/missions/lawnmower.toml"], strict=True):
        its, mission = sail(file, BOATS[-1]), load_mission(str(file))
        places = [(row.latitude_deg, row.longitude_deg) for row in mission.waypoint]
        (north, east), c = its.begin, math.cos(math.radians(its.begin[0]))
        laid = [
            [((lon - east) * c * 111_132.0, (lat - north) * 111_132.0) for lat, lon in each] for each in (its.track, places)
        ]
        axes.plot(*zip(*laid[0], strict=True), color="#2a6fb0", linewidth=1.3)
        axes.plot(*zip(*laid[1], strict=True), "o", markersize=4, color="none", markeredgecolor="#a85b00")
        axes.plot(0.0, 0.0, "^", color="black", markersize=7)
        for zone in mission.fence.keep_out if mission.fence else ():
            axes.fill(
                [(lon - east) * c * 111_132.0 for _, lon in zone.polygon],
                [(lat - north) * 111_132.0 for lat, _ in zone.polygon],
                color="#c44",
            )
        axes.set_title(f"{file.name}, {its.seconds / 60.0:.0f} min", fontsize=10)
        axes.set_aspect("equal", adjustable="datalim")
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.25)
    file = folder / "missions.png"
    figure.savefig(file, dpi=90)
    return file


if __name__ == "__main__":
    print(draw(Path(sys.argv[1])))
