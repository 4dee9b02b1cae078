"""`python -m bench peers`: Delfim, MOOS-IvP and DUNE, each with its whole suite, its own simulator and log, in turns.

MOOS-IvP is found by its `MOOSDB` in PATH, as its users have it; a C++ compiler must be there, too. DUNE is in
`bench/dune.py`. A turn starts a suite, lets it sail for some seconds, and kills its controller; then it looks how long
navigation takes to become an order to the motors: of Delfim from bus to bus, by the kernel's stamps, of MOOS-IvP from the
message that the boat is on the other side of its line to the first rudder that way. What is compared, and what is not fair
about it: docs/benchmark.md
"""

import argparse
import contextlib
import json
import os
import shutil
import signal
import statistics
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Final

from bench.critical_path import SOURCES, command_line, compiled, family, free_ports, running, until
from bench.dune import dune
from bench.onlooker import Onlooker
from bench.report import percentile
from bench.soak import Boat
from bench.turn import START_S, WATCH_S, Peer, Turn, spent
from delfim.base.errors import DelfimError
from delfim.canproxy.dsor import messages
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.vehicle.operator.link import Link

SECONDS: Final = 20.0  # of a turn under way
ROUNDS: Final = 3
TURNS: Final = 20  # of the boat beside its line, MOOS-IvP
PROGRAMS: Final = ("pLogger", "uSimMarineV22", "pMarinePIDV22", "pHelmIvP", "uProcessWatch", "pNodeReporter")
RATES_HZ: Final = {"as its examples have it": (5, 4, 20), "as fast as it goes": (100, 50, 100)}  # navigation, helm, controller


def run(asked: argparse.Namespace) -> int:
    """The command."""
    seconds, rounds = asked.seconds or SECONDS, asked.rounds or ROUNDS
    results = dict[str, list[Turn]]()
    with tempfile.TemporaryDirectory(prefix="delfim-bench-") as name:
        place = Path(name)
        others: dict[str, list[Peer]] = {"MOOS-IvP": [*moos(place)], "DUNE": [*dune(place)]}
        for name, found in others.items():
            if not found:
                print(f"{name} is not built here: its programs are not in PATH")
        peers: list[Peer] = [Delfim(asked, place), *chain.from_iterable(others.values())]
        Path(asked.output).mkdir(parents=True, exist_ok=True)
        file = Path(asked.output) / "peers.json"
        for number in range(rounds):
            for peer in peers if number % 2 == 0 else reversed(peers):
                print(f"round {number + 1} of {rounds}: {peer.label}", flush=True)
                results.setdefault(peer.label, []).append(peer.turn(seconds))
                kept = {label: [each._asdict() for each in turns] for label, turns in results.items()}
                file.write_text(json.dumps(kept, indent=1) + "\n")  # a turn takes a minute, and a later one may fail
    print(table(results), f"\ndelfim: {file}", sep="\n")
    return 0


class Delfim:
    """The suite as shipped, its nodes beside it; the boat goes to a place far ahead."""

    label = "Delfim"

    def __init__(self, asked: argparse.Namespace, place: Path) -> None:
        self._asked, self._place, self._count = asked, place, 0

    def turn(self, seconds: float) -> Turn:
        self._count += 1
        place = self._place / f"delfim-{self._count}"
        place.mkdir()
        boat = Underway(self._asked, place)
        with open_can(f"canloop:{boat.bus}") as bus:
            bus.bind(CanAddress(messages.PROPELLER_STARBOARD))
            bus.settimeout(START_S)
            began_ns = time.time_ns()
            with boat:
                start_s = (_ordered(bus, thrust=True) - began_ns) / 1e9
                with Onlooker(f"canloop:{boat.bus}") as look:
                    begin_ns = time.time_ns()
                    processor, memory_bytes = spent(boat.pids, seconds)
                    paths_us = look.paths_us(begin_ns, time.time_ns())
                stopped_s = self._killed(boat, bus)
        return Turn(start_s, processor, memory_bytes, stopped_s, paths_us)

    def _killed(self, boat: "Underway", bus: CanSocket) -> float | None:
        killed_ns = time.time_ns()
        os.kill(int(boat.programs()["runtime"]["pid"]), signal.SIGKILL)
        with contextlib.suppress(TimeoutError):
            return (_ordered(bus, thrust=False, since_ns=killed_ns) - killed_ns) / 1e9
        return None


class Underway(Boat):
    """A suite that sails to a place a kilometre ahead, as soon as it obeys."""

    def _begin(self, link: Link) -> None:
        until(lambda: link.ask("goto", latitude_deg=38.70, longitude_deg=-9.20), "goto")

    def pids(self) -> list[int]:
        return [each for process in self.started for each in family(process.pid)]


def _ordered(bus: CanSocket, *, thrust: bool, since_ns: int = 0) -> int:
    """When the bus carried the first order to the starboard propeller to turn, or to stop, ns. Raises TimeoutError."""
    while True:
        frame = bus.recvmsg()
        if frame.t_ns >= since_ns and messages.unpack_propeller_command(frame.data).run == thrust:
            return int(frame.t_ns)


def moos(place: Path) -> Iterator[Peer]:
    """MOOS-IvP at each of its rates; nothing where it is not built. Raises DelfimError."""
    if (found := shutil.which("MOOSDB")) is None:
        return
    absent = [each for each in ("pAntler", *PROGRAMS) if not shutil.which(each)]
    if absent:
        raise DelfimError(f"MOOS-IvP lacks {', '.join(absent)} in PATH")
    probe = probed(Path(found).resolve().parents[1], place)
    for label in RATES_HZ:
        yield Moos(label, probe, place)


def probed(root: Path, place: Path) -> Path:
    """The probe, with the library of that checkout. Raises DelfimError."""
    library = next(root.rglob("libMOOS.a"), None)
    sources = root / "MOOS/MOOSCore/Core/libMOOS"
    if library is None or not sources.is_dir():
        raise DelfimError(
            f"{root} has no libMOOS.a, or not its headers: the benchmark needs the checkout in which MOOS-IvP was built"
        )
    headers = [f"-I{each}" for each in sources.resolve().rglob("include") if each.is_dir()]
    probe = place / "moosprobe"
    words = ["-O2", "-std=c++14", *headers, "-o", str(probe), str(SOURCES / "moosprobe.cpp"), str(library), "-lpthread"]
    compiled(["c++", *words])
    return probe


class Moos:
    """A community that sails its simulated boat along a line."""

    def __init__(self, rates: str, probe: Path, place: Path) -> None:
        self.label, self._rates, self._probe, self._place = f"MOOS-IvP, {rates}", RATES_HZ[rates], probe, place

    def turn(self, seconds: float) -> Turn:
        began_ns = time.time_ns()
        with contextlib.ExitStack() as ended:
            antler, port = ended.enter_context(self._community(PROGRAMS))
            orders = Orders(
                ended.enter_context(running([str(self._probe), str(port)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL))
            )
            start_s = (orders.first(lambda thrust: thrust > 0.0, began_ns, START_S) - began_ns) / 1e9
            processor, memory_bytes = spent(lambda: family(antler.pid), seconds)
            killed_ns = time.time_ns()
            for pid in family(antler.pid):
                if b"pMarinePIDV22" in command_line(pid):
                    os.kill(pid, signal.SIGKILL)
            stopped_s = None
            with contextlib.suppress(TimeoutError):
                stopped_s = (orders.first(lambda thrust: thrust == 0.0, killed_ns, WATCH_S) - killed_ns) / 1e9
        return Turn(start_s, processor, memory_bytes, stopped_s, self._latency())

    def _latency(self) -> list[float]:
        """With navigation played by the probe."""
        with self._community([each for each in PROGRAMS if each != "uSimMarineV22"]) as (_, port):
            words = [str(self._probe), str(port), str(self._rates[0]), str(TURNS)]
            told = subprocess.run(words, check=True, capture_output=True, text=True, timeout=10 * START_S).stdout
        return sorted(us for us in map(float, told.split()) if us >= 0.0)

    @contextlib.contextmanager
    def _community(self, programs: Sequence[str]) -> Iterator[tuple["subprocess.Popen[bytes]", int]]:
        with tempfile.TemporaryDirectory(dir=self._place) as name:
            (port,) = free_ports(1)
            mission = Path(name) / "line.moos"
            mission.write_text(self._mission(port, programs))
            (Path(name) / "line.bhv").write_text(LINE)
            with (
                (Path(name) / "said").open("w") as said,
                running([shutil.which("pAntler") or "", str(mission)], stdout=said, stderr=said, cwd=name) as antler,
            ):
                try:
                    yield antler, port
                finally:
                    for pid in reversed(family(antler.pid)):
                        with contextlib.suppress(ProcessLookupError):
                            os.kill(pid, signal.SIGKILL)  # its logger outlives a request to end

    def _mission(self, port: int, programs: Sequence[str]) -> str:
        navigation, helm, controller = self._rates
        rates = {"uSimMarineV22": navigation, "pHelmIvP": helm, "pMarinePIDV22": controller}
        run = "".join(f"Run = {each} @ NewConsole = false\n" for each in ("MOOSDB", *programs))
        blocks = "".join(
            f"ProcessConfig = {each}\n{{\nAppTick = {(hz := rates.get(each, 4))}\nCommsTick = {hz}\n{SETTINGS[each]}}}\n"
            for each in programs
        )
        return f"{COMMUNITY}ServerPort = {port}\nProcessConfig = ANTLER\n{{\nMSBetweenLaunches = 200\n{run}}}\n{blocks}"


COMMUNITY: Final = "ServerHost = localhost\nCommunity = peers\nMOOSTimeWarp = 1\nLatOrigin = 38.69\nLongOrigin = -9.21\n"
SETTINGS: Final = {
    "pLogger": "AsyncLog = true\nWildCardLogging = true\n",
    "uSimMarineV22": "start_pos = x=0, y=0, heading=0, speed=0\nprefix = NAV\nturn_rate = 95\nthrust_map = 0:0, 100:5\n",
    "pMarinePIDV22": (
        "depth_control = false\nyaw_pid_kp = 0.9\nyaw_pid_kd = 0.3\nyaw_pid_ki = 0.3\nyaw_pid_integral_limit = 0.07\n"
        "speed_pid_kp = 1.0\nspeed_pid_kd = 0.0\nspeed_pid_ki = 0.0\nspeed_pid_integral_limit = 0.07\n"
        "maxrudder = 100\nmaxthrust = 100\nspeed_factor = 20\n"
    ),
    "pHelmIvP": "behaviors = line.bhv\ndomain = course:0:359:360\ndomain = speed:0:4:41\n",
    "uProcessWatch": "watch_all = true\n",
    "pNodeReporter": "platform_type = kayak\nplatform_length = 4\n",
}
LINE: Final = """initialize DEPLOY = false
Behavior = BHV_Waypoint
{
name = line
pwt = 100
condition = DEPLOY = true
speed = 1.5
capture_radius = 5
lead = 8
lead_to_start = true
points = 0,1 : 0,9000
}
"""


class Orders:
    """What a probe says of the controller's thrust, as it comes."""

    def __init__(self, probe: "subprocess.Popen[bytes]") -> None:
        self._said: list[tuple[float, int]] = []
        self._new = threading.Condition()
        threading.Thread(target=self._listen, args=(probe,), daemon=True).start()

    def _listen(self, probe: "subprocess.Popen[bytes]") -> None:
        assert probe.stdout is not None
        with contextlib.suppress(ValueError, OSError):  # closed at the end
            for line in probe.stdout:
                thrust, at_ns = line.split()
                with self._new:
                    self._said.append((float(thrust), int(at_ns)))
                    self._new.notify_all()

    def first(self, wanted: Callable[[float], bool], since_ns: int, within_s: float) -> int:
        """When the first such order was heard, ns. Raises TimeoutError."""

        def found() -> int | None:
            return next((at_ns for thrust, at_ns in self._said if at_ns >= since_ns and wanted(thrust)), None)

        with self._new:
            at_ns = self._new.wait_for(found, within_s)
        if at_ns is None:
            raise TimeoutError("no such order was heard")
        return at_ns


def table(results: dict[str, list[Turn]]) -> str:
    """Medians of the turns; of the latencies of all turns together the median and the 99th of 100."""
    head = f"{'':38}{'start s':>9}{'processor':>11}{'PSS MB':>8}{'stopped s':>11}{'p50 ms':>9}{'p99 ms':>9}{'cycles':>8}"
    lines = [head]
    for label, turns in results.items():
        stops = [each.stopped_s for each in turns if each.stopped_s is not None]
        stopped = f"{statistics.median(stops):.2f}" if len(stops) == len(turns) else f"never: {len(turns) - len(stops)}"
        us = sorted(us for each in turns for us in each.latency_us)
        ms = [f"{value / 1e3:.3f}" if (value := percentile(us, part)) is not None else "-" for part in (0.5, 0.99)]
        middle = [statistics.median(getattr(each, name) for each in turns) for name in ("start_s", "processor", "memory_bytes")]
        lines.append(
            f"{label:38}{middle[0]:9.1f}{middle[1]:11.1%}{middle[2] / 1e6:8.0f}{stopped:>11}{ms[0]:>9}{ms[1]:>9}{len(us):8}"
        )
    return "\n".join(lines)
