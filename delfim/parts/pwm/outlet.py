"""The outlet: a process for motors that keep their last command for ever. It writes their pulses, stops them when nobody sends,
and does nothing else (docs/pwm.md).

A pulse stands until another one is written, whatever becomes of the program behind it. So the runtime does not write it: it
sends a record each cycle, and here every channel goes to neutral after SILENT_S without a new command, when a sender repeats
an old one, when its connection ends, at SIGTERM, and when the supervisor is gone. Everybody may stop at any time; the last who
commands holds the motors. After the start, and after a fault of the hardware, channels stay neutral for `pwm.arm_s`: an ESC
arms by that.

The death of this process leaves a pulse standing until the supervisor has started it again, which begins with neutral; that
it hangs, until the supervisor's dead-man has killed it. Against a bus that holds it in the kernel there is `pwm.cut`, and
against the death of the computer only hardware: the kill relay.
"""

import logging
import os
import select
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Final

from delfim.base.errors import DelfimError, FormatError, in_words
from delfim.base.pulses import SILENT_S, PulseAnswer, pack_answer, unpack_command
from delfim.parts.pwm.pulseports import PulsePort, open_port
from delfim.parts.pwm.table import Pwm, PwmChannel

TICK_S: Final = 0.1  # at most between two looks at the clock, and between two writes of standing pulses
REOPEN_S: Final = 1.0  # between two attempts to open hardware that failed
CLIENTS: Final = 4  # the runtime, the supervisor, and two at the bench
RECORDS: Final = 64  # of one client, read at once: only the last one counts
RECORD_BYTES: Final = 256

log = logging.getLogger(__name__)


class Guard:
    """Decides from the records, and their age, whether motors may turn. Times are monotonic."""

    def __init__(self) -> None:
        self.counter = 0  # of the last command
        self._holder: object = None
        self._counters = dict[object, int]()
        self._heard_s = -inf
        self._fractions: tuple[float, ...] | None = None

    def hear(self, sender: object, data: bytes, now_s: float) -> None:
        """Take a record. Raises FormatError; such a record changes nothing."""
        command = unpack_command(data)
        self.counter = command.counter
        if not command.run:
            self._fractions = None
        elif self._counters.get(sender) != command.counter:
            self._holder, self._heard_s, self._fractions = sender, now_s, command.fractions
        self._counters[sender] = command.counter

    def lose(self, sender: object) -> None:
        """Note the end of a connection."""
        self._counters.pop(sender, None)
        if sender is self._holder:
            self._holder = self._fractions = None

    def fractions(self, now_s: float) -> tuple[float, ...] | None:
        """The command of each channel, -1 to 1; None: stop."""
        if now_s - self._heard_s > SILENT_S:
            self._fractions = None
        return self._fractions


class Channels:
    """The hardware, opened again when it fails, and the pulses of its channels."""

    def __init__(self, pwm: Pwm, channels: tuple[int, ...], opened: Callable[..., PulsePort] = open_port) -> None:
        self._pwm, self._open = pwm, opened
        self._tables = {each: pwm.channel.get(str(each), PwmChannel()) for each in channels}
        self._neutral = {each: table.neutral_us for each, table in self._tables.items()}
        self._port: PulsePort | None = None
        self._again_s = -inf
        self.state, self.trouble = "stopped", "not open yet"

    def put(self, fractions: tuple[float, ...] | None, now_s: float) -> None:
        """Write pulses; None: neutral. A failure is kept as `trouble`, and the hardware opened anew after REOPEN_S."""
        try:
            if self._port is None:
                if now_s < self._again_s:
                    return
                self._again_s = now_s + REOPEN_S
                self._port = self._open(self._pwm, self._neutral)
                self._armed_s = now_s + self._pwm.arm_s  # until then it stays neutral
                self._tell("")
            self.state = "stopped" if fractions is None else "arming" if now_s < self._armed_s else "running"
            running = fractions if self.state == "running" else None
            self._port.put(self._neutral if running is None else {n: t.pulse_us(running[n]) for n, t in self._tables.items()})
        except (OSError, DelfimError) as error:
            self._lose(in_words(error))

    def close(self) -> None:
        """Set neutral, for as long as the hardware keeps it."""
        self.put(None, inf)
        if self._port is not None:
            self._port.close()

    def _lose(self, why: str) -> None:
        self.state = "stopped"
        self._tell(why)
        if self._port is not None:
            with suppress(OSError):
                self._port.close()
            self._port = None

    def _tell(self, trouble: str) -> None:
        if trouble != self.trouble:
            log.log(logging.ERROR if trouble else logging.INFO, "outlet: %s", trouble or f"{self._pwm.chip} is open")
        self.trouble = trouble


class OutletServer:
    """The socket of the outlet and those connected to it."""

    def __init__(self, path: Path, channels: Channels) -> None:
        """Listen. Raises OSError where it cannot."""
        self._channels, self._guard, self._malformed = channels, Guard(), 0
        self._clients = list[socket.socket]()
        path.unlink(missing_ok=True)
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listening.bind(str(path))
        os.chmod(path, 0o600)
        self._listening.listen(CLIENTS)
        self._listening.setblocking(False)

    def serve(self, ended: Callable[[], str]) -> str:
        """Serve until `ended` gives a reason, in words; then set neutral. Returns the reason."""
        channels, guard = self._channels, self._guard
        while not (why := ended()):
            channels.put(guard.fractions(now_s := time.monotonic()), now_s)
            readable, _, _ = select.select([self._listening, *self._clients], [], [], TICK_S)
            spoke = [each for each in readable if each is not self._listening]
            for each in spoke:
                self._hear(each)
            if self._listening in readable:
                self._accept()
            if spoke:
                channels.put(guard.fractions(now_s := time.monotonic()), now_s)
                answer = pack_answer(PulseAnswer(guard.counter, channels.state, channels.trouble))
                for each in spoke:
                    with suppress(OSError):  # somebody who is gone, or does not read, gets no answers
                        each.send(answer, socket.MSG_DONTWAIT)
        channels.close()
        return why

    def close(self) -> None:
        for each in (self._listening, *self._clients):
            each.close()

    def _accept(self) -> None:
        with suppress(BlockingIOError, ConnectionError):
            client, _ = self._listening.accept()
            client.setblocking(False)
            if len(self._clients) < CLIENTS:
                self._clients.append(client)
            else:  # not one of those that may hold motors
                client.close()

    def _hear(self, client: socket.socket) -> None:
        """Read all that a client sent, or note that it is gone."""
        try:
            for _ in range(RECORDS):
                if not (data := client.recv(RECORD_BYTES)):
                    self._lose(client)
                    break
                self._take(client, data)
        except BlockingIOError:
            pass
        except OSError:
            self._lose(client)

    def _take(self, client: socket.socket, data: bytes) -> None:
        try:
            self._guard.hear(client, data, time.monotonic())
        except FormatError as error:
            self._malformed += 1
            if self._malformed == 1:
                log.error("outlet: %s; the next ones are not told", error)

    def _lose(self, client: socket.socket) -> None:
        self._guard.lose(client)
        self._clients.remove(client)
        client.close()


def serve(path: Path, pwm: Pwm, channels: tuple[int, ...], beat_fd: int) -> None:
    """Run the process until SIGTERM, SIGINT or the end of the supervisor. `beat_fd`: its pipe, -1 for none. Raises OSError
    where it cannot listen."""
    asked = list[str]()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: asked.append(signal.Signals(number).name))
    if beat_fd >= 0:
        os.set_blocking(beat_fd, False)

    def ended() -> str:
        if beat_fd >= 0:
            try:
                os.write(beat_fd, b".")
            except BlockingIOError:
                pass
            except OSError:
                return "the supervisor is gone"
        return asked[0] if asked else ""

    server = OutletServer(path, Channels(pwm, channels))
    try:
        log.info("outlet: stops: %s", server.serve(ended))
    finally:
        server.close()
