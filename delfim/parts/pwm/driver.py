"""Motors and servos that are driven by pulses (docs/pwm.md). Their ports may block, and a pulse stands until another is
written: so the outlet, a process of its own, writes them, and this driver sends it a record each cycle."""

import errno
from typing import Final

from delfim import config
from delfim.base import pulses
from delfim.base.errors import FormatError
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.state import Actuation, State, ThrusterReport

_REST: Final = (0.0,) * pulses.CHANNELS


class Pulses:
    """The channels of the rows that name this driver: motors, and the servos that turn them."""

    name = "pwm"
    period_s: float | None = None  # the outlet outlives the time between two cycles

    def __init__(self, settings: config.Vehicle, outlet: ReadableLine) -> None:
        self._outlet, self._counter, self._answer = outlet, 0, pulses.PulseAnswer(0, "not heard", "")
        rows = [(index, row) for index, row in enumerate(settings.thrusters) if row.driver == self.name]
        self._names = tuple(row.name for _, row in rows)
        self._motors = tuple((index, row.address, -1.0 if row.reversed else 1.0) for index, row in rows)
        self._servos = tuple((index, row.steer.address, *row.steer.as_told) for index, row in rows if row.steer)
        self.input, self.inputs = outlet, (self,)

    def send(self, sent: Actuation, now_s: float) -> int:
        self._counter += 1
        fractions = list(_REST)
        for index, channel, sign in self._motors:
            fractions[channel] = sign * sent.thrust[index]
        for index, channel, sign, middle_rad, most_rad in self._servos:
            fractions[channel] = min(max((sign * sent.angle_rad[index] + middle_rad) / most_rad, -1.0), 1.0)
        return 0 if self._outlet.write(pulses.pack_command(self._counter, sent.run, fractions)) else len(self._motors)

    def repeat(self, now_s: float) -> int:
        return 0

    def stop(self) -> None:
        if not self._outlet.write(pulses.pack_command(0, False, _REST)):
            raise OSError(errno.ENOTCONN, "the outlet, which writes the pulses of the motors, does not take the stop")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Do nothing: pulses cut no power, the kill relay does."""

    def read(self, state: State, now_s: float) -> None:
        """Read the answers of the outlet. A motor that is driven by pulses reports nothing: only that its pulses are
        written."""
        while data := self._outlet.read():
            try:
                self._answer = answer = pulses.unpack_answer(data)
            except FormatError:
                state.count("pwm_malformed")
                continue
            faults = (answer.trouble,) if answer.trouble else None
            for name in self._names:
                state.thrusters[name] = ThrusterReport(now_s, faults=faults, refuses=answer.trouble)

    def report(self) -> dict[str, object]:
        return {"outlet": self._answer.state, "trouble": self._answer.trouble}


def open_actuator(settings: config.Vehicle, links: Links) -> Pulses:
    """Open the driver. Raises DelfimError."""
    return Pulses(settings, links.line(f"unix:{pulses.socket_path(settings.runtime.run_directory)}", 0))
