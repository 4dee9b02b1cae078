"""`delfim identify`: from the log of an ordinary voyage to figures, a report, and the keys of the vehicle's file."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from delfim import config
from delfim.__main__ import main
from delfim.adoption import identify
from delfim.adoption.found import bound
from delfim.adoption.identify import Identified
from delfim.base.errors import DelfimError
from delfim.commands.operation.log import _since as since_the_fetch
from delfim.logging.ashore.tree import files
from delfim.simulator.measured import MeasuredModel, model_of
from tests.adoption import hulls, voyages
from tests.adoption.hulls import Hidden, after, steady, stopping_m


class Sailed:
    """A voyage of the hidden Heron, and what came of it."""

    def __init__(self, place: Path) -> None:
        self.hidden, self.log = hulls.heron(), place / "log"
        self.file = voyages.file_of(self.hidden, place / "heron.toml")
        voyages.sail(self.hidden, self.file, self.log)
        self.result = identify.of_log(files([self.log]), config.load(self.file))


@pytest.fixture(scope="module")
def voyage(tmp_path_factory: pytest.TempPathFactory) -> Sailed:
    return Sailed(tmp_path_factory.mktemp("voyage"))


@pytest.fixture
def hidden(voyage: Sailed) -> Hidden:
    return voyage.hidden


@pytest.fixture
def result(voyage: Sailed) -> Identified:
    return voyage.result


def test_the_log_of_courses_and_speeds_tells_what_she_does(hidden: Hidden, result: Identified) -> None:
    found = {name: each.found for name, each in result.found.figures.items()}
    assert result.fit.refusal == ""
    assert found["half_mps"] == pytest.approx(after(hidden, 0.5, 0.5).surge_mps, rel=0.05)
    assert found["turn_dps"] == pytest.approx(math.degrees(after(hidden, 0.3, 0.7).yaw_rate_radps), rel=0.05)
    assert found["spin_dps"] == pytest.approx(math.degrees(after(hidden, -0.5, 0.5).yaw_rate_radps), rel=0.05)
    assert result.fit.values["delay"] + result.fit.values["lag"] == pytest.approx(hidden.late_s, abs=0.1)


def test_it_says_what_is_other_and_what_it_did_not_see(result: Identified) -> None:
    lines = list(identify.told(result))
    assert any(line.startswith("changed: push of the motors: 30% less than by the file") for line in lines)
    assert "not seen: thrust astern: the motors hardly ran astern" in lines
    assert any(line.startswith("not seen: full speed: she sailed 1.7 m/s at most") for line in lines)
    assert all(each.key[-1] != "full_mps" for each in result.found.keys)  # it is extrapolated


def test_the_fence_reckons_with_the_ways_that_were_measured(hidden: Hidden, result: Identified) -> None:
    keys = {each.key: each.value for each in result.found.keys}
    for part in (0.3, 0.6, 1.0):
        v = after(hidden, part, part).surge_mps
        reckoned = v * keys["fence", "reaction_s"] + v * v / (2.0 * keys["fence", "deceleration_mps2"])
        assert stopping_m(hidden, part) <= reckoned
        assert part == 1.0 or reckoned <= 2.0 * stopping_m(hidden, part)  # full speed is extrapolated: no less than by the file


@pytest.mark.parametrize(
    ("speeds", "ways"), [((0.5, 1.0, 2.0), (0.4, 1.2, 4.0)), ((0.3, 0.8, 1.5), (3.0, 8.0, 15.0)), ((1.0, 2.0), (0.2, 3.0))]
)
def test_the_line_of_the_fence_is_never_below_a_way(speeds: tuple[float, ...], ways: tuple[float, ...]) -> None:
    reaction_s, deceleration = bound(list(speeds), list(ways))
    for v, way in zip(speeds, ways, strict=True):
        assert way <= v * reaction_s + v * v / (2.0 * deceleration) + 1e-9


def test_the_file_has_all_of_it_and_the_twin_does_as_the_boat(voyage: Sailed, tmp_path: Path) -> None:
    file = tmp_path / "boat.toml"
    file.write_text(voyage.file.read_text())
    identify.write(voyage.result, file)
    text, written = file.read_text(), config.load(file)
    assert "; was [-27, 45]  # of the shop's page" in text
    assert "mass_kg = 30  # by the scales" in text
    assert text.startswith("# A boat for tests, as its owner wrote it.")
    assert written.adopted.log == voyage.result.record.digest
    assert written.adopted.chi2 == pytest.approx(voyage.result.fit.chi2, abs=0.01)
    for parts in ((0.5, 0.5), (0.3, 0.7)):
        true, its = after(voyage.hidden, *parts), steady(model_of(written, 1), parts)
        assert isinstance(its, MeasuredModel)
        assert its.surge_mps == pytest.approx(true.surge_mps, rel=0.08)
        assert its.yaw_rate_radps == pytest.approx(true.yaw_rate_radps, rel=0.05, abs=0.045)
    again = identify.of_log(files([voyage.log]), written)
    assert not again.found.changes, again.found.changes
    identify.write(again, file)
    assert file.read_text().count("; was ") > text.count("; was ")
    assert "; was [-27, 45]" not in file.read_text()  # the one value before stays, not all of them


def test_a_fit_that_is_refused_writes_nothing(voyage: Sailed, tmp_path: Path) -> None:
    file = tmp_path / "boat.toml"
    file.write_text(voyage.file.read_text())
    poor = voyage.result._replace(fit=voyage.result.fit._replace(chi2=2.4))
    with pytest.raises(DelfimError, match=r"not written: the motion does not follow from the commands: chi2 is 2\.4"):
        identify.write(poor, file)
    assert file.read_text() == voyage.file.read_text()


@pytest.mark.long
def test_the_command_prints_writes_its_report_and_the_file(
    voyage: Sailed, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, report = tmp_path / "boat.toml", tmp_path / "found.html"
    file.write_text(voyage.file.read_text())
    words = ["identify", str(voyage.log), "--vehicle", str(file), "--output", str(report)]
    assert main(words) == 0
    assert file.read_text() == voyage.file.read_text()
    assert main([*words, "--write"]) == 0
    out = capsys.readouterr().out
    assert "speed at 50 % of command" in out
    off = re.search(r"mission Square: the twin is ([0-9.]+) m off her track \(rms\), ([0-9.]+) m at most", out)
    assert off is not None
    assert float(off[2]) < 2.0
    assert config.load(file).boat.inertia_kgm2 == pytest.approx(5.0, rel=0.1)
    page = report.read_text()
    assert page.count("data:image/png;base64") == 6
    assert "The mission Square, and the twin in it" in page
    assert "What was not seen" in page
    assert "delfim identify" in page


@pytest.mark.long
@pytest.mark.parametrize("hull", [pytest.param(hulls.otter, id="otter"), pytest.param(hulls.heron, id="heron")])
def test_the_simulators_own_hull_is_found_to_be_the_files(tmp_path: Path, hull: Callable[[], Hidden]) -> None:
    file = voyages.file_of(hull(), tmp_path / "boat.toml")
    voyages.sail(None, file, tmp_path / "log")
    result = identify.of_log(files([tmp_path / "log"]), config.load(file))
    told, found = ({name: getattr(each, key) for name, each in result.found.figures.items()} for key in ("told", "found"))
    sailed = ("half_mps", "quarter_mps", "turn_dps", "turn_port_dps", "spin_dps", "stop_60_m")
    assert {name: found[name] for name in sailed} == pytest.approx({name: told[name] for name in sailed}, rel=0.1)
    model = steady(model_of(config.load(file), 1), (0.3, 0.7))
    assert told["turn_dps"] == pytest.approx(math.degrees(model.yaw_rate_radps), rel=0.03)
    assert not result.found.changes, result.found.changes


def test_another_boat_is_refused(voyage: Sailed) -> None:
    rows = [msgspec.structs.replace(row, name=f"{row.name}_x") for row in voyage.hidden.told.thrusters]
    other = msgspec.structs.replace(config.load(voyage.file), thrusters=tuple(rows))
    with pytest.raises(DelfimError, match="the record is of thrusters starboard, port, the file has starboard_x, port_x"):
        identify.of_log(files([voyage.log]), other)


def test_after_a_voyage_a_line_says_that_the_hull_is_fouled(
    voyage: Sailed, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, log = tmp_path / "boat.toml", tmp_path / "log"
    file.write_text(voyage.file.read_text())
    assert main(["identify", str(voyage.log), "--since"]) == 0
    assert capsys.readouterr().out.startswith("hull and motors: the vehicle's file has none that was measured")
    identify.write(voyage.result, file)
    its = voyage.hidden.coefficients
    fouled = voyage.hidden._replace(coefficients=its._replace(xu=1.8 * its.xu, xuu=1.8 * its.xuu))
    voyages.sail(fouled, file, log)
    since_the_fetch(log)
    line = capsys.readouterr().out
    assert line.startswith("hull and motors since 20")
    assert "% more than by the file: a fouled hull, or more draught?" in line
    assert line.count("\n") == 1
