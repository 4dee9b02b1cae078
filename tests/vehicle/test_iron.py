"""The boat's iron is undone in magnetic headings, on both buses, and a place that is hopeless is refused."""

import math
from pathlib import Path

import pytest

from delfim import config
from delfim.adoption.model import said
from delfim.base.errors import ConfigError
from delfim.canproxy.nmea2000.pgns import NorthReference, VesselHeading
from delfim.config import CompassTable
from delfim.lines.nmea0183.sentences import Bearing
from delfim.parts.nmea0183.combining import Combined
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.parts.nmea2000.combining import Nmea2000Source
from delfim.parts.nmea2000.table import Nmea2000
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.navigation.iron import Iron, iron_of
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
BENT = CompassTable(hard_ahead=0.25, hard_aside=-0.2, soft_along=0.05, soft_across=-0.03, offset_deg=12.0)


def told_rad(table: CompassTable, heading_rad: float) -> float:
    """What the compass says, by the model of the fit."""
    import numpy as np

    names = {name: getattr(table, name) for name in ("hard_ahead", "hard_aside", "soft_along", "soft_across")}
    values = names | {"compass_offset": math.radians(table.offset_deg)}
    return float(said({name: np.array(value) for name, value in values.items()}, np.array(heading_rad)))


@pytest.mark.parametrize("degrees", range(0, 360, 15))
@pytest.mark.parametrize(
    "table", [BENT, CompassTable(hard_ahead=0.85), CompassTable(soft_across=0.3), CompassTable(offset_deg=-170.0)]
)
def test_what_the_magnet_does_is_undone(table: CompassTable, degrees: int) -> None:
    true = math.radians(degrees)
    found = Iron(table).undone(told_rad(table, true))
    assert 0.0 <= found <= math.tau
    assert math.remainder(found - true, math.tau) == pytest.approx(0.0, abs=1e-9)


def test_a_file_without_iron_changes_nothing() -> None:
    assert iron_of(CompassTable()) is None
    assert iron_of(BENT) is not None


@pytest.mark.parametrize("keys", [["hard_ahead=0.7", "hard_aside=0.7"], ["hard_ahead=0.8", "soft_along=0.3"]])
def test_iron_nearly_as_strong_as_the_earth_is_refused(keys: list[str]) -> None:
    with pytest.raises(ConfigError, match=r"of the earth's field, 0\.9 at most: give the compass another place"):
        config.load(ROOT / "etc/delfimx.toml", [f"compass.{key}" for key in keys])


@pytest.mark.parametrize("variation_rad", [None, math.radians(-3.0)])
def test_nmea_0183_undoes_it_before_the_variation(variation_rad: float | None) -> None:
    table = Nmea0183(ports={"compass": Nmea0183Port(device="/dev/compass")}, variation_deg=5.0)
    combined, magnetic = Combined(table, 2.5, {}, Iron(BENT)), math.radians(77.0)
    heard = list[tuple[float, ...]]()
    combined.fusion.hearer = lambda kind, value, utc_ns, deviation=0.0: heard.append(value)
    at = told_rad(BENT, magnetic) % math.tau
    true = None if variation_rad is None else at + variation_rad
    combined._heading("compass:HC", Bearing(true, at, variation_rad, 0.0), 1.0)
    expected = magnetic + (math.radians(5.0) if variation_rad is None else variation_rad)
    assert heard[-1][0] == pytest.approx(expected)
    combined._heading("compass:HC", Bearing(1.0, None, None, 0.0), 2.0)
    assert heard[-1][0] == pytest.approx(1.0)  # a true heading is no compass'


def test_nmea_2000_undoes_it_before_the_variation_and_leaves_true_headings_alone() -> None:
    source, magnetic = Nmea2000Source(Nmea2000(variation_deg=5.0), 2.5, iron=Iron(BENT)), math.radians(200.0)
    at = told_rad(BENT, magnetic) % math.tau
    found = source._true_heading(1, VesselHeading(at, None, None, NorthReference.MAGNETIC), 1.0)
    assert found is not None
    assert found[0] == pytest.approx(magnetic + math.radians(5.0))
    assert source._true_heading(1, VesselHeading(1.0, None, None, NorthReference.TRUE), 1.0) == (1.0,)


@pytest.mark.parametrize(("name", "variation"), [("blueboat", "nmea0183"), ("otter", "nmea2000")])
def test_in_simulation_the_iron_of_the_file_is_about_the_compass(name: str, variation: str) -> None:
    """Which the boat then undoes: a twin of a boat with a bent compass is not off by it."""
    iron = [f"compass.{key}={getattr(BENT, key)}" for key in BENT.__struct_fields__]
    still = "simulation.noise=false", f"{variation}.variation_deg=-3.0", "simulation.heading_deg=70.0"
    run = Lockstep(config.load(ROOT / f"etc/boats/{name}.toml", [*iron, *still]), 1, lambda clock: NoLog())
    for _ in run.cycles(8.0):
        pass
    assert math.degrees(run.state.motion.heading_rad - run.nodes.model.heading_rad) == pytest.approx(0.0, abs=1.0)
    compass = run.nodes.compasses[0]
    assert compass.bent is not None
    assert abs(math.degrees(compass.bent(1.0)) - math.degrees(1.0)) > 3.0
