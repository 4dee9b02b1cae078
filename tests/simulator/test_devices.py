"""A boat without a navigation node: a receiver and a compass on NMEA 2000, the estimator, the real loop, in lock step."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import pytest

from delfim import config
from delfim.base import geodesy
from delfim.base.clock import ManualClock
from delfim.base.errors import ConfigError
from delfim.base.modes import Mode
from delfim.base.parts import OWN
from delfim.canproxy.nmea2000.pgns import NorthReference, VesselHeading, encode
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.parts.nmea2000.table import Nmea2000
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.nodes.devices import COMPASS, NAMES, RECEIVER, Devices
from delfim.simulator.tables import Sea, Simulation
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
MISSION = (ROOT / "etc/missions/doca.toml").read_text()
NODE = config.NavigationTable()
SEPARATE = config.NavigationTable(sources=("nmea2000",), rate_hz=10.0, estimator=True)
LINES = config.NavigationTable(sources=("nmea0183",), rate_hz=10.0, estimator=True)
CORNER_S = 15.0  # after a waypoint, until the boat is on its next line


def boat(
    seed: int, navigation: config.NavigationTable = SEPARATE, *, towards_deg: float = 250.0, gyro: bool = True
) -> Lockstep:
    sea = Sea(current_mps=0.5, current_to_deg=towards_deg)
    simulation = Simulation(sea=sea, gyro=gyro)
    ports = {"gnss": Nmea0183Port(device="/dev/gnss"), "compass": Nmea0183Port(device="/dev/compass")}
    settings = config.Vehicle(
        boat=config.BoatTable(name="test"), navigation=navigation, simulation=simulation, nmea0183=Nmea0183(ports=ports)
    )
    return Lockstep(settings, seed, lambda clock: NoLog())


def devices(run: Lockstep) -> Devices:
    (there,) = run.nodes.beside
    assert isinstance(there, Devices)
    return there


def cross_track_m(run: Lockstep) -> float:
    """Sails the mission; the true distance from its lines, RMS."""
    assert run.command(console.LoadMission(MISSION)) is None
    playing, leg, since_s, squares = False, 0, 0.0, list[float]()
    for state in run.cycles(1200.0):
        playing = playing or run.command(console.Play()) is None
        if playing and state.mode is not Mode.PLAY:
            break
        if state.reference.leg != leg:
            leg, since_s = state.reference.leg, run.elapsed_s
        plan = state.setpoint.plan
        if plan is None or state.origin is None or not 0 < leg < len(plan.waypoints) or run.elapsed_s - since_s < CORNER_S:
            continue
        here = geodesy.to_plane(state.origin, run.nodes.model.latitude_rad, run.nodes.model.longitude_rad)
        (n, e), (to_n, to_e) = plan.waypoints[leg - 1][:2], plan.waypoints[leg][:2]
        across = (here[1] - e) * (to_n - n) - (here[0] - n) * (to_e - e)
        squares.append((across / math.dist((n, e), (to_n, to_e))) ** 2)
    assert run.state.reason == "play done"
    return math.sqrt(sum(squares) / len(squares))


def compared(navigation: config.NavigationTable, seeds: range) -> float:
    """The cross-track error with a receiver of 5 Hz and a compass of 10 Hz, by that of the navigation node."""
    separate = [cross_track_m(boat(seed, navigation, towards_deg=18.0 * seed, gyro=False)) for seed in seeds]
    whole = [cross_track_m(boat(seed, NODE, towards_deg=18.0 * seed)) for seed in seeds]
    return sum(separate) / sum(whole)


@pytest.mark.parametrize("navigation", [SEPARATE, LINES], ids=lambda table: table.sources[0])
def test_a_receiver_and_a_compass_sail_a_mission_in_current_as_the_navigation_node_does(navigation):
    assert compared(navigation, range(1, 2)) < 1.3


@pytest.mark.long
@pytest.mark.timeout(400)
@pytest.mark.parametrize("navigation", [SEPARATE, LINES], ids=lambda table: table.sources[0])
def test_a_receiver_and_a_compass_sail_missions_in_current_from_all_sides(navigation):
    assert compared(navigation, range(1, 21)) < 1.3


def test_the_same_seed_is_the_same_voyage_and_nothing_is_refused():
    voyages = []
    for _ in range(2):
        run = boat(3)
        assert run.command(console.LoadMission(MISSION)) is None
        list(run.cycles(5.0))
        assert run.command(console.Play()) is None
        voyages.append([(state.motion, state.actuation) for state in run.cycles(60.0)])
        assert run.state.counts == {}
        assert [each.refused for each in run.state.inputs["nmea2000"]] == [0, 0, 0, 0]
    assert voyages[0] == voyages[1]


def _position_jumps(d: Devices) -> None:
    d.receiver.jump_m = 60.0


def _heading_jumps(d: Devices) -> None:
    d.compass.jump_rad = math.radians(50.0)


def _receiver_freezes(d: Devices) -> None:
    d.receiver.frozen = True


def _compass_freezes(d: Devices) -> None:
    d.compass.frozen = True


def _receiver_falls_silent(d: Devices) -> None:
    d.receiver.silent = True


def _compass_falls_silent(d: Devices) -> None:
    d.compass.silent = True


ENDS: dict[str, tuple[Callable[[Devices], None], str, float]] = {  # what happens, why the boat stops, and within what time
    "position jumps": (_position_jumps, "position jumped by 60 m", 1.2),
    "heading jumps": (_heading_jumps, "heading jumped by 50 degrees", 1.2),
    "receiver freezes": (_receiver_freezes, "position frozen for 3.", 3.6),
    "compass freezes": (_compass_freezes, "heading frozen for 3.", 3.6),
    "receiver falls silent": (_receiver_falls_silent, "position silent for 1.", 1.5),
    "compass falls silent": (_compass_falls_silent, "heading silent for 1.", 1.5),
}


@pytest.mark.parametrize("name", ENDS)
def test_what_breaks_stops_a_boat_without_a_gyro_too_and_is_called_by_its_name(name):
    """With one: etc/scenarios."""
    happens, reason, within_s = ENDS[name]
    run = boat(1, gyro=False)
    list(run.cycles(5.0))
    assert run.command(console.Heading(3.0, 1.5)) is None
    list(run.cycles(30.0))
    assert run.state.mode is Mode.HEADING, run.state.reason
    happens(devices(run))
    began_s = run.elapsed_s
    for state in run.cycles(10.0):
        if state.mode is Mode.IDLE:
            break
    assert state.reason.startswith(reason), state.reason
    assert run.elapsed_s - began_s <= within_s
    refusal = run.command(console.Heading(3.0, 1.5))
    if "silent" in name:
        assert refusal is not None
        assert reason.split(" for")[0] in refusal or "navigation silent" in refusal, refusal


def test_a_silent_gyro_is_told_and_the_boat_sails_on():
    run = boat(1)
    list(run.cycles(5.0))
    assert run.command(console.Heading(60.0, 1.5)) is None
    list(run.cycles(30.0))
    devices(run).has_gyro = False
    list(run.cycles(60.0))
    assert run.state.mode is Mode.HEADING
    assert math.remainder(run.nodes.model.heading_rad - math.radians(60.0), math.tau) == pytest.approx(
        0.0, abs=math.radians(4.0)
    )
    line = next(check for check in run.vehicle.helm.checks() if check.name == "navigation")
    assert line.ok
    assert line.reason.endswith("rate silent for 60 s")


def test_the_navigation_node_is_the_reserve_and_its_messages_are_not_judged_by_the_estimators_inputs():
    both = config.NavigationTable(sources=("nmea2000", "dsor"), rate_hz=10.0, estimator=True)
    run = boat(1, both)
    list(run.cycles(5.0))
    assert run.command(console.Heading(60.0, 1.5)) is None
    list(run.cycles(10.0))
    assert run.state.source == "nmea2000"
    devices(run).receiver.silent = True
    list(run.cycles(10.0))
    assert run.state.source == "dsor"
    assert next(check for check in run.vehicle.helm.checks() if check.name == "navigation").ok
    devices(run).receiver.silent = False
    list(run.cycles(3.0))
    assert run.state.source == "nmea2000"
    assert run.state.mode is Mode.HEADING, run.state.reason


def test_a_boat_with_a_navigation_node_has_no_estimator():
    run = boat(1, NODE)
    list(run.cycles(5.0))
    assert run.state.inputs == {}
    assert run.nodes.beside == ()
    with pytest.raises(
        ConfigError, match="only for dronecan, nmea0183, nmea2000; these sources make whole messages by themselves"
    ):
        config.load(ROOT / "etc/delfimx.toml", ["navigation.estimator=true"])


def test_the_sources_that_may_be_estimated_are_those_that_tell_their_sensors():
    for name in get_args(config.SourceName):
        text = (ROOT / OWN[name].source.replace(".", "/")).with_suffix(".py").read_text()
        assert ("def tell(self, hearer: Hearer)" in text) == (name in config.ESTIMATED), name


def test_the_statistics_page_gets_the_ages_and_counts():
    run = boat(1)
    list(run.cycles(5.0))
    told = run.vehicle.sources[0].report(run.elapsed_s)["estimator"]
    assert isinstance(told, dict)
    assert set(told) == {"position", "velocity", "heading", "rate", "begun_again"}
    assert told["heading"]["refused"] == 0
    assert told["heading"]["heard"] > 40


def test_the_clock_may_be_set_at_sea():
    run = boat(1)
    list(run.cycles(5.0))
    assert run.command(console.Heading(60.0, 1.5)) is None
    for step_s in (3600.0, -1e6, 0.4):
        list(run.cycles(10.0))
        clock = run.clock
        assert isinstance(clock, ManualClock)
        clock.step(step_s)
    list(run.cycles(10.0))
    assert run.state.mode is Mode.HEADING
    assert "heading" in run.state.motion.has


def test_after_a_silence_of_the_receiver_everything_begins_with_a_position():
    run = boat(1)
    list(run.cycles(5.0))
    devices(run).receiver.silent = True
    list(run.cycles(5.0))
    before = run.state.cycles
    devices(run).receiver.silent = False
    list(run.cycles(1.0))
    assert run.state.cycles > before
    assert run.state.motion.has == {"position", "heading", "velocity"}
    assert run.command(console.Heading(60.0, 1.5)) is None


def test_sources_are_chosen_by_name_where_the_vehicles_file_has_names() -> None:
    table = Nmea2000(preferred_sources=(NAMES[RECEIVER], NAMES[COMPASS]))
    simulation = Simulation(heading_deg=90.0)
    settings = config.Vehicle(boat=config.BoatTable(name="test"), navigation=SEPARATE, nmea2000=table, simulation=simulation)
    run = Lockstep(settings, 1, lambda clock: NoLog())
    stranger = run.buses[table.interface].socket("stranger")
    for state in run.cycles(5.0):
        for frame in encode(VesselHeading(0.1, None, None, NorthReference.TRUE), 9):
            stranger.sendmsg(frame)
        known = None if state.navigation is None else state.navigation.heading_rad
        assert known is None or abs(known - 0.1) > 0.01
    (source,) = run.vehicle.sources
    told = source.report(run.clock.monotonic_s())
    assert told["kinds"]["heading"][0] == COMPASS
    assert told["sources"][str(COMPASS)][2] == NAMES[COMPASS]
