"""Where a mode cannot begin at once: a boat that cannot go home holds, says why, and goes home once its way is known unless it
was told otherwise meanwhile; astern it goes once in one place, and a survey's line goes on from a run-in."""

import math
import weakref
from functools import cache
from types import SimpleNamespace

import pytest

from delfim import config
from delfim.base import geodesy
from delfim.base.modes import Mode
from delfim.config import ASTERN
from delfim.vehicle import console
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.failsafe.failsafe import Action
from delfim.vehicle.helm import homeward
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.helm.homeward import SEEKING
from delfim.vehicle.plans.clearance import laid
from delfim.vehicle.plans.clearancefile import read
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.track import Point
from delfim.vehicle.plans.zones import charted, circle
from delfim.vehicle.state import Line, Plan, Setpoint
from tests.vehicle.charted import Shoal, chart
from tests.vehicle.test_helm import places
from tests.vehicle.test_pause import MISSION

AT = geodesy.origin(math.radians(38.6925), math.radians(-9.2150))
WALL: tuple[Shoal, ...] = tuple((20.0, float(east), 6.0) for east in range(-60, 61, 5))
DRIVEN = tuple((5.0 * n, 0.0) for n in range(8, -1, -1))
"""From 40 m north, beyond the wall, to the boat."""
SHUT = "no way home: no-go water is all about the "


@cache
def water(*shoals: Shoal) -> Fence:
    """About the boat, 118 m wide."""
    field = laid(read(chart(AT, shoals, knots=60)).water(""), AT)
    return Fence((charted("no-go water", field),), config.FenceTable())


@pytest.fixture
def helm(boat, monkeypatch) -> Helm:
    """Of a boat that takes several looks to know its way home."""
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    helm.plans.fence = water()
    helm.track.restore(DRIVEN, 5.0)
    monkeypatch.setattr(homeward, "SLICE", 1)
    return helm


def looks(helm: Helm) -> None:
    """Until the way home is known, and once more."""
    for _ in range(500):
        helm.go_on()
        if not helm.homeward.is_sought:
            break
    assert not helm.homeward.is_sought
    helm.go_on()


def now(helm: Helm) -> tuple[Mode, str]:
    return helm.state.mode, helm.state.reason


def goes_home(boat) -> str | None:
    return boat.vehicle.on_command(console.SetMode("home"))


# Home is asked for before its way is known.


def test_the_operators_home_waits_for_its_way(boat, helm):
    assert goes_home(boat) is None
    assert now(helm) == (Mode.HOLD, f"operator; {SEEKING}")
    assert boat.log.notes[-1] == f"hold: operator; {SEEKING}"
    helm.go_on()
    assert now(helm) == (Mode.HOLD, f"operator; {SEEKING}")
    looks(helm)
    assert now(helm) == (Mode.HOME, "operator")
    assert boat.state.setpoint.track == helm.track.way_home() == DRIVEN


def test_the_way_home_that_is_found_at_last_is_the_one_that_is_sailed(boat, helm, monkeypatch):
    helm.plans.fence = water((20.0, 0.0, 5.0))
    assert goes_home(boat) is None
    monkeypatch.undo()
    looks(helm)
    assert now(helm) == (Mode.HOME, "operator")
    assert boat.state.setpoint.track == helm.track.way_home()
    assert max(abs(east_m) for _, east_m in boat.state.setpoint.track) > 5.0, "round what it was driven over"


def test_home_after_a_restart_keeps_its_reason(boat, helm):
    helm.request(Mode.HOME, boat.state.setpoint, boat.clock.monotonic_s(), restarted="it was going home")
    assert now(helm) == (Mode.HOLD, f"it was going home; {SEEKING}")
    looks(helm)
    assert now(helm) == (Mode.HOME, "it was going home")


@pytest.mark.parametrize("before", [Mode.IDLE, Mode.HEADING, Mode.HOLD])
def test_the_failsafes_home_waits_for_its_way(boat, helm, before):
    helm.enter(before, "test")
    helm.fall_back(Action.HOME, "console silent", boat.clock.monotonic_s())
    assert now(helm) == (Mode.HOLD, f"console silent; {SEEKING}")
    looks(helm)
    assert now(helm) == (Mode.HOME, "console silent")


def test_home_at_the_end_of_a_mission_waits_for_its_way(boat, helm):
    assert boat.vehicle.on_command(MISSION) is None
    boat.state.setpoint = boat.state.setpoint._replace(plan=boat.state.setpoint.plan._replace(then_home=True))
    boat.state.mode = Mode.PLAY
    helm.plans.fence = water()
    helm.finish()
    assert now(helm) == (Mode.HOLD, f"play done, cannot go home: {SEEKING}")
    looks(helm)
    assert now(helm) == (Mode.HOME, "play done")


@pytest.mark.parametrize("before", [Mode.HEADING, Mode.HOLD])
def test_a_hold_that_is_no_home_stays_one(boat, helm, before):
    """Although the way home is being looked for just then."""
    helm.enter(before, "test")
    helm.go_on()
    assert helm.homeward.is_sought
    helm.fall_back(Action.HOLD, "gps bad", boat.clock.monotonic_s())
    looks(helm)
    assert now(helm) == (Mode.HOLD, "gps bad" if before is Mode.HEADING else "test")


def test_who_is_told_otherwise_meanwhile_does_not_go_home(boat, helm):
    assert goes_home(boat) is None
    assert boat.vehicle.on_command(console.Heading(0.0)) is None
    looks(helm)
    assert now(helm) == (Mode.HEADING, "operator")


def test_a_piece_of_the_way_that_was_driven_just_now_is_looked_at_at_once(boat, helm, monkeypatch):
    looks(helm)
    monkeypatch.undo()
    helm.track.add(-5.0, 0.0)
    places(boat, -5.0, 0.0)
    assert helm.homeward.is_sought
    assert goes_home(boat) is None
    assert now(helm) == (Mode.HOME, "operator")


# There is no way home.


def test_a_boat_that_waited_and_has_no_way_goes_on_holding_and_says_why(boat, helm, monkeypatch):
    helm.plans.fence = water(*WALL)
    assert goes_home(boat) is None
    assert now(helm) == (Mode.HOLD, f"operator; {SEEKING}")
    monkeypatch.undo()
    looks(helm)
    assert helm.state.mode is Mode.HOLD
    assert helm.state.reason.startswith(f"operator; {SHUT}")
    assert boat.log.notes[-1] == f"hold: {helm.state.reason}"
    assert (goes_home(boat) or "").startswith(f"home refused: {SHUT}")
    helm.enter(Mode.HOLD, "test")
    helm.fall_back(Action.HOME, "console silent", boat.clock.monotonic_s())
    assert helm.state.reason.startswith(f"console silent; {SHUT}")
    helm.plans.fence = water()
    looks(helm)
    assert helm.state.mode is Mode.HOLD, "nobody asks for it any more"


def test_a_boat_that_waited_and_has_lost_its_position_goes_on_holding(boat, helm):
    assert goes_home(boat) is None
    boat.state.motion = boat.state.motion._replace(has=frozenset({"heading"}))
    looks(helm)
    assert now(helm) == (Mode.HOLD, "operator; no position and no velocity: heading only")


def test_a_boat_on_its_way_home_waits_where_its_way_must_be_looked_at_again(boat, helm):
    looks(helm)
    assert goes_home(boat) is None
    helm.go_on()
    assert now(helm) == (Mode.HOME, "operator")
    helm.plans.fence = water((0.0, -50.0, 4.0))
    helm.go_on()
    assert now(helm) == (Mode.HOLD, f"operator; {SEEKING}")
    looks(helm)
    assert now(helm) == (Mode.HOME, "operator")


@pytest.mark.parametrize(
    ("track", "is_left_out"),
    [
        (((-40.0, 0.0), (0.0, 90.0), (-30.0, 0.0), (0.0, 70.0)), True),
        (((-40.0, 0.0), (-30.0, 0.0), (0.0, 90.0), (0.0, 70.0)), False),
    ],
)
def test_the_newest_point_of_the_track_is_left_out_behind_a_zone_and_no_other(boat, track: tuple[Point, ...], is_left_out):
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    helm.plans.fence = Fence((circle("rock", False, (0.0, 50.0), 10.0),), config.FenceTable())
    helm.track.restore(track, 5.0)
    refused = goes_home(boat)
    assert refused == (None if is_left_out else "home refused: no way home: the way leads through rock")
    assert boat.state.mode is (Mode.HOME if is_left_out else Mode.IDLE)
    assert boat.state.setpoint.track == (track[:-1] if is_left_out else ())


# Astern.


def unsticks(boat, helm: Helm) -> tuple[Mode, str]:
    helm.fall_back(Action.UNSTICK, "stuck", boat.clock.monotonic_s())
    return now(helm)


def test_a_boat_goes_astern_once_in_one_place(boat):
    """Which is as wide as two of its ways astern."""
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    wide_m = 2.0 * helm.limits.control.unstick.distance_m
    helm.enter(Mode.HEADING, "test")
    assert unsticks(boat, helm) == (Mode.UNSTICK, "stuck")
    places(boat, 0.0, wide_m)
    helm.enter(Mode.HEADING, "test")
    assert unsticks(boat, helm) == (Mode.UNSTICK, "stuck")
    for east_m in (wide_m + 1.0, 2.0 * wide_m - 0.1):
        places(boat, 0.0, east_m)
        helm.enter(Mode.HEADING, "test")
        assert unsticks(boat, helm) == (Mode.HOLD, "stuck; it went astern here before")


def test_a_boat_that_got_stuck_on_its_way_home_goes_on_home_although_it_went_astern_twice(boat):
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    helm.track.restore(DRIVEN, 5.0)
    assert goes_home(boat) is None
    assert unsticks(boat, helm) == (Mode.UNSTICK, "stuck")
    helm.enter(Mode.UNSTICK, "again")
    boat.state.reference = boat.state.reference._replace(distance_m=0.0, reason="15 m away")
    helm.finish()
    assert now(helm) == (Mode.HOME, "unstick done: 15 m away")


def test_the_operator_sends_it_astern_by_the_way_it_came_as_often_as_they_like(boat):
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    helm.track.restore(DRIVEN, 5.0)
    for _ in range(2):
        assert boat.vehicle.on_command(console.SetMode("unstick")) is None
        assert (boat.state.mode, boat.state.setpoint.track) == (Mode.UNSTICK, DRIVEN)
        assert boat.vehicle.on_command(console.SetMode("hold")) is None
    boat.state.motion = boat.state.motion._replace(has=frozenset({"heading"}))
    refused = boat.vehicle.on_command(console.SetMode("unstick"))
    assert refused == "unstick refused: no position and no velocity: heading only"


@pytest.mark.parametrize(("part", "refused"), [(0.99, "it cannot go astern: its thrusters push ahead alone"), (1.0, None)])
def test_a_boat_that_hardly_pushes_astern_does_all_but_that(boat, part, refused):
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    hull = helm.limits.hull
    helm.limits = helm.limits._replace(hull=hull._replace(astern_n=part * (ASTERN * hull.ahead_n)))
    assert boat.vehicle.on_command(console.SetMode("unstick")) == (refused and f"unstick refused: {refused}")
    assert boat.vehicle.on_command(console.Heading(0.0)) is None


# What goes on with a mode.


def test_a_search_that_a_mode_ends_is_let_go_bit_by_bit(boat):
    class Found:
        pass

    boat.ready()
    helm, found = boat.vehicle.helm, Found()
    gone = weakref.ref(found)
    helm.detour = SimpleNamespace(step=lambda: None, held=[[found]])  # type: ignore[assignment]
    del found
    helm.enter(Mode.HOLD, "test")
    assert helm.detour is None
    assert gone() is not None
    for _ in range(3):
        helm.plans.remains.let_go()
    assert gone() is None


def survey(*lines: int) -> Plan:
    """Lines to the north, 100 m each, one after the other; a survey's numbers of them."""
    pieces = (Line(100.0 * i, 0.0, 100.0 * (i + 1), 0.0, 1.0, line=line) for i, line in enumerate(lines))
    return Plan("survey", (), tuple(pieces), number=1, lines=max(lines))


@pytest.mark.parametrize(
    ("mode", "plan", "leg", "line_m"),
    [
        (Mode.PATH, survey(1, 2), -2, 200.0),
        (Mode.HEADING, survey(1, 2), 1, 30.0),
        (Mode.HEADING, None, 1, 30.0),
    ],
)
def test_a_survey_line_is_gone_on_with_from_a_run_in_and_nothing_else(boat, mode, plan, leg, line_m):
    boat.ready()
    helm = places(boat, 0.0, 0.0)
    run_in_m = 2.5 * helm.limits.control.path.lookahead_m
    helm.request(mode, Setpoint(plan=plan), boat.clock.monotonic_s(), Memory(leg=1, line_m=30.0), "it was there")
    assert helm.state.mode is mode
    assert (helm.memory.leg, helm.memory.line_m) == (leg, min(line_m, 30.0 + run_in_m) if leg < 0 else line_m)


@pytest.mark.parametrize(
    ("leg", "line_m", "heard"),
    [(-1, 0.0, [1.0]), (0, 0.0, [1.0, 2.0]), (-2, 0.0, [1.0, 2.0]), (-2, 30.0, [1.0, 2.0, 3.0])],
)
def test_actions_on_the_way_to_a_path_wait_for_it_and_those_of_a_line_gone_on_with_do_not(boat, leg, line_m, heard):
    boat.ready()
    actions = "".join(f"[[action]]\nafter = {n}\ncommand = 2000\nparams = [{n + 1.0}, 0, 0, 0]\n" for n in range(3))
    assert boat.vehicle.on_command(console.LoadMission(MISSION.text + actions)) is None
    assert boat.vehicle.on_command(console.SetMode("path")) is None
    helm = boat.vehicle.helm
    helm.memory = helm.memory._replace(leg=leg, line_m=line_m)
    helm.go_on()
    assert [each.params[0] for each in boat.state.announced] == heard
