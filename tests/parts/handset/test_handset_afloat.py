"""A receiver on a serial line, at its real rate, into the boat's own programs, while a MAVLink console keeps commanding."""

import contextlib
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest

from delfim.base.errors import DelfimError, Refused
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.wire import Sender, dialect
from delfim.vehicle.loop import HELD_BY_HAND
from delfim.vehicle.operator.link import Link
from tests.afloat import ROOT, running
from tests.parts.handset import receivers

FRAME_S = 0.007  # SBUS, and CRSF at 150 Hz
CONSOLE_S = 0.1
BOAT = 2  # boat.id of etc/delfimx.toml
TAKE, KILL = 5, 6
FREE = {TAKE: 1000.0, KILL: 1000.0}
TAKEN = {TAKE: 2000.0, KILL: 1000.0}
AHEAD = {3: 2012.0}


class Repeated:
    """Something that is done again and again beside the test, until it ends."""

    def __init__(self, act: Callable[[], object], each_s: float) -> None:
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(act, each_s))

    def _run(self, act: Callable[[], object], each_s: float) -> None:
        while not self._ended.wait(each_s):
            act()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._ended.set()
        self._thread.join()


class PlayedReceiver:
    """The far end of the boat's serial line."""

    def __init__(self, protocol: str) -> None:
        self.far, self._near = os.openpty()
        os.set_blocking(self.far, False)
        self.device, self._protocol = os.ttyname(self._near), protocol
        self.pulses_us, self.has_radio, self.is_cut = dict[int, float](FREE), True, False

    def speak(self) -> None:
        if self.is_cut:
            return
        if self._protocol == "sbus":
            data = receivers.sbus(self.pulses_us, 0 if self.has_radio else 0x0C)
        else:
            link = receivers.crsf_link(99 if self.has_radio else 0)
            data = link + (receivers.crsf(self.pulses_us) if self.has_radio else b"")
        with contextlib.suppress(BlockingIOError):  # nobody reads yet
            os.write(self.far, data)

    def close(self) -> None:
        os.close(self.far)
        os.close(self._near)


class CommandingConsole:
    """A console that asks for heading mode ten times a second, whatever it is told."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        self.accepted = self.rejected = self.owner = 0
        self.texts = list[str]()
        self.is_silent = False
        self._sender, self._boat = Sender(250, 190, None, lambda: 0), None

    def speak(self) -> None:
        while True:
            try:
                data, self._boat = self.socket.recvfrom(65536)
            except BlockingIOError:
                break
            for frame in wire.frames(data)[0]:
                self._hear(wire.decode(frame))
        if self._boat is not None and not self.is_silent:
            beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
            order = dialect.MAVLink_command_long_message(BOAT, 1, 43002, 0, 1.0, 90.0, 0.0, 0, 0, 0, 0)
            for message in (beat, order):
                self.socket.sendto(self._sender.pack(message), self._boat)

    def _hear(self, message: Any) -> None:
        match message.get_type():
            case "COMMAND_ACK":
                self.accepted += message.result == 0
                self.rejected += message.result == 1
            case "NAMED_VALUE_INT":
                self.owner = message.value
            case "STATUSTEXT":
                self.texts.append(message.text)


class Afloat:
    """The running boat, its receiver, and its console."""

    def __init__(self, command: Path, receiver: PlayedReceiver, console: CommandingConsole) -> None:
        self._command, self.receiver, self.console = command, receiver, console

    def ask(self, command: str = "state") -> dict[str, Any]:
        with Link(self._command, 60.0) as link:
            return link.ask(command)

    def until(self, wanted: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        while True:
            try:
                state = self.ask()
            except DelfimError:  # it does not run yet
                continue
            if wanted(state):
                return state

    def waits(self, wanted: Callable[[], object]) -> None:
        self.until(lambda _: wanted())

    def thrusts(self, part: float) -> None:
        self.until(lambda state: {each["thrust"] for each in state["thrusters"].values()} == {part})


@contextlib.contextmanager
def afloat_with(protocol: str, tmp_path: Path) -> Iterator[Afloat]:
    receiver, console = PlayedReceiver(protocol), CommandingConsole()
    values = (
        f'handset.device="{receiver.device}"',
        f'handset.protocol="{protocol}"',
        f"handset.kill.channel={KILL}",
        "handset.silent_s=2.0",  # on a busy machine the receiver's thread may have to wait
    )
    with (
        running(tmp_path, console.port, *values) as command,
        Repeated(receiver.speak, FRAME_S),
        Repeated(console.speak, CONSOLE_S),
    ):
        yield Afloat(command, receiver, console)
    receiver.close()
    console.socket.close()


@pytest.mark.long
@pytest.mark.parametrize("protocol", ["crsf", "sbus"])
def test_a_hand_set_has_the_boat_above_a_console_that_never_stops_commanding_and_the_logs_repeat_it(protocol, tmp_path):
    with afloat_with(protocol, tmp_path) as afloat:
        receiver, console = afloat.receiver, afloat.console
        afloat.until(lambda state: state["mode"] == "heading")
        assert afloat.ask()["operator"] == "console 250"

        receiver.pulses_us = TAKEN
        afloat.until(lambda state: (state["mode"], state["operator"]) == ("manual", "hand-set"))
        before = console.rejected
        afloat.waits(lambda: console.rejected > before + 5)
        afloat.waits(lambda: console.owner == BOAT)
        assert "hand-set commands" in console.texts
        assert any(HELD_BY_HAND[:30] in text for text in console.texts)
        afloat.thrusts(0.0)
        receiver.pulses_us = TAKEN | AHEAD
        afloat.thrusts(1.0)
        assert afloat.ask()["mode"] == "manual"

        console.is_silent = True
        receiver.has_radio = False  # positions go on (SBUS) or stop (CRSF)
        state = afloat.until(lambda state: state["reason"].startswith("no thrust: hand-set lost: "))
        assert state["operator"] == ""
        afloat.thrusts(0.0)
        receiver.has_radio = True
        afloat.until(lambda state: state["operator"] == "hand-set")
        afloat.thrusts(0.0)
        receiver.pulses_us = TAKEN
        afloat.until(lambda state: not state["handset"]["throttle"])
        receiver.pulses_us = TAKEN | AHEAD
        afloat.thrusts(1.0)
        receiver.is_cut = True
        afloat.until(lambda state: state["reason"] == "no thrust: hand-set silent")
        afloat.until(lambda state: state["mode"] == "idle" and state["reason"].startswith("no manual command for "))

        receiver.is_cut, receiver.pulses_us, console.is_silent = False, FREE, False
        afloat.until(lambda state: state["mode"] == "heading")
        receiver.pulses_us = FREE | {KILL: 2000.0}
        afloat.until(lambda state: (state["mode"], state["reason"]) == ("idle", "kill: hand-set: its kill switch"))
        with pytest.raises(Refused, match="hand-set still says kill; release it first"):
            afloat.ask("clear")
        receiver.pulses_us = FREE
        afloat.until(lambda state: not state["killed"]["held"])
        before = console.rejected
        afloat.waits(lambda: console.rejected > before + 5)
        assert afloat.ask()["mode"] == "idle"
        console.is_silent = True
        afloat.ask("clear")
        afloat.until(lambda state: not state["killed"]["reason"])

    repeated = subprocess.run(
        [sys.executable, "-m", "delfim", "log", "replay", str(tmp_path / "log")],
        cwd=ROOT, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert "all the same, bit by bit" in repeated.stdout, repeated.stdout + repeated.stderr
