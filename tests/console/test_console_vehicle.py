"""The console against the vehicle itself: its loop, its station, its control; only the sockets between them are left out."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.base.errors import Refused
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.canproxy.dsor import messages
from delfim.console.boats.fleet import Fleet
from delfim.console.link.mavlink import Key, keygen
from delfim.console.plans import plan
from delfim.console.plans.library import Library
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.codec.wire import Speaker
from delfim.parts.mavlink.station import Station
from delfim.vehicle import console
from delfim.vehicle.plans.mission import Mission, PayloadItem, Waypoint
from tests.console.fakeboat import Radio, order

HOME = ("127.0.0.1", 14550)
AWAY = ("192.168.1.7", 14550)
PLAN = {
    "name": "harbour",
    "waypoints": [
        {"latitude_deg": 38.6930, "longitude_deg": -9.2150, "speed_mps": 0.0, "acceptance_m": 4.0, "hold_s": 30.0},
        {"latitude_deg": 38.6934, "longitude_deg": -9.2150, "speed_mps": 1.25, "acceptance_m": 0.0},
        {"latitude_deg": 38.6934, "longitude_deg": -9.2144, "speed_mps": 1.25, "acceptance_m": 0.0},
        {"latitude_deg": 38.6938, "longitude_deg": -9.2144, "speed_mps": 0.0, "acceptance_m": 0.0},
    ],
    "fence": [[38.69, -9.22], [38.70, -9.22], [38.70, -9.21], [38.69, -9.21]],
    "obstacles": [{"latitude_deg": 38.695, "longitude_deg": -9.218, "radius_m": 12.0}],
    "home": {"latitude_deg": 38.692, "longitude_deg": -9.215},
}

TRIANGLE = [[38.6960, -9.22], [38.6962, -9.22], [38.6962, -9.2197]]
ZONES = [
    {"kind": "keep_in", "name": "", "polygon": [], "centre": [[38.7, -9.215]], "radius_m": 400.0},
    {"kind": "keep_in", "name": "", "polygon": [[38.68, -9.23], *TRIANGLE[1:]], "centre": [], "radius_m": 0.0},
    {"kind": "keep_out", "name": "", "polygon": TRIANGLE, "centre": [], "radius_m": 0.0},
]


class Afloat:
    """A boat that is fit, and a console that has found it. Time is the boat's."""

    def __init__(self, boat: Any, key: Key | None = None, secret: bytes | None = None, **radio: Any) -> None:
        self.boat, self.state, self.answers = boat, boat.state, list[tuple[bool, str]]()
        vehicle = boat.vehicle
        vehicle.helm.settings = config.Vehicle(boat=config.BoatTable(name="test", id=1))
        self.radio = Radio(boat.clock, 3, **radio)
        signing = Signing(secret, boat.clock) if secret else None
        self.station = Station(vehicle, lambda asked, who: self._obey(asked, who), self._down, signing)
        self.told: list[dict[str, Any]] = []
        self.obeyed: list[console.Commands] = []
        self.fleet = Fleet(boat.clock, self._up, self.told.append, key)
        boat.ready()

    def _obey(self, asked: console.Commands, who: str) -> str | None:
        refused: str | None = self.boat.vehicle.on_command(asked, who)
        if refused is None and not isinstance(asked, console.Alive):
            self.obeyed.append(asked)
        return refused

    def _up(self, address: Any, data: bytes) -> None:
        self.radio.carry(0, data, lambda frame: self._arrive(frame))

    def _arrive(self, data: bytes) -> None:
        self.station.receive(data, HOME)
        while self.station.turn():
            pass

    def _down(self, data: bytes, address: Any) -> None:
        if address == HOME:
            self.radio.carry(1, data, lambda frame: self.fleet.receive(("udp", *HOME), frame))

    def run(
        self, seconds: float, until: Callable[[], object] = lambda: False, each: Callable[[], object] = lambda: None
    ) -> float:
        took_s = 0.0
        while took_s < seconds and not until():
            took_s += 0.1
            self.boat.pass_time(0.1)
            self.boat.navigate()
            self.boat.report()
            self.radio.tick()
            self.station.tick()
            self.fleet.tick()
            each()
            self.radio.tick()
        return took_s

    def ask(self, word: str, **words: Any) -> tuple[bool, str]:
        """And wait for the answer."""
        answers: list[tuple[bool, str]] = []
        self.fleet.command(1, *order(word, words), lambda well, why: answers.append((well, why)))
        self.run(30.0, until=lambda: answers)
        assert answers, f"{word}: no answer"
        return answers[0]

    def do(self, begin: Callable[[int, Callable[[bool, str], None]], None], limit_s: float = 30.0) -> tuple[bool, str]:
        answers: list[tuple[bool, str]] = []
        begin(1, lambda well, why: answers.append((well, why)))
        self.run(limit_s, until=lambda: answers)
        assert answers, "no answer"
        return answers[0]

    @property
    def shown(self) -> dict[str, Any]:
        return self.fleet.snapshot()[0]


@pytest.fixture
def sea(boat: Any) -> Afloat:
    sea = Afloat(boat)
    sea.run(2.0)
    return sea


def test_what_the_console_shows_is_what_the_vehicle_says(sea: Afloat) -> None:
    sea.run(2.0)
    shown = sea.shown
    assert (shown["mode"], shown["armed"], shown["id"]) == ("idle", False, 1)
    assert shown["latitude_deg"] == pytest.approx(38.69, abs=0.1)
    assert shown["thrust_pct"] == [0, 0]
    assert all(age is not None and age < 2.0 for age in shown["age_s"].values()), shown["age_s"]
    assert shown["link"]["loss_pct"] == 0.0
    assert shown["link"]["rtt_ms"] is not None
    assert sum(codec.counts["refused"] for codec in sea.fleet._peers.values()) == 0


@pytest.mark.parametrize(
    ("word", "words", "mode"),
    [
        ("manual", {}, "MANUAL"),
        ("mode", {"mode": "heading"}, "HEADING"),
        ("heading", {"heading_deg": 123.0}, "HEADING"),
        ("hold", {}, "HOLD"),
        ("goto", {}, "GOTO"),
        ("goto", {"latitude_deg": 38.6935, "longitude_deg": -9.2147}, "GOTO"),
        ("play", {}, "PLAY"),
        ("path", {}, "PATH"),
        ("idle", {}, "IDLE"),
        ("stop", {}, "IDLE"),
        ("arm", {}, "IDLE"),
        ("reset", {}, "IDLE"),
        ("take", {}, "IDLE"),
        ("speed", {"speed_pct": 50}, "IDLE"),
        ("speed", {"speed_mps": 1.0}, "IDLE"),
    ],
)
def test_every_word_does_at_the_vehicle_what_it_says(sea: Afloat, word: str, words: dict[str, Any], mode: str) -> None:
    sea.fleet.put(1, PLAN)
    assert sea.do(sea.fleet.upload) == (True, "")
    assert sea.ask(word, **words) == (True, "")
    assert sea.state.mode is Mode[mode]
    sea.run(1.5)
    assert sea.shown["mode"] == mode.lower()


@pytest.mark.parametrize(("words", "heading_deg"), [({}, 0.0), ({"heading_deg": 243.0}, 243.0)])
def test_heading_mode_follows_the_heading_that_was_asked_for_or_else_the_boats(sea, words, heading_deg):
    assert sea.ask("goto", latitude_deg=38.6935, longitude_deg=-9.2147, speed_mps=0.8) == (True, "")
    assert sea.ask(*(("heading",) if words else ("mode",)), **(words or {"mode": "heading"})) == (True, "")
    asked = sea.state.setpoint
    assert (math.degrees(asked.heading_rad), asked.speed_mps) == pytest.approx((heading_deg, 0.8), abs=0.01)


@pytest.mark.parametrize("profile", ["wifi", "radio", "lean"])
def test_the_place_that_a_boat_steers_for_is_that_of_its_mode(sea: Afloat, profile: str) -> None:
    """From one mode into the next: what the mode before steered for is not shown any more."""
    sea.fleet.put(1, PLAN)
    assert sea.do(sea.fleet.upload) == (True, "")
    assert sea.ask("profile", profile=profile) == (True, "")
    waypoint = {key: PLAN["waypoints"][0][key] for key in ("latitude_deg", "longitude_deg")}  # type: ignore[index]
    for word, words in (
        ("play", {}),
        ("heading", {"heading_deg": 123.0}),
        ("goto", waypoint),
        ("manual", {}),
        ("hold", {}),
        ("heading", {"heading_deg": 301.0}),
        ("path", {}),
        ("idle", {}),
    ):
        assert sea.ask(word, **words) == (True, ""), word
        sea.run(3.0)
        shown, told = sea.shown["reference"], sea.state.reference
        has_place = told.north_m is not None and profile != "lean"
        assert (shown["latitude_deg"] is not None) == has_place, word
        if has_place:
            there = from_plane(sea.state.origin, told.north_m, told.east_m)  # type: ignore[arg-type]
            assert math.radians(shown["latitude_deg"]) == pytest.approx(there[0], abs=1e-8)
            assert math.radians(shown["longitude_deg"]) == pytest.approx(there[1], abs=1e-8)
            assert shown["distance_m"] == pytest.approx(told.distance_m, abs=1.0)
        elif told.distance_m is None:
            assert shown["distance_m"] is None
        if word == "heading":
            assert shown["heading_deg"] == pytest.approx(words["heading_deg"], abs=2.0)


def test_a_refusal_is_told_in_the_vehicles_words(sea: Afloat) -> None:
    well, why = sea.ask("play")
    assert (well, why) == (False, "play refused: no mission loaded")


def test_so_is_the_refusal_of_a_plan(sea: Afloat) -> None:
    answers: list[tuple[bool, str]] = []
    there = [{"latitude_deg": 40.0 + n / 1e3, "longitude_deg": -9.21} for n in range(2)]
    sea.fleet.put(1, {"name": "far", "waypoints": there})
    sea.fleet.upload(1, lambda well, why: answers.append((well, why)))
    sea.run(10.0)
    assert [well for well, _ in answers] == [False]
    assert answers[0][1].startswith("uploaded: waypoint[0]: 145.1 km from the boat")


def test_a_mission_comes_back_as_it_went(sea: Afloat) -> None:
    sea.fleet.put(1, PLAN | {"zones": ZONES})
    assert sea.do(sea.fleet.upload) == (True, "")
    back = sea.fleet.missions[1]["aboard"]
    assert [w["speed_mps"] for w in back["waypoints"]] == [0.0, 1.25, 1.25, 0.0]
    assert (back["waypoints"][0]["acceptance_m"], back["waypoints"][0]["hold_s"]) == (4.0, 30.0)
    assert plan.digest(back) == plan.digest(PLAN | {"zones": ZONES}) != plan.digest(PLAN)
    assert json.loads(json.dumps(back["zones"])) == ZONES
    assert (back["fence"][2], back["obstacles"], back["home"]) == ([38.70, -9.21], PLAN["obstacles"], PLAN["home"])
    assert sea.shown["mission"]["state"] == "same"


def test_the_page_carries_items_for_payloads_and_the_way_home() -> None:
    stops = tuple(Waypoint(latitude_deg=38.69 + n / 1000, longitude_deg=-9.21, speed_mps=float(n)) for n in range(3))
    actions = tuple(PayloadItem(after=after, command=206, params=(25.0, "nan", 1.0, 0.0)) for after in (0, 1, 1, 3))
    mission = Mission(version=1, name="camera", waypoint=stops, action=actions, then="home")
    page = plan.page_of(mission)
    assert plan.tables_of(json.loads(json.dumps(page))) == mission
    places = [number for number, item in enumerate(plan.items_of(page)[0]) if item.command == 16]
    assert [plan.item_of(page, n) for n in range(3)] == places
    assert [plan.waypoint_of(page, each) for each in places] == [0, 1, 2]
    back = plan.mission_of("camera", plan.items_of(page))
    assert (back["digest"], back["actions"]) == (plan.digest(page), page["actions"])


def test_what_is_saved_is_what_is_loaded(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.save(PLAN)
    keys = ("latitude_deg", "longitude_deg", "speed_mps", "acceptance_m", "hold_s")
    loaded = [{key: each[key] for key in keys} for each in library.load("harbour")["waypoints"]]
    assert loaded == [{"hold_s": 0.0, **each} for each in PLAN["waypoints"]]  # type: ignore[dict-item]


@pytest.mark.parametrize("name", ["Survey 2", "é", "日本", "a" * 60, "\U0001d4d0" * 60, "1.2-3_x", "COMPASS", "console"])
def test_a_mission_is_a_file_of_its_name(tmp_path: Path, name: str) -> None:
    library = Library(tmp_path / "missions")
    library.save(PLAN | {"name": name})
    assert (library.names(), library.load(name)["name"]) == ([name], name)


ODD = (
    "",
    ".",
    "..",
    "../x",
    "a/b",
    "a\\b",
    "/etc/passwd",
    "a\0b",
    "a\nb",
    "-rf",
    " x",
    "x ",
    "x.",
    "~",
    "a:b",
    "<b>",
    "\ud800",
    "\u202ea",
)


@pytest.mark.parametrize(
    "name",
    [*ODD, "-rf", " x", "x ", "x.", "~", "\ud800", "\u202ea", "a" * 61, "a" * 300, "CON", "nul", "Com1", "aux.old", "LPT9.x"],
)
def test_no_name_of_a_mission_leads_elsewhere(tmp_path: Path, name: str) -> None:
    library = Library(tmp_path / "missions")
    for ask in (lambda: library.save(PLAN | {"name": name}), lambda: library.load(name)):
        with pytest.raises(Refused) as refused:
            ask()
        assert len(str(refused.value)) < 200
    assert not [*tmp_path.rglob("*.*")]


def test_the_boats_name_is_that_of_its_file(sea: Afloat) -> None:
    assert sea.shown["name"] == "test"


def test_what_is_aboard_is_read_when_the_boat_is_found_and_when_it_changes(sea: Afloat, tmp_path: Path) -> None:
    def count() -> int:
        return int(sea.shown["mission"]["count"])

    sea.run(10.0, until=lambda: "aboard" in sea.fleet.missions.get(1, {}))
    assert (sea.shown["mission"]["state"], count()) == ("same", 0)
    Library(tmp_path).save(PLAN)
    text = (tmp_path / "harbour.toml").read_text()
    assert sea.boat.vehicle.on_command(console.LoadMission(text)) is None, "by another console, or on board"
    assert sea.run(10.0, until=count) < 7.0
    assert count() == 4
    said = [each for each in sea.told if each["t"] == "mission"]
    assert [len(each["mission"]["waypoints"]) for each in said] == [0, 4], "no more often than it changes"
    sea.run(60.0)
    assert [each for each in sea.told if each["t"] == "mission"] == said


def test_a_plan_that_is_sent_does_not_wait_for_the_one_that_is_read_by_itself(boat: Any) -> None:
    sea = Afloat(boat)
    sea.run(8.0, until=lambda: sea.fleet.progress())
    sea.fleet.put(1, PLAN)
    assert sea.do(sea.fleet.upload) == (True, "")
    assert sea.shown["mission"]["state"] == "same"
    reads = len([each for each in sea.told if each["t"] == "mission"])
    sea.run(20.0)
    assert len([each for each in sea.told if each["t"] == "mission"]) == reads, "what was sent is not read again"


def test_a_path_with_an_arc_goes_along_with_the_waypoints(sea: Afloat) -> None:
    begin, middle, end = (
        {"latitude_deg": latitude_deg, "longitude_deg": -9.2150} for latitude_deg in (38.6930, 38.6932, 38.6934)
    )
    half = middle | {"turn_deg": 180.0, "radius_m": 22.2, "speed_mps": 1.5}
    sea.fleet.put(1, PLAN | {"path": [begin, half, end | {"latitude_deg": 38.6938}]})
    assert sea.do(sea.fleet.upload) == (True, "")
    back = sea.fleet.missions[1]["aboard"]
    assert back["path"][1] == pytest.approx(half | {"hold_s": 0.0, "line": 0}, rel=1e-6)
    assert len(back["waypoints"]) == 4
    assert sea.shown["mission"]["state"] == "same"


def test_play_from_a_waypoint_is_that_waypoint_behind_changes_of_speed_too(sea: Afloat) -> None:
    sea.fleet.put(1, PLAN)
    sea.do(sea.fleet.upload)
    assert sea.ask("play", leg=2) == (True, "")
    assert sea.state.reference.leg == 2
    sea.run(2.5)
    assert sea.shown["mission"]["current"] == 2


def test_thrust_by_hand_reaches_the_propellers_and_ends_with_the_input(sea: Afloat) -> None:
    assert sea.ask("manual") == (True, "")
    counter = iter(range(1000))

    def steer() -> None:
        sea.fleet.input(1, next(counter), 40.0, 20.0)

    steer()
    sea.run(3.0, each=steer)
    assert sea.shown["thrust_pct"] == [40, 20]
    sea.run(1.5)
    assert (sea.state.mode, sea.state.actuation.thrust[1]) == (Mode.MANUAL, 0.0), "the console said zero"
    sea.run(6.0)
    assert sea.state.mode is Mode.IDLE, "and the boat itself gave up waiting"


@pytest.mark.parametrize("profile", ["lean", "radio", "wifi"])
def test_a_profile_is_the_vehicles(sea: Afloat, profile: str) -> None:
    answers: list[tuple[bool, str]] = []
    sea.fleet.command(1, "profile", {"profile": profile}, lambda well, why: answers.append((well, why)))
    sea.run(5.0, until=lambda: answers)
    assert answers == [(True, "")]
    sea.run(30.0)
    assert sea.shown["link"]["profile"] == profile
    most = {"lean": 110, "radio": 500, "wifi": 2500}[profile]
    assert 40 < sea.shown["link"]["bytes_per_s"] < most
    assert sea.shown["latitude_deg"] is not None
    assert sea.shown["age_s"]["heard"] <= 1.1


def test_another_consoles_ownership_is_shown_and_taken(sea: Afloat) -> None:
    assert sea.ask("hold") == (True, "")
    assert sea.shown["owner"]
    sea.station.consoles.commander = Speaker(255, 190, ("127.0.0.1", 14560))
    sea.run(2.0)
    assert not sea.shown["owner"]
    well, why = sea.ask("heading", heading_deg=3.0)
    assert (well, "255" in why) == (False, True)
    assert sea.ask("stop") == (True, ""), "anybody may stop"
    assert sea.ask("take") == (True, "")
    assert sea.ask("hold") == (True, "")
    sea.run(2.0)
    assert sea.shown["owner"]


def test_on_a_signed_link_commands_are_obeyed_for_as_long_as_it_lasts(boat: Any, tmp_path: Path) -> None:
    boat.clock.step(16 * 365 * 86_400.0)  # to a time after 2015, where signatures begin to count
    keygen(tmp_path / "key")
    key = Key(tmp_path / "key", boat.clock)
    sea = Afloat(boat, key=key, secret=key.secret)
    for minute in range(3):
        sea.run(60.0)
        assert sea.ask("hold") == (True, ""), minute
        assert sea.ask("stop") == (True, ""), minute
    assert {
        name: count for name, count in sea.station.consoles.counts.items() if name in ("late", "replayed", "forged", "unsigned")
    } == {}
    # A console that was started again goes on at once.
    again = Fleet(boat.clock, sea._up, sea.told.append, Key(tmp_path / "key", boat.clock))
    sea.fleet = again
    sea.run(3.0)
    assert sea.ask("hold") == (True, "")


@pytest.mark.parametrize("silent_s", [1.0, 20.0])
def test_a_console_that_is_started_again_or_was_away_knows_why_the_boat_stopped(sea: Afloat, silent_s: float) -> None:
    sea.run(3.0)
    assert sea.ask("hold") == (True, "")
    sea.boat.report(messages.Status.BAD, messages.Fault.OVERHEATED)
    sea.boat.vehicle.on_watchdog()
    sea.run(1.0)
    assert sea.shown["forced"] == "propeller starboard bad: overheated"
    sea.fleet = Fleet(sea.boat.clock, lambda address, data: None, sea.told.append, None)
    sea.run(silent_s)
    sea.fleet = Fleet(sea.boat.clock, sea._up, sea.told.append, None)
    sea.run(3.0)
    assert sea.shown["forced"] == "propeller starboard bad: overheated"


BAD = {"bytes_per_s": 960.0, "loss": 0.3, "duplicates": 0.1, "jitter_s": 0.4, "outages": lambda now_s: now_s % 30.0 < 2.0}


def test_over_a_bad_radio_nothing_that_is_stale_is_obeyed(boat: Any) -> None:
    """Play, and stop a second later, again and again: once the stop is confirmed no older command comes through."""
    sea = Afloat(boat, **BAD)
    sea.run(60.0, until=lambda: 1 in sea.fleet.boats)
    answers: list[tuple[bool, str]] = []
    sea.fleet.command(1, "profile", {"profile": "lean"}, lambda well, why: answers.append((well, why)))
    sea.run(30.0, until=lambda: answers)
    for _ in range(40):
        sea.fleet.command(1, "heading", {"heading_deg": 0.0}, lambda well, why: None)
        sea.run(1.0)
        stopped: list[bool] = []
        sea.fleet.command(1, "stop", {}, lambda well, why, stopped=stopped: stopped.append(well))  # type: ignore[misc]
        sea.run(60.0, until=lambda stopped=stopped: stopped)  # type: ignore[misc]
        assert stopped == [True]
        sea.run(8.0, until=lambda: sea.state.mode is not Mode.IDLE)
        assert sea.state.mode is Mode.IDLE


def test_over_a_bad_radio_the_age_that_is_shown_is_the_age(boat: Any) -> None:
    sea = Afloat(boat, **BAD)
    arrived: list[float] = []
    receive = sea.fleet.receive
    sea.fleet.receive = lambda address, data: (arrived.append(boat.clock.monotonic_s()), receive(address, data))[1]  # type: ignore[method-assign]
    sea.run(60.0, until=lambda: 1 in sea.fleet.boats)

    def look() -> None:
        assert sea.shown["age_s"]["heard"] == pytest.approx(boat.clock.monotonic_s() - arrived[-1], abs=0.011)

    sea.run(120.0, each=look)
