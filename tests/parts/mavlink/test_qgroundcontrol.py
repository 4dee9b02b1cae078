"""QGroundControl's requests, one after the other as its sources have them: every one is answered.

The sequence is tried, not the program. Of its 2026 sources: InitialConnectStateMachine, RequestMetaDataTypeStateMachine,
StandardModes, ParameterManager, PlanManager, APMFirmwarePlugin, Vehicle; what older versions of it ask for instead, too.
"""

import math
from typing import Any, NamedTuple

import pytest

from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import params
from delfim.parts.mavlink.codec.wire import dialect
from tests.parts.mavlink.mavlink_console import Console, newest
from tests.parts.mavlink.test_mavlink_station import afloat, sail

ACCEPTED, UNSUPPORTED = 0, 3
NAN = math.nan
PLACES = ((386_930_000, -92_150_000), (386_934_000, -92_150_000))
GENERIC, ROVER = "generic", "ardurover"


class Step(NamedTuple):
    """What is said, and all that comes back: types of messages, and the result of a command."""

    message: str
    fields: tuple[object, ...]
    answers: frozenset[str]
    result: int | None = None


def command(number: int, *p: float, also: str = "", result: int = ACCEPTED) -> Step:
    fields = 1, 1, number, 0, *p, *[0.0] * (7 - len(p))
    return Step("command_long", fields, frozenset({"COMMAND_ACK"} | ({also} if also else set())), result)


def question(number: int, index: int = 0, also: str = "") -> Step:
    """REQUEST_MESSAGE. A message that the vehicle does not have is refused at once: nothing waits for a time-out."""
    return command(512, number, index, also=also, result=ACCEPTED if also else UNSUPPORTED)


def silent(message: str, *fields: object) -> Step:
    """A message that MAVLink has no answer for."""
    return Step(message, fields, frozenset())


CONNECT = (
    silent("heartbeat", 6, 8, 192, 0, 4, 3),
    silent("system_time", 1_795_231_735_000_000, 0),
    *(silent("request_data_stream", 1, 1, stream, 2, 1) for stream in (1, 2, 3, 6, 10, 11, 12)),
    question(148, also="AUTOPILOT_VERSION"),
    question(300),  # PROTOCOL_VERSION
    command(520, 1, result=UNSUPPORTED),  # REQUEST_AUTOPILOT_CAPABILITIES and
    command(519, 1, result=UNSUPPORTED),  # REQUEST_PROTOCOL_VERSION of old versions
    question(435, also="AVAILABLE_MODES"),
    question(397),  # COMPONENT_METADATA, and where that is not there
    question(395),  # COMPONENT_INFORMATION
    Step("param_request_list", (1, 0), frozenset()),  # a few at each tick
    *(Step("mission_request_list", (1, 1, kind), frozenset({"MISSION_COUNT"})) for kind in (0, 1, 2)),
    *(silent("mission_ack", 1, 1, 0, kind) for kind in (0, 1, 2)),
    command(511, 33, 200_000),
    command(511, 242, 1_000_000, result=UNSUPPORTED),
    command(410, result=UNSUPPORTED),  # GET_HOME_POSITION
    question(280),  # GIMBAL_MANAGER_INFORMATION
    command(521, 1, result=UNSUPPORTED),  # REQUEST_CAMERA_INFORMATION
)
MODE, ARM, START, SPEED, YAW = 176, 400, 300, 178, 115
THERE = (1, 1, 0, 192, 0, 0, -1.0, 1.0, 0.0, NAN, *PLACES[1], 12.0)  # in MAV_FRAME_GLOBAL, with an altitude
BY_HAND = silent("manual_control", 1, 0, 300, 200, 0, 0)
ACTIONS = (  # of an ArduRover, and the mode that the boat is in then
    (command(ARM, 1), Mode.IDLE),
    (command(MODE, 1, 15), Mode.GOTO),  # the mission is started from Guided
    (command(START), Mode.PLAY),
    (command(MODE, 1, 4), Mode.IDLE),  # pause
    (Step("command_int", THERE, frozenset({"COMMAND_ACK"}), ACCEPTED), Mode.GOTO),
    (command(SPEED, 1, 1.2, -1, 0, NAN, NAN, NAN), Mode.GOTO),
    (command(YAW, 30, 0, 1, 1, result=UNSUPPORTED), Mode.GOTO),
    (command(MODE, 1, 11), Mode.HOME),
    (command(MODE, 1, 0), Mode.MANUAL),
    (BY_HAND, Mode.MANUAL),
    (silent("set_mode", 1, 217, 10), Mode.PLAY),
    (command(ARM, 0, 21196), Mode.IDLE),  # emergency stop
    (BY_HAND, Mode.IDLE),
    (command(ARM, 0), Mode.IDLE),
)


class Seen(NamedTuple):
    sea: Any
    station: Console

    def take(self, step: Step) -> list[Any]:
        heard = [m for m in self.station.say(step.message, *step.fields) if m.get_type() not in _BY_ITSELF]
        assert {m.get_type() for m in heard} == step.answers, step
        if step.result is not None:
            answer = newest(heard, "COMMAND_ACK")
            assert (answer.command, answer.result) == (step.fields[3 if step.message == "command_int" else 2], step.result)
            assert (answer.target_system, answer.target_component) == self.station.party
        return heard

    def upload(self, items: list[tuple[int, int]], kind: int = 0) -> None:
        heard = self.station.say("mission_count", 1, 1, len(items), kind)
        for number, place in enumerate(items):
            assert newest(heard, "MISSION_REQUEST_INT").seq == number
            what = 1, 1, number, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 16, int(number == 0), 1
            heard = self.station.say("mission_item_int", *what, 0.0, 0.0, 0.0, NAN, *place, 0.0, kind)
        done = newest(heard, "MISSION_ACK")
        assert (done.type, done.mission_type) == (ACCEPTED, kind)


_BY_ITSELF = {"STATUSTEXT", "HEARTBEAT", "MISSION_CHECKSUM"}  # what is told to everybody when something has changed


def seen(boat: Any, autopilot: str) -> Seen:
    sea = afloat(boat, autopilot=autopilot)
    return Seen(sea, Console(sea.station, sea.radio, system=255, address=("127.0.0.1", 14551)))


def home_and(places: tuple[tuple[int, int], ...], autopilot: str) -> list[tuple[int, int]]:
    """Item 0 is home for an ArduRover, and for nobody else."""
    return [places[0], *places] if autopilot == ROVER else list(places)


@pytest.mark.parametrize("autopilot", [GENERIC, ROVER])
def test_all_that_it_asks_for_when_it_finds_the_boat_is_answered(boat, autopilot):
    console = seen(boat, autopilot)
    heard = [message for step in CONNECT for message in console.take(step)]
    modes = {m.custom_mode for m in heard if m.get_type() == "AVAILABLE_MODES"}
    assert modes == set(Mode)
    capabilities = newest(heard, "AUTOPILOT_VERSION").capabilities
    assert capabilities & dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    assert capabilities & dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    before = len(console.sea.radio.sent)
    sail(console.sea, 3.0)
    told = console.station.listen(before)
    assert {m.param_id for m in told if m.get_type() == "PARAM_VALUE"} == set(params.NAMES)
    needed = {"HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE", "RAW_RPM", "SYS_STATUS", "GPS_RAW_INT", "VFR_HUD"}
    assert needed <= {m.get_type() for m in told}
    assert console.sea.state.mode is Mode.IDLE


@pytest.mark.parametrize("autopilot", [GENERIC, ROVER])
def test_a_plan_goes_up_and_comes_back(boat, autopilot):
    console = seen(boat, autopilot)
    console.upload(home_and(PLACES, autopilot))
    count = newest(console.station.say("mission_request_list", 1, 1, 0), "MISSION_COUNT").count
    back = [newest(console.station.say("mission_request_int", 1, 1, n, 0), "MISSION_ITEM_INT") for n in range(count)]
    assert [(m.x, m.y) for m in back][autopilot == ROVER :] == list(PLACES)
    assert newest(console.station.say("mission_clear_all", 1, 1, 0), "MISSION_ACK").type == ACCEPTED


def test_its_buttons_and_its_joystick_move_a_rover(boat):
    console = seen(boat, ROVER)
    console.upload(home_and(PLACES, ROVER))
    for step, mode in ACTIONS:
        console.take(step)
        assert console.sea.state.mode is mode, step
        if mode is Mode.MANUAL and step is BY_HAND:
            assert (console.sea.state.setpoint.port, console.sea.state.setpoint.starboard) == pytest.approx((0.5, -0.1))
