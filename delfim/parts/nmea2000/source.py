"""Off-the-shelf sensors on an NMEA 2000 bus (docs/nmea2000.md)."""

import contextlib

import msgspec

from delfim import config
from delfim.base.errors import BusError
from delfim.canproxy.nmea2000.device import device_name, facts_of
from delfim.canproxy.nmea2000.parcels import ROLL_CALL, frames
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.parts.nmea2000.combining import Nmea2000Source
from delfim.parts.nmea2000.table import Nmea2000
from delfim.vehicle.links import FRAMES_PER_READ, Links
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.navigation.fusion import Hearer
from delfim.vehicle.navigation.iron import iron_of
from delfim.vehicle.state import State


class Nmea2000Navigation:
    """Navigation by off-the-shelf sensors."""

    name = "nmea2000"

    def __init__(self, socket: CanSocket, source: Nmea2000Source, state: State) -> None:
        self.input, self._source, self._state = socket, source, state
        self.heard_s, self.t_ns = -1e9, 0

    def tell(self, hearer: Hearer) -> None:
        self._source.fusion.hearer = hearer

    def read(self, now_s: float) -> Fix | None:
        """Read as `DsorNavigation.read` does: a fix for each message of the chosen position source."""
        fix = None
        for _ in range(FRAMES_PER_READ):
            try:
                frame = self.input.receive()
            except BusError:
                self._state.count("nmea2000_bus_errors")
                break
            if frame is None:
                break
            self.t_ns = frame.t_ns
            navigation = self._source.feed(frame, now_s)
            if navigation is not None:
                fix = Fix(navigation, frame.t_ns, now_s)
                self.heard_s = now_s
        return fix

    def report(self, now_s: float) -> dict[str, object]:
        """The report: the device used for each kind of data, the devices that send, and counts of refused messages."""
        told: dict[str, object] = msgspec.to_builtins(self._source.status(now_s)._asdict(), str_keys=True)
        return told


def open_source(settings: config.Vehicle, links: Links, state: State) -> Nmea2000Navigation:
    own_name, iron = device_name(facts_of(settings).unique), iron_of(settings.compass)
    decoder = Nmea2000Source(settings.of(Nmea2000), settings.navigation.stale_s, own_name, iron)
    filters = tuple(CanAddress(arb, mask) for arb, mask in decoder.filters)
    return Nmea2000Navigation(opened(settings, links, filters), decoder, state)


def opened(settings: config.Vehicle, links: Links, filters: tuple[CanAddress, ...]) -> CanSocket:
    """Open the bus. It is only listened to, but for one request at the start, where NAMEs matter: who has which address."""
    bus = links.bus(settings.of(Nmea2000).interface, filters)
    if settings.of(Nmea2000).joins:
        ((arb, data),) = frames(ROLL_CALL, 0)
        with contextlib.suppress(OSError):  # nmea2000d asks, too, when the bus is there
            bus.sendto(data, CanAddress(arb))
    return bus
