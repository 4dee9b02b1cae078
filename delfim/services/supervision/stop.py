"""The supervisor's own way to actuators and bus, for when the runtime does not beat: loaded beforehand, opened when needed."""

import contextlib
import logging
from collections.abc import Callable, Sequence
from contextlib import nullcontext

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.errors import DelfimError, PermanentFailure, in_words
from delfim.base.parts import find
from delfim.canproxy.dsor.messages import SHUTDOWN_ACKNOWLEDGE, ShutdownAcknowledge, ShutdownStage, pack_shutdown_acknowledge
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.lines.gpio import GpioOutput, open_output
from delfim.lines.opening import OpenedLinks
from delfim.vehicle.links import Links
from delfim.vehicle.propulsion import actuators
from delfim.vehicle.propulsion.actuators import Actuator

log = logging.getLogger(__name__)


def _limit(settings: config.Vehicle, name: str) -> Callable[[], contextlib.AbstractContextManager[object]]:
    """What breaks off the call of a laboratory's driver, loaded before it is needed; nothing breaks off one of our own."""
    if find(settings.aboard, name) is None:
        return nullcontext
    from delfim.vehicle.foreign import breaking_off

    return breaking_off


class PropellerStop:
    """Stops all actuators when called. A link that failed is opened anew the next time."""

    def __init__(self, settings: config.Vehicle) -> None:
        self._settings, self._limits = settings, {name: _limit(settings, name) for name in settings.drivers}
        for name in self._limits:
            try:
                actuators.module(name, settings)
            except PermanentFailure as error:  # the vehicle does not start either; the others must be stopped all the same
                log.error("%s", error)
        self._opened = dict[str, tuple[Actuator, contextlib.ExitStack]]()
        self._bus: CanSocket | None = None

    def __call__(self) -> None:
        """Stop all actuators. Raises DelfimError if one of them took no stop; the others did."""
        refused = list[str]()
        for name, limit in self._limits.items():
            try:
                with limit():
                    if name not in self._opened:
                        self._opened[name] = opened_driver(self._settings, name)
                    self._opened[name][0].stop()
            except Exception as error:  # a laboratory's driver may raise anything, and keeps no other from its stop
                refused.append(in_words(error))
                if name in self._opened:
                    self._opened.pop(name)[1].close()
        if refused:
            raise DelfimError("; ".join(refused))

    def tell(self, is_safe: bool, holders: Sequence[str]) -> None:
        """Send a stop once more at the end of a shutdown, and whether the power may be cut."""
        stage = ShutdownStage.SAFE if is_safe else ShutdownStage.HELD
        with contextlib.suppress(OSError, DelfimError):  # motors that cannot be told any more keep the bus from nothing
            self()
        with contextlib.suppress(OSError, DelfimError):  # a full bus must not hold up the shutdown
            if self._bus is None:
                self._bus = open_can(self._settings.can.interface)
                self._bus.setblocking(False)
            told = pack_shutdown_acknowledge(ShutdownAcknowledge(stage, len(holders)))
            self._bus.sendto(told, CanAddress(SHUTDOWN_ACKNOWLEDGE))

    def close(self) -> None:
        """Close everything, until the next stop: a front seat whose output nobody reads would wait for us."""
        for _, links in self._opened.values():
            links.close()
        self._opened.clear()
        if self._bus is not None:
            self._bus.close()
            self._bus = None


def opened_driver(settings: config.Vehicle, name: str) -> tuple[Actuator, contextlib.ExitStack]:
    """Open a driver with links of its own; returns it with what closes them. Raises DelfimError."""
    with contextlib.ExitStack() as links:
        opened = OpenedLinks(settings, SystemClock(), links)
        return actuators.open_actuator(name, settings, Links(opened.bus, opened.line)), links.pop_all()


class CutOff:
    """The output of the computer that takes motors their pulses or their power, for when nobody else can stop them. A call sets
    it and returns the outcome, in words. It is held from the start."""

    def __init__(self, chip: str, line: str, at_high: bool) -> None:
        """`chip`: empty, there is none."""
        self._at_high, self._name, self._trouble = at_high, line, ""
        self._line: GpioOutput | None = None
        if chip:
            try:
                self._line = open_output(chip, line, not at_high)
            except DelfimError as error:
                self._trouble = f"pwm.cut: {error}"
                log.error("%s; nothing aboard can cut off the motors", self._trouble)

    def __call__(self, off: bool) -> str:
        if self._line is None:
            return self._trouble or "the boat has no pwm.cut; use the kill switch"
        try:
            self._line.put(self._at_high is off)
        except OSError as error:
            return f"pwm.cut: {self._name}: {error.strerror}; use the kill switch"
        return f"{self._name} cut them off" if off else f"{self._name} lets them turn again"

    def close(self) -> None:
        if self._line is not None:
            self._line.close()
