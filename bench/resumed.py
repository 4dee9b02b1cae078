"""Surveys cut in the middle of a line, and gone on with, in lock step: what is covered by true places, and how long it takes.

`python -m bench.resumed CUTS [SEED]`: the basin of `etc/areas`, lines 10 m apart, with wind and current; cut at so many places,
in turn by each of

- battery: the boat goes home, lies there with another battery, and gets what `delfim survey rest` makes of all its depths;
- power: its program dies without a word, starts again with the voyage that it kept up to five seconds before, `continue`, and
  at the end *Fill the gaps*: while the program is dead the boat drifts, and nobody measures;
- link: nobody hears it, so it goes home; then what the page's *Fill the gaps* makes of the depths that were heard;
- operator: another one, whose console knows the mission aboard and those depths alone, with *Fill the gaps*.
"""

import contextlib
import io
import math
import sys
import tempfile
from pathlib import Path
from random import Random
from typing import Final

import msgspec
from shapely.geometry import LineString
from shapely.ops import unary_union

from delfim import config
from delfim.__main__ import main as delfim
from delfim.base.geodesy import to_plane
from delfim.base.modes import Mode
from delfim.console.boats.soundings import HEAD
from delfim.simulator.faults import Breakage
from delfim.simulator.lockstep import Lockstep
from delfim.survey.areafile import read_area
from delfim.survey.ground import Ground, Place, Segment, in_plane, laid
from delfim.survey.planning import planned, wanted_of
from delfim.survey.preview import answered
from delfim.survey.progress import done_m, left, sailed
from delfim.vehicle import console
from delfim.vehicle.plans.mission import Mission, canonical, load_mission
from delfim.vehicle.state import NoLog

ROOT: Final = Path(__file__).parents[1]
FILE, AREA = str(ROOT / "etc/delfimx.toml"), ROOT / "etc/areas/basin.geojson"
SEA: Final = "simulation.sea={current_mps=0.2, current_to_deg=70.0, wind_mps=4.0, wind_from_deg=300.0}"
SPACING_M: Final = 10.0
UNTIL_S: Final = 7200.0
KEPT_S, OFF_S, SILENT_S = 5.0, 20.0, 60.0
KINDS: Final = "battery", "power", "link", "operator"


class Boat:
    """A boat that sails a survey: its true places and its time while it followed a path, and the files of its depths, of all
    and of those that a console heard."""

    def __init__(self, ground: Ground, folder: Path) -> None:
        self._ground, self.all, self.heard = ground, folder / "all.csv", folder / "heard.csv"
        for file in (self.all, self.heard):
            file.write_text(HEAD)
        self.tracks, self.path_s, self._kept, self._told_s = list[list[Place]](), 0.0, b"", 0.0
        self.run = self._begun()

    def _begun(self, *here: str) -> Lockstep:
        run = Lockstep(config.load(FILE, [SEA, *here]), 1, lambda clock: NoLog())
        for _ in run.cycles(5.0):
            pass
        return run

    def at(self) -> tuple[float, float]:
        model = self.run.nodes.model
        return math.degrees(model.latitude_rad), math.degrees(model.longitude_rad)

    def follow(self, how: console.Commands, until_s: float = math.inf) -> None:
        """Follow a path to its end, or to the middle of a line after so long."""
        why = self.run.command(how)
        assert why is None, why
        begun_s, was_s = self.run.elapsed_s, self.path_s
        self.tracks.append([])
        for state in self.run.cycles(UNTIL_S):
            self.path_s = was_s + self.run.elapsed_s - begun_s
            if state.mode is not Mode.PATH or (self.path_s > until_s and state.reference.line):
                return
            self._note()

    def _note(self) -> None:
        """Once a second."""
        if self.path_s < self._told_s:
            return
        self._told_s = self.path_s + 1.0
        model = self.run.nodes.model
        self.tracks[-1].append(to_plane(self._ground.at, model.latitude_rad, model.longitude_rad)[::-1])
        if not self._kept or self.path_s % KEPT_S < 1.0:
            self._kept = self.run.kept()
        n = self.run.state.navigation
        assert n is not None
        assert n.latitude_rad is not None
        assert n.longitude_rad is not None
        row = f"{self._told_s:.3f},{math.degrees(n.latitude_rad):.7f},{math.degrees(n.longitude_rad):.7f},5.0\n"
        for file in (self.all,) if "console_lost" in self.run.faults.on else (self.all, self.heard):
            with file.open("a") as out:
                out.write(row)

    def until(self, mode: Mode) -> None:
        assert any(state.mode is mode for state in self.run.cycles(UNTIL_S)), self.run.state.reason

    def swap(self) -> None:
        """Home, and another battery."""
        assert self.run.command(console.SetMode("home")) is None
        self.until(Mode.HOLD)
        here = zip(("latitude", "longitude"), self.at(), strict=True)
        self.run.close()
        self.run = self._begun(*(f"simulation.{name}_deg={deg:.8f}" for name, deg in here))

    def die(self) -> None:
        self.run.restart(OFF_S, self._kept)
        self.until(Mode.HOLD)

    def fall_silent(self) -> None:
        """It follows its path until it notices, and goes home."""
        self.run.breaks(Breakage("console_lost", for_s=SILENT_S))
        for state in self.run.cycles(UNTIL_S):
            if state.mode is not Mode.PATH:
                break
            self._note()
        self.until(Mode.HOLD)
        assert any("console_lost" not in self.run.faults.on for _ in self.run.cycles(2.0 * SILENT_S))


def command(*words: object) -> None:
    """Of `delfim survey`."""
    with contextlib.redirect_stdout(io.StringIO()):
        assert delfim(["survey", *map(str, words)]) == 0


def filled(boat: Boat, mission: Mission, known: bool) -> Mission | None:
    """What *Fill the gaps* makes of a mission, None: nothing is left; `known`: by the console that has its area."""
    legs = zip(mission.waypoint, mission.waypoint[1:], strict=False)
    lines = [[(each.latitude_deg, each.longitude_deg) for each in leg] for leg in legs if leg[1].line]
    asked = {"areas": read_area(AREA) if known else [], "spacing_m": SPACING_M if known else 0.0, "lines": lines}
    told = answered(msgspec.json.encode(asked | {"at": boat.at(), "heard": [str(boat.heard)]}), config.load(FILE))
    if str(told.get("refused", "")).startswith("nothing is left"):
        return None
    assert "refused" not in told, told
    return msgspec.convert(told["mission"], Mission)


def cut(boat: Boat, kind: str, mission: Mission, folder: Path) -> None:
    """What happens, and what is done."""
    rest: Mission | None
    match kind:
        case "power":
            boat.die()
            boat.follow(console.Continue())
            rest = filled(boat, mission, True)
        case "battery":
            boat.swap()
            here = "{:.8f},{:.8f}".format(*boat.at())
            command("rest", folder / "basin.survey.json", boat.all, f"--at={here}", "--output", folder / "rest.toml")
            rest = load_mission(folder / "rest.toml")
        case "link":
            boat.fall_silent()
            rest = filled(boat, mission, True)
        case _:
            assert boat.run.command(console.SetMode("hold")) is None
            rest = filled(boat, mission, False)
    if rest is not None:
        begun(boat, rest)


def begun(boat: Boat, mission: Mission, until_s: float = math.inf) -> None:
    assert boat.run.command(console.LoadMission(canonical(mission))) is None
    for _ in boat.run.cycles(2.0):
        pass
    boat.follow(console.SetMode("path"), until_s)


def told(boat: Boat, lines: list[Segment], free: object) -> tuple[float, float, float]:
    """The part that lies within half of the spacing of the way; the longest gap of a line, m; and how much of lines was sailed
    by more than one of the voyages, m."""
    near = unary_union([LineString(track).buffer(SPACING_M / 2.0) for track in boat.tracks if len(track) > 1])
    every = sailed(lines, [place for track in boat.tracks for place in track], SPACING_M)
    gaps = [math.dist(*gap) for line, done in zip(lines, every, strict=True) for gap in left(line, done)]
    each = sum(done_m(done) for track in boat.tracks for done in sailed(lines, track, SPACING_M))
    return near.intersection(free).area / free.area, max(gaps, default=0.0), each - sum(map(done_m, every))  # type: ignore[attr-defined]


def main(cuts: int, seed: int) -> None:
    ground, settings = laid(read_area(AREA)), config.load(FILE)
    free = planned(ground, wanted_of(settings, spacing_m=SPACING_M), settings.fence).free
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command("lines", AREA, "--spacing", SPACING_M, "--output", folder / "basin.toml")
        mission, kept = load_mission(folder / "basin.toml"), (folder / "basin.survey.json").read_bytes()
        ends = msgspec.json.decode(kept)["lines"]
        plane = [(in_plane(ground.at, *begin), in_plane(ground.at, *end)) for begin, end in ends]
        whole = Boat(ground, folder)
        begun(whole, mission)
        at_once, gap_m, _ = told(whole, plane, free)
        print(f"at once: {whole.path_s:.0f} s, {at_once:.2%} covered, longest gap {gap_m:.1f} m")
        for number in range(cuts):
            part, kind = Random(f"cut {seed} {number}").uniform(0.1, 0.9), KINDS[number % len(KINDS)]
            (folder / "basin.survey.json").write_bytes(kept)
            boat = Boat(ground, folder)
            begun(boat, mission, part * whole.path_s)
            cut(boat, kind, mission, folder)
            covered, gap_m, twice_m = told(boat, plane, free)
            words = f"{100.0 * (covered - at_once):+.2f} % covered, longest gap {gap_m:.1f} m, {twice_m:.0f} m twice"
            print(f"{kind} at {part:.2f}: {boat.path_s / whole.path_s:.3f} of the time, {words}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1)
