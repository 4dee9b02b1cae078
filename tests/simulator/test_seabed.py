"""The bed of the simulated sea: the truth that soundings are judged by, what sounders hear of it, and the trouble `shallow`."""

import itertools
import math

import msgspec
import pytest

from delfim import config
from delfim.base.errors import ConfigError
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.model import DEPTH_M, Bank
from delfim.simulator.nodes import nodes_of
from delfim.simulator.nodes.measuring import Sounder
from delfim.simulator.seabed import LEAST_M, SCATTERED_M, Echoes, SeaBed, bed_of
from delfim.simulator.tables import Sea, SimulatedBed, Simulation
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

BED = SimulatedBed(mean_m=8.0, seed=1)
EXACT = Simulation(noise=False, sea_bed=BED)
PLACES = list(itertools.product(range(-400, 401, 20), repeat=2))
DRAWN = 20_000


def bed(**keys: float) -> SeaBed:
    found = bed_of(Simulation(sea_bed=msgspec.structs.replace(BED, **keys)))
    assert found is not None
    return found


def boat(simulation: Simulation, least_m: float = 0.0, **sensors: object) -> config.Vehicle:
    return config.Vehicle(
        boat=config.BoatTable(name="test"),
        sensors=config.Sensors(names=("sysstat", "nmea2000"), **sensors),  # type: ignore[arg-type]
        sysstat=config.Sysstat(required=()),
        failsafe=config.Failsafe(shallow=config.Shallow(min_depth_m=least_m)),
        simulation=simulation,
    )


def test_a_seed_is_a_bed_and_another_seed_is_another_one() -> None:
    one, other = ([bed(seed=seed).depth_m(*place, 0.0) for place in PLACES] for seed in (1, 2))
    assert one == [bed().depth_m(*place, 0.0) for place in reversed(PLACES)][::-1], "whatever was asked before"
    assert one != other
    assert min(one) >= LEAST_M
    assert max(one) - min(one) > 3.0
    assert sum(one) / len(one) == pytest.approx(8.0, abs=1.0)


@pytest.mark.parametrize("seed", range(1, 6))
def test_the_bed_has_shallows_and_no_steps(seed: int) -> None:
    it = bed(seed=seed)
    line = [it.depth_m(0.1 * step - SCATTERED_M, 50.0, 0.0) for step in range(6000)]
    assert max(abs(b - a) for a, b in itertools.pairwise(line)) < 0.4, "in 10 cm, on the side of a boulder"
    everywhere = [it.depth_m(*place, 0.0) for place in itertools.product(range(-300, 301, 5), repeat=2)]
    assert min(everywhere) < 0.6 * 8.0
    assert max(everywhere) > 1.2 * 8.0


def test_the_tide_lifts_all_water_alike() -> None:
    it, still = bed(tide_m=1.5, tide_s=400.0), bed()
    for north_m, east_m in PLACES[::50]:
        depth_m = still.depth_m(north_m, east_m, 0.0)
        assert it.depth_m(north_m, east_m, 0.0) == depth_m, "it begins at the mean"
        assert it.depth_m(north_m, east_m, 100.0) == pytest.approx(depth_m + 1.5)
        assert it.depth_m(north_m, east_m, 700.0) == pytest.approx(max(depth_m - 1.5, LEAST_M))


def test_without_a_bed_the_water_is_as_it_was_and_a_bank_lies_on_the_bed() -> None:
    flat, model = nodes_of(boat(Simulation()), 1).model, nodes_of(boat(EXACT), 1).model
    assert (flat.bed, flat.depth_m) == (None, DEPTH_M)
    assert model.depth_m == bed().depth_m(0.0, 0.0, 0.0)
    model.bank = Bank(0.0, 0.0, 0.5)
    assert model.depth_m == 0.5


def test_the_bed_stays_where_it_is_when_a_boat_starts_elsewhere() -> None:
    fixed = msgspec.structs.replace(BED, latitude_deg=38.69, longitude_deg=-9.21)
    there = Simulation(sea_bed=fixed, latitude_deg=38.691, longitude_deg=-9.212)
    model, it = nodes_of(boat(there), 1).model, bed_of(there)
    assert it is not None
    assert model.depth_m == pytest.approx(it.depth_m(111.0, -174.0, 0.0), abs=0.1)
    assert model.depth_m == it.depth_at(math.radians(38.691), math.radians(-9.212), 0.0)
    assert it.middle == bed_of(Simulation(sea_bed=fixed)).middle  # type: ignore[union-attr]
    with pytest.raises(ConfigError, match="latitude_deg and longitude_deg go together"):
        config.load("etc/delfimx.toml", ["simulation.sea_bed={mean_m=5.0, latitude_deg=38.0}"])


def test_sounders_on_a_bus_and_on_a_line_tell_the_truth_of_their_place_and_time() -> None:
    sea = Sea(current_mps=0.8, current_to_deg=60.0)
    tidal = msgspec.structs.replace(EXACT, sea=sea, sea_bed=msgspec.structs.replace(BED, tide_m=1.0, tide_s=120.0))
    run, told = Lockstep(boat(tidal), 1, lambda clock: NoLog()), dict[float, tuple[float, float]]()
    model, sounder = run.nodes.model, Sounder(run.nodes.model, tidal, 1)
    for _ in run.cycles(60.0):
        if (measured := run.state.measured.get("depth_m")) is not None:
            told.setdefault(measured[1], (measured[0], model.depth_m))
        assert sounder.step(run.elapsed_s) in (None, model.depth_m)
    assert len(told) >= 55
    assert max(abs(depth_m - truth_m) for depth_m, truth_m in told.values()) < 0.06, "a centimetre, and a cycle's drift"
    assert max(truth_m for _, truth_m in told.values()) - min(truth_m for _, truth_m in told.values()) > 1.0


def test_bad_echoes_are_so_many_and_far_from_the_bottom() -> None:
    part = msgspec.structs.replace(EXACT, noise=True, sea_bed=msgspec.structs.replace(BED, bad_echoes=0.02))
    echoes = Echoes(part, 1, "sounder")
    heard = [echoes.heard(10.0) for _ in range(DRAWN)]
    bad = [each for each in heard if each != 10.0]
    assert len(bad) / DRAWN == pytest.approx(0.02, abs=0.004)
    assert all(1.0 <= each <= 8.0 or each == 20.0 for each in bad)
    for quiet in (EXACT, msgspec.structs.replace(part, noise=False)):
        echoes = Echoes(quiet, 1, "sounder")
        assert {echoes.heard(10.0) for _ in range(1000)} == {10.0}


def test_a_shallow_of_the_bed_turns_the_boat_back() -> None:
    it = bed(seed=25)
    ahead = [it.depth_m(0.0, float(east_m), 0.0) for east_m in range(150)]
    least_m = 0.5 * (min(ahead[:20]) + min(ahead))
    first_m = next(east_m for east_m, depth_m in enumerate(ahead) if depth_m < least_m)
    assert 20 <= first_m < 140, "the bed of this seed rises ahead"
    here = msgspec.structs.replace(EXACT, sea_bed=msgspec.structs.replace(BED, seed=25))
    run = Lockstep(boat(here, least_m, required=("depth_m",)), 1, lambda clock: NoLog())
    list(run.cycles(3.0))
    assert run.command(console.Heading(90.0, 1.5)) is None
    farthest_m = 0.0
    for _ in run.cycles(240.0):
        farthest_m = max(farthest_m, run.nodes.model.east_m)
    assert run.state.mode is Mode.HOLD
    assert run.state.reason.startswith("shallow: ")
    assert first_m - 2.0 < farthest_m < first_m + 20.0
    assert run.nodes.model.depth_m > least_m
