"""AIS on an NMEA 2000 bus: the boat's own receiver or transponder reports other vessels (docs/traffic.md)."""

from collections import Counter
from typing import Final

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.frames import CAN_IDE, Frame, extended
from delfim.canproxy.nmea2000 import ais
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.canproxy.nmea2000.pgns import ADDRESS_MAX
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.vehicle.links import Links, Readable, received
from delfim.vehicle.state import State

FILTERS: Final = tuple(CanAddress(extended(pgn << 8), extended(7 << 26 | 0xFF) & ~CAN_IDE) for pgn in sorted(ais.PGNS))
NAME: Final = "nmea2000"


class AisBus:
    def __init__(self, socket: CanSocket) -> None:
        self.input: Readable = socket
        self._socket = socket
        self._lost = Counter[str]()  # fast packets, by reason, until they are counted in the state
        self._fast = {pgn: FastPacket(self._lost) for pgn in ais.PGNS}

    def read(self, state: State, now_s: float) -> None:
        """Read the waiting frames. Malformed messages are counted."""
        for frame in received(self._socket, state, NAME):
            self.hear(state, frame, now_s)

    def hear(self, state: State, frame: Frame, now_s: float) -> None:
        """Take one frame. Never raises."""
        pgn, address = frame.arb >> 11 & 0x3FFFF, frame.arb >> 3 & 0xFF
        if frame.arb & 7 != CAN_IDE or pgn not in self._fast or address > ADDRESS_MAX:
            return
        whole = self._fast[pgn].feed(address, frame.data, now_s)
        if self._lost:
            state.count_lost(pgn, self._lost)
        if whole is None:
            return
        try:
            state.hear(ais.decode(pgn, whole), NAME, now_s)
        except FormatError:
            state.count(f"nmea2000_{pgn}_malformed")


def open_ais_bus(settings: config.Vehicle, links: Links) -> AisBus | None:
    """Open the bus; None where the boat has no such bus, or shall not listen to it. Raises DelfimError."""
    if NAME not in settings.traffic.hears or f"{NAME}.interface" not in settings.outside("interface"):
        return None
    return AisBus(links.bus(settings.table("nmea2000").interface, FILTERS))
