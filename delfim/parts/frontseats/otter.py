"""The Otter of Maritime Robotics as front seat: surge and yaw effort by its sentences, by TCP (docs/front-seat.md).

The formats are those that public programs for this boat use; the maker's manual was not at hand.
"""

from typing import Final

from delfim import config
from delfim.lines.nmea0183.framing import framed
from delfim.lines.nmea0183.proprietary import number
from delfim.parts.frontseats.frontseat import FrontSeatLine, SeatSide, sides
from delfim.parts.frontseats.table import OtterTable
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.state import Actuation, State, ThrusterReport

ABORT: Final = framed("PMARABT")  # drift: both motors off
TROUBLE_S: Final = 10.0  # an error is shown for so long


class Otter:
    """The two motors of an Otter."""

    name = "otter"
    period_s: float | None = None

    def __init__(self, starboard: SeatSide, port: SeatSide, line: ReadableLine) -> None:
        self._starboard, self._port = starboard, port
        self.input, self.inputs = line, (self,)
        self._seat = FrontSeatLine(self.name, (starboard, port), line, ABORT)
        self._mode, self._fuel, self._error, self._error_s = "", "", "", -TROUBLE_S
        self._power_w: float | None = None

    def send(self, sent: Actuation, now_s: float) -> int:
        return self._seat.send(sent, _sentence)

    def repeat(self, now_s: float) -> int:
        return 0

    def stop(self) -> None:
        self._seat.stop()

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Do nothing: it has no sentence for that."""

    def read(self, state: State, now_s: float) -> None:
        """Read its reports into the state. Malformed ones are counted."""
        for kind, *values in self._seat.heard(state):
            try:
                if kind == "PMAROTR":
                    self._motors(values, state, now_s)
                elif kind == "PMARMOD":
                    self._mode, self._fuel = values[:2]
                elif kind == "PMARERR":
                    self._error, self._error_s = ",".join(values), now_s
            except ValueError:
                state.count("otter_malformed")

    def report(self) -> dict[str, object]:
        return {"mode": self._mode, "fuel": self._fuel, "power_w": self._power_w, "error": self._error}

    def _motors(self, values: list[str], state: State, now_s: float) -> None:
        """Take revolutions, temperature and power of port and starboard, power of all, batteries."""
        port_rpm, starboard_rpm, port_c, starboard_c, _, _, power_w = (number(each) for each in values[:7])
        faults = (self._error,) if self._error and now_s - self._error_s < TROUBLE_S else None
        self._power_w = power_w
        for side, rpm, temperature_c in ((self._starboard, starboard_rpm, starboard_c), (self._port, port_rpm, port_c)):
            turns = None if rpm is None else side.sign * rpm
            state.thrusters[side.name] = ThrusterReport(now_s, turns, temperature_c=temperature_c, faults=faults)


def _sentence(starboard: float, port: float) -> bytes:
    surge, yaw = (starboard + port) / 2.0, (port - starboard) / 2.0  # its mixer: port = surge + yaw
    return framed(f"PMARMAN,{surge:.3f},0.000,{yaw:.3f}")


def open_actuator(settings: config.Vehicle, links: Links) -> Otter:
    """Open the driver. Raises DelfimError."""
    return Otter(*sides(settings, Otter.name), links.line(settings.of(OtterTable).device, settings.of(OtterTable).baud))
