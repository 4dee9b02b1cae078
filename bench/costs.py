"""`python -m bench costs`: what the largest input costs the loop, callback by callback, against the budget of a callback.

Whoever adds a computation to the loop that grows with what it is sent, or with time, adds its row here with the largest input.
Processor time of this thread is measured, so that other programs of the machine count for nothing, and each callback counts
with the best of some repetitions; a computer that is five times slower has five times these figures.
"""

import argparse
import gc
import json
import logging
import math
import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import count
from pathlib import Path
from random import Random
from typing import Any, Final, NamedTuple

from bench import thingcosts
from delfim import config
from delfim.base import geodesy
from delfim.base.clock import SystemClock
from delfim.base.cooperative import Sliced
from delfim.base.modes import Mode
from delfim.base.vessels import VesselPosition
from delfim.logging.systemlog import SystemHandler
from delfim.parts.mavlink.codec import plans
from delfim.parts.mavlink.codec.wire import Sender, dialect
from delfim.parts.mavlink.station import FRAMES, Station
from delfim.parts.traffic import keepclear
from delfim.parts.traffic.encounter import Own
from delfim.parts.traffic.targets import MOST
from delfim.parts.traffic.trialways import Caution, RouteAhead
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.control.control import enter
from delfim.vehicle.helm import detour
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.navigation.estimator import Estimator
from delfim.vehicle.plans import fence, missionreader
from delfim.vehicle.plans.mission import ROWS, Mission, PathPoint, Waypoint
from delfim.vehicle.plans.track import Track
from delfim.vehicle.plans.zones import Point, Zone, polygon
from delfim.vehicle.snapshot import in_json
from delfim.vehicle.state import Motion, NoLog, Setpoint
from delfim.vehicle.state import Waypoint as To
from delfim.vehicle.target import Target

REPETITIONS: Final = 5
WARM_S: Final = 3.0  # sailed before anything is asked
CONSOLES: Final = 16
METRE_DEG: Final = 9e-6
TICKS: Final = 40  # of the watchdog: in these a boat hears, judges and tells of all vessels
ALL: Final = frozenset({"position", "heading", "velocity"})
Callbacks = Iterator[object]  # its first step makes everything ready, and each other one is one callback


class Row(NamedTuple):
    """Something that the loop computes, with its largest input."""

    name: str
    callbacks: Callable[[], Callbacks]


class Cost(NamedTuple):
    name: str
    callbacks: int
    longest_ms: float
    all_ms: float


def run(asked: argparse.Namespace) -> int:
    """The command. Returns 1 where a callback is longer than the budget in the vehicle's file."""
    settings = config.load(asked.file, asked.set)
    budget_ms = settings.runtime.callback_budget_s * 1e3
    gc.disable()  # as in the runtime, which collects when it has time
    costs = [measured(row, 2 if asked.quick else REPETITIONS) for row in rows(settings)]
    gc.enable()
    output = Path(asked.output)
    output.mkdir(parents=True, exist_ok=True)
    (output / "costs.json").write_text(json.dumps([cost._asdict() for cost in costs], indent=1) + "\n")
    print(f"{'the largest':52} callbacks   longest       all   (budget of a callback: {budget_ms:g} ms)")
    for cost in costs:
        over = "  over budget" if cost.longest_ms > budget_ms else ""
        print(f"{cost.name:52} {cost.callbacks:9} {cost.longest_ms:6.3f} ms {cost.all_ms:6.0f} ms{over}")
    print(f"{output}/costs.json")
    return int(any(cost.longest_ms > budget_ms for cost in costs))


def measured(row: Row, repetitions: int = REPETITIONS, clock: Callable[[], float] = time.thread_time) -> Cost:
    """Each callback with the best of its repetitions: what disturbed it in one of them is not its own."""
    best: list[float] = []
    for _ in range(repetitions):
        callbacks = row.callbacks()
        next(callbacks)
        for at in count():
            began_s = clock()
            is_there = next(callbacks, callbacks) is not callbacks
            took_s = clock() - began_s
            if not is_there:
                break
            best[at : at + 1] = [min([took_s, *best[at : at + 1]])]
    return Cost(row.name, len(best), max(best) * 1e3, sum(best) * 1e3)


def rows(settings: config.Vehicle) -> list[Row]:
    """The table."""
    sea = Lockstep(settings, 1, lambda clock: NoLog())
    for _ in sea.cycles(WARM_S):
        pass
    boat = sea.vehicle
    largest = console.Upload(mission(boat, zones(boat)))
    found = [*_plans(boat, largest), *_fences(boat), *_voyage(boat, largest), *_consoles(boat, largest)]
    return [*found, *_vessels(settings), _estimator(), *_words()]


def zones(boat: VehicleLoop) -> config.Zones:
    """100 zones of 100 corners a hundred metres from each other, within one of as many."""
    places = ((300.0 + 100.0 * (i // 10), 100.0 * (i % 10)) for i in range(config.ZONES))
    out = tuple(config.Area(polygon=tuple(_ring(boat, n, e, 20.0))) for n, e in places)
    return config.Zones(keep_in=(config.Area(polygon=tuple(_ring(boat, 0.0, 0.0, 5000.0))),), keep_out=out)


def mission(boat: VehicleLoop, around: config.Zones) -> Mission:
    """1000 waypoints, and a path of 1000 circles."""
    south, east = _place(boat, -200.0, 0.0)
    step_deg = METRE_DEG
    stops = [Waypoint(latitude_deg=south - step_deg * i, longitude_deg=east + 2e-3 * (i % 2), hold_s=9.5) for i in range(ROWS)]
    begin = PathPoint(latitude_deg=south, longitude_deg=east)
    centre_deg = south - math.degrees(30.0 / _origin(boat).north_m_per_rad)
    circle = PathPoint(latitude_deg=centre_deg, longitude_deg=east, turn_deg=360.0, radius_m=30.0)
    return Mission(version=1, name="largest", waypoint=tuple(stops), path=(begin, *[circle] * (ROWS - 1)), fence=around)


def _origin(boat: VehicleLoop) -> Any:
    assert boat.state.origin is not None
    return boat.state.origin


def _place(boat: VehicleLoop, north_m: float, east_m: float) -> tuple[float, float]:
    at = _origin(boat)
    return (
        math.degrees(at.latitude_rad + north_m / at.north_m_per_rad),
        math.degrees(at.longitude_rad + east_m / at.east_m_per_rad),
    )


def _ring(boat: VehicleLoop, north_m: float, east_m: float, radius_m: float) -> Iterator[tuple[float, float]]:
    for i in range(config.CORNERS):
        turn = math.tau * i / config.CORNERS
        yield _place(boat, north_m + radius_m * math.cos(turn), east_m + radius_m * math.sin(turn))


def _vessels(settings: config.Vehicle) -> list[Row]:
    """As many vessels as are known at once, from the first report on: twelve of them come into the boat's way, the others lie
    all around. Then a decision for twelve."""
    random = Random(1)

    def heard() -> tuple[Lockstep, list[VesselPosition]]:
        sea = Lockstep(settings, 1, lambda clock: NoLog())
        for _ in sea.cycles(WARM_S):
            pass
        assert sea.command(console.Course(0.0, 1.5)) is None
        places = [_place(sea.vehicle, random.uniform(100.0, 900.0), random.uniform(-600.0, 600.0)) for _ in range(MOST)]
        rows = []
        for i, (latitude_deg, longitude_deg) in enumerate(places):
            course_rad, speed_mps = random.uniform(0.0, math.tau), random.uniform(0.5, 6.0) if i < keepclear.MOST else 0.5
            at = math.radians(latitude_deg), math.radians(longitude_deg)
            rows.append(VesselPosition(200_000_000 + i, *at, course_rad, speed_mps, None, None, "B"))
        return sea, rows

    def watched() -> Callbacks:
        random.seed(1)
        sea, rows = heard()
        for each in rows:
            sea.state.hear(each, "ais", sea.elapsed_s)
        yield None
        for _ in range(TICKS):
            sea.clock.advance(0.1)
            sea.vehicle.on_watchdog()
            yield None

    def told() -> Callbacks:
        sea, rows = heard()
        for each in rows:
            sea.state.hear(each, "ais", sea.elapsed_s)
        for _ in range(TICKS):
            sea.clock.advance(0.1)
            sea.vehicle.on_watchdog()
        yield None
        yield console.answer(None, in_json(sea.vehicle.report()))

    def decided() -> Callbacks:
        random.seed(1)
        own, route = Own(0.0, 0.0, 0.0, 1.5), RouteAhead(((5000.0, 0.0),), 1.5)
        limits = Caution(4.5, 0.26, 0.4)
        them = [_met(random, str(i)) for i in range(keepclear.MOST)]
        yield from _slices(keepclear.deciding(limits, keepclear.Memory(), own, route, them, None, 0.0))

    number, edge = f"{MOST} vessels", thingcosts.field(1.0)
    return [
        Row(f"{number}: a step of the watch", watched),
        Row(f"{number}, {thingcosts.THINGS} things: a step of the watch", partial(thingcosts.watched, settings, "thing")),
        Row(f"{number}, {thingcosts.THINGS} swimmers: a step of the watch", partial(thingcosts.watched, settings, "person")),
        Row("a way past all things, by the largest chart", thingcosts.passed),
        Row("the largest chart: a look 8 m along an edge", _once(lambda: edge.least_m((0.0, 0.0), (8.0, 0.0), 3.0))),
        Row(f"{number}: state for a watcher", told),
        Row(f"a decision for {keepclear.MOST} vessels that come together", decided),
    ]


def _met(random: Random, key: str) -> Target:
    """A vessel that comes to where the boat will be."""
    t_s, course_rad, speed_mps = random.uniform(60.0, 180.0), random.uniform(0.0, math.tau), random.uniform(1.0, 6.0)
    north_m, east_m = 1.5 * t_s - t_s * speed_mps * math.cos(course_rad), -t_s * speed_mps * math.sin(course_rad)
    return Target(key, key, north_m, east_m, course_rad, speed_mps, math.nan, 30.0, 6.0, True, 10.0, 0.0, False, "A", 0)


def _estimator() -> Row:
    """All four values at once, and the motion: more than a step at sea ever has. It is to take 0.1 ms at most."""
    estimator = Estimator(config.EstimatorTable(antenna_forward_m=1.0), config.NavigationTable(), 3.0)
    ticks = count()

    def step() -> Callbacks:
        yield None
        for _ in range(100):
            t_s = 0.1 * next(ticks)
            estimator.rate(t_s, 0.01 * math.sin(t_s))
            estimator.heading(t_s, 0.01 * t_s)
            estimator.position(t_s, 0.67 + 1e-8 * t_s, -0.16, 0.1)
            estimator.velocity(t_s, 0.06, 1e-6 * t_s, 0.1)
            yield estimator.estimate(t_s)

    return Row("step of the estimator", step)


def _words() -> list[Row]:
    """A message for the system log, as many lines of it as a deep stack has, none of them printable."""
    with open(os.devnull, "wb") as nothing:
        handler = SystemHandler(
            os.dup(nothing.fileno()), "bench", SystemClock(), levels={"": logging.INFO}, terminal=os.dup(nothing.fileno())
        )
    message = "\n".join(["\x01" * 900] * 30)
    record = logging.LogRecord("delfim", logging.ERROR, __file__, 0, "%s", (message,), None)
    return [Row("message of 30 lines for the system log", _once(lambda: handler.emit(record)))]


def _slices(work: Any) -> Callbacks:
    sliced = Sliced(work)
    yield None
    while not sliced.step():
        yield None
    yield None


def _once(call: Callable[[], object]) -> Callable[[], Callbacks]:
    def callbacks() -> Callbacks:
        yield None
        yield call()

    return callbacks


def _plans(boat: VehicleLoop, largest: console.Upload) -> list[Row]:
    def accepted() -> Callbacks:
        Sliced(boat.helm.plans.look(largest)).finish()
        yield None
        yield boat.on_command(largest)

    def changed(command: console.Upload | console.SetFence) -> Callbacks:
        """While the boat sails: looked at, and accepted."""
        for before in (largest, console.Play()):
            assert boat.on_command(before) is None
        yield from _slices(boat.helm.plans.look(command))
        yield boat.on_command(command)
        assert boat.on_command(console.Stop()) is None

    def items(draft: Any, told: Iterator[plans.Item]) -> Callbacks:
        yield None
        for number, item in enumerate(told):
            yield draft.add(number, item)
        yield draft.done("largest", largest.mission.fence) if isinstance(draft, plans.MissionDraft) else draft.done()

    fenced = console.SetFence(largest.mission.fence)
    star = [((1 + i % 2) * math.cos(0.0628 * i), (1 + i % 2) * math.sin(0.0628 * i)) for i in range(config.CORNERS)]
    return [
        Row("mission that came as text", lambda: _slices(missionreader.gathered(list(missionreader.written(largest.mission))))),
        Row("mission that comes item by item", lambda: items(plans.MissionDraft(), plans.mission_items(largest.mission))),
        Row("fence that comes item by item", lambda: items(plans.ZonesDraft(), plans.fence_items(largest.mission.fence))),
        Row("mission looked at, in the largest fence", lambda: _slices(boat.helm.plans.look(largest))),
        Row("fence looked at, around the largest mission", lambda: _slices(boat.helm.plans.look(fenced))),
        Row("mission written for the log", lambda: _slices(console.written(largest))),
        Row("mission accepted", accepted),
        Row("mission changed under way", lambda: changed(largest)),
        Row("fence changed under way", lambda: changed(fenced)),
        Row("line of the command socket", _once(lambda: console.parse(_line()))),
        Row("polygon, a star", lambda: _slices(geodesy.polygon_fault(star))),
    ]


def _line() -> bytes:
    """A part of a mission's text of which each character is escaped."""
    return json.dumps({"command": "mission", "text": "\n" * console.PART, "at": 0, "more": True}).encode()


def _fences(boat: VehicleLoop) -> list[Row]:
    def comb(n: float) -> Zone:
        """Its teeth run past the boat from west to east, a millimetre from each other."""
        return polygon("", False, [*((n + 1e-3 * i, 2e3 * (-1) ** i) for i in range(99)), (3e3, 0.0)])

    def near(north_m: float) -> Motion:
        return Motion(ALL, north_m, 0.0, 0.0, 0.0, -1.5, 0.0)

    def onto(f: fence.Fence) -> object:
        return fence.crossing(f, near(0.0), (9000.0, 9000.0))

    own = config.FenceTable()
    around = Sliced(fence.survey(own, zones(boat), _origin(boat))).finish()
    assert around is not None
    legal, worst = around, fence.Fence(tuple(comb(6.0 + 0.001 * i) for i in range(200)), own)
    track = tuple((5.0 - 1e-3 * i, 0.0) for i in range(config.HomeTable().points))
    found = []
    for name, each in (("fence", legal), ("fence of combs", worst)):
        found += [
            Row(f"{name}: watched ahead", _once(partial(fence.ahead, each, near(5.0)))),
            Row(f"{name}: whether the boat is outside", _once(partial(fence.outside, each, 6.05, 0.5))),
            Row(f"{name}: a way across it", _once(partial(onto, each))),
            Row(f"{name}: a place to hold", partial(_held, each, track)),
        ]
    return [*found, Row("fence: a way round it, until it is given up", partial(_led, legal))]


def _led(around: fence.Fence) -> Callbacks:
    search = detour.begun(
        around, Motion(ALL, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), Setpoint(target=To(1500.0, 1000.0, 1.5, 5.0)), "operator"
    )
    assert search is not None
    yield None
    while search.step() is None:
        yield None


def _held(around: fence.Fence, track: tuple[Point, ...]) -> Callbacks:
    return _slices(fence.place_to_hold(around, (5.0, 0.0), (5.0, 0.0), track, 5.0))


def _voyage(boat: VehicleLoop, largest: console.Upload) -> list[Row]:
    home = config.HomeTable()

    def driven() -> Track:
        track = Track(home)
        for i in range(home.points):
            track.add(home.spacing_m * i, 0.0)
        return track

    def thinned() -> Callbacks:
        track = driven()
        yield None
        track.add(home.spacing_m * home.points, 0.0)
        yield None

    def cut() -> Callbacks:
        """It was a loop, and the boat is back."""
        track = driven()
        yield None
        for i in range(home.points // 16):
            track.add(-home.spacing_m * i, 0.0)
            yield None

    def looked_back() -> Callbacks:
        track = driven()
        yield None
        track.call_at(tuple((9.0 * i, 99.0) for i in range(plans.HARBOURS)), 5.0)
        yield None
        for _ in range(home.points // 16):
            track.look_back()
            yield None
        yield track.way_home()

    def entered() -> object:
        nowhere = Motion(ALL, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
        return enter(Mode.PATH, nowhere, boat.state.setpoint, boat.helm.limits)

    return [
        Row("driven track thinned", thinned),
        Row("driven track, all of it a loop", cut),
        Row("driven track and harbours", looked_back),
        Row("path entered", _once(entered)),
        Row("value set", _once(lambda: boat.on_command(console.Set("control.hold.radius_m", 6.0)))),
        Row("state for a watcher", _once(lambda: console.answer(None, in_json(boat.report())))),
        Row("line after line of the guest", _once(lambda: boat.guest.data_received(b'{"heading_deg": 90}\n' * 3277))),
    ]


def _consoles(boat: VehicleLoop, largest: console.Upload) -> list[Row]:
    sent = count()
    station = Station(boat, boat.on_command, lambda datagram, address: next(sent), None)
    senders = [Sender(250, 1 + i, None, lambda: 0) for i in range(CONSOLES)]

    def hear(number: int, message: Any) -> None:
        station.receive(senders[number].pack(message), ("127.0.0.1", 14600 + number))

    def told() -> Callbacks:
        """All that is due for as many consoles as there may be; the parameters, too."""
        while station.consoles.missions.step():
            pass
        yield None
        for i in range(CONSOLES):
            hear(i, dialect.MAVLink_param_request_list_message(1, 1))
        while station.turn():
            yield None
        for peer in station.consoles.peers.known.values():
            peer.due_s.clear()
            peer.told.clear()
        station.begin()
        yield None
        while station.serve():
            yield None
        yield None

    def asked(message: Any) -> Callable[[], Callbacks]:
        def callbacks() -> Callbacks:
            for _ in range(FRAMES):
                hear(0, message)
            yield None
            while station.turn():
                yield None
            yield None

        return callbacks

    def reread() -> Callbacks:
        for each in station.consoles.missions._told.values():
            boat.helm.plans.remains.add(each.items)
        yield None
        station.consoles.missions._told.update(dict.fromkeys(station.consoles.missions._told, plans.NOTHING))
        while station.consoles.missions.step():
            yield None
        yield station.consoles.missions.checksum(plans.ALL)

    number = len(largest.mission.fence.keep_out) * config.CORNERS
    order, message = dialect.MAVLink_command_long_message, dialect.MAVLINK_MSG_ID_AVAILABLE_MODES
    modes = order(1, 1, dialect.MAV_CMD_REQUEST_MESSAGE, 0, message, 0, 0, 0, 0, 0, 0)
    hold = order(1, 1, dialect.MAV_CMD_DO_SET_MODE, 0, 1, int(Mode.HOLD), 0, 0, 0, 0, 0)
    return [
        Row("consoles told what is due", told),
        Row("plans made ready to be told", reread),
        Row("plans: items asked for", asked(dialect.MAVLink_mission_request_int_message(1, 1, number, plans.FENCE))),
        Row("questions after all modes", asked(modes)),
        Row("orders to hold", asked(hold)),
        Row("reason told to all consoles", _once(lambda: station.consoles.peers.say(4, "x" * 5000))),
    ]
