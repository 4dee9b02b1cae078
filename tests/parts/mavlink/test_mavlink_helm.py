"""Who may command: every command there is, by whoever may send it, signed and not, as docs/mavlink.md has it.

A console is known by its system, its component and what it speaks by: two that call themselves by one number are two.
"""

import math
from types import SimpleNamespace

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.parts.mavlink import commands, handlers
from delfim.parts.mavlink.peers import PEERS
from delfim.parts.mavlink.signing import Signing
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
