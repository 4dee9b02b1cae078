"""An area from a file, made into lines, sailed in lock step over a bed that is known, and its soundings taken home."""

import csv
import json
import math
from datetime import datetime
from pathlib import Path

import pytest
from shapely.geometry import LineString, MultiPolygon, Point, box

from bench.survey import BOATS, FOLLOWED, compared, followed, rectangle_of
from delfim import config
from delfim.__main__ import main
from delfim.base.geodesy import origin, to_plane
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.seabed import bed_of
from delfim.simulator.tables import Simulation
from delfim.survey.areafile import read_area
from delfim.survey.ground import Ground, in_degrees, laid, swaths
from delfim.survey.linefigures import figures
from delfim.survey.planning import SurveyPlan, check, mission, planned, wanted_of
from delfim.vehicle import console
from delfim.vehicle.plans.mission import Mission, canonical, load_mission
from delfim.vehicle.state import NoLog
from tests.logging.sailing import Day
from tests.survey.drawn import drawn

ROOT = Path(__file__).parents[2]
BASIN = ROOT / "etc/areas/basin.geojson"
SPACING_M = 20.0
BED = "{mean_m=7.0, seed=3, tide_m=0.8, tide_s=3000.0, latitude_deg=38.6911, longitude_deg=-9.2142}"
SEA = "simulation.sea={current_mps=0.2, current_to_deg=70.0, wind_mps=4.0, wind_from_deg=300.0}"
UNTIL_S = 3600.0


def survey(settings: config.Vehicle, **asked: object) -> SurveyPlan:
    return planned(laid(read_area(BASIN)), wanted_of(settings, spacing_m=SPACING_M, **asked), settings.fence)


def at_begin(plan: SurveyPlan, boat: str, *overrides: str) -> Lockstep:
    """The boat where its survey begins."""
    places = zip(("latitude", "longitude"), in_degrees(plan.ground.at, *plan.begin), strict=True)
    here = (f"simulation.{name}_deg={deg}" for name, deg in places)
    return Lockstep(config.load(ROOT / f"etc/{boat}.toml", [*overrides, *here]), 1, lambda clock: NoLog())


def on_its_path(run: Lockstep, its: Mission) -> None:
    """The boat has had time to find out where she is, and begins."""
    assert run.command(console.LoadMission(canonical(its))) is None
    for _ in run.cycles(5.0):
        pass
    assert run.command(console.SetMode("path")) is None


def sailed(sailing: Lockstep, plan: SurveyPlan, begun_s: float) -> float:
    """The time from the beginning of the plan, where the boat must come by, as long as it took: of one that is done."""
    assert sailing.state.reason.startswith("path done"), sailing.state.reason
    return sailing.elapsed_s - begun_s


def true_place(sailing: Lockstep, plan: SurveyPlan) -> tuple[float, float]:
    model = sailing.nodes.model
    north_m, east_m = to_plane(plan.ground.at, model.latitude_rad, model.longitude_rad)
    return east_m, north_m


def of_lines(plan: SurveyPlan, track: list[tuple[float, float]]) -> tuple[list[float], float]:
    """Of each line the part that was sailed within a quarter of the spacing; and what that covers of what may be sailed."""
    near = LineString(track).buffer(SPACING_M / 4.0)
    done = [LineString(line).intersection(near) for line in plan.lines]
    pieces = [part for each in done for part in getattr(each, "geoms", [each]) if part.length]
    covered = swaths([(piece.coords[0], piece.coords[-1]) for piece in pieces], SPACING_M).intersection(plan.free)
    parts = [each.length / math.dist(*line) for each, line in zip(done, plan.lines, strict=True)]
    return parts, covered.area / plan.free.area


def test_an_example_area_is_sailed_line_by_line_and_its_soundings_are_those_of_the_bed(tmp_path, capsys) -> None:
    text = tmp_path / "basin.toml"
    words = ["--spacing", str(SPACING_M), "--output", str(text), "--picture", str(tmp_path / "basin.png")]
    assert main(["survey", "lines", str(BASIN), *words]) == 0
    assert "covered: 100.0 % of what may be sailed" in capsys.readouterr().out
    day = Day(tmp_path / "log", 'sensors.names=["sysstat", "nmea2000"]', f"simulation.sea_bed={BED}", SEA)
    plan, begun_s, track = survey(day.settings), math.inf, list[tuple[float, float]]()
    assert mission(plan, "basin") == load_mission(text), "the command and the function make the same"
    day.sail(5.0)
    for command in (console.LoadMission(text.read_text()), console.SetMode("path")):
        assert day.command(command) is None
    while day.sailing.state.mode.name == "PATH" and day.sailing.elapsed_s < UNTIL_S:
        day.sail(1.0)
        track.append(true_place(day.sailing, plan))
        if math.isinf(begun_s) and math.dist(track[-1], plan.begin) < 3.0:
            begun_s = day.sailing.elapsed_s
    took_s = sailed(day.sailing, plan, begun_s)
    day.end()
    assert took_s == pytest.approx(plan.time_s, rel=0.05)
    parts, covered = of_lines(plan, track)
    assert min(parts) > 0.99
    assert covered > 0.99
    assert len(plan.ground.holes.geoms) == 1
    assert not any(hole.buffer(3.0).contains(Point(place)) for hole in plan.ground.holes.geoms for place in track)
    errors_m = soundings(tmp_path, day.settings)
    assert len(errors_m) > 0.9 * took_s, "one a second"
    assert sorted(map(abs, errors_m))[int(0.95 * len(errors_m))] < 0.15
    assert abs(sum(errors_m)) / len(errors_m) < 0.03


def soundings(place: Path, settings: config.Vehicle) -> list[float]:
    """How far the soundings of a day's log are off the truth of their place and time."""
    bed, file = bed_of(settings.of(Simulation)), place / "soundings.csv"
    assert bed is not None
    assert main(["log", "export", "soundings", str(place / "log"), "--output", str(file)]) == 0
    with file.open(newline="") as text:
        rows = [row for row in csv.DictReader(text) if row["latitude [deg]"]]
    first = datetime.fromisoformat(rows[0]["utc"])
    off = list[float]()
    for row in rows:
        time_s = (datetime.fromisoformat(row["utc"]) - first).total_seconds()
        position = math.radians(float(row["latitude [deg]"])), math.radians(float(row["longitude [deg]"]))
        off.append(float(row["depth_m [m]"]) - bed.depth_at(*position, time_s))
    return off


def test_a_boat_that_starts_on_one_of_its_lines_sails_them_all_from_the_first(tmp_path) -> None:
    """Wherever it lies: a path that began at the piece under the boat would be done in a moment, and nobody would notice."""
    here = {
        "type": "Polygon",
        "coordinates": [[[-9.2157, 38.6903], [-9.2149, 38.6903], [-9.2149, 38.6910], [-9.2157, 38.6910]]],
    }
    (tmp_path / "here.geojson").write_text(json.dumps(here))
    settings = config.load(ROOT / "etc/delfimx.toml")
    plan = planned(laid(read_area(tmp_path / "here.geojson")), wanted_of(settings, spacing_m=SPACING_M), settings.fence)
    run, track = Lockstep(settings, 1, lambda clock: NoLog()), list[tuple[float, float]]()
    assert LineString([place for line in plan.lines for place in line]).distance(Point(true_place(run, plan))) < 5.0
    on_its_path(run, mission(plan, "here"))
    for state in run.cycles(UNTIL_S):
        track.append(true_place(run, plan))
        if state.mode.name != "PATH":
            break
    assert min(of_lines(plan, track)[0]) > 0.99


@pytest.mark.long
@pytest.mark.parametrize("boat", ["delfimx", "boats/otter", "boats/blueboat", "boats/skiff"])
def test_boats_of_all_kinds_sail_the_lines_of_their_plan(boat: str) -> None:
    overrides = [SEA, f"simulation.sea_bed={BED}"]
    settings = config.load(ROOT / f"etc/{boat}.toml", overrides)
    plan = survey(settings)
    its = mission(plan, "basin")
    check(its, plan, settings)
    assert bool(its.path) == (boat == "boats/skiff"), "arcs for a boat that does not turn on the spot"
    run, begun_s, track = at_begin(plan, boat, *overrides), math.inf, list[tuple[float, float]]()
    on_its_path(run, its)
    for state in run.cycles(UNTIL_S):
        track.append(true_place(run, plan))
        if math.isinf(begun_s) and math.dist(track[-1], plan.begin) < 3.0:
            begun_s = run.elapsed_s
        if state.mode.name != "PATH":
            break
    took_s = sailed(run, plan, begun_s)
    parts, covered = of_lines(plan, track)
    told = {"boat": boat, "time": round(took_s / plan.time_s, 3), "worst line": round(min(parts), 3)}
    print(json.dumps(told | {"covered": round(covered, 4)}))
    assert took_s == pytest.approx(plan.time_s, rel=0.05)
    assert covered > 0.97


def test_no_fence_stops_a_boat_whose_lines_end_at_an_island_with_wind_and_current_behind() -> None:
    sea = "simulation.sea={current_mps=0.3, current_to_deg=20.0, wind_mps=6.0, wind_from_deg=200.0}"
    island = Point(0.0, 40.0).buffer(10.0)
    at = origin(math.radians(38.6907), math.radians(-9.2153))
    ground = Ground(at, MultiPolygon([box(-16.0, 0.0, 16.0, 70.0).difference(island)]), MultiPolygon([island]))
    settings = config.load(ROOT / "etc/boats/otter.toml", [sea])
    plan = planned(ground, wanted_of(settings, spacing_m=8.0, heading_deg=0.0), settings.fence)
    run = at_begin(plan, "boats/otter", sea)
    on_its_path(run, mission(plan, "island"))
    begun_s = run.elapsed_s
    for state in run.cycles(UNTIL_S):
        if state.mode.name != "PATH":
            break
    assert sailed(run, plan, begun_s) == pytest.approx(plan.time_s, rel=0.05)


@pytest.mark.parametrize(
    ("boat", "area", "wind_mps", "wind_from_deg", "current_mps", "current_to_deg"),
    [
        pytest.param("wam-v", 307, 3.62, 267.5, 0.25, 176.1, marks=pytest.mark.long),
        pytest.param("wam-v", 7, 2.17, 57.9, 0.249, 187.5, marks=pytest.mark.long),
        pytest.param("wam-v", 417, 4.617, 44.0, 0.256, 149.8, marks=pytest.mark.long),
        pytest.param("skiff", 303, 2.4, 254.5, 0.206, 359.7, marks=pytest.mark.long),
    ],
)
def test_no_fence_stops_a_boat_among_holes(
    boat: str, area: int, wind_mps: float, wind_from_deg: float, current_mps: float, current_to_deg: float
) -> None:
    """Areas whose voyages a fence had ended: short run-outs at full speed, sharp corners of a boat that steers, and a slow turn
    on the spot, during which wind and current carried the boat by 8 m."""
    wind, current = f"wind_mps={wind_mps}, wind_from_deg={wind_from_deg}", f"current_to_deg={current_to_deg}"
    sea = f"simulation.sea={{current_mps={current_mps}, {current}, {wind}}}"
    ground, spacing_m = drawn(area, (90.0, 150.0), 1.0)
    settings = config.load(ROOT / f"etc/boats/{boat}.toml")
    plan = planned(ground, wanted_of(settings, spacing_m=spacing_m), settings.fence)
    run, track = at_begin(plan, f"boats/{boat}", sea), list[tuple[int, tuple[float, float]]]()
    on_its_path(run, mission(plan, "holes"))
    begun_s = run.elapsed_s
    for state in run.cycles(UNTIL_S):
        track.append((state.reference.line, true_place(run, plan)))
        if state.mode.name != "PATH":
            break
    sailed(run, plan, begun_s)
    each = figures(dict(enumerate(plan.lines, 1)), track)
    assert sum(line.sailed * line.length_m for line in each) > 0.98 * plan.line_m


@pytest.mark.long
def test_a_survey_whose_power_is_cut_on_a_line_goes_on_by_its_log_from_where_the_boat_is(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["survey", "lines", str(BASIN), "--spacing", str(SPACING_M)]) == 0
    here, text = [f"simulation.sea_bed={BED}", SEA, 'sensors.names=["sysstat", "nmea2000"]'], Path("basin.toml")
    for number in (0, 1):
        day = Day(tmp_path / f"log{number}", *here)
        day.sail(5.0)
        for command in (console.LoadMission(text.read_text()), console.SetMode("path")):
            assert day.command(command) is None
        while day.sailing.state.mode.name == "PATH" and day.sailing.elapsed_s < UNTIL_S:
            day.sail(5.0)
            if number == 0 and day.sailing.state.reference.line == 6:
                day.sail(15.0)
                break
        model = day.sailing.nodes.model
        place = math.degrees(model.latitude_rad), math.degrees(model.longitude_rad)
        here += [f"simulation.{name}_deg={deg:.8f}" for name, deg in zip(("latitude", "longitude"), place, strict=True)]
        day.end()
        capsys.readouterr()
        assert main(["survey", "rest", "basin.survey.json", str(tmp_path / f"log{number}")]) == 0
        said, text = capsys.readouterr().out, Path("basin-rest.toml")
        assert ("1 in part" in said) == (number == 0)
    assert said.endswith("the survey is done\n")


@pytest.mark.long
def test_a_boat_that_comes_to_its_lines_in_a_bow_leaves_nothing_where_all_is_covered(tmp_path, capsys, monkeypatch) -> None:
    """A boat with a rudder, in wind: three of its lines were planned again for the 5 m at their ends."""
    monkeypatch.chdir(tmp_path)
    boat = str(ROOT / "etc/boats/bait-boat.toml")
    assert main(["survey", "lines", str(BASIN), "--vehicle", boat, "--spacing", "10", "--output", "basin.toml"]) == 0
    sea = ["--set", "simulation.sea_bed.mean_m=7.0", "--set", "simulation.sea.wind_mps=6.0"]
    assert main(["sim", boat, "--lockstep", "--mission", "basin.toml", "--output", "log", "--for", "3000", *sea]) == 0
    capsys.readouterr()
    assert main(["survey", "rest", "basin.survey.json", "log"]) == 0
    assert capsys.readouterr().out.endswith("the survey is done\n")


@pytest.mark.long
@pytest.mark.parametrize("boat", FOLLOWED)
@pytest.mark.parametrize(("noise_m", "off_m"), [(0.3, 1.3), (0.02, 0.7)], ids=["receiver", "RTK"])
def test_lines_are_kept_in_wind_and_current(boat: str, noise_m: float, off_m: float) -> None:
    """By true places: 6 m/s of wind and 0.3 m/s of current. 95 % of all places on ten lines, and how much of each is sailed."""
    its = followed(boat, noise_m, 6.0, 0.3, seed=11)
    assert its.p95_m <= off_m
    assert len(its.lines) == 10
    assert min(line.sailed for line in its.lines) >= 0.99


@pytest.mark.long
@pytest.mark.parametrize("boat", [*BOATS, "bait-boat"])
def test_a_survey_in_wind_and_current_takes_the_time_and_the_energy_foretold(boat: str) -> None:
    """4 m/s of wind and 0.2 m/s of current, of which the sum knows nothing."""
    time, energy = compared(boat, rectangle_of(331))
    assert time == pytest.approx(1.0, abs=0.05)
    assert energy == pytest.approx(1.0, abs=0.10)
