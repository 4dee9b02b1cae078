"""`delfim sim`: runs the whole suite over a loopback bus with the other nodes modelled, sails a mission, and draws pictures at
the end.

The boat's program is the same that goes to sea, started the same way; overrides of its file set another
bus and another place for logs and sockets. In lock step nothing runs in real time and the same seed gives the same bytes.
"""

import argparse
import contextlib
import json
import math
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from delfim import config
from delfim.base.errors import BusError, ConfigError, DelfimError
from delfim.base.input.untrusted import read_text
from delfim.base.modes import Mode
from delfim.base.wholefile import replace_file
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING
from delfim.commands import OWN_FILE, example_file, seconds, shipped
from delfim.console.terminal.onlooker import CTRL_C, START_S, Voyage
from delfim.parts.mavlink.table import Mavlink
from delfim.simulator.tables import Simulation
from delfim.simulator.workspace import BOATS, PAGE, SIMULATED, Workspace, settings_of, workspace
from delfim.vehicle.log.logbook import Logbook
from delfim.vehicle.plans.mission import Mission, canonical, load_mission

END_S = 10.0  # a program must have ended within this time
QUIET_S = 0.25  # a bus that was silent for this long is free
LOCKSTEP_S = 7200.0  # longest mission in lock step
PAUSE_NS = 5_000_000_000  # a longer gap between two records does not count as way


def options(parser: argparse.ArgumentParser) -> None:
    example_file(parser, nargs="?", default=OWN_FILE)
    parser.add_argument("--mission", metavar="FILE", type=shipped, help="Sail this one instead of simulation.mission of FILE.")
    parser.add_argument(
        "--scenario",
        metavar="FILE",
        type=shipped,
        help='Sail this scenario in lock step; the seed draws "mixed", "chased", "forged" and "searching".',
    )
    parser.add_argument(
        "--for", type=seconds, dest="for_s", metavar="SECONDS", help="End after this time, not with the mission."
    )
    told = "The boat in the water is that of this file, of which hers knows nothing: to try `delfim adopt` (docs/adopt.md)."
    parser.add_argument("--truth", metavar="FILE", type=shipped, help=told)
    parser.add_argument("--seed", type=int, default=1, help="Seed of noise and gusts.")
    parser.add_argument("--lockstep", action="store_true", help="Sail as fast as the machine can; same seed, same bytes.")
    parser.add_argument("--plain", action="store_true", help="Print one line a second instead of the live view.")
    parser.add_argument("--json", action="store_true", help="Print one JSON object for each state.")
    told = "Run the console in the browser, too, and stay until Ctrl-C (docs/console.md)."
    parser.add_argument("--console", action="store_true", help=told)
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="With --console: do not open the browser.")
    parser.add_argument(
        "--page", metavar="ADDRESS:PORT", help=f"Serve the console's page here (default: {PAGE}, or the next free)."
    )
    parser.add_argument(
        "--boats", metavar="ADDRESS:PORT", help=f"Have the console listen for boats here (default: {BOATS}, or the next free)."
    )
    parser.add_argument(
        "--output",
        metavar="DIRECTORY",
        help=f"Keep logs, sockets and pictures here (default: {SIMULATED}; of a second simulation, {SIMULATED}-2).",
    )


def run(asked: argparse.Namespace) -> int:
    """Run the command. Returns 0 when the mission was sailed to its end, the given time passed or Ctrl-C was typed, 1 when the
    boat stopped."""
    for name in {"SIGINT", "SIGTERM", "SIGHUP"} & {*dir(signal)}:  # our children end with us, also in a script's background
        signal.signal(getattr(signal, name), signal.default_int_handler)
    if asked.scenario:
        return _scenario(asked)
    settings = config.load(asked.file, asked.set)
    mission = _mission(asked, settings)
    if asked.truth and asked.lockstep:
        raise DelfimError("--truth is for real time; in lock step `delfim adopt FILE --sim SEED` draws a boat")
    return _lockstep(asked, settings, mission) if asked.lockstep else _real_time(asked, settings, mission)


def _scenario(asked: argparse.Namespace) -> int:
    from delfim.logging.statelog import columns
    from delfim.simulator.scenarios import random_faults, searching, trial

    logged = bool(asked.output)
    overrides = (*asked.set, *(_kept(asked) if logged else ()))
    if draw := searching.DRAWN.get(asked.scenario):
        result = random_faults.sail_mixed(asked.file, asked.seed, overrides, draw, logged=logged)
    else:
        result = trial.run_file(asked.scenario, asked.file, asked.seed, overrides, logged=logged)
    print(*trial.report(result), sep="\n")
    if logged:
        settings = config.load(asked.file, overrides)
        log = Path(settings.log.directory)
        data = columns(log.glob("*/state/*.state*"))
        print("\n".join(f"  {name:12} {words}" for name, words in [*_figures(data), ("log", _beside(log))]))
        _pictures(data, Mission(version=1, name=asked.scenario, waypoint=()), settings, Path(asked.output), timed=False)
    if result.failures:
        print(
            f"delfim: failed; again: {random_faults.again(asked.file, asked.scenario, asked.seed, asked.set)}", file=sys.stderr
        )
        return 1
    print(f"delfim: {asked.scenario}, seed {asked.seed}: all as it must be, {result.elapsed_s:.0f} s sailed")
    return 0


def _real_time(asked: argparse.Namespace, settings: config.Vehicle, mission: Mission) -> int:
    with workspace(asked.output) as its:
        named = {override.partition("=")[0].strip() for override in asked.set}
        truth = config.load(asked.truth, asked.set) if asked.truth else None
        simulated = settings_of(settings, its, named, truth)
        overrides, console = [*asked.set, *simulated.overrides], list[str]()
        if asked.console:
            console, heard, page_at = _console(asked, settings, its, simulated.boat_id)
            overrides += [] if "httpd.console" in named else [f"httpd.console={json.dumps(f'http://{page_at}/')}"]
            peers = [heard, *(peer for peer in settings.of(Mavlink).peers if peer != BOATS)][:8]
            overrides += [] if "mavlink.peers" in named else [f"mavlink.peers={json.dumps(peers)}"]
        settings = config.load(asked.file, overrides)
        _alone(settings.can.interface)
        arguments = [asked.file, *(word for override in overrides for word in ("--set", override))]
        voyage = Voyage(asked, settings, mission)
        page = "" if simulated.page.endswith(":0") else f"; its page is http://{simulated.page}/"
        told = f"simulation {its.number}: boat {simulated.boat_id} ({settings.boat.name}) in {its.folder}{page}"
        print(f"delfim: {told}", file=sys.stderr if asked.json else sys.stdout, flush=True)
        for each in simulated.moved:
            print(f"delfim: real ports are left alone: {each}", file=sys.stderr if asked.json else sys.stdout, flush=True)
        with contextlib.ExitStack() as running:
            try:
                world = [
                    asked.truth or asked.file,
                    *arguments[1:],
                    *(word for each in simulated.world for word in ("--set", each)),
                ]
                running.enter_context(_process("nodes", *world, "--seed", str(asked.seed)))
                boat = running.enter_context(_process("supervise", *arguments))
                if asked.console:
                    gateway = running.enter_context(_process("console", *console, stdout=subprocess.PIPE))
                    voyage.address, voyage.gateway = _announced(gateway), gateway
                voyage.sail(boat)
            except KeyboardInterrupt:
                voyage.end = CTRL_C
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # they end in order, each within END_S
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _report(voyage, settings, mission, its.folder)
        return _code(voyage.end)


def _console(asked: argparse.Namespace, settings: config.Vehicle, its: Workspace, number: int) -> tuple[list[str], str, str]:
    """The arguments of the console, its address for boats, and that of its page. Its files lie beside the
    simulation's own. A boat that has a key obeys nobody without it."""
    place, boats = its.folder.resolve() / "console", asked.boats or its.address(BOATS, udp=True)
    page = asked.page or its.address(PAGE)
    words = ["--vehicle", _copied(asked.file, place, number), "--boats", boats, "--page", page]
    words += ["--key", settings.of(Mavlink).key] if settings.of(Mavlink).key else []
    words += [] if asked.browser else ["--no-browser"]
    kept = [word for name in ("missions", "charts", "sessions", "trials", "token") for word in (f"--{name}", str(place / name))]
    return [*words, *kept], boats, page


def _copied(file: str, place: Path, number: int) -> str:
    """Copy the vehicle's file beside the simulation's own, for what is found of a simulated boat must not come into that of
    the real one. A copy is its own. `number` is the simulated boat's. Returns its name."""
    from delfim.adoption.writing import Key, changed

    copy = place / Path(file).name
    if copy.resolve() != Path(file).resolve():
        vehicle, its = config.load(file), dict[Key, tuple[object, str]]()
        if mission := vehicle.of(Simulation).mission:
            its["simulation", "mission"] = str(Path(file).resolve().parent / mission), "of a simulation"
        if vehicle.boat.id != number:
            its["boat", "id"] = number, "of a simulation"
        place.mkdir(parents=True, exist_ok=True)
        text = read_text(file)
        with contextlib.suppress(DelfimError):  # its tables are written in another way: the copy is as it is
            text = changed(text, its, file)
        replace_file(copy, text)
    return str(copy)


def _announced(console: "subprocess.Popen[bytes]") -> str:
    """Read the address that the console prints as soon as it listens. Raises DelfimError if it does not."""
    assert console.stdout is not None
    ready, _, _ = select.select([console.stdout], [], [], START_S)
    told = console.stdout.readline().decode(errors="replace").strip() if ready else ""
    if not told:
        raise DelfimError("the console did not start, so nothing was sailed; its error stands above")
    print(told, flush=True)
    return next((word.rstrip(";") for word in told.split() if word.startswith("http")), "")


def _report(voyage: Voyage, settings: config.Vehicle, mission: Mission, folder: Path) -> None:
    """Print the summary and draw the pictures."""
    from delfim.logging.statelog import columns

    log = Path(settings.log.directory)
    files = [file for file in log.glob("*/state/*.state*") if file.stat().st_mtime > voyage.began_utc_s]
    data = columns(files)
    print(f"delfim: {voyage.end}")
    rows = [("time", voyage.time()), *_figures(data)]
    rows.append(("troubles", "; ".join(f"{name}: {reason}" for name, reason in voyage.troubles.items()) or "none"))
    rows.append(("log", _beside(log)))
    print("\n".join(f"  {name:12} {words}" for name, words in rows), flush=True)
    _pictures(data, mission, settings, folder)


def _figures(data: dict[str, list[Any]]) -> list[tuple[str, str]]:
    """Distance sailed, and cross-track error while a mission was played, from the columns of the state log."""
    if not data:
        return []
    steps = zip(data["t1"], data["t1"][1:], data["north_speed"][1:], data["east_speed"][1:], strict=False)
    ways = [math.hypot(north, east) * (end - begin) / 1e9 for begin, end, north, east in steps if 0 < end - begin < PAUSE_NS]
    both = zip(data["mode"], data["cross_track"], strict=True)
    off = [abs(value) for mode, value in both if mode == Mode.PLAY and math.isfinite(value)]
    rows = [("distance", f"{math.fsum(way for way in ways if math.isfinite(way)):.0f} m")]
    if off:
        rms_m = math.sqrt(math.fsum(value * value for value in off) / len(off))
        rows.append(("cross-track", f"{rms_m:.2f} m rms, {max(off):.2f} m at most, while the mission was played"))
    return rows


def _code(end: str) -> int:
    return 0 if end.startswith(("mission done", "time", CTRL_C)) else 1


def _alone(interface: str) -> None:
    """Check that the bus is free. Raises BusError if a boat already sails on it: two would obey each other's commands."""
    with open_can(interface) as bus:
        bus.bind(ANYTHING)
        bus.settimeout(QUIET_S)
        with contextlib.suppress(TimeoutError):
            bus.recvmsg()
            raise BusError(
                f"{interface} is in use by another simulation; name another: --set simulation.interface=canloop:NAME"
            )


def _mission(asked: argparse.Namespace, settings: config.Vehicle) -> Mission:
    """What is played at the start. With a console it may be nothing, a mission without waypoints. Raises ConfigError."""
    if asked.mission:
        return load_mission(asked.mission)
    if not settings.of(Simulation).mission:
        if asked.console and not asked.lockstep:
            return Mission(version=1, name=settings.boat.name, waypoint=())
        raise ConfigError(asked.file, "simulation.mission", "missing, and no --mission was given")
    return load_mission(config.mission_place(asked.file, settings))


@contextlib.contextmanager
def _process(command: str, *arguments: str, stdout: int | None = None) -> Iterator["subprocess.Popen[bytes]"]:
    """Start a child of the same program, ended in order however this one ends."""
    child = subprocess.Popen([sys.executable, "-m", "delfim", command, *arguments], start_new_session=True, stdout=stdout)
    try:
        yield child
    finally:
        child.send_signal(signal.SIGTERM)
        try:
            child.wait(END_S)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
        if child.stdout is not None:
            child.stdout.close()


def _lockstep(asked: argparse.Namespace, settings: config.Vehicle, mission: Mission) -> int:
    """Sail the same mission as fast as the machine can; the state log's bytes depend on file, mission and seed alone."""
    from delfim.logging.statelog import columns
    from delfim.simulator.lockstep import Lockstep
    from delfim.simulator.realtime.external_model import SteppedModel

    settings = config.load(asked.file, [*asked.set, *_kept(asked)])
    log = Path(settings.log.directory)
    started = time.monotonic()
    model = SteppedModel.of(settings)
    if model is not None:
        print(f"delfim: waits for the model at {settings.of(Simulation).external}", flush=True)
        model.begin()
        started = time.monotonic()
    run = Lockstep(settings, asked.seed, partial(Logbook, settings), model)
    end = run.sail(canonical(mission), asked.for_s or LOCKSTEP_S)
    run.close()
    wall_s = time.monotonic() - started
    data = columns(log.glob("*/state/*.state*"))
    print(f"delfim: {end}; {run.elapsed_s:.0f} s sailed in {wall_s:.2f} s, {run.elapsed_s / wall_s:.0f} times real time")
    print("\n".join(f"  {name:12} {words}" for name, words in [*_figures(data), ("log", _beside(log))]), flush=True)
    _pictures(data, mission, settings, log.parent, timed=False)
    return _code(end)


def _kept(asked: argparse.Namespace) -> tuple[str, ...]:
    """The folder where a run in lock step keeps its log: nothing of one before stays."""
    log = Path(asked.output or SIMULATED).resolve() / f"lockstep-{asked.seed}"
    shutil.rmtree(log, ignore_errors=True)
    log.parent.mkdir(parents=True, exist_ok=True)
    return f'log.directory="{log}"', 'log.state_method="write"'


def _pictures(
    data: dict[str, list[Any]], mission: Mission, settings: config.Vehicle, output: Path, *, timed: bool = True
) -> None:
    """Draw the track of a run, and its latency where time was real, as PNG from the state log."""
    from delfim.console.tapes.loggedmissions import sailed
    from delfim.logging.ashore import tree

    try:
        from delfim.logging.ashore import plot
    except ModuleNotFoundError as error:  # on a boat, in its container
        print(f"delfim: no pictures without {error.name}: pip install 'delfim[ground]'", file=sys.stderr)
        return
    if not data:
        print("delfim: nothing was logged, so there are no pictures", file=sys.stderr)
        return
    acceptance_m = settings.control.path.acceptance_m
    last = tree.choose(tree.files([settings.log.directory]), "last", time.time_ns())
    mission = sailed(tree.events(file for run in last for file in run.files)) or mission
    marks = [(w.latitude_deg, w.longitude_deg, w.acceptance_m or acceptance_m) for w in mission.waypoint]
    plot.track(data, marks, f"{settings.boat.name}: {mission.name}", output / "track.png")
    drawn = [output / "track.png"]
    if timed:
        plot.latency(data, f"{settings.boat.name}: critical path, t0 to t4", output / "latency.png")
        drawn.append(output / "latency.png")
    print(f"  {'pictures':12} {', '.join(map(str, drawn))}", flush=True)


def _beside(path: Path) -> str:
    """A path as seen from the present folder."""
    return os.path.relpath(path) if path.is_relative_to(Path.cwd()) else str(path)
