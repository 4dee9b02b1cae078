"""The Heron of Clearpath as front seat, and boats with the same sentences: the effort of each side in sentences, by TCP or a
serial line (docs/front-seat.md).

The formats are those that public programs for this boat use; the maker's manual was not at hand.
"""

from typing import Final

from delfim import config
from delfim.lines.nmea0183.framing import framed
from delfim.lines.nmea0183.proprietary import number
from delfim.parts.frontseats.frontseat import FrontSeatLine, SeatSide, sides
from delfim.parts.frontseats.table import HeronTable
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.state import Actuation, State, ThrusterReport

STILL: Final = framed("PYDIR,0.0,0.0")


class Heron:
    """The two motors of a Heron."""

    name = "heron"
    period_s: float | None = None

    def __init__(self, starboard: SeatSide, port: SeatSide, line: ReadableLine) -> None:
        self._starboard, self._port = starboard, port
        self.input, self.inputs = line, (self,)
        self._seat = FrontSeatLine(self.name, (starboard, port), line, STILL)

    def send(self, sent: Actuation, now_s: float) -> int:
        return self._seat.send(sent, _sentence)

    def repeat(self, now_s: float) -> int:
        return 0

    def stop(self) -> None:
        self._seat.stop()

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Do nothing: it has no sentence for that."""

    def read(self, state: State, now_s: float) -> None:
        """Read its battery into the state, as the voltage of both motors. Malformed reports are counted."""
        for kind, *values in self._seat.heard(state):
            if kind == "CPRBS":
                try:
                    voltage_v = _voltage_v(values)
                except ValueError:
                    state.count("heron_malformed")
                else:
                    for side in (self._starboard, self._port):
                        state.thrusters[side.name] = ThrusterReport(now_s, voltage_v=voltage_v)

    def report(self) -> dict[str, object]:
        return {}


def _sentence(starboard: float, port: float) -> bytes:
    return framed(f"PYDIR,{100.0 * port:.1f},{100.0 * starboard:.1f}")


def _voltage_v(values: list[str]) -> float | None:
    """The battery's voltage, V, from time, number of the battery where there is one, voltage of all, of the weakest and the
    strongest cell, temperature."""
    if len(values) not in (5, 6):
        raise ValueError("a battery's report has five or six fields")
    return number(values[-4])


def open_actuator(settings: config.Vehicle, links: Links) -> Heron:
    """Open the driver. Raises DelfimError."""
    return Heron(*sides(settings, Heron.name), links.line(settings.of(HeronTable).device, settings.of(HeronTable).baud))
