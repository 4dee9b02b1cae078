"""`delfim sim`: the whole suite over a loopback bus, the other nodes modelled, a mission sailed, and pictures at the end.

The boat's program is the same that goes to sea, started the same way; what differs is said in its file's overrides: another
bus, another place for logs and sockets. In lock step nothing runs in real time and the same seed gives the same bytes.
"""

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from delfim import config
from delfim.canproxy.socket import ANYTHING, open_can
from delfim.console.drive import line
from delfim.console.link import Link
from delfim.errors import BusError, ConfigError, DelfimError, Refused
from delfim.vehicle.mission import Mission, canonical, load_mission
from delfim.wiring import StateLog

START_S = 10.0  # the suite must answer within this time
END_S = 10.0  # and have ended within this time
QUIET_S = 0.25  # a bus on which nobody speaks for so long is free
LOCKSTEP_S = 7200.0  # longest mission in lock step


def simulate(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when the mission was sailed to its end or the asked time passed, 1 when the boat stopped."""
    for number in (signal.SIGTERM, signal.SIGHUP):  # what we started ends with us
        signal.signal(number, signal.default_int_handler)
    settings = config.load(asked.file, asked.set)
    mission = _mission(asked, settings)
    output = Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    if asked.lockstep:
        return _lockstep(asked, settings, mission, output)
    overrides = [*asked.set, *_simulated(settings, output)]
    settings = config.load(asked.file, overrides)
    _alone(settings.can.interface)
    arguments = [asked.file, *(word for override in overrides for word in ("--set", override))]
    started = time.time()
    with contextlib.ExitStack() as running:
        running.enter_context(_process("nodes", *arguments, "--seed", str(asked.seed)))
        running.enter_context(_process("supervise", *arguments))
        if asked.console:
            running.enter_context(_process("console", *_console(asked.file, output)))
        end = _sail(asked, settings, mission)
    log = Path(settings.log.directory)
    _pictures([file for file in log.glob("*/state/*.state*") if file.stat().st_mtime > started], mission, settings, output)
    print(f"delfim: {end}")
    return _code(end)


def _console(file: str, output: Path) -> list[str]:
    """The console's words: what it keeps lies beside the simulation's own."""
    place = output.resolve() / "console"
    folders = [word for name in ("missions", "charts", "sessions") for word in (f"--{name}", str(place / name))]
    return ["--vehicle", file, *folders]


def _code(end: str) -> int:
    return 0 if end.startswith(("mission done", "time")) else 1


def _simulated(settings: config.Vehicle, output: Path) -> list[str]:
    """What is otherwise on a desk than at sea."""
    place = output.resolve()
    return [
        f'can.interface="{settings.simulation.interface}"',
        f'console.socket="{place}/command"',
        f'log.directory="{place}/log"',
        f'runtime.run_directory="{place}"',
        "runtime.fifo_priority=0",
        "simulation.faults=true",
        'supervisor.hardware_watchdog=""',
        f'httpd.listen="{settings.simulation.httpd}"',
        f'ftpd.listen="{settings.simulation.ftpd}"',
        f'ftpd.root="{place}/log"',
        f'sshd.listen="{settings.simulation.sshd}"',
        f'sshd.root="{place}/log"',
        f'sshd.host_key="{place}/ssh_host_ed25519"',
    ]


def _alone(interface: str) -> None:
    """Raises BusError when somebody sails on this bus already: two boats would obey each other's commands."""
    with open_can(interface) as socket:
        socket.bind(ANYTHING)
        socket.settimeout(QUIET_S)
        with contextlib.suppress(TimeoutError):
            socket.recvmsg()
            raise BusError(
                f"{interface} is in use by another simulation; name another with --set 'simulation.interface=\"canloop:can1\"'"
            )


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
                    with contextlib.suppress(Refused):  # not heard: a fault by command
                        operator.ask("alive")
                    alive = now
                if not playing:
                    with contextlib.suppress(DelfimError):  # not fit yet; the view shows why
                        operator.ask("play")
                        playing = True
                elif state["operator"] != "local":
                    continue  # a console took over: it ends this
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

        from delfim.console.view import View

        view = View([(w.latitude_deg, w.longitude_deg) for w in mission.waypoint])
        with Live(view.render(), refresh_per_second=5, screen=True) as live:

            def lively(state: dict[str, Any]) -> None:
                view.feed(state)
                live.update(view.render(*live.console.size))

            yield lively
            live.stop()


def _lockstep(asked: argparse.Namespace, settings: config.Vehicle, mission: Mission, output: Path) -> int:
    """The same mission as fast as the machine can; the state log's bytes depend on file, mission and seed alone."""
    from delfim.simulator.lockstep import Lockstep

    log = output.resolve() / f"lockstep-{asked.seed}"
    shutil.rmtree(log, ignore_errors=True)
    settings = config.load(asked.file, [*asked.set, f'log.directory="{log}"', 'log.state_method="write"'])
    started = time.monotonic()
    run = Lockstep(settings, asked.seed, lambda clock: StateLog(settings, clock))
    end = run.sail(canonical(mission), asked.for_s or LOCKSTEP_S)
    run.close()
    wall_s = time.monotonic() - started
    _pictures(list(log.glob("*/state/*.state*")), mission, settings, output, timed=False)
    print(f"delfim: {end}; {run.elapsed_s:.0f} s sailed in {wall_s:.2f} s, {run.elapsed_s / wall_s:.0f} times real time")
    return _code(end)


def _pictures(files: list[Path], mission: Mission, settings: config.Vehicle, output: Path, *, timed: bool = True) -> None:
    """Track of a run, and its latency where time was real, as PNG from the state log."""
    try:
        from delfim.logging import plot
    except ModuleNotFoundError as error:  # on a boat, in its container
        print(f"delfim: no pictures without {error.name}: pip install 'delfim[ground]'", file=sys.stderr)
        return
    from delfim.logging.statelog import columns

    data = columns(files)
    if not data:
        print("delfim: nothing was logged, so there are no pictures", file=sys.stderr)
        return
    acceptance_m = settings.control.path.acceptance_m
    marks = [(w.latitude_deg, w.longitude_deg, w.acceptance_m or acceptance_m) for w in mission.waypoint]
    plot.track(data, marks, f"{settings.boat.name}: {mission.name}", output / "track.png")
    print(f"delfim: {output}/track.png")
    if timed:
        plot.latency(data, f"{settings.boat.name}: critical path, t0 to t4", output / "latency.png")
        print(f"delfim: {output}/latency.png")
