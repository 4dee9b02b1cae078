"""What a put costs the caller, for the three ways to write, and what the black box costs at 7,700 frames a second.

    python bench/liblog.py [DIRECTORY] [--seconds S]

Records come paced, as in a control loop: back to back everything is in the caches and nothing shows.
"""

import argparse
import random
import resource
import tempfile
import time
from collections import deque
from pathlib import Path

from delfim.clock import SystemClock
from delfim.config import Log
from delfim.frames import Frame, extended
from delfim.logging.canzlogd import BlackBox
from delfim.logging.liblog import open_log

RECORD_BYTES, RECORDS_PER_S = 250, 500
FRAMES_PER_S, BATCHES_PER_S = 7_700, 500


def put_us(directory: Path, method: str, seconds: float) -> list[float]:
    """The time of each put, sorted, in microseconds."""
    clock, chance = SystemClock(), random.Random(1)
    log = open_log(directory, method, ".log", method, clock, file_bytes=1_000_000, file_s=600.0)
    times, due_s = [], time.monotonic()
    for _ in range(round(seconds * RECORDS_PER_S)):
        record = chance.randbytes(RECORD_BYTES)
        due_s += 1 / RECORDS_PER_S
        time.sleep(max(0.0, due_s - time.monotonic()))
        start_ns = time.perf_counter_ns()
        log.put(record)
        times.append((time.perf_counter_ns() - start_ns) / 1e3)
        log.poll()
    log.close()
    assert log.status().records == len(times), log.status()
    return sorted(times)


class Wire:
    def __init__(self) -> None:
        self.name, self.dropped, self.queue = "can0", 0, deque[Frame]()

    def receive(self) -> Frame | None:
        return self.queue.popleft() if self.queue else None

    def rebind(self) -> bool:
        return True


def black_box(directory: Path, seconds: float) -> tuple[float, float, int, int]:
    """Shares of a core of caller and writer, frames, frames lost."""
    clock, chance, wire = SystemClock(), random.Random(1), Wire()
    arbs = [extended(chance.getrandbits(29)) for _ in range(40)]
    box = BlackBox([wire], Log(directory=str(directory), free_bytes_min=0), clock)
    frames, due_s, used_s = 0, time.monotonic(), 0.0
    for _ in range(round(seconds * BATCHES_PER_S)):
        due_s += 1 / BATCHES_PER_S
        time.sleep(max(0.0, due_s - time.monotonic()))
        for _ in range(round(FRAMES_PER_S / BATCHES_PER_S)):
            data = bytes(chance.choice((0, 0, 1, 255, chance.getrandbits(8))) for _ in range(8))
            wire.queue.append(Frame(chance.choice(arbs), data, clock.time_ns()))
            frames += 1
        start_s = time.process_time()
        box.on_readable(wire)
        used_s += time.process_time() - start_s
    start_s = time.process_time()
    box.poll()
    used_s += time.process_time() - start_s
    dropped = box.status()["can0"].dropped
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    box.close()
    child = resource.getrusage(resource.RUSAGE_CHILDREN)
    writer_s = child.ru_utime + child.ru_stime - before.ru_utime - before.ru_stime
    return used_s / seconds, writer_s / seconds, frames, dropped


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("directory", nargs="?", help="where to log; a temporary directory otherwise")
    arguments.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    asked = arguments.parse_args()
    with tempfile.TemporaryDirectory(dir=asked.directory) as place:
        print(f"put of {RECORD_BYTES} bytes, {RECORDS_PER_S} a second, us:   p50     p99   p99.9   worst")
        for method in ("write", "zwrite", "zpipe"):
            times = put_us(Path(place), method, asked.seconds)
            figures = [times[int(share * (len(times) - 1))] for share in (0.5, 0.99, 0.999, 1.0)]
            print(f"{method:40}" + "".join(f"{figure:8.1f}" for figure in figures))
        caller, writer, frames, dropped = black_box(Path(place), asked.seconds)
        print(f"black box, {frames} frames, {dropped} blocks lost: {caller:.1%} of a core here, {writer:.1%} in the writer")


if __name__ == "__main__":
    main()
