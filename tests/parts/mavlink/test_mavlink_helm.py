"""Who may command: every command there is, by whoever may send it, signed and not, as docs/mavlink.md has it.

A console is known by its system, its component and what it speaks by: two that call themselves by one number are two.
"""

import math
from types import SimpleNamespace

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import ownorders
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.peers import PEERS
from delfim.parts.mavlink.received import commands, handlers
from delfim.parts.mavlink.station import Station
from delfim.vehicle import console
from tests.parts.mavlink.mavlink_console import Console, Radio, newest, texts

ACCEPTED, LATER = 0, 1
KEY = bytes(range(32))
MISSION = """
version = 1
name = "test"
waypoint = [{ latitude_deg = 38.6930, longitude_deg = -9.2150 }, { latitude_deg = 38.6934, longitude_deg = -9.2150 }]
"""
NAN = math.nan
ORDER, STOP, TAKE, ASK = "order", "stop", "take", "ask"
TABLE = [  # command, its numbers, what kind of a command it is
    (176, (1, 3), ORDER),
    (176, (1, 4), STOP),
    (400, (1,), ORDER),
    (400, (0,), STOP),
    (185, (1,), STOP),
    (300, (), ORDER),
    (224, (1,), ORDER),
    (20, (), ORDER),
    (43002, (1, 90.0), ORDER),
    (192, (-1, 1, 0, NAN, 38.6930, -9.2150), ORDER),
    (178, (1, 0.5), ORDER),
    (193, (0,), ORDER),
    (246, (0, 0, 1), ORDER),
    (32100, (0, 1), TAKE),
    (511, (33, 1e6), ASK),
    (512, (148,), ASK),
    (2600, (0,), ASK),
]
MESSAGES = [  # whatever else changes something
    ("set_mode", (1, 1, 3)),
    ("manual_control", (1, 500, 0, 0, 0, 0)),
    ("mission_set_current", (1, 1, 1)),
    ("mission_count", (1, 1, 0, 0)),
    ("mission_clear_all", (1, 1, 0)),
    ("param_set", (1, 1, b"SPEED_MAX", 1.8, 9)),
]
PLACES = {"owner": 14550, "other": 14551, "namesake": 14552, "guest": 14553}


def at_sea(make_boat, key: bytes | None) -> SimpleNamespace:
    """A boat with a mission, its owner, and the others that are heard."""
    boat, log, radio = make_boat(), [], Radio()
    boat.clock.step(16 * 365 * 86_400.0)  # to after 2015, when time stamps begin
    vehicle = boat.vehicle
    vehicle.helm.settings = config.Vehicle(boat=config.BoatTable(name="test", id=1))

    def obey(command: console.Commands, operator: str) -> str | None:
        log.append(command)
        return vehicle.on_command(command, operator)

    station = Station(vehicle, obey, radio, Signing(key, boat.clock) if key else None)
    sea = SimpleNamespace(boat=boat, state=boat.state, station=station, radio=radio, log=log, consoles={})
    boat.ready()
    vehicle.on_command(console.LoadMission(MISSION))
    for link, (who, port) in enumerate(PLACES.items()):
        sea.consoles[who] = spoken(sea, who, port, key, link)
    return sea


def spoken(sea, who: str, port: int, key: bytes | None, link: int) -> Console:
    numbers = {"owner": (250, 190), "namesake": (250, 190), "other": (251, 190), "guest": (1, 191)}[who]
    return Console(
        sea.station,
        sea.radio,
        numbers[0],
        ("127.0.0.1", port),
        Signing(key, sea.boat.clock) if key else None,
        numbers[1],
        link,
    )


@pytest.fixture
def sea(make_boat):
    return at_sea(make_boat, None)


def test_no_command_is_forgotten():
    assert {number for number, _, _ in TABLE} == commands.COMMANDS.keys() | handlers._REQUESTS.keys()


@pytest.mark.parametrize("key", [None, KEY], ids=["without-key", "signed"])
@pytest.mark.parametrize("who", PLACES)
@pytest.mark.parametrize(("number", "numbers", "kind"), TABLE)
def test_who_may_give_which_command(make_boat, number, numbers, kind, who, key):
    sea = at_sea(make_boat, key)
    sea.consoles["owner"].mode(0)
    if number == 246:  # in idle only
        sea.consoles["owner"].mode(4)
    before, owner = sea.state.mode, sea.station.consoles.commander
    assert owner.party == (250, 190)
    result, words = sea.consoles[who].command(number, *numbers)
    refused = (who != "owner" and kind == ORDER) or (who == "guest" and kind == TAKE)
    assert (result, sea.state.mode is before or not refused) == (LATER if refused else ACCEPTED, True)
    if refused:
        named = {"other": "console 250 commands", "namesake": "another console 250 commands"}.get(who, "the guest computer")
        assert named in words
    assert sea.station.consoles.commander == (
        sea.station.consoles.peers.known[sea.consoles[who].address].source if kind == TAKE and not refused else owner
    )
    if kind == STOP:
        assert sea.state.mode is Mode.IDLE


WORDS = (  # the same in the boat's own words
    {"command": "mode", "mode": "heading"},
    {"command": "stop"},
    {"command": "arm"},
    {"command": "play"},
    {"command": "heading", "heading_deg": 90},
    {"command": "course", "course_deg": 90},
    {"command": "goto", "latitude_deg": 38.6930, "longitude_deg": -9.2150},
    {
        "command": "trial",
        "begin": True,
        "number": 1,
        "pieces": [[1.0, [0.1, 0.1]]],
        "latitude_deg": 38.6907,
        "longitude_deg": -9.2153,
        "radius_m": 60.0,
    },
    {"command": "speed", "speed_mps": 0.5},
    {"command": "pause"},
    {"command": "continue"},
    {"command": "reset"},
    {"command": "clear"},
    {"command": "take"},
    {"command": "overrule"},
    {"command": "payload", "name": "camera"},
    {"command": "order", "name": "pay_out"},
)


def test_no_order_is_forgotten():
    orders = {word for word, kind in console.KINDS.items() if issubclass(kind, console.OperatorOrder)}
    assert {each["command"] for each in WORDS} == orders


@pytest.mark.parametrize("key", [None, KEY], ids=["without-key", "signed"])
@pytest.mark.parametrize("who", PLACES)
@pytest.mark.parametrize("words", WORDS, ids=lambda words: words["command"])
def test_who_may_give_which_order(make_boat, words, who, key):
    sea = at_sea(make_boat, key)
    word = words["command"]
    sea.consoles["owner"].mode(0)
    if word == "reset":  # in idle only
        sea.consoles["owner"].mode(4)
    if word == "continue":
        sea.consoles["owner"].mode(3)
        sea.consoles["owner"].order({"command": "pause"}, 7)
    before, owner = sea.state.mode, sea.station.consoles.commander
    sea.log.clear()
    refused = sea.consoles[who].order(words, 8)
    if who == "owner" or word == "stop" or (word == "take" and who != "guest"):
        assert bool(refused) == (word in ("payload", "order", "clear")), "there is nothing of the kind"
        assert [type(each) for each in sea.log] == [console.KINDS[word]]
    else:
        named = {"other": "console 250 commands", "namesake": "another console 250 commands"}.get(who, "the guest computer")
        assert named in refused
        assert (sea.log, sea.state.mode, sea.station.consoles.commander) == ([], before, owner)


def test_an_order_that_comes_again_is_obeyed_once_and_answered_again(make_boat):
    """Signed, so that it is one console by whichever way it comes."""
    sea = at_sea(make_boat, KEY)
    owner, words = sea.consoles["owner"], {"command": "speed", "speed_mps": 0.5}
    assert owner.order(words, 0xDEADBEEF) == ""
    owner.address = ("127.0.0.1", 14570)
    assert owner.order(words, 0xDEADBEEF) == ""
    assert owner.order({"command": "arm"}, 0xDEADBEEF) == "", "by its number"
    assert [type(each) for each in sea.log] == [console.SetSpeed]
    assert owner.order({"command": "play", "leg": 99}, 2) == owner.order({"command": "play", "leg": 99}, 2) != ""
    for number in range(3, 3 + 2 * handlers.ANSWERS_KEPT):
        owner.order({"command": "speed", "speed_mps": 0.5}, number)
    assert len(sea.station.consoles.answered) == handlers.ANSWERS_KEPT


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ({"command": "shutdown"}, "shutdown is no order of a console on a link"),
        ({"command": "kill", "by": "switch", "switch": "on"}, "kill is no order of a console on a link"),
        ({"command": "mission", "text": ""}, "mission is no order of a console on a link"),
        ({"command": "dance"}, "command not understood: there is no command 'dance'"),
        ({"command": "heading"}, "command not understood: heading needs heading_deg"),
        ({"command": "heading", "heading_deg": 400}, "command not understood: heading_deg must be -360.0 to 360.0"),
        (
            {"command": "goto", "latitude_deg": 38.7},
            "command not understood: goto needs a latitude and a longitude, or neither",
        ),
        (
            {"command": "speed", "speed_mps": 1, "speed_pct": 1},
            "command not understood: speed is either speed_mps or speed_pct",
        ),
        ({"command": "stop", "now": True}, "command not understood: stop has no 'now'"),
        ([], "command not understood: it names no command"),
    ],
)
def test_what_is_no_order_of_a_console_is_refused_in_words(sea, words, why):
    sea.consoles["owner"].mode(0)
    sea.log.clear()
    before = len(sea.radio.sent)
    assert sea.consoles["owner"].order(words) == why
    assert texts(sea.consoles["owner"].listen(before)).strip() == why, "and everybody hears it"
    assert sea.log == []


def test_an_order_is_for_the_boat_that_it_names(sea):
    owner = sea.consoles["owner"]
    assert owner.order({"command": "arm"}, target=0) is None
    assert owner.order({"command": "arm"}, target=2) is None
    answer = ownorders.answer((1, 1), 1, "")
    assert owner.deliver(owner.sender.pack(answer)) == []
    assert owner.say("v2_extension", 0, 1, 1, 7, [*b"{}", *bytes(247)]) == []
    assert sea.log == []


def test_a_percentage_is_of_the_boats_top_speed(sea):
    assert sea.consoles["owner"].order({"command": "speed", "speed_pct": 50}) == ""
    top_mps = sea.boat.vehicle.helm.settings.control.speed.max_mps
    assert sea.state.setpoint.override_mps == pytest.approx(top_mps / 2.0)


@pytest.mark.parametrize("key", [None, KEY], ids=["without-key", "signed"])
@pytest.mark.parametrize("who", PLACES)
@pytest.mark.parametrize(("name", "fields"), MESSAGES)
def test_who_may_change_anything_else(make_boat, name, fields, who, key):
    sea = at_sea(make_boat, key)
    sea.consoles["owner"].mode(0)
    sea.log.clear()
    heard = sea.consoles[who].say(name, *fields)
    asked = any(m.get_type() == "MISSION_REQUEST_INT" for m in heard)
    assert (bool(sea.log) or asked) is (who == "owner"), heard


@pytest.mark.parametrize("who", PLACES)
@pytest.mark.parametrize(("number", "numbers", "kind"), TABLE)
def test_where_there_is_a_key_nothing_unsigned_is_heard(make_boat, number, numbers, kind, who):
    sea = at_sea(make_boat, KEY)
    sea.consoles["owner"].mode(0)
    sea.log.clear()
    heard = spoken(sea, who, 14560, None, 0).say("command_long", 1, 1, number, 0, *numbers, *[0.0] * (7 - len(numbers)))
    assert heard == []
    assert sea.log == []
    assert sea.station.consoles.counts == {"unsigned": 1}


# Two that call themselves by one number.


@pytest.mark.parametrize("key", [None, KEY], ids=["without-key", "signed"])
def test_a_console_does_not_hide_the_silence_of_another_with_its_number(make_boat, key):
    sea = at_sea(make_boat, key)
    sea.consoles["owner"].command(43002, 1, 90.0)
    for _ in range(12):
        sea.consoles["namesake"].beat()
        sea.boat.pass_time(1.0)
        sea.station.tick()
    assert sea.state.mode is Mode.HOLD
    assert sea.state.reason.startswith("console silent")


@pytest.mark.parametrize("key", [None, KEY], ids=["without-key", "signed"])
@pytest.mark.parametrize(
    ("who", "restarted", "mode"),
    [("owner", "it was in heading", Mode.HEADING), ("other", "it was in heading", Mode.HOLD), ("owner", "", Mode.HOLD)],
)
def test_the_console_that_commanded_is_not_silent_after_a_restart(make_boat, key, who, restarted, mode):
    sea = at_sea(make_boat, key)
    sea.consoles["owner"].command(43002, 1, 90.0)
    sea.station.consoles.commander, sea.state.restarted = None, restarted  # what a program that was started again knows
    for _ in range(12):
        sea.consoles[who].beat()
        sea.boat.pass_time(1.0)
        sea.station.tick()
    assert sea.state.mode is mode
    assert (sea.station.consoles.commander is not None) == (mode is Mode.HEADING)


@pytest.mark.parametrize("key", [None, KEY], ids=["without-key", "signed"])
def test_the_guest_computer_takes_no_boat_whose_owner_is_silent(make_boat, key):
    sea = at_sea(make_boat, key)
    sea.consoles["owner"].mode(3)
    for _ in range(14):
        sea.consoles["guest"].beat()
        sea.boat.pass_time(1.0)
        sea.station.tick()
    for number, numbers in ((176, (1, 3)), (300, ()), (32100, (0, 1))):
        assert sea.consoles["guest"].command(number, *numbers)[0] == LATER
    assert sea.station.consoles.commander.party == (250, 190)
    assert sea.consoles["other"].mode(3)[0] == ACCEPTED, "another console does"


def test_consoles_with_one_number_are_told_so_and_it_is_over_when_one_goes(sea):
    words = "two consoles have number 250: 127.0.0.1:14550 and 127.0.0.1:14552; give one of them another number"
    heard = []
    for _ in range(4):
        before = len(sea.radio.sent)
        sea.consoles["owner"].beat()
        sea.consoles["namesake"].beat()
        sea.boat.pass_time(1.0)
        sea.station.tick()
        heard += sea.consoles["owner"].listen(before)
    assert texts(heard).count(words) == 1
    line = next(each for each in sea.boat.vehicle.helm.checks() if each.name == "link")
    assert (line.ok, line.reason) == (False, words)
    for _ in range(20):
        sea.consoles["owner"].beat()
        sea.boat.pass_time(1.0)
        sea.station.tick()
    assert sea.state.namesakes == ""


def test_a_console_that_moved_is_one(make_boat):
    """Signed, it is known by its link wherever it is, and commands on."""
    sea = at_sea(make_boat, KEY)
    here = sea.consoles["owner"]
    for port in (14550, 14570):
        here.address = ("127.0.0.1", port)
        for _ in range(3):
            here.beat()
            sea.boat.pass_time(1.0)
            sea.station.tick()
        assert here.mode(3)[0] == ACCEPTED
    assert sea.state.namesakes == ""


def test_an_upload_is_of_one_console_though_two_have_its_number(sea):
    first, second = sea.consoles["owner"], sea.consoles["namesake"]
    first.say("mission_count", 1, 1, 1, 0)
    second.say("mission_item_int", 1, 1, 0, 6, 16, 0, 1, 0.0, 0.0, 0.0, NAN, 386_999_000, -92_150_000, 0.0, 0)
    assert sea.log == []
    first.say("mission_item_int", 1, 1, 0, 6, 16, 0, 1, 0.0, 0.0, 0.0, NAN, 386_930_000, -92_150_000, 0.0, 0)
    assert sea.log[0].mission.waypoint[0].latitude_deg == 38.6930


# More that speak than there is room for.


def test_invented_peers_keep_nobody_out(make_boat):
    """The boat's own consoles, the one that commands and a newcomer are heard, whatever else speaks."""
    boat, radio = make_boat(), Radio()
    boat.vehicle.helm.settings = config.Vehicle(boat=config.BoatTable(name="test", id=1))  # which says hello to port 14550
    station = Station(boat.vehicle, boat.vehicle.on_command, radio, None)
    sea = SimpleNamespace(station=station, radio=radio, boat=boat)
    boat.ready()
    owner = Console(station, radio, 252, ("127.0.0.1", 14600))
    assert owner.mode(3)[0] == ACCEPTED
    for port in range(20_000, 20_000 + 3 * PEERS):
        boat.clock.advance(0.1)
        Console(sea.station, radio, 251, ("127.0.0.1", port)).beat()
    assert len(station.consoles.peers.known) == PEERS
    assert {("127.0.0.1", 14550), owner.address} <= station.consoles.peers.known.keys()
    assert newest(Console(station, radio, 255, ("127.0.0.1", 14601)).say("timesync", 0, 7), "TIMESYNC").ts1 == 7
    assert owner.mode(4)[0] == ACCEPTED
    assert station.consoles.counts["peers_replaced"] == 2 * PEERS + 3
