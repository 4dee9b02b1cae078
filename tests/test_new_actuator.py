"""A new driver on a serial line: one file, one row, and its table. It is commanded, limited, told again and again, heard, and
stopped by the dead-man."""

import contextlib
import json
import os
import signal
import sys
from types import ModuleType

import msgspec
import pytest

from delfim import config, messages
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress
from delfim.console.link import Link
from delfim.errors import DelfimError
from delfim.services.stop import PropellerStop
from delfim.vehicle.links import Links
from tests.afloat import running
from tests.enlarged import Enlarged

MOTOR = '''"""A motor behind a serial line."""

from delfim import config
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.state import Actuation, State, ThrusterReport


class Motor:
    name = "motor"
    period_s = 0.1  # it would stop after 0.15 s without a command

    def __init__(self, line: ReadableLine, settings: config.Vehicle) -> None:
        self._line, self._most, self._sent = line, settings.motor.most, 0.0
        ((self._row, self._name),) = [(i, row.name) for i, row in enumerate(settings.thrusters) if row.driver == self.name]
        self.input, self.inputs, self._told = line, (self,), b""

    def read(self, state: State, now_s: float) -> None:
        self._told += self.input.read()
        *lines, self._told = self._told[-80:].split(b"\\n")
        if lines:
            state.thrusters[self._name] = ThrusterReport(now_s, float(lines[-1]))

    def send(self, sent: Actuation, now_s: float) -> int:
        self._sent = min(max(sent.thrust[self._row], -self._most), self._most) if sent.run else 0.0
        return 0 if self._line.write(b"thrust %.2f\\n" % self._sent) else 1

    def repeat(self, now_s: float) -> int:
        return 0 if self._line.write(b"again %.2f\\n" % self._sent) else 1

    def stop(self) -> None:
        if not self._line.write(b"\\nstop\\n"):
            raise OSError("the motor takes no stop")

    def disconnect(self, names: tuple[str, ...]) -> None:
        """Its power is somebody else's."""

    def report(self) -> dict[str, object]:
        return {"sent": self._sent}


def open_actuator(settings: config.Vehicle, links: Links) -> Motor:
    return Motor(links.line(settings.motor.device, 9600), settings)
'''
TABLE = '''class Motor(Table, frozen=True):
    """A motor behind a serial line."""

    device: str = "/dev/ttyUSB1"  # its serial port
    most: Fraction = 0.9  # of full command


'''
ROWS = """thrusters=[{name="starboard", driver="dsor", y_m=1.0, thrust_n=[-300.0, 500.0], rate_per_s=0.7}, \
{name="port", driver="motor", y_m=-1.0, thrust_n=[-300.0, 500.0], rate_per_s=0.7}]"""


def spoken(end: int, beginning: str) -> str:
    """The next line that begins like this."""
    line = b""
    while not (line.endswith(b"\n") and line.startswith(beginning.encode())):
        line = (b"" if line.endswith(b"\n") else line) + os.read(end, 1)
    return line.decode().strip()


def test_a_new_driver_is_commanded_and_limited_and_stopped_by_the_dead_man(tmp_path):
    copy = Enlarged(tmp_path / "copy")
    copy.file("delfim/vehicle/actuators/motor.py", MOTOR)
    copy.row("delfim/config.py", "]  # files in delfim/vehicle/actuators", ', "motor"')
    copy.row("delfim/config.py", "class Vehicle(Table, frozen=True):", TABLE)
    copy.row("delfim/config.py", "    dsor: Dsor = Dsor()", "    motor: Motor = Motor()\n")
    end, port = os.openpty()
    values = (
        ROWS,
        f'motor.device="{os.ttyname(port)}"',
        'sysstat.required=["gps"]',
        "mavlink.enabled=false",
        "supervisor.deadman_s=1.0",
    )
    with running(tmp_path, 14550, *values, package=copy.place) as command:
        thrust = list[float]()
        while not thrust or thrust[-1] < 0.9:
            try:
                with Link(command, 60.0) as link:
                    state = link.ask("manual", starboard=-1.0, port=1.0)
            except DelfimError:  # it does not run yet, or is not fit yet
                continue
            thrust.append(float(spoken(end, "thrust").split()[1]))
        assert max(thrust) == 0.9, "of 1.0 that was asked for"
        assert [part for part in thrust if 0.0 < part < 0.9], "no faster than the row's rate"
        assert state["motor"]["sent"] is not None
        assert state["thrusters"]["port"]["thrust"] > 0.0 > state["thrusters"]["starboard"]["thrust"]
        spoken(end, "again")
        os.write(end, b"1850\n")
        with Link(command, 60.0) as link:
            while "rpm" not in state["thrusters"]["port"]:
                state = link.ask("state")
        assert state["thrusters"]["port"]["rpm"] == 1850.0
        told = json.loads((tmp_path / "supervisor.json").read_text())
        os.kill(told["programs"]["runtime"]["pid"], signal.SIGSTOP)
        assert spoken(end, "stop") == "stop"


def test_an_actuator_that_cannot_be_told_keeps_no_other_from_its_stop(monkeypatch):
    broken = ModuleType("delfim.vehicle.actuators.broken")

    def open_actuator(settings: config.Vehicle, links: Links) -> None:
        raise DelfimError("no such line")

    broken.open_actuator = open_actuator  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, broken.__name__, broken)
    settings = config.Vehicle(boat=config.BoatTable(name="test"), can=config.Can(interface=f"canloop:stop-{os.getpid()}"))
    first = msgspec.structs.replace(settings.thrusters[0], driver="broken")
    settings = msgspec.structs.replace(settings, thrusters=(first, settings.thrusters[1]))
    with open_can(settings.can.interface) as bus, contextlib.closing(PropellerStop(settings)) as stop:
        bus.bind(CanAddress(messages.PROPELLER_PORT))
        bus.settimeout(200)
        with pytest.raises(DelfimError, match="no such line"):
            stop()
        assert not messages.unpack_propeller_command(bus.recvmsg().data).run
