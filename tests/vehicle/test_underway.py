"""A mission that changes while it is sailed: what may change, what stays, and that nothing jumps."""

import math
from collections.abc import Sequence
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.modes import Mode
from delfim.simulator.replay.rerun import rerun
from delfim.vehicle import console
from delfim.vehicle.plans import legs, underway
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.mission import Mission, PathPoint, PayloadItem, Waypoint
from delfim.vehicle.plans.underway import SAME_M, UnderWay
from delfim.vehicle.plans.zones import circle
from delfim.vehicle.state import Arc, Line, Plan
from delfim.vehicle.state import Waypoint as To
from tests.logging.sailing import Day, logged

HERE = 38.6925, -9.2150  # where the boat of the tests lies
NORTH_DEG, EAST_DEG = 1.0 / 111_000.0, 1.0 / 86_800.0  # of a metre
LIMITS = config.FenceTable()
places = st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))


def place(north_m: float, east_m: float) -> tuple[float, float]:
    return HERE[0] + north_m * NORTH_DEG, HERE[1] + east_m * EAST_DEG


def upload(*points: Sequence[float], **more: object) -> console.Upload:
    """A mission with these waypoints: north, east, and, where given, the speed to them."""
    rows = []
    for north_m, east_m, *speed in points:
        at = place(north_m, east_m)
        rows.append(Waypoint(latitude_deg=at[0], longitude_deg=at[1], speed_mps=speed[0] if speed else 0.0))
    return console.Upload(Mission(version=1, name="way", waypoint=tuple(rows), **more))


def reef(north_m: float, east_m: float, radius_m: float = 10.0) -> config.Area:
    return config.Area(name="reef", centre=(place(north_m, east_m),), radius_m=radius_m)


# The rule.


@given(st.lists(places, min_size=1, max_size=8), st.data())
def test_a_boat_goes_on_if_all_up_to_the_end_of_its_leg_stays_where_it_is(points, data):
    """Against a slow, obvious calculation: one plan is the other with waypoints moved, put in, taken out, or told otherwise."""
    new = list(points)
    for _ in range(data.draw(st.integers(0, 3))):
        at = data.draw(st.integers(0, len(new)))
        new[at : at + data.draw(st.integers(0, 2))] = data.draw(st.lists(places, max_size=2))
    rounding = st.floats(-0.9 * SAME_M, 0.9 * SAME_M)
    was = Plan("", tuple(To(*each, 1.0, 5.0) for each in points), ())
    now = Plan("", tuple(To(n + data.draw(rounding), e, 2.0, 3.0, 60.0) for n, e in new), ())
    leg = data.draw(st.integers(0, len(points) - 1))
    same = Sliced(underway.same(was, now)).finish()
    why = underway.differs(UnderWay(Mode.PLAY, leg), same, now)
    may = len(new) > leg and all(
        max(map(abs, (a[0] - b[0], a[1] - b[1]))) <= 0.01 for a, b in zip(points, new[: leg + 1], strict=False)
    )
    assert (why is None) is may, why
    assert why is None or f"the boat is on the leg to waypoint {leg + 1}" in why


def test_an_arc_is_the_same_where_its_ends_and_its_centre_are():
    arc = Arc(10.0, 20.0, 30.0, 1.0, -math.pi, 1.5)
    for other, kept in (
        (arc._replace(speed_mps=0.5, start_rad=1.001), 1),
        (arc._replace(turn_rad=-3.0), 0),
        (arc._replace(radius_m=31.0), 0),
        (Line(10.0, 20.0, 30.0, 1.0, 1.5), 0),
    ):
        assert Sliced(underway.same(Plan("", (), (arc,)), Plan("", (), (other,)))).finish() == (0, kept)


@given(st.integers(1, 6), st.integers(0, 5), st.integers(0, 7))
def test_what_is_behind_is_not_held_against_the_fence_and_all_else_is(count, leg, where):
    """A reef on one leg of a line northwards."""
    leg, line = min(leg, count - 1), [To(100.0 * n, 0.0, 1.0, 5.0) for n in range(count)]
    path = tuple(Line(a.north_m, 0.0, b.north_m, 0.0, 1.0) for a, b in pairwise(line))
    around = Fence((circle("reef", False, (100.0 * where - 50.0, 0.0), 5.0),), LIMITS)
    for now in (UnderWay(Mode.PLAY, leg), UnderWay(Mode.PATH, max(leg - 1, 0))):  # on the same line
        passed = underway.behind(now, is_joined=True)
        why = Sliced(legs.complaint(around, Plan("", tuple(line), path), 5.0, passed)).finish()
        assert (why is not None) is (max(leg, 1) <= where < count), (now, passed)


# The boat.


def sailing(boat, *points: Sequence[float], mode: str = "play", **more: object) -> object:
    boat.ready()
    for command in (upload(*points, **more), console.SetMode(mode)):
        assert boat.vehicle.on_command(command) is None
    boat.pass_time(0.4)
    return boat.vehicle.helm


LINE = (0.0, 0.0), (100.0, 0.0), (100.0, 100.0)  # the boat is at the first


def test_points_ahead_move_and_more_are_appended_while_the_leg_under_way_goes_on(boat):
    helm = sailing(boat, *LINE)
    assert helm.memory.leg == 1
    before, reference = helm.memory, boat.state.reference
    assert boat.vehicle.on_command(upload(*LINE[:2], (100.0, 50.0, 0.7), (0.0, 50.0))) is None
    assert (helm.memory.north_m, helm.memory.east_m, helm.memory.leg) == (before.north_m, before.east_m, before.leg)
    assert boat.state.reference == reference._replace(heading_rad=pytest.approx(reference.heading_rad, abs=1e-9))
    assert [to.east_m for to in boat.state.setpoint.plan.waypoints] == pytest.approx([0.0, 0.0, 50.0, 50.0], abs=0.2)
    assert len(helm.plans.mission.waypoint) == 4
    assert boat.state.mode is Mode.PLAY


@pytest.mark.parametrize(
    ("points", "why"),
    [
        ([LINE[0], (110.0, 0.0), LINE[2]], "waypoint 2 is at another place, and the boat is on the leg to waypoint 2"),
        ([(5.0, 0.0), *LINE[1:]], "waypoint 1 is at another place, and the boat is on the leg to waypoint 2"),
        ([LINE[0]], "waypoint 2 is missing, and the boat is on the leg to waypoint 2"),
    ],
)
def test_what_is_behind_and_the_leg_under_way_do_not_change(boat, points, why):
    helm = sailing(boat, *LINE)
    plan, mission = boat.state.setpoint.plan, helm.plans.mission
    refused = boat.vehicle.on_command(upload(*points))
    assert refused == f"mission refused: {why}; the boat sails the mission: change only what is ahead, or hold first"
    assert (boat.state.setpoint.plan, helm.plans.mission, boat.state.mode) == (plan, mission, Mode.PLAY)
    boat.vehicle.on_command(console.SetMode("hold"))
    assert boat.vehicle.on_command(upload(*points)) is None


def test_a_mission_that_leads_through_the_fence_ahead_is_refused_and_the_old_one_is_sailed(boat):
    sailing(boat, *LINE, fence=config.Zones(keep_out=(reef(50.0, 60.0),)))
    refused = boat.vehicle.on_command(upload(*LINE[:2], (10.0, 100.0), fence=config.Zones(keep_out=(reef(50.0, 60.0),))))
    assert refused == "mission refused: the leg to waypoint 3 leads through reef; missions keep 6 m away"
    assert len(boat.state.setpoint.plan.waypoints) == 3


def test_a_mission_that_is_sailed_is_not_taken_away_and_its_zones_outlast_it(boat):
    helm = sailing(boat, *LINE, fence=config.Zones(keep_out=(reef(-60.0, 0.0),)))
    assert boat.vehicle.on_command(console.Unload()) == "unload refused: the mission is being played; stop or hold first"
    assert boat.state.setpoint.plan is not None
    boat.vehicle.on_command(console.SetMode("hold"))
    assert boat.vehicle.on_command(console.Unload()) is None
    assert (boat.state.setpoint.plan, helm.plans.mission) == (None, None)
    assert boat.vehicle.on_command(console.Goto(*place(-60.0, 0.0))) == "goto refused: the way leads through reef"


def test_a_path_goes_on_with_other_pieces_ahead(boat):
    sailing(boat, *LINE, mode="path")
    assert (boat.state.mode, boat.vehicle.helm.memory.leg) == (Mode.PATH, 0)
    assert boat.vehicle.on_command(upload(*LINE[:2], (50.0, 50.0), (0.0, 50.0))) is None
    assert (boat.state.mode, len(boat.state.setpoint.plan.path)) == (Mode.PATH, 3)
    refused = boat.vehicle.on_command(upload(LINE[0], (50.0, 50.0), LINE[2]))
    assert "piece 1 of the path is at another place, and the boat is on piece 1 of the path;" in refused
    own = tuple(PathPoint(latitude_deg=n, longitude_deg=e) for n, e in (place(*LINE[0]), place(*LINE[1])))
    assert boat.vehicle.on_command(upload((300.0, 0.0), path=own)) is None, "waypoints are nothing to a path of its own"
    assert (len(boat.state.setpoint.plan.path), len(boat.state.setpoint.plan.waypoints)) == (1, 1)


# The fence alone.


def test_a_fence_that_leaves_room_ahead_comes_into_force_under_way(boat):
    helm = sailing(boat, *LINE)
    plan = boat.state.setpoint.plan
    assert boat.vehicle.on_command(console.SetFence(config.Zones(keep_out=(reef(50.0, 60.0),)))) is None
    assert (boat.state.mode, boat.state.setpoint.plan, len(helm.plans.fence.zones)) == (Mode.PLAY, plan, 1)
    assert helm.plans.mission.fence == helm.plans.zones


@pytest.mark.parametrize(
    ("zone", "why"),
    [
        ({"keep_out": (reef(100.0, 50.0),)}, "the leg to waypoint 3 leads through reef; missions keep 6 m away"),
        ({"keep_out": (reef(50.0, 0.0),)}, "the leg to waypoint 2 leads through reef; missions keep 6 m away"),
        ({"keep_out": (reef(0.0, -11.0),)}, "the leg to waypoint 2 leads 1.0 m past reef; missions keep 6 m away"),
        (
            {"keep_in": (reef(100.0, 60.0, 75.0),)},
            "the leg to waypoint 2 leads out of the mission's keep-in zone; missions keep 6 m away",
        ),
    ],
)
def test_a_fence_that_would_stop_the_boat_is_refused_and_nothing_is_lost(boat, zone, why):
    helm = sailing(boat, *LINE)
    refused = boat.vehicle.on_command(console.SetFence(config.Zones(**zone)))
    assert refused == f"fence refused: {why}; the boat sails the mission: change only what is ahead, or hold first"
    assert (boat.state.mode, helm.plans.fence, len(boat.state.setpoint.plan.waypoints)) == (Mode.PLAY, None, 3)


def test_a_boat_that_lies_off_its_line_is_not_fenced_out(boat):
    helm = sailing(boat, *LINE)
    boat.state.motion = boat.state.motion._replace(east_m=40.0)  # it kept clear of somebody
    refused = boat.vehicle.on_command(console.SetFence(config.Zones(keep_out=(reef(0.0, 40.0),))))
    assert refused.startswith("fence refused: the boat is 9.9 m inside reef; the boat sails"), refused
    refused = boat.vehicle.on_command(console.SetFence(config.Zones(keep_out=(reef(50.0, 21.0),))))
    assert refused.startswith("fence refused: the way leads through reef; the boat sails"), refused
    assert (boat.state.mode, helm.plans.fence) == (Mode.PLAY, None)


def test_a_leg_that_a_fence_forbids_behind_the_boat_is_not_begun_again(boat):
    helm = sailing(boat, (-100.0, 0.0), *LINE)
    assert boat.vehicle.on_command(console.Play(2)) is None
    assert boat.vehicle.on_command(console.SetFence(config.Zones(keep_out=(reef(-50.0, 0.0),)))) is None
    assert (boat.state.mode, helm.memory.leg) == (Mode.PLAY, 2)
    for leg in (0, 1):
        refused = boat.vehicle.on_command(console.Play(leg))
        assert refused == "play refused: the fence forbids the mission before waypoint 3: begin there"
    assert boat.vehicle.on_command(console.SetMode("path")) == (
        "path refused: the fence forbids the mission before piece 2: begin there"
    )
    assert boat.vehicle.on_command(console.Play(2)) is None
    boat.vehicle.on_command(console.Stop())
    assert boat.vehicle.on_command(console.SetFence(config.Zones())) is None
    assert boat.vehicle.on_command(console.Play(0)) is None


# Paused.


@pytest.mark.parametrize("mode", ["play", "path"])
def test_a_pause_goes_on_with_a_mission_that_changed_ahead(boat, mode):
    helm = sailing(boat, *LINE, mode=mode)
    before = helm.memory
    boat.vehicle.on_command(console.Pause())
    assert boat.vehicle.on_command(upload(*LINE[:2], (50.0, 50.0), (0.0, 50.0))) is None
    assert boat.vehicle.on_command(console.Continue()) is None
    assert (boat.state.reason, helm.memory.leg) == ("operator continues", before.leg)
    assert (helm.memory.north_m, helm.memory.east_m) == (before.north_m, before.east_m)
    assert len(boat.state.setpoint.plan.waypoints) == 4


def test_a_mission_that_changed_behind_does_not_go_on_but_is_taken(boat):
    sailing(boat, *LINE)
    boat.vehicle.on_command(console.Pause())
    assert boat.vehicle.on_command(upload((5.0, 0.0), *LINE[1:])) is None
    refused = boat.vehicle.on_command(console.Continue())
    assert refused == "continue refused: the mission has changed since the pause; choose the mode again"


# What follows from it.


def test_actions_are_announced_once_and_new_ones_at_their_places(boat):
    def photo(after: int, number: float) -> PayloadItem:
        return PayloadItem(after=after, command=2000, params=(number, 0.0, 0.0, 0.0))

    sailing(boat, *LINE, action=(photo(0, 1.0), photo(1, 2.0), photo(2, 3.0)))
    assert [each.params[0] for each in boat.state.announced] == [1.0, 2.0]
    assert boat.vehicle.on_command(upload(*LINE, action=(photo(0, 9.0), photo(1, 8.0), photo(2, 4.0)))) is None
    boat.pass_time(0.4)
    assert [each.params[0] for each in boat.state.announced] == [1.0, 2.0]
    boat.vehicle.helm.memory = boat.vehicle.helm.memory._replace(leg=2)  # the second waypoint is reached
    boat.pass_time(0.4)
    assert [each.params[0] for each in boat.state.announced] == [1.0, 2.0, 4.0]


def test_a_leg_that_ended_while_a_plan_was_looked_at_counts(boat):
    """It is looked at in slices, and accepted by the leg on which the boat is then."""
    helm = sailing(boat, *LINE)
    command = upload(LINE[0], LINE[1], (50.0, 50.0))
    Sliced(helm.plans.look(command)).finish()
    helm.memory = helm.memory._replace(leg=2)
    refused = boat.vehicle.on_command(command)
    assert "waypoint 3 is at another place, and the boat is on the leg to waypoint 3" in refused


def test_what_was_checked_from_the_leg_on_is_checked_anew_once_the_boat_begins_again(boat):
    helm = sailing(boat, (-100.0, 0.0), *LINE)
    boat.vehicle.on_command(console.Play(2))
    command = console.SetFence(config.Zones(keep_out=(reef(-50.0, 0.0),)))
    Sliced(helm.plans.look(command)).finish()
    assert helm.plans.has_looked(command)
    assert boat.vehicle.on_command(console.Play(0)) is None
    assert not helm.plans.has_looked(command)
    assert "the leg to waypoint 2 leads through reef" in boat.vehicle.on_command(command)


@pytest.mark.parametrize("mode", ["play", "path"])
def test_neither_the_line_nor_the_thrust_jumps_and_a_replay_does_the_same(tmp_path, mode):
    """In lock step, with wind and current: a mission changes three times; the boat sails as one whose mission did not, until
    it comes to what changed."""
    changes = {12.0: [(260.0, 20.0, 1.0)], 20.0: [(300.0, -40.0), (100.0, -40.0)], 30.0: [(250.0, -80.0)]}
    told: list[list[tuple[float, ...]]] = []
    for changed in (False, True):
        day = Day(tmp_path / str(changed), "simulation.sea.wind_mps=5.0", "simulation.sea.current_mps=0.3")
        day.sail(5.0)
        state = day.sailing.state
        at = math.degrees(state.navigation.latitude_rad), math.degrees(state.navigation.longitude_rad)

        def way(*ahead: Sequence[float], at: tuple[float, float] = at) -> console.Upload:
            rows = [(10.0, 0.0), (50.0, 5.0), (200.0, 0.0), *ahead]
            points = [(at[0] + row[0] * NORTH_DEG, at[1] + row[1] * EAST_DEG, *row[2:]) for row in rows]
            stops = [Waypoint(latitude_deg=n, longitude_deg=e, speed_mps=mps[0] if mps else 0.0) for n, e, *mps in points]
            return console.Upload(Mission(version=1, name="way", waypoint=tuple(stops)))

        for command in (way((250.0, 0.0)), console.SetMode(mode)):
            assert day.command(command) is None
        rows = told.append([]) or told[-1]
        for second in range(60):
            if second in changes:
                assert day.command(way(*changes[second]) if changed else console.SetSpeed()) is None
            day.sail(1.0)
            rows.append((state.reference.cross_track_m, state.reference.leg, *state.actuation.thrust, state.motion.north_m))
        assert state.mode.name.lower() == mode
        assert rows[-1][1] == (2 if mode == "play" else 1), "on the leg that changed ahead"
        day.end()
        result = rerun(logged(tmp_path / str(changed)), None)
        assert result.exact, result.text()
    assert told[0] == told[1]
