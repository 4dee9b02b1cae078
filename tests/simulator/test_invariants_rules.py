"""Each rule of the watch, and a boat that breaks it: its program is changed in one place, and it sails."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from delfim import config
from delfim.base.modes import Mode
from delfim.parts.dsor.driver import Propellers
from delfim.simulator.invariants import thrust
from delfim.simulator.scenarios.random_faults import mixed_mission, place_of
from delfim.simulator.scenarios.scenario import FaultAt, Scenario, settings_of
from delfim.simulator.scenarios.trial import sail
from delfim.vehicle import console, loop, snapshot
from delfim.vehicle.control import guidance, hull
from delfim.vehicle.control.modes import goto, heading, hold, play
from delfim.vehicle.failsafe import failing, failsafe, troubles
from delfim.vehicle.helm import helm, setpoints
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.log import record
from delfim.vehicle.orders import handlers
from delfim.vehicle.propulsion import propulsion
from delfim.vehicle.voyagestate import VoyageState

VEHICLE = str(Path(__file__).parents[2] / "etc/delfimx.toml")
HERE = config.load(VEHICLE).simulation
CORNERS = [place_of(HERE, n * 65.0, e * 65.0) for n, e in ((1, -1), (1, 1), (-1, 1), (-1, -1))]
EAST = {"command": "heading", "heading_deg": 90.0, "speed_mps": 1.5, "at_s": 4.0}
NEAR = dict(zip(("latitude_deg", "longitude_deg"), place_of(HERE, -10.0, 0.0), strict=True))
GOTO = {"command": "goto", **NEAR, "at_s": 4.0}
PLAY = {"command": "play", "at_s": 4.0}
PUSH = {"command": "manual", "starboard": 0.5, "port": 0.5, "at_s": 4.0}
STAY = {"command": "mode", "mode": "hold", "at_s": 10.0}
LOST = FaultAt(at_s=5.0, kind="console_lost", for_s=30.0)
AGAIN = FaultAt(at_s=8.0, kind="restarted")
DARK = FaultAt(at_s=8.0, kind="navigation_silent", for_s=3.0)


def failures(*orders: dict[str, Any], fault: FaultAt | None = None, seconds: float = 16.0) -> list[str]:
    scenario = Scenario(
        version=1,
        name="a broken boat",
        seconds=seconds,
        vehicle={"fence": {"keep_in": [{"polygon": CORNERS}]}, "control": {"hold": {"radius_m": 2.0}}},
        command=orders,
        fault=() if fault is None else (fault,),
        patient=False,
    )
    return sail(scenario, settings_of(scenario, VEHICLE), 1, mixed_mission(HERE)).failures


def twice(function: Callable[..., Any], at: int) -> Callable[..., Any]:
    """The function with one of its arguments twice as large."""
    return lambda *given: function(*given[:at], 2.0 * given[at], *given[at + 1 :])


def but(function: Callable[..., Any], change: Callable[[Any], Any]) -> Callable[..., Any]:
    return lambda *given, **named: change(function(*given, **named))


def off(state: Any) -> Any:
    return state._replace(thrust=(0.0, 0.0), run=False)


def refused_late(self: Helm, command: Any, now_s: float) -> None:
    self.state.setpoint = self.state.setpoint._replace(starboard=command.starboard)
    PUSHED(self, command, now_s)


def tired(self: Helm) -> None:
    WENT_ON(self)
    if self.state.mode is Mode.GOTO:
        self.enter(Mode.HEADING, "tired")


def taken(change: Callable[[Any], None]) -> Callable[..., bool]:
    """Navigation that is taken into the state, and changed there."""

    def take(source: Any, fix: Any, sources: Any, state: Any, limits: Any) -> bool:
        is_taken = TAKE(source, fix, sources, state, limits)
        change(state)
        return is_taken

    return take


def counts_twice(state: Any) -> None:
    state.cycles += 1


def races(state: Any) -> None:
    state.motion = state.motion._replace(north_mps=9.0)


def leaps(state: Any) -> None:
    state.motion = state.motion._replace(north_m=state.motion.north_m + 7.0 * (state.cycles % 2))


def foresees(state: Any) -> None:
    state.changed_s += 9.0


def half_full(state: Any) -> None:
    for side, (told, at_s) in state.sysstat.items():
        if side.startswith("batteries"):
            state.sysstat[side] = told._replace(charge=0.5), at_s


def entered_else(self: Helm, mode: Mode, reason: str, resumed: Any = None) -> None:
    ENTERED(self, mode, reason, resumed)
    self.state.reason = "because"


def waits_anew(self: failing.Failing, now_s: float) -> None:
    self._off_s.clear()
    WAITED(self, now_s)


WAITED = failing.Failing._wait_for_rest
STUCK = FaultAt(at_s=6.0, kind="thruster_stuck", where="starboard")
TO_AND_FRO = [
    {"at_s": 7.0 + 0.6 * n, **({"command": "mode", "mode": "manual"} if n % 2 else {"command": "stop"})} for n in range(13)
]
TAKE, ENTERED = loop.take, Helm.enter
PUSHED, WENT_ON = handlers.OBEYED[console.Manual], Helm.go_on
BREAKS: dict[str, tuple[Any, str, Any, tuple[dict[str, Any], ...], FaultAt | None, str]] = {
    "rate": (propulsion, "limited", twice(propulsion.limited, 3), (EAST,), None, "thrust from"),
    "off": (propulsion, "limited", but(propulsion.limited, off), (EAST,), None, "the thrusters are off"),
    "restarted": (
        *(propulsion, "limited", but(propulsion.limited, off)),
        *(({**EAST, "at_s": 13.0},), AGAIN, "the thrusters are off"),
    ),
    "returned": (config.Restarted, "after", lambda self, mode: "resume", (EAST,), AGAIN, "the restart brings heading"),
    "forgotten": (VoyageState, "wanted", lambda self, now: now, (EAST,), AGAIN, "the set points aboard are others"),
    "bus": (
        *(Propellers, "send", lambda self, sent, now_s: SENT(self, sent._replace(thrust=(0.0, 0.0)), now_s)),
        *((EAST,), None, "the bus says"),
    ),
    "law": (
        heading,
        "steer",
        but(heading.steer, lambda s: (s[0], s[1]._replace(yaw_nm=2.0 * s[1].yaw_nm))),
        (EAST,),
        None,
        "short of",
    ),
    "integral": (
        *(heading, "steer", but(heading.steer, lambda s: (s[0]._replace(surge_n=1.0), s[1]))),
        *((EAST,), None, "the memory of surge"),
    ),
    "gains": (hull, "DAMPED", 2.4, (), None, "follows from the hull"),
    "speed": (setpoints, "speed", lambda asked, speeds: 0.7, (EAST,), None, "the speed_mps is"),
    "line": (
        *(guidance, "course_to_steer", but(guidance.course_to_steer, lambda c: (c[0]._replace(shift_m=1.0), c[1]))),
        *((PLAY,), None, "line of sight"),
    ),
    "reached": (goto, "leg", but(goto.leg, lambda s: (*s[:3], True)), (GOTO,), None, "goto is done"),
    "leg": (play, "leg", but(play.leg, lambda s: (*s[:3], True)), (PLAY,), None, "play goes on with leg 1"),
    "hold": (hold, "APPROACH_S", 10.0, (EAST, STAY), None, "hold asks for"),
    "place": (hold, "STOPPING_S", 1.0, (EAST,), LOST, "where the fence leaves it room"),
    "silence": (
        *(troubles, "_SEEN", tuple(row for row in troubles._SEEN if row[0] is not troubles.Trigger.NAVIGATION_SILENT)),
        *((EAST,), DARK, "navigation_silent is there since"),
    ),
    "no cause": (
        *(troubles, "_SEEN", (*troubles._SEEN, (troubles.Trigger.LOG, lambda look: "no log"))),
        *((), None, "log is told"),
    ),
    "other action": (
        *(failsafe, "_answer", but(failsafe._answer, lambda answer: (failsafe.Action.WARN, answer[1]))),
        *((EAST,), DARK, "brings warn in heading, not stop"),
    ),
    "cut off": (
        *(failing.Failing, "_wait_for_rest", waits_anew, (EAST, *TO_AND_FRO), STUCK),
        "thruster brings warn in idle, not disconnect",
    ),
    "no action": (
        Helm,
        "fall_back",
        lambda self, action, reason, now_s: None,
        (EAST,),
        DARK,
        "stop is told, and the boat is in",
    ),
    "never over": (
        failsafe,
        "_remembered",
        but(failsafe._remembered, lambda found: KEPT | found),
        (EAST,),
        DARK,
        "is not there",
    ),
    "changed": (
        *(handlers, "OBEYED", {**handlers.OBEYED, console.Manual: refused_late}),
        *(({**PUSH, "at_s": 9.6},), DARK, "and changed boat"),
    ),
    "forbidden": (helm, "refusal", lambda *given: None, ({**EAST, "at_s": 10.0},), DARK, "was obeyed, and is forbidden"),
    "no reason": (helm, "refusal", lambda *given: "no", (EAST,), None, "nothing forbids it"),
    "twice counted": (loop, "take", taken(counts_twice), (), None, "cycles at once"),
    "too fast": (loop, "take", taken(races), (), None, "m/s over ground"),
    "leaps": (loop, "take", taken(leaps), (), None, "m in 0.20 s"),
    "future": (loop, "take", taken(foresees), (), None, "something was heard at"),
    "charge": (loop, "take", taken(half_full), (), None, "is told to be at 0.5"),
    "other reason": (Helm, "enter", entered_else, (EAST,), None, "told is heading (operator)"),
    "untold": (failsafe, "news", lambda before, after: [], (EAST,), DARK, "not told: "),
    "told too much": (
        *(failsafe, "news", but(failsafe.news, lambda lines: [*lines, "shallow: over"])),
        *((EAST,), DARK, "told, and not so"),
    ),
    "page": (snapshot, "report", but(snapshot.report, lambda r: replace(r, mode="idle")), (EAST,), None, "reported is mode"),
    "heading": (
        *(snapshot, "report", but(snapshot.report, lambda r: replace(r, heading_deg=(r.heading_deg or 0.0) + 9.0))),
        *((EAST,), None, "the reported heading"),
    ),
    "elsewhere": (
        *(snapshot, "report", but(snapshot.report, lambda r: replace(r, latitude_deg=(r.latitude_deg or 0.0) + 1e-4))),
        *((EAST,), None, "the reported position"),
    ),
    "record": (record, "values", but(record.values, lambda v: (*v[:9], 99, *v[10:])), (EAST,), None, "logged is mode"),
    "bits": (record, "values", but(record.values, lambda v: (*v[:10], 8, *v[11:])), (EAST,), None, "logged are the troubles"),
    "by itself": (Helm, "go_on", tired, (GOTO,), None, "and nothing asks for it"),
}
SENT = Propellers.send
KEPT = {troubles.Trigger.SHALLOW: failsafe.Episode("shallow", 0.2, 0.2, 0.2, False)}


@pytest.mark.parametrize("name", BREAKS)
def test_a_boat_that_breaks_a_rule_is_told(name, monkeypatch):
    where, what, other, orders, fault, words = BREAKS[name]
    monkeypatch.setattr(where, what, other)
    found = failures(*orders, fault=fault)
    assert any(words in each for each in found), found


@pytest.mark.parametrize("orders", [(EAST,), (GOTO,), (PLAY,), (PUSH,)], ids=["heading", "goto", "play", "manual"])
def test_a_boat_as_it_is_breaks_none(orders):
    assert not failures(*orders, fault=DARK, seconds=30.0)


def test_a_motor_that_turns_on_is_cut_off_whatever_is_ordered():
    assert not failures(EAST, *TO_AND_FRO, fault=STUCK)


def test_a_refused_push_of_the_joystick_leaves_the_set_points_as_they_were():
    """Mixed faults, seed 44: it was asked for while navigation was silent, and its thrust stayed."""
    assert not failures({**PUSH, "at_s": 9.6}, fault=DARK)


def test_the_forces_of_two_thrusters_keep_the_yaw_moment_where_both_are_too_much():
    pair = thrust.pair_of(config.load(VEHICLE).thrusters)
    assert pair is not None
    for surge_n, yaw_nm in ((400.0, 100.0), (2000.0, 300.0), (-900.0, -200.0), (0.0, 5000.0)):
        forces = thrust.shared(pair, surge_n, yaw_nm)
        given_nm = sum(arm_m * force_n for arm_m, force_n in zip(pair.arms_m, forces, strict=True))
        assert all(low - 1e-9 <= f <= high + 1e-9 for low, f, high in zip(pair.least_n, forces, pair.most_n, strict=True))
        assert given_nm == pytest.approx(min(yaw_nm, 1.029 * (532.0 + 319.0)))
    assert sum(thrust.shared(pair, 400.0, 100.0)) == pytest.approx(400.0)
