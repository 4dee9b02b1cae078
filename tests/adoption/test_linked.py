"""A trial as the console's page has it: over a link that tells what MAVLink tells, on boats that are not as their files say."""

import math
from pathlib import Path
from typing import Any

import pytest

from bench.layouts import LAYOUTS
from delfim import config
from delfim.adoption.trial.boats import SimulatedTrial
from delfim.adoption.trial.hiddenhull import Hidden, drawn, rewired
from delfim.adoption.trial.linked import BoatHeard, GatewayWire, tried
from delfim.adoption.trial.manoeuvres import TrialEnded
from delfim.adoption.trial.session import kept
from delfim.base import geodesy
from delfim.base.errors import DelfimError
from delfim.base.modes import Mode
from delfim.campaign.adopted.truth import is_right
from delfim.console.gateway import adopting
from delfim.parts.mavlink.telemetry import TelemetryView, sensed, thrust
from delfim.vehicle import console
from tests.adoption.test_several import text_of

ROOT = Path(__file__).parents[2]
NOISE = "simulation.position_noise_m=1.0", "simulation.speed_noise_mps=0.05", "simulation.heading_noise_deg=2.0"
SEED = 5


class Link(GatewayWire):
    """A gateway and a boat in lock step: a cycle for each word that is heard of it. Orders that are not answered take effect
    with the next word, as on a link."""

    def __init__(
        self, settings: config.Vehicle, seed: int, ends_at: str = "", no: str = "", hidden: Hidden | None = None
    ) -> None:
        self.hidden = hidden or drawn(settings, seed)
        self.boat, self.digest = SimulatedTrial(settings, self.hidden, seed, 60.0), settings.sails_by
        self.said, self.ended, self._refused = list[dict[str, Any]](), "", ""
        self.steers = settings.thrusters[0].steer is not None
        self._ends_at, self._no, self._last = ends_at, no, {}
        self.is_old = False  # her program is of before thrusters were told one by one

    def say(self, **words: Any) -> None:
        self.said.append(words)
        if order := words.get("order"):
            self._refused = self.boat.run.command(console.Try(**order)) or ""
        if steer := words.get("steer"):
            command = console.KINDS[steer["command"]]
            told = {key: value for key, value in steer.items() if key != "command"}
            self._refused = self.boat.run.command(console.asked(command, **told)) or ""
        if mode := words.get("end"):
            self.boat.end(mode)
        if self._ends_at and words.get("step", {}).get("name") == self._ends_at:
            self.ended = "STOP"
            self.boat.end("idle")

    def newest(self) -> BoatHeard:
        if self.ended:
            raise TrialEnded(self.ended)
        seen = self.boat.wait()
        at = geodesy.origin(*map(math.radians, self.boat.middle))
        place = geodesy.from_plane(at, seen.north_m, seen.east_m)
        rows, each = self.boat.run.settings.thrusters, tuple[float, ...]()
        if self.steers:
            port, turned = seen.told
            starboard = port
        elif len(rows) > 2:
            port, starboard, turned, each = 0.0, 0.0, -3.0, self.each()
        else:
            port, starboard = seen.told if self.boat.run.settings.thrusters[0].y_m < 0 else seen.told[::-1]
            turned = -3.0  # what the link has where nothing turns
        heading_deg, turn_dps = math.degrees(seen.heading_rad), math.degrees(seen.turn_radps)
        moves = heading_deg, turn_dps, round(seen.north_mps, 2), round(seen.east_mps, 2)
        mode = self.boat.run.state.mode.name.lower()
        told = seen.at_s, *map(math.degrees, place), *moves, port, starboard, turned, mode, seen.reason
        return BoatHeard(*told, self.sensed(), self.digest, each)

    def each(self) -> tuple[float, ...]:
        """What each of more than two thrusters was told, by the message that the link has of it."""
        return () if self.is_old else tuple(adopting._each(next(iter(thrust(self.view())))))

    def view(self) -> TelemetryView:
        vehicle, now_s = self.boat.run.vehicle, self.boat.run.vehicle.clock.monotonic_s()
        return TelemetryView(vehicle, vehicle.helm.settings.mavlink, 0, lambda leg: 0, lambda kind: None, now_s)

    def sensed(self) -> dict[str, tuple[float, ...]] | None:
        """What the sensors said, by the message that the link has of it."""
        view = self.view()
        said = next(iter(sensed(view)), None)
        heard = adopting._sensed(said, view.now_s, view.now_s)
        return None if heard is None else {kind: tuple(value) for kind, value in heard.items()}

    def forget(self) -> None:
        pass

    def order_answered(self) -> str:
        return self._refused

    def answered(self) -> bool:
        question = str(self.said[-1]["ask"])
        return not (self._no and question.startswith(self._no))

    def of(self, kind: str) -> list[Any]:
        return [each[kind] for each in self.said if kind in each]


def several(name: str, folder: Path) -> tuple[Path, Hidden]:
    """The file of a layout, and a boat drawn of it whose motors are exchanged."""
    file = folder / "boat.toml"
    file.write_text(text_of(LAYOUTS[name]), encoding="utf-8")
    settings = config.load(file, NOISE)
    every = (drawn(settings, seed) for seed in range(1, 50))
    return file, next(each for each in every if each.places != tuple(range(len(settings.thrusters))) and any(each.reversed))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    place = tmp_path / "otter.toml"
    place.write_text((ROOT / "etc/boats/otter.toml").read_text() + "\n[adopted]\nproven = false\n")
    return place


@pytest.mark.long
def test_a_whole_trial_over_the_link_finds_the_motors_and_writes_what_is_agreed_to(file: Path, tmp_path: Path) -> None:
    settings = config.load(file, NOISE)
    hidden = next(each for each in (drawn(settings, seed) for seed in range(1, 50)) if each.swapped and each.reversed[0])
    link = Link(settings, SEED, hidden=hidden)
    assert tried(link, file, 60.0, tmp_path) == 0
    written = config.load(file)
    assert written.adopted.proven
    assert written.boat.inertia_kgm2
    assert [row.address for row in written.thrusters] == [row.address for row in settings.thrusters][::-1]
    wrong = [row.reversed != was.reversed for row, was in zip(written.thrusters, settings.thrusters[::-1], strict=True)]
    assert wrong == list(hidden.reversed)[::-1]
    assert abs(written.thrusters[0].dead - hidden.rows[0].dead) < 0.03
    assert "; was 0" in file.read_text() or "; was 1" in file.read_text()
    assert {"drift", "motors", "bow first", "proof", "legs", "spins"} <= {each["name"] for each in link.of("step")}
    assert link.of("step")[-1]["state"] == "done"
    assert link.of("circle")[0]["radius_m"] == 60.0
    assert (tmp_path / "otter.html").exists()
    assert (link.boat.run.state.mode, link.boat.run.state.actuation.run) == (Mode.IDLE, False)
    with pytest.raises(DelfimError, match=r"sails by another file .* then the proof sail is next"):
        tried(link, file, 60.0, tmp_path)
    again = Link(config.load(file, NOISE), SEED, hidden=rewired(link.hidden, written.thrusters))
    assert tried(again, file, 60.0, tmp_path) == 0, again.of("tell")
    assert "Was her program" not in again.of("ask")[0], "she tells by which file she sails"
    assert {each["command"] for each in again.of("steer")} == {"heading", "stop", "mode"}
    assert again.boat.run.state.mode is Mode.HOLD
    assert tried(again, file, 60.0, tmp_path) == 0
    assert again.of("tell")[-1].startswith("Adopted already")


def test_a_motor_that_steers_is_found_over_the_link_too(tmp_path: Path) -> None:
    file = tmp_path / "bait-boat.toml"
    file.write_text((ROOT / "etc/boats/bait-boat.toml").read_text() + "\n[adopted]\nproven = false\n")
    settings = config.load(file, NOISE)
    link = Link(settings, SEED, ends_at="gain")
    assert tried(link, file, 60.0, tmp_path) == 1
    known = kept(tmp_path / "bait-boat.trial", settings)
    assert (known.is_proven, known.wiring) == (True, (False, link.hidden.reversed, link.hidden.turned, ()))


@pytest.mark.parametrize("name", ["float", "bow-thruster"])
def test_the_motors_of_a_boat_with_three_or_four_are_found_and_written_over_the_link(name: str, tmp_path: Path) -> None:
    file, hidden = several(name, tmp_path)
    link = Link(config.load(file, NOISE), SEED, ends_at="gain", hidden=hidden)
    code = tried(link, file, 60.0, tmp_path)
    known = kept(tmp_path / "boat.trial", link.boat.run.settings)
    assert known.is_proven, link.of("tell")
    assert known.wiring is not None
    assert is_right(known.wiring, hidden, link.boat.run.settings.thrusters)
    if name != "float":  # whose hull is kept, and then the trial is whole
        assert code == 1
        return
    assert code == 0
    written, was = config.load(file), link.boat.run.settings
    assert written.adopted.proven
    assert {row.name: row.address for row in written.thrusters} != {row.name: row.address for row in was.thrusters}
    assert "Hull, compass and gains stay as they are" in link.of("tell")[-1]


def test_a_boat_that_does_not_tell_what_each_thruster_is_told_is_refused_before_anything_turns(tmp_path: Path) -> None:
    file, hidden = several("float", tmp_path)
    link = Link(config.load(file), SEED, hidden=hidden)
    link.is_old = True
    with pytest.raises(DelfimError, match="tells of no thrusters what each is told, and her file has 4: her program is older"):
        tried(link, file, 60.0, tmp_path)
    assert not link.said
    assert tried(link, file, 60.0, tmp_path, "berth") == 0
    assert len(link.of("order")) == 4


def test_at_the_berth_each_motor_turns_by_itself_for_a_second(file: Path, tmp_path: Path) -> None:
    link = Link(config.load(file, NOISE), SEED)
    assert tried(link, file, 60.0, tmp_path, "berth") == 0
    orders = link.of("order")
    assert [order["pieces"] for order in orders] == [((1.0, (0.15, 0.0)),), ((1.0, (0.0, 0.15)),)]
    assert [question.partition(":")[0] for question in link.of("ask")[1:]] == ["starboard", "port"]
    assert link.boat.run.state.mode is Mode.IDLE
    assert not (tmp_path / "otter.trial").exists()
    no = Link(config.load(file, NOISE), SEED, no="starboard")
    assert tried(no, file, 60.0, tmp_path, "berth") == 0
    assert "power, arming, address" in no.of("tell")[-1]
    assert len(no.of("order")) == 1


def test_a_boat_that_estimates_tells_what_its_sensors_said(file: Path) -> None:
    settings = config.load(ROOT / "etc/boats/blueboat.toml", NOISE)
    assert settings.navigation.estimator
    link = Link(settings, SEED)
    last = link.boat.wait().measured or {}
    told = link.sensed() or {}
    assert told.keys() == {"heading", "rate", "velocity"}
    for kind, (at_s, *value) in told.items():
        assert at_s == pytest.approx(last[kind][0], abs=1e-5)
        assert value == pytest.approx(last[kind][1:], abs=1e-6)
    assert Link(config.load(file, NOISE), SEED).sensed() is None, "she has no estimator"


def test_what_somebody_ended_gives_no_order_any_more_and_goes_on_later(file: Path, tmp_path: Path) -> None:
    link = Link(config.load(file, NOISE), SEED, ends_at="circles")
    before = file.read_text()
    assert tried(link, file, 60.0, tmp_path) == 1
    ended = next(at for at, each in enumerate(link.said) if each.get("step", {}).get("name") == "circles")
    assert not [each for each in link.said[ended:] if "order" in each or "end" in each]
    assert "The trial ended: STOP." in link.of("tell")
    assert file.read_text() == before
    again = Link(config.load(file, NOISE), SEED, ends_at="legs")
    with pytest.raises(DelfimError, match="the circle is not free"):
        tried(Link(config.load(file, NOISE), SEED, no="Otter"), file, 60.0, tmp_path)
    assert tried(again, file, 60.0, tmp_path) == 1
    assert "Goes on with" in again.of("tell")[0]
    names = [each["name"] for each in again.of("step") if each["state"] == "done"]
    assert "circles" in names, "what was interrupted is sailed again"
    assert "motors" not in names, "and what came to its end is not"
