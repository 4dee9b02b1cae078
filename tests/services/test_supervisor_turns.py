"""The supervisor turn by turn on a kernel that is played: when it starts, stops, asks, kills and ends, to the hundredth."""

import json
import logging
import re
from collections.abc import Callable, Iterator
from math import inf
from pathlib import Path
from signal import SIGCHLD, SIGTERM
from textwrap import fill
from typing import Any

import pytest

from delfim.services.supervision import children, supervisor
from delfim.services.supervision.cgroup import Limits
from delfim.services.supervision.children import Supervised
from tests.services.played_kernel import DUMP, FIRST_S, Kernel, Played

PROGRAMS = {
    "runtime": Supervised("runtime", ("runtime",), critical=True),
    "outlet": Supervised("outlet", ("outlet",), guard=True),
    "sshd": Supervised("sshd", ("sshd",)),
    "ftpd": Supervised("ftpd", ("ftpd",)),
    "absent": Supervised("absent", ("absent",)),
}
FAILED, KILLED = 1 << 8, 9  # as waitpid tells it
PERMANENT = 100 << 8


class Strokes:
    """The hardware watchdog."""

    def __init__(self, device: str) -> None:
        self.words = b""

    def stroke(self, word: bytes) -> None:
        self.words += word


class Boat(logging.Handler):
    """A supervisor on a kernel; what it does and says is in one list."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, place: Path, kernel: Kernel, programs: str, **more: Any) -> None:
        super().__init__()
        self.kernel, self.file, self.bus_is_off, self.critical = kernel, place / "state.json", False, list[str]()
        for name in ("os", "select", "signal", "time"):
            monkeypatch.setattr(supervisor, name, kernel)
        for name in ("os", "time"):
            monkeypatch.setattr(children, name, kernel)
        monkeypatch.setattr(supervisor, "Watchdog", Strokes)
        monkeypatch.setattr(supervisor, "process_state", lambda pid: "D (disk sleep)")
        monkeypatch.setattr(supervisor, "listening", lambda path: self)
        self.requests = kernel.pipe()[0]
        told = [PROGRAMS[name] for name in programs.split()]
        settings = {"deadman_s": 1.0, "backoff_s": 0.5, "backoff_max_s": 3.0, "state_file": self.file, "requests": place} | more
        self.supervisor = supervisor.Supervisor(told, stop=self._stop, calm=self._calm, cut=self._cut, **settings)

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno == logging.CRITICAL:  # said once more when it is done
            self.critical.append(record.getMessage())
        else:
            self.kernel.say(record.getMessage())

    def fileno(self) -> int:
        """Of the socket for requests."""
        return self.requests

    def _stop(self) -> None:
        self.kernel.say("stop")
        if self.bus_is_off:
            raise OSError("bus-off")

    def _calm(self) -> None:
        self.kernel.say("calm")

    def _cut(self, off: bool) -> str:
        self.kernel.say("cut" if off else "uncut")
        return "cut off" if off else "may turn"

    def run(self, until_s: float = inf) -> int:
        """Until it ends, or is ended by a signal."""
        self.kernel.at(until_s, lambda: self.kernel.deliver(SIGTERM))
        return self.supervisor.run_forever()

    def told(self) -> str:
        """What happened, a line for each moment; stop frames alone are one line, with their number."""
        lines = list[tuple[float, float, str, int]]()
        for at_s, what in self.kernel.told:
            first_s, last_s, words, stops = lines[-1] if lines else (-1.0, -1.0, "", 0)
            if stops and what == "stop":
                lines[-1] = first_s, at_s, words, stops + 1
            elif at_s == last_s and first_s == last_s:
                lines[-1] = first_s, at_s, f"{words}{f' ({stops})' if stops > 1 else ''}; {what}", 0
            else:
                lines.append((at_s, at_s, what, int(what == "stop")))
        rows = [(f"{a:.2f}" if a == b else f"{a:.2f} to {b:.2f}", words, stops) for a, b, words, stops in lines]
        told = (f"{when} {words}{f' ({stops})' if stops > 1 else ''}" for when, words, stops in rows)
        return "\n".join(fill(each, 124, subsequent_indent="     ") for each in told)

    def state(self) -> Any:
        return json.loads(self.file.read_text())


Make = Callable[..., Boat]


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Make]:
    logger, boats = logging.getLogger("delfim.services"), list[Boat]()

    def made(kernel: Kernel, programs: str, **more: Any) -> Boat:
        boats.append(Boat(monkeypatch, tmp_path, kernel, programs, **more))
        logger.addHandler(boats[-1])
        return boats[-1]

    level = logger.level
    logger.setLevel(logging.INFO)
    yield made
    logger.setLevel(level)
    for boat in boats:
        logger.removeHandler(boat)


LIVES: dict[str, dict[str, list[Played]]] = {
    "the others start after the first beat, and end before the guard": {"runtime": [Played(first_s=2.0)]},
    "a silent runtime": {"runtime": [Played(silent_s=2.03)]},
    "a silent runtime that does not say where it stands": {"runtime": [Played(silent_s=2.03, stands=b"")]},
    "a silent runtime that the kernel does not end": {"runtime": [Played(silent_s=2.03, stands=b"", kill_s=3.0)]},
    "a silent guard that the kernel does not end": {"outlet": [Played(silent_s=2.03, stands=b"", kill_s=3.0)]},
    "a runtime that never beats": {"runtime": [Played(first_s=inf)]},
    "a guard that never beats": {"outlet": [Played(first_s=inf)]},
    "another program that never beats": {"sshd": [Played(first_s=inf)]},
    "a silent program": {"sshd": [Played(silent_s=2.03)]},
    "a program that was silent": {"sshd": [Played(silent_s=2.03, again_s=12.0)]},
    "programs that die wait longer and longer, unless they lived for long": {
        "sshd": [
            *[Played(ends_s=0.01, status=FAILED)] * 5,
            Played(ends_s=3.0, status=FAILED),
            Played(ends_s=3.01, status=KILLED),
            Played(ends_s=0.7, status=PERMANENT),
        ]
    },
    "a runtime that dies": {"runtime": [Played(ends_s=0.01, status=FAILED)]},
    "a runtime that dies and then is silent": {"runtime": [Played(ends_s=0.01, status=FAILED), Played(silent_s=1.03)]},
    "a runtime that ends": {"runtime": [Played(ends_s=1.03)]},
    "a runtime that must not be started again": {"runtime": [Played(ends_s=1.03, status=PERMANENT)]},
    "nothing is left to run": {"sshd": [Played(ends_s=1.0)], "ftpd": [Played(ends_s=2.03, status=PERMANENT)]},
    "a runtime that leaves": {"runtime": [Played(says_s=0.95, word=b"l", silent_s=1.03)]},
    "a runtime that leaves and says so again": {"runtime": [Played(says_s=0.95, word=b"l")]},
    "a runtime that said its last word": {"runtime": [Played(says_s=0.95, word=b"e", silent_s=1.03)]},
    "a guard that says the last word": {"outlet": [Played(says_s=0.95, word=b"e", silent_s=1.03)]},
    "programs that do not end": {"runtime": [Played(term_s=inf)], "sshd": [Played(term_s=inf)]},
    "programs that the kernel does not end": {name: [Played(term_s=inf, kill_s=inf)] for name in ("runtime", "sshd")},
    "a program that waits as all end": {"sshd": [Played(ends_s=0.2, status=FAILED)]},
    "a guard that does not end": {"outlet": [Played(term_s=inf)]},
    "a guard that is silent as it ends": {"outlet": [Played(silent_s=0.63, term_s=inf)]},
    "a guard that the kernel does not end": {"outlet": [Played(term_s=inf, kill_s=inf)]},
    "a guard that the kernel did not end before all end": {
        "outlet": [Played(silent_s=1.03, stands=b"", term_s=inf, kill_s=inf)]
    },
    "a guard that comes up too late to stop its motors": {"outlet": [Played(term_s=inf), Played(first_s=inf)]},
    "a guard that failed for good": {"outlet": [Played(ends_s=0.2, status=PERMANENT)]},
}
# Name, programs, when they are told to end; what happens.
STORIES = """
= the others start after the first beat, and end before the guard | sshd outlet runtime ftpd | 5.02
0.00 runtime: started as process 100; outlet: started as process 101
2.00 sshd: started as process 102; ftpd: started as process 103
5.02 runtime term
5.22 stop; runtime: ended: exit code 0; stop; stop; ftpd term
5.32 to 5.42 stop (2)
5.42 ftpd: ended: exit code 0; outlet term
5.62 outlet: ended: exit code 0; sshd term
5.82 sshd: ended: exit code 0
= a silent runtime | runtime sshd | 5.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101
3.00 runtime asked; stop; runtime killed; runtime: beat stopped for 1.0 s: dead-man; it stood in turn (srv/loop.py:34);
     started again in 0 s; stop; runtime: started as process 102
3.10 to 3.50 stop (5)
3.50 calm
5.02 runtime term
5.22 stop; runtime: ended: exit code 0; stop; stop; sshd term
5.32 to 5.42 stop (2)
5.42 sshd: ended: exit code 0
= a silent runtime that does not say where it stands | runtime sshd | 5.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101
3.00 runtime asked; stop
3.10 to 3.50 stop (5)
3.50 runtime killed; runtime: beat stopped for 1.0 s: dead-man; it did not say where it stood: D (disk sleep); started again
     in 0 s; stop; runtime: started as process 102
3.60 to 4.00 stop (5)
4.00 calm
5.02 runtime term
5.22 stop; runtime: ended: exit code 0; stop; stop; sshd term
5.32 to 5.42 stop (2)
5.42 sshd: ended: exit code 0
= a silent runtime that the kernel does not end | runtime sshd | 7.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101
3.00 runtime asked; stop
3.10 to 3.50 stop (5)
3.50 runtime killed
3.60 to 4.50 stop (10)
4.50 runtime: does not answer, and cannot be killed: D (disk sleep)
4.60 to 6.50 stop (20)
6.50 runtime: beat stopped for 1.0 s: dead-man; it did not say where it stood: D (disk sleep); started again in 0 s; stop;
     runtime: started as process 102
6.60 to 7.00 stop (5)
7.00 calm
7.02 runtime term
7.22 stop; runtime: ended: exit code 0; stop; stop; sshd term
7.32 to 7.42 stop (2)
7.42 sshd: ended: exit code 0
= a silent guard that the kernel does not end | runtime outlet | 7.02
0.00 runtime: started as process 100; outlet: started as process 101
3.00 outlet asked
3.10 outlet killed
4.10 cut; outlet: does not answer, and cannot be killed: D (disk sleep); THE MOTORS MAY TURN: cut off
6.10 outlet: beat stopped for 1.0 s: dead-man; it did not say where it stood: D (disk sleep); started again in 0 s; outlet:
     started as process 102
6.70 uncut; outlet: beats again: may turn
7.02 runtime term
7.22 stop; runtime: ended: exit code 0; stop; stop; outlet term
7.42 outlet: ended: exit code 0
= a runtime that never beats | runtime sshd | 61.02
0.00 runtime: started as process 100
5.00 sshd: started as process 101
60.00 runtime asked; stop; runtime killed; runtime: no beat for 60.0 s: dead-man; it stood in turn (srv/loop.py:34); started
     again in 0 s; stop; runtime: started as process 102
60.10 to 60.50 stop (5)
60.50 calm
61.02 runtime term
61.22 stop; runtime: ended: exit code 0; stop; stop; sshd term
61.32 stop
61.42 sshd: ended: exit code 0; stop
= a guard that never beats | runtime outlet | 61.02
0.00 runtime: started as process 100; outlet: started as process 101
60.00 outlet asked; outlet killed; outlet: no beat for 60.0 s: dead-man; it stood in turn (srv/loop.py:34); started again in
     0 s; outlet: started as process 102
61.02 runtime term
61.22 stop; runtime: ended: exit code 0; stop; stop; outlet term
61.42 outlet: ended: exit code 0
= another program that never beats | runtime sshd | 302.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101
300.50 sshd asked; sshd killed; sshd: no beat for 300.0 s: killed; it stood in turn (srv/loop.py:34); started again in 0.5 s
301.00 sshd: started as process 102
302.02 runtime term
302.22 stop; runtime: ended: exit code 0; stop; stop; sshd term
302.32 stop
302.42 sshd: ended: exit code 0
= a silent program | runtime sshd | 33.52
0.00 runtime: started as process 100
0.50 sshd: started as process 101
3.60 sshd: does not answer
32.50 sshd asked; sshd killed; sshd: beat stopped for 30.0 s: killed; it stood in turn (srv/loop.py:34); started again in
     0.5 s
33.00 sshd: started as process 102
33.52 runtime term
33.72 stop; runtime: ended: exit code 0; stop; stop; sshd term
33.82 stop
33.92 sshd: ended: exit code 0; stop
= a program that was silent | runtime sshd | 13.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101
3.60 sshd: does not answer
12.60 sshd: did not answer for 10.1 s
13.02 runtime term
13.22 stop; runtime: ended: exit code 0; stop; stop; sshd term
13.32 to 13.42 stop (2)
13.42 sshd: ended: exit code 0
= programs that die wait longer and longer, unless they lived for long | runtime sshd | 22.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101
0.51 sshd: exit code 1; started again in 0.5 s
1.01 sshd: started as process 102
1.02 sshd: exit code 1; started again in 1 s
2.02 sshd: started as process 103
2.03 sshd: exit code 1; started again in 2 s
4.03 sshd: started as process 104
4.04 sshd: exit code 1; started again in 3 s
7.04 sshd: started as process 105
7.05 sshd: exit code 1; started again in 3 s
10.05 sshd: started as process 106
13.05 sshd: exit code 1; started again in 3 s
16.05 sshd: started as process 107
19.06 sshd: killed by signal 9 (Killed); started again in 0.5 s
19.56 sshd: started as process 108
20.26 sshd: exit code 100: not to be started again
22.02 runtime term
22.22 stop; runtime: ended: exit code 0; stop; stop
= a runtime that dies | runtime sshd | 2.02
0.00 runtime: started as process 100
0.01 stop; runtime: exit code 1; started again in 0.5 s; stop; sshd: started as process 101
0.11 to 0.51 stop (5)
0.51 runtime: started as process 102
0.61 to 1.01 stop (5)
1.01 calm
2.02 runtime term
2.22 stop; runtime: ended: exit code 0; stop; stop; sshd term
2.32 to 2.42 stop (2)
2.42 sshd: ended: exit code 0
= a runtime that dies and then is silent | runtime | 4.02
0.00 runtime: started as process 100
0.01 stop; runtime: exit code 1; started again in 0.5 s; stop
0.11 to 0.51 stop (5)
0.51 runtime: started as process 101
0.61 to 1.01 stop (5)
1.01 calm
2.51 runtime asked; stop; runtime killed; runtime: beat stopped for 1.0 s: dead-man; it stood in turn (srv/loop.py:34);
     started again in 0 s; stop; runtime: started as process 102
2.61 to 3.01 stop (5)
3.01 calm
4.02 runtime term
4.22 stop; runtime: ended: exit code 0; stop; stop
= a program that cannot be started | runtime absent | 1.22
0.00 runtime: started as process 100
0.50 absent: cannot be started: No such file or directory; started again in 0.5 s
1.00 absent: cannot be started: No such file or directory; started again in 1 s
1.22 runtime term
1.42 stop; runtime: ended: exit code 0; stop; stop
= a runtime that ends | runtime sshd | inf
0.00 runtime: started as process 100
0.50 sshd: started as process 101
1.03 stop; runtime: ended: exit code 0; stop; stop; sshd term
1.13 to 1.23 stop (2)
1.23 sshd: ended: exit code 0
= a runtime that must not be started again | runtime sshd | 2.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101
1.03 stop; runtime: exit code 100: not to be started again; stop
1.13 to 2.02 stop (10)
2.02 sshd term
2.12 to 2.22 stop (2)
2.22 sshd: ended: exit code 0
= nothing is left to run | sshd ftpd | inf
0.00 sshd: started as process 100; ftpd: started as process 101
1.00 sshd: ended: exit code 0
2.03 ftpd: exit code 100: not to be started again
= a runtime that leaves | runtime | 7.02
0.00 runtime: started as process 100
2.00 to 6.00 stop (41)
6.00 runtime asked; stop; runtime killed; runtime: beat stopped for 5.0 s: dead-man; it stood in turn (srv/loop.py:34);
     started again in 0 s; stop; runtime: started as process 101
6.10 to 6.50 stop (5)
6.50 calm
7.02 runtime term
7.22 stop; runtime: ended: exit code 0; stop; stop
= a runtime that leaves and says so again | runtime | 3.02
0.00 runtime: started as process 100
3.02 runtime term
3.22 stop; runtime: ended: exit code 0; stop; stop
= a runtime that said its last word | runtime | 7.02
0.00 runtime: started as process 100
1.00 to 6.00 stop (51)
6.00 runtime asked; stop; runtime killed; runtime: beat stopped for 5.0 s: dead-man; it stood in turn (srv/loop.py:34);
     started again in 0 s; stop; runtime: started as process 101
6.10 to 6.50 stop (5)
6.50 calm
7.02 runtime term
7.22 stop; runtime: ended: exit code 0; stop; stop
= a guard that says the last word | runtime outlet | 3.02
0.00 runtime: started as process 100; outlet: started as process 101
2.00 outlet asked; outlet killed; outlet: beat stopped for 1.0 s: dead-man; it stood in turn (srv/loop.py:34); started again
     in 0 s; outlet: started as process 102
3.02 runtime term
3.22 stop; runtime: ended: exit code 0; stop; stop; outlet term
3.42 outlet: ended: exit code 0
= programs that do not end | runtime sshd ftpd | 1.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101; ftpd: started as process 102
1.02 runtime term
6.10 runtime killed; runtime: ended: did not end in 5 s; stop; stop; ftpd term
6.20 to 6.30 stop (2)
6.30 ftpd: ended: exit code 0; sshd term
6.40 to 8.50 stop (22)
8.50 sshd killed; sshd: ended: did not end in 2 s
= programs that the kernel does not end | runtime sshd ftpd | 1.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101; ftpd: started as process 102
1.02 runtime term
6.10 runtime killed
7.10 stop; ftpd term; runtime: does not answer, and cannot be killed: D (disk sleep)
7.20 to 7.30 stop (2)
7.30 ftpd: ended: exit code 0; sshd term
7.40 to 9.50 stop (22)
9.50 sshd killed
9.60 to 10.40 stop (9)
= a program that waits as all end | runtime sshd | 1.02
0.00 runtime: started as process 100
0.50 sshd: started as process 101
0.70 sshd: exit code 1; started again in 0.5 s
1.02 runtime term
1.22 stop; runtime: ended: exit code 0; stop; stop
= a guard that does not end | runtime outlet sshd | 1.02
0.00 runtime: started as process 100; outlet: started as process 101
0.50 sshd: started as process 102
1.02 runtime term
1.22 stop; runtime: ended: exit code 0; stop; stop; sshd term
1.32 to 1.42 stop (2)
1.42 sshd: ended: exit code 0; outlet term
3.60 outlet killed; outlet: ended: did not end in 2 s; outlet: started as process 103
4.10 outlet term
4.30 outlet: ended: exit code 0
= a guard that is silent as it ends | runtime outlet sshd | 1.02
0.00 runtime: started as process 100; outlet: started as process 101
0.50 sshd: started as process 102
1.02 runtime term
1.22 stop; runtime: ended: exit code 0; stop; stop; sshd term
1.32 to 1.42 stop (2)
1.42 sshd: ended: exit code 0; outlet term
1.60 outlet asked; outlet killed; outlet: ended: beat stopped for 1.0 s: dead-man; it stood in turn (srv/loop.py:34);
     outlet: started as process 103
2.10 outlet term
2.30 outlet: ended: exit code 0
= a guard that the kernel does not end | runtime outlet | 1.02
0.00 runtime: started as process 100; outlet: started as process 101
1.02 runtime term
1.22 stop; runtime: ended: exit code 0; stop; stop; outlet term
3.40 outlet killed
4.30 cut; outlet: does not answer, and cannot be killed: D (disk sleep); THE MOTORS MAY TURN: cut off
= a guard that the kernel did not end before all end | runtime outlet | 4.02
0.00 runtime: started as process 100; outlet: started as process 101
2.00 outlet asked
2.10 outlet killed
3.10 cut; outlet: does not answer, and cannot be killed: D (disk sleep); THE MOTORS MAY TURN: cut off
4.02 runtime term
4.22 stop; runtime: ended: exit code 0; stop; stop; outlet term
= a guard that comes up too late to stop its motors | runtime outlet | 1.02
0.00 runtime: started as process 100; outlet: started as process 101
1.02 runtime term
1.22 stop; runtime: ended: exit code 0; stop; stop; outlet term
3.40 outlet killed; outlet: ended: did not end in 2 s; outlet: started as process 102
8.50 outlet term
8.70 outlet: ended: exit code 0
= a guard that failed for good | runtime outlet | 1.02
0.00 runtime: started as process 100; outlet: started as process 101
0.20 outlet: exit code 100: not to be started again
1.02 runtime term
1.22 stop; runtime: ended: exit code 0; stop; stop
"""


@pytest.mark.parametrize("story", re.split(r"^= ", STORIES, flags=re.MULTILINE)[1:], ids=lambda story: story.partition(" |")[0])
def test_a_story(make: Make, story: str) -> None:
    head, _, told = story.partition("\n")
    name, programs, until_s = head.split(" | ")
    boat = make(Kernel(**LIVES.get(name, {})), programs)
    boat.run(float(until_s))
    assert boat.told() == told.strip()
    assert {each.fd for each in boat.kernel.processes if not each.is_alive} <= set(boat.kernel.closed)


def test_it_strokes_the_hardware_watchdog_ten_times_a_second_and_lets_it_go_at_the_end(make: Make) -> None:
    boat = make(Kernel(), "sshd runtime outlet")
    assert boat.run(5.02) == 0
    assert (boat.supervisor.word, boat.supervisor.reason) == ("end", "SIGTERM")
    assert max(boat.kernel.waits_s) == pytest.approx(0.1)
    assert boat.supervisor._watchdog.words == bytes(len(boat.kernel.waits_s)) + b"V"
    assert boat.kernel.idle == boat.kernel.hurried == ["sshd"]
    assert boat.state()["deadman"] is None
    assert list(boat.state()["programs"]) == ["runtime", "sshd", "outlet"]
    ended = {"state": "stopped", "pid": 0, "restarts": 0, "reason": "exit code 0", "since_s": pytest.approx(FIRST_S + 5.22)}
    assert boat.state()["programs"]["runtime"] == ended


def test_where_a_silent_runtime_stood_is_kept_and_told_with_all_stacks(make: Make) -> None:
    boat = make(Kernel(runtime=[Played(silent_s=2.03)]), "runtime sshd")
    boat.kernel.at(4.0, lambda: states.append(boat.state()))
    states = list[Any]()
    boat.run(5.02)
    reason = "beat stopped for 1.0 s: dead-man; it stood in turn (srv/loop.py:34)"
    assert boat.state()["deadman"] == {"reason": reason, "at_s": pytest.approx(FIRST_S + 3.0)}
    assert states[0]["programs"]["runtime"] == {
        "state": "running",
        "pid": 102,
        "restarts": 1,
        "reason": reason,
        "since_s": pytest.approx(FIRST_S + 3.0),
    }
    assert boat.critical == [f"runtime: {reason}", *DUMP.decode()[1:].split("\n\n")]


def test_a_silent_guard_is_no_event_of_the_deadman(make: Make) -> None:
    boat = make(Kernel(outlet=[Played(silent_s=2.03)]), "runtime outlet")
    boat.run(5.02)
    assert boat.state()["deadman"] is None
    assert boat.state()["programs"]["outlet"]["restarts"] == 1


def test_who_does_not_end_is_killed_with_the_reason(make: Make) -> None:
    boat = make(Kernel(runtime=[Played(term_s=inf)], sshd=[Played(term_s=inf)]), "runtime sshd")
    boat.run(1.02)
    assert boat.critical == ["runtime: did not end in 5 s", "sshd: did not end in 2 s"]


@pytest.mark.parametrize(
    ("lives", "until_s", "init", "code", "word"),
    [
        ([Played(ends_s=1.0)], inf, False, 0, ""),
        ([Played(ends_s=1.0, status=PERMANENT)], inf, False, 100, ""),
        ([Played(ends_s=1.0, status=PERMANENT)], 2.0, True, 0, "reboot"),
        ([Played(ends_s=1.0)], 2.0, True, 0, "reboot"),
        ([], 2.0, False, 0, "end"),
    ],
)
def test_how_it_ends(make: Make, lives: list[Played], until_s: float, init: bool, code: int, word: str) -> None:
    boat = make(Kernel(runtime=lives), "runtime", init=init)
    assert boat.run(until_s) == code
    assert (boat.supervisor.word, boat.supervisor.reason) == (word, "SIGTERM" if word else "")
    assert boat.kernel.now_s == pytest.approx(FIRST_S + (1.0 if until_s == inf else 2.0), abs=0.21)


def test_the_first_request_counts_and_nonsense_does_not(make: Make) -> None:
    boat = make(Kernel(runtime=[Played(term_s=1.0)]), "runtime")
    for at_s, text in ((1.0, b"O" + 30 * b"F" + b" now"), (2.0, b"off " + 5000 * b"x"), (2.5, b"reboot later")):
        boat.kernel.at(at_s, lambda text=text: boat.kernel.ask(boat.requests, text))
    boat.run()
    assert (boat.supervisor.word, boat.supervisor.reason) == ("off", 4092 * "x")
    assert "1.00 supervisor: not a request: 'OFFFFFFFFFFFFFFFFFFF'\n2.00 supervisor: off: xxx" in boat.told().replace(
        "\n     ", " "
    )
    assert boat.kernel.now_s == pytest.approx(FIRST_S + 3.0)


def test_a_bus_that_fails_is_told_once_and_again_when_it_was_well(make: Make) -> None:
    boat = make(Kernel(runtime=[Played(ends_s=1.02, status=FAILED), Played(first_s=inf)]), "runtime")
    for at_s, is_off in ((1.21, True), (1.61, False), (2.01, True)):
        boat.kernel.at(at_s, lambda is_off=is_off: setattr(boat, "bus_is_off", is_off))
    boat.run(2.51)
    told = [row for row in boat.kernel.told if row[1].startswith("stop frames")]
    assert told == [(1.22, "stop frames: bus-off"), (2.02, "stop frames: bus-off")]


def test_a_program_that_closes_its_pipe_is_silent_and_costs_no_turns(make: Make) -> None:
    boat = make(Kernel(runtime=[Played(stands=b"")]), "runtime")
    boat.kernel.at(1.02, lambda: boat.kernel.hang_up(boat.kernel.processes[0]))
    boat.run(2.52)
    assert "2.00 runtime asked; stop\n2.10 to 2.50 stop (5)\n2.50 runtime killed" in boat.told()
    assert boat.kernel.closed.count(boat.kernel.processes[0].fd) == 1
    assert len(boat.kernel.waits_s) < 60


def test_who_needs_too_much_memory_is_told_so_and_orphans_are_reaped(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Limits, "exceeded", lambda *_: "it needed too much")
    boat = make(Kernel(sshd=[Played(ends_s=1.0, status=KILLED)]), "runtime sshd")
    boat.kernel.at(1.01, lambda: boat.kernel.strays(3))
    boat.kernel.at(1.02, lambda: left.append(len(boat.kernel.dead)))
    left = list[int]()
    boat.run(2.0)
    assert left == [0]
    assert "1.50 sshd: it needed too much; started again in 0.5 s" in boat.told()


def test_while_the_computer_stands_still_nobody_is_late(make: Make) -> None:
    boat = make(Kernel(), "runtime sshd")
    boat.kernel.at(2.02, lambda: boat.kernel.stand_still(30.0))
    boat.run(40.0)
    assert "killed" not in boat.told()
    assert "does not answer" not in boat.told()


def test_another_program_is_silent_after_the_deadmans_time_and_not_before(make: Make) -> None:
    boat = make(Kernel(sshd=[Played(first_s=0.5, silent_s=0.55)]), "runtime sshd")
    boat.kernel.at(2.0, lambda: boat.kernel.deliver(SIGCHLD))
    boat.kernel.at(2.5, lambda: reasons.append(boat.state()["programs"]["sshd"]["reason"]))
    reasons = list[str]()
    boat.run(3.02)
    assert (2.1, "sshd: does not answer") in boat.kernel.told
    assert reasons == ["does not answer"]


def test_a_state_that_cannot_be_written_is_told(make: Make) -> None:
    boat = make(Kernel(), "runtime")
    boat.file.mkdir()
    boat.run(1.02)
    assert (0.0, f"{boat.file}: Is a directory") in boat.kernel.told
