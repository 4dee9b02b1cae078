"""The mapping table of docs/mavlink.md, row by row: what a console says and what the vehicle does and answers."""

import math
from types import SimpleNamespace

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.canproxy.dsor import messages
from delfim.parts.mavlink.codec.wire import dialect
from delfim.parts.mavlink.station import Station
from delfim.parts.mavlink.table import Mavlink
from delfim.vehicle import console
from delfim.vehicle.control.hull import filled
from delfim.vehicle.loop import VehicleLoop
from tests.parts.mavlink.mavlink_console import Console, Radio, newest, texts

ACCEPTED, LATER, DENIED, UNSUPPORTED = 0, 1, 2, 3
SMART_RTL = 12
MISSION = """
version = 1
name = "test"
waypoint = [
  { latitude_deg = 38.6930, longitude_deg = -9.2150 },
  { latitude_deg = 38.6934, longitude_deg = -9.2150, speed_mps = 1.0 },
  { latitude_deg = 38.6934, longitude_deg = -9.2144 },
]
"""


def afloat(boat, **options: object) -> SimpleNamespace:
    """A boat that is fit, its station, and a console that it has heard."""
    vehicle: VehicleLoop = boat.vehicle
    settings = config.Vehicle(boat=config.BoatTable(name="test", id=1), mavlink=Mavlink(**options))
    vehicle.helm.settings = filled(settings)
    log: list[console.Commands] = []

    def obey(command: console.Commands, operator: str) -> str | None:
        log.append(command)
        return vehicle.on_command(command, operator)

    radio = Radio()
    station = Station(vehicle, obey, radio, None)
    here = SimpleNamespace(boat=boat, vehicle=vehicle, state=boat.state, station=station, radio=radio, log=log)
    here.console = Console(station, radio)
    boat.ready()
    here.console.beat()
    return here


@pytest.fixture
def sea(boat):
    return afloat(boat)


def sail(sea, seconds: float) -> list:
    """Time passes with navigation, watchdog and the station's ticks; what the console heard."""
    before = len(sea.radio.sent)
    for _ in range(round(seconds * 10)):
        sea.boat.pass_time(0.1)
        sea.boat.navigate()
        sea.boat.report()
        sea.station.tick()
    return sea.console.listen(before)


# Modes.


@pytest.mark.parametrize(
    ("number", "mode"),
    [(0, "MANUAL"), (3, "HEADING"), (5, "HOLD"), (10, "PLAY"), (15, "GOTO"), (100, "PATH"), (4, "IDLE")],
)
def test_a_mode_is_entered_by_its_number_and_seen_within_a_tick(sea, number, mode):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    assert sea.console.mode(number)[0] == ACCEPTED
    assert sea.state.mode is Mode[mode]
    heard = sail(sea, 0.1)
    beat = newest(heard, "HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.custom_mode) == (11, 0, number)
    assert bool(beat.base_mode & 128) is (mode != "IDLE"), "armed"


@pytest.mark.parametrize(("sub", "piece"), [(0, 0), (1, 0), (2, 1)])
def test_a_path_begins_at_the_piece_that_the_third_number_names(sea, sub, piece):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    assert sea.console.mode(100, sub)[0] == ACCEPTED
    sail(sea, 0.3)
    assert (sea.state.mode, sea.state.reference.leg) == (Mode.PATH, piece)
    assert sea.state.reason == ("operator; begins at piece 2 of 2" if piece else "operator")


def test_a_paused_path_goes_on_and_one_with_a_piece_begins_there(sea):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    for sub, piece in ((2, 1), (0, 1), (1, 0)):
        assert sea.console.mode(100, sub)[0] == ACCEPTED
        sail(sea, 0.3)
        assert sea.state.reference.leg == piece
        sea.console.command(193, 0)


@pytest.mark.parametrize("sub", [-1, 0.5, 65536, math.nan, math.inf])
def test_a_piece_of_a_path_is_a_whole_number(sea, sub):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    assert sea.console.mode(100, sub)[0] == DENIED
    assert sea.state.mode is Mode.IDLE


def test_a_piece_that_the_path_does_not_have_is_refused(sea):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    assert sea.console.mode(100, 3) == (LATER, " path refused: no piece 3: the path has pieces 1 to 2")


def test_grex_is_entered_when_its_guest_speaks(sea):
    assert sea.console.mode(101)[0] == LATER
    sea.vehicle.on_guest(b'{"heading_deg": 90, "speed_mps": 1.5}')
    assert sea.console.mode(101)[0] == ACCEPTED


def test_the_guest_has_one_entrance_and_mavlink_is_none(sea):
    """Every console has the key of MAVLink, and any of them could call itself component 191."""
    impostor = Console(sea.station, sea.radio, system=1, address=("127.0.0.1", 4001))
    impostor.party = (1, 191)
    impostor.sender = type(impostor.sender)(1, 191, None, lambda: 0)
    impostor.say("set_position_target_global_int", 0, 1, 1, 6, 0, 0, 0, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert sea.state.setpoint.guest_heading_rad is None
    assert sea.console.mode(101)[0] == LATER


@pytest.mark.parametrize(("number", "sub"), [(4, 1), (4, 2), (4, 6), (6, 1), (1, 1), (10, 4), (101, 3)])
def test_another_autopilots_modes_move_nothing(sea, number, sub):
    assert sea.console.mode(number, sub)[0] == DENIED
    assert sea.state.mode is Mode.IDLE
    assert sea.log == []


@pytest.mark.parametrize("number", [1, 2, 6, 13, 16, max(Mode) + 1, -1, 3.5, math.nan, math.inf])
def test_no_such_mode(sea, number):
    assert sea.console.mode(number)[0] == DENIED
    assert sea.state.mode is Mode.IDLE


@pytest.mark.parametrize("number", [0, 4])
def test_mavsdks_hold_never_starts_the_propellers(sea, number):
    sea.console.mode(number)
    for _ in range(2):
        assert sea.console.mode(4, 3)[0] == ACCEPTED
        assert sea.state.mode is Mode.IDLE


@pytest.mark.parametrize(
    ("pause", "resume"), [((193, 0), (193, 1)), ((176, 1, 4, 3), (176, 1, 4, 4)), ((176, 1, 5), (176, 1, 10))]
)
def test_a_mission_is_paused_and_goes_on_where_it_was(sea, pause, resume):
    """By the command, by MAVSDK's modes of another autopilot, and by the boat's own."""
    sea.vehicle.on_command(console.LoadMission(MISSION))
    sea.console.command(300, 2)
    for _ in range(2):
        assert sea.console.command(*pause)[0] == ACCEPTED
        assert sea.state.mode is Mode.HOLD
    told = newest(sail(sea, 1.1), "MISSION_CURRENT")
    assert (told.seq, told.mission_state) == (2, dialect.MISSION_STATE_PAUSED)
    assert sea.console.command(*resume)[0] == ACCEPTED
    assert (sea.state.mode, sea.state.reference.leg) == (Mode.PLAY, 1)
    assert newest(sail(sea, 1.1), "MISSION_CURRENT").mission_state == dialect.MISSION_STATE_ACTIVE


def test_a_mission_that_an_ardurovers_hold_stopped_goes_on_at_its_leg(boat):
    sea = afloat(boat, autopilot="ardurover")
    sea.vehicle.on_command(console.LoadMission(MISSION))
    sea.console.command(300, 2)
    assert sea.state.reference.leg == 1
    sea.console.mode(4)
    assert sea.state.mode is Mode.IDLE
    sea.console.mode(10)
    assert (sea.state.mode, sea.state.reference.leg) == (Mode.PLAY, 1)


@pytest.mark.parametrize(("number", "result"), [(1, LATER), (2, DENIED), (math.nan, DENIED)])
def test_what_is_not_paused_does_not_go_on(sea, number, result):
    assert sea.console.command(193, number)[0] == result
    assert sea.state.mode is Mode.IDLE


def test_the_end_of_go_to_is_a_parameter(sea):
    sea.console.say("param_set", 1, 1, b"GOTO_END", 1.0, 9)
    sea.console.command(192, -1, 1, 0, math.nan, 38.6925, -9.2150)
    sail(sea, 0.4)
    assert (sea.state.mode, sea.state.reason) == (Mode.IDLE, "goto done")


@pytest.mark.parametrize("number", [176, 400, 300, 43002, 192, 178, 246, 20, 224])
@pytest.mark.parametrize("target", [0, 2])
def test_what_names_no_vehicle_or_another_one_moves_nothing(sea, number, target):
    before = len(sea.radio.sent)
    sea.console.say("command_long", target, 1, number, 0, 1.0, 0, 0, 0, 0, 0, 0)
    assert sea.log == []
    acks = [m for m in sea.console.listen(before) if m.get_type() == "COMMAND_ACK"]
    assert [m.result for m in acks] == ([DENIED] if target == 0 else []), "one for another vehicle is not even answered"


@pytest.mark.parametrize("ask", [(176, 1, 11), (176, 1, 12), (20,)])
def test_home_is_a_mode_and_a_command(sea, ask):
    assert sea.console.command(*ask)[0] == ACCEPTED
    assert sea.state.mode is Mode.HOME
    sea.station.tick()
    assert newest(sea.console.listen(), "HEARTBEAT").custom_mode == SMART_RTL, "the way that it came, not the straight one"


def test_the_old_way_to_set_a_mode(sea):
    sea.console.say("set_mode", 1, 1, 0)
    assert sea.state.mode is Mode.MANUAL
    sea.console.say("set_mode", 0, 1, 3)
    assert sea.state.mode is Mode.MANUAL


def test_a_refusal_carries_the_boats_reason(sea):
    result, words = sea.console.mode(10)
    assert result == LATER
    assert "no mission loaded" in words


# Motion.


def test_manual_thrust_port_and_starboard(sea):
    sea.console.mode(0)
    sea.console.say("manual_control", 1, 200, 0, 0, 300, 0)
    assert (sea.state.setpoint.port, sea.state.setpoint.starboard) == pytest.approx((0.5, -0.1))
    sea.console.say("manual_control", 1, 1000, 0, 0, 1000, 0)
    assert (sea.state.setpoint.port, sea.state.setpoint.starboard) == (1.0, 0.0)


@pytest.mark.parametrize("x", [32767, -32768, 1001])
def test_an_axis_that_is_not_there_is_no_thrust(sea, x):
    sea.console.mode(0)
    sea.console.say("manual_control", 1, x, 0, 0, 0, 0)
    assert (sea.state.setpoint.port, sea.state.setpoint.starboard) == (0.0, 0.0)
    assert sea.station.consoles.counts["manual_ignored"] == 1


def override(sea, steer_us: int, thrust_us: int, target: int = 1, console: Console | None = None) -> tuple[float, float]:
    """RC_CHANNELS_OVERRIDE with the other channels not held; (port, starboard) in force."""
    (console or sea.console).say("rc_channels_override", target, 1, steer_us, 65535, thrust_us, *[65535] * 5)
    return sea.state.setpoint.port, sea.state.setpoint.starboard


def test_channels_of_a_hand_set_are_thrust_and_let_go(sea):
    sea.console.mode(0)
    assert override(sea, 1650, 1600) == pytest.approx((0.5, -0.1))
    assert override(sea, 0, 1750) == pytest.approx((0.5, 0.5)), "a channel that nobody holds is in the middle"
    assert override(sea, 65535, 1250) == pytest.approx((-0.5, -0.5))
    assert override(sea, 0, 65535) == (0.0, 0.0), "at once"
    for released in (0, 65535) * 30:
        sail(sea, 0.1)
        override(sea, released, released)
    assert sea.state.mode is Mode.IDLE, "what is released is silence for the dead-man"
    assert override(sea, 1500, 1700) == (0.0, 0.0)
    assert sea.state.mode is Mode.IDLE, "and a stream of thrust changes no mode"


@pytest.mark.parametrize(("steer_us", "thrust_us"), [(1500, 2001), (999, 1500), (1500, 65534), (1, 1600)])
def test_a_channel_that_cannot_be_is_no_thrust(sea, steer_us, thrust_us):
    sea.console.mode(0)
    assert override(sea, steer_us, thrust_us) == (0.0, 0.0)
    assert sea.station.consoles.counts["manual_ignored"] == 1


def test_channels_are_heard_of_the_console_that_commands_alone(sea):
    sea.console.mode(0)
    other = Console(sea.station, sea.radio, 251, ("127.0.0.1", 4001))
    other.beat()
    assert override(sea, 1500, 1700, console=other) == (0.0, 0.0)
    assert override(sea, 1500, 1700, target=2) == (0.0, 0.0)
    assert override(sea, 1500, 1700) == pytest.approx((0.4, 0.4))
    sail(sea, 2.5)
    assert sea.state.setpoint.port == 0.0, "no thrust after 1.8 s of silence"
    assert override(sea, 1500, 1700) == (0.0, 0.0), "until it was released"
    override(sea, 1500, 1500)
    assert override(sea, 1500, 1700) == pytest.approx((0.4, 0.4))


@pytest.mark.parametrize("target", [0, 2])
def test_manual_thrust_that_names_no_vehicle_is_none(sea, target):
    sea.console.mode(0)
    sea.console.say("manual_control", target, 500, 0, 0, 0, 0)
    assert sea.state.setpoint.port == 0.0


def test_a_stream_of_thrust_changes_no_mode(sea):
    sea.console.mode(3)
    sea.console.say("manual_control", 1, 500, 0, 0, 0, 0)
    assert sea.state.mode is Mode.HEADING
    sea.console.mode(4)
    sea.console.say("manual_control", 1, 500, 0, 0, 0, 0)
    assert sea.state.mode is Mode.IDLE


def test_the_ardurover_profile_takes_the_other_axes(boat):
    sea = afloat(boat, autopilot="ardurover")
    sea.console.mode(0)
    sea.console.say("manual_control", 1, 0, 300, 200, 0, 0)
    assert (sea.state.setpoint.port, sea.state.setpoint.starboard) == pytest.approx((0.5, -0.1))
    assert newest(sail(sea, 1.1), "HEARTBEAT").autopilot == 3


VELOCITY, PLACE = 0b1101_1110_0111, 0b1101_1111_1100  # of the type mask: what is not ignored


def target(
    sea, mask: int, x: float = 0.0, y: float = 0.0, v: tuple[float, float] = (0.0, 0.0), frame: int = 1, to: int = 1
) -> list:
    return sea.console.say("set_position_target_local_ned", 0, to, 1, frame, mask, x, y, 0.0, *v, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_program_steers_by_velocity_and_position_in_the_modes_for_it(sea):
    target(sea, VELOCITY, v=(0.0, 1.2))
    assert sea.state.mode is Mode.IDLE, "a stream changes no mode that an operator chose"
    sea.console.mode(3)
    before = len(sea.log)
    for _ in range(5):
        target(sea, VELOCITY, v=(0.0, 1.2))
    assert sea.log[before:] == [console.Course(course_deg=90.0, speed_mps=pytest.approx(1.2))], "equal ones count once"
    assert sea.state.mode is Mode.COURSE
    target(sea, VELOCITY, v=(-0.5, 0.0))
    assert sea.log[-1] == console.Course(course_deg=180.0, speed_mps=0.5)
    target(sea, PLACE, x=30.0, y=-40.0)
    assert sea.state.mode is Mode.GOTO
    goal = sea.state.setpoint.target
    assert (goal.north_m, goal.east_m) == pytest.approx((30.0, -40.0), abs=0.05)
    latitude, longitude = 386_930_000, -92_150_000
    sea.console.say("set_position_target_global_int", 0, 1, 1, 6, PLACE, latitude, longitude, 0.0, *[0.0] * 8)
    assert (sea.log[-1].latitude_deg, sea.log[-1].longitude_deg) == (38.693, -9.215)
    sea.console.mode(5)
    target(sea, VELOCITY, v=(0.0, 1.2))
    assert sea.state.mode is Mode.HOLD


@pytest.mark.parametrize(
    ("mask", "v", "frame", "reason"),
    [
        (VELOCITY, (1.0, 0.0), 8, "north and east or latitude and longitude"),
        (VELOCITY | 0x200, (1.0, 0.0), 1, "a velocity or a position"),
        (0xFFF & ~0x200, (1.0, 0.0), 1, "needs a velocity or a position"),
        (VELOCITY, (math.nan, 0.0), 1, "course_deg must be"),
        (VELOCITY, (1e9, 0.0), 1, "speed_mps must be"),
        (PLACE, (0.0, 0.0), 6, "north and east or latitude and longitude"),
    ],
)
def test_a_set_point_that_the_boat_cannot_steer_by_is_refused_in_words_once(sea, mask, v, frame, reason):
    sea.console.mode(3)
    before = len(sea.log)
    assert reason in texts(target(sea, mask, v=v, frame=frame))
    assert texts(target(sea, mask, v=v, frame=frame)) == "", "a stream of them says it once"
    assert (sea.log[before:], sea.state.mode, sea.station.consoles.counts["guided_refused"]) == ([], Mode.HEADING, 2)


def test_set_points_are_heard_of_the_console_that_commands_alone(sea):
    sea.console.mode(3)
    target(sea, VELOCITY, v=(0.0, 1.2), to=2)
    sea.console.party = (251, 190)
    sea.console.sender = type(sea.console.sender)(251, 190, None, lambda: 0)
    target(sea, VELOCITY, v=(0.0, 1.2))
    assert sea.state.mode is Mode.HEADING


def test_guided_heading_and_position(sea):
    assert sea.console.command(43002, 1, 123.0)[0] == ACCEPTED
    assert sea.state.mode is Mode.HEADING
    assert math.degrees(sea.state.setpoint.heading_rad) == pytest.approx(123.0)
    assert sea.console.reposition(38.6930, -9.2150)[0] == ACCEPTED
    assert sea.state.mode is Mode.GOTO
    assert sea.state.reference.distance_m == pytest.approx(55.6, abs=0.5)
    assert sea.console.reposition(38.6934, -9.2150, flags=0)[0] == ACCEPTED
    assert sea.state.reference.distance_m == pytest.approx(100.1, abs=0.5)


def test_a_course_over_ground_is_another_mode_than_a_heading(sea):
    sea.boat.navigate(north_mps=1.0, east_mps=0.5)  # set to starboard
    assert sea.console.command(43002, 0, 90.0)[0] == ACCEPTED
    assert (sea.state.mode, sea.state.setpoint.heading_rad) == (Mode.COURSE, pytest.approx(math.radians(90.0)))
    for _ in range(30):
        sea.boat.clock.advance(0.2)
        sea.boat.navigate(heading_rad=math.radians(90.0), north_mps=-0.5, east_mps=1.0)
    assert math.degrees(sea.state.reference.heading_rad) == pytest.approx(90.0 - 26.6, abs=0.5)
    sea.station.tick()
    told = newest(sea.console.listen(), "NAV_CONTROLLER_OUTPUT")
    assert (told.nav_bearing, told.target_bearing) == (63, 90)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [((1, math.nan), "heading_deg must be"), ((0, math.nan), "course_deg must be"), ((2, 90.0), "2 is neither")],
)
def test_what_is_no_heading_is_not_steered(sea, numbers, words):
    result, why = sea.console.command(43002, *numbers)
    assert result == DENIED
    assert words in why
    assert sea.state.mode is Mode.IDLE


@pytest.mark.parametrize("frame", [0, 3, 5, 6, 10, 11])
def test_a_place_in_degrees_is_gone_to_whatever_its_height_means(sea, frame):
    assert sea.console.reposition(38.6930, -9.2150, frame=frame)[0] == ACCEPTED
    assert sea.state.mode is Mode.GOTO


@pytest.mark.parametrize("frame", [1, 2, 4, 7, 8, 9, 12, 20, 21, 200])
def test_a_place_in_metres_is_no_place(sea, frame):
    result, words = sea.console.reposition(1e-5, 1e-5, frame=frame)
    assert result == DENIED
    assert f"a position in frame {frame} has no latitude and longitude" in words
    assert sea.state.mode is Mode.IDLE


@pytest.mark.parametrize(("latitude_deg", "longitude_deg"), [(0.0, 0.0), (38.6930, 9.2150), (38.6930, -8.7)])
def test_a_place_that_is_too_far_away_is_refused(sea, latitude_deg, longitude_deg):
    result, words = sea.console.reposition(latitude_deg, longitude_deg)
    assert result == LATER
    assert "km to go; up to 20 km are allowed" in words
    assert sea.state.mode is Mode.IDLE


@pytest.mark.parametrize(("latitude_deg", "longitude_deg"), [(95.0, 0.0), (38.69, 181.0), (38.69, None), (None, -9.215)])
def test_what_is_no_place_is_denied_and_moves_nothing(sea, latitude_deg, longitude_deg):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    assert sea.console.reposition(latitude_deg, longitude_deg)[0] == DENIED
    nan = [math.nan if each is None else each for each in (latitude_deg, longitude_deg)]
    assert sea.console.command(192, -1, 1, 0, math.nan, *nan)[0] == DENIED
    assert sea.state.mode is Mode.IDLE


def test_the_present_position_is_held(sea):
    """NaN, or the largest integer: the standard's way to say that a position is not given."""
    sea.vehicle.on_command(console.LoadMission(MISSION))
    assert sea.console.reposition(None, None)[0] == ACCEPTED
    assert sea.state.mode is Mode.HOLD
    sea.console.mode(4)
    assert sea.console.command(192, -1, 1, 0, math.nan, math.nan, math.nan)[0] == ACCEPTED
    assert sea.state.mode is Mode.HOLD


@pytest.mark.parametrize("mode", [4, 0, 3, 5])
def test_without_the_flag_to_change_the_mode_it_stays(sea, mode):
    sea.console.mode(mode)
    before = sea.state.mode, sea.state.armed
    result, words = sea.console.reposition(38.6930, -9.2150, flags=0)
    assert result == LATER
    assert "set the flag that changes the mode" in words
    assert (sea.state.mode, sea.state.armed) == before


def test_in_the_ardurover_profile_the_guided_mode_waits_for_a_place(boat):
    sea = afloat(boat, autopilot="ardurover")
    sea.vehicle.on_command(console.LoadMission(MISSION))
    assert sea.console.mode(15)[0] == ACCEPTED
    sail(sea, 3.0)
    assert sea.state.mode is Mode.GOTO
    assert sea.state.actuation.thrust == (0.0, 0.0)
    assert sea.console.reposition(38.6930, -9.2150, flags=0)[0] == ACCEPTED
    sail(sea, 1.0)
    assert sea.state.actuation.thrust[1] > 0.0


@pytest.mark.parametrize(("percent", "mps"), [(0, 0.0), (10, 0.22), (80, 1.76), (100, 2.2)])
def test_the_speed_keys_go_before_the_plans_speed(sea, percent, mps):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    sea.console.command(300)
    sail(sea, 0.2)
    assert sea.state.reference.speed_mps == 1.5, "the boat's own"
    assert sea.console.command(178, 1, -1, percent)[0] == ACCEPTED
    heard = sail(sea, 1.0)
    assert sea.state.reference.speed_mps == pytest.approx(mps)
    assert newest(heard, "NAMED_VALUE_FLOAT").value == pytest.approx(mps)
    assert sea.console.command(178, 1, -2)[0] == ACCEPTED
    sail(sea, 0.2)
    assert sea.state.reference.speed_mps == 1.5


def test_another_mode_is_begun_at_its_own_speed(sea):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    sea.console.command(300)
    sea.console.command(178, 1, 0.4)
    sea.console.mode(4)
    sea.console.command(300)
    sail(sea, 0.2)
    assert sea.state.reference.speed_mps == 1.5


def test_play_from_an_item_and_the_current_one(sea):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    assert newest(sea.console.say("mission_set_current", 1, 1, 2), "MISSION_CURRENT").seq == 2
    assert sea.console.mode(10)[0] == ACCEPTED
    sail(sea, 0.2)
    assert sea.state.reference.leg == 1, "items: waypoint, speed, waypoint, speed, waypoint"
    assert sea.console.command(300, 0)[0] == ACCEPTED
    sail(sea, 0.2)
    assert sea.state.reference.leg == 0
    assert sea.console.command(224, 4)[0] == ACCEPTED
    sail(sea, 0.2)
    assert sea.state.reference.leg == 2
    assert sea.console.command(300, 9)[0] == DENIED


def test_arm_says_why_not_and_disarm_stops(boat):
    boat.clock.advance(10.0)
    vehicle = boat.vehicle
    station = Station(vehicle, vehicle.on_command, radio := Radio(), None)
    here = Console(station, radio)
    here.beat()
    assert "no navigation" in here.command(400, 1)[1]
    boat.ready()
    assert here.command(400, 1)[0] == ACCEPTED
    assert boat.state.armed
    here.mode(3)
    assert here.command(400, 0)[0] == ACCEPTED
    assert boat.state.mode is Mode.IDLE
    assert not boat.state.armed


def test_reset_reaches_the_bus_in_idle_only(sea):
    sea.console.mode(3)
    assert sea.console.command(246, 0, 0, 1)[0] == LATER
    sea.console.mode(4)
    sea.boat.heard()
    assert sea.console.command(246, 0, 0, 1)[0] == ACCEPTED
    assert sea.console.command(246, 0, 0, 1, 16)[0] == ACCEPTED
    resets = [messages.unpack_reset(frame.data) for frame in sea.boat.heard() if frame.arb == messages.RESET]
    assert resets == [127, 16]
    assert sea.console.command(246, 1)[0] == DENIED, "this computer does not restart on request"


# Requests.


@pytest.mark.parametrize("number", [0, 1, 2500, 31010, 65535])
def test_unknown_requests_are_answered(sea, number):
    assert sea.console.command(number) == (UNSUPPORTED, "")
    assert sea.console.command(number, target=0) == (UNSUPPORTED, "")


@pytest.mark.parametrize(
    ("number", "name"),
    [
        (148, "AUTOPILOT_VERSION"),
        (436, "CURRENT_MODE"),
        (242, "HOME_POSITION"),
        (33, "GLOBAL_POSITION_INT"),
        (2, "SYSTEM_TIME"),
    ],
)
def test_a_message_by_request(sea, number, name):
    answers = sea.console.say("command_long", 1, 1, 512, 0, number, 0, 0, 0, 0, 0, 0)
    way = {"DEBUG_FLOAT_ARRAY"} if name == "HOME_POSITION" else set()  # to it
    assert {m.get_type() for m in answers} == {name, "COMMAND_ACK", *way}
    assert newest(answers, "COMMAND_ACK").result == ACCEPTED


@pytest.mark.parametrize("asked", [(b"BOAT_NAME", -1), (b"", 0)])
def test_the_name_of_the_boat_by_request(sea, asked):
    answer = newest(sea.console.say("param_ext_request_read", 1, 1, *asked), "PARAM_EXT_VALUE")
    assert (answer.param_id, answer.param_value) == ("BOAT_NAME", sea.boat.vehicle.helm.settings.boat.name)


def test_each_run_of_a_boat_has_a_name_of_its_own_and_tells_it_to_all(sea):
    texts = {m.param_id: m.param_value for m in sea.console.say("param_ext_request_list", 1, 1)}
    again = newest(sea.console.say("param_ext_request_read", 1, 1, b"BOAT_RUN", -1), "PARAM_EXT_VALUE").param_value
    helm = sea.boat.vehicle.helm
    told = {"BOAT_NAME": helm.settings.boat.name, "SAILS_BY": helm.sails_by, "BOAT_SIZE": "4.5 2.45 1200"}
    assert texts == told | {"BOAT_RUN": again}
    another = Station(sea.boat.vehicle, lambda command, who: None, lambda data, to: None, None)
    assert again != another.consoles.texts()["BOAT_RUN"]


def test_a_text_that_does_not_exist_is_answered(sea):
    answer = newest(sea.console.say("param_ext_request_read", 1, 1, b"OTHER", -1), "PARAM_ERROR")
    assert (answer.param_id, answer.error) == ("OTHER", 1)


def test_all_modes_by_request(sea):
    answers = sea.console.say("command_long", 1, 1, 512, 0, 435, 0, 0, 0, 0, 0, 0)
    modes = {m.custom_mode: m.mode_name for m in answers if m.get_type() == "AVAILABLE_MODES"}
    assert set(modes) == set(Mode)


def test_a_message_that_does_not_exist_here(sea):
    assert sea.console.command(512, 395)[0] == UNSUPPORTED
    assert sea.console.command(512, math.nan)[0] == UNSUPPORTED


def test_time_is_answered_with_time(sea):
    answer = newest(sea.console.say("timesync", 0, 12345), "TIMESYNC")
    assert (answer.ts1, answer.tc1) == (12345, sea.boat.clock.time_ns())


def test_ping_ftp_and_logs_are_answered(sea):
    assert newest(sea.console.say("ping", 1, 7, 0, 0), "PING").seq == 7
    payload = newest(
        sea.console.say("file_transfer_protocol", 0, 1, 1, [1, 0, 9, 4] + [0] * 247), "FILE_TRANSFER_PROTOCOL"
    ).payload
    assert (payload[0], payload[2], payload[3], payload[12]) == (2, 9, 129, 7), "number, session, refused, for what"
    assert newest(sea.console.say("log_request_list", 1, 1, 0, 0xFFFF), "LOG_ENTRY").num_logs == 0
    data = newest(sea.console.say("log_request_data", 1, 1, 3, 90, 90), "LOG_DATA")
    assert (data.id, data.ofs, data.count) == (3, 90, 0)


# Telemetry.


def test_what_is_told_is_what_is(sea):
    sea.console.command(43002, 1, 90.0)
    heard = sail(sea, 5.0)
    at = newest(heard, "GLOBAL_POSITION_INT")
    assert (at.lat, at.lon, at.hdg) == (386_925_000, -92_150_000, 0)
    assert newest(heard, "ATTITUDE").yaw == 0.0
    assert [m.index for m in heard if m.get_type() == "RAW_RPM"][:2] == [0, 1]
    servos = newest(heard, "SERVO_OUTPUT_RAW")
    starboard, port = sea.state.actuation.thrust
    assert servos.servo2_raw == 0, "nothing turns"
    assert (servos.servo1_raw, servos.servo3_raw) == (1500 + round(500 * port), 1500 + round(500 * starboard))
    health = newest(heard, "SYS_STATUS")
    assert health.onboard_control_sensors_health & 0x10000000
    geofence = dialect.MAV_SYS_STATUS_GEOFENCE  # there is none, and it is not near
    assert (health.onboard_control_sensors_health & geofence, health.onboard_control_sensors_present & geofence) == (
        geofence,
        0,
    )
    assert (health.voltage_battery, health.battery_remaining) == (48000, 90)
    assert {m.id: m.battery_remaining for m in heard if m.get_type() == "BATTERY_STATUS"} == {0: 90, 1: 90}
    satellites = newest(heard, "GPS_RAW_INT")
    assert (satellites.fix_type, satellites.satellites_visible, satellites.eph) == (3, 9, 90)
    assert newest(heard, "NAV_CONTROLLER_OUTPUT").nav_bearing == 90
    assert newest(heard, "NAMED_VALUE_INT").value == 250
    assert newest(heard, "MISSION_CURRENT").mission_state == dialect.MISSION_STATE_NO_MISSION


def test_where_no_heading_is_kept_the_boats_own_is_told(sea):
    """At rest in hold a page drew a set heading of 000."""
    sea.console.mode(5)
    for _ in range(30):
        sea.boat.pass_time(0.1)
        sea.boat.navigate(heading_rad=math.radians(70.0))
        sea.boat.report()
        sea.station.tick()
    assert sea.state.reference.heading_rad is None
    heard = sea.console.listen()
    assert newest(heard, "NAV_CONTROLLER_OUTPUT").nav_bearing == 70
    assert sea.console.command(2600, 1)[0] == ACCEPTED
    for _ in range(30):
        sea.boat.pass_time(0.1)
        sea.boat.navigate(heading_rad=math.radians(70.0))
        sea.station.tick()
    assert newest(sea.console.listen(), "HIGH_LATENCY2").target_heading == 35


@pytest.mark.parametrize(("fix", "told"), [(0, 1), (2, 2), (3, 3), (4, 4), (5, 6), (6, 5), (9, 1)])
def test_the_kind_of_fix_is_the_protocols(sea, fix, told):
    """RTK is 6 there and RTK float 5; what is not known is no fix."""
    sea.boat.navigate(fix=fix)
    sea.station.tick()
    assert newest(sea.console.listen(), "GPS_RAW_INT").fix_type == told


@pytest.mark.parametrize(("accuracy_m", "told_mm"), [(None, 0), (0.014, 14), (0.0001, 1), (12.3, 12_300)])
def test_the_accuracy_of_the_position_is_told(sea, accuracy_m, told_mm):
    sea.boat.navigate(accuracy_m=accuracy_m)
    sea.station.tick()
    assert newest(sea.console.listen(), "GPS_RAW_INT").h_acc == told_mm


@pytest.mark.parametrize(
    ("profile", "positions", "beats", "most_bytes_per_s"),
    [("lean", 0, 10, 80), ("radio", 10, 10, 480), ("wifi", 100, 10, 2600)],
)
def test_rates_by_profile(boat, profile, positions, beats, most_bytes_per_s):
    sea = afloat(boat, profile=profile)
    sea.console.command(43002, 1, 90.0)
    sail(sea, 5.0)
    before = len(sea.radio.sent)
    heard = [m for _ in range(10) for m in [sea.console.beat(), sail(sea, 1.0)][1]]
    sent = sum(len(data) for data, _ in sea.radio.sent[before:]) / 10
    count = {name: sum(m.get_type() == name for m in heard) for name in ("GLOBAL_POSITION_INT", "HEARTBEAT", "HIGH_LATENCY2")}
    assert count["GLOBAL_POSITION_INT"] == pytest.approx(positions, abs=1)
    assert count["HEARTBEAT"] == pytest.approx(beats, abs=1)
    assert count["HIGH_LATENCY2"] == pytest.approx(10 if profile == "lean" else 0, abs=1)
    assert sent <= most_bytes_per_s


def test_lean_says_all_in_one(boat):
    sea = afloat(boat, profile="lean")
    sea.console.command(43002, 1, 90.0)
    one = newest(sail(sea, 2.6), "HIGH_LATENCY2")
    assert (one.latitude, one.longitude, one.custom_mode, one.target_heading) == (386_925_000, -92_150_000, 3, 45)
    assert (one.battery, one.custom0 & 0xFF) == (90, 250)
    starboard, port = sea.state.actuation.thrust
    assert (one.custom1, one.custom2) == pytest.approx((100 * port, 100 * starboard), abs=8)


def test_old_measurements_are_not_sent_again(sea):
    sail(sea, 1.0)
    before = len(sea.radio.sent)
    for _ in range(20):
        sea.boat.clock.advance(0.1)
        sea.station.tick()
    heard = sea.console.listen(before)
    assert not [m for m in heard if m.get_type() in ("GLOBAL_POSITION_INT", "ATTITUDE", "RAW_RPM")]
    assert [m for m in heard if m.get_type() == "HEARTBEAT"]


def test_a_console_asks_for_a_rate_and_for_a_profile(sea):
    assert sea.console.command(511, 33, 1e6)[0] == ACCEPTED
    assert sum(m.get_type() == "GLOBAL_POSITION_INT" for m in sail(sea, 5.0)) in (5, 6)
    assert sea.console.command(511, 33, -1)[0] == ACCEPTED
    assert not [m for m in sail(sea, 2.0) if m.get_type() == "GLOBAL_POSITION_INT"]
    assert sea.console.command(511, 33, 0)[0] == ACCEPTED
    assert sea.console.command(511, 99, 1e6)[0] == UNSUPPORTED
    assert sea.console.command(511, 0, -1)[0] == DENIED, "the heartbeat is never slower"
    assert sea.console.command(2600, 1)[0] == ACCEPTED
    assert {m.get_type() for m in sail(sea, 2.1)} == {"HEARTBEAT", "HIGH_LATENCY2"}
    sea.console.say("param_set", 1, 1, b"LINK_PROFILE", 1.0, 9)
    assert "HIGH_LATENCY2" not in {m.get_type() for m in sail(sea, 2.1)}


def test_reasons_come_in_plain_words_and_long_ones_in_pieces(sea):
    sea.console.mode(3)
    sea.boat.report(messages.Status.BAD, messages.Fault.OVERHEATED)
    sea.boat.vehicle.on_watchdog()
    before = len(sea.radio.sent)
    sea.station.tick()
    assert "idle: propeller starboard bad: overheated" in texts(sea.console.listen(before))
    sea.station.consoles.peers.say(4, "x" * 120)
    pieces = [m for m in sea.console.listen(before) if m.get_type() == "STATUSTEXT" and m.id]
    assert [(len(m.text), m.chunk_seq) for m in pieces] == [(50, 0), (50, 1), (20, 2)]


def test_a_console_that_comes_later_hears_why_the_boat_stopped_and_its_troubles(sea):
    """Once; so does one whose link was lost. Those that heard it do not hear it again; a boat that obeys has nothing to say."""
    other = Console(sea.station, sea.radio, 251, ("127.0.0.1", 4001))
    sail(sea, 1.0)
    assert texts(other.beat() + other.listen()) == "", "it is idle since it started"
    sea.console.mode(3)
    sea.boat.report(messages.Status.BAD, messages.Fault.OVERHEATED)
    sea.boat.vehicle.on_watchdog()
    sail(sea, 8.0), sea.console.beat(), sail(sea, 8.0)  # the boat does not hear the other one for that long
    for _ in range(70):
        sea.boat.pass_time(0.2, navigation=False), sea.console.beat(), sea.station.tick()
    assert [notice.action for notice in sea.state.notices] == ["warn"]
    before = len(sea.radio.sent)
    sea.console.beat(), other.beat()
    sea.station.tick(), sea.station.tick()
    assert "idle: propeller starboard bad: overheated" in texts(other.listen(before))
    assert all(f"{notice.reason}: {notice.action}" in texts(other.listen(before)) for notice in sea.state.notices)
    assert "overheated" not in texts(sea.console.listen(before))
    before = len(sea.radio.sent)
    other.beat(), sea.station.tick()
    assert "idle: " not in texts(other.listen(before))
    restarted = Console(sea.station, sea.radio, 251, ("127.0.0.1", 4002))
    restarted.beat(), sea.station.tick()
    assert "idle: " in texts(restarted.listen(before)), "the same console, started again"
    for seconds, words in ((1.0, 0), (2.0, 1)):  # it has just been told; at the same place another one may have begun
        sail(sea, seconds)
        before = len(sea.radio.sent)
        restarted.command(512, 435), sea.station.tick()
        assert texts(restarted.listen(before)).count("idle: ") == words


def test_a_trouble_that_lasts_is_told_again_with_what_it_has_become(sea):
    """When it has lasted twice as long; and a number that changes ten times a second makes no heartbeat more."""
    sea.console.command(43002, 1, 0.0)
    sail(sea, 9.0)
    before = len(sea.radio.sent)
    for _ in range(70):
        sea.boat.pass_time(0.1, navigation=False)
        sea.station.tick()
    heard = sea.console.listen(before)
    silent = [m.text for m in heard if m.get_type() == "STATUSTEXT" and m.text.startswith("navigation silent")]
    assert [text.split(": ")[1] for text in silent] == ["stop", "warn", "warn", "warn"]
    assert [float(text.split(" for ")[1].split(" s")[0]) for text in silent] == pytest.approx([1.1, 1.2, 3.2, 5.4], abs=0.3)
    assert sum(m.get_type() == "HEARTBEAT" for m in heard) <= 12


# Parameters.


def test_all_parameters_in_order_and_none_twice(sea):
    sea.console.say("param_request_list", 1, 1)
    values = [m for m in sail(sea, 2.0) if m.get_type() == "PARAM_VALUE"]
    assert [m.param_index for m in values] == list(range(values[0].param_count))
    told = {m.param_id: m.param_value for m in values}
    assert told["SPEED_MAX"] == pytest.approx(2.2)
    assert told["HEAD_P"] == pytest.approx(sea.vehicle.helm.limits.gains.p_nm_per_rad), "as it follows from the hull"


def test_a_parameter_is_changed_within_its_range_and_logged(sea):
    answers = sea.console.say("param_set", 1, 1, b"SPEED_MAX", 1.8, 9)
    assert newest(answers, "PARAM_VALUE").param_value == pytest.approx(1.8)
    assert sea.vehicle.helm.settings.control.speed.max_mps == 1.8
    assert sea.log == [console.Set("control.speed.max_mps", 1.8)]
    answers = sea.console.say("param_set", 1, 1, b"SPEED_MAX", -3.0, 9)
    assert newest(answers, "PARAM_VALUE").param_value == pytest.approx(1.8)
    assert "0.05 to 30.0" in texts(answers)
    answers = sea.console.say("param_set", 1, 1, b"LOSS_ACTION", 3.0, 9)
    assert sea.vehicle.helm.settings.failsafe.console_silent.action == "stop"
    assert newest(sea.console.say("param_request_read", 1, 1, b"LOSS_ACTION", -1), "PARAM_VALUE").param_value == 3.0
    assert "0 to 3" in texts(sea.console.say("param_set", 1, 1, b"LOSS_ACTION", 7.0, 9))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_no_parameter(sea, value):
    sea.console.say("param_set", 1, 1, b"LOSS_TIMEOUT", value, 9)
    assert sea.vehicle.helm.settings.failsafe.console_silent.after_s == 10.0


def test_a_parameter_that_does_not_exist(sea):
    assert newest(sea.console.say("param_request_read", 1, 1, b"NONSENSE", -1), "PARAM_ERROR").error == 1
    assert newest(sea.console.say("param_request_read", 1, 1, b"", 999), "PARAM_ERROR").error == 1
    assert newest(sea.console.say("param_set", 1, 1, b"NONSENSE", 1.0, 9), "PARAM_ERROR").error == 1


# Who commands.


def test_one_commands_and_others_take_over_by_saying_so(sea):
    other = Console(sea.station, sea.radio, system=251, address=("127.0.0.1", 14551))
    other.beat()
    assert sea.console.mode(3)[0] == ACCEPTED
    result, words = other.mode(5)
    assert (result, sea.state.mode) == (LATER, Mode.HEADING)
    assert "console 251 refused: console 250 commands; take over first" in words
    other.say("manual_control", 1, 500, 0, 0, 0, 0)
    assert other.command(32100, 0, 1)[0] == ACCEPTED
    assert other.mode(5)[0] == ACCEPTED
    assert sea.console.mode(3)[0] == LATER
    assert newest(sail(sea, 0.2), "NAMED_VALUE_INT").value == 251


def test_anybody_stops_the_boat(sea):
    other = Console(sea.station, sea.radio, system=251, address=("127.0.0.1", 14551))
    sea.console.mode(3)
    assert other.mode(4)[0] == ACCEPTED
    assert sea.state.mode is Mode.IDLE
    assert sea.station.consoles.owner == 250


def test_a_console_gives_up_and_the_next_one_commands(sea):
    other = Console(sea.station, sea.radio, system=251, address=("127.0.0.1", 14551))
    sea.console.mode(3)
    assert sea.console.command(32100, 0, 0)[0] == ACCEPTED
    assert other.mode(4)[0] == ACCEPTED
    assert other.mode(3)[0] == ACCEPTED


def test_onlookers_do_not_keep_the_boat_sailing(sea):
    """The silence of whoever commands is a trouble, however much others talk."""
    other = Console(sea.station, sea.radio, system=251, address=("127.0.0.1", 14551))
    sea.console.command(43002, 1, 0.0)
    for _ in range(9):
        other.beat()
        sea.vehicle.on_command(console.Alive())
        sail(sea, 1.0)
    assert sea.state.mode is Mode.HEADING
    for _ in range(2):
        other.beat()
        sea.vehicle.on_command(console.Alive())
        sail(sea, 1.0)
    assert sea.state.mode is Mode.HOLD
    assert sea.state.reason.startswith("console silent")


def test_whoever_commands_keeps_the_boat_sailing_by_its_heartbeat(sea):
    sea.console.command(43002, 1, 0.0)
    for _ in range(15):
        sea.console.beat()
        sail(sea, 1.0)
    assert sea.state.mode is Mode.HEADING


# The dead-man of manual thrust.


def test_thrust_ends_then_the_mode_and_coming_back_moves_nothing(sea):
    sea.console.mode(0)
    for _ in range(10):
        sea.console.say("manual_control", 1, 500, 0, 0, 0, 0)
        sail(sea, 0.2)
    assert sea.state.actuation.thrust[1] > 0.4
    heard = sail(sea, 2.1)
    assert sea.state.mode is Mode.MANUAL
    assert sea.state.actuation.thrust == (0.0, 0.0)
    assert "no thrust: no manual command" in texts(heard)
    for _ in range(5):
        sea.console.say("manual_control", 1, 500, 0, 0, 0, 0)
        sail(sea, 0.2)
    assert sea.state.actuation.thrust[1] == 0.0, "the operator lets go first"
    sea.console.say("manual_control", 1, 0, 0, 0, 0, 0)
    sea.console.say("manual_control", 1, 500, 0, 0, 0, 0)
    sail(sea, 1.0)
    assert sea.state.actuation.thrust[1] > 0.4
    sea.console.beat()
    sail(sea, 5.2)
    assert sea.state.mode is Mode.IDLE


# Once is once.


def test_a_command_repeated_for_want_of_an_answer_is_answered_and_not_obeyed_twice(sea):
    sea.vehicle.on_command(console.LoadMission(MISSION))
    assert sea.console.command(300, 0)[0] == ACCEPTED
    before = list(sea.log)
    sail(sea, 1.0)
    sea.console.command(512, 435)  # a question between the two
    assert sea.console.command(300, 0, confirmation=1)[0] == ACCEPTED
    assert sea.log == before


@pytest.mark.parametrize("stop", [(176, 1, 4), (400, 0)])
def test_a_stop_that_is_repeated_stops_again(sea, stop):
    sea.console.command(*stop)
    sea.vehicle.on_command(console.Heading(0.0), "console 250")
    assert sea.console.command(*stop, confirmation=1)[0] == ACCEPTED
    assert sea.state.mode is Mode.IDLE


def test_what_comes_twice_or_late_is_not_obeyed(sea):
    first, second = (sea.console.frame("command_long", 1, 1, 176, 0, 1, number, 0, 0, 0, 0, 0) for number in (3, 4))
    sea.console.deliver(second)
    sea.console.deliver(second)
    sea.console.deliver(first)
    assert sea.log == [console.Stop()]
    assert sea.station.consoles.counts["late"] == 2
    assert sea.state.mode is Mode.IDLE


def rtcm(sea, data: bytes, length: int) -> dict[str, int]:
    """GPS_RTCM_DATA; what the station counted since."""
    sea.console.say("gps_rtcm_data", 0, length, [*data, *bytes(180 - len(data))])
    return {name: count for name, count in sea.station.consoles.counts.items() if name.startswith("corrections")}


def test_corrections_are_handed_on_as_they_come_and_counted(sea):
    taken, is_there = [], True

    def correct(data: bytes) -> bool:
        taken.append(data)
        return is_there

    sea.station.consoles.correct = correct
    assert rtcm(sea, b"\xd3\x00\x13>\xd0", 5) == {"corrections": 1}
    is_there = False
    assert rtcm(sea, b"12345", 3) == {"corrections": 1, "corrections_lost": 1}
    assert taken == [b"\xd3\x00\x13>\xd0", b"123"]


def test_nobody_corrects_a_boat_without_such_a_receiver_and_the_guest_corrects_none(sea):
    assert rtcm(sea, b"\xd3", 1) == {"corrections_refused": 1}
    sea.station.consoles.correct = lambda data: pytest.fail("not from the guest")
    sea.console = Console(sea.station, sea.radio, component=191)
    assert rtcm(sea, b"\xd3", 1) == {"corrections_refused": 2}
