"""The door into a mode, the gate before the propellers, and what control answers to missing and mad inputs."""

import itertools
import math
import re
from pathlib import Path
from typing import TypeVar, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.modes import Mode
from delfim.canproxy.socket import CanSocket
from delfim.vehicle.control.control import MODES, Memory, Settings, admit, control, enter
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.helm.setpoints import first
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.state import NOWHERE, Arc, Line, Motion, Plan, Reference, Setpoint, State, TrialPieces, Wanted, Waypoint
from tests.vehicle.closed_loop import ALL, DELFIMX, DT_S, SETTINGS

DOCS = Path(__file__).parents[2] / "docs"
T = TypeVar("T")
INPUTS = ("position", "heading", "velocity")
PLAN = Plan("plan", (Waypoint(50.0, 0.0, 1.5, 5.0),), (Line(0.0, 0.0, 50.0, 0.0, 1.5), Arc(50.0, 20.0, 20.0, -1.57, 3.0, 1.0)))
TRIAL = TrialPieces(1, ((2.0, (0.2, 0.0)), (1.0, (0.0, 0.1))), 0.0, 0.0, 30.0, 0.9)
READY = Setpoint(
    1.0, 1.0, 0.5, 0.5, plan=PLAN, guest_heading_rad=1.0, guest_speed_mps=1.0, track=((0.0, 0.0), (9.0, 9.0)), trial=TRIAL
)
KNOWN = Motion(ALL, 1.0, 2.0, 0.5, 0.0, 1.0, 0.0)
FLOATS = st.floats() | st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 0.0, -0.0])
SUBSETS = [frozenset(c) for n in range(4) for c in itertools.combinations(INPUTS, n)]


def waypoints() -> st.SearchStrategy[Waypoint]:
    return st.builds(Waypoint, FLOATS, FLOATS, FLOATS, FLOATS)


def rows(of: st.SearchStrategy[T]) -> st.SearchStrategy[tuple[T, ...]]:
    return st.lists(of, max_size=3).map(tuple)


def plans() -> st.SearchStrategy[Plan]:
    pieces = st.builds(Line, *[FLOATS] * 5) | st.builds(Arc, *[FLOATS] * 6)
    return st.builds(Plan, st.just("mad"), rows(waypoints()), rows(pieces))


def trials() -> st.SearchStrategy[TrialPieces]:
    pieces = st.lists(st.tuples(FLOATS, st.tuples(FLOATS, FLOATS)), min_size=1, max_size=3).map(tuple)
    return st.builds(TrialPieces, st.just(1), pieces, *[FLOATS] * 4)


SETPOINTS = st.builds(
    Setpoint,
    FLOATS,
    FLOATS,
    FLOATS,
    FLOATS,
    target=st.none() | waypoints(),
    via=rows(waypoints()),
    plan=st.none() | plans(),
    leg=st.integers(-2, 5),
    guest_heading_rad=st.none() | FLOATS,
    guest_speed_mps=FLOATS,
    track=rows(st.tuples(FLOATS, FLOATS)),
    trial=st.none() | trials(),
)
MOTIONS = st.builds(Motion, st.sampled_from(SUBSETS), *[FLOATS] * 6)
FRACTIONS = st.tuples(*[st.floats(-1.0, 1.0)] * 2)


def test_every_mode_has_a_row_and_says_what_it_is() -> None:
    MODES.load()
    assert set(MODES) == set(Mode)
    for program in MODES.values():
        assert set(INPUTS) >= program.NEEDS
        assert program.SENTENCE.endswith(".")


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("has", SUBSETS, ids=lambda has: "+".join(sorted(has)) or "nothing")
def test_a_mode_runs_with_what_it_needs_and_stops_without(mode: Mode, has: frozenset[str]) -> None:
    motion = Motion(has, *KNOWN[1:])
    memory = enter(mode, motion, READY, SETTINGS)
    after, reference, actuation = control(mode, memory, motion, READY, SETTINGS, DT_S)
    refusal = admit(mode, has, READY)
    assert reference.reason == (refusal or "")
    if has >= MODES[mode].NEEDS:
        assert refusal is None
        assert actuation.run == (mode is not Mode.IDLE)
    else:
        assert refusal is not None
        for missing in MODES[mode].NEEDS - has:
            assert missing in refusal
        assert actuation == STOP
        assert after == memory


def test_refusals_are_sentences_for_a_tired_operator() -> None:
    assert admit(Mode.PLAY, frozenset({"heading", "velocity"}), READY) == "no position: heading and velocity only"
    assert admit(Mode.HEADING, frozenset(), READY) == "no heading"
    assert admit(Mode.PLAY, ALL, Setpoint()) == "no mission loaded"
    assert admit(Mode.PLAY, ALL, READY._replace(leg=1)) == "no leg 2: the mission has legs 1 to 1"
    assert admit(Mode.PATH, ALL, Setpoint()) == "no mission loaded"
    assert admit(Mode.PATH, ALL, Setpoint(plan=PLAN._replace(path=()))) is not None
    assert admit(Mode.GREX, ALL, Setpoint()) == "no set point from the guest computer"
    assert admit(Mode.HOME, ALL, Setpoint()) == "no driven track to go back along"


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("field", Motion._fields[1:])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9])
def test_navigation_that_makes_no_sense_stops_and_leaves_no_trace(mode: Mode, field: str, value: float) -> None:
    motion = Motion(**{**KNOWN._asdict(), field: value})
    memory = enter(mode, KNOWN, READY, SETTINGS)
    after, reference, actuation = control(mode, memory, motion, READY, SETTINGS, DT_S)
    assert (after, actuation) == (memory, STOP)
    assert reference.reason == "navigation makes no sense"


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("field", "most"), [*zip(Motion._fields[1:], (1e7, 1e7, 1e3, 1e3, 100.0, 100.0), strict=True)])
def test_navigation_makes_sense_up_to_its_limits(field: str, most: float, sign: float) -> None:
    for part, reason in ((0.999, ""), (1.0, "navigation makes no sense")):
        motion = Motion(**{**KNOWN._asdict(), field: sign * part * most})
        assert (
            control(Mode.HEADING, enter(Mode.HEADING, KNOWN, READY, SETTINGS), motion, READY, SETTINGS, DT_S)[1].reason
            == reason
        )
        assert (enter(Mode.HOLD, motion, READY, SETTINGS) == Memory()) is (part == 1.0)


@pytest.mark.parametrize(("dt_s", "is_refused"), [(-1e-9, True), (0.0, False), (0.5, False), (9.9e6, False), (1e7, True)])
def test_a_step_of_time_makes_sense_within_its_limits(dt_s: float, is_refused: bool) -> None:
    memory = enter(Mode.HEADING, KNOWN, READY, SETTINGS)
    _, reference, wanted = control(Mode.HEADING, memory, KNOWN, READY, SETTINGS, dt_s)
    assert reference.reason == ("navigation makes no sense" if is_refused else "")
    assert wanted.run is not is_refused


class Failing:
    """A mode whose numbers go wrong."""

    NEEDS: frozenset[str] = frozenset()
    SENTENCE = "It fails."

    def __init__(self, told: Wanted | None) -> None:
        self._told = told

    def lacks(self, setpoint: Setpoint) -> str | None:
        return None

    def enter(self, motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
        raise OverflowError

    def step(
        self, memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
    ) -> tuple[Memory, Reference, Wanted]:
        if self._told is None:
            raise ValueError
        return Memory(leg=7), Reference(), self._told


@pytest.mark.parametrize("told", [None, Wanted(math.nan), Wanted(0.0, math.inf), Wanted(0.0, 0.0, -math.inf)])
def test_a_mode_that_fails_or_asks_for_what_is_not_finite_stops(monkeypatch: pytest.MonkeyPatch, told: Wanted | None) -> None:
    memory, mad = Memory(leg=3), "set point makes no sense"
    monkeypatch.setitem(MODES, Mode.HOLD, Failing(told))
    assert enter(Mode.HOLD, KNOWN, READY, SETTINGS) == Memory()
    assert control(Mode.HOLD, memory, KNOWN, READY, SETTINGS, DT_S) == (memory, Reference(reason=mad), STOP)


def test_where_a_mode_goes_first() -> None:
    place, begun = Waypoint(7.0, 8.0, 1.0, 2.0), Memory(leg=0)
    two = PLAN._replace(waypoints=(*PLAN.waypoints, place))
    assert first(Mode.GOTO, Memory(), READY._replace(target=place)) == (7.0, 8.0)
    assert first(Mode.HOLD, Memory(), READY._replace(target=place)) is None
    assert first(Mode.PLAY, Memory(), READY._replace(plan=two, leg=1)) == (7.0, 8.0)
    assert first(Mode.PLAY, Memory(), READY._replace(plan=None)) is None
    assert first(Mode.GOTO, Memory(), READY) is None
    assert first(Mode.PATH, Memory(leg=-1), READY) == (0.0, 0.0)
    assert first(Mode.PATH, begun, READY) is None, "it is on the path"
    assert first(Mode.PATH, Memory(leg=-1), READY._replace(plan=None)) is None
    assert first(Mode.HEADING, Memory(leg=-1), READY) is None


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e308, -1e308])
def test_a_set_point_that_makes_no_sense_stops_or_changes_nothing(mode: Mode, value: float) -> None:
    pieces = (Arc(*[value] * 6), Line(*[value] * 5))
    plan = Plan("mad", (Waypoint(*[value] * 5),), pieces)
    place = Waypoint(*[value] * 5)
    mad = Setpoint(value, value, value, value, place, (place,), plan, 0, 0, value, value, ((value, value),) * 2)
    memory = enter(mode, KNOWN, mad, SETTINGS)
    after, reference, actuation = control(mode, memory, KNOWN, mad, SETTINGS, DT_S)
    assert math.isfinite(actuation.surge_n + actuation.yaw_nm)
    if reference.reason:
        assert (after, actuation) == (memory, STOP)


@given(st.sampled_from(Mode), MOTIONS, SETPOINTS, FLOATS, FRACTIONS)
def test_whatever_comes_what_is_sent_is_finite_and_within_limits(mode, motion, setpoint, dt_s, before):
    propulsion = Propulsion((), cast(CanSocket, None), DELFIMX.thrusters, State())
    memory = enter(mode, motion, setpoint, SETTINGS)
    propulsion.send(Wanted(hand=before), 1.0)
    for seen, now_s in ((motion, 1.0 + dt_s), (KNOWN, 2.0)):
        memory, _, wanted = control(mode, memory, seen, setpoint, SETTINGS, dt_s)
        sent = propulsion.send(wanted, now_s)
        assert max(map(abs, sent.thrust)) <= 1.0
        assert sent.run or sent.thrust == (0.0, 0.0)


def test_idle_and_manual_need_nothing() -> None:
    assert control(Mode.IDLE, Memory(), NOWHERE, Setpoint(), SETTINGS, DT_S)[2] == STOP
    asked = Setpoint(starboard=-0.5, port=2.0)
    assert control(Mode.MANUAL, Memory(), NOWHERE, asked, SETTINGS, DT_S)[2] == Wanted(hand=(-0.5, 1.0))


def test_a_guest_that_asked_for_nothing_gets_a_stop() -> None:
    _, reference, actuation = control(Mode.GREX, Memory(), KNOWN, Setpoint(), SETTINGS, DT_S)
    assert actuation == STOP
    assert "guest" in reference.reason


def test_the_documents_have_a_line_for_each_mode() -> None:
    control, mavlink = ((DOCS / name).read_text() for name in ("control.md", "mavlink.md"))
    needs = control.partition("| mode | needs |")[2].partition("\n\n")[0]
    assert set(re.findall(r"^\| (\w+) \|", needs, re.MULTILINE)) == {mode.name.lower() for mode in Mode}
    numbers = mavlink.partition("## Modes")[2].partition("\nEvery mode")[0]
    told = {int(number): name for number, name in re.findall(r"\| (\d+)[, \d]* \| (\w+)", numbers)}
    assert {number: name.lower() for number, name in told.items()} == {mode.value: mode.name.lower() for mode in Mode}
