"""The loop with motors on DroneCAN: rehearsed without a frame on the bus, and the trouble of a motor that does not obey."""

import pytest

from delfim.base.frames import Frame
from delfim.base.modes import Mode
from delfim.canproxy.dronecan.datatypes import ESC_STATUS
from delfim.canproxy.dronecan.fields import pack
from delfim.canproxy.dronecan.transfers import STATUS, Publisher
from delfim.config import ThrusterTable
from delfim.vehicle import console
from delfim.vehicle.rehearsal import Rehearsal

TWIN = tuple(
    ThrusterTable(name=name, driver="dronecan", address=address, y_m=y_m, thrust_n=(-300.0, 500.0), rpm_max=1400.0)
    for address, (name, y_m) in enumerate((("starboard", 1.0), ("port", -1.0)))
)


@pytest.fixture
def boat(make_boat):
    return make_boat(thrusters=TWIN)


def test_the_rehearsal_goes_the_whole_way_and_sends_nothing(boat):
    boat.ready()
    assert boat.vehicle.on_command(console.Heading(90.0, 1.0)) is None
    boat.pass_time(1.0)
    boat.heard()
    rehearsal = Rehearsal(boat.vehicle, boat.outlets, boat.outlets[0].mirror())
    for _ in range(3):
        rehearsal.whole()
    for _ in range(8):
        rehearsal.part()
    assert boat.heard() == []
    twin = rehearsal._twin
    assert (twin.state.mode, twin.state.actuation.run) == (Mode.HEADING, True)
    assert twin.state.cycles >= 3


@pytest.mark.parametrize(
    ("port", "words"),
    [
        (1.0, None),
        (0.0, "port propeller turns 0 instead of"),
        (-1.0, "port propeller turns -"),
        (None, "port propeller silent for"),
    ],
)
def test_a_motor_that_is_dead_or_reversed_or_silent_is_the_trouble_thruster(boat, port, words):
    """`port`: how it turns, as a part of what it is told; None: it falls silent."""
    driver, publisher = boat.vehicle.propulsion.actuators[0], Publisher(ESC_STATUS, 20, STATUS)
    boat.ready()
    assert boat.vehicle.on_command(console.Heading(0.0, 2.0)) is None
    reasons = set[str]()
    for tick in range(150):
        boat.pass_time(0.1, navigation=False)
        if tick % 2:
            boat.navigate()
        if tick % 10 == 0:
            boat.report()
        parts = (1.0, port if tick > 50 else 1.0)
        for motor, (part, thrust) in enumerate(zip(parts, boat.state.actuation.thrust, strict=True)):
            if part is not None:
                values = (0, 24.0, 1.0, 300.0, round(part * thrust * 1400.0), 10, motor)
                for arb, data in publisher.frames(pack(ESC_STATUS, values)):
                    boat.nodes.sendmsg(Frame(arb, data))
        boat.vehicle.on_sensor(driver)
        reasons |= {notice.reason for notice in boat.state.notices if notice.name == "thruster"}
    if words is None:
        assert not reasons
    else:
        assert any(reason.startswith(words) for reason in reasons), reasons
