"""The boat's links to the outside, opened for real: CAN buses, serial lines, lines on which this computer listens, pins."""

import contextlib
from collections.abc import Callable

from delfim import config
from delfim.base.clock import Clock
from delfim.base.input.ratelimit import SECOND_BYTES, Allowance
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.lines.forms import Bias, Form
from delfim.lines.gpio import GpioLine, open_gpio
from delfim.lines.networkline import LISTENING, NetworkLine
from delfim.lines.serialline import SerialLine

AnyLine = SerialLine | NetworkLine


class OpenedLinks:
    """Opens links, and keeps them open until `links` closes them. Opening one raises DelfimError."""

    def __init__(self, settings: config.Vehicle, clock: Clock, links: contextlib.ExitStack) -> None:
        self.settings, self.clock, self.links = settings, clock, links
        self._inputs = list[CanSocket | AnyLine]()

    def bus(self, interface: str, filters: tuple[CanAddress, ...]) -> CanSocket:
        socket = self.links.enter_context(open_bound(self.settings.can, interface, filters))
        self._inputs.append(socket)
        return socket

    def line(self, device: str, baud: int, form: Form = "8N1") -> AnyLine:
        return self.opened(device, baud, form)

    def opened(
        self,
        device: str,
        baud: int,
        form: Form,
        may_lack: bool = False,
        heard: Callable[[int, bytes], object] = lambda t_ns, data: None,
    ) -> AnyLine:
        """A line, whose input `heard` gets. One that `may_lack` is tried again by `rebind`, as one that is lost later."""
        line: AnyLine
        if device.startswith(LISTENING):
            line = NetworkLine(device, next(iter(self.settings.facts("senders"))), self.clock, heard)
        else:
            line = SerialLine(device, baud, self.clock, heard, may_lack, form, Allowance(SECOND_BYTES, self.clock.monotonic_s))
        self.links.callback(line.close)
        self._inputs.append(line)
        return line

    def gpio(self, chip: str, name: str, bias: Bias) -> GpioLine:
        line = open_gpio(chip, name, bias)
        self.links.callback(line.close)
        return line

    def rebind(self) -> None:
        """Take up what failed; call it about once a second."""
        for each in self._inputs:
            each.rebind()
