"""The GPS receiver with its health and the time frame."""

import math
from typing import Final

from delfim import config
from delfim.base.frames import Frame
from delfim.canproxy.dsor.messages import (
    GPS_SYSSTAT_ID,
    SYSSTAT_PRIORITY,
    TIME,
    Fault,
    GpsStatus,
    Node,
    Status,
    pack_gps_status,
    time_frame,
)
from delfim.canproxy.dsor.protocol import Message, segments
from delfim.simulator.model import Model
from delfim.simulator.nodes.navigation import FIX, HDOP, SATELLITES

_GOOD: Final = Status.GOOD, Fault(0)
_BAD: Final = Status.BAD, Fault.HARDWARE
_SECOND_NS: Final = 1_000_000_000


class GpsNode:
    """The receiver's health and the time frame, both at the start of each UTC second (thesis 3.2)."""

    hears = ()

    def __init__(self, vehicle: int = 0xC0) -> None:
        self._time_frame = time_frame(vehicle)
        self.due_s = -math.inf
        self.silent = self.bad = False
        self._second: int | None = None
        self._number = 0

    def feed(self, frame: Frame, now_s: float) -> None:
        """Ignore the frame."""

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        second, rest_ns = divmod(utc_ns, _SECOND_NS)
        self.due_s = now_s + (_SECOND_NS - rest_ns) / 1e9
        if second == self._second or self.silent:
            return []
        self._second = second
        self._number += 1
        status = GpsStatus(*(_BAD if self.bad else _GOOD), FIX, SATELLITES, HDOP, utc_ns)
        message = Message(SYSSTAT_PRIORITY, Node.GPS, Node.BROADCAST, GPS_SYSSTAT_ID, pack_gps_status(status))
        return [Frame(self._time_frame, TIME.pack(utc_ns)), *segments(message, self._number)]


def nodes(settings: config.Vehicle, model: Model, seed: int) -> dict[str, GpsNode]:
    return {"gps": GpsNode(settings.can.vehicle)}
