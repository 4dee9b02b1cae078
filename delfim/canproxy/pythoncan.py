"""canloop as an interface of python-can: `can.Bus(interface="canloop", channel="NAME")`, so that its tools join the bus.

python -m can.viewer -i canloop -c NAME        python -m can.logger -i canloop -c NAME
"""

from typing import Any

import can
from can import typechecking

from delfim.base.errors import BusError, FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, Frame
from delfim.canproxy.adapter import from_message, to_message
from delfim.canproxy.canloop import open_canloop
from delfim.canproxy.socket import ANYTHING, CanAddress


def addresses(filters: typechecking.CanFilters) -> tuple[CanAddress, ...]:
    """The acceptance filters equivalent to python-can's: set bits of `can_mask` must match, remote frames pass too."""
    accepted = []
    for entry in filters:
        number, mask, formats = entry["can_id"], entry["can_mask"], entry.get("extended")
        if formats is not False:
            accepted.append(CanAddress((number & 0x1FFFFFFF) << 3 | CAN_IDE, _dont_care((mask & 0x1FFFFFFF) << 3)))
        if formats is not True and not number & mask & ~0x7FF:
            accepted.append(CanAddress((number & 0x7FF) << 21, _dont_care((mask & 0x7FF) << 21)))
    return tuple(accepted)


def _dont_care(match: int) -> int:
    return ~(match | CAN_IDE | CAN_ERR) & 0xFFFFFFFF


class CanloopBus(can.BusABC):
    """A bus of python-can on the canloop bus `channel`. Filters are the kernel's; own messages are never received.

    `droprate`, `seed` and `verbose` are those of open_canloop. Raises can.CanError's subclasses, as every bus of python-can.
    """

    def __init__(
        self,
        channel: str,
        can_filters: typechecking.CanFilters | None = None,
        droprate: float = 0.0,
        seed: int | None = None,
        verbose: bool = False,
        **kwargs: Any,
    ) -> None:
        try:
            self._socket = open_canloop(channel, droprate=float(droprate), seed=seed, verbose=bool(verbose), error_frames=True)
        except BusError as error:
            raise can.CanInitializationError(str(error)) from None
        self.channel_info = f"canloop:{channel}"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel, can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        try:
            arb, data = from_message(msg)
            self._socket.settimeout(timeout or 0)
            self._socket.sendmsg(Frame(arb, data))
        except FormatError as error:
            raise can.CanOperationError(f"canloop carries CAN 2.0 frames: {error}") from None
        except OSError as error:
            raise can.CanOperationError(str(error)) from None

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            self._socket.settimeout(timeout)
            frame = self._socket.recvmsg()
        except (BlockingIOError, TimeoutError):
            return None, True
        except OSError as error:
            raise can.CanOperationError(str(error)) from None
        message = to_message(frame.arb, frame.data, frame.t_ns)
        message.channel = self.channel_info
        return message, True

    def _apply_filters(self, filters: typechecking.CanFilters | None) -> None:
        self._socket.bind(*(addresses(filters) if filters else (ANYTHING,)))

    def fileno(self) -> int:
        return self._socket.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        self._socket.close()
