"""Any thrusters: their troubles from what they report, what is told of them, and their driver on the bus of DelfimX."""

import math

import msgspec
import pytest

from delfim import config
from delfim.base.frames import Frame
from delfim.canproxy.dsor import messages
from delfim.config import Steer, ThrusterTable
from delfim.parts.dsor.driver import Propellers
from delfim.parts.dsor.table import Dsor
from delfim.vehicle.failsafe.troubles import astray, unstopped
from delfim.vehicle.propulsion import thrusters
from delfim.vehicle.report import ThrusterFacts
from delfim.vehicle.state import Actuation, State, ThrusterReport

BOAT = config.BoatTable(name="test")
ROW = ThrusterTable(name="port", driver="dsor", address=1, y_m=-1.0, thrust_n=(-100.0, 200.0))


def other(name: str, **more: object) -> ThrusterTable:
    """A row of a driver that is not that of DelfimX: built past the check of its name."""
    row = msgspec.structs.replace(ROW, name=name, **more)
    msgspec.structs.force_setattr(row, "driver", "vesc")
    return row


ROWS = (
    other("port"),
    other("starboard", y_m=1.0, rpm_max=3000.0),
    other("bow", x_m=2.0, y_m=0.0, angle_deg=90.0),
    other("rudder", x_m=-2.0, y_m=0.0, steer=Steer(kind="rudder")),
)
SETTINGS = config.Vehicle(boat=BOAT)
msgspec.structs.force_setattr(SETTINGS, "thrusters", ROWS)
SENT = Actuation((0.5, 0.5, -0.5, 1.0), (0.0, 0.0, 0.0, 0.5), True)


def said(now_s: float = 10.0, run: bool = True, **reports: ThrusterReport) -> dict[str, str]:
    return astray(SETTINGS, State(actuation=SENT if run else SENT._replace(run=False), thrusters=reports), now_s)


@pytest.mark.parametrize(
    ("name", "report", "words"),
    [
        ("port", ThrusterReport(10.0, 0.0), "port propeller stands still at 50% thrust"),
        ("port", ThrusterReport(10.0, -900.0), "port propeller turns -900 rpm at 50% thrust"),
        ("port", ThrusterReport(10.0, 900.0), ""),
        ("starboard", ThrusterReport(10.0, 0.0), "starboard propeller turns 0 instead of 1500 rpm"),
        ("starboard", ThrusterReport(10.0, 1300.0), ""),
        ("bow", ThrusterReport(10.0, 800.0), "bow propeller turns 800 rpm at -50% thrust"),
        ("bow", ThrusterReport(3.0, -800.0), "bow propeller silent for 7.0 s"),
        ("bow", ThrusterReport(7.0, 800.0), ""),
        ("rudder", ThrusterReport(10.0, angle_rad=0.0), "rudder thruster stands at 0 instead of 29 degrees"),
        ("rudder", ThrusterReport(10.0, 2000.0, angle_rad=0.4), ""),
        ("rudder", ThrusterReport(10.0), ""),
        ("port", ThrusterReport(10.0, refuses="not armed"), "port thruster does not obey: not armed"),
        ("port", ThrusterReport(10.0, 900.0, faults=("hot",)), ""),
    ],
)
def test_each_thruster_is_judged_by_its_own_report(name, report, words):
    assert said(**{name: report}) == ({name: words} if words else {})


def test_one_that_turns_although_it_was_switched_off_is_named_and_nothing_else():
    reports = {
        "port": ThrusterReport(10.0, 500.0),
        "bow": ThrusterReport(1.0, 0.0),
        "rudder": ThrusterReport(10.0, angle_rad=0.0),
    }
    assert said(run=False, bow=ThrusterReport(10.0, refuses="not armed")) == {}
    assert said(run=False, **reports) == {"port": "port propeller turns 500 instead of 0 rpm"}
    assert unstopped(SETTINGS, State(actuation=SENT._replace(run=False), thrusters=reports), 10.0) == ("port",)
    assert unstopped(SETTINGS, State(actuation=SENT, thrusters=reports), 10.0) == ()


def test_the_sides_are_what_pushes_ahead_and_the_middle_belongs_to_both():
    state = State(actuation=SENT, thrusters={"port": ThrusterReport(10.0, 900.0), "rudder": ThrusterReport(10.0, 2000.0)})
    assert thrusters.sides(ROWS) == ((0, 3), (1, 3))
    assert thrusters.thrust(ROWS, state) == (0.75, 0.75)
    assert thrusters.revolutions(ROWS, state) == (1450.0, 2000.0)


def test_what_is_told_of_a_thruster_is_its_command_and_its_report():
    report = ThrusterReport(9.5, 900.0, 4.0, 12.5, 30.0, math.radians(20.0), ("hot",))
    told = thrusters.facts(ROWS, State(actuation=SENT, thrusters={"rudder": report}), 10.0)
    assert list(told) == ["port", "starboard", "bow", "rudder"]
    assert told["bow"] == ThrusterFacts(thrust=-0.5)
    assert told["rudder"] == ThrusterFacts(
        thrust=1.0,
        angle_deg=28.6,
        rpm=900.0,
        current_a=4.0,
        voltage_v=12.5,
        temperature_c=30.0,
        turned_deg=20.0,
        faults=("hot",),
        age_s=0.5,
    )


def test_a_propeller_of_delfimx_may_be_mounted_the_other_way(make_boat):
    starboard = msgspec.structs.replace(config.DELFIMX[0], reversed=True)
    boat = make_boat(thrusters=(starboard, config.DELFIMX[1]), dsor=Dsor(rpm_max=1000))
    (propellers,) = boat.vehicle.propulsion.actuators
    assert isinstance(propellers, Propellers)
    propellers.send(Actuation((0.5, 0.5), (0.0, 0.0), True), 0.0)
    assert [command.rpm for command in boat.propellers()] == [-500, 500]
    boat.nodes.sendmsg(status(messages.Node.PROPELLER_STARBOARD, -480))
    boat.vehicle.on_sensor(boat.sensor)
    assert boat.state.thrusters["starboard"].rpm == 480.0


def test_one_propeller_alone_is_the_only_one_that_is_commanded(make_boat):
    rows = (ROW, other("starboard", y_m=1.0))
    settings = config.Vehicle(boat=BOAT)
    msgspec.structs.force_setattr(settings, "thrusters", rows)
    boat = make_boat()
    Propellers(settings, boat.outlets[0]).send(Actuation((0.5, 0.5), (0.0, 0.0), True), 0.0)
    assert [frame.arb for frame in boat.heard()] == [messages.PROPELLER_PORT, messages.BATTERIES_PORT]


def status(node: messages.Node, rpm: int) -> Frame:
    report = messages.PropellerStatus(messages.Status.GOOD, messages.Fault(0), rpm, 1.0, 20, 0)
    return Frame(messages.sysstat_arb(node), messages.pack_propeller_status(report))
