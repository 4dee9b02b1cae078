"""The look-out: reports from the bus through the tracker into the state, on a recorded harbour and with all that goes wrong."""

import math
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest

from delfim import config
from delfim.base import geodesy
from delfim.base.clock import ManualClock
from delfim.base.cooperative import Sliced
from delfim.base.frames import Frame, extended
from delfim.base.vessels import ThingSeen, VesselPosition
from delfim.canproxy.nmea2000.fastpacket import split
from delfim.parts.traffic import lookout, watchkeeper
from delfim.parts.traffic.aisbus import FILTERS, AisBus
from delfim.parts.traffic.lookout import AT_ONCE, OF_THING, TrafficLookout
from delfim.parts.traffic.targets import MOST
from delfim.parts.traffic.watchkeeper import LATE_S
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle import console
from delfim.vehicle.snapshot import in_json
from delfim.vehicle.state import HEARD_MAX, Motion, NoLog, State
from tests.canproxy.test_recordings import BUSY, RAYMARINE, recording

VEHICLE = Path(__file__).parents[3] / "etc/delfimx.toml"
HERE = math.radians(38.6907), math.radians(-9.2153)
TICK_S = 0.1
NOWHERE = "no position, or none that a vessel can have"


def recorded(name: str) -> State:
    """The vehicle after a recording, which the boat hears from the middle of it."""
    state, lookout = State(), TrafficLookout(config.TrafficTable())
    bus = LockstepBus(ManualClock())
    ais, world = AisBus(bus.bound(*FILTERS)), bus.bound()
    tick_s = 0.0
    for line in recording(name):
        while line.now_s >= tick_s:
            told = next(iter(state.heard.values())).told if state.heard else None
            if state.origin is None and isinstance(told, VesselPosition):
                state.origin = geodesy.origin(told.latitude_rad or 0.0, told.longitude_rad or 0.0)
                state.motion = Motion(frozenset({"position"}), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            lookout.hear(state)
            lookout.look(state, tick_s)
            tick_s += TICK_S
        world.sendmsg(line.frame)
        ais.read(state, line.now_s)
    return state


def test_a_recorded_harbour_is_seen_without_the_boat_that_recorded_it() -> None:
    state = recorded(BUSY)
    traffic = state.traffic
    kinds = Counter(each.kind for each in traffic.targets)
    assert (len(traffic.targets), kinds["A"], kinds["B"]) == (121, 111, 10)
    assert sum(each.is_size_known for each in traffic.targets) == 11
    assert sum(each.speed_mps == 0.0 for each in traffic.targets) > 60
    assert dict(traffic.refused)["own transponder"] > 20
    assert set(dict(traffic.refused)) <= {"own transponder", "no vessel", "heard before", NOWHERE}
    assert traffic.at_s - traffic.own_s < 5.0
    assert traffic.at_s - traffic.heard_s < 5.0
    assert state.counts == {"nmea2000_129038_timed_out": 2}
    assert not any(each.is_lost for each in traffic.targets)


def test_a_report_that_lost_a_frame_on_the_bus_is_counted() -> None:
    state, bus = State(), LockstepBus(ManualClock())
    ais, world = AisBus(bus.bound(*FILTERS)), bus.bound()
    for sequence in range(2):
        for number, data in enumerate(split(bytes(27), sequence)):
            if (sequence, number) != (0, 1):
                world.sendmsg(Frame(extended(6 << 26 | 129038 << 8 | 7), data))
    for sequence in range(2, 5):
        world.sendmsg(Frame(extended(6 << 26 | 129038 << 8 | 7), split(bytes(27), sequence)[0]))
    ais.read(state, 1.0)
    assert state.counts["nmea2000_129038_incomplete"] == 2


def test_the_other_recording_has_its_own_transponder_too() -> None:
    state = recorded(RAYMARINE)
    assert dict(state.traffic.refused)["own transponder"] > 5
    assert state.counts == {}


def told(north_m: float, east_m: float, number: int = 0, **more: Any) -> VesselPosition:
    at = geodesy.origin(*HERE)
    moves: dict[str, Any] = {"course_rad": 3.0, "speed_mps": 4.0, "heading_rad": None, "rate_radps": None}
    return VesselPosition(244_000_000 + number, *geodesy.from_plane(at, north_m, east_m), **(moves | more))


def test_a_flood_waits_in_a_bounded_queue_and_each_step_takes_a_part() -> None:
    state, lookout = State(origin=geodesy.origin(*HERE)), TrafficLookout(config.TrafficTable())
    for i in range(3 * HEARD_MAX):
        state.hear(told(float(i), 0.0, i), "flood", 0.0)
    assert (len(state.heard), state.counts) == (HEARD_MAX, {"traffic_dropped": 2 * HEARD_MAX})
    lookout.hear(state)
    lookout.look(state, 0.0)
    assert len(state.heard) == HEARD_MAX - AT_ONCE
    assert len(state.traffic.targets) == AT_ONCE
    for i in range(1, 25):
        lookout.hear(state)
        lookout.look(state, i * TICK_S)
    assert (len(state.heard), len(state.traffic.targets)) == (0, MOST)


def test_sightings_of_things_are_taken_fewer_at_a_time() -> None:
    """Each is compared with all things that are known."""
    state, its = State(), TrafficLookout(config.TrafficTable())
    for number in range(3 * AT_ONCE // OF_THING):
        state.hear(ThingSeen(HERE[0], HERE[1] + 1e-5 * number, 0.5), "payload lidar", 0.0, f"lidar {number}")
    taken = [len(state.heard)]
    while state.heard:
        its.hear(state)
        taken.append(len(state.heard))
    assert {before - after for before, after in pairwise(taken)} == {AT_ONCE // OF_THING}
    assert len(its.things) == 3 * AT_ONCE // OF_THING


def test_a_sighting_that_may_be_any_of_many_swimmers_counts_more() -> None:
    """Each may have swum to where the others were, so that each is measured."""
    state, its, later_s = State(), TrafficLookout(config.TrafficTable()), 100.0
    swimmers = [ThingSeen(HERE[0], HERE[1] + 1.6e-6 * number, 0.5, "person") for number in range(60)]  # 8 m from each other
    for number, each in enumerate(swimmers):
        its.things.hear(each, f"camera {number}", 0.0)
    assert len(its.things) == len(swimmers)
    for number, each in enumerate(swimmers):
        state.hear(each, "payload camera", later_s, f"camera {number}")
    its.hear(state)
    assert len(swimmers) - len(state.heard) == 8  # of twelve


def test_all_are_looked_at_once_a_second_and_a_boat_without_position_has_no_targets() -> None:
    state, lookout = State(), TrafficLookout(config.TrafficTable())
    lookout.hear(state)
    lookout.look(state, 0.0)
    assert state.traffic.at_s < 0.0
    state.hear(told(100.0, 0.0), "ais", 0.1)
    lookout.hear(state)
    lookout.look(state, 0.1)
    assert (state.traffic.targets, state.traffic.heard_s) == ((), 0.1)
    state.origin = geodesy.origin(*HERE)
    lookout.hear(state)
    lookout.look(state, 1.0)
    assert state.traffic.targets == ()
    lookout.hear(state)
    lookout.look(state, 1.2)
    assert len(state.traffic.targets) == 1


@pytest.mark.parametrize("trouble", ["silent", "frozen", "late", "wrong", "many", "on us"])
def test_a_boat_among_others_sails_whatever_its_receiver_does(trouble: str) -> None:
    """Reports of vessels that sail by, through the whole boat in lock step; the boat sails its way, and nothing is raised."""
    boat = Lockstep(config.Vehicle(boat=config.BoatTable(name="test")), 1, lambda clock: NoLog())
    state, number = boat.state, {"many": 500, "on us": 1}.get(trouble, 20)
    before = [told(50.0 * i, 300.0, i) for i in range(number)]
    for step, _ in enumerate(boat.cycles(90.0)):
        now_s = boat.elapsed_s
        if step % 5 or (trouble == "silent" and now_s > 20.0):
            continue
        passed_s = {"frozen": 0.0, "late": now_s - 60.0}.get(trouble, now_s)
        for i, each in enumerate(before):
            if i % 10 != step // 5 % 10:
                continue
            moved = told(50.0 * i - 4.0 * passed_s, 300.0, i)
            match trouble:
                case "wrong":
                    moved = each._replace(latitude_rad=math.nan, speed_mps=math.inf) if step % 2 else told(1e4 * step, 1e5, i)
                case "on us":
                    moved = each._replace(latitude_rad=HERE[0], longitude_rad=HERE[1], speed_mps=0.0)
            state.hear(moved, "ais", now_s)
    targets = state.traffic.targets
    assert len(targets) == (number // 2 if trouble == "wrong" else min(number, MOST))  # a wrong place is none
    assert state.traffic.at_s > 85.0
    assert all(math.isfinite(each.north_m) and math.isfinite(each.margin_m) for each in targets)
    assert all(each.is_lost for each in targets) == (trouble in ("silent", "frozen", "wrong"))
    told_state = msgspec.json.decode(in_json(boat.vehicle.report()))["traffic"]
    assert len(told_state["targets"]) == len(targets)


@pytest.mark.parametrize(("table", "keys"), [({}, ["244660123"]), ({"hears": ("mavlink",)}, []), ({"mmsi": 244_660_123}, [])])
def test_the_bus_of_a_file_is_heard_unless_the_file_says_otherwise(table: dict[str, Any], keys: list[str]) -> None:
    boat, traffic = config.BoatTable(name="test"), config.TrafficTable(**table)
    sensors = config.Sensors(names=("sysstat", "nmea2000"))
    run = Lockstep(config.Vehicle(boat=boat, sensors=sensors, traffic=traffic), 1, lambda clock: NoLog())
    data = b"\x01" + (244_660_123).to_bytes(4, "little") + _e7(HERE[1]) + _e7(HERE[0]) + bytes(15)
    world = run.buses.get("can1", run.bus).bound()
    for _ in run.cycles(2.0):
        pass
    for part in split(data, 0):
        world.sendmsg(Frame(extended(4 << 26 | 129038 << 8 | 43), part, 0))
    for _ in run.cycles(2.0):
        pass
    assert [each.key for each in run.state.traffic.targets] == keys
    assert (run.state.traffic.own_s > 0.0) == ("mmsi" in table)


def _e7(angle_rad: float) -> bytes:
    return round(math.degrees(angle_rad) * 1e7).to_bytes(4, "little", signed=True)


def slices(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The work that each slice of watching and deciding costs from now on, in the order in which they are done."""
    spent = list[int]()

    class Counted(Sliced[Any]):
        def step(self, most: int = 0) -> bool:
            before, is_done = self.spent, super().step(most)
            spent.append(self.spent - before)
            return is_done

    monkeypatch.setattr(lookout, "Sliced", Counted)
    monkeypatch.setattr(watchkeeper, "Sliced", Counted)
    return spent


def test_a_crowd_is_watched_a_slice_in_each_step_and_kept_clear_of_within_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    spent = slices(monkeypatch)
    run = Lockstep(config.load(VEHICLE, ("simulation.heading_deg=0.0",)), 1, lambda clock: NoLog())
    for _ in run.cycles(10.0):
        pass
    assert run.command(console.Course(0.0, 1.5)) is None
    assert run.state.origin is not None
    origin = run.state.origin
    for i in range(MOST):
        at = geodesy.from_plane(origin, 300.0 + 40.0 * (i // 10), 50.0 * (i % 10) - 250.0)
        run.state.hear(VesselPosition(244_000_000 + i, *at, math.pi, 1.0, None, None), "ais", run.elapsed_s)
    ordered = list[float]()
    for state in run.cycles(30.0):
        if state.traffic.order is not None and state.traffic.order.at_s not in ordered:
            ordered.append(state.traffic.order.at_s)
    assert len(run.state.traffic.targets) == len(run.state.traffic.dangers) == MOST
    assert max(after - before for before, after in pairwise(ordered)) < LATE_S, "with half the steps of a real boat"
    assert len(spent) <= 30.0 / 0.2, "one slice in each step"
    assert max(spent) < 2 * lookout.SLICE


@pytest.mark.parametrize(("vessels", "is_lost"), [(110, False), (150, True)])
def test_in_lock_step_as_much_is_heard_as_both_channels_of_ais_carry_and_more_is_counted(vessels: int, is_lost: bool) -> None:
    """75 reports a second; 24 are taken in each look, of which lock step has five a second."""
    rows = ",".join(f'{{name="V{i}", transponder="A", north_m={900 + 30 * i}, course_deg=90.0}}' for i in range(vessels))
    more = (
        'sensors.names=["sysstat", "nmea2000"]',
        'simulation.traffic.heard="perfect"',
        f"simulation.traffic.vessel=[{rows}]",
    )
    run = Lockstep(config.load(VEHICLE, more), 1, lambda clock: NoLog())
    *_, state = run.cycles(20.0)
    assert len(state.traffic.targets) == vessels
    assert set(state.counts) == ({"traffic_dropped"} if is_lost else set())
    assert is_lost or max(each.age_s for each in state.traffic.targets) <= 1.2
