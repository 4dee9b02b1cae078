"""Missions as items and back, and the protocol that carries them, over a link that loses, doubles and reorders."""

import math
import struct
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.cooperative import Sliced
from delfim.base.errors import FormatError
from delfim.base.modes import Mode
from delfim.parts.mavlink import missions
from delfim.parts.mavlink.codec import plans
from delfim.parts.mavlink.codec.plans import FENCE, MISSION, RALLY, Item
from delfim.vehicle import console
from delfim.vehicle.plans.mission import CARRIED, HOLD_MAX_S, Mission, PathPoint, Waypoint, canonical, parse_mission
from delfim.vehicle.plans.missionreader import gathered, written
from delfim.vehicle.report import Announced
from tests.parts.mavlink.mavlink_console import Console, messages, newest, texts
from tests.parts.mavlink.test_mavlink_station import afloat, sail

OK, INVALID, DENIED, UNSUPPORTED = 0, 5, 14, 3


@pytest.fixture
def sea(boat):
    return afloat(boat)


def zigzag(count: int, speed_mps: float = 0.0) -> Mission:
    """North in steps of 20 m, off where the boat lies."""
    places = ((386_926_000 + 1_800 * n, -92_150_000 + 2_000 * (n % 2)) for n in range(count))
    return Mission(
        version=1,
        name="zigzag",
        waypoint=tuple(Waypoint(latitude_deg=x / 1e7, longitude_deg=y / 1e7, speed_mps=speed_mps) for x, y in places),
    )


def fields(number: int, item: Item, kind: int) -> tuple[object, ...]:
    return (1, 1, number, item.frame, item.command, 0, 1, item.p1, item.p2, item.p3, item.p4, item.x, item.y, item.z, kind)


def items_of(mission: Mission) -> list[Item]:
    return list(plans.mission_items(mission))


def drafted(draft, items):
    for number, item in enumerate(items):
        draft.add(number, item)
    return draft


def told(items, frame: int = plans.PLACED) -> plans.Told:
    return Sliced(plans.told(None, items, frame)).finish()


def checksum(items, frame: int = plans.PLACED) -> int:
    return told(items, frame).checksum


def upload(console_: Console, items: list[Item], kind: int = MISSION) -> list:
    """Over a link that loses nothing; all that came back."""
    items = list(items)
    heard = console_.say("mission_count", 1, 1, len(items), kind)
    for number, item in enumerate(items):
        if any(m.get_type() == "MISSION_ACK" for m in heard):
            break  # refused already
        assert newest(heard, "MISSION_REQUEST_INT").seq == number
        heard += console_.say("mission_item_int", *fields(number, item, kind))
    return heard


def download(console_: Console, kind: int = MISSION) -> list[Item]:
    count = newest(console_.say("mission_request_list", 1, 1, kind), "MISSION_COUNT").count
    answers = [newest(console_.say("mission_request_int", 1, 1, n, kind), "MISSION_ITEM_INT") for n in range(count)]
    return [Item(m.command, m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z, m.frame) for m in answers]


# Items.

degrees_e7 = st.integers(-889_999_999, 889_999_999).filter(lambda value: value != 0)
places = st.tuples(degrees_e7, degrees_e7)
milli = st.integers(0, 10_000).map(lambda value: value / 1000.0)
waypoints = st.builds(
    lambda place, speed, reach, hold: Waypoint(
        latitude_deg=place[0] / 1e7, longitude_deg=place[1] / 1e7, speed_mps=speed, acceptance_m=reach, hold_s=hold
    ),
    places,
    milli,
    milli,
    milli,
)
pieces = st.builds(
    lambda place, turn: PathPoint(latitude_deg=place[0] / 1e7, longitude_deg=place[1] / 1e7, turn_deg=turn, radius_m=10.0),
    places,
    st.integers(-360_000, 360_000).map(lambda value: value / 1000.0),
)


@given(st.lists(waypoints, min_size=1, max_size=20), st.lists(pieces, max_size=5))
def test_a_mission_comes_back_as_it_was_sent(points, path):
    mission = Mission(version=1, name="any", waypoint=tuple(points), path=tuple(path))
    items = [single(item) for item in plans.mission_items(mission)]
    back = drafted(plans.MissionDraft(), items).done("any", config.Zones())
    assert back == mission
    assert checksum(items) == checksum(plans.mission_items(back))


def single(item: Item) -> Item:
    """As it travels: in single precision."""
    return item._replace(
        **{name: struct.unpack("<f", struct.pack("<f", getattr(item, name)))[0] for name in ("p1", "p2", "p3")}
    )


def test_a_fence_and_harbours_come_back_as_they_were_sent():
    ring = ((38.69, -9.22), (38.69, -9.21), (38.70, -9.21))
    zones = config.Zones(
        keep_in=(config.Area(polygon=ring), config.Area(centre=((38.7, -9.2),), radius_m=100.0), config.Area(polygon=ring)),
        keep_out=(config.Area(polygon=ring), config.Area(centre=((38.695, -9.215),), radius_m=12.5)),
    )
    assert drafted(plans.ZonesDraft(), plans.fence_items(zones)).done() == zones
    assert drafted(plans.RallyDraft(), plans.rally_items(ring)).done() == ring


def test_the_checksum_is_that_of_mavlink_ftp():
    """Of no bytes it is 0; of one item it was computed once by hand, bit by bit."""
    assert checksum([]) == 0
    data = plans._CHECKED.pack(5, 16, 1, 0.0, 3.0, 0.0, 0.0, 386_909_000, -92_149_000, 0.0)
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    assert checksum([Item(16, 0.0, 3.0, x=386_909_000, y=-92_149_000)], frame=5) == crc


@pytest.mark.parametrize(
    ("item", "result", "reason"),
    [
        (Item(177, 1.0), UNSUPPORTED, "item 1: DO_JUMP (177) is not something this boat does"),
        (Item(22, x=1, y=1), UNSUPPORTED, "item 1: NAV_TAKEOFF (22)"),
        (Item(206, math.inf), INVALID, "item 1: inf is not a number"),
        (Item(18, 3.0, x=386_930_000, y=-92_150_000), UNSUPPORTED, "item 1: NAV_LOITER_TURNS (18)"),
        (Item(93, -1.0, 12.0), UNSUPPORTED, "item 1: this boat cannot wait for a time of day"),
        (Item(60_000), UNSUPPORTED, "item 1: command 60000"),
        (Item(93, math.nan), INVALID, "item 1: nan is not a number"),
        (Item(93, 1e6), INVALID, "item 1: hold_s must be 0.0 to 86400.0"),
        (Item(16, -5.0, x=386_930_000, y=-92_150_000), INVALID, "item 1: hold_s must be 0.0 to 86400.0"),
        (Item(16, 1e6, x=386_930_000, y=-92_150_000), INVALID, "item 1: "),
        (Item(19, math.inf, x=386_930_000, y=-92_150_000), INVALID, "item 1: inf is not a number"),
        (Item(16, 0.0, math.nan, x=386_930_000, y=-92_150_000), INVALID, "item 1: nan is not a number"),
        (Item(16, 0.0, -1.0, x=386_930_000, y=-92_150_000), INVALID, "item 1: acceptance_m must be 0.0 to 1000.0"),
        (Item(16, x=386_930_000, y=-92_150_000, frame=1), INVALID, "item 1: frame 1 has no latitude"),
        (Item(16), INVALID, "item 1: no such latitude and longitude"),
        (Item(16, x=2_000_000_000, y=0), INVALID, "item 1: no such latitude and longitude"),
        (Item(178, 1.0, math.inf), INVALID, "item 1: inf is not a number"),
    ],
)
def test_what_a_boat_cannot_do_is_refused_by_its_number(sea, item, result, reason):
    first = Item(16, x=386_926_000, y=-92_150_000)
    heard = upload(sea.console, [first, item])
    assert newest(heard, "MISSION_ACK").type == result
    assert reason in texts(heard)
    assert sea.vehicle.helm.plans.mission is None


def test_a_refused_item_has_the_number_that_the_console_gave_it(boat):
    sea = afloat(boat, autopilot="ardurover")
    heard = upload(sea.console, [Item(16, x=1, y=1), Item(16, x=386_926_000, y=-92_150_000), Item(177, 1.0)])
    assert "item 2: DO_JUMP" in texts(heard)


def test_a_stay_is_said_in_three_ways_and_told_back_in_one(sea):
    place, other = {"x": 386_926_000, "y": -92_150_000}, {"x": 386_928_000, "y": -92_150_000}
    assert newest(upload(sea.console, [Item(93, 5.0)]), "MISSION_ACK").type == INVALID, "a delay of nothing"
    heard = upload(sea.console, [Item(16, 10.0, **place), Item(93, 5.0), Item(93, 2.5), Item(19, 30.0, **other)])
    assert newest(heard, "MISSION_ACK").type == OK
    assert download(sea.console) == [Item(16, 17.5, **place), Item(16, 30.0, **other)]


HERE, THERE = {"x": 386_925_000, "y": -92_150_000}, {"x": 386_927_000, "y": -92_150_000}
CAMERA, SERVO = Item(206, 25.0, 0.0, 1.0, math.nan, frame=2), Item(183, 9.0, 1900.0, z=-0.1, frame=2)
floats = st.floats(width=32, allow_infinity=False, allow_nan=False) | st.just(math.nan)
integers = st.integers(-(2**31), 2**31 - 1)
carried = st.builds(
    Item, st.sampled_from(sorted(CARRIED)), floats, floats, floats, floats, integers, integers, floats, st.integers(0, 21)
)
stops = st.builds(lambda x: Item(16, x=386_900_000 + x, y=-92_150_000), st.integers(0, 1000))


@given(st.lists(st.one_of(stops, carried), max_size=30), stops, st.booleans())
def test_items_for_payloads_come_back_to_the_last_bit(items, stop, goes_home):
    items = [*items, stop, *([Item(20, frame=2)] if goes_home else [])]
    mission = drafted(plans.MissionDraft(), items).done("any", config.Zones())
    back = list(plans.mission_items(mission))
    assert packed(back) == packed(items)
    assert packed(plans.mission_items(drafted(plans.MissionDraft(), back).done("any", config.Zones()))) == packed(items)
    assert Sliced(gathered(list(written(mission)))).finish() == mission, "by the process that reads files"


def packed(items) -> bytes:
    return bytes(told(items).packed)


def test_a_mission_with_camera_servo_and_the_way_home(sea):
    """Up, down, sailed: announced once each, at their places, and home at the end."""
    items = [
        CAMERA,
        Item(16, 0.0, 8.0, **HERE),
        SERVO,
        CAMERA._replace(p1=0.0),
        Item(16, 0.0, 40.0, **THERE),
        SERVO,
        Item(20, frame=2),
    ]
    assert newest(upload(sea.console, items), "MISSION_ACK").type == OK
    assert packed(download(sea.console)) == packed(items)
    file = parse_mission(canonical(sea.vehicle.helm.plans.mission))
    assert packed(plans.mission_items(file)) == packed(items), "the file carries them, too"
    sea.console.command(300)
    heard = sail(sea, 3.0)
    assert [each.command for each in sea.state.announced] == [206, 183, 206, 183]
    assert sea.state.announced[0] == Announced(1, 206, (25.0, 0.0, 1.0, None, 0.0, 0.0, 0.0))
    assert "DO_SET_CAM_TRIGG_DIST (206): 25 0 1 - 0 0 0" in texts(heard)
    assert "home: play done" in texts(heard)
    sail(sea, 2.0)
    assert len(sea.state.announced) == 4


def test_each_console_is_told_of_samples_in_words(sea):
    assert newest(upload(sea.console, [Item(16, 1.0, 40.0, 0.0, 2.0, **HERE)]), "MISSION_ACK").type == OK
    sea.console.command(300)
    heard = sail(sea, 6.0)
    ends = "sample 1 is asked for, try 1 of 2", "sample 2 is asked for, try 2 of 2", "no sample: no answer for 1 s"
    assert " ".join(f"station: waypoint 1: {end}" for end in ends) in texts(heard)


def test_a_leg_that_goes_on_announces_nothing_again_and_one_begun_anew_does(sea):
    upload(sea.console, [CAMERA, Item(16, **THERE)])
    sea.console.command(300)
    sail(sea, 0.3)
    sea.console.mode(5)
    sail(sea, 0.3)
    sea.console.mode(10)
    sail(sea, 0.3)
    assert len(sea.state.announced) == 1
    sea.console.mode(4)
    sail(sea, 0.3)
    sea.console.command(300)
    sail(sea, 0.3)
    assert [each.number for each in sea.state.announced] == [1, 2]


@pytest.mark.parametrize(
    ("after", "stays_s", "then"),
    [([], 0.0, "hold"), ([Item(20)], HOLD_MAX_S, "home"), ([Item(16, **HERE)], HOLD_MAX_S, "hold"), ([SERVO], 0.0, "hold")],
)
def test_a_stay_without_end(after, stays_s, then):
    mission = drafted(plans.MissionDraft(), [Item(16, **HERE), Item(17, **THERE), *after]).done("any", config.Zones())
    assert (mission.waypoint[1].hold_s, mission.then) == (stays_s, then)


@pytest.mark.parametrize("behind", [Item(16, **HERE), SERVO, Item(20), Item(17, **HERE)])
def test_nothing_follows_the_way_home(behind):
    with pytest.raises(FormatError, match="item 2: the mission ends with NAV_RETURN_TO_LAUNCH"):
        drafted(plans.MissionDraft(), [Item(16, **HERE), Item(20), behind])


def test_the_boat_stays_that_long_and_then_goes_on(sea):
    """The first waypoint is where the boat lies."""
    here = {"x": 386_925_000, "y": -92_150_000}
    upload(sea.console, [Item(16, 20.0, 5.0, **here), Item(16, x=386_935_000, y=-92_150_000)])
    sea.console.command(300)
    for _ in range(19):
        sea.console.beat()
        sail(sea, 1.0)
    assert (sea.state.mode, sea.state.reference.leg, sea.state.actuation.thrust[0]) == (Mode.PLAY, 0, 0.0)
    heard = sail(sea, 3.0)
    assert (sea.state.mode, sea.state.reference.leg) == (Mode.PLAY, 1)
    assert sea.state.actuation.thrust[0] > 0.0
    assert newest(heard, "MISSION_ITEM_REACHED").seq == 0


@pytest.mark.parametrize(
    "items",
    [
        [Item(5001, 3.0, x=1, y=1)] * 2,
        [Item(5001, 4.0, x=n, y=n * n) for n in range(1, 4)],
        [Item(5001, math.nan, x=1, y=1)] * 3,
        [Item(5001, 2.0, x=1, y=1)] * 2,
        [Item(5002, 101.0, x=n, y=n * n) for n in range(1, 102)],
        [Item(5004, 0.0, x=1, y=1)],
        [Item(5003, 0.0, x=1, y=1)],
        [Item(5004, 10.0, x=n, y=1) for n in range(1, 102)],
        [Item(5003, 10.0, x=n, y=1) for n in range(1, 22)],
        [Item(5001, 3.0, x=n, y=n * n) for n in range(1, 64)],
        [Item(5005, 10.0, x=1, y=1)],
    ],
)
def test_zones_that_make_no_sense(items):
    with pytest.raises(FormatError, match="item "):
        drafted(plans.ZonesDraft(), items).done()


# The protocol.


def test_up_down_and_the_checksum_is_everybodys(sea):
    mission = zigzag(20, speed_mps=1.2)
    heard = upload(sea.console, items_of(mission))
    assert newest(heard, "MISSION_ACK").type == OK
    assert newest(heard, "MISSION_CHECKSUM").checksum == checksum(plans.mission_items(mission))
    assert [single(item) for item in plans.mission_items(mission)] == download(sea.console)
    assert sea.vehicle.helm.plans.mission.waypoint == mission.waypoint
    assert isinstance(sea.log[-1], console.Upload), "through the one door"
    assert newest(sea.console.say("command_long", 1, 1, 512, 0, 53, 0, 0, 0, 0, 0, 0), "MISSION_CHECKSUM").mission_type == 0


@pytest.mark.parametrize("frame", sorted(plans.GLOBAL))
@pytest.mark.parametrize("autopilot", ["generic", "ardurover"])
def test_places_come_back_in_the_frame_in_which_they_were_sent(boat, autopilot, frame):
    sea = afloat(boat, autopilot=autopilot)
    ways = told(plans.mission_items(zigzag(3, speed_mps=1.2)), frame).items
    home = [Item(16, x=386_925_000, y=-92_150_000, frame=frame)] if autopilot == "ardurover" else []
    heard = upload(sea.console, [*home, *ways])
    assert download(sea.console) == [single(item) for item in [*home, *ways]]
    assert newest(heard, "MISSION_CHECKSUM").checksum == checksum(ways, frame)
    harbours = told(plans.rally_items([(38.69, -9.215)]), frame).items
    upload(sea.console, harbours, RALLY)
    assert download(sea.console, RALLY) == harbours


def test_a_boats_own_mission_file_is_told_item_by_item(sea):
    mission = zigzag(3)
    sea.vehicle.on_command(console.LoadMission(canonical(mission)))
    assert download(sea.console) == items_of(mission)


@pytest.mark.parametrize("seed", range(20))
def test_twenty_points_get_through_a_bad_link(sea, seed):
    """30 % of the datagrams lost, some doubled, some late, both ways; the console does what the protocol says."""
    random, mission = Random(seed), zigzag(20)
    items = items_of(mission)
    sender, way, ack, begun = sea.console, [], None, False
    sent = len(sea.radio.sent)
    for tick in range(3000):
        sea.boat.clock.advance(0.1)
        if not begun and tick % 10 == 0:
            way.append((tick + random.randrange(5), sender.frame("mission_count", 1, 1, len(items), MISSION)))
        arrived, way = [each for each in way if each[0] <= tick], [each for each in way if each[0] > tick]
        for _, datagram in arrived:
            for _ in range(random.choice((0, 1, 1, 2))):
                sender.deliver(datagram)
        sea.station.tick()
        heard = messages([data for data, _ in sea.radio.sent[sent:] if random.random() > 0.3])
        sent = len(sea.radio.sent)
        for message in heard:
            if message.get_type() == "MISSION_REQUEST_INT":
                begun = True
                frame = sender.frame("mission_item_int", *fields(message.seq, items[message.seq], MISSION))
                way.append((tick + random.randrange(5), frame))
            elif message.get_type() == "MISSION_ACK":
                ack = message.type
        if ack is not None:
            break
    assert ack in (OK, None), "the acknowledgement may be the one that is lost"
    assert sea.vehicle.helm.plans.mission.waypoint == mission.waypoint


def test_a_lost_acknowledgement_is_given_again(sea):
    items = items_of(zigzag(2))
    upload(sea.console, items)
    again = sea.console.say("mission_item_int", *fields(1, items[1], MISSION))
    assert newest(again, "MISSION_ACK").type == OK
    assert len(sea.log) == 1


def test_an_upload_that_stops_is_given_up_and_changes_nothing(sea):
    upload(sea.console, items_of(zigzag(3)))
    sea.console.say("mission_count", 1, 1, 5, MISSION)
    heard = sail(sea, 21.0)
    assert sum(m.get_type() == "MISSION_REQUEST_INT" for m in heard) >= 10, "it asks again"
    sea.console.beat()
    assert len(sea.vehicle.helm.plans.mission.waypoint) == 3


def test_a_new_upload_takes_the_place_of_the_one_before(sea):
    sea.console.say("mission_count", 1, 1, 5, MISSION)
    assert newest(upload(sea.console, items_of(zigzag(2))), "MISSION_ACK").type == OK
    assert len(sea.vehicle.helm.plans.mission.waypoint) == 2


def test_a_mission_that_is_played_is_changed_ahead_and_not_behind_and_not_cleared(sea):
    upload(sea.console, items_of(zigzag(3)))
    sea.console.command(300)
    sail(sea, 0.5)
    heard = upload(sea.console, items_of(zigzag(5, speed_mps=0.7)))
    assert newest(heard, "MISSION_ACK").type == OK
    assert newest(heard, "MISSION_CHECKSUM").checksum == checksum([*items_of(zigzag(5, speed_mps=0.7))])
    assert (sea.state.mode, len(sea.state.setpoint.plan.waypoints)) == (Mode.PLAY, 5)
    assert newest(upload(sea.console, items_of(zigzag(3))), "MISSION_ACK").type == OK
    there = Item(plans.WAYPOINT, x=386_927_000, y=-92_150_000)
    heard = upload(sea.console, [there, there._replace(y=-92_151_000)])
    assert newest(heard, "MISSION_ACK").type == DENIED
    assert "waypoint 1 is at another place, and the boat is on the leg to waypoint 1" in texts(heard)
    heard = upload(sea.console, [Item(plans.CIRCLE_OUT, 5.0, x=there.x, y=there.y - 10_000)], FENCE)
    assert newest(heard, "MISSION_ACK").type == OK
    heard = upload(sea.console, [Item(plans.CIRCLE_OUT, 50.0, x=there.x, y=there.y)], FENCE)
    assert newest(heard, "MISSION_ACK").type == DENIED
    heard = sea.console.say("mission_clear_all", 1, 1, 255)
    assert newest(heard, "MISSION_ACK").type == DENIED
    assert len(sea.vehicle.helm.plans.mission.waypoint) == 3


# A part of a plan.


def rewrite(console_: Console, first: int, items: list[Item], kind: int = MISSION) -> list:
    """Over a link that loses nothing; all that came back."""
    heard = console_.say("mission_write_partial_list", 1, 1, first, first + len(items) - 1, kind)
    for number, item in enumerate(items, first):
        if any(m.get_type() == "MISSION_ACK" for m in heard):
            break  # refused already
        assert newest(heard, "MISSION_REQUEST_INT").seq == number
        heard += console_.say("mission_item_int", *fields(number, item, kind))
    return heard


@pytest.mark.parametrize("autopilot", ["generic", "ardurover"])
@pytest.mark.parametrize(("first", "count"), [(0, 1), (7, 3), (19, 1), (19, 6), (20, 2), (0, 20), (0, 25)])
def test_a_part_of_a_mission_is_written_and_the_rest_stays(boat, autopilot, first, count):
    sea, homes = afloat(boat, autopilot=autopilot), int(autopilot == "ardurover")
    sail(sea, 0.5)
    before, after = items_of(zigzag(20)), items_of(zigzag(27))
    upload(sea.console, [Item(16, x=1, y=1)] * homes + before)
    part = [each._replace(y=each.y + 500) for each in after[first : first + count]]
    heard = rewrite(sea.console, first + homes, part)
    assert newest(heard, "MISSION_ACK").type == OK
    whole = [*before[:first], *part, *before[first + count :]]
    assert newest(heard, "MISSION_CHECKSUM").checksum == checksum(whole)
    assert download(sea.console)[homes:] == whole
    assert isinstance(sea.log[-1], console.Upload), "through the one door"


def test_the_home_item_alone_changes_nothing(boat):
    sea = afloat(boat, autopilot="ardurover")
    sail(sea, 0.5)
    upload(sea.console, [Item(16, x=1, y=1), *items_of(zigzag(3))])
    assert newest(rewrite(sea.console, 0, [Item(16, x=7, y=7)]), "MISSION_ACK").type == OK
    assert download(sea.console)[1:] == items_of(zigzag(3))


def test_a_part_of_the_fence_and_of_the_harbours_is_written(sea):
    rings = [Item(plans.CIRCLE_OUT, 5.0 + n, x=386_960_000 + 3_000 * n, y=-92_180_000) for n in range(4)]
    harbours = list(plans.rally_items([(38.69, -9.215), (38.691, -9.215)]))
    upload(sea.console, rings, FENCE)
    upload(sea.console, harbours, RALLY)
    assert newest(rewrite(sea.console, 2, [rings[2]._replace(p1=9.5)], FENCE), "MISSION_ACK").type == OK
    assert [each.p1 for each in download(sea.console, FENCE)] == [5.0, 6.0, 9.5, 8.0]
    assert newest(rewrite(sea.console, 1, [harbours[1]._replace(x=386_920_000)], RALLY), "MISSION_ACK").type == OK
    assert sea.vehicle.helm.plans.rally == ((38.69, -9.215), (38.692, -9.215))


def test_waypoints_ahead_of_a_boat_under_way_are_written_and_those_behind_are_not(sea):
    upload(sea.console, items_of(zigzag(5)))
    sea.console.command(300, 1)
    sail(sea, 0.5)
    ahead = [each._replace(y=each.y + 900) for each in items_of(zigzag(5))[3:]]
    assert newest(rewrite(sea.console, 3, ahead), "MISSION_ACK").type == OK
    assert (sea.state.mode, sea.state.reference.leg) == (Mode.PLAY, 1)
    aboard = items_of(zigzag(5))[:3] + ahead
    assert download(sea.console) == aboard
    heard = rewrite(sea.console, 0, [aboard[0]._replace(y=-92_151_000)])
    assert newest(heard, "MISSION_ACK").type == DENIED
    assert "waypoint 1 is at another place, and the boat is on the leg to waypoint 2" in texts(heard)
    assert (sea.state.mode, download(sea.console)) == (Mode.PLAY, aboard)


@pytest.mark.parametrize(("first", "last"), [(4, 4), (-1, 2), (2, 1), (0, 2000)])
def test_a_part_that_is_none_is_refused_in_words(sea, first, last):
    upload(sea.console, items_of(zigzag(3)))
    heard = sea.console.say("mission_write_partial_list", 1, 1, first, last, MISSION)
    assert newest(heard, "MISSION_ACK").type == 13
    assert f"items {first} to {last} are no part of a plan of 3" in texts(heard)


def test_an_item_that_makes_no_sense_ends_a_part_and_nothing_changes(sea):
    upload(sea.console, items_of(zigzag(3)))
    heard = rewrite(sea.console, 1, [Item(177), Item(16, **HERE)])
    assert newest(heard, "MISSION_ACK").type == UNSUPPORTED
    heard = rewrite(sea.console, 0, [Item(20)])
    assert newest(heard, "MISSION_ACK").type == INVALID
    assert "item 1: the mission ends with NAV_RETURN_TO_LAUNCH before it" in texts(heard), "the one that stays is in its way"
    assert download(sea.console) == items_of(zigzag(3))


def test_a_part_of_a_plan_that_changed_meanwhile_is_refused(sea):
    upload(sea.console, items_of(zigzag(3)))
    sea.console.say("mission_write_partial_list", 1, 1, 2, 2, MISSION)
    sea.vehicle.on_command(console.LoadMission(canonical(zigzag(8))))
    heard = sea.console.say("mission_item_int", *fields(2, items_of(zigzag(3))[2], MISSION))
    assert newest(heard, "MISSION_ACK").type == DENIED
    assert "the plan aboard changed while a part of it came" in texts(heard)
    assert len(sea.vehicle.helm.plans.mission.waypoint) == 8


def test_a_part_gets_through_when_items_and_the_answer_are_lost(sea):
    items = items_of(zigzag(6))
    upload(sea.console, items)
    moved = items[4]._replace(y=-92_149_000)
    sea.console.say("mission_write_partial_list", 1, 1, 4, 4, MISSION)
    heard = sail(sea, 2.5)
    assert {m.seq for m in heard if m.get_type() == "MISSION_REQUEST_INT"} == {4}, "it asks again"
    for _ in range(2):
        heard = sea.console.say("mission_item_int", *fields(4, moved, MISSION))
        assert newest(heard, "MISSION_ACK").type == OK
    assert (len(sea.log), download(sea.console)) == (2, [*items[:4], moved, items[5]])


def test_a_part_of_an_unknown_type_or_from_an_onlooker_is_refused(sea):
    upload(sea.console, items_of(zigzag(3)))
    assert newest(sea.console.say("mission_write_partial_list", 1, 1, 0, 0, 7), "MISSION_ACK").type == UNSUPPORTED
    other = Console(sea.station, sea.radio, system=251, address=("127.0.0.1", 14551))
    assert newest(other.say("mission_write_partial_list", 1, 1, 0, 0, MISSION), "MISSION_ACK").type == DENIED


def test_no_slice_of_a_part_takes_many_items(sea):
    """The items that stay go into the plan a few at a time, between other work."""
    upload(sea.console, items_of(zigzag(900)))
    sea.station.receive(sea.console.frame("mission_write_partial_list", 1, 1, 899, 899, MISSION), sea.console.address)
    turns = sum(1 for _ in iter(sea.station.turn, False))
    assert turns >= 899 // missions.KEPT


def test_clearing(sea):
    upload(sea.console, items_of(zigzag(3)))
    upload(sea.console, plans.rally_items([(38.69, -9.2)]), RALLY)
    assert newest(sea.console.say("mission_clear_all", 1, 1, 255), "MISSION_ACK").type == OK
    assert sea.vehicle.helm.plans.mission is None
    assert sea.vehicle.helm.plans.rally == ()
    assert download(sea.console) == []
    upload(sea.console, items_of(zigzag(3)))
    assert newest(upload(sea.console, []), "MISSION_ACK").type == OK, "a mission of no items is none"
    assert sea.vehicle.helm.plans.mission is None


@pytest.mark.parametrize("target", [0, 2])
def test_an_upload_that_names_no_vehicle_changes_nothing(sea, target):
    sea.console.say("mission_count", target, 1, 3, MISSION)
    sea.console.say("mission_clear_all", target, 1, 255)
    assert sea.log == []


def test_an_onlooker_downloads_and_does_not_upload(sea):
    upload(sea.console, items_of(zigzag(3)))
    other = Console(sea.station, sea.radio, system=251, address=("127.0.0.1", 14551))
    assert len(download(other)) == 3
    heard = other.say("mission_count", 1, 1, 2, MISSION)
    assert newest(heard, "MISSION_ACK").type == DENIED


@pytest.mark.parametrize(
    ("name", "more"),
    [("mission_item", (0,) * 12), ("mission_request_partial_list", (0, 1, 0))],
)
def test_older_ways_are_answered(sea, name, more):
    assert newest(sea.console.say(name, 1, 1, *more), "MISSION_ACK").type == UNSUPPORTED


def test_unknown_types_and_numbers_are_answered(sea):
    assert newest(sea.console.say("mission_request_list", 1, 1, 7), "MISSION_ACK").type == UNSUPPORTED
    assert newest(sea.console.say("mission_request_int", 1, 1, 99, 0), "MISSION_ACK").type == 13
    assert newest(sea.console.say("mission_count", 1, 1, 5000, 0), "MISSION_ACK").type == 4


def test_a_home_item_comes_first_where_that_is_the_custom(boat):
    sea = afloat(boat, autopilot="ardurover")
    sail(sea, 0.5)
    items = items_of(zigzag(3))
    assert newest(upload(sea.console, [Item(16, x=1, y=1), *items]), "MISSION_ACK").type == OK
    assert len(sea.vehicle.helm.plans.mission.waypoint) == 3
    assert download(sea.console)[0].x == pytest.approx(386_925_000, abs=2)
    assert download(sea.console)[1:] == items
    sea.console.command(300, 2)
    sail(sea, 0.2)
    assert sea.state.reference.leg == 1


# Fence and harbours.

NEAR = ((38.6920, -9.2156), (38.6920, -9.2144), (38.6930, -9.2144), (38.6930, -9.2156))


def test_a_fence_keeps_the_boat_in(sea):
    assert (
        newest(
            upload(sea.console, plans.fence_items(config.Zones(keep_in=(config.Area(polygon=NEAR),))), FENCE), "MISSION_ACK"
        ).type
        == OK
    )
    assert download(sea.console, FENCE) == list(plans.fence_items(config.Zones(keep_in=(config.Area(polygon=NEAR),))))
    heard = upload(sea.console, items_of(zigzag(20)))
    assert newest(heard, "MISSION_ACK").type == DENIED
    assert "keep-in zone" in texts(heard)
    assert sea.console.command(192, -1, 0, 0, 0, 38.70, -9.215)[0] == 1


def test_a_mission_that_a_new_fence_crosses_is_forgotten(sea):
    upload(sea.console, items_of(zigzag(20)))
    upload(sea.console, plans.fence_items(config.Zones(keep_in=(config.Area(polygon=NEAR),))), FENCE)
    assert sea.vehicle.helm.plans.mission is None
    assert any("mission was removed" in note for note in sea.boat.log.notes)


def test_a_mission_keeps_the_fence_that_came_before_it(sea):
    wide = ((38.68, -9.23), (38.68, -9.20), (38.71, -9.20), (38.71, -9.23))
    upload(sea.console, plans.fence_items(config.Zones(keep_in=(config.Area(polygon=wide),))), FENCE)
    upload(sea.console, items_of(zigzag(3)))
    assert sea.vehicle.helm.plans.zones.keep_in[0].polygon == wide
    assert sea.log[-1].mission.fence.keep_in[0].polygon == wide


def test_the_way_home_ends_at_the_last_harbour_that_was_passed(sea):
    for n in range(60):
        sea.boat.clock.advance(0.2)
        sea.boat.navigate(latitude_rad=math.radians(38.6925) + n * 1.0 / 6.37e6)
    upload(sea.console, plans.rally_items([(38.6925 + math.degrees(20 / 6.37e6), -9.215)]), RALLY)
    sea.boat.report()
    assert sea.console.mode(11)[0] == 0
    assert sea.state.mode is Mode.HOME
    north_m = sea.state.setpoint.track[0][0]
    assert 15.0 <= north_m <= 25.0
