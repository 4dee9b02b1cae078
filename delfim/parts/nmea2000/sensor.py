"""Values beside navigation of instruments on an NMEA 2000 bus, and its batteries (docs/nmea2000.md)."""

from collections import Counter
from collections.abc import Iterator
from typing import Final

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.frames import CAN_IDE, Frame, extended
from delfim.base.selection import Newest
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Node, Status
from delfim.canproxy.nmea2000.device import device_name, facts_of
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.canproxy.nmea2000.instruments import FAST, MESSAGES, WATER_DEPTH, Battery, BatteryCharge, Told, decode
from delfim.canproxy.nmea2000.names import CLAIMED, Names
from delfim.canproxy.nmea2000.pgns import ADDRESS_MAX
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.parts.nmea0183 import sensor as nmea0183
from delfim.parts.nmea2000.source import opened
from delfim.parts.nmea2000.table import Nmea2000
from delfim.vehicle.failsafe.nodehealth import NAMES
from delfim.vehicle.links import Links, received
from delfim.vehicle.sensors import Value
from delfim.vehicle.state import Ping, State

VALUES = (
    *(each for each in nmea0183.VALUES if each.name not in ("position_sigma_m", "corrections_age_s", "height_m", "air_pa")),
    Value("speed_water_mps", "m/s", "through the water", "stw_mps"),
    Value("water_c", "degC", "temperature of the water"),
    Value("air_c", "degC", "temperature of the air"),
)
READ: Final = (*MESSAGES, CLAIMED)
SIDES: Final = tuple(NAMES[node] for node in (Node.BATTERIES_STARBOARD, Node.BATTERIES_PORT))
FILTERS: Final = tuple(CanAddress(extended(pgn << 8), extended(7 << 26 | 0xFF) & ~CAN_IDE) for pgn in READ)


class Nmea2000Instruments:
    """Each value has its chosen device, as each kind of navigation data has; the batteries that the file names stand in the
    health of the boat."""

    name = "nmea2000"

    def __init__(self, settings: config.Vehicle, socket: CanSocket) -> None:
        self.input = socket
        self._names = Names(settings.of(Nmea2000).preferred_sources, device_name(facts_of(settings).unique))
        preferred, stale_s = self._names.preferred, settings.sensors.stale_s
        self._batteries = settings.of(Nmea2000).batteries
        names = (*(value.name for value in VALUES), "depth_offset_m")
        self._newest = {name: Newest[int, float](preferred, stale_s) for name in names}
        self._powers = tuple(Newest[int, Battery](preferred, stale_s) for _ in self._batteries)
        self._charges = tuple(Newest[int, float](preferred, stale_s) for _ in self._batteries)
        self._lost = Counter[str]()  # fast packets, by reason, until they are counted in the state
        self._fast = {pgn: FastPacket(self._lost) for pgn in FAST}

    def read(self, state: State, now_s: float) -> None:
        """Read the values of the bus. Malformed messages are counted."""
        for frame in received(self.input, state, self.name):
            self.hear(state, frame, now_s)

    def hear(self, state: State, frame: Frame, now_s: float) -> None:
        """Take one frame. Never raises."""
        pgn, address, data = frame.arb >> 11 & 0x3FFFF, frame.arb >> 3 & 0xFF, frame.data
        if frame.arb & 7 != CAN_IDE:
            return
        if pgn == CLAIMED:
            self._names.learn(address, data, (*self._newest.values(), *self._powers, *self._charges))
            return
        if pgn not in READ or address > ADDRESS_MAX or address == self._names.own:
            return
        if pgn in self._fast:
            whole = self._fast[pgn].feed(address, data, now_s)
            if self._lost:
                state.count_lost(pgn, self._lost)
            if whole is None:
                return
            data = whole
        try:
            told = decode(pgn, data)
        except FormatError:
            state.count(f"nmea2000_{pgn}_malformed")
            return
        for name, value in self._filed(state, address, told, now_s):
            self._newest[name].put(address, value, now_s)
            if value is not None and self._newest[name].choose(now_s) == address:
                state.measured[name] = value, now_s
        if pgn == WATER_DEPTH and self._newest["depth_m"].choose(now_s) == address:
            depth_m, offset_m = (self._newest[name].of(address, now_s) for name in ("depth_m", "depth_offset_m"))
            if depth_m is not None:
                state.sound(Ping(now_s, depth_m, f"{self.name} {address}", offset_m))

    def _filed(self, state: State, address: int, told: Told, now_s: float) -> Iterator[tuple[str, float | None]]:
        """File the values of a message; those of a battery go into the health at once."""
        if not isinstance(told, Battery | BatteryCharge):
            yield from told or ()
        elif told.instance in self._batteries:
            side = self._batteries.index(told.instance)
            if isinstance(told, Battery):
                self._powers[side].put(address, told, now_s)
            else:
                self._charges[side].put(address, told.charge, now_s)
            power, charge = self._powers[side].get(now_s), self._charges[side].get(now_s)
            _, volts, amperes, celsius = power or Battery(told.instance, None, None, None)
            warm = None if celsius is None else round(celsius)
            amperes = None if amperes is None else -amperes  # positive is charging on this bus, and discharging here
            state.sysstat[SIDES[side]] = BatteriesStatus(Status.GOOD, Fault(0), volts, amperes, charge, warm), now_s


def open_sensor(settings: config.Vehicle, links: Links) -> Nmea2000Instruments:
    return Nmea2000Instruments(settings, opened(settings, links, FILTERS))
