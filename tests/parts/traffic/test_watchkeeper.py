"""The guard in the loop: orders shape the steps of a mode, in a boat that sails in lock step and is told where others are."""

import math
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.geodesy import from_plane, wrap
from delfim.base.modes import Mode
from delfim.parts.traffic import watchkeeper
from delfim.parts.traffic.routeahead import route_ahead
from delfim.parts.traffic.watchkeeper import LATE_S
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.control.control import control
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.snapshot import in_json
from delfim.vehicle.state import Motion, NoLog, Setpoint, State, Waypoint
from delfim.vehicle.target import Traffic
from tests.parts.traffic.encounters import Ship, place, target

VEHICLE = Path(__file__).parents[3] / "etc/delfimx.toml"
START_S = 10.0


class Notes(NoLog):
    def __init__(self, clock: ManualClock) -> None:
        self.lines: list[str] = []

    def note(self, text: str) -> None:
        self.lines.append(text)


class Voyage:
    """A boat that lies at the origin of its plane at first, and ships that keep course and speed."""

    def __init__(self, *overrides: str) -> None:
        here = ("simulation.heading_deg=0.0", *overrides)
        self.run = Lockstep(config.load(VEHICLE, here), 1, Notes)
        self.ships: tuple[Ship, ...] = ()
        self.least, self.orders = math.inf, list[str]()
        self.tells = True
        for _ in self.run.cycles(START_S):
            pass

    @property
    def state(self) -> State:
        return self.run.state

    def obey(self, command: console.Commands) -> None:
        assert self.run.command(command) is None

    def at(self, north_m: float, east_m: float) -> tuple[float, float]:
        assert self.state.origin is not None
        latitude_rad, longitude_rad = from_plane(self.state.origin, north_m, east_m)
        return math.degrees(latitude_rad), math.degrees(longitude_rad)

    def meet(self, t_s: float, course_deg: float, speed_mps: float = 1.5, length_m: float = 30.0) -> None:
        """A ship comes to where the boat, which goes north from now on, will be."""
        north_m = self.state.motion.north_m + 1.5 * t_s
        ship = Ship(north_m, self.state.motion.east_m, math.radians(course_deg), speed_mps, length_m, "", t_s)
        self.ships = (*self.ships, ship.at(-t_s - self.run.elapsed_s))

    def after(self, seconds: float) -> State:
        """The state, sailed so far."""
        for _ in self.sail(seconds):
            pass
        return self.state

    def sail(self, seconds: float) -> Iterator[State]:
        for state in self.run.cycles(seconds):
            now_s, tells = self.run.elapsed_s, self.tells and self.ships
            now = [ship.at(now_s) for ship in self.ships]
            if tells and now_s - state.traffic.at_s >= 1.0:
                targets = tuple(target(i, ship) for i, ship in enumerate(now))
                state.traffic = Traffic(targets, now_s, now_s, now_s, (), *state.traffic[5:])
            own = watchkeeper.own_of(state.motion)
            self.least = min([self.least, *(place(own, ship)[0] for ship in now)])
            order = state.traffic.order
            if order is not None and (not self.orders or self.orders[-1] != order.words[:20]):
                self.orders.append(order.words[:20])
            yield state


def mission(voyage: Voyage, *points: tuple[float, float]) -> str:
    rows = [
        f"[[waypoint]]\nlatitude_deg = {n:.8f}\nlongitude_deg = {e:.8f}\n" for n, e in (voyage.at(*point) for point in points)
    ]
    return "\n".join(['version = 1\nname = "to the north"\n', *rows])


def under_way(voyage: Voyage, mode: Mode) -> None:
    if mode in (Mode.PLAY, Mode.PATH):
        voyage.obey(console.LoadMission(mission(voyage, (0.0, 0.0), (2000.0, 0.0))))
        voyage.obey(console.SetMode(mode.name.lower()))
    elif mode is Mode.GOTO:
        north, east = voyage.at(2000.0, 0.0)
        voyage.obey(console.Goto(north, east))
    elif mode is Mode.COURSE:
        voyage.obey(console.Course(0.0, 1.5))
    elif mode is Mode.HEADING:
        voyage.obey(console.Heading(0.0, 1.5))
    else:
        voyage.obey(console.SetMode(mode.name.lower()))
    voyage.after(15.0)


@pytest.mark.parametrize("mode", [Mode.PLAY, Mode.PATH, Mode.GOTO, Mode.COURSE])
def test_the_boat_gives_way_and_returns_and_its_mode_is_never_entered_anew(mode: Mode) -> None:
    voyage = Voyage()
    under_way(voyage, mode)
    entered_s = voyage.state.mode_s
    voyage.meet(150.0, 180.0)
    widest_rad = 0.0
    for state in voyage.sail(400.0):
        widest_rad = max(widest_rad, wrap(watchkeeper.own_of(state.motion).course_rad))
        assert (state.mode, state.mode_s) == (mode, entered_s)
    assert voyage.least > 1.0
    assert widest_rad > math.radians(28.0)
    assert voyage.state.traffic.order is None
    assert voyage.run.vehicle.helm.shapes == {}
    assert abs(watchkeeper.own_of(voyage.state.motion).course_rad) < math.radians(20.0)
    notes = [line for line in voyage.run.log.lines if line.startswith("traffic:")]  # type: ignore[attr-defined]
    assert "giving way to SHIP 0, head-on, port to port" in notes[0]
    assert "traffic: clear: back to the way" in notes


def test_a_boat_that_is_clear_comes_back_onto_its_path_at_45_degrees() -> None:
    voyage = Voyage()
    under_way(voyage, Mode.PATH)
    voyage.meet(150.0, 180.0)
    clear_s, steepest_rad, farthest_m = math.inf, 0.0, 0.0
    for state in voyage.sail(500.0):
        farthest_m = max(farthest_m, abs(state.motion.east_m))
        if "traffic: clear: back to the way" in voyage.run.log.lines:  # type: ignore[attr-defined]
            clear_s = min(clear_s, voyage.run.elapsed_s)
        if voyage.run.elapsed_s > clear_s + 15.0:
            steepest_rad = max(steepest_rad, abs(watchkeeper.own_of(state.motion).course_rad))
    assert farthest_m > 30.0
    assert math.radians(35.0) < steepest_rad < math.radians(55.0)
    assert abs(voyage.state.motion.east_m) < 2.0


def test_a_boat_that_holds_moves_off_and_comes_back() -> None:
    voyage = Voyage()
    under_way(voyage, Mode.HOLD)
    voyage.ships = (Ship(900.0, 0.0, math.pi, 3.0, 60.0, "", 300.0).at(-voyage.run.elapsed_s),)
    for state in voyage.sail(700.0):
        assert state.mode is Mode.HOLD
    assert voyage.least > 0.99
    assert voyage.orders
    assert math.hypot(voyage.state.motion.north_m, voyage.state.motion.east_m) < 15.0


@pytest.mark.parametrize("mode", [Mode.HEADING, Mode.MANUAL, Mode.IDLE])
def test_in_modes_that_are_not_asked_for_there_are_alarms_alone(mode: Mode) -> None:
    voyage = Voyage()
    under_way(voyage, mode)
    voyage.meet(60.0, 180.0)
    for state in voyage.sail(10.0):
        assert state.traffic.order is None
    assert voyage.state.traffic.guard == "off"
    assert [each.level for each in voyage.state.traffic.dangers] == ["danger"]


def test_heading_may_be_asked_for_and_the_guard_switched_off() -> None:
    asked = Voyage('traffic.guard.modes=["heading"]')
    under_way(asked, Mode.HEADING)
    asked.meet(120.0, 180.0)
    assert any(state.traffic.order for state in asked.sail(5.0))
    off = Voyage("traffic.guard.enabled=false")
    under_way(off, Mode.COURSE)
    off.meet(60.0, 180.0)
    assert not any(state.traffic.order for state in off.sail(5.0))
    assert off.state.traffic.dangers[0].level == "danger"


def test_an_old_order_does_not_count() -> None:
    voyage = Voyage()
    under_way(voyage, Mode.COURSE)
    voyage.meet(120.0, 180.0)
    state = voyage.after(10.0)
    assert state.traffic.order is not None
    assert state.reference.course_rad == state.traffic.order.course_rad != 0.0
    voyage.tells = False
    state = voyage.after(LATE_S + 2.0)
    assert state.traffic.order is not None
    assert state.reference.course_rad == 0.0


@pytest.mark.parametrize("does", ["warn", "slow", "hold"])
def test_where_the_guard_fails_the_boat_does_as_its_file_says(does: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ValueError("math domain error")

    monkeypatch.setattr(watchkeeper, "deciding", fails)
    voyage = Voyage(f'traffic.guard.on_failure="{does}"')
    under_way(voyage, Mode.COURSE)
    voyage.meet(120.0, 180.0)
    state = voyage.after(15.0)
    assert state.traffic.guard == "cannot avoid: the guard failed: math domain error"
    assert state.mode is (Mode.HOLD if does == "hold" else Mode.COURSE)
    assert state.reference.speed_mps == {"warn": 1.5, "slow": 0.75}.get(does, state.reference.speed_mps)
    voyage.ships = ()
    state.traffic = Traffic()
    for _ in range(10):
        state.traffic = state.traffic._replace(at_s=voyage.run.elapsed_s - 0.1)
        voyage.run.cycle()
    assert voyage.run.vehicle.helm.shapes == {}


def test_half_the_speed_is_half_of_what_the_file_allows() -> None:
    limits = Voyage("control.speed.max_mps=1.0").run.vehicle.helm.limits
    motion = Motion(frozenset({"position", "heading", "velocity"}), 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    setpoint = Setpoint(target=Waypoint(900.0, 0.0, 1.0, 5.0))
    memory = Memory()
    for _ in range(50):
        memory, reference, _ = control(Mode.GOTO, memory, motion, watchkeeper.slowed(setpoint, limits), limits, 0.2)
    assert reference.speed_mps == pytest.approx(0.5)


def test_legs_are_checked_off_while_the_boat_is_away() -> None:
    voyage = Voyage()
    voyage.obey(console.LoadMission(mission(voyage, (0.0, 0.0), (40.0, 0.0), (2000.0, 0.0))))
    voyage.obey(console.SetMode("play"))
    state = voyage.after(8.0)
    voyage.meet(120.0, 180.0)
    state = voyage.after(3.0)
    assert (order := state.traffic.order) is not None
    beside = state.motion._replace(north_m=42.0, east_m=8.0)
    helm = voyage.run.vehicle.helm
    helm.memory, state.motion = helm.memory._replace(leg=1), beside
    wanted = helm.control(voyage.run.clock.monotonic_s())
    after, reference = helm.memory, state.reference
    assert after.leg == 2
    assert wanted.run
    assert reference.course_rad == order.course_rad


def test_the_state_tells_the_order_and_how_near_each_vessel_comes() -> None:
    voyage = Voyage()
    under_way(voyage, Mode.COURSE)
    voyage.meet(140.0, 180.0)
    for _ in voyage.sail(20.0):
        pass
    tree = msgspec.json.decode(in_json(voyage.run.vehicle.report()))["traffic"]
    assert tree["guard"] == "on"
    assert tree["order"]["words"].startswith("giving way to SHIP 0, head-on")
    assert 29.0 < tree["order"]["course_deg"] < 91.0
    (vessel,) = tree["targets"]
    assert vessel["danger"] == "near"
    assert vessel["nearness"] > 1.0
    assert vessel["cpa_m"] > 20.0
    assert vessel["tcpa_s"] > 50.0


def test_the_boat_is_not_reckoned_faster_than_its_file_allows() -> None:
    voyage = Voyage("control.speed.max_mps=1.2", "control.speed.cruise_mps=1.0")
    helm = voyage.run.vehicle.helm
    asked, motion = voyage.state.setpoint._replace(speed_mps=1.5), voyage.state.motion
    assert route_ahead(Mode.COURSE, helm.memory, asked, motion, helm.limits).speed_mps == 1.2
    by_hand = motion._replace(north_mps=2.0, east_mps=0.0)
    assert route_ahead(Mode.MANUAL, helm.memory, asked, by_hand, helm.limits).speed_mps == 2.0
