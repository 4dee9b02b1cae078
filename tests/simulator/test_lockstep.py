"""Whole missions in lock step: the real loop, console words and control around the modelled world."""

import math
import struct
from pathlib import Path

import pytest

from delfim import config
from delfim.base import geodesy
from delfim.base.clock import ManualClock
from delfim.base.cooperative import Sliced
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.tables import Sea, Simulation
from delfim.vehicle import console
from delfim.vehicle.log import record
from delfim.vehicle.plans.fence import stopping_m
from delfim.vehicle.plans.mission import load_mission, plan
from delfim.vehicle.state import State

ROOT = Path(__file__).parents[2]
MISSION = ROOT / "etc/missions/doca.toml"
RECORD = record.of(config.load(ROOT / "etc/delfimx.toml"))
PACK = struct.Struct("<" + "".join(field.code for field in RECORD.fields)).pack
CROSS = Sea(current_mps=0.5, current_to_deg=250.0, wind_mps=4.0, wind_from_deg=320.0)


class Bytes:
    """A state log in memory."""

    def __init__(self, clock: ManualClock) -> None:
        self.data = bytearray()

    def write(self, state: State, now_s: float) -> None:
        self.data += PACK(*record.values(RECORD, state, now_s))

    def note(self, text: str) -> None:
        self.data += text.encode()

    def reason(self) -> str:
        return ""

    def close(self) -> None:
        pass


def boat(seed: int, sea: Sea = CROSS) -> Lockstep:
    settings = config.load(ROOT / "etc/delfimx.toml")
    there = Simulation(sea=sea)
    simulated = config.Vehicle(boat=settings.boat, control=settings.control, thrusters=settings.thrusters, simulation=there)
    return Lockstep(simulated, seed, Bytes)


def recorded(sailing: Lockstep) -> bytes:
    assert isinstance(sailing.log, Bytes)
    return bytes(sailing.log.data)


def test_same_seed_same_bytes_and_another_seed_another_run():
    runs = []
    for seed in (1, 1, 2):
        sailing = boat(seed)
        assert sailing.sail(MISSION.read_text(), 60.0).startswith("time")
        runs.append(recorded(sailing))
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_a_mission_that_is_never_played_ends_with_the_reason():
    """Else a boat without a compass lies in idle for two hours, and nobody says why."""
    sailing = boat(1)
    assert sailing.command(console.Kill()) is None
    assert sailing.sail(MISSION.read_text(), 2.0) == "time: 2 s sailed, mode idle; play refused: kill: operator: commanded"
    sailing = boat(1)
    assert sailing.sail(MISSION.read_text(), 5.0) == "time: 5 s sailed, mode play"


@pytest.mark.parametrize("seed", [1, 2, 3, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(4, 21))])
def test_every_waypoint_is_reached_in_a_cross_current_with_sensor_noise(seed):
    sailing = boat(seed)
    mission = MISSION.read_text()
    assert sailing.command(console.LoadMission(mission)) is None
    next(sailing.cycles(1.0))
    legs = Sliced(plan(load_mission(MISSION), sailing.state.origin, sailing.settings.control)).finish().waypoints
    nearest_m = [math.inf] * len(legs)
    playing = False
    for state in sailing.cycles(3600.0):
        playing = playing or sailing.command(console.Play()) is None
        model = sailing.nodes.model
        where = geodesy.to_plane(state.origin, model.latitude_rad, model.longitude_rad)
        nearest_m = [min(m, math.dist(where, leg[:2])) for m, leg in zip(nearest_m, legs, strict=True)]
        if state.mode is Mode.HOLD:
            break
    assert state.reason == "play done"
    for number, (away_m, leg) in enumerate(zip(nearest_m, legs, strict=True), 1):
        assert away_m <= leg.acceptance_m, f"waypoint {number}, by the true position"


def test_nothing_is_refused_or_lost_on_a_healthy_boat():
    sailing = boat(3)
    sailing.sail(MISSION.read_text(), 120.0)
    assert sailing.state.counts == {}


def test_a_guest_steers_in_grex_mode():
    sailing = boat(4)
    east = b'{"heading_deg": 90, "speed_mps": 1.5}'
    assert len(list(sailing.cycles(5.0))) == 25
    sailing.vehicle.on_guest(east)
    assert sailing.command(console.SetMode("grex")) is None
    for _ in sailing.cycles(40.0):
        sailing.vehicle.on_guest(east)
    state = sailing.state
    assert state.motion.heading_rad == pytest.approx(math.pi / 2, abs=math.radians(5))
    assert state.motion.east_m > 20


@pytest.mark.parametrize("speed_mps", [0.5, 1.0, 1.5, 2.2])
@pytest.mark.parametrize("order", [console.Stop(), console.SetMode("hold")], ids=["stop", "hold"])
def test_the_boat_comes_to_rest_where_the_fence_reckons_with(speed_mps, order):
    sailing = boat(1, Sea())
    list(sailing.cycles(4.0))
    assert sailing.command(console.Heading(0.0, speed_mps)) is None
    list(sailing.cycles(40.0))
    model = sailing.nodes.model
    before_m = model.north_m
    assert model.north_mps == pytest.approx(speed_mps, abs=0.15)
    assert sailing.command(order) is None
    rolled_m = max(model.north_m - before_m for _ in sailing.cycles(60.0))
    limits = config.FenceTable()
    assert 1.0 < rolled_m < stopping_m(limits, speed_mps) + limits.margin_m


DAY_S = 86_400.0
BY_THE_WALL_CLOCK = {"t0", "t1", "t2", "t3", "t4", "previous_t5", "utc_ns"}


class Rows:
    """A state log without what the wall clock says."""

    def __init__(self, clock: ManualClock) -> None:
        self.rows, self.notes = list[tuple[object, ...]](), list[str]()

    def write(self, state: State, now_s: float) -> None:
        values = zip(RECORD.fields, record.values(RECORD, state, now_s), strict=True)
        self.rows.append(tuple(repr(value) for field, value in values if field.name not in BY_THE_WALL_CLOCK))

    def note(self, text: str) -> None:
        self.notes.append(text)

    def reason(self) -> str:
        return ""

    def close(self) -> None:
        pass


def stepped(*steps_s: float) -> Rows:
    """A mission of which the wall clock is set, every five seconds."""
    settings = config.load(ROOT / "etc/delfimx.toml")
    sailing = Lockstep(settings, 1, Rows)
    sailing.command(console.LoadMission(MISSION.read_text()))
    due_s = [20.0 + 5.0 * number for number in range(len(steps_s))]
    for state in sailing.cycles(60.0):
        if state.mode is Mode.IDLE:
            sailing.command(console.Play())
        if due_s and sailing.elapsed_s >= due_s[0]:
            sailing.clock.step(steps_s[len(steps_s) - len(due_s)])
            due_s.pop(0)
    assert state.mode is Mode.PLAY
    assert isinstance(sailing.log, Rows)
    return sailing.log


@pytest.mark.parametrize(
    "steps_s",
    [
        (DAY_S, -2.0 * DAY_S, DAY_S),
        (-40.0 * 365.0 * DAY_S,),
        (1024.0 * 7.0 * DAY_S, -1024.0 * 7.0 * DAY_S),
        (28.5 * 365.0 * DAY_S,),
    ],
    ids=["a day to and fro", "1970", "the weeks of GPS roll over", "past 2038"],
)
def test_whatever_the_wall_clock_says_the_boat_does_the_same(steps_s: tuple[float, ...]) -> None:
    calm, odd = stepped(), stepped(*steps_s)
    assert odd.rows == calm.rows
    assert odd.notes == calm.notes


def test_instruments_measure_on_while_the_program_of_the_boat_is_away() -> None:
    settings = config.load(ROOT / "etc/boats/bait-boat.toml")
    run = Lockstep(settings, 1, Bytes)
    assert run.nodes.instruments is not None
    (receiver,) = run.nodes.instruments.receivers
    measured, step = list[float](), receiver.step

    def counted(now_s: float) -> object:
        measured.append(now_s)
        return step(now_s)

    receiver.step = counted  # type: ignore[method-assign,assignment]
    run.restart(2.0)
    assert len(measured) == 20
