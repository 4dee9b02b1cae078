"""The supervisor as a real process with real programs (program.py) that fail in every way that programs have."""

import contextlib
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from delfim.base.clock import ManualClock
from delfim.services.supervision import children, shutdown, supervisor
from delfim.services.supervision.supervisor import EXIT_PERMANENT

PROGRAM = [sys.executable, str(Path(__file__).with_name("program.py"))]
DEADMAN_S = 0.5


class Event(NamedTuple):
    at_s: float
    name: str
    word: str


class Suite:
    """A supervisor and its programs."""

    def __init__(self, place: Path) -> None:
        self.record, self.state_file = place / "record", place / "state.json"
        self.watchdog, self.requests = place / "watchdog", place / "supervisor"
        self.is_namespace = False  # then nothing survives it, and its process ids are its own
        self._rows: list[tuple[str, list[str], bool, bool]] = []

    def program(self, name: str, *behaviour: str, critical: bool = False, guard: bool = False) -> None:
        self._rows.append((name, [*PROGRAM, name, str(self.record), *behaviour], critical, guard))

    def command(self, name: str, *argv: str) -> None:
        self._rows.append((name, list(argv), False, False))

    def start(
        self,
        prefix: tuple[str, ...] = (),
        *,
        subreaper: bool = False,
        deadman_s: float = 100.0,  # no test that has another subject fails because the machine is busy
        init: bool = False,
        absent_s: float = 0.0,
        unkillable: bool = False,
        **constants: float,
    ) -> None:
        """absent_s: so much later it is on its clock each time when it was stopped and goes on."""
        told = {
            "record": str(self.record),
            "subreaper": subreaper,
            "constants": constants,
            "programs": self._rows,
            "state_file": str(self.state_file),
            "deadman_s": deadman_s,
            "backoff_s": 0.05,
            "backoff_max_s": 0.2,
            "watchdog": str(self.watchdog),
            "requests": str(self.requests),
            "init": init,
            "absent_s": absent_s,
            "unkillable": unkillable,
        }
        self.process = subprocess.Popen(
            [*prefix, *PROGRAM, "supervise", json.dumps(told)], stderr=subprocess.PIPE, text=True, start_new_session=True
        )

    def events(self, name: str = "", word: str = "") -> list[Event]:
        lines = self.record.read_text().splitlines() if self.record.exists() else []
        events = [Event(float(at_s), who, what) for at_s, who, what in (line.split() for line in lines)]
        return [event for event in events if name in ("", event.name) and word in ("", event.word)]

    def state(self) -> Any:
        return json.loads(self.state_file.read_text()) if self.state_file.exists() else {"programs": {}}

    def waits(self, name: str) -> int:
        """How often a program has waited until now; it does so after each beat."""
        status = Path(f"/proc/{self.state()['programs'][name]['pid']}/status").read_text()
        return int(status.partition("\nvoluntary_ctxt_switches:")[2].split()[0])

    def terminate(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.ended()

    def ended(self) -> int:
        """Its exit code, when it has one."""
        _, self.said = self.process.communicate(timeout=200)
        return self.process.returncode


def until(condition: Callable[[], object], within_s: float = 200.0) -> None:
    """Wait for it."""
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, "it did not happen"
        select.select([], [], [], 0.005)


@pytest.fixture
def suite(tmp_path: Path) -> Iterator[Suite]:
    """What a test leaves running is ended with it."""
    suite = Suite(tmp_path)
    yield suite
    if suite.process.poll() is None:
        suite.process.kill()
        suite.process.wait()
    if suite.process.stderr:
        suite.process.stderr.close()
    for program in suite.state()["programs"].values():
        if program["pid"] > 1 and not suite.is_namespace:
            with contextlib.suppress(ProcessLookupError):
                os.kill(program["pid"], signal.SIGKILL)


@pytest.mark.parametrize(
    ("how", "where"),
    [
        ("busy", r"it stood in stall \(services/program.py:\d+\), called by run \(.*\), called by <module> \(.*\)"),
        (
            "regex",
            r"it stood in match \(re/__init__.py:\d+\), called by stall \(services/program.py:\d+\), called by run \(.*\)",
        ),
        ("holds-gil", r"it stood in stall \(services/program.py:\d+\), .*"),
        ("stopped", r"it did not say where it stood: T \(stopped\)"),
        ("hangs-up", r"it did not say where it stood: (killed by signal 12 .*|[A-Z] \(\w+\))"),  # a busy machine kills slowly
    ],
)
def test_a_stalled_runtime_is_stopped_killed_and_started_again(suite: Suite, how: str, where: str) -> None:
    began = time.monotonic()
    suite.program("runtime", f"stall={how}", critical=True)
    suite.start(deadman_s=DEADMAN_S)
    until(lambda: len(suite.events("runtime", "beat")) == 2)
    stall, stops = suite.events("runtime", "stall")[0], suite.events("bus", "stop")
    again = suite.events("runtime", "start")[1]
    until(lambda: suite.events("bus", "calm"))
    assert suite.events("bus", "calm")[0].at_s > again.at_s, "what stops the propellers is kept until the next one beats"
    assert stall.at_s < stops[0].at_s < again.at_s, "stopped before anything else is done"
    runtime, deadman = suite.state()["programs"]["runtime"], suite.state()["deadman"]
    assert runtime["restarts"] >= 1
    assert runtime["reason"] == deadman["reason"]
    assert re.fullmatch(rf"beat stopped for \d\.\d s: dead-man; {where}", runtime["reason"])
    assert deadman["at_s"] >= began
    assert suite.terminate() == 0
    assert runtime["reason"] in suite.said
    assert ("(most recent call first)" in suite.said) is ("did not say" not in where), "all stacks are in the log"


BEATS_ONCE = """import os, signal, sys
signal.alarm(100)
signal.signal(signal.SIGUSR2, signal.SIG_IGN)
os.write(int(sys.argv[3]), sys.argv[1].encode())
while True:
    signal.pause()
"""


@pytest.mark.parametrize(
    ("said", "stands_still_s", "held_s", "stopped_s", "killed_s"),
    [
        (".", 0.0, 0.0, 1.0, 1.0),
        (".", 0.7, 0.0, 1.7, 1.7),
        (".", 30.0, 0.0, 31.0, 31.0),
        (".", 0.0, 30.0, 31.0, 31.0),
        (".e", 0.0, 0.0, 0.0, supervisor.END_CRITICAL_S),
        (".l", 0.0, 0.0, 1.0, supervisor.END_CRITICAL_S),
    ],
)
def test_the_stop_frames_come_when_the_deadman_is_due_and_the_kill_a_moment_later(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    said: str,
    stands_still_s: float,
    held_s: float,
    stopped_s: float,
    killed_s: float,
) -> None:
    """On a clock of its own, that waiting alone moves: what the contract of 1.2 s leaves is the computer's, not ours. While the
    computer stands still, or we are held between a wait and a look, nobody beats, and nobody is killed for that. A runtime
    whose services have ended in order has time for its threads, and the supervisor stops the propellers meanwhile; one that has
    stopped the boat has time for its logs, and the supervisor stops the propellers when the deadman is due."""
    clock, look = ManualClock(100.0), select.select
    stops_s, kills_s, killpg = list[float](), list[float](), os.killpg
    program = children.Supervised("runtime", (sys.executable, "-c", BEATS_ONCE, said), critical=True)
    boat = supervisor.Supervisor(
        [program],
        stop=lambda: stops_s.append(clock.monotonic_s()),
        deadman_s=1.0,
        backoff_s=1.0,
        backoff_max_s=1.0,
        state_file=tmp_path / "state.json",
    )
    boat._wake, woken = os.pipe()
    boat._start_due()
    assert look([boat._children[0].pipe], [], [], 60.0)[0], "its only beat"

    def waits(read: list[int], write: list[int], error: list[int], seconds: float) -> tuple[list[int], list[int], list[int]]:
        found, before_s = look(read, write, error, 0.0), clock.monotonic_s()
        if not found[0]:
            clock.advance(seconds + 1e-6 + (stands_still_s if before_s < 100.35 <= before_s + seconds else 0.0))
        return found

    monkeypatch.setattr(supervisor.time, "monotonic", clock.monotonic_s)
    monkeypatch.setattr(supervisor.select, "select", waits)
    monkeypatch.setattr(supervisor.os, "killpg", lambda *told: (kills_s.append(clock.monotonic_s()), killpg(*told)))
    boat._turn_s = clock.monotonic_s()
    while not kills_s:
        boat._wait()
        if clock.monotonic_s() > 100.35:
            clock.advance(held_s)
            held_s = 0.0
        boat._watch_beat()
        boat._keep_stopped()
    monkeypatch.undo()
    assert os.waitpid(boat._children[0].pid, 0)[1] == signal.SIGKILL
    for fd in (boat._wake, woken):
        os.close(fd)
    assert stops_s[0] == pytest.approx(100.0 + stopped_s)
    assert kills_s == [pytest.approx(100.5 + killed_s)]  # half a second to say where it stands


def test_a_program_that_does_not_know_how_to_say_where_it_stands_ends_all_the_same(suite: Suite) -> None:
    suite.program("runtime", "stall=busy", "unarmed", critical=True)
    suite.start(deadman_s=DEADMAN_S)
    until(lambda: len(suite.events("runtime", "beat")) == 2)
    assert re.search(
        r"dead-man; it did not say where it stood: killed by signal 12", suite.state()["programs"]["runtime"]["reason"]
    )


def test_where_a_program_stood_is_the_innermost_of_its_main_thread() -> None:
    stacks = """..Thread 0x00007f01 (most recent call first):
  File "/usr/lib/python3.11/concurrent/futures/thread.py", line 81 in _worker

Current thread 0x00007f02 [main] (most recent call first):
  File "/srv/delfim/vehicle/plans/track.py", line 12 in crossing
  File "/srv/delfim/vehicle/loop.py", line 34 in <genexpr>
  File "<frozen runpy>", line 88 in _run_code
  File "/srv/delfim/__main__.py", line 1 in <module>
"""
    innermost = ("crossing (plans/track.py:12)", "<genexpr> (vehicle/loop.py:34)", "_run_code (<frozen runpy>:88)")
    assert children.stood(stacks) == "it stood in " + ", called by ".join(innermost)
    assert children.stood("") == children.stood("....") == children.stood(stacks[:40]) == ""


def test_stop_frames_are_repeated_until_a_runtime_beats_again(suite: Suite) -> None:
    suite.program("runtime", "exit=1", critical=True)
    suite.start(STOP_EVERY_S=0.01)
    until(lambda: len(suite.events("runtime", "beat")) == 2)
    ordered = [event.word for event in suite.events()]
    first, second = (i for i, word in enumerate(ordered) if word == "beat")
    assert "stop" not in ordered[:first]
    assert ordered[first + 1 : second].count("stop") > 3


def test_a_runtime_that_never_beats_is_killed_after_its_grace(suite: Suite) -> None:
    suite.program("runtime", "mute", critical=True)
    suite.start(START_S=0.5)
    until(lambda: len(suite.events("runtime", "start")) == 2)
    assert re.match(r"no beat for \d+\.\d s: dead-man; it ", suite.state()["programs"]["runtime"]["reason"])


@pytest.mark.parametrize("how", ["busy", "stopped"])
def test_a_silent_guard_is_killed_and_started_again_and_the_runtime_goes_on(suite: Suite, how: str) -> None:
    suite.program("runtime", critical=True)
    suite.program("outlet", f"stall={how}", guard=True)
    suite.start(deadman_s=DEADMAN_S)
    until(lambda: len(suite.events("outlet", "beat")) == 2)
    told = suite.state()
    assert re.match(r"beat stopped for \d\.\d s: dead-man; it ", told["programs"]["outlet"]["reason"])
    assert (told["programs"]["outlet"]["restarts"], told["programs"]["runtime"]["restarts"]) == (1, 0)
    assert told["deadman"] is None
    assert suite.events("bus") == []


def test_a_guard_that_outlives_its_kill_has_its_motors_cut_off_until_another_one_beats(suite: Suite) -> None:
    suite.program("runtime", critical=True)
    suite.program("outlet", "stall=stopped", guard=True)
    suite.start(deadman_s=DEADMAN_S, unkillable=True, KILL_S=0.2)
    until(lambda: suite.events("bus", "cut"))
    words = "does not answer, and cannot be killed: T (stopped); THE MOTORS MAY TURN: cut off"
    until(lambda: suite.state()["programs"]["outlet"]["reason"] == words)
    assert suite.state()["programs"]["runtime"]["restarts"] == 0
    os.kill(suite.state()["programs"]["outlet"]["pid"], signal.SIGKILL)
    until(lambda: suite.events("bus", "uncut"))
    assert suite.events("bus", "uncut")[0].at_s > suite.events("outlet", "beat")[1].at_s
    assert len(suite.events("bus", "cut")) == 1
    suite.terminate()
    assert f"outlet: {words}" in suite.said


def test_a_guard_that_hangs_at_the_end_is_started_once_more_to_stop_its_motors(suite: Suite) -> None:
    suite.program("runtime", critical=True)
    suite.program("outlet", guard=True)
    suite.start(END_S=0.2)
    until(lambda: len(suite.events(word="beat")) == 2)
    os.kill(suite.state()["programs"]["outlet"]["pid"], signal.SIGSTOP)
    assert suite.terminate() == 0
    assert [event.word for event in suite.events("outlet") if event.word != "beat"] == ["start", "start", "end"]


def test_another_program_may_be_silent_for_longer_and_is_then_killed_and_started_again(suite: Suite) -> None:
    suite.program("runtime", critical=True)
    suite.program("sshd", "stall=stopped")
    suite.start(SILENT_S=DEADMAN_S)
    until(lambda: len(suite.events("sshd", "beat")) == 2)
    sshd = suite.state()["programs"]["sshd"]
    assert re.fullmatch(r"beat stopped for .* s: killed; it did not say where it stood: T \(stopped\)", sshd["reason"])
    assert suite.state()["programs"]["runtime"]["restarts"] == 0
    assert suite.events("bus") == []


def test_the_silence_of_other_programs_is_told_before(suite: Suite) -> None:
    suite.program("runtime", critical=True)
    suite.program("sshd", "stall=stopped")
    suite.start(deadman_s=DEADMAN_S)
    until(lambda: suite.state()["programs"].get("sshd", {}).get("reason") == "does not answer")
    os.kill(suite.state()["programs"]["sshd"]["pid"], signal.SIGCONT)
    until(lambda: suite.state()["programs"]["sshd"]["reason"].startswith("did not answer for "))
    assert suite.state()["programs"]["sshd"]["restarts"] == 0
    assert suite.state()["programs"]["runtime"]["reason"] == ""


@pytest.mark.parametrize(
    ("behaviour", "reason"), [("exit=1", "exit code 1"), ("killed", "killed by signal 9 (Killed)"), ("exit=77", "exit code 77")]
)
def test_what_dies_is_started_again_and_the_reason_kept(suite: Suite, behaviour: str, reason: str) -> None:
    suite.program("runtime", critical=True)
    suite.program("sshd", behaviour)
    suite.start()
    until(lambda: len(suite.events("sshd", "start")) == 2)
    sshd = suite.state()["programs"]["sshd"]
    assert (sshd["reason"], sshd["restarts"]) == (reason, 1)
    assert suite.state()["programs"]["runtime"]["restarts"] == 0
    assert suite.events("bus") == []
    suite.terminate()
    assert f"sshd: {reason}; started again in 0.05 s" in suite.said


def test_a_program_that_cannot_be_started_is_tried_again(suite: Suite) -> None:
    suite.command("sshd", "/does/not/exist")
    suite.start()
    until(lambda: suite.state()["programs"].get("sshd", {}).get("restarts", 0) >= 2)
    assert suite.state()["programs"]["sshd"]["reason"] == "cannot be started: No such file or directory"


def test_the_critical_program_comes_up_alone(suite: Suite) -> None:
    suite.program("sshd")
    suite.program("runtime", critical=True)
    suite.start()
    until(lambda: suite.events("sshd", "start"))
    assert suite.events("runtime", "beat")[0].at_s < suite.events("sshd", "start")[0].at_s


def test_a_signal_ends_the_runtime_first_then_stops_the_propellers_then_ends_the_others(suite: Suite) -> None:
    suite.program("sshd")
    suite.program("ftpd")
    suite.program("runtime", critical=True)
    suite.start()
    until(lambda: len(suite.events(word="beat")) == 3)
    assert next(iter(suite.state()["programs"])) == "runtime"  # started first
    assert suite.terminate() == 0
    end = [(event.name, event.word) for event in suite.events()[-20:] if event.word in ("end", "stop")]
    assert list(dict.fromkeys(end)) == [("runtime", "end"), ("bus", "stop"), ("ftpd", "end"), ("sshd", "end")]
    assert {program["state"] for program in suite.state()["programs"].values()} == {"stopped"}
    assert all(program["pid"] == 0 for program in suite.state()["programs"].values())


def test_the_end_is_bounded(suite: Suite) -> None:
    suite.program("runtime", "deaf", critical=True)
    suite.program("sshd", "deaf")
    suite.start(END_CRITICAL_S=0.2, END_S=0.2)
    until(lambda: len(suite.events(word="beat")) == 2)
    assert suite.terminate() == 0
    assert {program["reason"] for program in suite.state()["programs"].values()} == {"did not end in 0.2 s"}
    assert suite.events("bus", "stop")


def test_the_deadman_is_awake_while_the_runtime_ends(suite: Suite) -> None:
    suite.program("runtime", critical=True)
    suite.start(deadman_s=DEADMAN_S)
    until(lambda: suite.events("runtime", "beat"))
    os.kill(suite.state()["programs"]["runtime"]["pid"], signal.SIGSTOP)
    assert suite.terminate() == 0
    assert "dead-man" in suite.state()["programs"]["runtime"]["reason"], "and not that it did not end in order"
    assert suite.events("bus", "stop")


def test_a_runtime_without_supervisor_learns_of_it(suite: Suite) -> None:
    suite.program("runtime", critical=True)
    suite.program("sshd")
    suite.start()
    until(lambda: len(suite.events(word="beat")) == 2)
    suite.process.kill()
    until(lambda: len(suite.events(word="abandoned")) == 2)


def test_programs_are_idle_but_the_critical_one_and_have_a_session_of_their_own(suite: Suite) -> None:
    suite.program("runtime", critical=True)
    suite.program("sshd")
    suite.start()
    until(lambda: len(suite.events(word="beat")) == 2)
    for name, policy in (("runtime", os.SCHED_OTHER), ("sshd", os.SCHED_IDLE)):
        pid = suite.state()["programs"][name]["pid"]
        assert os.sched_getscheduler(pid) == policy
        assert os.getsid(pid) == pid
    suite.terminate()
    assert suite.events(word="end")
    assert os.geteuid() or not suite.events(word="idles"), "who has little time to end competes for the processor"


def test_a_guard_starts_at_once_is_not_idle_and_ends_last(suite: Suite) -> None:
    suite.program("runtime", "mute", critical=True)
    suite.program("outlet", guard=True)
    suite.program("sshd")
    suite.start(HEAD_START_S=0.5)
    until(lambda: suite.events("sshd", "beat"))
    starts = [event.name for event in suite.events(word="start")]
    assert (set(starts[:2]), starts[2]) == ({"runtime", "outlet"}, "sshd")
    assert os.sched_getscheduler(suite.state()["programs"]["outlet"]["pid"]) == os.SCHED_OTHER
    assert suite.terminate() == 0
    assert [event.name for event in suite.events(word="end")] == ["runtime", "sshd", "outlet"]
    assert suite.events("bus", "stop")[-1].at_s < suite.events("outlet", "end")[0].at_s, "there is nobody left to tell"


@pytest.mark.parametrize(("word", "reason"), [("off", "button"), ("reboot", "command of somebody"), ("end", "")])
def test_a_request_ends_all_and_is_kept(suite: Suite, word: shutdown.Word, reason: str) -> None:
    suite.program("runtime", critical=True)
    suite.program("sshd")
    suite.start()
    until(lambda: len(suite.events(word="beat")) == 2)
    shutdown.request(suite.requests, word, reason)
    assert suite.ended() == 0
    end = [(event.name, event.word) for event in suite.events()[-10:] if event.word in ("end", "stop")]
    assert list(dict.fromkeys(end)) == [("runtime", "end"), ("bus", "stop"), ("sshd", "end")]
    assert f"ended by {word!r}, {reason!r}" in suite.said


@pytest.mark.parametrize("text", [b"", b"shutdown", b"OFF now", b"\xff\xfe", b"off" * 2000])
def test_a_request_that_is_none_ends_nothing(suite: Suite, text: bytes) -> None:
    suite.program("runtime", critical=True)
    suite.start()
    until(lambda: suite.events("runtime", "beat"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        asking.sendto(text, str(suite.requests))
        asking.sendto(b"end test", str(suite.requests))
    assert suite.ended() == 0
    assert "ended by 'end', 'test'" in suite.said


@pytest.mark.parametrize(
    ("init", "number", "word"),
    [
        (False, signal.SIGTERM, "end"),
        (False, signal.SIGINT, "end"),
        (False, signal.SIGHUP, "end"),
        (False, signal.SIGPWR, "off"),
        (True, signal.SIGTERM, "reboot"),
        (True, signal.SIGINT, "reboot"),
        (True, signal.SIGUSR1, "off"),
        (True, signal.SIGUSR2, "off"),
        (True, signal.SIGPWR, "off"),
    ],
)
def test_what_a_signal_means(suite: Suite, init: bool, number: signal.Signals, word: str) -> None:
    suite.program("runtime", critical=True)
    suite.start(init=init)
    until(lambda: suite.events("runtime", "beat"))
    suite.process.send_signal(number)
    assert suite.ended() == 0
    assert f"ended by {word!r}, {number.name!r}" in suite.said


@pytest.mark.parametrize("code", [0, EXIT_PERMANENT])
def test_the_first_process_of_a_machine_does_not_end_by_itself(suite: Suite, code: int) -> None:
    """A runtime that ended is started again; one that cannot be leaves the propellers stopped and the rest running."""
    suite.program("runtime", f"exit={code}", critical=True)
    suite.program("sshd")
    suite.start(init=True)
    if code == 0:
        until(lambda: len(suite.events("runtime", "beat")) >= 2)
    else:
        until(lambda: suite.state()["programs"].get("runtime", {}).get("state") == "failed")
        stops = len(suite.events("bus", "stop"))
        until(lambda: len(suite.events("bus", "stop")) > stops + 2)
    assert suite.process.poll() is None
    assert suite.state()["programs"]["sshd"]["state"] == "running"
    assert suite.terminate() == 0


def may_make_a_namespace() -> bool:
    command = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "true"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def zombies_below(pid: int) -> list[str]:
    """The names of dead processes that a descendant of this one has not reaped."""
    rows = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            text = path.read_text()
            state, parent = text.rpartition(")")[2].split()[:2]
            rows[int(path.parent.name)] = (int(parent), state, text.partition("(")[2].rpartition(")")[0])
    family = {pid}
    while more := {each for each, row in rows.items() if row[0] in family} - family:
        family |= more
    return [rows[each][2] for each in family if each in rows and rows[each][1] == "Z"]


def test_orphans_are_reaped(suite: Suite) -> None:
    """As PID 1 of a namespace, or where the machine forbids namespaces, as their appointed reaper."""
    suite.program("runtime", "orphan", critical=True)
    is_allowed = may_make_a_namespace()
    prefix = ("unshare", "--user", "--map-root-user", "--pid", "--fork", "--kill-child") if is_allowed else ()
    suite.is_namespace = is_allowed
    suite.start(prefix, subreaper=not is_allowed)
    until(lambda: suite.events("runtime", "orphan-ends"))
    until(lambda: zombies_below(suite.process.pid) == [])
    assert suite.state()["programs"]["runtime"]["state"] == "running"
    if is_allowed:
        assert suite.state()["pid"] == 1


def test_the_hardware_watchdog_is_stroked_and_let_go_in_order(suite: Suite) -> None:
    suite.watchdog.touch()
    suite.program("runtime", critical=True)
    suite.start()
    until(lambda: len(suite.watchdog.read_bytes()) > 3)
    assert set(suite.watchdog.read_bytes()) == {0}
    assert suite.terminate() == 0
    assert suite.watchdog.read_bytes().strip(b"\0") == b"V"


def test_a_supervisor_that_dies_leaves_the_watchdog_armed(suite: Suite) -> None:
    suite.watchdog.touch()
    suite.program("runtime", critical=True)
    suite.start()
    until(lambda: suite.events("runtime", "beat"))
    suite.process.kill()
    suite.process.wait()
    assert b"V" not in suite.watchdog.read_bytes()


def test_a_supervisor_that_is_stopped_strokes_no_watchdog_and_holds_nobody_up(suite: Suite) -> None:
    """So the hardware resets the computer. Where there is none, the runtime sails on without its dead-man; when the supervisor
    goes on, it must not take its own absence for the runtime's."""
    suite.watchdog.touch()
    suite.program("runtime", critical=True)
    suite.start(absent_s=60.0)
    until(lambda: suite.events("runtime", "beat"))
    until(lambda: len(suite.watchdog.read_bytes()) > 3)
    suite.process.send_signal(signal.SIGSTOP)
    until(lambda: Path(f"/proc/{suite.process.pid}/stat").read_text().rpartition(")")[2].split()[0] == "T")
    strokes, waits = suite.watchdog.read_bytes(), suite.waits("runtime")
    until(lambda: suite.waits("runtime") > waits + 10)
    assert suite.watchdog.read_bytes() == strokes
    assert b"V" not in strokes
    suite.process.send_signal(signal.SIGCONT)
    until(lambda: len(suite.watchdog.read_bytes()) > len(strokes) + 3)
    assert suite.state()["programs"]["runtime"]["restarts"] == 0
    assert suite.events("bus", "stop") == []
    assert len(suite.events("runtime", "start")) == 1
