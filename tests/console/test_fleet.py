"""The console's truth against boats on good and bad links, on a clock of the test's own."""

import math
import random
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from delfim.base.clock import ManualClock
from delfim.base.errors import ConfigError, FormatError, Refused
from delfim.base.modes import Mode
from delfim.base.numberedorders import NumberKey
from delfim.console.boats import item_transfer
from delfim.console.boats.fleet import ASKS, Fleet
from delfim.console.link.mavlink import Key, keygen
from delfim.console.plans import plan
from delfim.parts.mavlink.codec import ownorders, plans, wire
from delfim.parts.mavlink.codec.signing import Signing
from tests.console.fakeboat import FakeBoat, Radio, order

SQUARE = {
    "name": "square",
    "waypoints": [
        {"latitude_deg": 38.69 + n / 1e4, "longitude_deg": -9.21, "speed_mps": 1.0 + n / 10, "acceptance_m": 3.0, "hold_s": 0.0}
        for n in range(20)
    ],
    "fence": [[38.68, -9.22], [38.70, -9.22], [38.70, -9.20]],
    "obstacles": [{"latitude_deg": 38.69, "longitude_deg": -9.205, "radius_m": 12.0}],
    "home": {"latitude_deg": 38.695, "longitude_deg": -9.215},
}


class Sea:
    """Boats, their links, the console, and time."""

    def __init__(self, *numbers: int, secret: bytes | None = None, key: Key | None = None, **radio: Any) -> None:
        self.clock = ManualClock(100.0)
        self.told: list[dict[str, Any]] = []
        self.radios = {n: Radio(self.clock, n, **radio) for n in numbers}
        self.fleet = Fleet(self.clock, self._transmit, self.told.append, key)
        self.boats = {
            n: FakeBoat(
                n, self.clock, lambda data, n=n: self.radios[n].carry(1, data, lambda d: self.fleet.receive(n, d)), secret
            )
            for n in numbers
        }
        self.answers: list[tuple[bool, str]] = []

    def _transmit(self, address: Any, data: bytes) -> None:
        if address in self.radios:  # others are not heard by anybody
            self.radios[address].carry(0, data, self.boats[address].hear)

    def run(
        self, seconds: float, until: Callable[[], object] = lambda: False, each: Callable[[], object] = lambda: None
    ) -> float:
        """Until that time has passed or something is so; how long it took."""
        begun_s = self.clock.monotonic_s()
        while self.clock.monotonic_s() - begun_s < seconds and not until():
            self.clock.advance(0.05)
            each()
            for number, boat in self.boats.items():
                boat.tick()
                self.radios[number].tick()
            self.fleet.tick()
        return self.clock.monotonic_s() - begun_s

    def ask(self, number: int, word: str, **words: Any) -> None:
        self.fleet.command(number, *order(word, words), lambda well, why: self.answers.append((well, why)))

    def shown(self, number: int) -> dict[str, Any]:
        return next(each for each in self.fleet.snapshot() if each["id"] == number)


@pytest.fixture
def sea() -> Sea:
    sea = Sea(1, 2)
    sea.run(3.0)
    return sea


def test_boats_are_found_and_shown_with_the_age_of_each_group(sea: Sea) -> None:
    one = sea.shown(1)
    assert (one["mode"], one["armed"], one["heading_deg"], one["rpm"]) == ("idle", False, 90.0, [300, 310])
    assert one["latitude_deg"] == pytest.approx(38.6901)
    assert 0 <= one["age_s"]["position"] <= 1.1
    assert one["age_s"]["attitude"] is None
    assert one["link"]["rtt_ms"] is not None
    assert sea.boats[1].heartbeats >= 2
    sea.boats[1].tick = lambda: None  # type: ignore[method-assign]
    sea.boats[1].hear = lambda data: None  # type: ignore[method-assign]
    sea.run(10.0)
    one, two = sea.shown(1), sea.shown(2)
    assert one["age_s"]["heard"] > 3.5 > two["age_s"]["heard"]
    assert one["ghost"]["latitude_deg"] > one["latitude_deg"], "it was under way to the north"
    assert two["ghost"] is None


def test_a_silent_boat_is_forgotten_until_it_is_heard_again(sea: Sea) -> None:
    boat = sea.boats[1]
    with pytest.raises(Refused, match="is heard"):
        sea.fleet.forget(1)
    boat.tick, tick, boat.hear = lambda: None, boat.tick, lambda data: None  # type: ignore[method-assign]
    sea.run(5.0)
    sea.ask(1, "stop")
    with pytest.raises(Refused, match="a command to it is under way"):
        sea.fleet.forget(1)
    sea.run(61.0)
    assert sea.answers == [(False, "no answer from the boat")]
    sea.fleet.forget(1)
    sea.run(3.0)
    assert [each["id"] for each in sea.fleet.snapshot()] == [2]
    boat.tick = tick  # type: ignore[method-assign]
    sea.run(3.0)
    assert [each["id"] for each in sea.fleet.snapshot()] == [1, 2]


def test_what_a_boat_never_tells_has_no_age() -> None:
    """A boat with motors on pulses and without a battery node: no green bar for what nobody told."""
    sea = Sea(1)
    sea.boats[1].tells = False
    sea.run(3.0)
    ages = sea.shown(1)["age_s"]
    assert (ages["rpm"], ages["battery"]) == (None, None)
    sea.boats[1].tells = True
    sea.run(2.0)
    ages = sea.shown(1)["age_s"]
    assert max(ages["rpm"], ages["battery"]) < 2.0


def test_a_trouble_is_shown_though_something_harmless_was_said_after_it(sea: Sea) -> None:
    boat = sea.boats[1]
    sea.run(1.0)
    alarmed = boat._heartbeat()
    alarmed.system_status = mavlink.MAV_STATE_CRITICAL
    boat._heartbeat = lambda: alarmed  # type: ignore[method-assign]
    boat.say(
        mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, b"kill: hand-set: its kill switch: stop"),
        mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_NOTICE, b"no console commands"),
        alarmed,
    )
    sea.run(1.5)
    assert sea.shown(1)["failsafe"] == "kill: hand-set: its kill switch: stop"


def test_a_failsafe_is_shown_with_what_its_trouble_has_become(sea: Sea) -> None:
    boat = sea.boats[1]
    sea.run(1.0)

    alarmed = boat._heartbeat()
    alarmed.system_status = mavlink.MAV_STATE_CRITICAL
    boat._heartbeat = lambda: alarmed  # type: ignore[method-assign]
    for text, shown in (
        ("navigation silent for 1.0 s: hold", "navigation silent for 1.0 s: hold"),
        ("console 250 commands", "navigation silent for 1.0 s: hold"),
        ("navigation silent for 4.8 s: hold", "navigation silent for 4.8 s: hold"),
    ):
        boat.say(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, text.encode()), alarmed)
        sea.run(1.5)
        assert sea.shown(1)["failsafe"] == shown


@pytest.mark.parametrize(
    ("word", "words", "expected"),
    [
        ("stop", {}, (176, 1, 4)),
        ("idle", {}, (176, 1, 4)),
        ("kill", {}, (185, 1, 0)),
        ("hold", {}, {"command": "mode", "mode": "hold"}),
        ("heading", {"heading_deg": 92}, {"command": "heading", "heading_deg": 92}),
        (
            "goto",
            {"latitude_deg": 38.6907123456789, "longitude_deg": -9.2},
            {"command": "goto", "latitude_deg": 38.6907123, "longitude_deg": -9.2},
        ),
        (
            "order",
            {"name": "pay_out", "values": {"rope_m": 5}},
            {"command": "order", "name": "pay_out", "values": {"rope_m": 5}},
        ),
    ],
)
def test_each_word_reaches_its_boat_alone_and_is_answered(sea: Sea, word: str, words: dict[str, Any], expected: Any) -> None:
    if word == "kill":
        sea.boats[1].mode = 4
    sea.ask(1, word, **words)
    sea.run(1.0)
    assert sea.boats[1].obeyed == [expected]
    assert sea.answers == [(True, "")]
    assert sea.boats[2].obeyed == []


def test_a_refusal_comes_with_the_boats_own_reason(sea: Sea) -> None:
    sea.boats[1].refuse = f"heading refused: gps has not reported{' for long' * 18}"
    sea.ask(1, "heading", heading_deg=90)
    assert sea.shown(1)["asked"] == "heading"
    sea.run(1.0)
    assert sea.answers == [(False, sea.boats[1].refuse)]


@pytest.mark.parametrize(
    ("boat", "word", "words"),
    [
        (3, "idle", {}),
        (1, "goto", {"latitude_deg": math.inf, "longitude_deg": math.inf}),
        (1, "order", {"name": "sing", "values": {"text": "x" * 250}}),
        (1, "profile", {"profile": "fast"}),
    ],
)
def test_what_cannot_be_asked_is_refused_at_once(sea: Sea, boat: int, word: str, words: dict[str, Any]) -> None:
    with pytest.raises((Refused, FormatError)):
        sea.ask(boat, word, **words)
    sea.run(1.0)
    assert sea.boats[1].obeyed == []


def test_an_older_boat_takes_a_stop_and_what_it_does_not_know_is_refused_in_words(sea: Sea) -> None:
    sea = Sea(1)
    sea.boats[1].is_older, sea.boats[1].offers = True, []
    sea.run(3.0)
    sea.ask(1, "hold")
    sea.run(6.0)
    words = "no answer from the boat; its program may be older than this console: it takes stop and kill alone"
    assert (sea.answers, sea.boats[1].obeyed) == ([(False, words)], [])
    sea.ask(1, "stop")
    sea.run(1.0)
    assert (sea.answers[1:], sea.boats[1].mode) == ([(True, "")], 4)


def test_an_order_whose_answer_is_lost_is_obeyed_once() -> None:
    sea = Sea(1)
    sea.run(3.0)
    receive, sea.fleet.receive = sea.fleet.receive, lambda address, data: None  # type: ignore[method-assign]
    sea.ask(1, "speed", speed_pct=40)
    sea.run(2.5)
    sea.fleet.receive = receive  # type: ignore[method-assign]
    sea.run(1.0)
    assert sea.answers == [(True, "")]
    assert sea.boats[1].obeyed == [{"command": "speed", "speed_pct": 40}]


@pytest.mark.parametrize("later", ["grex", "heading"])
def test_an_order_that_was_lost_does_not_undo_a_later_one(later: str) -> None:
    sea = Sea(1, outages=lambda now_s: 103.9 <= now_s < 104.3)
    sea.run(4.0)
    sea.ask(1, "hold")
    sea.run(0.4)
    sea.ask(1, later, **({"heading_deg": 3} if later == "heading" else {}))
    sea.run(4.0)
    assert sea.answers == [(False, "replaced by a newer command"), (True, "")]
    assert len(sea.boats[1].obeyed) == 1


def test_the_orders_of_the_menu_are_those_that_the_boat_offers() -> None:
    sea = Sea(1, loss=0.3)
    sea.boats[1].offers = [ownorders.Offer("dance", title="Dance", keys=(NumberKey("steps_m", 0.0, 9.0, 3.0),))]
    sea.run(60.0, until=lambda: 1 in sea.fleet.boats and sea.fleet.boats[1].has_told_orders)
    (offered,) = sea.shown(1)["orders"]
    assert (offered["command"], offered["title"], offered["keys"]) == ("dance", "Dance", (("steps_m", 0.0, 9.0, 3.0),))


def test_a_boat_tells_how_large_it_is_and_another_boat_of_its_number_is_not_as_large() -> None:
    sea = Sea(1, loss=0.3)
    sea.boats[1].name, sea.boats[1].size = "Alfa", "4.5 2.45 1200"
    sea.run(60.0, until=lambda: 1 in sea.fleet.boats and sea.shown(1)["size"] is not None)
    assert sea.shown(1)["size"] == {"length_m": 4.5, "beam_m": 2.45, "rpm_max": 1200.0}
    sea.fleet.boats[1].rename("Bravo")
    assert sea.shown(1)["size"] is None


def test_thrust_follows_the_page_and_ends_when_the_page_does(sea: Sea) -> None:
    sea.ask(1, "manual")
    for n in range(5):
        sea.fleet.input(1, n, 40.0, 20.0)
        sea.run(0.2)
    sea.fleet.input(1, 2, 100.0, 100.0)  # overtaken
    sea.run(3.0)
    assert sea.boats[1].thrust == [(300, 100)] * 5 + [(0, 0)], "zero once, then silence"
    assert sea.shown(1)["released"]
    assert any("manual thrust set to 0" in each.get("text", "") for each in sea.told)
    assert sea.boats[2].thrust == []


def test_a_mode_that_was_refused_is_not_shown_as_asked_for(sea: Sea) -> None:
    sea.boats[1].refuse = "not now"
    sea.ask(1, "hold")
    assert sea.shown(1)["asked"] == "hold"
    sea.run(1.0)
    assert sea.answers == [(False, "not now")]
    assert sea.shown(1)["asked"] is None


def test_another_boat_with_the_number_has_its_own_name() -> None:
    """After a silence the number may be another boat's."""
    sea = Sea(1, outages=lambda now_s: 110.0 <= now_s < 116.0)
    boat = sea.boats[1]
    boat.name, boat.profile = "Alfa", 2
    sea.run(10.0)
    assert (sea.shown(1)["name"], sea.shown(1)["link"]["profile"]) == ("Alfa", "wifi")
    sea.run(6.0)
    boat.name, boat.profile = "DelfimX", 1
    sea.told.clear()
    sea.run(3.0)
    assert (sea.shown(1)["name"], sea.shown(1)["link"]["profile"]) == ("DelfimX", "radio")
    warned = [each["text"] for each in sea.told if each.get("severity") == 4]
    assert warned == ["number 1 is now DelfimX: it was Alfa"]


def test_a_profile_that_was_not_told_is_not_shown() -> None:
    sea = Sea(1, 2)
    sea.boats[1].profile = None
    sea.boats[2].profile = 1
    sea.run(8.0)
    assert [sea.shown(n)["link"]["profile"] for n in (1, 2)] == ["", "radio"]


def test_one_page_drives_and_the_others_are_told_which(sea: Sea) -> None:
    sea.fleet.command(1, "mode", {"mode": "manual"}, lambda well, why: None, 1)
    for n in range(10, 13):
        sea.fleet.input(1, n, 30.0, 30.0, 1)
        sea.fleet.input(1, n + 50, 60.0, 60.0, 2)  # it has counted further
        sea.run(0.2)
    assert sea.boats[1].thrust == [(300, 0)] * 3
    assert sea.shown(1)["driver"] == 1
    sea.fleet.release(1, "another window is in front", 2)
    sea.run(0.2)
    assert sea.boats[1].thrust == [(300, 0)] * 3, "it was not its to release"
    sea.fleet.command(1, "mode", {"mode": "manual"}, lambda well, why: None, 2)
    sea.fleet.input(1, 13, 30.0, 30.0, 1)
    sea.fleet.input(1, 1, 60.0, 60.0, 2)
    sea.run(0.2)
    assert sea.boats[1].thrust == [*[(300, 0)] * 3, (0, 0), (600, 0)]
    assert sea.shown(1)["driver"] == 2
    sea.fleet.release_all("the page was closed", 2)
    sea.run(0.2)
    assert sea.boats[1].thrust[-1] == (0, 0)
    assert sea.shown(1)["driver"] == 0


def test_after_the_computer_slept_what_the_page_said_meanwhile_moves_nothing(sea: Sea) -> None:
    sea.run(3.0)
    sea.fleet.input(1, 1, 40.0, 40.0)
    sea.run(0.2)
    sea.clock.advance(20.0)
    said = len(sea.boats[1].thrust)
    sea.fleet.input(1, 2, 40.0, 40.0)  # read before time is noticed
    sea.fleet.tick()
    for count in range(3, 8):
        sea.fleet.input(1, count, 40.0, 40.0)
    sea.run(0.5)
    assert set(sea.boats[1].thrust[said:]) == {(0, 0)}
    assert sea.shown(1)["released"]
    sea.run(1.0)
    sea.fleet.input(1, 8, 40.0, 40.0)
    sea.run(0.2)
    assert sea.boats[1].thrust[-1] != (0, 0), "the operator took it again"


def test_a_stop_ends_input_and_is_repeated_until_it_arrives() -> None:
    sea = Sea(1, outages=lambda now_s: 104.0 <= now_s < 109.0)
    sea.run(3.5)
    sea.ask(1, "manual")
    sea.run(0.6)
    sea.fleet.input(1, 0, 50.0, 50.0)
    sea.ask(1, "stop")
    took_s = sea.run(20.0, until=lambda: sea.answers[1:])
    assert sea.answers[1:] == [(True, "")]
    assert 4.0 < took_s < 6.0
    assert sea.boats[1].mode == 4


def tries(sea: Sea, lost: int = 0) -> list[float]:
    """When an order to boat 1 is sent; so many of the first tries are lost."""
    transmit, tried_s = sea.fleet._transmit, list[float]()

    def look(address: Any, data: bytes) -> None:
        if b'"command":"heading"' in data:
            tried_s.append(sea.clock.monotonic_s())
        if b'"command":"heading"' not in data or len(tried_s) > lost:
            transmit(address, data)

    sea.fleet._transmit = look  # type: ignore[method-assign]
    return tried_s


def test_on_a_quick_link_an_order_that_is_lost_once_does_not_wait() -> None:
    sea = Sea(1)
    sea.run(3.0)
    tried_s = tries(sea, lost=1)
    sea.ask(1, "heading", heading_deg=90.0, speed_mps=1.0)
    assert sea.run(3.0, until=lambda: sea.answers) < 0.25
    sea.run(1.0)
    assert sea.answers == [(True, "")]
    assert len(tried_s) == 2


def test_on_a_slow_link_an_order_waits_for_its_answer() -> None:
    sea = Sea(1, jitter_s=0.3)
    sea.run(3.0, until=lambda: (sea.shown(1)["link"]["rtt_ms"] or 0.0) > 100.0 if 1 in sea.fleet.boats else False)
    tried_s = tries(sea, lost=9)
    sea.ask(1, "heading", heading_deg=90.0, speed_mps=1.0)
    sea.run(1.2)
    assert [round(after - before, 2) for before, after in pairwise(tried_s)] == [0.5, 0.5]


def test_a_stop_is_not_taken_for_heard_because_a_mode_before_it_was() -> None:
    """The answer to the mode comes when the stop is on its way, and the stop is lost."""
    sea = Sea(1)
    sea.run(2.0)
    ways: list[bytes] = []
    sea.fleet._transmit = lambda address, data: ways.append(data)
    sea.ask(1, "hold")
    hold = ways[-1]
    sea.ask(1, "stop")
    sea.boats[1].hear(hold)
    sea.run(1.0)
    assert sea.answers == [(False, "replaced by a newer command")]
    sea.boats[1].hear(ways[-1])
    sea.run(0.5)
    assert (sea.answers[1:], sea.boats[1].mode) == ([(True, "")], 4)


def test_the_name_is_asked_for_until_the_boat_tells_it() -> None:
    sea = Sea(1, loss=0.5)
    sea.boats[1].name = "Delfim\x07X "
    sea.run(60.0, until=lambda: 1 in sea.fleet.boats and sea.shown(1)["name"] != "boat 1")
    assert sea.shown(1)["name"] == "DelfimX"


OWN_MODES = [(4, b"Hold"), (0, b"manual"), (42, b"Dance\x07"), (43, b"")]


def test_the_modes_are_those_that_the_boat_tells() -> None:
    sea = Sea(1, loss=0.3)
    sea.boats[1].modes = OWN_MODES
    sea.run(60.0, until=lambda: 1 in sea.fleet.boats and len(sea.shown(1)["modes"]) == len(OWN_MODES))
    assert sea.shown(1)["modes"] == ["idle", "manual", "dance", "mode 43"], "4 is where STOP leads, whatever it is called"
    asked = sea.boats[1].asked_modes
    sea.ask(1, "dance")
    sea.run(30.0, until=lambda: sea.shown(1)["mode"] == "dance")
    assert (sea.boats[1].mode, sea.shown(1)["armed"]) == (42, True)
    sea.run(30.0)
    assert sea.boats[1].asked_modes == asked, "what is known is not asked again"


def test_a_boat_that_does_not_tell_its_modes_is_shown_by_its_heartbeat(sea: Sea) -> None:
    sea.boats[1].mode = 77
    sea.run(2.0)
    assert sea.shown(1)["mode"] == "mode 77"
    assert sea.shown(1)["modes"] == [mode.name.lower() for mode in Mode]
    sea.ask(1, "hold")
    sea.run(2.0)
    assert (sea.boats[1].mode, sea.shown(1)["mode"]) == (5, "hold")
    sea.run(80.0)
    assert sea.boats[1].asked_modes == ASKS


def test_a_boat_that_has_no_name_is_not_asked_for_ever(sea: Sea) -> None:
    sea.run(200.0)
    assert sea.shown(1)["name"] == "boat 1"
    assert sea.boats[1].asked_name == ASKS


def test_a_command_that_is_too_old_is_not_sent_any_more() -> None:
    sea = Sea(1, outages=lambda now_s: 104.0 <= now_s < 120.0)
    sea.run(4.5)
    sea.ask(1, "play")
    sea.run(30.0)
    assert sea.answers == [(False, "no answer from the boat")]
    assert sea.boats[1].obeyed == []


def test_a_mission_goes_up_is_read_back_and_compared(sea: Sea) -> None:
    sea.fleet.put(1, SQUARE)
    sea.fleet.upload(1, lambda well, why: sea.answers.append((well, why)))
    with pytest.raises(Refused, match="being sent or read"):
        sea.fleet.download(1, lambda well, why: None)
    sea.run(20.0, until=lambda: sea.answers)
    assert sea.answers == [(True, "")]
    assert sea.shown(1)["mission"]["state"] == "same"
    assert (sea.shown(1)["mission"]["count"], sea.shown(1)["mission"]["name"]) == (20, "square")
    assert [len(items) for items in sea.boats[1].aboard.values()] == [40, 4, 1]
    assert sea.boats[2].aboard == {0: [], 1: [], 2: []}
    sea.fleet.put(1, SQUARE | {"waypoints": SQUARE["waypoints"][:5]})
    assert sea.shown(1)["mission"]["state"] == "differs"


@pytest.mark.parametrize("deed", ["upload", "download"])
@pytest.mark.parametrize("silent", [False, True])
def test_a_transfer_that_is_over_says_so_well_or_not(deed: str, silent: bool) -> None:
    sea = Sea(1, outages=lambda now_s: silent and now_s > 104.0)
    sea.run(4.5)
    sea.fleet.put(1, SQUARE)
    getattr(sea.fleet, deed)(1, lambda well, why: sea.answers.append((well, why)))
    sea.run(2 * item_transfer.TIMEOUT_S, until=lambda: sea.answers)
    assert sea.answers[0][0] is not silent
    assert sea.fleet.progress() == []
    assert [each["part"] for each in sea.told if each["t"] == "progress"] == [1.0]


def test_items_and_missions_are_each_others_inverse() -> None:
    back = plan.mission_of("square", plan.items_of(SQUARE))
    assert plan.digest(back) == plan.digest(SQUARE)
    assert back["waypoints"][3]["speed_mps"] == pytest.approx(1.3)
    numbers = [n for n, item in enumerate(plan.items_of(SQUARE)[0]) if item.command == plans.WAYPOINT]
    assert [plan.item_of(SQUARE, waypoint) for waypoint in range(20)] == numbers
    assert plan.digest(SQUARE | {"name": "another"}) == plan.digest(SQUARE)


@pytest.mark.parametrize("wrong", [{}, {"waypoints": 3}, {"waypoints": [{"latitude_deg": 95.0, "longitude_deg": 0.0}]}])
def test_what_is_no_mission_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(FormatError):
        plan.items_of(wrong)


BAD = {
    "bytes_per_s": 960.0,
    "loss": 0.3,
    "duplicates": 0.1,
    "jitter_s": 0.4,
    "outages": lambda now_s: 10.0 < now_s % 30.0 < 12.0,
}


def test_over_a_bad_radio_stops_arrive_and_missions_go_up() -> None:
    """9,600 bit/s, 30 % loss, duplicates, overtaking, and 2 s of silence every 30 s."""
    took_s = []
    for seed in range(100):
        sea = Sea(1, **BAD)
        sea.radios[1]._random.seed(seed)
        sea.run(8.0 + seed % 7, until=lambda sea=sea: False)
        if 1 not in sea.fleet.boats:
            sea.run(30.0, until=lambda sea=sea: 1 in sea.fleet.boats)
        sea.boats[1].mode = 0
        sea.ask(1, "stop")
        took_s.append(sea.run(60.0, until=lambda sea=sea: sea.boats[1].mode == 4))
    assert sorted(took_s)[98] <= 3.0, sorted(took_s)[-5:]
    sea.fleet.put(1, SQUARE)
    answers: list[tuple[bool, str]] = []
    sea.fleet.upload(1, lambda well, why: answers.append((well, why)))
    sea.run(600.0, until=lambda: answers)
    assert answers == [(True, "")]
    assert 5.0 < sea.shown(1)["link"]["loss_pct"] < 60.0


def test_a_hundred_thousand_bytes_of_nonsense_do_no_harm(sea: Sea) -> None:
    noise = random.Random(7)
    for _ in range(1000):
        data = bytearray(noise.randbytes(100))
        if noise.random() < 0.5:
            data[0] = 0xFD
        sea.fleet.receive(1, bytes(data))
    sea.run(3.0)
    assert sea.shown(1)["age_s"]["heard"] <= 2.1
    assert len(sea.fleet.boats) == 2


def test_peers_and_boats_are_bounded(sea: Sea) -> None:
    for n in range(1, 200):
        boat = FakeBoat(n, sea.clock, lambda data, n=n: sea.fleet.receive(("udp", n), data))
        boat.tick()
    assert len(sea.fleet.boats) <= 32
    assert len(sea.fleet._peers) <= 64


class Twins:
    """Two that speak by the number 1, at two addresses, and a console."""

    HERE, THERE = ("udp", "10.0.0.3", 14550), ("udp", "10.0.0.4", 14550)

    def __init__(self, *runs: str, there: Any = THERE) -> None:
        self.clock = ManualClock(100.0)
        self.told: list[dict[str, Any]] = []
        self.answers: list[tuple[bool, str]] = []
        self.places = (self.HERE, there)
        self.boats = {
            place: FakeBoat(1, self.clock, lambda data, place=place: self.fleet.receive(place, data)) for place in self.places
        }
        for boat, run in zip(self.boats.values(), runs, strict=False):
            boat.run = run
        self.boats[there].position = [0, 1]
        self.fleet = Fleet(self.clock, lambda address, data: self.boats[address].hear(data), self.told.append)

    def run(self, seconds: float, *silent: Any) -> None:
        for _ in range(round(seconds / 0.05)):
            self.clock.advance(0.05)
            for place, boat in self.boats.items():
                if place not in silent:
                    boat.tick()
            self.fleet.tick()

    @property
    def shown(self) -> dict[str, Any]:
        return self.fleet.snapshot()[0]

    @property
    def alarms(self) -> list[str]:
        return [each["text"] for each in self.told if each["t"] == "text" and each["severity"] <= 2]


@pytest.mark.parametrize("runs", [("a", "b"), ("", ""), ("a", "")])
def test_two_boats_with_one_number_are_told_of_and_not_mixed(runs: tuple[str, str]) -> None:
    sea = Twins(*runs)
    sea.run(10.0)
    assert sea.shown["twins"] == ["10.0.0.3:14550", "10.0.0.4:14550"]
    assert sea.alarms == ["2 boats have the number 1: 10.0.0.3:14550 and 10.0.0.4:14550; STOP goes to all of them"]
    assert {longitude_deg for _, _, longitude_deg in sea.fleet.boats[1].track} == {-9.215}
    sea.run(20.0, sea.THERE)
    assert (sea.shown["twins"], len(sea.alarms)) == ([], 1)


@pytest.mark.parametrize("to", [1, "all"])
def test_stop_goes_to_every_boat_of_a_number_and_is_over_when_all_of_them_are_idle(to: int | str) -> None:
    sea = Twins("a", "b")
    for boat in sea.boats.values():
        boat.mode = 10
    sea.run(10.0)
    deaf = sea.boats[sea.THERE]
    hear, deaf.hear = deaf.hear, lambda data: None  # type: ignore[method-assign]
    sea.fleet.command(1, "stop", {}, lambda well, why: sea.answers.append((well, why)))
    sea.run(3.0)
    assert (sea.boats[sea.HERE].mode, deaf.mode, sea.answers) == (4, 10, [])
    deaf.hear = hear  # type: ignore[method-assign]
    sea.run(3.0)
    assert (deaf.mode, sea.answers) == (4, [(True, "")])
    sea.fleet.command(1, "mode", {"mode": "hold"}, lambda well, why: None)
    sea.run(2.0)
    assert (sea.boats[sea.HERE].mode, deaf.mode) == (5, 4), "anything else is for the one that is shown"


@pytest.mark.parametrize("there", [Twins.THERE, ("serial", "/dev/ttyUSB0")])
def test_a_boat_that_is_heard_on_two_links_is_one(there: Any) -> None:
    sea = Twins("same", "same", there=there)
    sea.run(20.0)
    assert (sea.alarms, sea.shown["twins"]) == ([], [])


def test_a_boat_that_comes_back_from_another_address_is_the_boat() -> None:
    sea = Twins("a", "b")
    sea.run(5.0, sea.THERE)
    sea.boats[sea.HERE].hear = lambda data: None  # type: ignore[method-assign]
    sea.run(10.0, sea.HERE)
    sea.fleet.command(1, "mode", {"mode": "hold"}, lambda well, why: sea.answers.append((well, why)))
    sea.run(1.0, sea.HERE)
    assert (sea.boats[sea.THERE].mode, sea.answers, sea.alarms) == (5, [(True, "")], [])


def test_addresses_of_one_number_are_bounded() -> None:
    sea = Twins("a", "b")
    sea.run(2.0)
    for n in range(300):
        FakeBoat(1, sea.clock, lambda data, n=n: sea.fleet.receive(("udp", "10.0.1.1", n), data)).tick()
    sea.run(5.0)
    assert len(sea.fleet._ways.to_stop(1, sea.clock.monotonic_s())) <= 9
    assert sea.shown["twins"][0] == "10.0.0.3:14550"


def test_invented_boats_give_way_and_those_that_are_used_stay() -> None:
    sea = Sea(1, 2)
    sea.run(2.0)
    sea.ask(1, "hold")
    for n in range(100, 200):
        FakeBoat(n, sea.clock, lambda data, n=n: sea.fleet.receive(("udp", "10.0.1.1", n), data)).tick()
    assert len(sea.fleet.boats) == 32
    assert {1, 2} <= set(sea.fleet.boats)
    sea.run(10.0)
    late = FakeBoat(77, sea.clock, lambda data: sea.fleet.receive(("udp", "10.0.1.1", 77), data))
    sea.boats[1].tick = lambda: None  # type: ignore[method-assign]
    sea.run(30.0)
    late.tick()
    assert 77 in sea.fleet.boats, "one that had fallen silent made room"
    assert {1, 2} <= set(sea.fleet.boats), "the silent one is the operator's, the other one speaks"
    assert len(sea.fleet.boats) == 32
    sea.ask(2, "hold")
    sea.run(1.0)
    assert sea.boats[2].mode == 5, "and is reached, though many addresses spoke since"


def test_another_console_with_our_number_is_told_of_once_a_minute() -> None:
    sea = Sea(1)
    other = mavlink.MAVLink(None, 231, 190)
    sea.fleet.me = 231
    for _ in range(90):
        beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(other)
        sea.fleet.receive(("serial", "/dev/ttyUSB0"), beat)
        sea.run(1.0)
    texts = [each["text"] for each in sea.told if each["t"] == "text" and each["boat"] is None]
    words = "a console on /dev/ttyUSB0 has our number, 231: start one of the two with another --number"
    assert texts == [words] * 2


def test_a_boat_says_who_commands_and_the_console_knows_whether_it_is_meant() -> None:
    sea = Sea(1)
    sea.fleet.me = 231
    sea.run(2.0)
    for number, mine in ((250, False), (231, True), (0, True)):
        sea.boats[1].say(mavlink.MAVLink_named_value_int_message(0, b"OWNER", number))
        sea.run(0.5)
        assert (sea.shown(1)["owner"], sea.shown(1)["commander"]) == (mine, number)


def test_signed_links_take_nothing_else(tmp_path: Any) -> None:
    keygen(tmp_path / "key")
    assert (tmp_path / "key").stat().st_mode & 0o777 == 0o600
    with pytest.raises(ConfigError, match="exists"):
        keygen(tmp_path / "key")
    key = Key(tmp_path / "key")
    sea = Sea(1, secret=key.secret, key=key)
    sea.run(3.0)
    sea.ask(1, "hold")
    sea.run(1.0)
    assert (sea.answers, sea.boats[1].mode) == ([(True, "")], 5)
    stranger = FakeBoat(1, sea.clock, lambda data: sea.fleet.receive(1, data))
    stranger.position = [0, 0]
    stranger.tick()
    assert sea.shown(1)["latitude_deg"] == pytest.approx(38.6901)
    assert sea.fleet._peers[1].counts["refused"] >= 1
    first = Key(tmp_path / "key").stamp()
    assert Key(tmp_path / "key").stamp() > first, "a stamp never goes back, not even over a restart"


def test_what_was_recorded_and_is_played_again_changes_nothing(tmp_path: Any) -> None:
    keygen(tmp_path / "key")
    key = Key(tmp_path / "key")
    sea = Sea(1, secret=key.secret, key=key)
    recorded: list[bytes] = []
    hear = sea.boats[1].hear
    sea.boats[1].hear = lambda data: (recorded.append(data), hear(data))[1]
    sea.run(3.0)
    sea.ask(1, "play")
    sea.run(1.0)
    obeyed = len(sea.boats[1].obeyed)
    for data in recorded:
        hear(data)
    assert len(sea.boats[1].obeyed) == obeyed == 1


def test_a_profile_sets_the_rates(sea: Sea) -> None:
    sea.ask(1, "profile", profile="lean")
    sea.run(3.0)
    assert sea.boats[1].profile == 0
    assert (sea.answers, sea.shown(1)["link"]["profile"]) == ([(True, "")], "lean")


def test_tracks_hold_a_point_a_second_and_no_more_than_ten_hours(sea: Sea) -> None:
    sea.run(60.0)
    assert 55 <= len(sea.fleet.boats[1].track) <= 65
    assert sea.fleet.boats[1].track.maxlen == 36_000


def test_boats_are_never_mixed(sea: Sea) -> None:
    """Words, thrust, missions and releases for one of three by turns: the others hear nothing but heartbeats and time."""
    sea = Sea(1, 2, 3)
    sea.run(3.0)
    turns = random.Random(5)
    wanted: dict[int, int] = {1: 0, 2: 0, 3: 0}
    for n in range(60):
        number = turns.choice((1, 2, 3))
        match turns.randrange(3):
            case 0:
                sea.ask(number, turns.choice(("hold", "idle", "path")))
                wanted[number] += 1
            case 1:
                sea.fleet.input(number, n, float(number), float(number))
            case _:
                sea.fleet.release(number, "test")
        sea.run(1.2)
    assert {n: len(boat.obeyed) for n, boat in sea.boats.items()} == wanted
    for number, boat in sea.boats.items():  # FakeBoat fails for whatever names another boat
        assert set(boat.thrust) <= {(10 * number, 0), (0, 0)}


def test_a_zone_of_the_plan_is_not_shown_as_one_that_the_boat_keeps(sea: Sea) -> None:
    sea.fleet.put(1, SQUARE)
    assert (sea.shown(1)["fence"], sea.shown(1)["obstacles"], sea.shown(1)["home"]) == ([], [], None)
    sea.fleet.upload(1, lambda well, why: sea.answers.append((well, why)))
    sea.run(30.0, until=lambda: sea.answers)
    assert len(sea.shown(1)["fence"]) == 3
    assert sea.shown(1)["home"] is not None


def test_what_a_boat_said_is_shown_with_its_age(sea: Sea) -> None:
    assert sea.shown(1)["reason_age_s"] is None
    sea.boats[1].say(mavlink.MAVLink_statustext_message(4, b"navigation silent for 1.0 s: warn", 0, 0))
    sea.run(5.0)
    assert sea.shown(1)["reason_age_s"] == pytest.approx(5.0, abs=0.2)


def test_a_boat_with_another_time_is_not_shown_but_told(tmp_path: Path) -> None:
    keygen(tmp_path / "key")
    here, aboard = (ManualClock(time_ns=1_795_000_000_000_000_000 + ns) for ns in (0, 3 * 3_600_000_000_000))
    key, told = Key(tmp_path / "key", here), list[dict[str, Any]]()
    fleet = Fleet(here, lambda address, data: None, told.append, key)
    beat = mavlink.MAVLink_heartbeat_message(12, 0, 0, 0, 4, 3)
    frame = wire.Sender(4, 1, key.secret, Signing(key.secret, aboard).stamp).pack(beat)
    for _ in range(2):
        fleet.receive("udp", frame)
    assert fleet.snapshot() == []
    assert [(each["severity"], each["text"]) for each in told] == [
        (2, "boat 4 signs 180 minutes ahead of the clock here, and is not believed: one of the two clocks is wrong")
    ]


@pytest.mark.parametrize(
    ("here", "aboard", "words"),
    [
        ("key", "other", "boat 4 is heard, and signs with another key than this console's (--key)"),
        ("key", "", "boat 4 is heard, and signs nothing: a console with a key (--key) believes only who signs with it"),
        ("", "key", "boat 4 obeys nothing from here, no STOP either: she signs, and this console has no key (--key)"),
        ("", "", ""),
        ("key", "key", ""),
    ],
)
def test_another_key_than_the_boats_is_told(tmp_path: Path, here: str, aboard: str, words: str) -> None:
    """Else there is no boat and no reason, or one whose STOP does nothing."""
    for name in ("key", "other"):
        keygen(tmp_path / name)
    clock, told = ManualClock(), list[dict[str, Any]]()
    fleet = Fleet(clock, lambda address, data: None, told.append, Key(tmp_path / here, clock) if here else None)
    secret = Key(tmp_path / aboard, clock).secret if aboard else None
    boat = FakeBoat(4, clock, lambda data: fleet.receive("udp", data), secret)
    boat.tick()
    assert [each["text"] for each in told if each.get("alarm") == "console"] == ([words] if words else [])


def test_a_stranger_alarms_nobody_who_has_a_boat(tmp_path: Path) -> None:
    keygen(tmp_path / "key")
    key = Key(tmp_path / "key")
    sea = Sea(1, secret=key.secret, key=key)
    sea.run(3.0)
    FakeBoat(4, sea.clock, lambda data: sea.fleet.receive(4, data)).tick()
    assert not [each for each in sea.told if each.get("alarm") == "console"]


def test_with_a_key_a_whole_fleet_has_room(tmp_path: Path) -> None:
    keygen(tmp_path / "key")
    clock, key = ManualClock(), Key(tmp_path / "key")
    fleet = Fleet(clock, lambda address, data: None, lambda message: None, key)
    for number in range(1, 200):
        FakeBoat(number, clock, lambda data, n=number: fleet.receive(("broker", str(n)), data), key.secret).tick()  # type: ignore[misc]
    assert len(fleet.snapshot()) == 199
