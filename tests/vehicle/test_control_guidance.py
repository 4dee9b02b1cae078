"""Missions, paths, station keeping and the way home in current and noise: the bounds of docs/control.md."""

import math
from itertools import pairwise

import msgspec
import pytest
from hypothesis import given, strategies

from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.simulator.tables import Sea
from delfim.vehicle.control.control import admit, control, enter
from delfim.vehicle.control.guidance import along, course_to_steer, turn_onto
from delfim.vehicle.control.memory import LineOfSight
from delfim.vehicle.control.modes.path import APPROACH
from delfim.vehicle.helm.setpoints import first
from delfim.vehicle.state import Arc, Line, Motion, Plan, Setpoint, Waypoint
from tests.vehicle.closed_loop import (
    ALL,
    DOCA,
    DT_S,
    LAWNMOWER,
    OTHERS,
    SETTINGS,
    Boat,
    current,
    described,
    errors,
    heading_step,
    hold_distances,
    home_errors,
    path_errors,
    play,
)

HERE = Motion(ALL, 0.0, 0.0, 0.0, 0.0, 1.5, 0.0)


@pytest.mark.parametrize("seed", range(20))
def test_every_waypoint_is_reached_in_half_a_metre_per_second_of_current(seed: int) -> None:
    closest, seconds = play(Boat(seed, current(seed)), DOCA)
    assert seconds < 480.0
    for approach_m, to in zip(closest, DOCA.waypoints, strict=True):
        assert approach_m <= to.acceptance_m


@pytest.mark.parametrize("seed", range(4))
def test_a_survey_is_played_to_its_end(seed: int) -> None:
    closest, _ = play(Boat(seed, current(seed, 4)), LAWNMOWER)
    for approach_m, to in zip(closest, LAWNMOWER.waypoints, strict=True):
        assert approach_m <= to.acceptance_m + 0.5  # the radius is measured with a position that errs by 0.3 m


def test_path_following_keeps_to_lines_and_wide_arcs() -> None:
    runs = [path_errors(Boat(seed, current(seed, 8)), DOCA.path) for seed in range(8)]
    on_lines, on_arcs = errors([e for run in runs for e in run[0]]), errors([e for run in runs for e in run[1]])
    assert on_lines.rms < 0.3
    assert on_lines.most < 1.5
    assert on_arcs.rms < 0.3
    assert on_arcs.most < 1.5


def test_path_following_keeps_to_half_turns_of_ten_metres() -> None:
    runs = [path_errors(Boat(seed, current(seed, 4)), LAWNMOWER.path) for seed in range(4)]
    assert errors([e for run in runs for e in run[0]]).rms < 0.6
    assert errors([e for run in runs for e in run[1]]).rms < 1.3
    assert errors([e for run in runs for on in run for e in on]).most < 3.0


def test_path_following_in_calm_water_is_better_than_the_sensor() -> None:
    on_lines, on_arcs = path_errors(Boat(), DOCA.path)
    assert errors(on_lines).rms < 0.3
    assert errors(on_arcs).rms < 0.3


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("speed_mps", [0.8, 1.5])
def test_a_course_over_ground_is_made_good_in_a_current_from_anywhere(seed: int, speed_mps: float) -> None:
    """Half a metre a second of it; a heading would be carried off by up to 30 degrees."""
    asked = Setpoint(speed_mps=speed_mps, heading_rad=math.radians(60.0))
    steady = list(Boat(seed, current(seed, 8)).sail(Mode.COURSE, asked, 90.0))[150:]
    made = [math.atan2(x.truth.east_mps, x.truth.north_mps) - asked.heading_rad for x in steady]
    assert max(map(abs, made)) < math.radians(2.0)
    if seed == 2:  # abeam
        assert abs(wrap(steady[-1].truth.heading_rad - asked.heading_rad)) > math.radians(10.0), "it crabs"


def test_a_boat_too_slow_to_have_a_course_steers_it_as_a_heading() -> None:
    asked = Setpoint(speed_mps=0.0, heading_rad=math.radians(60.0))
    lying = list(Boat(1, current(3, 8)).sail(Mode.COURSE, asked, 60.0))[150:]
    assert max(abs(wrap(x.truth.heading_rad - asked.heading_rad)) for x in lying) < math.radians(5.0)


def test_the_integral_takes_away_what_the_measured_course_does_not_see() -> None:
    """A velocity sensor that errs by 0.15 m/s athwart would leave the boat 0.8 m beside the line for ever."""

    class Deceived(Boat):
        def seen(self) -> Motion:
            seen = super().seen()
            return seen._replace(east_mps=seen.east_mps + 0.15)

    off = path_errors(Deceived(), (Line(0.0, 0.0, 900.0, 0.0, 1.5),))[0]
    assert abs(sum(off[:50]) / 50) > 0.4
    assert abs(sum(off[-300:]) / 300) < 0.15


def test_an_arc_of_more_than_one_turn_is_sailed_to_its_end() -> None:
    path = (Line(0.0, 0.0, 40.0, 0.0, 1.5), Arc(40.0, -20.0, 20.0, math.pi / 2.0, -4.0 * math.pi, 1.5))
    _, on_arcs = path_errors(Boat(), path)
    assert len(on_arcs) * DT_S * 1.5 == pytest.approx(4.0 * math.pi * 20.0, rel=0.2)


def test_a_path_begins_at_its_first_piece_or_at_the_one_that_is_told_wherever_the_boat_is() -> None:
    path = (
        Line(0.0, 0.0, 100.0, 0.0, 1.5),
        Arc(100.0, 20.0, 20.0, -math.pi / 2.0, math.pi, 1.5),
        Line(100.0, 40.0, 0.0, 40.0, 1.5),
    )
    setpoint = Setpoint(plan=Plan("", (), path))
    for north_m, east_m in ((50.0, 2.0), (120.0, 20.0), (50.0, 42.0), (50.0, 20.0)):
        there = HERE._replace(north_m=north_m, east_m=east_m)
        for piece, begins in enumerate(((0.0, 0.0), (100.0, 0.0), (100.0, 40.0))):
            told = setpoint._replace(piece=piece)
            memory = enter(Mode.PATH, there, told, SETTINGS)
            assert first(Mode.PATH, memory, told) == pytest.approx(begins)
            _, reference, _ = control(Mode.PATH, memory, there, told, SETTINGS, DT_S)
            assert reference[5:7] == (pytest.approx(begins[1]), piece)
            assert reference.north_m == pytest.approx(begins[0])
    assert admit(Mode.PATH, ALL, setpoint._replace(piece=3)) == "no piece 4: the path has pieces 1 to 3"


@pytest.mark.parametrize("start_m", [(0.0, 0.0), (60.0, 1.0), (3.0, 40.0)])
def test_a_survey_whose_lines_pass_where_the_boat_lies_is_sailed_from_end_to_end(start_m: tuple[float, float]) -> None:
    """Lines of a hundred metres, ten metres apart; the boat lies at one of their ends, or on one of them."""
    ends = [(n, 10.0 * i) for i in range(5) for n in ((0.0, 100.0) if i % 2 == 0 else (100.0, 0.0))]
    path = tuple(Line(*a, *b, 1.5) for a, b in pairwise(ends))
    boat = Boat()
    boat.model.north_m, boat.model.east_m = start_m
    for piece in (0, 6):
        setpoint = Setpoint(plan=Plan("", (), path), piece=piece)
        legs = [x.leg for x in boat.sail(Mode.PATH, setpoint, 900.0) if x.mode is Mode.PATH]
        assert list(dict.fromkeys(legs)) == [APPROACH - piece, *range(piece, len(path))]


@pytest.mark.parametrize(
    ("turn_deg", "kept"), [(0.0, 1.0), (30.0, math.cos(math.pi / 6.0)), (90.0, 0.0), (-120.0, 0.0), (180.0, 0.0)]
)
def test_round_a_corner_the_guidance_keeps_what_lies_aside_of_the_next_piece(turn_deg: float, kept: float) -> None:
    """What wind and water did on one line they do from another side on the next: the boat had to unlearn it for 25 to 50 m."""
    turn_rad = math.radians(turn_deg)
    path = (Line(0.0, 0.0, 60.0, 0.0, 1.5), Line(60.0, 0.0, 60.0 + 60.0 * math.cos(turn_rad), 60.0 * math.sin(turn_rad), 1.5))
    setpoint = Setpoint(plan=Plan("", (), path))
    memory = enter(Mode.PATH, HERE, setpoint, SETTINGS)
    memory = memory._replace(leg=0, course=LineOfSight(0.0, 2.0))
    before, _, _ = control(Mode.PATH, memory, HERE._replace(north_m=20.0), setpoint, SETTINGS, DT_S)
    after, _, _ = control(Mode.PATH, memory, HERE._replace(north_m=61.0), setpoint, SETTINGS, DT_S)
    assert (before.leg, after.leg) == (0, 1)
    assert before.course.shift_m == pytest.approx(2.0, abs=0.1)
    assert after.course.shift_m == pytest.approx(2.0 * kept, abs=0.1)


@pytest.mark.parametrize(("north_m", "onto_deg"), [(20.0, 45.0), (65.0, 45.0), (90.0, 75.1)])
def test_from_far_off_a_path_the_boat_comes_back_at_45_degrees_but_not_past_its_end(north_m: float, onto_deg: float) -> None:
    setpoint = Setpoint(plan=Plan("", (), (Line(0.0, 0.0, 100.0, 0.0, 1.5),)))
    memory = enter(Mode.PATH, HERE, setpoint, SETTINGS)._replace(leg=0)
    away = HERE._replace(north_m=north_m, east_m=30.0)
    _, reference, _ = control(Mode.PATH, memory, away, setpoint, SETTINGS, DT_S)
    assert reference.heading_rad is not None
    assert math.degrees(reference.heading_rad) == pytest.approx(-onto_deg, abs=0.5)


@pytest.mark.parametrize("seed", range(3))
def test_before_the_wind_the_boat_settles_on_its_line_without_crossing_it_to_and_fro(seed: int) -> None:
    """It came out of the turn too fast, and its heading came late: it was 1.2 m off to one side, and 0.8 to the other."""
    sea = Sea(current_mps=0.3, current_to_deg=180.0, wind_mps=6.0, wind_from_deg=0.0)
    corners = (0.0, 0.0), (60.0, 0.0), (60.0, -10.0), (-60.0, -10.0)
    path = tuple(Line(*here, *to, 1.5) for here, to in pairwise(corners))
    sailed = Boat(seed, sea, noise=0.1).sail(Mode.PATH, Setpoint(plan=Plan("", (), path)), 200.0)
    off_m = [abs(x.truth.east_m + 10.0) for x in sailed if x.mode is Mode.PATH and x.leg == 2 and x.truth.north_m < 40.0]
    assert len(off_m) > 200
    assert max(off_m) < 0.8


@given(
    *(strategies.floats(*each, allow_nan=False) for each in ((-8.0, 8.0), (-3.0, 3.0), (-1.5, 1.5), (1.0, 20.0))),
)
def test_the_turn_fed_forward_is_what_the_course_to_steer_does(
    off_m: float, tangent_rad: float, aside: float, ahead_m: float
) -> None:
    motion = HERE._replace(north_mps=-aside * math.sin(tangent_rad), east_mps=aside * math.cos(tangent_rad))
    table = msgspec.structs.replace(SETTINGS.control.path, lookahead_m=ahead_m, integral_gain=0.0)
    before, after = (course_to_steer(LineOfSight(), motion, 0.0, off_m + aside * s, table, 0.0)[1] for s in (-1e-4, 1e-4))
    assert turn_onto(motion, tangent_rad, off_m, ahead_m, 1.5) == pytest.approx((after - before) / 2e-4, abs=1e-6)


def test_the_turn_fed_forward_is_bounded_by_the_speed_asked_for() -> None:
    assert turn_onto(HERE._replace(east_mps=1e9), 0.0, 0.0, 5.0, 1.5) == pytest.approx(-0.3)


@pytest.mark.parametrize(("off_m", "turns"), [(0.5, True), (1.9, True), (2.1, False), (40.0, False)])
def test_farther_off_an_arc_than_its_radius_the_boat_does_not_turn_with_it(off_m: float, turns: bool) -> None:
    """A current took a boat off an arc of two metres: it turned on as fast as the arc, round and round, and drifted."""
    setpoint = Setpoint(plan=Plan("", (), (Arc(0.0, 0.0, 2.0, -math.pi / 2.0, math.pi, 1.0),)))
    memory = enter(Mode.PATH, HERE, setpoint, SETTINGS)._replace(leg=0)
    away = HERE._replace(north_m=0.5, east_m=-2.0 - off_m)
    _, reference, _ = control(Mode.PATH, memory, away, setpoint, SETTINGS, DT_S)
    assert reference.heading_rad is not None
    right = away._replace(heading_rad=reference.heading_rad)  # what is asked of it then is the arc's turn alone
    _, _, wanted = control(Mode.PATH, memory, right, setpoint, SETTINGS, DT_S)
    assert (wanted.yaw_nm > 300.0) is turns
    assert turns or abs(wanted.yaw_nm) < 100.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_boat_that_has_turned_far_beyond_its_arc_turns_back(side: float) -> None:
    """A current took a short boat off its course on an arc: the arc's turn was fed forward, stronger than what was to bring it
    back, and it went round and round for three minutes."""
    setpoint = Setpoint(plan=Plan("", (), (Arc(0.0, 0.0, 2.0, -side * math.pi / 2.0, side * math.pi, 1.0),)))
    memory = enter(Mode.PATH, HERE, setpoint, SETTINGS)._replace(leg=0)
    there = HERE._replace(north_m=0.5, east_m=-2.0 * side)
    _, reference, _ = control(Mode.PATH, memory, there, setpoint, SETTINGS, DT_S)
    assert reference.heading_rad is not None
    yaws_nm = list[float]()
    for beyond_rad in (-1.0, 0.1, 0.6, 2.0):
        at_rad = reference.heading_rad + side * beyond_rad
        turned = there._replace(heading_rad=at_rad, north_mps=math.cos(at_rad), east_mps=math.sin(at_rad))
        yaws_nm.append(side * control(Mode.PATH, memory, turned, setpoint, SETTINGS, DT_S)[2].yaw_nm)
    assert all(each > 0.0 for each in yaws_nm[:2]), "it turns with its arc"
    assert all(each < 0.0 for each in yaws_nm[2:])


def test_cross_track_is_positive_to_starboard() -> None:
    bearing_rad, cross_m, left_m = along(HERE._replace(north_m=10.0, east_m=3.0), 0.0, 0.0, 100.0, 0.0)
    assert (bearing_rad, cross_m, left_m) == (0.0, 3.0, 90.0)
    bearing_rad, cross_m, left_m = along(HERE._replace(north_m=3.0, east_m=-10.0), 0.0, 0.0, 0.0, -100.0)
    assert (bearing_rad, cross_m, left_m) == pytest.approx((-math.pi / 2.0, 3.0, 90.0))


def test_a_leg_can_be_jumped_to() -> None:
    setpoint = Setpoint(plan=DOCA, leg=7)
    samples = list(Boat().sail(Mode.PLAY, setpoint, 5.0))
    assert {x.reference.leg for x in samples} == {7}
    assert (samples[0].reference.north_m, samples[0].reference.east_m) == DOCA.waypoints[7][:2]


def test_a_narrow_miss_is_not_sailed_again_and_a_wide_one_is() -> None:
    plan = Plan("", (Waypoint(50.0, 0.0, 1.5, 2.0), Waypoint(200.0, 0.0, 1.5, 2.0)), ())
    setpoint = Setpoint(plan=plan)
    begun = enter(Mode.PLAY, HERE, setpoint, SETTINGS)
    narrow, _, _ = control(Mode.PLAY, begun, HERE._replace(north_m=50.1, east_m=3.5), setpoint, SETTINGS, DT_S)
    assert narrow.leg == 1
    wide, reference, _ = control(Mode.PLAY, begun, HERE._replace(north_m=50.1, east_m=9.0), setpoint, SETTINGS, DT_S)
    assert wide.leg == 0
    assert (wide.north_m, wide.east_m) == (50.1, 9.0)
    assert reference.cross_track_m == pytest.approx(0.0, abs=1e-9)


def test_the_speed_of_each_waypoint_is_kept() -> None:
    plan = Plan("", (Waypoint(80.0, 0.0, 1.0, 5.0), Waypoint(200.0, 0.0, 2.0, 5.0), Waypoint(300.0, 0.0, 2.0, 5.0)), ())
    samples = list(Boat().sail(Mode.PLAY, Setpoint(plan=plan), 130.0))
    assert [x.truth.north_mps for x in samples if x.leg == 0][-1] == pytest.approx(1.0, abs=0.15)
    assert [x.truth.north_mps for x in samples if x.leg == 1][-1] == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_a_waypoint_is_stayed_at_for_as_long_as_told(seed: int) -> None:
    """Near the point, in a current of any direction; then the boat goes on, and at the end waits again before it is done."""
    places = (Waypoint(60.0, 0.0, 1.5, 3.0, 120.0), Waypoint(60.0, 80.0, 1.5, 3.0, 20.0))
    samples = []
    for x in Boat(seed, current(seed, 4, 0.3)).sail(Mode.PLAY, Setpoint(plan=Plan("", places, ())), 600.0):
        samples.append(x)
        if x.reference.done:
            break
    for leg, to in enumerate(places):
        stayed = [
            x for x in samples if x.leg == leg and x.reference.speed_mps is not None and x.reference.cross_track_m is None
        ]
        assert len(stayed) * DT_S == pytest.approx(to.hold_s, abs=2.0 * DT_S)
        radius_m = SETTINGS.control.hold.radius_m + 3.0
        assert max(math.hypot(x.truth.north_m - to.north_m, x.truth.east_m - to.east_m) for x in stayed) < radius_m
    assert samples[-1].reference.done


@pytest.mark.parametrize("seed", range(4))
def test_goto_arrives_slowly_and_is_done(seed: int) -> None:
    target = Waypoint(-40.0, 70.0, 2.0, 5.0)
    samples = []
    for x in Boat(seed, current(seed, 4)).sail(Mode.GOTO, Setpoint(target=target), 200.0):
        samples.append(x)
        if x.reference.done:
            break
    arrived = samples[-1].truth
    assert samples[-1].reference.done
    assert math.hypot(arrived.north_m - target.north_m, arrived.east_m - target.east_m) < target.acceptance_m + 1.0
    assert math.hypot(arrived.north_mps, arrived.east_mps) < 1.75  # 2.0 asked for


def test_goto_without_a_point_stays_where_it_is() -> None:
    x = next(iter(Boat().sail(Mode.GOTO, Setpoint(plan=DOCA), 1.0)))
    assert x.reference.distance_m == pytest.approx(0.0, abs=1.0)
    assert x.reference.speed_mps == 0.0


@pytest.mark.parametrize("way_mps", [0.0, 1.5, 2.2])
@pytest.mark.parametrize("to_deg", [0.0, 90.0, 180.0])
def test_hold_stays_within_ten_metres_in_current_and_wind(way_mps: float, to_deg: float) -> None:
    sea = Sea(current_mps=0.5, current_to_deg=to_deg, wind_mps=8.0, wind_from_deg=90.0)
    distances = hold_distances(Boat(sea=sea), way_mps)
    assert max(distances) < 10.0
    assert max(distances[300:]) < 8.0


def test_hold_rests_in_calm_water() -> None:
    samples = list(Boat().sail(Mode.HOLD, Setpoint(), 300.0))
    assert all(x.sent == ((0.0, 0.0), (0.0, 0.0), True) for x in samples)


def test_hold_does_not_circle() -> None:
    boat = Boat(sea=Sea(current_mps=0.5), heading_rad=math.pi / 2.0)
    headings = [x.truth.heading_rad for x in boat.sail(Mode.HOLD, Setpoint(), 600.0)]
    turned_rad = sum(abs(math.remainder(b - a, math.tau)) for a, b in pairwise(headings))
    assert turned_rad < 2.0 * math.tau  # in ten minutes: once into the drift, and the small corrections


def test_hold_backs_up_to_a_point_close_astern() -> None:
    memory = enter(Mode.HOLD, HERE._replace(north_mps=0.0), Setpoint(), SETTINGS)
    near = HERE._replace(north_m=7.0, north_mps=0.0)
    for _ in range(5):
        memory, _, actuation = control(Mode.HOLD, memory, near, Setpoint(), SETTINGS, DT_S)
    assert actuation.surge_n < 0.0
    memory = enter(Mode.HOLD, HERE._replace(north_mps=0.0), Setpoint(), SETTINGS)
    _, _, actuation = control(Mode.HOLD, memory, HERE._replace(north_m=50.0, north_mps=0.0), Setpoint(), SETTINGS, DT_S)
    assert (actuation.surge_n, abs(actuation.yaw_nm)) == (0.0, SETTINGS.gains.p_limit_nm)  # far astern: turn


def test_hold_comes_back_sooner_where_the_fence_leaves_less_room() -> None:
    memory = enter(Mode.HOLD, HERE._replace(north_mps=0.0), Setpoint(), SETTINGS)
    there = HERE._replace(north_m=3.0, north_mps=0.0)
    _, _, resting = control(Mode.HOLD, memory, there, Setpoint(), SETTINGS, DT_S)
    _, _, returning = control(Mode.HOLD, memory._replace(room=0.4), there, Setpoint(), SETTINGS, DT_S)
    assert resting.surge_n == 0.0 > returning.surge_n


@pytest.mark.parametrize("seed", range(6))
def test_home_leads_back_along_the_driven_track(seed: int) -> None:
    off, end_m, points = home_errors(Boat(seed, current(seed, 6)))
    assert errors(off).rms < 2.5
    assert max(off) < 12.0  # while it turns around in the current; the track itself has corners of 5 m
    assert end_m < 6.0
    assert points <= 3  # driving home has taken the track back


def test_grex_follows_the_guest() -> None:
    setpoint = Setpoint(guest_heading_rad=math.radians(300.0), guest_speed_mps=1.0)
    last = list(Boat().sail(Mode.GREX, setpoint, 60.0))[-1].truth
    assert math.degrees(last.heading_rad) % 360.0 == pytest.approx(300.0, abs=2.0)
    assert math.hypot(last.north_mps, last.east_mps) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", OTHERS)
def test_the_gains_of_another_boat_follow_from_its_description(name: str) -> None:
    hull = OTHERS[name]
    vehicle = described(hull)
    over_deg, settled_s, _ = heading_step(Boat(hull=hull, vehicle=vehicle), 90.0, 1.5)
    assert over_deg < 5.0
    assert settled_s < 15.0
    runs = [path_errors(Boat(seed, current(seed, 4), hull=hull, vehicle=vehicle), DOCA.path) for seed in range(4)]
    assert errors([e for _, on_arcs in runs for e in on_arcs]).rms < 0.5


def test_a_run_is_repeated_bit_by_bit() -> None:
    assert play(Boat(3, current(3)), DOCA) == play(Boat(3, current(3)), DOCA)
