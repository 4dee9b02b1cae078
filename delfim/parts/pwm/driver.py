"""Motors and servos that are driven by pulses (docs/pwm.md). Their ports may block, and a pulse stands until another is
written: so the outlet, a process of its own, writes them, and this driver sends it a record each cycle."""

import errno
from collections.abc import Mapping
from typing import Final

from delfim import config
from delfim.base import pulses
from delfim.base.errors import DelfimError, FormatError, in_words
from delfim.parts.pwm.table import Pwm
from delfim.parts.pwm.telemetry import BAUD, EscTelemetry, NoTelemetry
from delfim.vehicle.links import Links, LoopInput, Readable, ReadableLine
from delfim.vehicle.state import Actuation, State, ThrusterReport

_REST: Final = (0.0,) * pulses.CHANNELS


class Pulses:
    """The channels of the rows that name this driver: motors, and the servos that turn them."""

    name = "pwm"
    period_s: float | None = None  # the outlet outlives the time between two cycles

    def __init__(
        self, settings: config.Vehicle, outlet: ReadableLine, telemetry: Mapping[str, EscTelemetry | NoTelemetry] | None = None
    ) -> None:
        self._outlet, self._counter, self._answer = outlet, 0, pulses.PulseAnswer(0, "not heard", "")
        rows = [(index, row) for index, row in enumerate(settings.thrusters) if row.driver == self.name]
        self._names = tuple(row.name for _, row in rows)
        self._motors = tuple((index, row.address, -1.0 if row.reversed else 1.0) for index, row in rows)
        self._servos = tuple((index, row.steer.address, *row.steer.as_told) for index, row in rows if row.steer)
        self._telemetry = telemetry or {}
        self._ways = {row.name: (index, 1.0) for index, row in rows if row.name in self._telemetry}  # of the last command
        heard = (each for each in self._telemetry.values() if isinstance(each, EscTelemetry))
        self.input: Readable = outlet
        self.inputs: tuple[LoopInput, ...] = (self, *heard)

    def send(self, sent: Actuation, now_s: float) -> int:
        self._counter += 1
        fractions = list(_REST)
        for index, channel, sign in self._motors:
            fractions[channel] = sign * sent.thrust[index]
        for index, channel, sign, middle_rad, most_rad in self._servos:
            fractions[channel] = min(max((sign * sent.angle_rad[index] + middle_rad) / most_rad, -1.0), 1.0)
        for name, (index, _) in self._ways.items():
            if part := sent.thrust[index]:
                self._ways[name] = index, 1.0 if part > 0.0 else -1.0
        return 0 if self._outlet.write(pulses.pack_command(self._counter, sent.run, fractions)) else len(self._motors)

    def repeat(self, now_s: float) -> int:
        return 0

    def stop(self) -> None:
        if not self._outlet.write(pulses.pack_command(0, False, _REST)):
            raise OSError(errno.ENOTCONN, "the outlet, which writes the pulses of the motors, does not take the stop")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Do nothing: pulses cut no power, the kill relay does."""

    def read(self, state: State, now_s: float) -> None:
        """Read the answers of the outlet. A motor that is driven by pulses reports nothing of its own: that its pulses are
        written, and what the telemetry of its ESC told, which says nothing of the outlet."""
        while data := self._outlet.read():
            try:
                self._answer = answer = pulses.unpack_answer(data)
            except FormatError:
                state.count("pwm_malformed")
                continue
            faults = (answer.trouble,) if answer.trouble else None
            for name in self._names:
                state.thrusters[name] = ThrusterReport(now_s, faults=faults, refuses=answer.trouble)
            for name in self._telemetry:
                state.thrusters[name] = self._with_telemetry(name, state.thrusters[name], now_s)

    def _with_telemetry(self, name: str, report: ThrusterReport, now_s: float) -> ThrusterReport:
        told, fault = self._telemetry[name].told(now_s)
        if told is None:
            return report._replace(faults=(*(report.faults or ()), fault))
        rpm, current_a, voltage_v, temperature_c = told
        _, way = self._ways[name]
        return report._replace(rpm=way * rpm, current_a=current_a, voltage_v=voltage_v, temperature_c=temperature_c)

    def report(self) -> dict[str, object]:
        return {"outlet": self._answer.state, "trouble": self._answer.trouble}


def open_actuator(settings: config.Vehicle, links: Links) -> Pulses:
    """Open the driver. Raises DelfimError."""
    outlet = links.line(f"unix:{pulses.socket_path(settings.runtime.run_directory)}", 0)
    telemetry = dict[str, EscTelemetry | NoTelemetry]()
    for name, wire in settings.of(Pwm).telemetry.items():
        try:
            telemetry[name] = EscTelemetry(links.line(wire.device, BAUD), wire.pole_pairs)
        except DelfimError as error:  # a wire that only tells keeps no motor from its commands, or its stop
            telemetry[name] = NoTelemetry(in_words(error))
    return Pulses(settings, outlet, telemetry)
