"""The supervisor: the parent of all programs, and the dead-man. It can run as PID 1.

It starts the programs, each in a session of its own, and restarts those that die. Every program gets `--beat-fd N`, the
write end of a pipe, and beats on it. When the beat stops, whatever the reason, the supervisor has the program write into the
pipe where its threads stand and die of it, kills it STACKS_S later if it did not (a guard sooner), and starts it again. That
is the dead-man of the critical one, whose propellers it stops first, and of a guard; any other may be silent for longer. A
guard that even the kernel cannot end has its motors cut off. A program whose pipe breaks knows that the supervisor is gone.

It ends on a signal or on a word at its socket (delfim.services.supervision.shutdown), the critical program first; the caller
does the rest. It does not handle dependencies or logs. It never waits for anything but time and its children.
"""

import logging
import os
import select
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Final, Literal, cast, get_args

from delfim.services.supervision.children import (
    LAST_WORD,
    LEAVES,
    STACKS_SIGNAL,
    Child,
    Supervised,
    ended,
    process_state,
    stood,
)
from delfim.services.supervision.shutdown import Word, listening
from delfim.services.supervision.supervisorfile import write_state
from delfim.services.supervision.watchdog import Watchdog

EXIT_PERMANENT: Final = 100  # of a program: do not start me again
START_S: Final = 60.0  # the critical program and a guard may take so long to the first beat: a slow board, a slow card
START_OTHERS_S: Final = 300.0  # the others come up together, and have what the critical one leaves of the processor
SILENT_S: Final = 30.0  # then one of these is killed and started again
HEAD_START_S: Final = 5.0  # the others wait so long for its first beat: until then it has the processor to itself
STOP_EVERY_S: Final = 0.1  # between two stop frames while nothing beats
STACKS_S: Final = 0.5  # for a silent program to write where its threads stand (busy machines); stop frames are already sent
GUARD_STACKS_S: Final = 0.1  # for one whose motors nobody else stops
TICK_S: Final = 0.1  # the longest wait: the hardware watchdog is fed this often, and a later wake-up was forced on us
END_CRITICAL_S: Final = 5.0  # for the critical program to end in order
END_S: Final = 2.0  # for another program
KILL_S: Final = 1.0  # for the kernel to end killed processes
REQUEST_BYTES: Final = 4096

# The effect of each signal: for the machine's first process as busybox' poweroff and reboot, ctrl-alt-del and a UPS send them.
SIGNALS: Final[dict[int, Word]] = {
    signal.SIGTERM: "end",
    signal.SIGINT: "end",
    signal.SIGHUP: "end",
    signal.SIGPWR: "off",
}
INIT_SIGNALS: Final[dict[int, Word]] = {
    signal.SIGTERM: "reboot",
    signal.SIGINT: "reboot",
    signal.SIGUSR1: "off",
    signal.SIGUSR2: "off",
    signal.SIGPWR: "off",
}

log = logging.getLogger(__name__)


class Supervisor:
    """The supervisor of a boat; `run_forever` does it all.

    stop: sends frames that stop the propellers; its exceptions are logged, and the rest goes on.
    calm: called when the runtime beats again after stops: what they opened can be closed.
    cut: takes the motors of a guard their power or their pulses (True), or gives it back. Returns what that came to, in words.
    state_file: JSON for the other programs, replaced at each change.
    watchdog: device, "" for none; if it does not exist there is none.
    requests: UNIX socket for "off REASON" and the like; None for none.
    init: the first process of a machine. It ends only when it is told to.

    `word` and `reason` name afterwards the request that ended it; "" if it ended by itself.
    """

    def __init__(
        self,
        programs: Sequence[Supervised],
        *,
        stop: Callable[[], None],
        calm: Callable[[], None] = lambda: None,
        cut: Callable[[bool], str] = lambda off: "",
        deadman_s: float,
        backoff_s: float,
        backoff_max_s: float,
        state_file: Path,
        watchdog: str = "",
        requests: Path | None = None,
        init: bool = False,
    ) -> None:
        self._children = [Child(program) for program in sorted(programs, key=lambda program: not program.critical)]
        self._critical = next((child for child in self._children if child.program.critical), None)
        self._stop, self._calm, self._stop_error = stop, calm, ""
        self._cut, self._is_cut = cut, False
        self._deadman_s, self._backoff_s, self._backoff_max_s = deadman_s, backoff_s, backoff_max_s
        self._state_file = state_file
        self._watchdog = Watchdog(watchdog)
        self._deadman: dict[str, object] | None = None  # last event
        self._stop_due_s: float | None = None  # when to send stop frames again; None: the critical program is in charge
        self._init, self._signals = init, INIT_SIGNALS if init else SIGNALS
        self._requests = listening(requests) if requests else None
        self.word: Word | Literal[""] = ""
        self.reason = ""
        self._is_ending = False
        self._turn_s = time.monotonic()  # when the last wait was over

    def run_forever(self) -> int:
        """Supervise until a signal asks for the end, the critical program ended in order, or nothing is left that could be
        started. Returns the exit code: EXIT_PERMANENT where a program must not be started again, otherwise 0."""
        self._catch_signals()
        try:
            while not self._done():
                self._start_due()
                self._wait()
                self._watch_beat()
                self._keep_stopped()
        finally:
            self._end()
        self._watchdog.stroke(b"V")  # magic close; an end that was not in order leaves it to the hardware to start again
        failed = any(child.state == "failed" for child in self._children)
        return EXIT_PERMANENT if failed and not self.word else 0

    def _catch_signals(self) -> None:
        self._wake, woken = os.pipe()  # readable when a signal came
        os.set_blocking(woken, False)
        signal.set_wakeup_fd(woken, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        for number in self._signals:
            signal.signal(number, lambda number, _: self._asked(self._signals[number], signal.Signals(number).name))

    def _asked(self, word: Word, reason: str) -> None:
        """Take a request to end; the first one counts."""
        if not self.word:
            self.word, self.reason = word, reason

    def _on_request(self, text: bytes) -> None:
        word, _, reason = text.decode(errors="replace").partition(" ")
        if word in get_args(Word):
            log.warning("supervisor: %s: %s", word, reason)
            self._asked(cast(Word, word), reason)
        else:
            log.error("supervisor: not a request: %r", word[:20])

    def _done(self) -> bool:
        if self.word or self._init:
            return bool(self.word)
        if self._critical and self._critical.state == "stopped":
            return True
        return all(child.state in ("stopped", "failed") for child in self._children)

    # Programs.

    def _start_due(self) -> None:
        for child in self._children:
            if child.state == "waiting" and self._due_s(child) <= time.monotonic():
                self._start(child)

    def _due_s(self, child: Child) -> float:
        """The time when it is to be started: while the critical program comes up, the others wait."""
        first = self._critical
        if first is None or child is first or child.program.guard or first.state != "running" or first.beat_s is not None:
            return child.start_s
        return max(child.start_s, first.start_s + HEAD_START_S)

    def _start(self, child: Child) -> None:
        try:
            child.spawn()
        except OSError as error:
            self._died(child, 1, f"cannot be started: {error.strerror}")
        else:
            log.info("%s: started as process %d", child.program.name, child.pid)
            self._change(child, "running")

    def _reap(self) -> None:
        """Reap every process that ended, also those that PID 1 inherited."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if pid == 0:
                return
            for child in self._children:
                if child.pid == pid:
                    code = os.waitstatus_to_exitcode(status)
                    self._died(child, code, child.program.limits.exceeded(child.program.name) or ended(code))

    def _died(self, child: Child, code: int, reason: str) -> None:
        now_s = time.monotonic()
        if child.kill_s < inf:
            self._finish(child, reason)
        child.hang_up()
        child.pid, child.reason = 0, child.verdict or reason
        if child.program.critical:
            self._stop_due_s = now_s
        in_order = code == 0 and not child.verdict and not (self._init and child.program.critical)
        if self._is_ending or in_order:
            log.info("%s: ended: %s", child.program.name, child.reason)
            self._change(child, "stopped")
        elif code == EXIT_PERMANENT:
            log.error("%s: %s: not to be started again", child.program.name, child.reason)
            self._change(child, "failed")
        else:
            if child.verdict and child.is_urgent:
                child.pause_s = 0.0  # deadman_s paces it
            elif now_s - child.start_s > self._backoff_max_s:
                child.pause_s = self._backoff_s
            else:
                child.pause_s = min(max(2 * child.pause_s, self._backoff_s), self._backoff_max_s)
            child.start_s, child.restarts = now_s + child.pause_s, child.restarts + 1
            log.error("%s: %s; started again in %g s", child.program.name, child.reason, child.pause_s)
            self._change(child, "waiting")

    def _kill(self, child: Child, verdict: str) -> None:
        """Kill the whole group. Its log writers live in sessions of their own and finish what they were given."""
        child.verdict, child.dead_s = verdict, time.monotonic() + KILL_S
        log.critical("%s: %s", child.program.name, verdict)
        os.killpg(child.pid, signal.SIGKILL)

    # The dead-man.

    def _deadline_s(self, child: Child) -> float:
        """The time when it has been silent for too long; after that, when it is killed, and when it should be dead."""
        if child.state != "running":
            return inf
        if child.verdict:
            return min(child.kill_s, child.dead_s)
        if child.beat_s is None:
            return child.start_s + (START_S if child.is_urgent else START_OTHERS_S)
        if child.is_leaving and child.program.critical:
            return child.beat_s + END_CRITICAL_S
        return child.beat_s + (self._deadman_s if child.is_urgent else SILENT_S)

    def _watch_beat(self) -> None:
        """Check the beats, unless the processor was taken from us since the wait was over: that took the beats from us, too."""
        now_s = min(time.monotonic(), self._turn_s + TICK_S)
        for child in self._children:
            if now_s >= self._deadline_s(child):
                self._overdue(child, now_s)
            elif child.state != "running" or child.is_urgent or child.is_silent or child.beat_s is None:
                pass
            elif now_s - child.beat_s > self._deadman_s:
                self._noted(child, "does not answer", is_silent=True)

    def _overdue(self, child: Child, now_s: float) -> None:
        """Act on a silent program: the propellers of the critical one are stopped at once, it is asked where it stands, and
        killed."""
        if child.kill_s < inf:
            self._finish(child, process_state(child.pid))
        elif child.verdict:
            self._outlives(child)
        else:
            silent_s = now_s - (child.start_s if child.beat_s is None else child.beat_s)
            words = "dead-man" if child.is_urgent else "killed"
            child.verdict = f"{'no beat' if child.beat_s is None else 'beat stopped'} for {silent_s:.1f} s: {words}"
            child.kill_s = now_s + (GUARD_STACKS_S if child.program.guard else STACKS_S)
            if child.program.critical:
                self._stop_due_s = now_s
            os.kill(child.pid, STACKS_SIGNAL)

    def _outlives(self, child: Child) -> None:
        """Note that it waits in the kernel for hardware that does not answer, and is killed when that does."""
        child.dead_s = inf
        words = f"does not answer, and cannot be killed: {process_state(child.pid)}"
        if child.program.guard:
            self._is_cut = True
            words += f"; THE MOTORS MAY TURN: {self._cut(True)}"
        self._noted(child, words, is_silent=True)

    def _finish(self, child: Child, otherwise: str) -> None:
        """Kill a program that survived the question, and all its group; log where it stood, or its state, and all
        stacks."""
        child.kill_s, child.dead_s = inf, time.monotonic() + KILL_S
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        stacks = child.stacks()
        child.verdict += f"; {stood(stacks) or f'it did not say where it stood: {otherwise}'}"
        if child.program.critical:
            self._deadman = {"reason": child.verdict, "at_s": time.monotonic()}
        log.critical("%s: %s", child.program.name, child.verdict)
        for thread in filter(None, stacks.split("\n\n")):
            log.critical("%s", thread)

    def _noted(self, child: Child, reason: str, *, is_silent: bool) -> None:
        child.reason, child.is_silent = reason, is_silent
        log.error("%s: %s", child.program.name, reason)
        self._tell()

    def _keep_stopped(self) -> None:
        """Send stop frames again and again, until a critical program beats."""
        now_s = time.monotonic()
        if self._stop_due_s is not None and now_s >= self._stop_due_s:
            self._stop_now()
            self._stop_due_s = now_s + STOP_EVERY_S

    def _stop_now(self) -> None:
        try:
            self._stop()
            self._stop_error = ""
        except Exception as error:  # whatever fails on the bus, killing and restarting go on
            if str(error) != self._stop_error:
                log.error("stop frames: %s", error)
                self._stop_error = str(error)

    # Time.

    def _wait(self) -> None:
        """Wait for a beat, a death, a signal, or the next deadline."""
        now_s = time.monotonic()
        due_s = [self._due_s(child) for child in self._children if child.state == "waiting"]
        due_s += [now_s + TICK_S, *map(self._deadline_s, self._children), inf if self._stop_due_s is None else self._stop_due_s]
        pipes = {child.pipe: child for child in self._children if child.pipe >= 0 and not child.verdict}
        requests = [self._requests.fileno()] if self._requests else []
        wait_s = max(0.0, min(due_s) - now_s)
        readable, _, _ = select.select([self._wake, *requests, *pipes], [], [], wait_s)
        self._excuse(wait_s)
        for fd in readable:
            told = os.read(fd, REQUEST_BYTES)
            if fd in requests:
                self._on_request(told)
            elif fd != self._wake:
                self._on_beat(pipes[fd], told) if told else self._on_closed(pipes[fd])
        self._reap()
        self._watchdog.stroke(b"\0")

    def _excuse(self, wait_s: float) -> None:
        """Excuse the programs after a turn that took longer than its wait: the computer stood still, or gave the processor to
        others. Programs that could not beat then are not silent; beats that we could not hear are unknown."""
        now_s = time.monotonic()
        lost_s, self._turn_s = max(0.0, now_s - self._turn_s - wait_s), now_s
        for child in self._children:
            if child.beat_s is not None:
                child.beat_s = min(child.beat_s + lost_s, now_s)

    def _on_beat(self, child: Child, told: bytes) -> None:
        now_s = time.monotonic()
        if child.is_silent and child.beat_s is not None:
            self._noted(child, f"did not answer for {now_s - child.beat_s:.1f} s", is_silent=False)
        if child.program.guard and self._is_cut and child.beat_s is not None:  # since its first one it has written neutral
            self._is_cut = False
            log.warning("%s: beats again: %s", child.program.name, self._cut(False))
        child.beat_s, child.is_leaving = now_s, told.endswith((LEAVES, LAST_WORD))
        if child.program.critical and child.is_leaving:  # it commands nothing more: the propellers are ours, when it is silent
            self._stop_due_s = now_s + (0.0 if told.endswith(LAST_WORD) else self._deadman_s)
        elif child.program.critical and self._stop_due_s is not None:
            self._stop_due_s = None
            self._calm()

    def _on_closed(self, child: Child) -> None:
        """Take the end of a beat: the program is gone, or beats no more. The propellers are stopped before it is reaped, for
        which the kernel may take a second while somebody looks at its files in /proc."""
        child.hang_up()
        if child.program.critical:
            self._stop_due_s = time.monotonic()
            self._keep_stopped()

    def _end(self) -> None:
        """End in order and bounded: the critical program first, which stops the propellers itself; then they are stopped
        again."""
        self._is_ending = True
        for child in self._children:
            if child.state == "waiting":  # no longer: who is due, and not started, would keep us from waiting
                self._change(child, "stopped")
        critical = [child for child in self._children if child.program.critical]
        for child in critical + [child for child in reversed(self._children) if not child.program.critical]:
            if child.program.guard:
                self._end_guard(child)
                continue
            self._end_child(child, END_CRITICAL_S if child.program.critical else END_S)
            if child.program.critical:
                self._stop_due_s = time.monotonic()  # until the others have ended, too
                self._keep_stopped()

    def _end_guard(self, child: Child) -> None:
        """End the outlet. It stops its motors as it ends, and takes no stop any more. One that died of anything else left them
        as they were: it is started once more, and begins with neutral."""
        self._stop_due_s = None
        self._end_child(child, END_S)
        if child.pid and child.dead_s < inf:
            self._outlives(child)
        elif not child.pid and child.state != "failed" and child.reason != ended(0):
            self._start(child)
            while child.pid and child.beat_s is None and time.monotonic() < child.start_s + END_CRITICAL_S:
                self._wait()
            self._end_child(child, END_S)

    def _end_child(self, child: Child, patience_s: float) -> None:
        if child.pid:
            child.hurry()
            os.kill(child.pid, signal.SIGTERM)
        until_s = time.monotonic() + patience_s
        while child.pid and (now_s := time.monotonic()) < until_s + KILL_S:
            self._wait()
            self._watch_beat()
            self._keep_stopped()
            if child.pid and now_s > until_s and not child.verdict:
                self._kill(child, f"did not end in {patience_s:g} s")

    # The state for other programs.

    def _change(self, child: Child, state: Literal["waiting", "running", "stopped", "failed"]) -> None:
        child.state, child.since_s = state, time.monotonic()
        self._tell()

    def _tell(self) -> None:
        try:
            write_state(self._state_file, self._children, self._deadman)
        except OSError as error:
            log.error("%s: %s", self._state_file, error.strerror)
