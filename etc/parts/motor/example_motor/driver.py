"""The driver: a line `thrust ADDRESS NUMBER` for each motor, -1 to 1. A motor stops by itself when it hears nothing for half a
second, and tells its revolutions in a line `ADDRESS NUMBER`."""

from delfim.api import Actuation, Links, ReadableLine, State, ThrusterReport, Vehicle
from example_motor import MotorTable

LINE_MAX = 80  # bytes: longer ones are no lines of this motor


class Motor:
    name = "example_motor"
    period_s = 0.2  # it wants to hear its command so often

    def __init__(self, line: ReadableLine, table: MotorTable, places: dict[int, int], names: dict[int, str]) -> None:
        """`places`: of each motor's address, the place of its row in the vehicle's file; `names`: the name there."""
        self.input, self.inputs = line, (self,)
        self._most, self._places, self._names, self._rest = table.most, places, names, b""
        self._thrust = dict.fromkeys(places, 0.0)

    def read(self, state: State, now_s: float) -> None:
        """What the motors tell. Never raises, never waits, and reads no more than has come."""
        *lines, self._rest = (self._rest + self.input.read()).split(b"\n")
        self._rest = self._rest[-LINE_MAX:]
        for line in lines:
            try:
                address, rpm = line[:LINE_MAX].split()
                state.thrusters[self._names[int(address)]] = ThrusterReport(now_s, float(rpm))
            except (ValueError, KeyError):
                state.count("example_motor_malformed")

    def send(self, sent: Actuation, now_s: float) -> int:
        """Returns how many commands were not taken."""
        for address, place in self._places.items():
            self._thrust[address] = min(max(sent.thrust[place], -self._most), self._most) if sent.run else 0.0
        return self.repeat(now_s)

    def repeat(self, now_s: float) -> int:
        return sum(not self.input.write(b"thrust %d %.3f\n" % each) for each in self._thrust.items())

    def stop(self) -> None:
        """The dead-man of the supervisor calls this, too, in a process of its own. Raises OSError."""
        taken = [self.input.write(b"\nthrust %d 0\n" % address) for address in self._thrust]  # each, whatever became of another
        if not all(taken):
            raise OSError("example_motor: the line takes no stop")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """It has no relay."""

    def report(self) -> dict[str, object]:
        return {"thrust": {name: self._thrust[address] for address, name in self._names.items()}}


def open_actuator(settings: Vehicle, links: Links) -> Motor:
    table = settings.of(MotorTable)
    rows = [(place, row) for place, row in enumerate(settings.thrusters) if row.driver == Motor.name]
    places, names = {row.address: place for place, row in rows}, {row.address: row.name for _, row in rows}
    return Motor(links.line(table.device, table.baud), table, places, names)
