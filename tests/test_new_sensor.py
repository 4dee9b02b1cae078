"""A new sensor on the bus: one file and one row. Its value is shown with its age, logged, and does not disturb the replay."""

import os

from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress
from delfim.console.link import Link
from delfim.errors import DelfimError
from delfim.frames import standard
from delfim.logging.table import table, units
from delfim.logging.tree import files
from tests.afloat import running
from tests.enlarged import Enlarged

DEPTH = '''"""An echo sounder: a frame with the depth in cm."""

from delfim import config
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.errors import BusError
from delfim.frames import standard
from delfim.vehicle.links import Links
from delfim.vehicle.sensors import Value
from delfim.vehicle.state import State

VALUES = (Value("depth_m", "m", "below the echo sounder"),)


class EchoSounder:
    name = "depth"

    def __init__(self, socket: CanSocket) -> None:
        self.input = socket

    def read(self, state: State, now_s: float) -> None:
        try:
            while (frame := self.input.receive()) is not None:
                state.measured["depth_m"] = int.from_bytes(frame.data) / 100.0, now_s
        except BusError:
            state.count("depth_bus_errors")


def open_sensor(settings: config.Vehicle, links: Links) -> EchoSounder:
    return EchoSounder(links.bus(settings.can.interface, (CanAddress(standard(0x150)),)))
'''


def test_a_new_sensor_is_shown_with_its_age_and_logged(tmp_path):
    copy = Enlarged(tmp_path / "copy")
    copy.file("delfim/vehicle/sensors/depth.py", DEPTH)
    copy.row("delfim/config.py", "]  # files in delfim/vehicle/sensors", ', "depth"')
    bus = f"canloop:depth-{os.getpid()}"
    values = (f'can.interface="{bus}"', 'sensors.names=["sysstat", "depth"]', "mavlink.enabled=false")
    with running(tmp_path, 14550, *values, package=copy.place) as command, open_can(bus) as sounder:
        state, cycle = dict[str, object](), None
        while cycle is None or state["cycle"] < cycle + 2 or "gps" not in state["sysstat"]:  # records of the log; health, too
            sounder.sendto((750).to_bytes(2), CanAddress(standard(0x150)))
            try:
                with Link(command, 60.0) as link:
                    state = link.ask("state")
            except DelfimError:  # it does not run yet
                continue
            cycle = state["cycle"] if cycle is None and state["measured"] else cycle
        assert state["measured"] == {"depth_m": 7.5}
        assert state["age_s"]["depth_m"] < 60.0
    logged = [file for file in files([tmp_path / "log"]) if file.id == "state"]
    columns, schema = table(logged)
    assert units(schema)["depth_m"] == "m"
    assert columns["depth_m"][-1] == 7.5
