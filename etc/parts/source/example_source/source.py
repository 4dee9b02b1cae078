"""The source: a line for each message, `latitude longitude heading north_mps east_mps number`, angles in degrees."""

import math

from delfim.api import Fix, Links, Navigation, ReadableLine, State, Vehicle
from example_source import CompassTable

LINE_MAX = 160  # bytes: longer ones are no lines of this compass
FIX, SATELLITES, HDOP = 3, 12, 0.9


class Compass:
    name = "example_source"

    def __init__(self, line: ReadableLine, state: State) -> None:
        self.input, self._state = line, state
        self.heard_s, self._rest = -1e9, b""

    def read(self, now_s: float) -> Fix | None:
        """The newest message that has come. Never raises, never waits."""
        *lines, self._rest = (self._rest + self.input.read()).split(b"\n")
        self._rest = self._rest[-LINE_MAX:]
        fix = None
        for line in lines:
            try:
                latitude, longitude, heading, north, east, number = map(float, line[:LINE_MAX].split())
                if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and 0.0 <= number < 1e9):
                    raise ValueError
                angles = map(math.radians, (latitude, longitude))
                said = Navigation(
                    0, *angles, north, east, math.radians(heading), 0.0, 0.0, 0.0, FIX, SATELLITES, HDOP, int(number) & 255
                )
            except ValueError:
                self._state.count("example_source_malformed")
                continue
            self.heard_s = now_s
            fix = Fix(said, self.input.t_ns, now_s)
        return fix

    def report(self, now_s: float) -> dict[str, object]:
        return {}


def open_source(settings: Vehicle, links: Links, state: State) -> Compass:
    table = settings.of(CompassTable)
    return Compass(links.line(table.device, table.baud), state)
