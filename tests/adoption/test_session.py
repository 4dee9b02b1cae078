"""The whole trial in lock step, on boats that are not as their files say; its ends, and what is kept of it."""

import contextlib
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from bench.adoption import drifting
from delfim import config
from delfim.adoption import identify
from delfim.adoption.magnet import shape_of
from delfim.adoption.trial import boats, session
from delfim.adoption.trial.boats import RunningTrial, SimulatedTrial
from delfim.adoption.trial.hiddenhull import HiddenSensors, LateModel, drawn, rewired
from delfim.adoption.trial.manoeuvres import SeaTrial, TrialEnded
from delfim.adoption.trial.motors import MotorsFound, corrected
from delfim.adoption.trial.session import TrialProgress, TrialSession, kept
from delfim.adoption.trial.taped import record_of
from delfim.base.errors import Refused
from delfim.base.modes import Mode
from delfim.campaign.adopted.truth import is_right
from delfim.commands.operation.adopt import RADIUS_M
from delfim.config import CompassTable
from delfim.simulator.tables import Sea
from delfim.vehicle import console

ROOT = Path(__file__).parents[2]
NAMES = "otter", "heron", "wam-v", "blueboat"
STEERED = "skiff", pytest.param("bait-boat", marks=pytest.mark.long)
NOISE = "simulation.position_noise_m=1.0", "simulation.speed_noise_mps=0.05", "simulation.heading_noise_deg=2.0"


def vehicle(name: str, *more: str) -> config.Vehicle:
    return config.load(ROOT / f"etc/boats/{name}.toml", [*NOISE, "adopted.proven=false", *more])


class Tried:
    """A trial with a drawn boat; `says` answers each question."""

    def __init__(
        self,
        name: str,
        seed: int,
        place: Path,
        says: bool = True,
        settings: config.Vehicle | None = None,
        iron: CompassTable | None = None,
    ) -> None:
        self.settings = settings or vehicle(name)
        self.hidden, self.most_m, self.said = drawn(self.settings, seed), 0.0, list[str]()
        if iron is not None:
            self.hidden = self.hidden._replace(sensors=self.hidden.sensors._replace(iron=iron))
        self.boat = SimulatedTrial(self.settings, self.hidden, seed, RADIUS_M, self.look)
        self.progress = kept(place, self.settings)
        self.session = TrialSession(
            self.boat, self.settings, self.progress, place, RADIUS_M, lambda words: says, self.said.append
        )

    def look(self, boat: SimulatedTrial) -> None:
        north_m, east_m = boat.model.north_m - boat.middle_m[0], boat.model.east_m - boat.middle_m[1]
        self.most_m = max(self.most_m, math.hypot(north_m, east_m))

    @property
    def is_right(self) -> bool:
        found = self.progress.wiring
        return found is not None and is_right(found, self.hidden, self.settings.thrusters)


@pytest.fixture(
    scope="module",
    params=["otter", "heron", *(pytest.param(name, marks=pytest.mark.long) for name in ("wam-v", "blueboat")), *STEERED],
)
def tried(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Tried:
    """A trial of each boat, with its end."""
    its = Tried(request.param, 5 if request.param in NAMES else 6, tmp_path_factory.mktemp("tried") / "a.trial")
    assert its.session.run() == ""
    return its


def test_a_trial_finds_the_motors_and_makes_a_record_within_its_circle_and_its_time(tried: Tried) -> None:
    assert tried.is_right
    assert tried.most_m < 1.25 * RADIUS_M
    assert tried.session.trial.elapsed_s < 20.0 * 60.0
    assert (tried.boat.run.state.mode, tried.boat.run.state.actuation.run) == (Mode.IDLE, False)
    record = record_of(tried.progress, is_estimated=tried.settings.navigation.estimator)
    assert record.told.values.shape == (len(tried.progress.tape), 2)
    assert {"legs", "spins", "circles", "wiggle fast"} <= {each.name for each in record.manoeuvres}
    ahead = next(each for each in tried.progress.played if each.name == "bow first")
    told = zip(record.told.at_s, record.told.values, strict=True)
    pushed = [each for each in told if ahead.from_s + 1.5 < each[0] < ahead.to_s - 2.0]
    assert pushed
    steers = tried.settings.thrusters[0].steer is not None
    assert all(parts[0] > 0.05 if steers else min(parts) > 0.05 for _, parts in pushed), (
        "in the record ahead is positive, whatever the wiring"
    )


@pytest.mark.parametrize("tried", STEERED, indirect=True)
def test_a_boat_that_steers_is_found_whole(tried: Tried) -> None:
    """From her trial: speed, dead band, the angle at which she goes straight, and how quickly she turns."""
    settings = corrected_vehicle(tried.progress, tried.settings)
    record = record_of(tried.progress, is_estimated=settings.navigation.estimator)
    result = identify.identified(record, settings, "2026-11-28")
    assert result.fit.refusal == ""
    hidden, p, row = tried.hidden, result.fit.values, settings.thrusters[0]
    straight_rad = (-1.0 if hidden.turned else 1.0) * hidden.middle_rad
    assert math.degrees(p["straight"]) == pytest.approx(math.degrees(straight_rad), abs=1.0)
    assert p["dead_starboard"] == pytest.approx(hidden.rows[0].dead, abs=0.03)
    calm = LateModel(settings, rewired(hidden, (row,))._replace(sea=Sea()), 1)
    most_rad, figures = math.radians(row.steer.angle_max_deg), result.found.figures
    for words, angle_rad, seen in (
        ("full_mps", straight_rad, lambda: calm.surge_mps),
        ("turn_dps", straight_rad - 0.5 * most_rad, lambda: math.degrees(calm.yaw_rate_radps)),
    ):
        calm.push(row.name, 1.0 if words == "full_mps" else 0.5, angle_rad)
        calm.advance(60.0)
        assert figures[words].found == pytest.approx(seen(), rel=0.1)
    (keys,) = (each.value for each in result.found.keys if each.key == ("thrusters", row.name, "steer"))
    assert (("thrusters", row.name, "curve") in {each.key for each in result.found.keys}) == bool(row.curve)
    assert keys["middle_deg"] == pytest.approx(math.degrees(hidden.middle_rad), abs=1.0), "as her servo is told"


def corrected_vehicle(progress: TrialProgress, settings: config.Vehicle) -> config.Vehicle:
    """The settings with what the trial of the motors found."""
    rows = zip(progress.thrusters, corrected(progress.motors, progress.thrusters), strict=True)
    return msgspec.structs.replace(settings, thrusters=tuple(msgspec.structs.replace(row, **keys) for row, keys in rows))


def test_a_boat_that_goes_astern_by_its_compass_is_not_believed(tmp_path: Path) -> None:
    tried = Tried("otter", 2, tmp_path / "a.trial", says=False)
    assert tried.session.run().startswith("she goes astern when she is to go ahead, by the compass")
    assert kept(tmp_path / "a.trial", tried.settings).motors is None
    assert tried.boat.run.state.mode is Mode.IDLE


class Broken(Exception):
    pass


@pytest.mark.parametrize("at", ["motors", "legs"])
def test_what_is_interrupted_ends_in_idle_and_goes_on_where_it_was(
    at: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "a.trial"
    tried = Tried("heron", 4, place)
    played = SeaTrial.play

    def interrupted(self: SeaTrial, name: str, words: str, manoeuvre: Any) -> None:
        played(self, name, words, manoeuvre)
        if name == at:
            raise Broken

    with monkeypatch.context() as patch:
        patch.setattr(SeaTrial, "play", interrupted)
        with pytest.raises(Broken):
            tried.session.run()
    assert tried.boat.run.state.mode is Mode.IDLE
    seconds = tried.progress.tape[-1].at_s
    again = Tried("heron", 4, place)
    assert again.progress.is_proven is (at != "motors")
    with monkeypatch.context() as patch:
        if at == "motors":  # what follows them is gone on with in the other case
            patch.setattr(SeaTrial, "hull", lambda self, *told: None)
        assert again.session.run() == ""
    names = [each.name for each in again.progress.played]
    assert names.count("circles") == (at != "motors")
    assert names.count("proof") == 1
    times = [each.at_s for each in again.progress.tape]
    assert times == sorted(times)
    assert times[-1] > seconds + session.APART_S


def test_a_stop_of_anybody_ends_the_trial_and_nothing_goes_on(tmp_path: Path) -> None:
    tried = Tried("otter", 3, tmp_path / "a.trial")
    look = tried.look

    def stopped(boat: SimulatedTrial) -> None:
        look(boat)
        if 100.0 < boat.run.elapsed_s < 100.3:
            boat.run.command(console.Stop())

    tried.boat._look = stopped
    assert tried.session.run() == "operator"
    assert tried.boat.run.elapsed_s < 101.0
    assert not tried.boat.run.state.actuation.run


def test_a_boat_that_is_carried_off_ends_in_words_and_idle(tmp_path: Path) -> None:
    tried = Tried("otter", 3, tmp_path / "a.trial")
    tried.boat.model.current_north_mps = 1.5
    ended = tried.session.run()
    assert ended.startswith("trial ended: ")
    assert tried.boat.run.state.mode is Mode.IDLE
    assert not tried.boat.run.state.actuation.run


class Drifting:
    """The trial of the motors alone, in the strongest current and wind that are drawn, both the same way."""

    def __init__(self, name: str, seed: int, hull: int, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.settings = vehicle(name)
        self.hidden = drifting(drawn(self.settings, seed, hull))
        self.boat = SimulatedTrial(self.settings, self.hidden, seed, RADIUS_M)
        self.progress = TrialProgress(self.settings.thrusters)
        yes = lambda words: True  # noqa: E731
        self.session = TrialSession(self.boat, self.settings, self.progress, place, RADIUS_M, yes, lambda words: None)
        monkeypatch.setattr(SeaTrial, "hull", lambda self, *told: None)


@pytest.mark.parametrize(("name", "hull", "seed"), [("wam-v", 2, 1), ("wam-v", 6, 1), ("skiff", 102, 1)])
def test_a_boat_that_drifts_is_brought_back_before_the_proof(
    name: str, hull: int, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = Drifting(name, seed, hull, tmp_path / "a.trial", monkeypatch)
    assert tried.session.run() == ""
    assert tried.progress.is_proven
    assert tried.progress.wiring is not None
    assert is_right(tried.progress.wiring, tried.hidden, tried.settings.thrusters)
    back, proof = (next(each for each in tried.progress.played if each.name == its) for its in ("back", "proof"))
    far_m = {each.at_s: each.far_m for each in tried.progress.tape}
    assert far_m[back.from_s] > 30.0
    assert far_m[back.to_s] < 0.7 * far_m[back.from_s]
    assert proof.from_s >= back.to_s
    assert max(far_m.values()) < 1.25 * RADIUS_M


def test_a_boat_that_lies_where_it_began_is_not_brought_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = Drifting("otter", 2, 9, tmp_path / "a.trial", monkeypatch)
    tried.boat.model.current_north_mps = tried.boat.model.current_east_mps = 0.0
    assert tried.session.run() == ""
    assert tried.progress.is_proven
    assert "back" not in {each.name for each in tried.progress.played}


def test_a_boat_that_goes_away_by_what_was_found_is_stopped_a_little_beyond_the_edge(tmp_path: Path) -> None:
    tried = Tried("otter", 3, tmp_path / "a.trial")
    trial, its = tried.session.trial, tried.hidden
    ways = [-1 if is_back else 1 for is_back in its.reversed]
    sides = [(1 if row.y_m > 0.0 else -1) * (-1 if its.swapped else 1) for row in tried.settings.thrusters]
    trial.motors = MotorsFound(tuple(-side for side in sides), tuple(-way for way in ways), (0.12, 0.12))
    trial.drive(trial.mix(0.5, 0.0), 90.0, lambda seen: seen.far_m > 30.0)  # it heads well, and goes astern
    assert trial.seen.far_m > 30.0
    with pytest.raises(TrialEnded, match="she does not come back by what was found"):
        trial.back(is_proven=False)
    assert trial.seen.far_m < 1.25 * RADIUS_M


def test_a_proven_boat_ends_with_hold(tmp_path: Path) -> None:
    settings = vehicle("otter", "adopted.proven=true")
    tried = Tried("otter", 3, tmp_path / "a.trial", settings=settings)
    tried.progress.done = ("circles", "legs", "spins", "wiggle slow", "wiggle fast")
    assert tried.session.run() == ""
    assert tried.boat.run.state.mode is Mode.HOLD


def test_what_is_kept_of_another_boat_or_broken_is_not_gone_on_with(tmp_path: Path) -> None:
    place = tmp_path / "a.trial"
    tried = Tried("otter", 3, place)
    session.keep(place, tried.progress)
    assert kept(place, vehicle("heron")) == TrialProgress(vehicle("heron").thrusters)
    place.write_bytes(place.read_bytes()[:-5])
    assert kept(place, tried.settings) == TrialProgress(tried.settings.thrusters)


class Socket:
    """The local command socket of a boat in lock step."""

    def __init__(self, played: SimulatedTrial) -> None:
        self.played, self.words = played, list[str]()

    def ask(self, command: str, **words: Any) -> dict[str, Any]:
        self.words.append(command)
        line = {"command": command} | words
        if command != "state" and (why := self.played.run.command(console.asked(console.KINDS[command], **words))) is not None:
            raise Refused(why)
        self.played.run.cycle()
        told = self.played.run.vehicle.report()
        thrusters = {
            name: {"thrust": each.thrust, "rpm": each.rpm, "angle_deg": each.angle_deg} for name, each in told.thrusters.items()
        }
        keys = (
            "latitude_deg",
            "longitude_deg",
            "heading_deg",
            "turn_dps",
            "speed_mps",
            "course_deg",
            "mode",
            "reason",
            "run",
            "age_s",
            "heard",
        )
        return line | {key: getattr(told, key) for key in keys} | {"thrusters": thrusters}


def test_a_boat_that_runs_is_tried_over_its_command_socket(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    settings, seed = vehicle("otter"), 5
    hidden = drawn(settings, seed)
    played = SimulatedTrial(settings, hidden, seed, RADIUS_M)
    monkeypatch.setattr(boats.time, "monotonic", lambda: played.run.elapsed_s)
    monkeypatch.setattr(boats.time, "sleep", lambda seconds: None)
    link: Any = Socket(played)
    ended = list[bool]()
    boat = RunningTrial(link, settings.thrusters, RADIUS_M, lambda: bool(ended))
    progress = TrialProgress(settings.thrusters)
    trial = TrialSession(boat, settings, progress, tmp_path / "a.trial", RADIUS_M, lambda words: True, lambda words: None)
    with contextlib.suppress(TrialEnded):
        trial._motors()
    assert progress.wiring == (hidden.swapped, hidden.reversed, False, ())
    assert progress.is_proven
    ended.append(True)
    assert trial.run() == "the operator ended it"
    assert played.run.state.mode is Mode.IDLE
    assert boat.turn_alone("port").startswith("15% for 1 s, ")


def test_behind_an_estimator_the_record_has_what_the_sensors_said(tmp_path: Path) -> None:
    tried = Tried("blueboat", 3, tmp_path / "a.trial")
    tried.progress.done = ("legs", "spins", "wiggle slow", "wiggle fast")
    assert tried.session.run() == ""
    record = record_of(tried.progress, is_estimated=True)
    assert record.is_raw
    assert np.diff(record.velocity.at_s).min() > 0.15, "each value of the receiver once, five a second"
    bent = np.degrees(np.std(np.diff(np.unwrap(record.heading.values[:, 0]))))
    assert bent > 2.0, "with the noise of the compass, which the estimator takes away"
    shape = shape_of(record)
    assert math.degrees(shape.deviation_rad) == pytest.approx(math.degrees(tried.hidden.sensors.deviation_rad), abs=1.5)
    smoothed = record_of(
        msgspec.structs.replace(tried.progress, tape=[each._replace(measured=None) for each in tried.progress.tape]),
        is_estimated=True,
    )
    assert not smoothed.is_raw


def test_a_compass_that_is_much_bent_makes_quick_turns_slow(tmp_path: Path) -> None:
    tried = Tried("blueboat", 2, tmp_path / "a.trial", iron=CompassTable(hard_ahead=0.2, hard_aside=-0.19))
    assert tried.session.run() == ""
    assert "The boat's iron bends the compass by 1" in " ".join(tried.said)
    spins = next(each for each in tried.progress.played if each.name == "spins")
    rates = [abs(each.turn_radps) for each in tried.progress.tape if spins.from_s <= each.at_s <= spins.to_s]
    assert math.degrees(max(rates)) < 40.0


def test_a_hopeless_place_ends_the_trial_and_another_begins_with_the_circles(tmp_path: Path) -> None:
    tried = Tried("heron", 3, tmp_path / "a.trial")

    def near_a_pier(boat: SimulatedTrial) -> None:
        tried.look(boat)
        compass = boat.run.nodes.compasses[0]
        compass.cable_rad_per_a = 0.0
        pile = CompassTable(hard_ahead=0.012 * boat.model.north_m, hard_aside=0.012 * boat.model.east_m)
        compass.bent = HiddenSensors(pile).said

    tried.boat._look = near_a_pier
    assert tried.session.run().startswith("this place is magnetically hopeless: ")
    again = kept(tmp_path / "a.trial", tried.settings)
    assert again.is_proven
    assert "circles" not in again.done
    assert again.middle is None


def test_a_gyro_that_is_upside_down_is_told_before_anything_is_built_on_it(tmp_path: Path) -> None:
    tried = Tried("otter", 3, tmp_path / "a.trial")
    tried.boat.run.nodes.compasses[0].gyro_sign = -1.0
    assert tried.session.run().startswith("the gyro says port where the compass says starboard")
    assert tried.boat.run.state.mode is Mode.IDLE


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_no_wiring_is_told_wrong_whatever_the_hull(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """100 boats: inertia from a third to three times, coefficients 40 % off, dead band to 0.15, delay to 0.5 s, wind to 4 m/s,
    current to 0.3 m/s."""
    monkeypatch.setattr(SeaTrial, "hull", lambda self, *told: None)
    unanswered = 0
    for seed in range(1, 101):
        tried = Tried(name, seed, tmp_path / f"{seed}.trial")
        ended = tried.session.run()
        assert tried.is_right or tried.progress.motors is None, f"seed {seed}: told wrong: {tried.hidden.words()}"
        assert ended or tried.progress.is_proven
        assert tried.most_m < 1.25 * RADIUS_M + 10.0, seed
        unanswered += not tried.progress.is_proven
    assert unanswered <= 10
