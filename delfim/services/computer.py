"""Samples the computer again and again: processors, memory, disk, networks, CAN controllers, processes, clock.

`python -m delfim.services.computer LOG-DIRECTORY FREE-BYTES-MIN RUN-DIRECTORY SECONDS` is a niced child of httpd: looking at
all processes takes milliseconds that a cooperative service does not have. It writes one JSON object a line, a `Computer`,
and ends with its standard input. Linux only.
"""

import fcntl
import json
import os
import select
import socket
import struct
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import msgspec

from delfim.base.errors import FormatError
from delfim.base.input.untrusted import parse_json
from delfim.services.clock.kernel import KernelClock
from delfim.services.page.api import Bus, Computer, Disk, Memory, Network, Process, Time
from delfim.services.page.saidlines import last_lines
from delfim.services.supervision.processes import PAGE_BYTES, TICKS_PER_S
from delfim.vehicle.report import Service

PROCESSES: Final = 15  # shown
LINES: Final = 10  # of the system log
TREND_S: Final = 600.0  # the disk's rate is a mean over so long ...
TREND_MIN_S: Final = 30.0  # ... and not told before so long
NICE: Final = 10
FRAME_OVERHEAD_BITS: Final = 47 + 10  # of a standard CAN frame, and its usual stuff bits
_SIOCGIFADDR: Final = 0x8915
_NAME: Final = struct.Struct("16s24x")


class ComputerLook:
    """The counters of the last sample, for the next one: rates are differences."""

    def __init__(self, directory: str, free_bytes_min: int, run_directory: str, root: Path = Path("/")) -> None:
        self._directory, self._free_bytes_min = directory, free_bytes_min
        self._supervisor = Path(run_directory) / "supervisor.json"
        self._root = root
        self._at_s = 0.0
        self._cpu: list[tuple[int, int]] = []
        self._ticks: dict[int, int] = {}
        self._bytes: dict[str, tuple[int, int]] = {}
        self._frames: dict[str, tuple[int, int]] = {}
        self._free: deque[tuple[float, int]] = deque()

    def look(self, now_s: float, time_ns: int) -> Computer:
        """Take one sample, `now_s` by the monotonic clock. A value that cannot be read has its default."""
        elapsed_s = max(now_s - self._at_s, 1e-3)
        self._at_s = now_s
        processes = self._processes(elapsed_s)
        supervisor, deadman = programs(_read(self._supervisor), now_s)
        resident = {each.pid: each.memory_bytes for each in processes}
        for name, each in supervisor.items():
            told = service(each, _read(self._supervisor.with_name(f"service-{name}.json")))
            supervisor[name] = msgspec.structs.replace(told, memory_bytes=resident.get(each.pid, 0))
        return Computer(
            uptime_s=float((_read(self._root / "proc/uptime").split() or ["0"])[0]),
            cpu=self._processors(),
            load=tuple(float(each) for each in _read(self._root / "proc/loadavg").split()[:3]),
            memory=memory(_read(self._root / "proc/meminfo")),
            temperature_c=temperature_c(self._root),
            disk=self._disk(now_s),
            networks=self._networks(elapsed_s),
            buses=self._buses(_links(self._root), elapsed_s),
            processes=tuple(processes[:PROCESSES]),
            process_count=len(processes),
            time=clock(time_ns),
            supervisor=supervisor,
            deadman=deadman,
            log=last_lines(str(self._supervisor.parent), LINES),
        )

    def _processors(self) -> tuple[float, ...]:
        before, self._cpu = self._cpu, processors(_read(self._root / "proc/stat"))
        if len(before) != len(self._cpu):
            before = [(0, 0)] * len(self._cpu)
        pairs = zip(before, self._cpu, strict=True)
        return tuple(round((busy - was_busy) / max(total - was_total, 1), 3) for (was_busy, was_total), (busy, total) in pairs)

    def _disk(self, now_s: float) -> Disk | None:
        try:
            disk = os.statvfs(self._directory)
        except OSError:
            return None
        free_bytes = disk.f_bavail * disk.f_frsize
        self._free.append((now_s, free_bytes))
        while now_s - self._free[0][0] > TREND_S:
            self._free.popleft()
        began_s, began_bytes = self._free[0]
        full_in_s = None
        if now_s - began_s >= TREND_MIN_S and began_bytes > free_bytes:
            left = max(free_bytes - self._free_bytes_min, 0)
            full_in_s = left * (now_s - began_s) / (began_bytes - free_bytes)
        return Disk(path=self._directory, total_bytes=disk.f_blocks * disk.f_frsize, free_bytes=free_bytes, full_in_s=full_in_s)

    def _networks(self, elapsed_s: float) -> dict[str, Network]:
        found, now = {}, {}
        for name, counters in networks(_read(self._root / "proc/net/dev")).items():
            link = self._root / "sys/class/net" / name
            if _read(link / "type").strip() == "280":
                continue  # a CAN interface
            received, sent = now[name] = counters[0], counters[8]
            was_received, was_sent = self._bytes.get(name, (received, sent))
            found[name] = Network(
                up=_is_up(link),
                addresses=tuple(_addresses(name)),
                received_bytes=received,
                sent_bytes=sent,
                received_bps=round(max(received - was_received, 0) * 8 / elapsed_s),
                sent_bps=round(max(sent - was_sent, 0) * 8 / elapsed_s),
                errors=counters[2] + counters[10],
                dropped=counters[3] + counters[11],
            )
        self._bytes = now
        return found

    def _buses(self, links: Iterable[dict[str, Any]], elapsed_s: float) -> dict[str, Bus]:
        found, now = {}, {}
        for link in links:
            name, bus, bits = can_bus(link)
            now[name] = bus.frames, bits
            frames, was_bits = self._frames.get(name, now[name])
            found[name] = msgspec.structs.replace(
                bus,
                frames_per_s=round(max(bus.frames - frames, 0) / elapsed_s, 1),
                load=round(max(bits - was_bits, 0) / elapsed_s / bus.bitrate_bps, 3) if bus.bitrate_bps else None,
            )
        self._frames = now
        return found

    def _processes(self, elapsed_s: float) -> list[Process]:
        """All processes, the busiest first."""
        found, now = [], {}
        for entry in os.listdir(self._root / "proc"):
            if entry.isdecimal() and (line := _read(self._root / "proc" / entry / "stat")):
                pid, name, ticks, nice, threads, memory_bytes = process(line)
                now[pid] = ticks
                cpu = (ticks - self._ticks.get(pid, ticks)) / TICKS_PER_S / elapsed_s
                name = program(name, _read(self._root / "proc" / entry / "cmdline").split("\0"))
                each = Process(pid=pid, name=name, nice=nice, cpu=round(cpu, 3), memory_bytes=memory_bytes, threads=threads)
                found.append(each)
        self._ticks = now
        return sorted(found, key=lambda each: (-each.cpu, -each.memory_bytes))


def processors(stat: str) -> list[tuple[int, int]]:
    """(busy, total) ticks of each processor, from /proc/stat."""
    rows = [list(map(int, line.split()[1:9])) for line in stat.splitlines() if line.startswith("cpu") and line[3] != " "]
    return [(sum(row) - row[3] - row[4], sum(row)) for row in rows]


def memory(meminfo: str) -> Memory:
    """The use of the memory, from /proc/meminfo."""
    rows = {name: int(value.split()[0]) * 1024 for name, _, value in (line.partition(":") for line in meminfo.splitlines())}
    return Memory(total_bytes=rows.get("MemTotal", 0), available_bytes=rows.get("MemAvailable", 0))


def networks(dev: str) -> dict[str, list[int]]:
    """The 16 counters of each interface, from /proc/net/dev."""
    rows = (line.partition(":") for line in dev.splitlines() if ":" in line)
    return {name.strip(): list(map(int, counters.split())) for name, _, counters in rows}


def process(stat: str) -> tuple[int, str, int, int, int, int]:
    """(pid, name, ticks, nice, threads, resident bytes) from /proc/PID/stat. The name may hold anything, parentheses too."""
    pid, _, rest = stat.partition(" (")
    name, _, numbers = rest.rpartition(") ")
    field = numbers.split()  # the third field of proc(5) is field[0]
    return int(pid), name, int(field[11]) + int(field[12]), int(field[16]), int(field[17]), int(field[21]) * PAGE_BYTES


def program(name: str, words: list[str]) -> str:
    """The name of a process; of a Python program its own, not the interpreter's: its module or file, of delfim also the command
    and the service. Other arguments, and a program that stands in the command itself, may be long and secret."""
    if not name.startswith("python"):
        return name
    what = next((number for number, word in enumerate(words[1:], 1) if word in ("-c", "-m") or word[:1] != "-"), len(words))
    rest = [*words[what:], "", ""]
    if rest[0] == "-c":
        return f"{name} -c"
    shown, rest = (rest[1], rest[2:]) if rest[0] == "-m" else (os.path.basename(rest[0]), rest[1:])
    if shown != "delfim":
        return shown or name
    service = rest[rest.index("--service") + 1] if "--service" in rest[:-1] else ""
    return f"delfim {rest[0]} {service}".strip()


def temperature_c(root: Path) -> float | None:
    """The temperature of the hottest thermal zone, degrees Celsius; None where there is none."""
    texts = (_read(zone / "temp").strip() for zone in (root / "sys/class/thermal").glob("thermal_zone*"))
    return max((int(text) / 1000 for text in texts if text.lstrip("-").isdecimal()), default=None)


def can_bus(link: dict[str, Any]) -> tuple[str, Bus, int]:
    """Name, counters, and bits seen so far of an interface from `ip -d -s -j link`. Sent frames count, too."""
    details, counters = link.get("linkinfo", {}), link.get("stats64", {})
    data, errors = details.get("info_data", {}), details.get("info_xstats", {})
    received, sent = counters.get("rx", {}), counters.get("tx", {})
    frames = received.get("packets", 0) + sent.get("packets", 0)
    berr = data.get("berr_counter", {})
    bus = Bus(
        state=str(data.get("state", link.get("operstate", ""))).lower().replace("-", " "),
        bitrate_bps=data.get("bittiming", {}).get("bitrate", 0),
        frames=frames,
        dropped=received.get("dropped", 0) + sent.get("dropped", 0),
        errors=received.get("errors", 0) + sent.get("errors", 0) + errors.get("bus_error", 0),
        bus_off=errors.get("bus_off", 0),
        transmit_errors=berr.get("tx"),
        receive_errors=berr.get("rx"),
    )
    return (
        str(link.get("ifname", "can")),
        bus,
        8 * (received.get("bytes", 0) + sent.get("bytes", 0)) + frames * FRAME_OVERHEAD_BITS,
    )


def programs(state: str, now_s: float) -> tuple[dict[str, Service], str]:
    """The supervisor's processes, and its dead-man's last event in words, from its state file; `now_s` is
    monotonic, as its times are."""
    try:
        tree = parse_json(state)
        found = {
            name: Service(
                state=each["state"],
                restarts=each["restarts"],
                reason=each["reason"],
                pid=each["pid"],
                for_s=round(max(now_s - each["since_s"], 0.0), 1),
            )
            for name, each in tree["programs"].items()
        }
        event = tree["deadman"]
        return found, f"{event['reason']}, {max(now_s - event['at_s'], 0.0):.0f} s ago" if event else ""
    except (FormatError, KeyError, TypeError, AttributeError):
        return {}, ""


def service(process: Service, told: str) -> Service:
    """The supervisor's data of a process, with its service's own report if that comes from the process."""
    try:
        own = msgspec.json.decode(told, type=Service)
    except msgspec.DecodeError:
        return process
    if process.pid not in (own.pid, 0):
        return process
    reason = own.reason if own.reason and not process.reason.endswith("answer") else process.reason
    if process.state != "running":
        return msgspec.structs.replace(process, reason=reason)
    return msgspec.structs.replace(own, restarts=process.restarts + own.restarts, reason=reason or process.reason)


def clock(time_ns: int) -> Time:
    """The kernel's data of its own clock; nothing is set."""
    try:
        state = KernelClock().read()
    except OSError:
        return Time(utc_ns=time_ns)
    synchronised = state.synchronised
    return Time(utc_ns=time_ns, synchronised=synchronised, error_s=state.maxerror / 1e6 if synchronised else None)


def _is_up(link: Path) -> bool:
    """Whether an interface is up. Loopback and tunnels have no other word for it than "unknown"."""
    flags = _read(link / "flags").strip()
    return bool(flags) and bool(int(flags, 16) & 1) and _read(link / "operstate").strip() in ("up", "unknown")


def _addresses(name: str) -> list[str]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        try:
            found = fcntl.ioctl(any_socket, _SIOCGIFADDR, _NAME.pack(name.encode()[:15]))
        except OSError:
            return []
    return [socket.inet_ntoa(found[20:24])]


def _links(root: Path) -> list[dict[str, Any]]:
    """The CAN interfaces, from iproute2; none if there are none or no iproute2."""
    types = (root / "sys/class/net").glob("*/type")
    if not any(_read(each).strip() == "280" for each in types):
        return []
    try:
        told = subprocess.run(["ip", "-d", "-s", "-j", "link", "show"], capture_output=True, timeout=2.0, check=True).stdout
        return [link for link in json.loads(told) if link.get("link_type") == "can"]
    except (OSError, subprocess.SubprocessError, ValueError):
        return []


def _read(path: Path) -> str:
    """Read a small file; empty where there is none: processes and interfaces come and go."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def main(directory: str, free_bytes_min: str, run_directory: str, seconds: str) -> None:
    os.nice(NICE)
    look, encode = ComputerLook(directory, int(free_bytes_min), run_directory), msgspec.json.encode
    pause_s = 0.5  # the first rates soon
    while True:
        os.write(sys.stdout.fileno(), encode(look.look(time.monotonic(), time.time_ns())) + b"\n")
        if select.select([sys.stdin], [], [], pause_s)[0]:
            return
        pause_s = float(seconds)


if __name__ == "__main__":
    main(*sys.argv[1:])
