"""`python -m bench log`: figure 2-8 of the thesis on this machine, and beside it what a log call of ours costs the loop.

The figure's ways of getting rid of a record, one write after the other: a pipe, a UNIX socket, a file, a UDP socket, a buffered
file, deflate, and a file with O_SYNC. Ours come paced, as in a control loop: back to back everything is in the caches and
nothing shows. Last, the black box at the rate of a full bus, and how long it takes to list the logs of a year.
"""

import argparse
import calendar
import contextlib
import json
import os
import random
import socket
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, get_args

from bench.critical_path import cpu_ns, family
from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.errors import DelfimError
from delfim.base.frames import extended
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import BATCH
from delfim.logging.ashore.plot import INK, LINE, SEA
from delfim.logging.liblog import Method
from delfim.logging.openlog import open_log
from delfim.logging.reading import read_log

WRITES, QUICK_WRITES = 100_000, 2_000
RECORD_BYTES, RECORDS_PER_S = 250, 500
FRAMES_PER_S = 7_700
SECONDS, QUICK_SECONDS = 10.0, 2.0
DAYS, FILES_A_DAY = 209, 24  # at sea, in a year; files of each log: 10,032 of them
PARTS: Final = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999, "worst": 1.0}
DRAIN: Final = "import socket, sys; s = socket.socket(fileno=int(sys.argv[1]))\nwhile s.recv(65536): pass"

Write = Callable[[bytes], object]


def run(asked: argparse.Namespace) -> int:
    """The command. Returns 0 when it was measured, whatever came out."""
    output = Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    writes = QUICK_WRITES if asked.quick else WRITES
    seconds = asked.seconds or (QUICK_SECONDS if asked.quick else SECONDS)
    with tempfile.TemporaryDirectory(dir=output) as place:
        times = {name: figure_us(way, Path(place) / f"{i}", writes) for i, (name, way) in enumerate(WAYS.items())}
        times["os.write, paced"] = bare_us(Path(place) / "bare", seconds)
        times |= {f"liblog {method}, paced": put_us(Path(place), method, seconds) for method in get_args(Method)}
        box = black_box(asked.file, Path(place) / "box", seconds)
        files, listing_s = year(Path(place) / "year"), listed_s(Path(place) / "year")
    told = {name: {part: round(_part(each, share), 2) for part, share in PARTS.items()} for name, each in times.items()}
    (output / "log.json").write_text(
        json.dumps({"writes": writes, "us": told, "black_box": box, "ls_s": listing_s}, indent=1) + "\n"
    )
    picture(times, output / "log.png")
    print(f"{'one record of 250 bytes, us':28}" + "".join(f"{part:>10}" for part in PARTS))
    for name, figures in told.items():
        print(f"{name:28}" + "".join(f"{figure:10.1f}" for figure in figures.values()))
    print(
        f"canzlogd, {FRAMES_PER_S} frames a second for {seconds:.0f} s: {box['service']:.1%} of a core and"
        f" {box['writer']:.1%} in its child; of {box['frames']} frames {box['missing']} are missing"
    )
    print(f"delfim log ls of a year, {files} files with their sidecars: {listing_s:.2f} s; {output}/log.png")
    return 0


@contextlib.contextmanager
def _pipe(path: Path) -> Iterator[Write]:
    """To a child that reads, as figure 2-8 has it."""
    with _draining("import os\nwhile os.read(0, 65536): pass", stdin=subprocess.PIPE) as child:
        assert child.stdin is not None
        fd = child.stdin.fileno()
        yield lambda record: os.write(fd, record)


@contextlib.contextmanager
def _unix_socket(path: Path) -> Iterator[Write]:
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with ours, its, _draining(DRAIN, str(its.fileno()), pass_fds=(its.fileno(),)):
        yield ours.sendall


@contextlib.contextmanager
def _udp_socket(path: Path) -> Iterator[Write]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as its, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        its.bind(("127.0.0.1", 0))
        ours.connect(its.getsockname())
        with _draining(DRAIN, str(its.fileno()), pass_fds=(its.fileno(),)):
            yield ours.send


@contextlib.contextmanager
def _file(path: Path, flags: int = 0) -> Iterator[Write]:
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | flags)
    try:
        yield lambda record: os.write(fd, record)
    finally:
        os.close(fd)


@contextlib.contextmanager
def _o_sync(path: Path) -> Iterator[Write]:
    with _file(path, os.O_SYNC) as write:
        yield write


@contextlib.contextmanager
def _buffered_file(path: Path) -> Iterator[Write]:
    with path.open("wb") as file:
        yield file.write


@contextlib.contextmanager
def _deflate(path: Path) -> Iterator[Write]:
    stream = zlib.compressobj()
    with _file(path) as write:

        def deflated(record: bytes) -> None:
            data = stream.compress(record)
            if data:
                write(data)

        yield deflated
        write(stream.flush())


@contextlib.contextmanager
def _draining(program: str, *words: str, **options: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A child that reads and does nothing with it."""
    with subprocess.Popen([sys.executable, "-c", program, *words], **options) as child:
        try:
            yield child
        finally:
            child.kill()


WAYS: Final = {
    "pipe": _pipe,
    "UNIX socket": _unix_socket,
    "file": _file,
    "UDP socket": _udp_socket,
    "buffered file": _buffered_file,
    "deflate": _deflate,
    "O_SYNC": _o_sync,
}


def figure_us(way: Callable[[Path], Any], path: Path, writes: int) -> list[float]:
    """The time of each write, sorted, us."""
    chance = random.Random(1)
    records = [_record(chance) for _ in range(256)]
    times = [0] * writes
    stamp = time.perf_counter_ns
    with way(path) as write:
        for i in range(writes):
            record = records[i & 255]
            start_ns = stamp()
            write(record)
            times[i] = stamp() - start_ns
    return sorted(each / 1e3 for each in times)


def put_us(directory: Path, method: Method, seconds: float) -> list[float]:
    """The time of each put of liblog, paced, sorted, us."""
    log = open_log(config.LogTable(directory=str(directory), free_bytes_min=0), method, ".log", method, SystemClock())
    times = paced_us(log.put, log.poll, seconds)
    log.close()
    assert log.status().records == len(times), log.status()
    return times


def bare_us(path: Path, seconds: float) -> list[float]:
    """The same with nothing but the system call: what the kernel takes by itself."""
    with _file(path) as write:
        return paced_us(write, lambda: None, seconds)


def paced_us(write: Write, poll: Callable[[], None], seconds: float) -> list[float]:
    """The time of each of RECORDS_PER_S writes a second, sorted, us; polled once a second, as the vehicle does."""
    chance = random.Random(1)
    times, due_s = [], time.monotonic()
    for number in range(round(seconds * RECORDS_PER_S)):
        record = _record(chance)
        due_s += 1 / RECORDS_PER_S
        time.sleep(max(0.0, due_s - time.monotonic()))
        start_ns = time.perf_counter_ns()
        write(record)
        times.append((time.perf_counter_ns() - start_ns) / 1e3)
        if number % RECORDS_PER_S == 0:
            poll()
    return sorted(times)


def black_box(file: str, place: Path, seconds: float) -> dict[str, float]:
    """canzlogd in a process of its own on a full loopback bus: the shares of a core that it and its child took, frames sent and
    frames missing in its log."""
    bus = f"canloop:log-{os.getpid()}"
    told = {"can.interface": bus, "log.directory": str(place / "log"), "runtime.run_directory": str(place)}
    words = [word for key, value in told.items() for word in ("--set", f'{key}="{value}"')]
    words += ["--set", "log.free_bytes_min=0", "--set", f"can.receive_buffer_bytes={64 << 20}"]
    command = [sys.executable, "-m", "delfim", "run", file, "--service", "canzlogd", *words]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as box:
        try:
            awaited(lambda: next(place.glob("log/*/*/*.meta.jsonl"), None), f"{' '.join(command)} does not log; it says why")
            pids = family(box.pid)
            before_s = [cpu_ns(pid) / 1e9 for pid in pids]
            sent = flooded(bus, seconds)
            time.sleep(1.0)
            used_s = [cpu_ns(pid) / 1e9 - before for pid, before in zip(pids, before_s, strict=True)]
        finally:
            box.terminate()
    logged = sum(read_log(path)[0].count(b"\n") for path in place.glob("log/*/*/*.log.gz"))
    return {"service": used_s[0] / seconds, "writer": sum(used_s[1:]) / seconds, "frames": sent, "missing": sent - logged}


def awaited(sign: Callable[[], object], trouble: str) -> None:
    """Wait until there is a sign. Raises DelfimError."""
    until_s = time.monotonic() + 20.0
    while not sign():
        if time.monotonic() > until_s:
            raise DelfimError(trouble)
        time.sleep(0.05)


def flooded(bus: str, seconds: float) -> int:
    """Frames on the bus at the rate of a full one, a few at a time. Returns how many."""
    chance, sent = random.Random(1), 0
    arbs = [extended(chance.getrandbits(29)) for _ in range(40)]
    messages = [(arb, bytes(chance.choice((0, 0, 1, 255, chance.getrandbits(8))) for _ in range(8))) for arb in arbs * 40]
    begin_s = time.monotonic()
    with open_can(bus) as can:
        while (elapsed_s := time.monotonic() - begin_s) < seconds:
            for _ in range(round((elapsed_s * FRAMES_PER_S - sent) / BATCH)):
                at = sent % (len(messages) - BATCH)
                sent += BATCH - can.send_many(messages[at : at + BATCH])
            time.sleep(0.002)
    return sent


def year(place: Path) -> int:
    """A tree of logs as a year leaves them: four hours a day, state and black box, a file every ten minutes, sidecars beside
    all of them. Returns how many files, sidecars not counted."""
    for day in range(DAYS):
        for id_, suffix in (("state", ".state.gz"), ("can0", ".log.gz")):
            begin_s = calendar.timegm((2025, 1, 1, 8, 0, 0)) + 86_400 * day
            folder = place / time.strftime("%Y%m%d", time.gmtime(begin_s)) / id_
            folder.mkdir(parents=True)
            for number in range(FILES_A_DAY):
                stem = folder / time.strftime("%H%M%S", time.gmtime(begin_s + 600 * number))
                end_s = begin_s + 600 * (number + 1)
                event = {0: "start", FILES_A_DAY - 1: "end"}.get(number, "mode")
                stem.with_suffix(".meta.jsonl").write_text(f'{{"t_ns": {end_s}000000000, "event": "{event}"}}\n')
                stem.with_suffix(suffix).touch()
                os.utime(stem.with_suffix(suffix), (end_s, end_s))
    return 2 * DAYS * FILES_A_DAY


def listed_s(place: Path) -> float:
    """How long `delfim log ls` takes, s, the start of the program included."""
    begin_s = time.monotonic()
    subprocess.run([sys.executable, "-m", "delfim", "log", "ls", str(place)], check=True, stdout=subprocess.DEVNULL)
    return time.monotonic() - begin_s


def picture(times: dict[str, list[float]], file: Path) -> None:
    """A histogram a way, both axes logarithmic, as figure 2-8."""
    import numpy as np
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 1.25 * len(times)), layout="constrained", facecolor="white")
    edges = 10 ** (np.arange(-20, 121) / 20)
    for axes, (name, each) in zip(figure.subplots(len(times), sharex=True), times.items(), strict=True):
        axes.hist(each, bins=edges, color="#d1495b" if name.startswith("liblog") else "#2e86ab")
        axes.set(xscale="log", yscale="log", facecolor=SEA, xlim=(0.1, 1e6))
        axes.grid(color=LINE, lw=0.5)
        axes.set_axisbelow(True)
        words = f"{name}   p50 {_part(each, 0.5):.1f}   p99 {_part(each, 0.99):.1f}   worst {each[-1]:.0f} µs"
        axes.text(0.99, 0.93, words, transform=axes.transAxes, ha="right", va="top", fontsize=9, color=INK)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    axes.set_xlabel("one write of 250 bytes, µs")
    figure.savefig(file, dpi=110)


def _record(chance: random.Random) -> bytes:
    """Half of it changes, half does not, as in a state."""
    return chance.randbytes(RECORD_BYTES // 2) + bytes(RECORD_BYTES - RECORD_BYTES // 2)


def _part(ordered: Sequence[float], share: float) -> float:
    return ordered[int(share * (len(ordered) - 1))]
