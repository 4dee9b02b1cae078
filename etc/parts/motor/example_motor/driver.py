"""The driver: `thrust NUMBER` in a line, -1 to 1; the motor stops by itself when it hears nothing for half a second, and
tells its revolutions in a line."""

from delfim.api import Actuation, Links, ReadableLine, State, ThrusterReport, Vehicle
from example_motor import MotorTable

LINE_MAX = 80  # bytes: longer ones are no lines of this motor


class Motor:
    name = "example_motor"
    period_s = 0.2  # it wants to hear its command so often

    def __init__(self, line: ReadableLine, table: MotorTable, row: int, thruster: str) -> None:
        self.input, self.inputs = line, (self,)
        self._most, self._row, self._thruster = table.most, row, thruster
        self._thrust, self._rest = 0.0, b""

    def read(self, state: State, now_s: float) -> None:
        """What the motor tells. Never raises, never waits, and reads no more than has come."""
        *lines, self._rest = (self._rest + self.input.read()).split(b"\n")
        self._rest = self._rest[-LINE_MAX:]
        for line in lines:
            try:
                state.thrusters[self._thruster] = ThrusterReport(now_s, float(line[:LINE_MAX]))
            except ValueError:
                state.count("example_motor_malformed")

    def send(self, sent: Actuation, now_s: float) -> int:
        """Returns how many commands were not taken."""
        self._thrust = min(max(sent.thrust[self._row], -self._most), self._most) if sent.run else 0.0
        return self.repeat(now_s)

    def repeat(self, now_s: float) -> int:
        return 0 if self.input.write(b"thrust %.3f\n" % self._thrust) else 1

    def stop(self) -> None:
        """The dead-man of the supervisor calls this, too, in a process of its own. Raises OSError."""
        if not self.input.write(b"\nthrust 0\n"):
            raise OSError("example_motor: the line takes no stop")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """It has no relay."""

    def report(self) -> dict[str, object]:
        return {"thrust": self._thrust}


def open_actuator(settings: Vehicle, links: Links) -> Motor:
    table = settings.of(MotorTable)
    rows = [(index, row.name) for index, row in enumerate(settings.thrusters) if row.driver == Motor.name]
    return Motor(links.line(table.device, table.baud), table, *rows[0])
