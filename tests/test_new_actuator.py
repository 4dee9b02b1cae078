"""A new actuator on a serial line: one file, one row, and its table. It is commanded, limited, told again and again, heard, and
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

RUDDER = '''"""A rudder behind a serial line, which turns with the difference of the propellers."""

from delfim import config
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.state import Actuation, State


class Rudder:
    name = "rudder"
    period_s = 0.1  # it would turn to the middle after 0.15 s without a command

    def __init__(self, line: ReadableLine, limits: config.Rudder) -> None:
        self._line, self._limits, self._sent_deg = line, limits, 0.0
        self.input, self.inputs, self._told = line, (self,), b""

    def read(self, state: State, now_s: float) -> None:
        self._told += self.input.read()
        *lines, self._told = self._told[-80:].split(b"\\n")
        if lines:
            state.measured["rudder_deg"] = float(lines[-1]), now_s

    def send(self, sent: Actuation, now_s: float) -> int:
        wanted_deg = self._limits.deg_per_rpm * (sent.port_rpm - sent.starboard_rpm) if sent.run else 0.0
        most_deg = self._limits.most_deg
        self._sent_deg = min(max(wanted_deg, -most_deg), most_deg)
        return 0 if self._line.write(b"rudder %.1f\\n" % self._sent_deg) else 1

    def repeat(self, now_s: float) -> int:
        return 0 if self._line.write(b"again %.1f\\n" % self._sent_deg) else 1

    def stop(self) -> None:
        if not self._line.write(b"\\nstop\\n"):
            raise OSError("the rudder takes no stop")

    def disconnect(self, sides: tuple[str, ...]) -> None:
        """A rudder needs no power to be harmless."""

    def report(self) -> dict[str, object]:
        return {"sent_deg": self._sent_deg}


def open_actuator(settings: config.Vehicle, links: Links) -> Rudder:
    return Rudder(links.line(settings.rudder.device, 9600), settings.rudder)
'''
TABLE = '''class Rudder(Table, frozen=True):
    """A rudder behind a serial line."""

    device: str = "/dev/ttyUSB1"  # its serial port
    deg_per_rpm: Gain = 0.05  # of the difference of the propellers
    most_deg: Annotated[float, msgspec.Meta(ge=0.0, le=90.0)] = 30.0  # to either side


'''


def spoken(end: int, beginning: str) -> str:
    """The next line that begins like this."""
    line = b""
    while not (line.endswith(b"\n") and line.startswith(beginning.encode())):
        line = (b"" if line.endswith(b"\n") else line) + os.read(end, 1)
    return line.decode().strip()


def test_a_new_actuator_is_commanded_and_limited_and_stopped_by_the_dead_man(tmp_path):
    copy = Enlarged(tmp_path / "copy")
    copy.file("delfim/vehicle/actuators/rudder.py", RUDDER)
    copy.row("delfim/config.py", "]  # files in delfim/vehicle/actuators", ', "rudder"')
    copy.row("delfim/config.py", "class Vehicle(Table, frozen=True):", TABLE)
    copy.row("delfim/config.py", "    propulsion: PropulsionTable = PropulsionTable()", "    rudder: Rudder = Rudder()\n")
    end, port = os.openpty()
    values = ('propulsion.actuators=["dsor", "rudder"]', f'rudder.device="{os.ttyname(port)}"', "mavlink.enabled=false")
    with running(tmp_path, 14550, *values, package=copy.place) as command:
        angles = list[float]()
        while not angles or angles[-1] < 30.0:
            try:
                with Link(command, 60.0) as link:
                    state = link.ask("manual", starboard=-1.0, port=1.0)
            except DelfimError:  # it does not run yet, or is not fit yet
                continue
            angles.append(float(spoken(end, "rudder").split()[1]))
        assert max(angles) == 30.0, "of 120 that the revolutions would ask for"
        assert [angle for angle in angles if 0.0 < angle < 30.0], "it turned no faster than the propellers may"
        assert state["rudder"]["sent_deg"] is not None
        spoken(end, "again")
        os.write(end, b"29.5\n")
        with Link(command, 60.0) as link:
            while "rudder_deg" not in state["measured"]:
                state = link.ask("state")
        assert state["measured"]["rudder_deg"] == 29.5
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
    both = msgspec.structs.replace(settings.propulsion, actuators=("broken", "dsor"))
    settings = msgspec.structs.replace(settings, propulsion=both)
    with open_can(settings.can.interface) as bus, contextlib.closing(PropellerStop(settings)) as stop:
        bus.bind(CanAddress(messages.PROPELLER_PORT))
        bus.settimeout(60)
        with pytest.raises(DelfimError, match="no such line"):
            stop()
        assert not messages.unpack_propeller_command(bus.recvmsg().data).run
