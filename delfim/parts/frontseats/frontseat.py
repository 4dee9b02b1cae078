"""The line to a boat's own computer, its front seat, which has the motors and takes commands in sentences (docs/front-seat.md).

It mixes for itself: what it is asked for is the effort of the starboard and the port side. Two rows of the vehicle's file
describe them, address 0 starboard and 1 port.
"""

import errno
import math
from collections.abc import Callable
from typing import Final

from delfim import config
from delfim.base.input.ratelimit import PIECE_BYTES
from delfim.lines.nmea0183.proprietary import FieldReader
from delfim.vehicle.links import ReadableLine
from delfim.vehicle.state import Actuation, State

STOPS: Final = 10  # times that a stop is said and taken; then silence, so that the boat's own remote control can have it


class SeatSide:
    """One side of the boat, a row of the vehicle's file."""

    def __init__(self, index: int, row: config.ThrusterTable) -> None:
        self.index, self.name, self.sign = index, row.name, -1.0 if row.reversed else 1.0

    def effort(self, sent: Actuation) -> float:
        """The effort of this side, positive ahead, as its motor is mounted."""
        return self.sign * sent.thrust[self.index]


class FrontSeatLine:
    """The line of a front seat: commands out, sentences in."""

    def __init__(
        self, name: str, sides: tuple[SeatSide, SeatSide], line: ReadableLine, stop: bytes, *, stays: bool = False
    ) -> None:
        """`sides` are starboard and port; `stop` is the sentence that stops the boat. `stays`: it is sent before the first
        command, too, and repeated."""
        self._line, self._name, self._stop = line, name, stop
        self._starboard, self._port = sides
        self._stops = math.inf if stays else STOPS
        self._reader, self._stops_left = FieldReader(), math.inf if stays else 0

    def send(self, sent: Actuation, words: Callable[[float, float], bytes]) -> int:
        """Send a command, or a stop; returns how many rows' commands the line did not take. `words` makes a sentence of the
        efforts of starboard and port. Before the first command nothing is sent, unless the stop stays: somebody else may be
        driving."""
        if sent.run:
            self._stops_left = self._stops
            said = words(self._starboard.effort(sent), self._port.effort(sent))
        elif self._stops_left == 0:
            return 0
        else:
            said = self._stop
        if not self._line.write(said):
            return 2
        if not sent.run:
            self._stops_left -= 1
        return 0

    def stop(self) -> None:
        """Send a stop. Raises OSError."""
        if not self._line.write(self._stop):
            raise OSError(errno.ENOTCONN, f"the {self._name} does not take the stop")

    def heard(self, state: State) -> list[list[str]]:
        """Read the fields of the next sentences; malformed ones are counted. The rest stays readable."""
        before, found, taken = self._reader.malformed, list[list[str]](), 0
        while taken < PIECE_BYTES and (data := self._line.read()):
            taken += len(data)
            found += self._reader.feed(data)
        if self._reader.malformed > before:
            state.count(f"{self._name}_malformed", self._reader.malformed - before)
        return found


def sides(settings: config.Vehicle, driver: str) -> tuple[SeatSide, SeatSide]:
    """The rows of the starboard and of the port side; the vehicle's file has both."""
    rows = {row.address: SeatSide(index, row) for index, row in enumerate(settings.thrusters) if row.driver == driver}
    return rows[0], rows[1]
