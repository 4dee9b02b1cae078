"""What a console sends may be as large as it is allowed to be, or larger: the loop goes on, the boat sails, and the console
hears in words what came of it. Work is counted, and no time is measured."""

import asyncio
import itertools
import json
import math
import tomllib
from types import SimpleNamespace

import pytest

from delfim import config
from delfim.base import cooperative
from delfim.base.errors import Refused
from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import plans
from delfim.parts.mavlink.codec.plans import FENCE, MISSION, Item
from delfim.parts.mavlink.station import Station
from delfim.vehicle import console
from delfim.vehicle.failsafe.failsafe import Action
from delfim.vehicle.operator.command import CommandServer
from delfim.vehicle.operator.link import Link
from delfim.vehicle.operator.reviews import Reviews
from delfim.vehicle.plans import fence
from delfim.vehicle.plans.mission import Mission, PathPoint, Waypoint, canonical
from delfim.vehicle.plans.zones import circle, polygon
from delfim.vehicle.snapshot import in_json
from tests.parts.mavlink.mavlink_console import Console, Radio, newest, texts
from tests.parts.mavlink.test_mavlink_missions import fields
from tests.vehicle_fixtures import MOST_AT_ONCE

OK, INVALID, DENIED = 0, 5, 14
HERE = 38.6925, -9.2150  # where the boat of the tests lies
OPEN = config.Zones()


def ring(north_deg: float, east_deg: float, radius_deg: float, corners: int = 100) -> tuple[tuple[float, float], ...]:
    turns = [math.tau * i / corners for i in range(corners)]
    return tuple((HERE[0] + north_deg + radius_deg * math.cos(a), HERE[1] + east_deg + radius_deg * math.sin(a)) for a in turns)


def zones(keep_out: int = 100) -> config.Zones:
    """The largest fence that is legal: 100 zones of 100 corners a hundred metres from each other, within one of as many."""
    rows = ((0.002 + 0.001 * (i // 10), 0.002 + 0.001 * (i % 10)) for i in range(keep_out))
    return config.Zones(
        keep_in=(config.Area(polygon=ring(0.0, 0.0, 0.05)),),
        keep_out=tuple(config.Area(polygon=ring(*at, 0.0002)) for at in rows),
    )


def mission(waypoints: int, path: int = 0, around: config.Zones = OPEN) -> Mission:
    """Back and forth south of where the boat lies; the path goes round and round."""
    (n, e), r = HERE, 22.2
    places = [Waypoint(latitude_deg=n - 0.001 - 1e-5 * i, longitude_deg=e + 0.002 * (i % 2)) for i in range(waypoints)]
    begin = PathPoint(latitude_deg=n - 0.001, longitude_deg=e)
    arcs = [PathPoint(latitude_deg=n - 0.0012, longitude_deg=e, turn_deg=360.0, radius_m=r) for _ in range(path - 1)]
    return Mission(version=1, name="large", waypoint=tuple(places), path=(begin, *arcs) if path else (), fence=around)


@pytest.fixture
def boat(make_boat):
    """It lies where it is, whatever its motors do."""
    return make_boat(failsafe=config.Failsafe(stuck=config.Stuck(after_s=3600.0)))


@pytest.fixture
def sea(boat):
    """A boat under way with consoles at its station and at its command socket; the loop is turned by hand."""
    turns: list = []
    loop = SimpleNamespace(call_soon=lambda call, *arguments: turns.append((call, arguments)))
    vehicle, log = boat.vehicle, []

    def obey(command, operator="local"):
        refused = vehicle.on_command(command, operator)
        reviews.hear(command, operator)
        log.append((command, refused))
        return refused

    reviews = Reviews(vehicle, obey, loop)
    radio = Radio()
    station = Station(vehicle, obey, radio, None, reviews.begin)
    boat.ready()
    here = SimpleNamespace(boat=boat, vehicle=vehicle, state=boat.state, station=station, radio=radio, log=log, turns=turns)
    here.console, here.reviews = Console(station, radio), reviews
    here.other = Console(station, radio, system=9, address=("127.0.0.1", 14999))
    here.console.beat()
    return here


def turn(sea, times: int = 1_000_000) -> int:
    """The loop's callbacks, one at a time; how many there were."""
    for count in range(times):
        if not sea.turns and not sea.station.turn():
            return count
        if sea.turns:
            call, arguments = sea.turns.pop(0)
            call(*arguments)
    return times


def send(sea, items: list[Item], kind: int, home: bool = False) -> list:
    """All that came back, the loop turned until nothing was left to do."""
    heard = sea.console.say("mission_count", 1, 1, len(items), kind)
    for number, item in enumerate(items):
        if any(m.get_type() == "MISSION_ACK" for m in heard):
            break
        heard += sea.console.say("mission_item_int", *fields(number, item, kind))
    before = len(sea.radio.sent)
    turn(sea)
    return heard + sea.console.listen(before)


def test_a_polygon_of_two_thousand_corners_is_refused_at_its_first(sea, counted):
    heard = send(sea, [Item(plans.KEEP_IN, 2000.0, x=386_900_000 + n, y=-92_150_000 - n * n) for n in range(2000)], FENCE)
    assert newest(heard, "MISSION_ACK").type == INVALID
    assert "item 0: a polygon of 2000 corners: up to 100 are understood" in texts(heard)
    assert sum(m.get_type() == "MISSION_REQUEST_INT" for m in heard) == 1
    assert sum(counted) == 0


def test_twenty_polygons_of_a_hundred_corners_around_a_mission(sea, counted):
    sea.vehicle.on_command(console.Upload(mission(12)))
    counted.clear()
    heard = send(sea, list(plans.fence_items(zones(19))), FENCE)
    assert newest(heard, "MISSION_ACK").type == OK
    assert len(sea.vehicle.helm.plans.fence.zones) == 20
    assert max(counted) <= MOST_AT_ONCE


def test_five_hundred_waypoints_into_the_largest_fence(sea, counted):
    sea.vehicle.on_command(console.SetFence(zones()))
    counted.clear()
    heard = send(sea, list(plans.mission_items(mission(500))), MISSION)
    assert newest(heard, "MISSION_ACK").type == OK
    assert len(sea.state.setpoint.plan.waypoints) == 500
    assert max(counted) <= MOST_AT_ONCE


def test_the_largest_mission_takes_many_slices_and_the_boat_sails_meanwhile(sea, counted):
    sea.vehicle.on_command(console.Heading(heading_deg=90.0, speed_mps=1.0))
    answers: list[str | None] = []
    sea.reviews.begin("local", console.Upload(mission(1000, 100, zones())), answers.append)
    cycles = 0
    while sea.turns:
        assert turn(sea, 20) == 20 or not sea.turns
        sea.boat.pass_time(0.1)
        sea.boat.navigate()
        sea.vehicle.on_command(console.Alive())
        cycles += 1
        assert sea.state.mode is Mode.HEADING
        assert (sea.state.setpoint.plan is None) is not bool(answers)
    assert answers == [None]
    assert cycles > 100
    assert max(counted) <= MOST_AT_ONCE


@pytest.mark.parametrize("changed", ["mission", "fence"])
def test_the_largest_change_under_way_takes_many_slices_and_the_boat_sails_meanwhile(sea, counted, changed):
    """All of a mission but what is behind and the leg under way; and the largest fence, around as much."""
    large = mission(1000, 100)
    for command in (console.Upload(large), console.Play()):
        assert sea.vehicle.on_command(command) is None
    first, *_ = large.waypoint
    others = [Waypoint(latitude_deg=each.latitude_deg - 1e-4, longitude_deg=each.longitude_deg) for each in large.waypoint[1:]]
    other = Mission(version=1, name="other", waypoint=(first, *others), path=large.path, fence=zones())
    counted.clear()
    answers: list[str | None] = []
    command = console.Upload(other) if changed == "mission" else console.SetFence(zones())
    sea.reviews.begin("local", command, answers.append)
    cycles = 0
    while sea.turns:
        turn(sea, 20)
        sea.boat.pass_time(0.1)
        sea.boat.navigate()
        sea.vehicle.on_command(console.Alive())
        cycles += 1
        assert sea.state.mode is Mode.PLAY
    assert answers == [None]
    assert cycles > 100
    assert max(counted) <= MOST_AT_ONCE
    assert len(sea.vehicle.helm.plans.fence.zones) == 101


def test_what_cannot_be_done_is_refused_in_words_and_changes_nothing(sea):
    inside = config.Zones(keep_out=(config.Area(name="reef", polygon=ring(-0.001, 0.001, 0.0003)),))
    answers: list[str | None] = []
    sea.reviews.begin("local", console.Upload(mission(4, 0, inside)), answers.append)
    turn(sea)
    assert answers == ["mission refused: the leg to waypoint 2 leads through reef; missions keep 6 m away"]
    crossed = config.Area(polygon=(*ring(0.0, 0.0, 0.05)[:50], *ring(0.0, 0.0, 0.05)[:49:-1]))
    crossing = config.Zones(keep_in=(crossed,))
    sea.reviews.begin("local", console.SetFence(crossing), answers.append)
    turn(sea)
    assert "fence.keep_in[0]: the polygon crosses itself" in answers[1]
    assert (sea.state.setpoint.plan, sea.vehicle.helm.plans.mission, sea.vehicle.helm.plans.fence) == (None, None, None)


def test_work_without_end_is_given_up_in_words(sea, monkeypatch):
    monkeypatch.setattr(cooperative, "MOST", 1000)
    answers: list[str | None] = []
    sea.reviews.begin("local", console.Upload(mission(1000)), answers.append)
    turn(sea)
    assert "more than 1,000 comparisons" in answers[0]


@pytest.mark.parametrize(
    ("end", "reason"),
    [
        (lambda sea: sea.other.mode(4), "refused: a stop was commanded"),
        (lambda sea: sea.other.command(32100, 1, 1), "refused: console 9 commands now"),
        (
            lambda sea: sea.reviews.begin("local", console.Upload(mission(2)), lambda _: None),
            "refused: a newer plan replaced it",
        ),
    ],
)
def test_a_stop_a_new_owner_and_a_newer_plan_end_it(sea, end, reason):
    answers: list[str | None] = []
    sea.reviews.begin("local", console.Upload(mission(1000)), answers.append)
    turn(sea, 10)
    end(sea)
    assert answers == [reason]
    turn(sea)
    assert answers == [reason]
    assert sea.state.setpoint.plan is None or len(sea.state.setpoint.plan.waypoints) == 2


def test_what_was_looked_at_for_another_state_is_looked_at_again(sea):
    answers: list[str | None] = []
    sea.reviews.begin("local", console.Upload(mission(20)), answers.append)
    turn(sea, 3)
    sea.vehicle.on_command(console.Set("control.speed.max_mps", 1.0))
    turn(sea)
    assert answers == [None]
    for _ in range(3):
        sea.reviews.begin("local", console.Upload(mission(20)), answers.append)
        while sea.turns:
            turn(sea, 1)
            sea.vehicle.on_command(console.Set("control.speed.max_mps", 1.0))
    assert answers[1:] == ["refused: the boat's settings kept changing meanwhile: send it again"] * 3


async def test_over_the_command_socket_a_long_text_comes_in_parts(boat, tmp_path, counted, monkeypatch):
    """The real socket, the real client, the real loop, the real worker. The boat's own process reads no TOML."""
    monkeypatch.setattr(tomllib, "loads", lambda text: pytest.fail("the loop waits for who reads this"))
    boat.ready()
    large = canonical(mission(1000, 1000))
    assert len(large) > 3 * console.PART

    def talk() -> None:
        with Link(tmp_path / "command", 20.0) as link:
            assert link.ask("mission", text=large)["mission"] == "large"
            with pytest.raises(Refused, match="not TOML"):
                link.ask("mission", text="[" * 5000)
            with pytest.raises(Refused, match="send it again from the start"):
                link._asked("mission", text="x", at=7)
            lines = [{"command": "upload", "mission": json.loads(SMALL)}, {"command": "play"}, {"command": "state"}]
            link._socket.sendall(b"".join(json.dumps(line).encode() + b"\n" for line in lines))
            assert [link._reply()["state"]["mode"] for _ in lines] == ["idle", "play", "play"]

    reviews = Reviews(boat.vehicle, boat.vehicle.on_command, asyncio.get_running_loop())
    server = CommandServer(boat.vehicle.on_command, reviews, lambda: in_json(boat.vehicle.report()), 4)
    listening = await asyncio.get_running_loop().create_unix_server(server.connection, str(tmp_path / "command"))
    await asyncio.to_thread(talk)
    server.close()
    listening.close()
    assert max(counted) <= MOST_AT_ONCE


SMALL = json.dumps({"version": 1, "name": "small", "waypoint": [{"latitude_deg": HERE[0] - 0.0005, "longitude_deg": HERE[1]}]})


def test_a_stop_behind_a_plan_does_not_wait_for_it(boat, tmp_path):
    boat.ready()
    told: list[dict] = []

    async def both() -> None:
        reviews = Reviews(boat.vehicle, obey, asyncio.get_running_loop())
        listening = await asyncio.get_running_loop().create_unix_server(
            CommandServer(obey, reviews, lambda: in_json(boat.vehicle.report()), 4).connection, str(tmp_path / "command")
        )
        await asyncio.to_thread(talk)
        listening.close()

    def obey(command, operator="local"):
        return boat.vehicle.on_command(command, operator)

    def talk() -> None:
        with Link(tmp_path / "command", 20.0) as link:
            both = {"command": "upload", "mission": json.loads(LONG)}, {"command": "stop"}
            link._socket.sendall(b"".join(json.dumps(part).encode() + b"\n" for part in both))  # the end of one with the other
            told.extend(link._reply() for _ in range(2))

    asyncio.run(both())
    assert [(each["ok"], each["reason"]) for each in told] == [(False, "refused: a stop was commanded after it"), (True, "")]


def place(n: int) -> dict[str, float]:
    return {"latitude_deg": round(HERE[0] - 1e-5 * n, 6), "longitude_deg": round(HERE[1] + 0.002 * (n % 2), 6)}


LONG = json.dumps({"version": 1, "name": "long", "waypoint": [place(n) for n in range(1000)]})


def test_the_fence_is_watched_at_a_bounded_price(counted):
    """However many corners are near, one look at the fence compares no more than it may, and says so."""
    corners = [(n, e) for n, e in itertools.zip_longest([6.0 + 1e-3 * i for i in range(99)], [], fillvalue=0.0)]
    comb = [(n, 2000.0 if i % 2 else -2000.0) for i, (n, _) in enumerate(corners)]
    thick = fence.Fence(tuple(polygon(f"comb {i}", False, [*comb, (3000.0, 0.0)]) for i in range(200)), config.FenceTable())
    looked: list[int] = []
    real = fence.least

    def looking(*arguments):
        found = real(*arguments)
        looked.append(found[1])
        return found

    fence.least, kept = looking, fence.least
    try:
        motion = fence.Motion(frozenset({"position", "velocity"}), 5.0, 0.0, 0.0, 0.0, -1.5, 0.0)
        assert "too many corners of zones close by to watch" in fence.ahead(thick, motion)
    finally:
        fence.least = kept
    assert sum(looked) <= 2 * fence.LOOKS


def test_a_boats_own_fence_is_laid_out_in_slices_once_there_is_a_position(make_boat, counted):
    own = zones()
    boat = make_boat(fence=config.FenceTable(keep_in=own.keep_in, keep_out=own.keep_out))
    boat.ready()
    lines = {line.name: line for line in boat.vehicle.helm.checks()}
    assert (lines["fence"].ok, lines["fence"].reason) == (False, "its zones are still being prepared: wait a moment")
    ticks = 0
    while not boat.vehicle.helm.plans.fence.is_laid:
        boat.pass_time(0.1)
        ticks += 1
    assert 10 < ticks < 150
    assert len(boat.vehicle.helm.plans.fence.zones) == 101
    assert max(counted) <= MOST_AT_ONCE


def test_a_better_place_to_hold_is_found_later(sea, counted):
    """The track leads along a wall for longer than one slice can look."""
    driven = [(0.0, 0.0), *((3.0 + 0.01 * i, 100.0 + 5.0 * i) for i in range(300))]
    for point in driven:
        sea.vehicle.helm.track.add(*point)
    wall = polygon("wall", False, [(10.0, 50.0), (10.0, 3000.0), (11.0, 3000.0), (11.0, 50.0)])
    sea.vehicle.helm.plans.fence = fence.Fence((wall,), config.FenceTable())
    sea.boat.state.motion = sea.state.motion._replace(north_m=5.0, east_m=1500.0)
    sea.vehicle.helm.enter(Mode.HOLD, "test")
    assert sea.vehicle.helm.memory.north_m == 5.0, "meanwhile here"
    for _ in range(100):
        sea.vehicle.helm.go_on()
    assert (sea.vehicle.helm.memory.north_m, sea.vehicle.helm.memory.east_m) == (0.0, 0.0)
    assert max(counted) <= MOST_AT_ONCE


@pytest.mark.parametrize("is_between", [True, False])
def test_a_boat_that_was_led_away_from_its_place_goes_back_through_no_zone(sea, is_between):
    zone = circle("rock", False, (0.0, 50.0 if is_between else -50.0), 10.0)
    sea.vehicle.helm.plans.fence = fence.Fence((zone,), config.FenceTable())
    sea.boat.state.motion = sea.state.motion._replace(north_m=0.0, east_m=0.0, north_mps=0.0, east_mps=0.0)
    sea.vehicle.helm.enter(Mode.HOLD, "test")
    sea.boat.state.motion = sea.state.motion._replace(east_m=100.0)
    sea.vehicle.helm.fall_back(Action.HOLD, "rock 4 m away", sea.boat.clock.monotonic_s())
    assert sea.state.mode is Mode.HOLD
    assert sea.vehicle.helm.memory.east_m == (100.0 if is_between else 0.0)
    assert (sea.state.reason == "rock 4 m away") is is_between


def test_what_large_plans_were_made_of_is_let_go_little_by_little(sea):
    for _ in range(3):
        sea.vehicle.on_command(console.Upload(mission(1000, 0, zones(30))))
    remains, met, had = sea.vehicle.helm.plans.remains, 0, 0
    while remains._walks or remains._things:
        sea.vehicle.helm.go_on()
        new, had = len(remains._things) - max(0, had - cooperative.LET_GO), len(remains._things)
        assert 0 <= new <= cooperative.LET_GO
        met += new
    assert met > 2 * (1000 + 31 * 100)
