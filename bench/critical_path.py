"""`python -m bench critical-path`: navigation to propulsion, this program against others, side by side on one machine.

Competitors take turns in short slices, in the same run, so that what the machine does to one it does to all; those whose turn
it is not are stopped. C has two turns a round: how far C is from itself is how far the figures can be trusted. Every
competitor keeps its own log of stamps t0..t5; t0 is the kernel's. What is compared, and how to read it: docs/benchmark.md.
"""

import argparse
import contextlib
import itertools
import json
import os
import platform
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from bench import report
from bench.load import ASHORE, ELSEWHERE, IDLE, Ports, prepare
from bench.report import Cycle
from delfim import config
from delfim.base.errors import DelfimError, Refused
from delfim.canproxy.canloop import group_of
from delfim.logging.statelog import columns
from delfim.services.priority.window import ARRIVALS
from delfim.vehicle.operator.link import Link

SOURCES: Final = Path(__file__).parent
LABELS: Final = {
    "c": "C poll loop, services apart",
    "realtime": "the same in real time",
    "delfim": "Delfim",
    "ordinary": "Delfim, not in real time",
    "dronecan": "Delfim, motors on DroneCAN",
    "vesc": "Delfim, motors on VESC",
    "empty": "Delfim that computes nothing",
    "apart": "Delfim, services apart",
    "asyncio": "the same on plain asyncio",
    "uvloop": "the same on uvloop",
}
MOTORS: Final = ("dronecan", "vesc")  # drivers in place of the boat's own propellers, on a bus of their own
OURS: Final = ("delfim", "ordinary", *MOTORS, "empty", "apart")  # that have a window
RATES_HZ: Final = (5.0, 100.0, 500.0)
LONG_CYCLES: Final = 150_645  # as many as the thesis logged at sea
REAL_TIME: Final = ("chrt", "--fifo", str(config.RuntimeTable().fifo_priority))  # as this program where its file says nothing
WARM_PERIODS, WARM_S_MIN = ARRIVALS + 1, 0.7  # until the source and the figures of the turn before are forgotten
START_S: Final = 20.0  # a competitor must be ready within this time
OVER: Final = "over budget: "
END_S: Final = 15.0  # and have ended within this one
GRACE_S: Final = 0.05  # for the last cycle of a slice


class Plan(NamedTuple):
    """What is measured. Every round of a rate and a load has a slice for each competitor and, among several, two for C."""

    rates_hz: tuple[float, ...]
    loads: tuple[str, ...]
    competitors: tuple[str, ...]
    seconds: float
    rounds: int

    def turns(self, load: str, number: int) -> list[str]:
        """The order of a round: back and forth, C at both ends; two take turns."""
        others = [key for key in self.competitors if key != "c" and not (key == "apart" and load == "idle")]
        if len(others) == 1:
            return [*others, "c"] if number % 2 else ["c", *others]
        return ["c", *(others if number % 2 else reversed(others)), "c"]

    def slices(self) -> int:
        return sum(len(self.turns(load, 0)) for load in self.loads) * self.rounds * len(self.rates_hz)


class Slice(NamedTuple):
    """One turn of one competitor, between two instants of the wall clock."""

    begin_ns: int
    end_ns: int
    due: int  # cycles
    cpu_ns_per_cycle: float  # of the critical process
    cpu_all_ns_per_cycle: float  # of all its processes
    window_share: float | None  # of the time; None where there is no window
    over_budget_per_s: dict[str, float]  # by service: callbacks of this program that were longer than they may be
    steal_share: float  # of all processors, taken by other machines
    others_share: float  # of all processors, taken by programs that are no part of the benchmark
    feeder: dict[str, Any]
    served: dict[str, int]  # what the load's clients got


def run(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when everything was measured, however fast it was, and 1 where a service exceeds its budget."""
    plan, output = planned(asked), Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    groups = []
    with tempfile.TemporaryDirectory(prefix="delfim-bench-") as place, _Progress(plan) as progress:
        programs = build(Path(place))
        for rate_hz in plan.rates_hz:
            groups += _measure_rate(plan, rate_hz, asked, programs, progress)
    results = {"machine": _machine(), "plan": plan._asdict() | {"wire_us": asked.wire_us}, "groups": groups}
    (output / "critical-path.json").write_text(json.dumps(results, indent=1) + "\n")
    print(report.table(results))
    report.picture(results, output / "critical-path.png")
    print(f"\ndelfim: {output}/critical-path.json, {output}/critical-path.png")
    return 1 if any(report.over_budget(group) for group in groups) else 0


def planned(asked: argparse.Namespace) -> Plan:
    """The plan that the options ask for."""
    if asked.long:
        rates_hz, seconds = tuple(asked.rates or (100.0,)), asked.seconds or 60.0
        rounds = asked.rounds or -int(-LONG_CYCLES // (min(rates_hz) * seconds))
        return Plan(rates_hz, ("full load",), ("c", "delfim"), seconds, rounds)
    missing = {key for key, has in (("uvloop", _has_uvloop), ("realtime", _may_real_time)) if not has()}
    competitors = tuple(key for key in LABELS if key not in missing)
    rates_hz = tuple(asked.rates or RATES_HZ)
    seconds, rounds = asked.seconds or (1.0 if asked.quick else 5.0), asked.rounds or (1 if asked.quick else 4)
    return Plan(rates_hz, ("idle", "full load"), competitors, seconds, rounds)


def build(place: Path) -> dict[str, Path]:
    """The C programs, compiled on the spot. Raises DelfimError."""
    programs = {}
    for name in ("loop", "feeder"):
        source, programs[name] = SOURCES / f"{name}.c", place / name
        if not source.exists():
            raise DelfimError(f"{source} is missing: the benchmark runs from a checkout of the sources")
        command = ["cc", "-O2", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-o", str(programs[name]), str(source), "-lm"]
        compiled(command)
    return programs


def compiled(command: Sequence[str]) -> None:
    """Runs a compiler. Raises DelfimError where there is none, or with what it says."""
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except FileNotFoundError:
        raise DelfimError(f"the benchmark needs a compiler ({command[0]})") from None
    except subprocess.CalledProcessError as error:
        source = next(word for word in command if word.startswith(str(SOURCES)))
        raise DelfimError(f"{source} does not compile:\n{error.stderr}") from None


def _measure_rate(
    plan: Plan, rate_hz: float, asked: argparse.Namespace, programs: dict[str, Path], progress: "_Progress"
) -> list[dict[str, Any]]:
    """All slices of one rate, and their figures, one group for each load."""
    slices = defaultdict[tuple[str, str], list[Slice]](list)
    with contextlib.ExitStack() as links:
        place = Path(links.enter_context(tempfile.TemporaryDirectory(prefix="delfim-bench-")))
        teams = {}
        for key in plan.competitors:
            progress.say(f"{rate_hz:g} Hz: {LABELS[key]} starts")
            teams[key] = links.enter_context(Team(key, rate_hz, asked, programs, place / key))
        clients = links.enter_context(_process("-m", "bench.load", stdin=subprocess.PIPE, stdout=subprocess.PIPE))
        for number, load in itertools.product(range(plan.rounds), plan.loads):
            for key in plan.turns(load, number):
                progress.turn(f"{rate_hz:g} Hz, {load}, round {number + 1} of {plan.rounds}")
                slices[load, key].append(teams[key].turn(plan.seconds, clients if load != "idle" else None))
        for team in teams.values():
            team.end()
        logs = {key: team.cycles() for key, team in teams.items()}
    return [_group(rate_hz, load, {k: v for (of, k), v in slices.items() if of == load}, logs) for load in plan.loads]


def _group(rate_hz: float, load: str, slices: dict[str, list[Slice]], logs: dict[str, list[Cycle]]) -> dict[str, Any]:
    """The figures of one rate and load."""
    samples = {key: [_within(logs[key], each) for each in turns] for key, turns in slices.items()}
    factors = report.noise(list(itertools.chain(*samples["c"][::2])), list(itertools.chain(*samples["c"][1::2])))
    rows = []
    for key in (key for key in LABELS if key in slices):
        turns = slices[key]
        row = {
            "competitor": key,
            "label": LABELS[key],
            **report.figures(list(itertools.chain(*samples[key])), sum(each.due for each in turns)),
        }
        shares = [each.window_share for each in turns if each.window_share is not None]
        rows.append(
            row
            | {
                "cpu_us": round(_mean([each.cpu_ns_per_cycle for each in turns]) / 1e3, 1),
                "cpu_all_us": round(_mean([each.cpu_all_ns_per_cycle for each in turns]) / 1e3, 1),
                "window_share": round(_mean(shares), 4) if shares else None,
                "over_budget_per_s": {
                    name: round(_mean([each.over_budget_per_s[name] for each in turns]), 2)
                    for name in turns[0].over_budget_per_s
                },
                "served": {name: sum(each.served[name] for each in turns) for name in turns[0].served},
            }
        )
    everybody = [each for turns in slices.values() for each in turns]
    steal, others = _mean([each.steal_share for each in everybody]), _mean([each.others_share for each in everybody])
    return {
        "rate_hz": rate_hz,
        "load": load,
        "noise": factors,
        "steal_share": round(steal, 4),
        "others_share": round(others, 3),
        "late_us_max": max(each.feeder["late_us_max"] for each in everybody),
        "rows": [row | report.compared(row, rows[0], factors, steal + others) for row in rows],
    }


def _within(cycles: Sequence[Cycle], part: Slice) -> Sequence[Cycle]:
    """The cycles of a slice, out of all in their order."""
    first = bisect_left(cycles, part.begin_ns, key=lambda cycle: cycle.t0)
    return cycles[first : bisect_left(cycles, part.end_ns, key=lambda cycle: cycle.t0)]


class Team:
    """All processes of one competitor, on a bus of their own. They run during their turns only."""

    def __init__(self, key: str, rate_hz: float, asked: argparse.Namespace, programs: dict[str, Path], place: Path) -> None:
        self.key, self.rate_hz, self._place, self._feeder = key, rate_hz, place, str(programs["feeder"])
        place.mkdir(exist_ok=True)
        self._is_c = key in ("c", "realtime")
        self.socket, self._log = place / "command", place / ("c.state" if self._is_c else "log")
        interface = asked.bus or f"canloop:{key[:3]}-{os.getpid()}"  # no longer than the name of an interface may be
        self.interface = interface
        self._bus = "{}:{}".format(*group_of(interface.partition(":")[2])) if interface.startswith("canloop:") else interface
        self.ports = Ports(*free_ports(len(Ports._fields)))
        overrides = [*asked.set, *_overrides(interface, rate_hz, place, self.ports)]
        if key == "ordinary":
            overrides.append("runtime.fifo_priority=0")
        if key in MOTORS:
            sides = (("starboard", 0, 1.0), ("port", 1, -1.0))
            rows = (f'name="{name}", driver="{key}", address={address}, y_m={y_m}' for name, address, y_m in sides)
            overrides.append(f"thrusters=[{', '.join(f'{{{row}, thrust_n=[-300.0, 500.0], rpm_max=1200.0}}' for row in rows)}]")
            overrides.append(f'{key}.interface="canloop:{key[:3]}m-{os.getpid()}"')
        self._arguments = [asked.file, ",".join(map(str, self.ports))]
        self._arguments += [word for one in overrides for word in ("--set", one)]
        self.name = interface.rpartition(":")[2]  # as cantcpd has it
        prepare(place / "log")
        self._all = contextlib.ExitStack()
        self._processes: list[subprocess.Popen[bytes]] = []
        self._loop, self._wire_us, self._frames = str(programs["loop"]), asked.wire_us, asked.frames
        self.state: dict[str, Any] = {}  # what it said last of itself

    @property
    def warm_s(self) -> float:
        """Of each slice, not counted."""
        return max(WARM_S_MIN, WARM_PERIODS / self.rate_hz)

    def writers(self) -> list[int]:
        """The processes that write its logs."""
        pids = [pid for process in self._processes for pid in family(process.pid)]
        return [pid for pid in pids if b"delfim.logging.writer" in command_line(pid)]

    def go_on(self) -> None:
        """Run between two turns."""
        self._stop(signal.SIGCONT)

    def hold(self) -> None:
        """Stop again."""
        self._stop(signal.SIGSTOP)

    def __enter__(self) -> "Team":
        try:
            self._start()
            self._stop(signal.SIGSTOP)
        except BaseException:
            self._all.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def _start(self) -> None:
        if self._is_c:
            self._launch(*(REAL_TIME if self.key == "realtime" else ()), self._loop, self._bus, str(self._log))
        else:
            self._launch(*self._competitor("delfim" if self.key in ("ordinary", *MOTORS) else self.key))
        if self._is_c or self.key == "apart":
            self._launch(*self._competitor("services"))
        until(lambda: socket.create_connection(("127.0.0.1", self.ports.commands), timeout=1.0).close(), "its services")
        if not self._is_c:
            words = self._arguments[:1] + self._arguments[2:]
            self._launch(*IDLE, sys.executable, "-m", "delfim", "run", *words, "--service", "syslogd")
            self._steer()

    def _competitor(self, kind: str) -> list[str]:
        return [sys.executable, "-m", "bench.competitor", kind, *self._arguments]

    def _launch(self, *command: str) -> None:
        self._processes.append(self._all.enter_context(running(list(command), stdout=subprocess.DEVNULL)))

    def _steer(self) -> None:
        """Put the vehicle into heading mode, in which it stays: its watchdog is told to be patient."""
        with until(lambda: Link(self.socket), "its command socket") as link, self._feeding(START_S, 0.0, flood=False):
            until(lambda: link.ask("heading", heading_deg=90.0, speed_mps=1.5), "heading mode")

    def turn(
        self, seconds: float, clients: "subprocess.Popen[bytes] | None", *, watchers: int = 0, flood: bool | None = None
    ) -> Slice:
        """A slice: run, warm up, measure, stop. `clients` load the services where they are given, all of them or only so many
        watchers of the bus; the bus is full then, unless `flood` says otherwise."""
        self._stop(signal.SIGCONT)
        if clients is not None:
            _told(clients, " ".join(map(str, (*self.ports, self.name, watchers))))
        warm_s = self.warm_s
        with self._feeding(seconds, warm_s, flood=clients is not None if flood is None else flood) as feeder:
            time.sleep(warm_s)
            before = self._meters(clients)
            said = feeder.communicate(timeout=seconds + 10.0)[0]
            after = self._meters(clients)
        time.sleep(GRACE_S)  # for the last cycle
        if feeder.returncode:
            raise DelfimError(f"the feeder ended with {feeder.returncode}")
        served = json.loads(_told(clients, "")) if clients is not None else {}
        self._stop(signal.SIGSTOP)
        if not all(process.poll() is None for process in self._processes):
            raise DelfimError(f"{LABELS[self.key]} ended in the middle of the benchmark; what it said stands above")
        fed = json.loads(said)
        span_s = after["time"] - before["time"]
        cycles, spent = span_s * self.rate_hz, {name: after[name] - before[name] for name in after}
        told_s = spent["told"] or span_s
        cpus = os.cpu_count() or 1
        others_s = max(spent["busy"] - spent["ours"], 0.0)
        return Slice(
            fed["begin_ns"],
            fed["end_ns"],
            fed["messages"] - round(warm_s * self.rate_hz),
            spent["cpu"] / cycles,
            spent["all"] / cycles,
            spent["window"] / told_s if self.key in OURS else None,
            {name.removeprefix(OVER): count / told_s for name, count in spent.items() if name.startswith(OVER)},
            spent["steal"] / span_s / cpus,
            others_s / span_s / cpus,
            fed,
            served,
        )

    def _meters(self, clients: "subprocess.Popen[bytes] | None") -> dict[str, float]:
        """Meters that only go up, of the competitor and the machine: ns of processor time, otherwise seconds."""
        times = [cpu_ns(pid) for process in self._processes for pid in family(process.pid)]
        window_s, told_s, over = 0.0, 0.0, dict[str, float]()
        if self.key in OURS:
            with Link(self.socket, START_S) as link:
                state = link.ask("state")
            window_s, told_s, self.state = state["window"]["spent_s"], state["figures_s"], state
            over = {OVER + name: service["over_budget"] for name, service in state["services"].items()}
        busy_s, steal_s = _processors_s()
        feeders = resource.getrusage(resource.RUSAGE_CHILDREN)
        ours_ns = sum(times) + time.process_time_ns() + (cpu_ns(clients.pid) if clients else 0)
        return {
            "time": time.monotonic(),
            "cpu": times[0],
            "all": sum(times),
            "window": window_s,
            "told": told_s,
            "busy": busy_s,
            "steal": steal_s,
            "ours": ours_ns / 1e9 + feeders.ru_utime + feeders.ru_stime,
            **over,
        }

    @contextlib.contextmanager
    def _feeding(self, seconds: float, warm_s: float, *, flood: bool) -> Iterator[subprocess.Popen[bytes]]:
        words = self.rate_hz, warm_s, seconds, self._frames if flood else 0, self._wire_us
        with running([*ELSEWHERE, self._feeder, self._bus, *map(str, words)], stdout=subprocess.PIPE) as feeder:
            yield feeder

    def _stop(self, number: signal.Signals) -> None:
        """Stop or continue all processes, those that hang on the competitor's pipes included."""
        for process in self._processes:
            for pid in family(process.pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)

    def end(self) -> None:
        """End all processes in order, so that their logs are complete."""
        if self._processes:
            self._stop(signal.SIGCONT)
            self._processes = []
        self._all.close()

    def cycles(self) -> list[Cycle]:
        """All cycles that the log holds."""
        files = [self._log] if self._is_c else list(self._log.glob("*/state/*.state*"))
        data = columns(files)
        if not data:
            raise DelfimError(f"{LABELS[self.key]} left no log")
        t5 = [*data["previous_t5"][1:], data["t4"][-1]]
        return [Cycle(*stamps) for stamps in zip(*(data[f"t{i}"] for i in range(5)), t5, strict=True)]


_PATIENT: Final = (
    "navigation_silent",
    "navigation_frozen",
    "console_silent",
    "thruster",
)  # the feeder's propellers stand still


def _overrides(interface: str, rate_hz: float, place: Path, ports: Ports) -> list[str]:
    """What differs from the vehicle's file: bus and places, and the patience to be stopped between two turns."""
    return [
        f'can.interface="{interface}"',
        f"navigation.rate_hz={rate_hz}",
        f'console.socket="{place}/command"',
        f'log.directory="{place}/log"',
        f'runtime.run_directory="{place}"',
        'supervisor.hardware_watchdog=""',
        'guest.listen="127.0.0.1:0"',
        f'mavlink.listen="127.0.0.1:{ports.mavlink}"',
        "mavlink.peers=[]",
        f'cantcpd.listen=["127.0.0.1:{ports.cantcpd}"]',
        f'httpd.listen="127.0.0.1:{ports.httpd}"',
        *(f"failsafe.{key}.after_s=3600.0" for key in _PATIENT),
        "sysstat.stale_s=3600.0",
    ]


@contextlib.contextmanager
def running(command: Sequence[str], **pipes: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A child, ended however this ends. It finds this package, wherever it was started."""
    child = subprocess.Popen(command, env=os.environ | {"PYTHONPATH": str(SOURCES.parent)}, **pipes)
    try:
        yield child
    finally:
        if child.poll() is None:
            child.send_signal(signal.SIGTERM)
            try:
                child.wait(END_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                pipe.close()


def _process(*arguments: str, **pipes: Any) -> contextlib.AbstractContextManager[subprocess.Popen[bytes]]:
    return running([*ASHORE, sys.executable, *arguments], **pipes)


def _told(child: subprocess.Popen[bytes], line: str) -> bytes:
    """A line to the clients, and their answer."""
    assert child.stdin is not None
    assert child.stdout is not None
    child.stdin.write(line.encode() + b"\n")
    child.stdin.flush()
    answer = child.stdout.readline()
    if not answer:
        raise DelfimError("the clients of the load ended; what they said stands above")
    return answer


def until(attempt: Any, what: str) -> Any:
    """What `attempt` returns as soon as it does not fail. Raises DelfimError when it still does after START_S."""
    until_s = time.monotonic() + START_S
    while True:
        try:
            return attempt()
        except (Refused, DelfimError, OSError) as error:
            if time.monotonic() > until_s:
                raise DelfimError(f"a competitor did not get ready: {what}: {error}") from None
            time.sleep(0.02)


def free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as links:
        sockets = [links.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]


def family(pid: int) -> list[int]:
    """A process and all its descendants."""
    try:
        children = [
            int(word) for task in Path(f"/proc/{pid}/task").iterdir() for word in (task / "children").read_text().split()
        ]
    except OSError:
        return [pid]
    return [pid, *(one for child in children for one in family(child))]


def command_line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def cpu_ns(pid: int) -> int:
    """Processor time of a process, its ended threads included: the CPU-time clock of clock_getcpuclockid(3)."""
    try:
        return time.clock_gettime_ns(~pid << 3 | 2)
    except OSError:
        return 0


def _processors_s() -> tuple[float, float]:
    """How long all processors together worked, and how long the hypervisor took them away, since boot."""
    user, nice, system, _, _, irq, softirq, steal, *_ = map(int, Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:])
    tick_s = 1.0 / os.sysconf("SC_CLK_TCK")
    return (user + nice + system + irq + softirq) * tick_s, steal * tick_s


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else 0.0


def _may_real_time() -> bool:
    return subprocess.run([*REAL_TIME, "true"], capture_output=True).returncode == 0


def _has_uvloop() -> bool:
    from importlib.util import find_spec

    return find_spec("uvloop") is not None


def _machine() -> dict[str, object]:
    models = [line.partition(":")[2].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line]
    return {
        "processors": os.cpu_count(),
        "model": models[0] if models else platform.machine(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "compiler": subprocess.run(["cc", "--version"], capture_output=True, text=True, check=True).stdout.split("\n")[0],
        "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


class _Progress:
    """How far the benchmark is, on standard error: one line that changes, or one a round where that is no terminal."""

    def __init__(self, plan: Plan) -> None:
        warm_s = _mean([max(WARM_S_MIN, WARM_PERIODS / rate_hz) for rate_hz in plan.rates_hz])
        self._left, self._slice_s, self._said = plan.slices(), plan.seconds + warm_s + 0.1, ""
        self._terminal = sys.stderr.isatty()

    def turn(self, text: str) -> None:
        self.say(f"{text}; about {self._left * self._slice_s / 60:.0f} min left", text)
        self._left -= 1

    def say(self, line: str, key: str = "") -> None:
        if self._terminal:
            width = shutil.get_terminal_size().columns - 1
            print(f"\r\x1b[K{line[:width]}", end="", file=sys.stderr, flush=True)
        elif key and key != self._said:
            self._said = key
            print(f"delfim: {line}", file=sys.stderr, flush=True)

    def __enter__(self) -> "_Progress":
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
