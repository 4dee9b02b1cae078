"""Values beside navigation of instruments that speak NMEA 0183 (docs/nmea0183.md). Where these lines carry navigation, too, the
source reads them, and leaves these values in the state.
"""

from delfim import config
from delfim.base.vessels import Report
from delfim.canproxy.dsor.messages import SystemStatus
from delfim.lines.nmea0183.sentences import RadarTarget
from delfim.parts.nmea0183 import radar
from delfim.parts.nmea0183.source import AnyPort, Nmea0183Navigation, opened
from delfim.vehicle.links import Links, Readable
from delfim.vehicle.sensors import Sensor, Value
from delfim.vehicle.state import Ping, State

VALUES = (
    Value("depth_m", "m", "below the transducer"),
    Value("wind_apparent_rad", "rad", "where the apparent wind comes from, clockwise from the bow", "awa_rad"),
    Value("wind_apparent_mps", "m/s", "apparent wind", "aws_mps"),
    Value("wind_true_rad", "rad", "where the true wind comes from, clockwise from the bow", "twa_rad"),
    Value("wind_true_mps", "m/s", "true wind", "tws_mps"),
    Value("position_sigma_m", "m", "standard deviation of the position, as the receiver states it", "sigma_m"),
    Value("corrections_age_s", "s", "since the receiver's last correction", "corr_s"),
    Value("height_m", "m", "of the antenna above the ellipsoid of WGS 84"),
    Value("air_pa", "Pa", "pressure of the air"),
)


class Instruments:
    """The lines that carry no navigation."""

    name = "nmea0183"

    def __init__(
        self,
        lines: Nmea0183Navigation,
        measured: dict[str, tuple[float, float]],
        heard: list[tuple[Report | RadarTarget | str, str, float]],
        pings: list[Ping],
        health: dict[str, tuple[SystemStatus, float]],
    ) -> None:
        self.input: Readable = lines.input
        self._lines, self._measured, self._heard, self._pings, self._health = lines, measured, heard, pings, health

    def read(self, state: State, now_s: float) -> None:
        self._lines.read(now_s)
        state.measured.update(self._measured)
        state.sysstat.update(self._health)
        for each in self._heard:
            radar.hear(state, *each)
        for ping in self._pings:
            state.sound(ping)
        self._heard.clear()
        self._pings.clear()


class ReadByTheSource:
    """Stands for lines that the source reads."""

    name = "nmea0183"

    def __init__(self) -> None:
        self.input: Readable = AnyPort(())

    def read(self, state: State, now_s: float) -> None:
        pass


def open_sensor(settings: config.Vehicle, links: Links) -> Sensor:
    if "nmea0183" in settings.navigation.sources:
        return ReadByTheSource()
    measured, heard, pings, health = (
        dict[str, tuple[float, float]](),
        list[tuple[Report | RadarTarget | str, str, float]](),
        list[Ping](),
        dict[str, tuple[SystemStatus, float]](),
    )
    lines = opened(settings, links, measured, lambda *report: heard.append(report), pings.append, health)
    return Instruments(lines, measured, heard, pings, health)
