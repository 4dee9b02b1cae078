"""`python -m bench avoiding`: Imazu's 22 encounters, sailed by the guard and by MOOS-IvP's BHV_AvdColregsV22, with one hull.

MOOS-IvP is found by its `MOOSDB` in PATH, in the checkout in which it was built; a C++ compiler must be there, too. Its helm
runs in lock step (`bench/moosavoid.cpp`): four times a second it is told where the boat and all ships truly are, and what it
decides the boat steers, as a front seat does (grex mode), with the guard off. The guard hears perfect AIS each second. No wind,
no current, whatever the vehicle's file has. What is fair about it and what is not: docs/encounters.md
"""

import argparse
import math
import shutil
import statistics
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from bench.critical_path import SOURCES, compiled
from delfim.base.errors import DelfimError
from delfim.campaign.colreg import RuleTape
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.scenarios.encounters import START_S, Staged, staged_of
from delfim.simulator.scenarios.scenario import load_scenario, settings_of
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

FILE: Final = "etc/encounters/imazu22-similar.toml"
CALM: Final = ('simulation.traffic.heard="perfect"', "simulation.sea.current_mps=0.0", "simulation.sea.wind_mps=0.0")
HELM_S: Final = 0.25


class Parameters(NamedTuple):
    """What the helm's behaviours are told, as "name=value" after each other."""

    avoid: str  # BHV_AvdColregsV22
    way: str = ""  # BHV_Waypoint. Without `lead` it steers for the end of the line, else for a point so far ahead on it


DEFAULT: Final = Parameters("pwt_outer_dist=100")  # as the behaviour has them without a file: inner 90 m, CPA 10 to 75 m
SCALED: Final = Parameters("pwt_outer_dist=540 pwt_inner_dist=270 min_util_cpa_dist=60 max_util_cpa_dist=120")
BERTA: Final = Parameters(  # of the mission m2_berta, which is for smaller boats, six times as large
    "pwt=150 pwt_outer_dist=480 pwt_inner_dist=300 min_util_cpa_dist=60 max_util_cpa_dist=108 use_refinery=true", "lead=48"
)
PILOTS: Final = {
    "Delfim, as shipped": None,
    "MOOS-IvP, its defaults": DEFAULT,
    "MOOS-IvP, as large as these domains": SCALED,
    "the same, led along the line (lead 20 m)": SCALED._replace(way="lead=20"),
    "MOOS-IvP, its mission Berta, six times as large": BERTA,
}


class Avoided(NamedTuple):
    """What came of an encounter."""

    name: str
    collisions: int
    entered: int
    nearest: tuple[float, ...]  # domains, of each ship
    late_s: float  # behind a boat that goes straight on, at the end
    asked: int  # checks of rules 8 and 13 to 17
    broken: tuple[str, ...]


class MoosHelm:
    """The helm of MOOS-IvP, in a process of its own."""

    def __init__(self, program: Path, run: Lockstep, speed_mps: float, parameters: Parameters) -> None:
        self._run, self._due_s = run, START_S
        words = [str(program), f"{speed_mps}", str(len(run.nodes.vessels)), "0", f"{1e5}", *parameters]
        pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
        self.process = subprocess.Popen(words, text=True, bufsize=1, stdin=pipe, stdout=pipe, stderr=nowhere)
        self._asked = 0.0, speed_mps

    def look(self) -> None:
        """Steer as it decides, from the beginning of the encounter on; straight on before."""
        run, now_s = self._run, self._run.elapsed_s
        if now_s >= self._due_s:
            self._due_s += HELM_S
            self._asked = self._decided(now_s)
        line = {"heading_deg": self._asked[0] % 360.0, "speed_mps": self._asked[1]}
        run.guest_says(msgspec.json.encode(line))

    def _decided(self, now_s: float) -> tuple[float, float]:
        model, into, out = self._run.nodes.model, self.process.stdin, self.process.stdout
        assert into is not None
        assert out is not None
        speed_mps = math.hypot(model.north_mps, model.east_mps)
        told = [now_s, model.east_m, model.north_m, math.degrees(model.heading_rad) % 360.0, speed_mps]
        for each in self._run.nodes.vessels:
            told += each.east_m, each.north_m, math.degrees(each.course_rad) % 360.0, each.speed_mps
        into.write(" ".join(f"{value:.4f}" for value in told) + "\n")
        words = out.readline().split()
        if not words:
            raise DelfimError("moosavoid ended")
        return (float(words[0]), float(words[1])) if len(words) == 2 else self._asked


def built(place: Path) -> Path | None:
    """The helm, compiled with the library of MOOS-IvP; None where that is not built. Raises DelfimError."""
    if (found := shutil.which("MOOSDB")) is None:
        return None
    root, program = Path(found).resolve().parents[1], place / "moosavoid"
    libraries = [str(each) for each in sorted((root / "lib").glob("*.a"))]
    helm = root / "ivp/src/pHelmIvP"
    headers = [f"-I{root / 'include/ivp'}", f"-I{helm}"]
    sources = [str(SOURCES / "moosavoid.cpp"), str(helm / "HelmEngine.cpp")]
    group = ["-Wl,--start-group", *libraries, "-Wl,--end-group", "-ldl", "-lpthread"]
    compiled(["c++", "-O2", "-std=c++17", "-w", *headers, "-o", str(program), *sources, *group])
    return program


def sailed(staged: Staged, file: str, program: Path | None, parameters: Parameters | None) -> Avoided:
    """One encounter, by the guard, or where there are parameters by the helm. Raises DelfimError."""
    lower = (*CALM, f"traffic.guard.enabled={'true' if parameters is None else 'false'}")
    settings = settings_of(staged.scenario, file, lower)
    run = Lockstep(settings, 1, lambda clock: NoLog())
    tape, speed_mps, helm = RuleTape(run), settings.control.speed.cruise_mps, None
    if parameters is not None and program is not None:
        helm = MoosHelm(program, run, speed_mps, parameters)
    try:
        _sail(run, staged, tape, helm)
    finally:
        if helm is not None:
            helm.process.kill()
            helm.process.communicate()
    model, vessels, checks = run.nodes.model, run.nodes.vessels, tape.checks()
    collisions = sum(each.nearest_m < (each.row.length_m + settings.boat.length_m) / 2.0 for each in vessels)
    nearest = tuple(each.nearest for each in vessels)
    straight_m = speed_mps * (run.elapsed_s - START_S)
    late_s = (straight_m - (model.north_m - _north_m(tape))) / speed_mps
    broken = tuple(each.rule for each in checks if not each.is_kept)
    return Avoided(staged.name, collisions, sum(each < 1.0 for each in nearest), nearest, late_s, len(checks), broken)


def _sail(run: Lockstep, staged: Staged, tape: RuleTape, helm: MoosHelm | None) -> None:
    began = False
    for _ in run.cycles(staged.scenario.seconds):
        if helm is not None:
            helm.look()
        if not began and run.elapsed_s >= START_S / 3.0:
            began = True
            orders: tuple[console.Commands, ...] = (console.LoadMission(staged.mission), console.SetMode("play"))
            for each in orders if helm is None else (console.SetMode("grex"),):
                if (why := run.command(each)) is not None:
                    raise DelfimError(f"{staged.name}: {why}")
        tape.look(run.elapsed_s)


def _north_m(tape: RuleTape) -> float:
    """Where the encounter began."""
    return next(each.north_m for each in tape.instants if each.t_s >= START_S)


def told(row: Avoided) -> str:
    """A case in a line."""
    near = ", ".join(f"{each:.2f}" for each in row.nearest)
    words = f"{row.name}: {row.collisions} collisions, {row.entered} entered, {near}, {row.late_s:.0f} s late"
    return f"{words}, not kept: {', '.join(row.broken)}" if row.broken else words


def table(rows: dict[str, list[Avoided]]) -> str:
    """The table of the document."""
    lines = [
        "| | ships | collisions | domains entered | nearest: least, median | late at the end, mean (most) | rules kept |",
        "|---" * 7 + "|",
    ]
    for name, these in rows.items():
        near, late = sorted(each for row in these for each in row.nearest), [row.late_s for row in these]
        kept = sum(row.asked - len(row.broken) for row in these)
        words = [name, len(near), sum(row.collisions for row in these), sum(row.entered for row in these)]
        words += [f"{near[0]:.2f}, {statistics.median(near):.2f}", f"{statistics.mean(late):.0f} s ({max(late):.0f})"]
        lines.append(f"| {' | '.join(map(str, words))} | {kept} of {sum(row.asked for row in these)} |")
    return "\n".join(lines)


def cases(quick: bool) -> Sequence[Staged]:
    found = staged_of(load_scenario(FILE), FILE)
    return found[:2] if quick else found


def run(asked: argparse.Namespace) -> int:
    """The command."""
    with tempfile.TemporaryDirectory(prefix="delfim-bench-") as folder:
        program, rows = built(Path(folder)), dict[str, list[Avoided]]()
        if program is None:
            print("MOOS-IvP is not built here (no MOOSDB in PATH): Delfim alone")
        for name, parameters in PILOTS.items():
            if parameters is None or program is not None:
                rows[name] = []
                for each in cases(asked.quick):
                    row = sailed(each, asked.file, program, parameters)
                    rows[name].append(row)
                    print(f"  {name}: {told(row)}", flush=True)
    print(table(rows))
    return 0
