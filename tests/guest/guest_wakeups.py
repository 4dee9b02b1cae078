"""Inside an emulated PC, by the image's own Python: how late a process in real time is woken that asks for it every 5 ms, alone
and beside others that keep the kernel busy: they write to the disk, read, copy memory, start programs and walk folders.
"""

import os
import signal
import sys
import time
from pathlib import Path

PERIOD_S, ALONE, BUSY = 0.005, 1000, 4000  # wake-ups
PRIORITY = 10  # runtime.fifo_priority
LOAD = """while :; do
    dd if=/dev/zero of=/log/x bs=4M count=6 conv=fsync; cat /log/x /usr/lib/python3*/*.py | md5sum; rm /log/x
    find /usr /proc/1; dd if=/dev/zero of=/dev/null bs=32M count=2
done >/dev/null 2>&1"""


def ticks() -> int:
    """Interrupts of the processors' timers so far."""
    lines = (line.split() for line in Path("/proc/interrupts").read_text().splitlines())
    return sum(int(word) for words in lines if words[0] == "LOC:" for word in words[1:] if word.isdigit())


def measure(kind: str, count: int) -> None:
    late_s, before, began_s = [], ticks(), time.monotonic()
    due_s = began_s + PERIOD_S
    for _ in range(count):
        time.sleep(max(0.0, due_s - time.monotonic()))
        late_s.append(time.monotonic() - due_s)
        due_s += PERIOD_S * (1 + late_s[-1] // PERIOD_S)
    rate = (ticks() - before) / (time.monotonic() - began_s)
    late_s.sort()
    parts = (late_s[int(count * part)] * 1e6 for part in (0.5, 0.99, 0.999))
    print(kind, *(f"{part:.0f}" for part in (*parts, late_s[-1] * 1e6, rate)), "END", flush=True)


def main() -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    measure("alone", ALONE)
    if (load := os.fork()) == 0:
        os.setpgid(0, 0)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.execl("/bin/sh", "sh", "-c", LOAD)
    time.sleep(1.0)
    measure("busy", BUSY)
    os.killpg(load, signal.SIGKILL)
    sys.exit()


main()
