"""The sensor: a line for each measurement, the temperature in degrees Celsius."""

from delfim.api import Links, ReadableLine, State, Value, Vehicle
from example_sensor import ThermometerTable

VALUES = (Value("water_c", "°C", "temperature of the water", "water"),)
LINE_MAX = 40  # bytes: longer ones are no lines of this thermometer


class Thermometer:
    name = "example_sensor"

    def __init__(self, line: ReadableLine) -> None:
        self.input, self._rest = line, b""

    def read(self, state: State, now_s: float) -> None:
        """All that has come, into the state. Never raises, never waits."""
        *lines, self._rest = (self._rest + self.input.read()).split(b"\n")
        self._rest = self._rest[-LINE_MAX:]
        for line in lines:
            try:
                water_c = float(line[:LINE_MAX])
                if not -5.0 <= water_c <= 50.0:  # neither is NaN
                    raise ValueError
                state.measured["water_c"] = water_c, now_s
            except ValueError:
                state.count("example_sensor_malformed")


def open_sensor(settings: Vehicle, links: Links) -> Thermometer:
    table = settings.of(ThermometerTable)
    return Thermometer(links.line(table.device, table.baud))
