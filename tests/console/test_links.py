"""Several links to one boat at once: a serial radio and LTE. One session, one sequence; either may fail at any time."""

from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.console.boats.fleet import Fleet
from delfim.console.link.mavlink import Key, keygen
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.station import Station
from delfim.vehicle import console
from tests.console.fakeboat import Radio

LTE, RADIO = ("10.0.0.1", 14550), ("/dev/ttyUSB0", 57600)
PLACES = {LTE: ("udp", "10.0.0.9", 14555), RADIO: ("serial", "/dev/ttyUSB1")}  # of the boat, as the console knows it
NAMES = {LTE: "10.0.0.9:14555", RADIO: "/dev/ttyUSB1"}
AGES = 17 * 365.25 * 86_400.0  # the tests' clock stands in 2010, before time stamps began
SWITCH_S = 1.0


class TwoLinks:
    """The vehicle with its station, and the console, with two links between them; each fails in one direction or in both."""

    def __init__(self, boat: Any, folder: Path, seed: int) -> None:
        boat.clock.step(AGES)
        keygen(folder / "key")
        key = Key(folder / "key", boat.clock)
        boat.vehicle.helm.settings = config.Vehicle(boat=config.BoatTable(name="test", id=1))
        self.boat, self.clock = boat, boat.clock
        self.failed = set[tuple[Any, int]]()  # link and direction: 0 to the boat, 1 from it
        self.radios = {
            LTE: Radio(boat.clock, seed, bytes_per_s=500_000, loss=0.02, jitter_s=0.06, duplicates=0.05),
            RADIO: Radio(boat.clock, seed + 1, bytes_per_s=5_760, loss=0.05, jitter_s=0.25, duplicates=0.05),
        }
        self.told: list[dict[str, Any]] = []
        self.obeyed: list[tuple[float, console.Commands]] = []
        self.station = Station(boat.vehicle, self._obey, self._down, Signing(key.secret, boat.clock))
        self.fleet = Fleet(boat.clock, self._up, self.told.append, key)
        boat.ready()
        for place in PLACES:  # the boat's file names both
            peer = self.station.consoles.peers.at(place, None, configured=True)
            assert peer is not None
            peer.profile = "radio" if place == RADIO else "wifi"

    def _obey(self, asked: console.Commands, who: str) -> str | None:
        refused: str | None = self.boat.vehicle.on_command(asked, who)
        if refused is None and not isinstance(asked, console.Alive):
            self.obeyed.append((self.clock.monotonic_s(), asked))
        return refused

    def _up(self, address: Any, data: bytes) -> None:
        place = next(each for each, known in PLACES.items() if known == address)
        if (place, 0) not in self.failed:
            self.radios[place].carry(0, data, lambda frame: self._arrive(frame, place))

    def _arrive(self, data: bytes, place: Any) -> None:
        self.station.receive(data, place)
        while self.station.turn():
            pass

    def _down(self, data: bytes, place: Any) -> None:
        if place in PLACES and (place, 1) not in self.failed:
            self.radios[place].carry(1, data, lambda frame: self.fleet.receive(PLACES[place], frame))

    def step(self) -> None:
        """A tenth of a second."""
        self.boat.pass_time(0.1)
        self.boat.navigate()
        self.boat.report()
        for radio in self.radios.values():
            radio.tick()
        self.station.tick()
        self.fleet.tick()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            self.step()

    @property
    def used(self) -> str:
        """The link that the page shows as the one in use."""
        return next(each["place"] for each in self.fleet.snapshot()[0]["link"]["all"] if each["used"])

    def orders(self) -> list[str]:
        """What was obeyed, but for thrust by hand."""
        return [type(each).__name__ for _, each in self.obeyed if not isinstance(each, console.Manual)]


@pytest.fixture
def sea(boat: Any, tmp_path: Path) -> TwoLinks:
    sea = TwoLinks(boat, tmp_path, 1)
    sea.run(5.0)
    return sea


def test_the_page_tells_both_links_and_the_better_one_is_used(sea: TwoLinks) -> None:
    shown = sea.fleet.snapshot()[0]
    assert {each["place"]: each["kind"] for each in shown["link"]["all"]} == {"10.0.0.9:14555": "udp", "/dev/ttyUSB1": "serial"}
    assert sea.used == "10.0.0.9:14555"
    assert all(each["rtt_ms"] is not None and each["age_s"] < 2.0 for each in shown["link"]["all"])
    assert (shown["link"]["kind"], shown["twins"]) == ("udp", [])
    assert sea.boat.state.namesakes == "", "one console on two links is one"
    assert sea.station.consoles.counts.get("replayed", 0) < 30, "of frames that came twice"


def test_a_text_that_comes_on_both_links_is_shown_once(sea: TwoLinks) -> None:
    for number in range(20):
        sea.station.consoles.peers.say(4, f"text {number}" + 60 * "." * (number % 2))
        sea.run(0.5)
    shown = [each["text"].rstrip(".") for each in sea.told if each["t"] == "text" and each["text"].startswith("text")]
    assert sorted(set(shown)) == sorted(shown)
    assert len(shown) >= 18, "few are lost on both"


def test_an_order_that_a_newer_one_overtook_on_the_other_link_is_not_obeyed(sea: TwoLinks) -> None:
    sea.radios[RADIO]._jitter_s = 0.0
    held: list[Any] = []
    carry = sea.radios[RADIO].carry
    sea.radios[RADIO].carry = lambda way, data, to: held.append((data, to)) if way == 0 else carry(way, data, to)  # type: ignore[method-assign]
    sea.failed = {(LTE, 0)}
    sea.fleet.command(1, "mode", {"mode": "hold"}, lambda well, why: None)
    sea.run(0.2)
    sea.failed = set()
    sea.fleet.command(1, "stop", {}, lambda well, why: None)
    sea.run(0.5)
    for data, to in held:
        to(data)
    assert sea.boat.state.mode is Mode.IDLE
    assert "SetMode" not in sea.orders()
    assert sea.station.consoles.counts["overtaken"] >= 1


def test_an_order_of_which_six_copies_are_lost_on_both_links_is_answered_in_time(sea: TwoLinks) -> None:
    """As where a link fails and the other one loses many: every copy counts, and an answer after 4 s is none."""
    lost = dict.fromkeys(PLACES, 6)
    carries = {place: radio.carry for place, radio in sea.radios.items()}

    def carry(place: Any, way: int, data: bytes, to: Any) -> None:
        is_order = way == 0 and b'"speed"' in data
        lost[place] -= is_order
        if not is_order or lost[place] < 0:
            carries[place](way, data, to)

    for place, radio in sea.radios.items():
        radio.carry = partial(carry, place)  # type: ignore[method-assign]
    answers: list[tuple[bool, str]] = []
    sea.fleet.command(1, "mode", {"mode": "manual"}, lambda well, why: None, page=1)
    sea.run(2.0)
    sea.fleet.command(1, "speed", {"speed_pct": 5.0}, lambda well, why: answers.append((well, why)))
    sea.run(4.5)
    assert answers == [(True, "")]


def test_a_plan_goes_up_while_links_change(sea: TwoLinks) -> None:
    waypoints = [
        {"latitude_deg": 38.693 + n / 1e4, "longitude_deg": -9.215, "speed_mps": 1.0, "acceptance_m": 0.0} for n in range(40)
    ]
    sea.fleet.put(1, {"name": "long", "waypoints": waypoints, "fence": [], "obstacles": [], "home": None})
    answers: list[tuple[bool, str]] = []
    sea.fleet.upload(1, lambda well, why: answers.append((well, why)))
    for turn in range(60):
        place = (LTE, RADIO)[turn % 2]
        sea.failed = {(place, 0), (place, 1)}
        sea.run(2.0)
        if answers:
            break
    assert answers == [(True, "")]


def drilled(sea: TwoLinks, seed: int, outages: int) -> tuple[list[float], list[float]]:
    """Outages of one link at a time; an order in each of them, and thrust by hand all along. Of each outage the longest gap in
    the thrust that was obeyed, and the time until another link was in use."""
    random, gaps, switches, asked = Random(seed), list[float](), list[float](), 0
    answers: list[tuple[bool, str]] = []
    for number in range(outages):
        before = len(sea.orders())
        sea.fleet.command(1, "mode", {"mode": "manual"}, lambda well, why: answers.append((well, why)), page=1)
        while len(answers) < 2 * number + 1:
            sea.step()
        sea.run(1.0)
        place, ways = random.choice((LTE, RADIO)), random.choice(((0,), (1,), (0, 1)))
        sea.failed = {(place, way) for way in ways}
        begun_s, at_s, lasts_s = sea.clock.monotonic_s(), random.uniform(0.0, 1.3), random.uniform(1.5, 4.0)
        is_asked, was_used = False, sea.used == NAMES[place]
        switched_s = None if was_used else 0.0
        while (passed_s := sea.clock.monotonic_s() - begun_s) < lasts_s:
            if round(passed_s * 10) % 2 == 0:
                asked += 1
                sea.fleet.input(1, asked, 20.0, 20.0, page=1)
            if not is_asked and passed_s >= at_s:
                is_asked = True
                sea.fleet.command(1, "speed", {"speed_pct": 1.0 + number % 50}, lambda well, why: answers.append((well, why)))
            sea.step()
            if switched_s is None and sea.used != NAMES[place]:
                switched_s = sea.clock.monotonic_s() - begun_s
        assert switched_s is not None, f"seed {seed}, outage {number}: {place} {ways} is still in use"
        switches.append(switched_s)
        thrusts = [at_s for at_s, each in sea.obeyed if isinstance(each, console.Manual) and at_s >= begun_s]
        gaps.append(max(b - a for a, b in zip([begun_s, *thrusts], [*thrusts, begun_s + lasts_s], strict=True)))
        sea.failed = set()
        while len(answers) < 2 * number + 2:  # an order is answered, or given up after 4 s
            sea.step()
        sea.run(1.0)
        assert len(sea.orders()) - before == 2, f"seed {seed}, outage {number}: {sea.orders()[before:]}"
    assert answers == [(True, "")] * (2 * outages)
    return gaps, switches


@pytest.mark.timeout(3600)  # with --outages 1000
def test_no_outage_loses_an_order_or_has_it_obeyed_twice(sea: TwoLinks, outages: int) -> None:
    gaps, switches = drilled(sea, 1, outages)
    print(f"{outages} outages: gap {max(gaps):.1f} s, switch {max(switches):.1f} s at most")
    assert max(*gaps, *switches) <= SWITCH_S + 0.01
