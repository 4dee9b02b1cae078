"""The commands of a boat to its motors, recorded and repeated. Differences are counted, each with the cycle in which it begins.

Controllers of other makes than DelfimX's hear their last command again and again, at times of which there is no record. So a
repetition must only equal a command that the replay has just computed, and every new command must have been on the bus once.
"""

import struct
from collections import deque
from typing import Final, NamedTuple, Protocol

from delfim import config
from delfim.base.frames import Frame
from delfim.base.parts import OWN, load
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.logging.ashore.tree import Span
from delfim.logging.blackbox import device

STAMP_NS: Final = 5_000_000  # between a cycle's time and the stamp of a frame; a repetition within it is no news
_NOTHING: Final = "nothing"
_F32: Final = struct.Struct("f")


class Difference(NamedTuple):
    t_ns: int
    cycle: int  # of navigation, from the start of the run
    told: str  # who was told: a bus and its command, or a thruster
    recorded: str
    repeated: str


class Findings:
    """The differences within a time."""

    def __init__(self, span: Span) -> None:
        self.span, self.differences = span, list[Difference]()
        self.frames = self.commands = 0  # compared: on buses, and in the state log
        self.cycle = 0  # the present one

    def differ(self, t_ns: int, told: str, recorded: str, repeated: str) -> None:
        if self.span.has(t_ns):
            self.differences.append(Difference(t_ns, self.cycle, told, recorded, repeated))

    def logged(self, t_ns: int, told: str, recorded: float, repeated: float) -> None:
        """Compare a command in the record of a cycle, which has the precision of the log."""
        if self.span.has(t_ns):
            self.commands += 1
            (now,) = _F32.unpack(_F32.pack(repeated))
            if now != recorded:
                self.differ(t_ns, told, f"{recorded:+.7f}", f"{now:+.7f}")


class Commands(Protocol):
    """The commands of a protocol: `commands_of` of the module that plays its devices."""

    hears: tuple[CanAddress, ...]  # the frames that may be commands

    def command(self, frame: Frame) -> tuple[str, bytes] | None: ...  # who is told, and what; None: it completes none
    def is_own(self, frame: Frame) -> bool: ...  # whether this computer sent it


def has_bus(driver: str) -> bool:
    """Whether the driver commands motors on a bus of their own, with a protocol."""
    return driver in OWN and bool(OWN[driver].driver and OWN[driver].protocol)


def _commands(driver: str, settings: config.Vehicle) -> Commands:
    made: Commands = load(OWN[driver], OWN[driver].played).commands_of(settings)
    return made


class Listener:
    """The commands to one listener: those repeated, from the one that was recorded last."""

    def __init__(self, name: str, findings: Findings) -> None:
        self._name, self._findings = name, findings
        self._made = deque[tuple[int, int, bytes]]()  # time, cycle, command
        self._is_said = False  # whether the first of them was recorded
        self._wrong: bytes | None = None

    def make(self, t_ns: int, command: bytes) -> None:
        if not self._made or self._made[-1][2] != command:
            self._made.append((t_ns, self._findings.cycle, command))

    def hear(self, t_ns: int, command: bytes) -> None:
        """Take a recorded command. Before the first cycle, everything is as the driver was started."""
        made, findings = self._made, self._findings
        if not made:
            return
        findings.frames += findings.span.has(t_ns)
        for place, (_, _, each) in enumerate(made):
            if each == command:
                self._skip(place)
                self._is_said, self._wrong = True, None
                return
        if command != self._wrong:
            findings.differ(t_ns, self._name, command.hex(), made[-1][2].hex())
        self._wrong, self._is_said = command, True
        while len(made) > 1:
            made.popleft()

    def _skip(self, count: int) -> None:
        for _ in range(count):
            t_ns, cycle, command = self._made.popleft()
            if not self._is_said and self._findings.span.has(t_ns):
                self._findings.differences.append(Difference(t_ns, cycle, self._name, _NOTHING, command.hex()))
            self._is_said = False

    def finish(self) -> None:
        """Count the repeated commands that were never recorded."""
        self._skip(len(self._made))


class MotorBus:
    """The commands on one bus."""

    def __init__(self, driver: str, settings: config.Vehicle, onlooker: CanSocket, findings: Findings) -> None:
        self.name = device(settings.table(driver).interface)
        self._driver, self._findings = driver, findings
        self._then, self._now = _commands(driver, settings), _commands(driver, settings)
        self._onlooker = onlooker
        onlooker.bind(*self._now.hears)
        self._recorded, self._told = deque[tuple[int, str, bytes]](), dict[str, Listener]()

    def keep(self, frame: Frame) -> bool:
        """Whether a recorded frame was sent by the boat; if so it is kept for the comparison."""
        if not self._then.is_own(frame):
            return False
        if (command := self._then.command(frame)) is not None:
            self._recorded.append((frame.t_ns, *command))
        return True

    @property
    def last_ns(self) -> int:
        """The time of the last recorded command; 0 without any."""
        return self._recorded[-1][0] if self._recorded else 0

    def hear(self, until_ns: int) -> None:
        """Compare what was recorded before this time."""
        while self._recorded and self._recorded[0][0] < until_ns:
            t_ns, name, command = self._recorded.popleft()
            self._of(name).hear(t_ns, command)

    def make(self, t_ns: int) -> None:
        """Take the frames that the replay just sent."""
        while (frame := self._onlooker.receive()) is not None:
            if self._now.is_own(frame) and (command := self._now.command(frame)) is not None:
                self._of(command[0]).make(t_ns, command[1])

    def finish(self) -> None:
        self.hear(1 << 63)
        for told in self._told.values():
            told.finish()

    def _of(self, name: str) -> Listener:
        if name not in self._told:
            self._told[name] = Listener(f"{self._driver} {name}", self._findings)
        return self._told[name]
