"""`delfim sim`: the whole suite over a loopback bus, the other nodes modelled, a mission sailed, and pictures at the end.

The boat's program is the same that goes to sea, started the same way; what differs is said in its file's overrides: another
bus, another place for logs and sockets. In lock step nothing runs in real time and the same seed gives the same bytes.
"""

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from delfim import config
from delfim.console.drive import line
from delfim.console.link import Link
from delfim.console.view import View
from delfim.errors import ConfigError, DelfimError
from delfim.vehicle.mission import Mission, canonical, load_mission

START_S = 10.0  # the suite must answer within this time
END_S = 10.0  # and have ended within this time


def simulate(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when the mission was sailed to its end or the asked time passed, 1 when the boat stopped."""
    settings = config.load(asked.file, asked.set)
    mission = _mission(asked, settings)
    output = Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    if asked.lockstep:
        return _lockstep(asked, settings, mission, output)
    overrides = [*asked.set, *_simulated(settings, output)]
    settings = config.load(asked.file, overrides)
    arguments = [asked.file, *(word for override in overrides for word in ("--set", override))]
    with _process("nodes", *arguments, "--seed", str(asked.seed)), _process("supervise", *arguments):
        end = _sail(asked, settings, mission)
    _pictures(Path(settings.log.directory), mission, settings.boat.name, output)
    print(f"delfim: {end}")
    return 0 if end.startswith(("mission done", "time")) else 1


def _simulated(settings: config.Vehicle, output: Path) -> list[str]:
    """What is otherwise on a desk than at sea."""
    place = output.resolve()
    return [
        f'can.interface="{settings.simulation.interface}-{os.getpid()}"',
        f'console.socket="{place}/command"',
        f'log.directory="{place}/log"',
        f'runtime.run_directory="{place}"',
        'supervisor.hardware_watchdog=""',
        'guest.listen="127.0.0.1:0"',
    ]


def _mission(asked: argparse.Namespace, settings: config.Vehicle) -> Mission:
    named = asked.mission or (settings.simulation.mission and str(Path(asked.file).parent / settings.simulation.mission))
    if not named:
        raise ConfigError(asked.file, "simulation.mission", "missing, and no --mission was given")
    return load_mission(named)


@contextlib.contextmanager
def _process(command: str, *arguments: str) -> Iterator[None]:
    """A child of the same program, ended in order however this one ends."""
    child = subprocess.Popen([sys.executable, "-m", "delfim", command, *arguments], start_new_session=True)
    try:
        yield
    finally:
        child.send_signal(signal.SIGTERM)
        try:
            child.wait(END_S)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()


def _connected(path: str) -> Link:
    """A link to the vehicle as soon as it listens. Raises DelfimError when it does not within START_S."""
    until = time.monotonic() + START_S
    while True:
        try:
            return Link(path)
        except DelfimError:
            if time.monotonic() > until:
                raise
            time.sleep(0.02)


def _sail(asked: argparse.Namespace, settings: config.Vehicle, mission: Mission) -> str:
    """Load the mission, play it as soon as the boat is fit, watch until it ends. Returns how it ended, in words."""
    with _connected(settings.console.socket) as operator, _connected(settings.console.socket) as onlooker:
        operator.ask("mission", text=canonical(mission))
        started = time.monotonic()
        playing = False
        alive = 0.0
        with _shown(asked, mission) as show:
            for state in onlooker.watch():
                show(state)
                now = time.monotonic()
                if asked.for_s is not None and now - started > asked.for_s:
                    return f"time: {asked.for_s:.0f} s sailed, mode {state['mode']}"
                if now - alive > 1.0:
                    operator.ask("alive")
                    alive = now
                if not playing:
                    with contextlib.suppress(DelfimError):  # not fit yet; the view shows why
                        operator.ask("play")
                        playing = True
                elif state["mode"] == "hold" and state["reason"] == "play done":
                    return f"mission done in {now - started:.0f} s"
                elif state["mode"] == "idle":
                    return f"stopped: {state['reason']}"
    return "the vehicle went away"


@contextlib.contextmanager
def _shown(asked: argparse.Namespace, mission: Mission) -> Iterator[Any]:
    """How states are shown: a live view, one line a second, or JSON."""
    if asked.json:
        yield lambda state: print(json.dumps(state), flush=True)
    elif asked.plain or not sys.stdout.isatty():
        last = [0.0]

        def plain(state: dict[str, Any]) -> None:
            if time.monotonic() - last[0] >= 1.0:
                last[0] = time.monotonic()
                path = "/".join(f"{state['latency'][name]:.0f}" for name in ("p50_us", "p99_us", "worst_us"))
                print(f"{line(state)}  path {path} us", flush=True)

        yield plain
    else:
        from rich.live import Live

        view = View([(w.latitude_deg, w.longitude_deg) for w in mission.waypoint])
        with Live(view.render(), refresh_per_second=5, screen=True) as live:

            def lively(state: dict[str, Any]) -> None:
                view.feed(state)
                live.update(view.render())

            yield lively
            live.stop()


def _lockstep(asked: argparse.Namespace, settings: config.Vehicle, mission: Mission, output: Path) -> int:
    from delfim.simulator.lockstep import Lockstep

    log = output / "log"
    run = Lockstep(settings, asked.seed, log)
    started = time.monotonic()
    end = run.sail(canonical(mission), asked.for_s or 7200.0)
    run.close()
    wall_s = time.monotonic() - started
    _pictures(log, mission, settings.boat.name, output)
    print(f"delfim: {end}; {run.elapsed_s:.0f} s sailed in {wall_s:.2f} s, {run.elapsed_s / wall_s:.0f} times real time")
    return 0 if end.startswith(("mission done", "time")) else 1


def _pictures(log: Path, mission: Mission, boat: str, output: Path) -> None:
    """Track and latency of the newest run under `log`, as PNG beside it."""
    from delfim.logging import plot
    from delfim.logging.statelog import columns

    files = sorted(log.glob("*/state/*"))
    if not files:
        print(f"delfim: nothing was logged under {log}", file=sys.stderr)
        return
    data = columns(files)
    marks = [(w.latitude_deg, w.longitude_deg, w.acceptance_m or 5.0) for w in mission.waypoint]
    plot.track(data, marks, f"{boat}: {mission.name}", output / "track.png")
    plot.latency(data, f"{boat}: critical path, t0 to t4", output / "latency.png")
    print(f"delfim: {output}/track.png, {output}/latency.png")
