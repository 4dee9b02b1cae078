"""The watchkeeper by itself, among swimmers, things and shores: where a decision is played, the helm is, too."""

import math
from typing import Any, Final

import pytest

from delfim import config
from delfim.base.cooperative import Work
from delfim.base.modes import Mode
from delfim.parts.traffic import watchkeeper
from delfim.parts.traffic.pastthings import Passage
from delfim.parts.traffic.swimmers import CLEAR_S
from delfim.parts.traffic.watchkeeper import LATE_S, LED_ASIDE
from delfim.vehicle.control.control import control
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.plans.fence import Fence, stopping_m
from delfim.vehicle.plans.zones import circle
from delfim.vehicle.state import Reference, Waypoint
from delfim.vehicle.target import Target
from tests.parts.traffic.test_on_guard import EAST, HERE, LIMITS, MARIA, TO, Boat

ANA: Final = MARIA._replace(key="ana", name="ANA", kind="person", east_m=HERE.east_m, speed_mps=0.0, length_m=1.0, margin_m=1.0)
PIER: Final = ANA._replace(key="pier", name="PIER", kind="thing")
ASKED_MPS: Final = TO.speed_mps
WORDS: Final = "propellers stopped: ANA, a swimmer, is beside the boat"


def ahead(thing: Target, far_m: float) -> Target:
    return thing._replace(north_m=HERE.north_m + far_m)


def still(boat: Boat, mode: Mode = Mode.GOTO) -> bool:
    """Whether a step of this mode is one without propellers, that goes on from where it was."""
    memory = Memory(north_m=3.0)
    own = control(Mode.GOTO, memory, HERE, TO, LIMITS, 0.2)
    after, reference, wanted = boat.keeper._still(mode, memory, own, LIMITS, 0.2)
    assert reference is own[1]
    assert (after is memory) is (wanted is STOP)
    assert (after is own[0]) is (wanted is own[2])
    return wanted is STOP


# Beside a swimmer.


def test_the_propellers_stop_at_once_and_turn_again_once_the_swimmer_is_clear(monkeypatch: pytest.MonkeyPatch) -> None:
    boat = Boat(monkeypatch)
    boat.look(ahead(ANA, 30.0))
    assert boat.helm.shapes == {"traffic": boat.keeper._kept_clear}
    boat.notes.clear()
    boat.state.motion = HERE._replace(north_m=HERE.north_m + 25.0)
    assert not boat.keeper.look(boat.helm, 101.2), "between two rounds"
    assert boat.state.traffic.order is not None
    assert (boat.state.traffic.order.words, boat.state.traffic.order.speed_mps) == (WORDS, 0.0)
    assert boat.helm.shapes == {"traffic": boat.keeper._still}
    assert still(boat)
    for _ in range(3):
        boat.look(ahead(ANA, 30.0), order=EAST)
        assert boat.state.traffic.order.words == WORDS
        assert boat.helm.shapes == {"traffic": boat.keeper._still}
    assert boat.notes == [f"traffic: {WORDS}"]
    for second in range(1, 10):
        boat.look()
        assert (boat.state.traffic.order is None) is (second >= CLEAR_S)
    assert boat.helm.shapes == {}
    assert not still(boat)


@pytest.mark.parametrize(
    ("mode", "guard", "has"),
    [
        (Mode.GOTO, {"enabled": False}, ("position", "velocity")),
        (Mode.MANUAL, {}, ("position", "velocity")),
        (Mode.GOTO, {}, ("velocity",)),
    ],
)
def test_who_drives_by_hand_or_without_a_guard_or_a_place_is_not_stopped(monkeypatch, mode, guard, has):
    boat = Boat(monkeypatch, mode, **guard)
    boat.blinded(*has)
    boat.look(ahead(ANA, 5.0))
    assert (boat.state.traffic.order, boat.helm.shapes) == (None, {})
    assert f"traffic: {WORDS}" not in boat.notes
    assert not still(boat)


def test_an_operator_who_overrules_turns_the_propellers_again_for_no_longer_than_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    boat = Boat(monkeypatch)
    boat.look(ahead(ANA, 5.0))
    boat.state.overruled_s = 103.0
    boat.keeper.look(boat.helm, 101.2)
    assert (boat.state.traffic.order, boat.helm.shapes) == (None, {})
    assert not still(boat)
    boat.look(ahead(ANA, 5.0))
    assert (boat.state.traffic.order, boat.state.traffic.guard) == (None, "cannot avoid: the operator overruled the guard")
    boat.look(ahead(ANA, 5.0))
    assert boat.state.traffic.order is not None, "at 103 s"


def test_a_stop_that_is_old_or_by_hand_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    boat = Boat(monkeypatch)
    assert not still(boat)
    boat.look(ahead(ANA, 5.0))
    assert [still(boat, mode) for mode in (Mode.GOTO, Mode.HEADING, Mode.MANUAL, Mode.IDLE)] == [True, True, False, False]
    boat.clock.advance(LATE_S)
    assert still(boat)
    boat.clock.advance(0.1)
    assert not still(boat)


# Past things.


class Led(Boat):
    """A boat whose way past things is told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, passage: Passage | None = None) -> None:
        super().__init__(monkeypatch)
        self.passage = passage
        monkeypatch.setattr(watchkeeper, "past", self.past)

    def past(self, *told: object) -> Work[Passage | None]:
        yield from ()
        return self.passage


ROUND: Final = Passage(((80.0, -10.0), (2000.0, -30.0)), "pier", "keeping clear of PIER", 1.0)


@pytest.mark.parametrize(
    ("part", "near", "mps"), [(1.0, 300.0, 1.0), (0.5, 300.0, 0.5), (1.0, 50.0, 0.5), (0.5, 50.0, 0.5), (None, 50.0, 0.5)]
)
def test_past_a_thing_the_route_bends_and_past_a_swimmer_it_is_slow_once(monkeypatch, part, near, mps):
    """`near`: a swimmer; `part`: of the speed, that the way past a thing asks for."""
    boat = Led(monkeypatch, None if part is None else ROUND._replace(part=part))
    boat.look(PIER, ahead(ANA, near))
    (_, _, route, *_), order = boat.asked[0], boat.state.traffic.order
    assert route.speed_mps == pytest.approx(mps * ASKED_MPS)
    if part is None:
        assert (order, route.points) == (None, ((2000.0, -30.0),))
        assert boat.helm.shapes == {"traffic": boat.keeper._slowly}
        return
    assert route.points == ROUND.points
    assert order is not None
    assert (order.words, order.speed_mps) == ("keeping clear of PIER", pytest.approx(mps * ASKED_MPS))
    assert order.course_rad == pytest.approx(math.atan2(20.0, 40.0))
    assert boat.helm.shapes == {"traffic": boat.keeper._kept_clear}


def test_the_way_past_a_thing_that_is_found_leads_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    boat = Boat(monkeypatch)
    boat.look(ahead(PIER, 40.0))
    assert boat.state.traffic.order is not None
    assert boat.state.traffic.order.words.startswith("keeping clear of PIER, which stands, leaving it to ")
    assert len(boat.asked[0][2].points) > 1
    boat.look(ahead(PIER, 40.0), order=EAST)
    assert boat.state.traffic.order.words == EAST.words, "ships go before"


@pytest.mark.parametrize(("cost", "is_decided"), [(269, True), (270, False)])
def test_among_things_a_slice_is_longer(monkeypatch: pytest.MonkeyPatch, cost: int, is_decided: bool) -> None:
    boat = Led(monkeypatch)
    boat.length = cost
    boat.state.traffic = boat.state.traffic._replace(targets=(PIER,), at_s=101.0)
    assert boat.keeper.look(boat.helm, 101.0)
    assert bool(boat.paid) is is_decided


@pytest.mark.parametrize(
    ("words", "course_rad", "notes"),
    [("keeping clear of PIER", 0.0, 0), ("keeping clear of PIER, at half speed", 1.0, 1), ("keeping clear of PIER", 1.0, 0)],
)
def test_on_the_way_past_a_thing_each_turn_is_not_a_line_of_the_log(monkeypatch, words, course_rad, notes):
    boat = Led(monkeypatch, ROUND)
    order = EAST._replace(key="pier", words="keeping clear of PIER", course_rad=0.0)
    boat.look(PIER, order=order)
    boat.notes.clear()
    boat.look(PIER, order=order._replace(words=words, course_rad=course_rad))
    assert boat.notes == notes * [f"traffic: {words}"]


def test_a_boat_that_goes_slowly_for_long_is_not_doubted(monkeypatch: pytest.MonkeyPatch) -> None:
    boat = Boat(monkeypatch, stopped_s=20.0)
    for _ in range(60):
        boat.look(MARIA, order=EAST._replace(speed_mps=0.5))
        assert boat.state.traffic.order is not None
        assert boat.state.traffic.order.words == EAST.words


# Beside a shore.


class Shore(Boat):
    """A boat on its way to a point, past which it is led; a zone lies beside the way there."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, room_m: float) -> None:
        """`room_m`: that the straight way leaves, beyond the margin."""
        super().__init__(monkeypatch)
        beside_m = 20.0 + config.FenceTable().margin_m + room_m
        self.helm.plans.fence = Fence((circle("the spit", False, (150.0, HERE.east_m + beside_m), 20.0),), config.FenceTable())
        self.helm.state, self.helm.enter, self.helm.detour = self.state, self.entered, None
        self.helm.memory = Memory(north_m=1.0, east_m=2.0)
        self.state.setpoint = TO._replace(via=(Waypoint(500.0, 0.0, 1.5, 5.0),), target=Waypoint(300.0, -30.0, 1.5, 5.0))
        self.state.reference, self.modes = Reference(north_m=300.0, east_m=-30.0), list[Any]()

    def entered(self, mode: Mode, reason: str) -> None:
        self.modes.append((mode, reason, self.state.setpoint))

    def led(self) -> None:
        """Aside, and back."""
        self.look(MARIA, order=EAST)
        self.look(MARIA)


ROOM_M: Final = stopping_m(config.FenceTable(), LIMITS.control.speed.cruise_mps)


def test_a_goto_that_was_led_to_where_it_has_no_room_to_stop_looks_for_a_way_round(monkeypatch: pytest.MonkeyPatch) -> None:
    boat = Shore(monkeypatch, 0.5 * ROOM_M)
    asked = boat.state.setpoint
    boat.led()
    ((mode, reason, setpoint),) = boat.modes
    assert mode is Mode.GOTO
    assert reason.startswith(f"{LED_ASIDE}: the way leads ")
    assert reason.endswith(": a way round is looked for")
    assert setpoint == boat.state.setpoint == asked._replace(target=None, via=()), "it waits meanwhile"
    assert boat.helm.detour.setpoint == asked._replace(via=())
    assert boat.helm.memory == Memory(north_m=1.0, east_m=2.0), "goto was entered anew: nothing is set after that"


def test_a_goto_with_room_goes_straight_on_from_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    boat = Shore(monkeypatch, 1.5 * ROOM_M)
    asked = boat.state.setpoint
    boat.led()
    assert (boat.modes, boat.helm.detour, boat.state.setpoint) == ([], None, asked)
    assert boat.helm.memory == Memory(north_m=HERE.north_m, east_m=HERE.east_m)
