"""The DroneCAN driver on a bus of this process: its frames, its timing, and the reports that come back."""

import math
from types import SimpleNamespace
from typing import cast

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import BusError
from delfim.base.frames import Frame, extended
from delfim.canproxy.dronecan.datatypes import (
    ARMING_STATUS,
    ARRAY_COMMAND,
    ESC_STATUS,
    NODE_STATUS,
    RAW_COMMAND,
    RPM_COMMAND,
    SAFETY_STATE,
    CommandKind,
)
from delfim.canproxy.dronecan.fields import DataType, pack, unpack
from delfim.canproxy.dronecan.transfers import Publisher, TransferReceiver
from delfim.canproxy.socket import ANYTHING
from delfim.config import Steer, ThrusterTable
from delfim.parts.dronecan.driver import ARMING_S, TWINS_S, ZERO_S
from delfim.parts.dronecan.sim import Esc
from delfim.parts.dronecan.table import Dronecan
from delfim.simulator.lockstepbus import LockstepBus
from delfim.simulator.model import Model
from delfim.vehicle.links import Links
from delfim.vehicle.propulsion.actuators import open_actuator
from delfim.vehicle.state import Actuation, State, ThrusterReport

KINDS = (ARMING_STATUS, ARRAY_COMMAND, NODE_STATUS, RAW_COMMAND, RPM_COMMAND, SAFETY_STATE)
TWIN = tuple(
    ThrusterTable(name=name, driver="dronecan", address=address, y_m=y_m, thrust_n=(-10.0, 20.0), rpm_max=1400.0)
    for address, (name, y_m) in enumerate((("starboard", 1.0), ("port", -1.0)))
)
WELL = (0, 24.0, 3.0, 300.0, 700, 50)


class Bench:
    """The driver, and the devices' end of its bus."""

    def __init__(self, rows: tuple[ThrusterTable, ...] = TWIN, **table: object) -> None:
        self.settings = config.Vehicle(boat=config.BoatTable(name="test"), thrusters=rows, dronecan=Dronecan(**table))
        self.bus = LockstepBus(ManualClock())
        self.devices = self.bus.socket("devices")
        self.devices.bind(ANYTHING)
        links = Links(lambda interface, filters: self.bus.bound(*filters), lambda device, baud: None)
        self.driver = open_actuator("dronecan", self.settings, links)
        self.state, self._receiver = State(), TransferReceiver(KINDS)

    def send(self, now_s: float, *thrust: float, angle_rad: tuple[float, ...] = (), run: bool = True) -> None:
        angles = angle_rad or (0.0,) * len(thrust)
        assert self.driver.send(Actuation(thrust, angles, run), now_s) == 0

    def told(self) -> list[tuple[str, tuple[float, ...]]]:
        """What the devices have heard since the last call: names of messages, and their values."""
        names, heard = {kind.id: kind for kind in KINDS}, list[tuple[str, tuple[float, ...]]]()
        while (frame := self.devices.receive()) is not None:
            if (transfer := self._receiver.feed(frame, 0.0)) is not None:
                assert transfer.source == self.settings.dronecan.node
                values, items = unpack(names[transfer.type], transfer.payload)
                heard.append((names[transfer.type].name, values + items))
        assert not self._receiver.errors
        return heard

    def turning(self, *thrust: float) -> None:
        """The motors have been armed, and have this command."""
        self.send(0.0, *thrust)
        self.send(ZERO_S, *thrust)
        self.told()

    def say(self, kind: DataType, values: tuple[float, ...], node: int = 20, now_s: float = 5.0) -> None:
        """A device says something, and the driver reads it."""
        for arb, data in Publisher(kind, node, 20).frames(pack(kind, values)):
            self.devices.sendmsg(Frame(arb, data))
        self.driver.read(self.state, now_s)


def test_motors_are_armed_and_see_a_zero_before_they_are_told_to_turn():
    bench = Bench()
    bench.send(1.0, 0.0, 0.0, run=False)
    assert bench.told() == [("RawCommand", (0, 0))]
    bench.send(2.0, 0.5, -1.0)
    assert bench.told() == [("ArmingStatus", (255,)), ("RawCommand", (0, 0))]
    bench.driver.repeat(2.05)
    assert ("RawCommand", (0, 0)) in bench.told()
    bench.send(2.2, 0.5, -1.0)
    assert bench.told() == [("RawCommand", (4096, -8191))]
    bench.send(2.4, 0.5, -1.0, run=False)
    assert bench.told() == [("ArmingStatus", (0,)), ("RawCommand", (0, 0))], "off at once"
    bench.send(2.6, 0.5, -1.0)
    assert bench.told()[-1] == ("RawCommand", (0, 0)), "and armed anew"


def test_the_last_command_is_repeated_with_what_devices_want_to_hear_beside_it():
    bench = Bench()
    bench.turning(0.5, 0.25)
    heard = list[tuple[str, tuple[float, ...]]]()
    for tick in range(41):
        assert bench.driver.repeat(10.0 + tick * bench.driver.period_s) == 0
        heard += bench.told()
    names = [name for name, _ in heard]
    assert bench.driver.period_s == 0.05
    assert [values for name, values in heard if name == "RawCommand"] == [(4096, 2048)] * 41
    assert names.count("ArmingStatus") == names.count("SafetyState") == 1 + 2.0 / ARMING_S
    assert [values[:3] for name, values in heard if name == "NodeStatus"] == [(0, 0, 0), (1, 0, 0), (2, 0, 0)], "uptime, well"
    assert {values for name, values in heard if name in ("ArmingStatus", "SafetyState")} == {(255,)}


def test_in_idle_motors_hear_zeros_and_that_they_are_not_armed():
    bench = Bench()
    bench.driver.repeat(1.0)
    assert bench.told()[:2] == [("RawCommand", (0, 0)), ("ArmingStatus", (0,))], "before the first command, too"


def test_the_dead_mans_stop_is_complete_in_itself():
    bench = Bench()
    bench.driver.stop()
    assert bench.told() == [("RawCommand", (0, 0)), ("ArmingStatus", (0,)), ("RawCommand", (0, 0))]


def test_a_reversed_motor_is_commanded_and_reports_with_the_other_sign():
    starboard, port = TWIN
    bench = Bench((starboard, msgspec.structs.replace(port, reversed=True)))
    bench.turning(0.5, 0.5)
    bench.driver.repeat(1.0)
    assert bench.told()[0] == ("RawCommand", (4096, -4096))
    bench.say(ESC_STATUS, (*WELL[:4], -700, 50, 1))
    assert bench.state.thrusters["port"].rpm == 700.0


def test_motors_may_be_told_revolutions():
    bench = Bench(command="rpm")
    bench.turning(0.5, -1.0)
    bench.driver.repeat(1.0)
    assert bench.told()[0] == ("RPMCommand", (700, -1400))


def test_indices_without_a_thruster_of_the_boat_get_zero():
    far = ThrusterTable(name="bow", driver="dronecan", address=3, x_m=2.0, angle_deg=90.0, thrust_n=(-5.0, 5.0))
    bench = Bench((far, *TWIN))
    bench.turning(1.0, 0.5, 0.5)
    bench.driver.repeat(1.0)
    assert bench.told()[0] == ("RawCommand", (4096, 4096, 0, 8191))


@pytest.mark.parametrize(("steer", "kind", "value"), [("unitless", 0, -0.5), ("position", 1, -math.pi / 12)])
def test_what_turns_gets_its_angle_also_when_the_motor_stands(steer, kind, value):
    values = 7, kind, pytest.approx(value, abs=1e-3)
    outboard = ThrusterTable(
        name="outboard",
        driver="dronecan",
        x_m=-2.0,
        thrust_n=(-10.0, 20.0),
        steer=Steer(kind="azimuth", address=7, angle_max_deg=30.0),
    )
    bench = Bench((outboard,), steer=steer)
    bench.send(0.0, 0.0, angle_rad=(-math.pi / 12,), run=False)
    assert bench.told() == [("RawCommand", (0,)), ("ArrayCommand", values)]
    bench.driver.repeat(0.05)
    assert ("ArrayCommand", values) in bench.told()


@pytest.mark.parametrize(
    ("changes", "part"), [({}, 0.5), ({"reversed": True}, -0.5), ({"reversed": True, "middle_deg": 6.0}, -0.3)]
)
def test_a_servo_that_is_mounted_anyhow_is_told_so_that_it_turns_right(changes, part):
    row = ThrusterTable(
        name="outboard",
        driver="dronecan",
        x_m=-2.0,
        thrust_n=(-10.0, 20.0),
        steer=Steer(kind="azimuth", address=7, angle_max_deg=30.0, **changes),
    )
    bench = Bench((row,))
    bench.send(0.0, 0.0, angle_rad=(math.radians(15.0),), run=False)
    assert bench.told()[1] == ("ArrayCommand", (7, 0, pytest.approx(part, abs=1e-3)))
    model = cast(Model, SimpleNamespace(drives={"outboard": None}))
    played = Esc(model, row, 20)
    played.steer(CommandKind.UNITLESS, part)
    assert math.degrees(played._angle_rad) == pytest.approx(15.0, abs=0.1)


def test_fifteen_motors_with_a_rudder_each_are_commanded_whole():
    rows = tuple(
        ThrusterTable(name=f"t{i}", driver="dronecan", address=i, y_m=i - 7.0, x_m=-1.0, thrust_n=(-1.0, 1.0), steer=rudder)
        for i, rudder in enumerate(Steer(kind="rudder", address=address) for address in range(15))
    )
    bench = Bench(rows)
    bench.turning(*(i / 15.0 for i in range(15)))
    assert bench.driver.repeat(1.0) == 0
    (_, motors), (_, turns), *_ = bench.told()
    assert motors == tuple(round(i / 15.0 * 8191) for i in range(15))
    assert turns[::3] == tuple(range(15))


def test_a_thruster_that_does_not_obey_gets_zero_for_good():
    bench = Bench()
    bench.driver.disconnect(("port",))
    bench.turning(0.5, 0.5)
    bench.driver.repeat(1.0)
    assert bench.told()[0] == ("RawCommand", (4096, 0))


def test_a_report_becomes_that_of_the_thruster():
    bench = Bench()
    bench.say(ESC_STATUS, (*WELL, 0), now_s=5.0)
    assert bench.state.thrusters == {
        "starboard": ThrusterReport(5.0, 700.0, 3.0, 24.0, 26.85, None, None),
    }
    bench.say(NODE_STATUS, (77, 0, 0, 0, 0), node=21)
    assert bench.driver.report() == {"node": 10, "devices": {"21": {"uptime_s": 77, "health": 0}}, "errors": {}}


def test_a_device_that_knows_nothing_reports_nothing():
    bench = Bench()
    bench.say(ESC_STATUS, (0, math.nan, math.nan, math.nan, 0, 127, 1))
    assert bench.state.thrusters["port"] == ThrusterReport(5.0, 0.0, None, None, None, None, None)


def test_faults_of_a_controller_are_told_in_words():
    bench = Bench()
    bench.say(NODE_STATUS, (77, 2, 0, 0, 0))
    bench.say(ESC_STATUS, (4, *WELL[1:], 0))
    assert bench.state.thrusters["starboard"].faults == ("4 errors since the motor started", "node 20 reports an error")


def test_two_controllers_with_one_index_are_named_until_one_of_them_is_silent():
    bench = Bench()
    bench.say(ESC_STATUS, (*WELL, 0), node=20)
    bench.say(ESC_STATUS, (*WELL, 0), node=21)
    assert bench.state.thrusters["starboard"].faults == ("nodes 20 and 21 are both motor 0",)
    bench.say(ESC_STATUS, (*WELL, 0), node=21, now_s=5.1 + TWINS_S)
    assert bench.state.thrusters["starboard"].faults is None


def test_what_makes_no_sense_is_counted():
    bench = Bench()
    bench.say(ESC_STATUS, (*WELL, 9))
    bench.say(ESC_STATUS, (*WELL[:4], 25_000, 50, 0))
    bench.say(NODE_STATUS, (1, 0, 0, 0, 0), node=10)
    assert bench.state.thrusters == {}
    assert bench.state.counts == {"dronecan_malformed": 1}
    errors = bench.driver.report()["errors"]
    assert errors == {"report of a motor that is not in the file": 1, "another device has the number of this computer": 1}


def test_a_bus_that_fails_is_counted():
    bench = Bench()

    class Broken:
        def receive(self) -> None:
            raise BusError("no such device")

    bench.driver._socket = Broken()
    bench.driver.read(bench.state, 0.0)
    assert bench.state.counts == {"dronecan_bus_errors": 1}


def test_a_flood_does_not_hold_the_loop():
    bench = Bench()
    for _ in range(100):
        bench.devices.sendmsg(Frame(extended(24 << 24 | 341 << 8 | 20), bytes(7) + b"\xc0"))
    bench.driver.read(bench.state, 1.0)
    assert len(bench.driver._socket._transport.queue) == 36, "the rest stays readable"


@pytest.mark.parametrize("run", [True, False])
@given(thrust=st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=2), apart_s=st.floats(0.0, 1.0))
def test_no_motor_is_told_more_than_was_sent(run, thrust, apart_s):
    bench = Bench()
    bench.send(0.0, *thrust, run=run)
    bench.send(apart_s, *thrust, run=run)
    for name, values in bench.told():
        if name == "RawCommand":
            for raw, part in zip(values, thrust, strict=True):
                assert raw == 0 or (run and raw == round(part * 8191))
