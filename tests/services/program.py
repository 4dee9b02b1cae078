"""What the supervisor's tests supervise: `program.py NAME RECORD BEHAVIOUR...`; the supervisor: `program.py supervise JSON`.

Everyone appends lines to the record: monotonic time, name, word.
"""

import ctypes
import faulthandler
import json
import os
import re
import select
import signal
import sys
import time
from functools import partial
from pathlib import Path

from delfim.services.supervision import children, supervisor


def note(record: str, name: str, word: str) -> None:
    fd = os.open(record, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(fd, f"{time.monotonic()} {name} {word}\n".encode())
    os.close(fd)


def supervise(text: str) -> int:
    told = json.loads(text)
    record = told.pop("record")
    if told.pop("subreaper"):
        ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER: orphans come here, as they come to PID 1
    for name, value in told.pop("constants").items():
        setattr(supervisor, name, value)
    absences_s, monotonic, absent_s = list[float](), time.monotonic, told.pop("absent_s")
    signal.signal(signal.SIGCONT, lambda *_: absences_s.append(absent_s))
    vars(time)["monotonic"] = lambda: monotonic() + sum(absences_s)

    def cut(off: bool) -> str:
        note(record, "bus", "cut" if off else "uncut")
        return "cut off" if off else "may turn"

    if told.pop("unkillable"):  # as one that waits in the kernel for a bus
        vars(os)["killpg"] = lambda pid, number: None
    programs = [children.Supervised(name, tuple(argv), *kinds) for name, argv, *kinds in told.pop("programs")]
    files = {name: Path(told.pop(name)) for name in ("state_file", "requests")}
    supervising = supervisor.Supervisor(
        programs, stop=partial(note, record, "bus", "stop"), calm=partial(note, record, "bus", "calm"), cut=cut, **files, **told
    )
    code = supervising.run_forever()
    print(f"ended by {supervising.word!r}, {supervising.reason!r}", file=sys.stderr)
    return code


def stall(how: str, beat_fd: int) -> None:
    """In one of the ways in which programs stop to do anything."""
    if how == "busy":
        while True:
            pass
    if how == "regex":
        re.match("(a+)+$", "a" * 60 + "b")
    if how == "holds-gil":
        ctypes.PyDLL(None).sleep(60)
    if how == "stopped":
        os.kill(os.getpid(), signal.SIGSTOP)
    if how == "hangs-up":
        os.close(beat_fd)
        signal.pause()


def orphan(record: str, name: str) -> None:
    """A grandchild that ends after its parent did."""
    if os.fork() == 0:
        if os.fork() == 0:
            select.select([], [], [], 0.1)
            note(record, name, "orphan-ends")
        os._exit(0)
    os.wait()


def run(name: str, record: str, behaviour: list[str], beat_fd: int) -> int:
    signal.alarm(100)  # whatever becomes of the test, nothing is left behind
    if "unarmed" not in behaviour:
        faulthandler.register(children.STACKS_SIGNAL, beat_fd, chain=True)
    starts = Path(record).read_text().count(f" {name} start\n") if os.path.exists(record) else 0

    def end(*_: object) -> None:
        if os.sched_getscheduler(0) == os.SCHED_IDLE:
            note(record, name, "idles")
        note(record, name, "end")
        os._exit(0)

    signal.signal(signal.SIGTERM, signal.SIG_IGN if "deaf" in behaviour else end)
    note(record, name, "start")
    beats = 0
    while True:
        for word in behaviour:
            kind, _, argument = word.partition("=")
            if beats == 3 and kind == "exit":
                return int(argument)
            if beats == 3 and kind == "killed":
                os.kill(os.getpid(), signal.SIGKILL)
            if beats == 3 and kind == "orphan":
                orphan(record, name)
            if beats == 3 and kind == "stall" and starts == 0:
                note(record, name, "stall")
                stall(argument, beat_fd)
            if kind == "mute":
                signal.pause()
        try:
            os.write(beat_fd, b".")
        except BrokenPipeError:
            note(record, name, "abandoned")
            return 0
        beats += 1
        if beats == 1:
            note(record, name, "beat")
        select.select([], [], [], 0.02)


if __name__ == "__main__":
    if sys.argv[1] == "supervise":
        sys.exit(supervise(sys.argv[2]))
    sys.exit(run(sys.argv[1], sys.argv[2], sys.argv[3:-2], int(sys.argv[-1])))
