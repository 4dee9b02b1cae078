"""`delfim identify` of boats with three and four fixed thrusters: logs of ordinary sailing, in lock step, of drawn hulls whose
motors are unequal.
"""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from delfim import config
from delfim.adoption import identify
from delfim.adoption.figures import sailed
from delfim.adoption.foretold import prior, pushes_of
from delfim.adoption.identify import Identified
from delfim.adoption.model import PLACE
from delfim.adoption.suited import place_of
from delfim.adoption.trial.hiddenhull import Hidden, HiddenSensors, LateModel, drawn, rewired
from delfim.adoption.writing import FoundKey
from delfim.logging.ashore.tree import files
from delfim.simulator.tables import Sea
from tests.adoption import voyages
from tests.adoption.test_several import ROOT, vehicle


class Voyage:
    """A voyage of a drawn boat whose motors are where her file says."""

    def __init__(self, name: str, seed: int, folder: Path) -> None:
        self.its, hidden = vehicle(name), drawn(vehicle(name), seed)
        wired = [
            msgspec.structs.replace(row, address=self.its.thrusters[hidden.places.index(at)].address)
            for at, row in enumerate(self.its.thrusters)
        ]
        rows = rewired(hidden, wired).rows
        straight = (False,) * len(rows)
        self.hidden: Hidden = hidden._replace(rows=rows, reversed=straight, places=(), sensors=HiddenSensors())
        told = msgspec.structs.replace(self.its, adopted=msgspec.structs.replace(self.its.adopted, proven=True))
        voyages.sail_legs(told, LateModel(told, self.hidden, seed), folder, seed)
        self.result: Identified = identify.of_log(files([folder]), self.its)
        self.keys: dict[tuple[str, ...], FoundKey] = {each.key: each for each in self.result.found.keys}

    def after(self, starboard: float, port: float) -> tuple[float, float]:
        """Speed ahead, m/s, and rate of turn, deg/s, of the true boat in calm water after a minute of these parts."""
        calm = LateModel(self.its, self.hidden._replace(sea=Sea()), 1)
        for row in self.its.thrusters:
            if way := place_of(row).way:
                calm.push(row.name, way * (starboard if place_of(row).side > 0 else port))
        for _ in range(1200):
            calm.advance(0.05)
        return calm.surge_mps, math.degrees(calm.yaw_rate_radps)


@pytest.mark.parametrize(
    ("name", "seed"),
    [("pairs", 1), ("pods", 1), *(pytest.param(*each, marks=pytest.mark.long) for each in (("bow-thruster", 2), ("float", 9)))],
)
def test_a_log_of_ordinary_sailing_tells_the_hull(name: str, seed: int, tmp_path: Path) -> None:
    voyage = Voyage(name, seed, tmp_path)
    assert voyage.result.fit.refusal == ""
    figures = voyage.result.found.figures
    assert figures["half_mps"].found == pytest.approx(voyage.after(0.5, 0.5)[0], rel=0.05)
    assert figures["turn_dps"].found == pytest.approx(voyage.after(0.3, 0.7)[1], rel=0.05)
    assert figures["spin_dps"].found == pytest.approx(voyage.after(-0.5, 0.5)[1], rel=0.06)
    lines = list(identify.told(voyage.result))
    assert any("unequal thrust of the motors at one side" in line for line in lines) == (name != "bow-thruster")
    assert any("her thrusters push across" in line for line in lines) == (name in ("float", "pods"))
    assert not any(key[0] == "compass" for key in voyage.keys)
    theta = voyage.result.fit.theta.copy()
    theta[PLACE["within_port"]] = -1.1
    refused = voyage.result.fit._replace(theta=theta).refusal
    assert refused.startswith("one of the two motors at port would be 3.0 times as strong as the other")


@pytest.mark.long
def test_the_stronger_one_of_two_at_a_side_is_looked_for_on_either_side(tmp_path: Path) -> None:
    voyage = Voyage("float", 11, tmp_path)
    figures = voyage.result.found.figures
    assert voyage.result.fit.refusal == ""
    assert figures["turn_dps"].found == pytest.approx(voyage.after(0.3, 0.7)[1], rel=0.05)
    assert figures["spin_dps"].found == pytest.approx(voyage.after(-0.5, 0.5)[1], rel=0.06)


@pytest.mark.long
def test_turns_that_were_never_so_quick_are_extrapolated_and_less_sure(tmp_path: Path) -> None:
    """A small boat with much power: her log has turns of 20 deg/s, and she can turn by 79."""
    voyage = Voyage("small pairs", 2, tmp_path)
    assert voyage.result.fit.refusal == ""
    turn, true_dps = voyage.result.found.figures["turn_dps"], voyage.after(0.3, 0.7)[1]
    assert abs(turn.found - true_dps) > 0.3 * true_dps, "else this tells nothing"
    assert turn.is_beyond
    assert abs(turn.found - true_dps) < 2.0 * turn.spread
    assert any(line.startswith("not seen: quick turns: she turned by ") for line in identify.told(voyage.result))


def test_two_at_a_side_that_would_be_too_unlike_are_not_believed(tmp_path: Path) -> None:
    refused = Voyage("float", 12, tmp_path).result.fit.refusal
    assert refused.startswith("one of the two motors at port would be 3.1 times as strong as the other")


def test_how_strong_a_bow_thruster_is_stands_beside_the_others(tmp_path: Path) -> None:
    voyage = Voyage("bow-thruster", 1, tmp_path)
    rows = {row.name: row.ends_n[1] for row in voyage.hidden.rows}
    real = rows["bow"] / math.sqrt(rows["starboard"] * rows["port"])
    strong = {name: voyage.keys["thrusters", name, "thrust_n"].value[1] for name in rows}
    assert strong["bow"] / math.sqrt(strong["starboard"] * strong["port"]) == pytest.approx(real, rel=0.12)
    assert real < 0.8 * 70.0 / 250.0, "it is weaker than her file says, or this tells nothing"
    assert any("push of what pushes aside, against the other motors" in each for each in voyage.result.found.changes)


@pytest.mark.parametrize("name", ["pairs", "bow-thruster"])
def test_motors_commanded_alike_at_a_side_do_as_one_there(name: str) -> None:
    its = vehicle(name)
    lanes = prior(its).centre[None].copy()
    lanes[:, PLACE["ahead_uneven"]], lanes[:, PLACE["loss"]] = 0.2, 0.05
    one, each = sailed(lanes), sailed(lanes, rows=pushes_of(its))
    for of in ("surge", "sway", "turn", "heading"):
        np.testing.assert_allclose(getattr(each, of), getattr(one, of), rtol=1e-9, atol=1e-12)


def test_one_that_pushes_to_port_turns_her_by_its_place() -> None:
    its = vehicle("bow-thruster")
    bow = pushes_of(its)[2]
    assert (bow.side, bow.aside) == (0, pytest.approx(1.0))
    assert bow.arm == pytest.approx(2.0 / 1.03)
    assert bow.shares == (pytest.approx(70.0 / 250.0), pytest.approx(70.0 / 250.0))
    to_port = msgspec.structs.replace(its.thrusters[2], angle_deg=-90.0)
    turned = pushes_of(msgspec.structs.replace(its, thrusters=(*its.thrusters[:2], to_port)))[2]
    assert (turned.aside, turned.arm) == (pytest.approx(-1.0), pytest.approx(-2.0 / 1.03))
    assert pushes_of(config.load(ROOT / "etc/boats/heron.toml")) == ()
