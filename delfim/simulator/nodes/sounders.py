"""An echo sounder on an NMEA 2000 bus, where the vehicle's file names the sensor `nmea2000`."""

import struct
from typing import Final

from delfim import config
from delfim.base.frames import Frame, extended
from delfim.canproxy.nmea2000.instruments import WATER_DEPTH
from delfim.canproxy.socket import CanAddress
from delfim.simulator.model import Model
from delfim.simulator.nodes.period import Period
from delfim.simulator.seabed import Echoes
from delfim.simulator.tables import Simulation

SOUNDER: Final = 35  # its address
PERIOD_S: Final = 1.0
_FRAME: Final = extended(3 << 26 | WATER_DEPTH << 8 | SOUNDER)
_UNKNOWN: Final = 0xFF


class EchoSounder:
    """Depth below the transducer, which is at the water line."""

    hears: tuple[CanAddress, ...] = ()

    def __init__(self, interface: str, model: Model, echoes: Echoes) -> None:
        self.interface, self._model, self._echoes, self._period = interface, model, echoes, Period(PERIOD_S)

    @property
    def due_s(self) -> float:
        return self._period.due_s

    def feed(self, frame: Frame, now_s: float) -> None:
        """Ignore the frame: the sounder listens to nobody."""

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        if not self._period.passed(now_s):
            return []
        depth_m = self._echoes.heard(self._model.depth_m)
        return [Frame(_FRAME, struct.pack("<BIhB", _UNKNOWN, round(depth_m * 100.0), 0, _UNKNOWN))]


def devices_of(settings: config.Vehicle, model: Model, seed: int) -> EchoSounder | None:
    if "nmea2000" not in settings.sensors.names:
        return None
    return EchoSounder(settings.table("nmea2000").interface, model, Echoes(settings.of(Simulation), seed, "nmea2000"))
