"""Which of three or four fixed motors is where, and which way each pushes: boats that are played, and trials in lock step."""

import math
from collections.abc import Sequence
from itertools import permutations, product
from pathlib import Path
from random import Random
from typing import Any

import msgspec
import pytest

from bench.layouts import LAYOUTS
from delfim import config
from delfim.adoption import identify
from delfim.adoption.record import NOTHING, TRIAL, BoatRecord
from delfim.adoption.suited import at_side, place_of, unfit
from delfim.adoption.trial import several
from delfim.adoption.trial.boats import SimulatedTrial
from delfim.adoption.trial.concluding import conclude
from delfim.adoption.trial.hiddenhull import drawn, rewired
from delfim.adoption.trial.manoeuvres import TrialEnded
from delfim.adoption.trial.motors import Doublet, DriftNoise, MotorsFound, Response, Sample, as_corrected, corrected, wiring
from delfim.adoption.trial.session import TrialProgress, TrialSession, keep, kept
from delfim.adoption.trial.taped import record_of
from delfim.base import tables
from delfim.base.errors import DelfimError
from delfim.campaign.adopted.truth import is_right, truth
from delfim.config import ThrusterTable
from tests.adoption.test_motors import asked

ROOT = Path(__file__).parents[2]
QUIET = DriftNoise(0.0, 0.0)
NOISE = "simulation.position_noise_m=1.0", "simulation.speed_noise_mps=0.05", "simulation.heading_noise_deg=2.0"
Rows = tuple[ThrusterTable, ...]


def vehicle(name: str) -> config.Vehicle:
    layout = LAYOUTS[name]
    return config.load(ROOT / f"etc/boats/{layout.boat}.toml", [*NOISE, "adopted.proven=false", *layout.told])


def boat(rows: Rows, places: Sequence[int], signs: Sequence[int], strong: Sequence[float] = (1.0,) * 4) -> Any:
    """A boat that moves as the places of its motors say, beyond a dead band; she goes half as easily aside."""
    every = [place_of(rows[at]) for at in places]
    arm_m, most_n = max(abs(its.turn_m) for its in every), max(row.ends_n[1] for row in rows)

    def answer(asked: Doublet) -> Response:
        pushes = [
            math.copysign(max(abs(part) - 0.1, 0.0), part) * sign * more * rows[at].ends_n[1] / most_n
            for part, sign, at, more in zip(asked.parts, signs, places, strong, strict=False)
        ]
        turn, ahead, aside = (sum(push * its[axis] for push, its in zip(pushes, every, strict=True)) for axis in range(3))
        return Response(turn / arm_m, 2.0 * ahead, 1.0 * aside)

    return answer


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_order_is_found_and_proven_and_those_that_do_the_same_keep_theirs(name: str) -> None:
    rows, draw = vehicle(name).thrusters, Random(name)
    kinds, identity = several.kinds_of(rows), tuple(range(len(rows)))
    for places in permutations(identity):
        signs = tuple(draw.choice((1, -1)) for _ in rows)
        strong = [draw.uniform(0.8, 1.2) for _ in rows]
        found, said = asked(several.finding(rows, 1.5, QUIET), boat(rows, places, signs, strong))
        assert isinstance(found, MotorsFound), (places, signs, found)
        assert [kinds[at] for at in found.places] == [kinds[at] for at in places]
        assert found.signs == signs
        moved = sum(at != row for row, at in enumerate(found.places))
        assert moved <= sum(at != row for row, at in enumerate(places)), "no motor is moved that need not be"
        assert max(abs(part) for each in said for part in each.parts) <= 0.65
        assert asked(several.proving(found, rows, 1.5, QUIET), boat(rows, places, signs, strong))[0] == ""
        other = boat(rows, places, [-sign for sign in signs], strong)
        assert asked(several.proving(found, rows, 1.5, QUIET), other)[0].startswith("she turns to port")


@pytest.mark.parametrize("name", LAYOUTS)
def test_what_was_found_pushes_ahead_and_turns_to_starboard_by_the_rows_of_the_file(name: str) -> None:
    rows = vehicle(name).thrusters
    for places, signs in zip(permutations(range(len(rows))), product((1, -1), repeat=len(rows)), strict=False):
        found = MotorsFound(tuple(place_of(rows[at]).side for at in places), signs, (0.2,) * len(rows), places)
        answer = boat(rows, places, signs)
        ahead = answer(Doublet(several.mix(found, rows, 0.5, 0.0), 2.0, ()))
        assert ahead == pytest.approx((0.0, ahead.ahead_mps, 0.0), abs=1e-9)
        assert ahead.ahead_mps > 0.5
        turn = answer(Doublet(several.mix(found, rows, 0.0, 0.5), 2.0, ()))
        assert turn.turn_radps > 0.2
        told = several.mix(found, rows, 0.4, 0.2)
        straight = as_corrected(found, rows, told)
        for side in (1, -1):
            its = [straight[at] * place_of(rows[at]).way for at in at_side(rows, side)]
            assert len(set(its)) == 1, "those at a side alike"
            assert its[0] > 0.0
        again = tuple(msgspec.structs.replace(row, **keys) for row, keys in zip(rows, corrected(found, rows), strict=True))
        for at, row in enumerate(places):
            assert (again[row].address, again[row].driver) == (rows[at].address, rows[at].driver)
            assert again[row].reversed == (rows[at].reversed != (signs[at] < 0))
            assert (again[row].name, again[row].x_m, again[row].y_m) == (rows[row].name, rows[row].x_m, rows[row].y_m)


def test_what_differs_is_said_in_words() -> None:
    rows = vehicle("bow-thruster").thrusters
    wired = wiring(MotorsFound((1, -1, -1), (1, -1, 1), (0.2,) * 3, (0, 2, 1)), rows)
    assert wired.words(rows) == [
        "The motor that port reaches is that of bow.",
        "The motor that bow reaches is that of port.",
        "The motor that port reaches is reversed.",
    ]


@pytest.mark.parametrize("name", LAYOUTS)
def test_two_rows_that_reach_one_motor_are_no_clear_answer(name: str) -> None:
    rows = vehicle(name).thrusters
    kinds = several.kinds_of(rows)
    for twice, lost in list(permutations(range(len(rows)), 2))[:: 1 if len(rows) == 3 else 5]:
        if kinds[twice] != kinds[lost]:
            places = [twice if at == lost else at for at in range(len(rows))]
            found, _ = asked(several.finding(rows, 1.5, QUIET), boat(rows, places, (1,) * len(rows)))
            assert isinstance(found, str), (name, places, found)
            assert found.endswith("no clear answer")


def test_a_motor_that_turns_nothing_is_no_clear_answer() -> None:
    rows = vehicle("float").thrusters
    found, said = asked(several.finding(rows, 1.5, QUIET), boat(rows, range(4), (1,) * 4, (1.0, 0.0, 1.0, 1.0)))
    assert found == "motor 2 of the file: she does not move beyond doubt, up to 90%: no clear answer"
    assert max(abs(part) for each in said for part in each.parts) == 0.9


def test_an_antenna_off_the_middle_and_a_compass_askew_exchange_no_motors() -> None:
    rows = vehicle("pods").thrusters
    for places in permutations(range(4)):
        answers = boat(rows, places, (1, -1, 1, 1), (1.2, 0.8, 1.1, 0.9))

        def seen(doublet: Doublet, answers: Any = answers) -> Response:
            turn, ahead, aside = answers(doublet)
            aside, ahead = aside + 1.2 * turn, ahead - 0.4 * turn
            c, s = math.cos(0.35), math.sin(0.35)
            return Response(turn, ahead * c + aside * s, aside * c - ahead * s)

        found, _ = asked(several.finding(rows, 4.9, QUIET), seen)
        assert not isinstance(found, MotorsFound) or found.places == places, "a wrong one is never told"
        assert isinstance(found, MotorsFound), found


def test_a_current_falls_out_of_an_answer_however_she_turns() -> None:
    """She turns by a quarter as she goes ahead and comes back; a current of 0.5 m/s goes on."""

    def at(at_s: float) -> Sample:
        gone = min(max(at_s - 0.4, 0.0), 2.0) - min(max(at_s - 2.4, 0.0), 2.0)
        heading = 0.4 * gone
        north, east = 0.3 * gone * math.cos(heading), 0.3 * gone * math.sin(heading)
        return Sample(at_s, 0.0, 0.0, north + 0.4, east - 0.3, heading)

    found = several.response([at(0.1 * i) for i in range(60)], 0.0, 2.0)
    assert (found.ahead_mps, found.aside_mps) == (pytest.approx(1.1, abs=0.15), pytest.approx(0.0, abs=0.05))


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({2: {"y_m": 0.0}}, "stern_starboard hardly turns the boat by itself"),
        ({0: {"angle_deg": -45.0}}, "its thrusters at starboard push her aside as they push ahead"),
        ({at: {"angle_deg": 90.0} for at in range(4)}, "none of its thrusters pushes ahead at starboard"),
        ({3: {"steer": config.Steer(kind="azimuth")}}, "stern_port turns; of 4 thrusters those are found that are fixed"),
    ],
)
def test_what_cannot_be_found_is_said_by_name(told: dict[int, Any], words: str) -> None:
    rows = vehicle("pairs").thrusters
    assert unfit(rows) == ""
    other = tuple(msgspec.structs.replace(row, **told.get(at, {})) for at, row in enumerate(rows))
    assert unfit(other).startswith(words)
    assert unfit((*rows, rows[0])) == "it has 5 thrusters; 4 are found at most"


class Tried:
    """The trial of a drawn boat."""

    def __init__(self, name: str, seed: int, folder: Path, hull: int | None = None) -> None:
        self.settings = vehicle(name)
        self.hidden, self.place, self.said = drawn(self.settings, seed, hull), folder / "a.trial", list[str]()
        self.boat = SimulatedTrial(self.settings, self.hidden, seed, 60.0)
        self.progress = TrialProgress(self.settings.thrusters)
        self.session = TrialSession(
            self.boat, self.settings, self.progress, self.place, 60.0, lambda words: True, self.said.append
        )


@pytest.mark.parametrize("name", [pytest.param("float", marks=pytest.mark.long), "pods"])
def test_a_boat_whose_thrusters_push_across_has_her_motors_found_and_keeps_her_hull(name: str, tmp_path: Path) -> None:
    tried = Tried(name, 3, tmp_path)
    assert tried.session.run() == ""
    found = tried.progress.wiring
    assert found is not None
    assert is_right(found, tried.hidden, tried.settings.thrusters)
    assert not is_right(found._replace(places=(*found.places[1:], found.places[0])), tried.hidden, tried.settings.thrusters)
    assert (tried.progress.is_whole, tried.progress.done) == (True, ())
    assert tried.session.trial.elapsed_s < 300.0
    assert kept(tried.place, tried.settings).is_whole
    file = tmp_path / "boat.toml"
    layout = LAYOUTS[name]
    file.write_text(text_of(layout), encoding="utf-8")
    said = list[str]()
    assert conclude(tried.progress, file, file.with_suffix(".html"), "2026-11-29", lambda words: True, said.append) == ""
    assert said[-1].startswith("Hull, compass and gains stay as they are: her thrusters push across")
    written = config.load(file)
    assert written.adopted.proven
    wired = {row.address: row for row in written.thrusters}
    for row, its, place in zip(tried.settings.thrusters, tried.hidden.rows, tried.hidden.places, strict=True):
        reached, there = wired[row.address], tried.settings.thrusters[place]
        assert (reached.name, reached.reversed) == (
            there.name,
            abs(math.remainder(its.angle_deg - there.angle_deg, 360.0)) > 90.0,
        )


@pytest.mark.parametrize(("name", "hull"), [("pods", 259), pytest.param("float", 250, marks=pytest.mark.long)])
def test_a_boat_that_the_current_carries_off_is_brought_back_before_the_proof(name: str, hull: int, tmp_path: Path) -> None:
    """The one was carried to the edge; the other is quick, and turned on the spot with what steers a large one."""
    tried = Tried(name, 1, tmp_path, hull)
    assert tried.session.run() == ""
    assert tried.progress.is_proven
    found = tried.progress.wiring
    assert found is not None
    assert is_right(found, tried.hidden, tried.settings.thrusters)
    back, proof = (next(each for each in tried.progress.played if each.name == its) for its in ("back", "proof"))
    far_m = {each.at_s: each.far_m for each in tried.progress.tape}
    assert far_m[back.from_s] > 30.0
    assert far_m[back.to_s] < 0.7 * far_m[back.from_s]
    assert proof.from_s >= back.to_s


def test_one_that_goes_away_by_what_was_found_is_stopped_a_little_beyond_the_edge(tmp_path: Path) -> None:
    tried = Tried("pairs", 1, tmp_path)
    mirrored, signs = (1, 0, 3, 2), [-1 if is_back else 1 for is_back in tried.hidden.reversed]
    places = tuple(mirrored[at] for at in tried.hidden.places)
    sides = tuple(place_of(tried.settings.thrusters[at]).side for at in places)
    trial = tried.session.trial
    trial.motors = MotorsFound(sides, tuple(-sign for sign in signs), (0.12,) * 4, places)  # it heads well, and goes astern
    trial.drive(trial.mix(0.5, 0.0), 60.0, lambda seen: seen.far_m > 30.0)
    assert trial.seen.far_m > 30.0
    with pytest.raises(TrialEnded, match="she does not come back by what was found"):
        trial.back(is_proven=False)
    assert trial.seen.far_m < 1.25 * 60.0


def text_of(layout: Any) -> str:
    """The file of a layout as text, with rows of their own."""
    tree = config.read_toml(ROOT / f"etc/boats/{layout.boat}.toml", list(layout.told))
    tree["simulation"].pop("mission", None)
    return tables.text_of(tree | {"adopted": {"proven": False}})


@pytest.mark.long
@pytest.mark.parametrize("name", ["pairs", "bow-thruster"])
def test_a_boat_with_motors_at_both_sides_is_found_whole(name: str, tmp_path: Path) -> None:
    tried = Tried(name, 2, tmp_path)
    assert tried.session.run() == ""
    rows = tried.settings.thrusters
    assert tried.progress.motors is not None
    owner = msgspec.structs.replace(
        tried.settings,
        thrusters=tuple(
            msgspec.structs.replace(row, **keys) for row, keys in zip(rows, corrected(tried.progress.motors, rows), strict=True)
        ),
    )
    record = record_of(tried.progress, is_estimated=owner.navigation.estimator)
    assert record.told.values.shape[1] == len(rows)
    result = identify.identified(record, owner, "2026-11-29")
    assert result.fit.refusal == ""
    real = truth(tried.settings, tried.hidden)
    assert result.found.figures["full_mps"].found == pytest.approx(real.full_mps, rel=0.05)
    true = rewired(tried.hidden, owner.thrusters)
    keys = {each.key: each.value for each in result.found.keys}
    for side in (1, -1):
        its = at_side(rows, side)
        strong_n = sum(keys["thrusters", rows[at].name, "thrust_n"][1] for at in its)
        of_mass = strong_n / sum(true.rows[at].ends_n[1] for at in its)
        assert of_mass == pytest.approx(1.0, rel=0.3), "the file's mass is kept, the true one is another"
        assert all(keys["thrusters", rows[at].name, "dead"] == pytest.approx(true.rows[at].dead, abs=0.03) for at in its)
    assert ("thrusters", "bow", "thrust_n") not in keys, "who pushes aside alone is not in the fit"


def test_a_trial_of_thrusters_set_across_tells_nothing_of_the_hull() -> None:
    its = vehicle("float")
    record = BoatRecord(tuple(row.name for row in its.thrusters), *(NOTHING,) * 5, source=TRIAL)
    with pytest.raises(DelfimError, match="the hull of this boat cannot be identified: her thrusters push across"):
        identify.identified(record, its, "2026-11-29")
    with pytest.raises(DelfimError, match="the record has no commands"):
        identify.identified(record._replace(source="state log of Float, 1 files"), its, "2026-11-29")


def test_a_kept_trial_whose_places_are_none_is_begun_afresh(tmp_path: Path) -> None:
    its, place = vehicle("pairs"), tmp_path / "a.trial"
    motors = MotorsFound((1, -1, 1, -1), (1, 1, 1, 1), (0.2,) * 4, (0, 1, 2, 3))
    keep(place, TrialProgress(its.thrusters, motors=motors, is_proven=True))
    assert kept(place, its).is_proven
    for places in ((), (0, 1, 2, 2), (0, 1, 2)):
        keep(place, TrialProgress(its.thrusters, motors=motors._replace(places=places), is_proven=True))
        assert not kept(place, its).is_proven
