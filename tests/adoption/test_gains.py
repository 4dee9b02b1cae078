"""Gains that are chosen on the twin, their margins, and the proof sail that must prove them."""

import math
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.adoption.trial import dialogue
from delfim.adoption.trial.dialogue import Dialogue
from delfim.adoption.trial.hiddenhull import Hidden, drawn, rewired
from delfim.adoption.trial.manoeuvres import TrialEnded
from delfim.adoption.trial.proof import ProofFigures, SimulatedProof, sail
from delfim.adoption.trial.session import TrialProgress, Written
from delfim.adoption.twin import gains
from delfim.adoption.twin.child import in_child
from delfim.adoption.twin.gains import AT_CRUISE, AT_REST, ChosenGains
from delfim.adoption.twin.margins import Loop
from delfim.adoption.twin.twinvoyage import TwinVoyage, VoyageTurn
from delfim.adoption.writing import changed, put_back
from delfim.base.errors import DelfimError
from delfim.base.modes import Mode
from delfim.parts.traffic.watchkeeper import caution
from delfim.simulator.measured import model_of
from delfim.survey.planning import RUN_IN_M, wanted_of
from delfim.vehicle.control.memory import settings_of
from tests.adoption.hulls import HERON

ROOT = Path(__file__).parents[2]
FOUND = [
    *(f"simulation.hull.{name}={value}" for name, value in HERON.items()),
    *("boat.inertia_kgm2=9.0", "boat.yaw_nm_per_radps=7.5", "boat.yaw_nm_per_radps2=3.0", 'adopted.on="2026-11-27"'),
]


def told(*more: str) -> config.Vehicle:
    """The Heron's file with motors that are 0.4 s late, and more."""
    file = config.load(ROOT / "etc/boats/heron.toml", more)
    rows = tuple(msgspec.structs.replace(row, delay_s=0.4, lag_s=0.15) for row in file.thrusters)
    return msgspec.structs.replace(file, thrusters=rows)


@pytest.fixture(scope="module")
def choice() -> ChosenGains:
    """Of some of the candidates."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gains, "SAILED", 2)
        patch.setattr(gains, "LOOKS_S", ())
        return gains.chosen(told(), told(*FOUND), 1.0)


@pytest.mark.parametrize("dead_s", [0.2, 0.5])
def test_margins_are_those_of_a_loop_that_can_be_solved(dead_s: float) -> None:
    """1 / s with a dead time: it crosses at 1 rad/s, and its phase is 180 deg where the dead time alone has 90."""
    loop = Loop(p=1.0, i=0.0, d=0.0, mass=1.0, damping=0.0, lag_s=1e-9, dead_s=dead_s, poles=1)
    phase_deg, gain = loop.margins
    assert phase_deg == pytest.approx(90.0 - math.degrees(dead_s), abs=1.0)
    assert gain == pytest.approx(0.5 * math.pi / dead_s, rel=0.05)


def test_an_integral_costs_phase_and_too_much_gain_has_no_margin() -> None:
    loop = Loop(p=1.0, i=0.0, d=1.5, mass=1.0, damping=0.5, lag_s=0.1, dead_s=0.2, poles=2)
    assert loop._replace(i=0.1).margins.phase_deg < loop.margins.phase_deg < 90.0
    assert not loop._replace(p=60.0, d=90.0).margins.holds((0.0, 1.0))


@pytest.mark.long
def test_the_chosen_gains_have_the_margins_and_are_no_worse_than_todays() -> None:
    choice = gains.chosen(told(), told(*FOUND), 1.0)
    best = choice.best
    assert best.is_steady
    assert best.at_rest.holds(AT_REST)
    assert best.at_cruise.holds(AT_CRUISE)
    assert best.cost <= choice.today.cost or not choice.today.is_steady
    assert all(each.over_deg <= 4.0 for each in best.voyages)
    assert best.voyages[0].quarter.settled_s <= 10.0
    assert all(each.is_done for each in best.voyages)
    assert {each.name for each in choice.tried} >= {"today's", "by the hull"}


def test_the_boat_asks_for_no_more_than_it_can(choice: ChosenGains) -> None:
    keys, hull = {each.key: each.value for each in choice.keys}, gains.twin_hull(told(*FOUND))
    assert keys["control", "speed", "cruise_mps"] <= 0.66 * hull.full_mps
    assert keys["control", "hold", "radius_m"] == 2.5  # of a receiver of 1 m
    assert choice.best.keys["control", "speed", "max_mps"] <= 0.86 * hull.full_mps
    adopted = gains.with_keys(told(*FOUND), choice.best.keys)
    limits = caution(adopted, settings_of(adopted))
    model = model_of(adopted, 1)
    for row in adopted.thrusters:
        model.push(row.name, -math.copysign(1.0, row.y_m))
    model.advance(30.0)
    assert limits.turn_radps <= abs(model.yaw_rate_radps)


def test_a_voyage_off_its_speed_costs_what_one_off_its_lines_does() -> None:
    """She swings about her course, and is slower for it: the lines alone do not tell."""
    turn = VoyageTurn(over_deg=1.0, settled_s=6.0, told_over_deg=1.5, told_s=6.5)
    sailed = TwinVoyage(1.0, 9.0, turn, 0.8, 2.0, 0.06, 0.2, is_done=True, turn_s=5.0, run_in_m=5.0)
    assert sailed._replace(speed_off=0.31).cost == pytest.approx(sailed.cost + 2.5)
    assert sailed._replace(path_m=1.8).cost == pytest.approx(sailed.cost + 2.5)


def test_motors_that_are_a_little_later_make_the_speed_a_little_slower() -> None:
    def loop(delay_s: float) -> tuple[float, float]:
        file = told(*FOUND)
        rows = tuple(msgspec.structs.replace(row, delay_s=delay_s) for row in file.thrusters)
        late = msgspec.structs.replace(file, thrusters=rows)
        keys = gains._common(late, gains.twin_hull(late), 1.0)
        return keys["control", "speed", "p_n_per_mps"], keys["control", "speed", "i_n_per_m"]

    found = [loop(0.4 + 0.01 * step) for step in range(11)]
    for (p, i), (later_p, later_i) in pairwise(found):
        assert 0.95 * p <= later_p <= p
        assert 0.9 * i <= later_i <= i
    assert found[-1] < found[0]


def test_a_file_without_a_twin_has_no_gains_to_choose() -> None:
    with pytest.raises(DelfimError, match=r"gains follow from \[simulation.hull\], which this file has not"):
        gains.twin_hull(told())


def test_a_slippery_hull_is_slow_to_stop_for_the_guard_too() -> None:
    """What was measured counts in a file that says when; in another one everything is as ever."""
    slippery = "fence.reaction_s=9.0", "fence.deceleration_mps2=10.0", "control.speed.cruise_mps=0.8"
    file = told(*slippery)
    assert caution(file, settings_of(file)).ramp_mps2 == file.control.speed.ramp_mps2
    measured = told(*slippery, *FOUND)
    assert caution(measured, settings_of(measured)).ramp_mps2 == pytest.approx(0.8 / (2.0 * 9.04), rel=0.01)


def test_a_survey_turns_as_the_boat_was_found_to() -> None:
    file, found = told(), told("adopted.turn_s=7.5", "adopted.run_in_m=21.0")
    assert wanted_of(file, spacing_m=10.0).run_in_m == RUN_IN_M
    wanted = wanted_of(found, spacing_m=10.0)
    assert (wanted.turn_s, wanted.run_in_m) == (7.5, 21.0)


def test_the_gains_before_come_back_into_the_file() -> None:
    text = (ROOT / "etc/boats/heron.toml").read_text() + "\n[control.hold]\nradius_m = 4.0  # by feel\nspeed_mps = 0.8\n"
    keys = ("control", "hold", "radius_m"), ("control", "heading", "p_nm_per_rad"), ("control", "hold", "speed_mps")
    new = changed(text, {keys[0]: (2.5, "found 2026-11-27"), keys[1]: (3.4, "found 2026-11-27")}, "a file")
    assert "radius_m = 2.5  # found 2026-11-27; was 4.0  # by feel" in new
    before = put_back(new, keys, "a file")
    assert before == text + "\n[control.heading]\n"
    by_hand = new.replace("p_nm_per_rad = 3.4  # found 2026-11-27", "p_nm_per_rad = 3.0")
    assert "p_nm_per_rad = 3.0" in put_back(by_hand, keys, "a file")


def _added(first: int, second: int, tell: gains.Tell) -> int:
    tell(f"{first} and {second}")
    if second == 0:
        raise DelfimError("nothing to add")
    return first + second


def test_a_process_of_its_own_tells_returns_and_refuses() -> None:
    said = list[str]()
    assert in_child(_added, 2, 3, tell=said.append) == 5
    assert said == ["2 and 3"]
    with pytest.raises(DelfimError, match="nothing to add"):
        in_child(_added, 2, 0, tell=said.append)


class Adopted:
    """A boat whose trial is written, and her file."""

    def __init__(self, place: Path, choice: ChosenGains) -> None:
        self.file = place / "heron.toml"
        text = (ROOT / "etc/boats/heron.toml").read_text()
        keys = {each.key: (each.value, "found 2026-11-27") for each in choice.keys}
        keys |= {("simulation", "hull", name): (value, "found 2026-11-27") for name, value in HERON.items()}
        for row in ("starboard", "port"):
            keys |= {("thrusters", row, "delay_s"): (0.4, "found 2026-11-27"), ("thrusters", row, "lag_s"): (0.15, "found")}
        self.file.write_text(changed(text, keys, "heron.toml"))
        self.settings = config.load(self.file)
        written = Written("2026-11-27", self.settings.thrusters, tuple(each.key for each in choice.keys))
        self.progress = TrialProgress(self.settings.thrusters, is_proven=True, written=written)

    def prove(self, boat: SimulatedProof) -> int:
        person = Dialogue(is_yes=True)
        return dialogue.proof(self.progress, self.file.with_suffix(".trial"), str(self.file), boat, 60.0, person)


def twin(settings: config.Vehicle, later_s: float = 0.0) -> SimulatedProof:
    from delfim.simulator.lockstep import Lockstep
    from delfim.vehicle.state import NoLog

    rows = tuple(msgspec.structs.replace(row, delay_s=row.delay_s + later_s) for row in settings.thrusters)
    true = msgspec.structs.replace(settings, thrusters=rows)
    return SimulatedProof(Lockstep(settings, 5, lambda clock: NoLog(), model_of(true, 5)))


def test_a_boat_that_does_as_its_twin_is_proven(tmp_path: Path, choice: ChosenGains) -> None:
    boat = Adopted(tmp_path, choice)
    before = boat.file.read_text()
    assert boat.prove(twin(boat.settings)) == 0
    assert boat.progress.written is not None
    assert boat.progress.written.proof == "proven"
    assert boat.file.read_text() == before


def test_a_boat_that_does_worse_has_its_gains_before(
    tmp_path: Path, choice: ChosenGains, capsys: pytest.CaptureFixture[str]
) -> None:
    boat = Adopted(tmp_path, choice)
    assert boat.prove(twin(boat.settings, later_s=1.0)) == 1
    now = config.load(boat.file)
    assert now.control == config.load(ROOT / "etc/boats/heron.toml").control
    assert now.table("simulation").hull.mass_kg == HERON["mass_kg"]
    assert "Not proven: she " in capsys.readouterr().out
    assert boat.progress.written is not None
    assert boat.progress.written.proof.startswith("not proven: she ")


def test_only_worse_is_not_proven() -> None:
    foretold = ProofFigures(3.0, 8.0, 4.0, 1.5)
    assert ProofFigures(0.0, 3.0, 1.0, 0.2).worse(foretold) == []
    assert ProofFigures(5.9, 9.9, 4.9, 1.9).worse(foretold) == []
    assert len(ProofFigures(6.1, 10.1, 5.1, 2.1).worse(foretold)) == 4


def test_the_proof_sail_ends_at_the_edge_of_the_circle_with_hold(choice: ChosenGains) -> None:
    boat = twin(gains.with_keys(told(*FOUND), choice.best.keys))
    with pytest.raises(TrialEnded, match=r"edge of the circle, 8 m from its middle; she holds"):
        sail(boat, 1.0, 8.0)
    assert boat._run.state.mode is Mode.HOLD


def test_a_boat_whose_file_was_corrected_reaches_the_motor_at_each_side() -> None:
    file = told()
    for seed in range(1, 9):
        hidden: Hidden = drawn(file, seed)
        true = rewired(hidden, file.thrusters)
        for row, motor in zip(file.thrusters, true.rows, strict=True):
            was = next(each for each in hidden.rows if each.y_m == motor.y_m)
            assert (row.name, row.y_m > 0.0, motor.angle_deg) == (motor.name, motor.y_m > 0.0, 0.0)
            assert sorted(abs(end) for end in motor.thrust_n) == sorted(abs(end) for end in was.thrust_n)
            assert motor.thrust_n[1] > -motor.thrust_n[0]
