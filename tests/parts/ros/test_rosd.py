"""The boat in ROS 2: bytes, hashes and keys against a second implementation, rosbags and zenoh-ros2-sdk, over a router."""

import asyncio
import contextlib
import json
import math
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from delfim import config
from delfim.base import geodesy
from delfim.base.clock import SystemClock
from delfim.base.errors import ConfigError, FormatError, PermanentFailure
from delfim.base.input.keys import new_key
from delfim.base.ranges import address
from delfim.parts.ros import rosd, roskeys, rosmessages
from delfim.parts.ros.cdr import HEAD, CdrReader, CdrWriter
from delfim.parts.ros.rosseeing import NEAREST, SCAN_S, Seeing
from delfim.parts.ros.rossteering import GOAL_S, TURN_MAX_RAD, TWIST_S, Steering
from delfim.parts.ros.table import RosTable
from delfim.services.access.exposure import doors
from delfim.services.access.guest_listener import GuestListener
from delfim.services.suite import services
from delfim.services.tables import GuestTable
from delfim.vehicle.grex import Guest, HeadingReference, SeenVessel, reference, sighted
from delfim.vehicle.report import BoatReport
from delfim.vehicle.state import State
from tests.parts.fleet.test_fleetd import loaded_by_delfimx
from tests.parts.gnss.caster import free_port
from tests.services.boat import STATE, served, vehicle, vehicle_file

zenoh = pytest.importorskip("zenoh", reason="make formats brings it")
AT = msgspec.convert(
    STATE | {"accuracy_m": 0.5, "turn_dps": 2.0, "course_deg": 140.0, "roll_deg": 3.0, "pitch_deg": -2.0}, BoatReport
)
GEO = {
    "geographic_msgs/msg/GeoPoint": "float64 latitude\nfloat64 longitude\nfloat64 altitude\n",
    "geographic_msgs/msg/GeoPose": "GeoPoint position\ngeometry_msgs/Quaternion orientation\n",
    "geographic_msgs/msg/GeoPoseStamped": "std_msgs/Header header\nGeoPose pose\n",
}
TYPES = {
    "fix": rosmessages.FIX,
    "odom": rosmessages.ODOMETRY,
    "imu": rosmessages.IMU,
    "battery": rosmessages.BATTERY,
    "diagnostics": rosmessages.DIAGNOSTICS,
    "cmd_vel": rosmessages.TWIST,
    "goal": rosmessages.GEO_POSE,
    "scan": rosmessages.SCAN,
}


@pytest.fixture(scope="module")
def store() -> Any:
    """The types of ROS 2 Jazzy, as rosbags has them, and those of geographic_info."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    found = get_typestore(Stores.ROS2_JAZZY)
    for name, text in GEO.items():
        found.register(get_types_from_msg(text, name))
    return found


def said() -> Iterator[tuple[roskeys.RosType, bytes]]:
    """Each message that goes out."""
    utc_ns = STATE["utc_ns"]
    for of, message in (
        (rosmessages.FIX, rosmessages.fix(AT, utc_ns)),
        (rosmessages.ODOMETRY, rosmessages.odometry(AT, utc_ns, geodesy.origin(math.radians(38.69), math.radians(-9.216)))),
        (rosmessages.IMU, rosmessages.imu(AT, utc_ns)),
        (rosmessages.BATTERY, next(rosmessages.batteries(AT, utc_ns))),
        (rosmessages.DIAGNOSTICS, rosmessages.diagnostics("Otter", rosmessages.diagnosis(AT), utc_ns)),
    ):
        assert message is not None
        yield of, message


def test_each_message_is_byte_by_byte_that_of_another_implementation(store: Any) -> None:
    for of, message in said():
        assert bytes(store.serialize_cdr(store.deserialize_cdr(message, of.name), of.name)) == message, of.name


def test_the_hash_of_each_type_is_that_of_another_implementation(store: Any) -> None:
    assert {of.name: of.hash for of in TYPES.values()} == {of.name: store.hash_rihs01(of.name) for of in TYPES.values()}


def test_the_values_are_those_of_the_boat_by_the_axes_of_ros(store: Any) -> None:
    fix, odometry, imu, battery, diagnostics = (store.deserialize_cdr(message, of.name) for of, message in said())
    assert (fix.latitude, fix.longitude, fix.header.frame_id) == (AT.latitude_deg, AT.longitude_deg, "base_link")
    assert fix.header.stamp.sec * 10**9 + fix.header.stamp.nanosec == STATE["utc_ns"]
    assert (fix.position_covariance[0], math.isnan(fix.altitude)) == (0.25, True)
    place, q = odometry.pose.pose.position, odometry.pose.pose.orientation
    assert (place.x, place.y) == (pytest.approx(61.1, abs=0.5), pytest.approx(76.0, abs=0.5)), "east, north"
    yaw_rad = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    assert math.degrees(yaw_rad) == pytest.approx(90.0 - 131.65)
    assert math.degrees(math.asin(2 * (q.w * q.y - q.z * q.x))) == pytest.approx(2.0), "bow down"
    assert math.degrees(math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x * q.x + q.y * q.y))) == pytest.approx(3.0)
    speed = odometry.twist.twist
    assert speed.linear.y < 0 < speed.linear.x, "the boat drifts to starboard"
    assert math.degrees(speed.angular.z) == pytest.approx(-2.0), "and turns there"
    assert imu.linear_acceleration_covariance[0] == -1.0, "nobody measures it"
    assert (battery.voltage, battery.percentage, battery.location) == (
        pytest.approx(53.88),
        pytest.approx(0.4),
        "batteries_port",
    )
    told = {status.name: (status.level, status.message) for status in diagnostics.status}
    assert told["Otter: mode"] == (0, "play")
    assert told["Otter: check log"] == (1, "disk full")
    assert told["Otter: battery_low"] == (2, "batteries port at 12 %")


def test_what_is_not_known_is_not_said() -> None:
    nothing = msgspec.structs.replace(AT, latitude_deg=None, heading_deg=None)
    at = geodesy.origin(0.0, 0.0)
    assert (rosmessages.fix(nothing, 1), rosmessages.odometry(nothing, 1, at), rosmessages.imu(nothing, 1)) == (
        None,
        None,
        None,
    )


def test_keys_and_tokens_are_those_of_another_implementation() -> None:
    from zenoh_ros2_sdk import attachment, entity, keyexpr, qos

    node = roskeys.RosNode(7, "a1b2", "/otter", "delfim")
    other = entity.NodeEntity(7, "a1b2", 0, "delfim", "/otter")
    assert node.token() == keyexpr.node_liveliness_keyexpr(other)
    for number, (name, of) in enumerate(TYPES.items(), 1):
        assert node.key(f"/otter/{name}", of) == keyexpr.topic_keyexpr(7, f"/otter/{name}", of.dds, of.hash)
        for kind in ("MP", "MS"):
            end = entity.EndpointEntity(
                other, number, entity.EntityKind(kind), f"/otter/{name}", of.dds, of.hash, qos.QosProfile().encode()
            )
            assert node.endpoint(number, kind, f"/otter/{name}", of) == keyexpr.endpoint_liveliness_keyexpr(end)  # type: ignore[arg-type]
    beside = roskeys.attachment(3, STATE["utc_ns"], node.token())
    read = attachment.Attachment.from_bytes(beside)
    assert (read.sequence_id, read.timestamp_ns, len(read.gid), read.to_bytes()) == (3, STATE["utc_ns"], 16, beside)


@pytest.mark.parametrize("data", [b"", b"\x00\x00\x00\x00", HEAD, HEAD + bytes(47), HEAD + b"\xff" * 40])
def test_bytes_that_are_no_message_are_refused(data: bytes) -> None:
    with pytest.raises(FormatError):
        rosmessages.twist(data)
    with pytest.raises(FormatError):
        rosmessages.geo_pose(data)
    with pytest.raises(FormatError):
        rosmessages.laser_scan(data)


def test_a_string_that_is_none_is_refused() -> None:
    for text in (CdrWriter().put("I", 2000), CdrWriter().put("I", 0), CdrWriter().put("I", 3).put("B", 0xFF, 0xFE, 0)):
        with pytest.raises(FormatError):
            CdrReader(bytes(text.data)).text()


def test_a_twist_turns_the_heading_and_ends_with_its_dead_man() -> None:
    steering = Steering(1.5)
    steering.on_twist(1.2, 0.2, 10.0)
    first = steering.step(AT, 10.0)
    assert first == (pytest.approx(131.65), 1.2)
    steering.on_twist(1.2, 0.2, 10.1)
    second = steering.step(AT, 10.1)
    assert second == (pytest.approx(131.65 + math.degrees(0.02)), 1.2)
    assert steering.step(AT, 10.1 + TWIST_S + 0.1) == (AT.heading_deg, 0.0), "speed 0, once"
    assert steering.step(AT, 11.0) is None, "then nothing: the boat holds by itself"


def test_a_twist_never_asks_for_a_heading_far_from_the_boats_nor_for_speed_astern() -> None:
    steering = Steering(1.5)
    for tick in range(200):
        steering.on_twist(-1.0, -3.0, tick / 10)
        asked = steering.step(AT, tick / 10)
    assert asked == (pytest.approx(131.65 - math.degrees(TURN_MAX_RAD)), 0.0)


def test_a_goal_is_steered_for_while_it_is_repeated_and_ends_there() -> None:
    steering = Steering(1.5)
    steering.on_goal(38.70, -9.2152974, 0.0)
    assert steering.step(AT, 0.1) == (pytest.approx(0.0, abs=0.01), 1.5)
    steering.on_twist(0.5, 0.0, 0.2)
    assert steering.step(AT, 0.2) == (pytest.approx(131.65), 0.5), "who steers by hand goes first"
    assert steering.step(AT, GOAL_S + 0.1) == (AT.heading_deg, 0.0)
    assert steering.step(AT, GOAL_S + 0.2) is None
    steering.on_goal(38.6906848, -9.2152974, 10.0)
    assert steering.step(AT, 10.0) == (AT.heading_deg, 0.0), "it is there"


@pytest.mark.parametrize("place", [(91.0, 0.0), (0.0, 181.0), (math.nan, 0.0), (0.0, math.inf)])
def test_a_goal_that_is_no_place_and_a_twist_without_numbers_are_refused(place: tuple[float, float]) -> None:
    with pytest.raises(FormatError):
        Steering(1.5).on_goal(*place, 0.0)
    with pytest.raises(FormatError):
        Steering(1.5).on_twist(math.nan, 0.0, 0.0)


def scan(store: Any, ranges_m: dict[int, float], first_deg: float = -90.0, step_deg: float = 1.0, count: int = 181) -> bytes:
    """A scan of a lidar that looks ahead, as another implementation writes it."""
    types = store.types
    ranges = np.full(count, np.inf, np.float32)
    for index, far_m in ranges_m.items():
        ranges[index] = far_m
    first, step = math.radians(first_deg), math.radians(step_deg)
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "base_link")
    said = types["sensor_msgs/msg/LaserScan"](header, first, -first, step, 0.0, 0.1, 0.5, 60.0, ranges, np.zeros(0, np.float32))
    return bytes(store.serialize_cdr(said, rosmessages.SCAN.name))


def places(seen: list[SeenVessel]) -> list[tuple[float, float]]:
    """Distance of the middle of each from the boat, m, and its bearing, degrees from the bow to starboard."""
    at, found = geodesy.origin(math.radians(AT.latitude_deg), math.radians(AT.longitude_deg)), []
    for each in seen:
        north_m, east_m = geodesy.to_plane(at, math.radians(each.latitude_deg), math.radians(each.longitude_deg))
        bearing_deg = math.degrees(math.atan2(east_m, north_m)) - AT.heading_deg
        found.append((math.hypot(north_m, east_m), (bearing_deg + 180.0) % 360.0 - 180.0))
    return found


def test_what_a_scan_sees_stands_where_it_looks(store: Any) -> None:
    seeing = Seeing()
    seeing.on_scan(rosmessages.laser_scan(scan(store, {60: 20.0, 61: 20.1, 120: 40.0, 10: 0.2, 170: 61.0, 90: math.nan})), 1.0)
    seen = seeing.step(AT, 1.0)
    near, far = places(seen)
    assert near == (pytest.approx(20.3, abs=0.05), pytest.approx(30.0, abs=0.1)), "30 degrees to starboard, a thing once"
    assert far == (pytest.approx(40.35, abs=0.05), pytest.approx(-30.0, abs=0.1)), "and one to port"
    assert {(each.kind, each.confidence) for each in seen} == {("thing", 0.5)}


def test_a_scan_is_told_once_four_times_a_second_and_not_when_it_is_old(store: Any) -> None:
    seeing, said = Seeing(), rosmessages.laser_scan(scan(store, {90: 20.0}))
    told = list[float]()
    for tick in range(40):
        seeing.on_scan(said, tick / 20)
        told += [tick / 20] * len(seeing.step(AT, tick / 20))
    assert told == [0.25 * each for each in range(8)]
    assert seeing.step(AT, 2.3) != []
    assert seeing.step(AT, 2.6) == [], "once"
    seeing.on_scan(said, 3.0)
    assert seeing.step(AT, 3.0 + SCAN_S + 0.01) == []
    seeing.on_scan(said, 4.0)
    assert seeing.step(msgspec.structs.replace(AT, heading_deg=None), 4.0) == []


def test_of_a_wall_the_nearest_places_are_told(store: Any) -> None:
    seeing = Seeing()
    seeing.on_scan(rosmessages.laser_scan(scan(store, {each: 10.0 + 0.1 * each for each in range(181)})), 0.0)
    seen = places(seeing.step(AT, 0.0))
    assert len(seen) == NEAREST
    assert seen[0] == (pytest.approx(10.3, abs=0.05), pytest.approx(90.0, abs=0.1))


def test_a_scan_without_directions_and_one_of_too_many_are_refused(store: Any) -> None:
    for first_deg, step_deg in ((math.nan, 1.0), (0.0, math.inf), (0.0, 400.0)):
        with pytest.raises(FormatError, match="without directions"):
            Seeing().on_scan(rosmessages.laser_scan(scan(store, {}, first_deg, step_deg)), 0.0)
    with pytest.raises(FormatError, match="10001 directions"):
        rosmessages.laser_scan(scan(store, {}, count=10_001))
    with pytest.raises(FormatError):
        rosmessages.laser_scan(scan(store, {})[:-5])


@contextlib.contextmanager
def router(port: int) -> Iterator[None]:
    """A Zenoh router, as `rmw_zenohd` is one."""
    asked = zenoh.Config()
    for key, value in {
        "mode": "router",
        "listen/endpoints": [f"tcp/127.0.0.1:{port}"],
        "scouting/multicast/enabled": False,
    }.items():
        asked.insert_json5(key, json.dumps(value))
    with zenoh.open(asked):
        yield


@contextlib.contextmanager
def peer(port: int, store: Any) -> Iterator[Any]:
    """Another program of ROS: zenoh-ros2-sdk, which knows the types."""
    from zenoh_ros2_sdk import ZenohSession

    session = ZenohSession.get_instance("127.0.0.1", port)
    session.store.register(store.fielddefs)
    session._registered_types |= {of.name: of.name for of in TYPES.values()}
    try:
        yield session
    finally:
        session.close()


@contextlib.asynccontextmanager
async def guests_door(table: GuestTable) -> AsyncIterator[list[bytes]]:
    """The vehicle's door for the guest, and what the guest says."""
    state: Any = SimpleNamespace(navigation=None, count=lambda what: None)
    guest, said = Guest(state, SystemClock()), list[bytes]()
    guest.on_line = said.append
    door = GuestListener(table, guest, state, SystemClock())
    host, port = address(table.listen)
    server = await asyncio.get_running_loop().create_server(door.visitor, host, port)
    try:
        yield said
    finally:
        server.close()
        door.close()


async def until(is_so: Callable[[], object]) -> None:
    async with asyncio.timeout(200):
        while not is_so():
            await asyncio.sleep(0.02)


def settings(tmp_path: Path, port: int, guest: int) -> config.Vehicle:
    new_key(tmp_path / "guest.key")
    return vehicle_file(
        tmp_path,
        guest=GuestTable(enabled=True, listen=f"127.0.0.1:{guest}", key=str(tmp_path / "guest.key")),
        ros=RosTable(router=f"tcp/127.0.0.1:{port}", commands=True, obstacles=True),
    )


class Other:
    """The other program: what it heard last on each topic, and what it says."""

    def __init__(self, session: Any, port: int) -> None:
        from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber

        self.heard, self._types = dict[str, Any](), session.store.types
        place: dict[str, Any] = {"router_ip": "127.0.0.1", "router_port": port}
        for name in ("fix", "odom", "imu", "battery", "diagnostics"):
            topic, of = f"/{'' if name == 'diagnostics' else 'test/'}{name}", TYPES[name]
            ROS2Subscriber(topic, of.name, lambda said, name=name: self.heard.update({name: said}), type_hash=of.hash, **place)
        self._twist, self._goal = (
            ROS2Publisher(f"/test/{name}", TYPES[name].name, type_hash=TYPES[name].hash, **place)
            for name in ("cmd_vel", "goal")
        )
        self._scan = ROS2Publisher("/test/scan", rosmessages.SCAN.name, type_hash=rosmessages.SCAN.hash, **place)

    def twist(self, ahead_mps: float) -> None:
        vector = self._types["geometry_msgs/msg/Vector3"]
        self._twist.publish(linear=vector(ahead_mps, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0))

    def scan(self, far_m: float) -> None:
        header = self._types["std_msgs/msg/Header"](self._types["builtin_interfaces/msg/Time"](0, 0), "base_link")
        angles = {"angle_min": 0.0, "angle_max": 0.1, "angle_increment": 0.02, "time_increment": 0.0, "scan_time": 0.1}
        ranges = np.array([far_m, 99.0], np.float32)
        self._scan.publish(
            header=header, **angles, range_min=0.5, range_max=60.0, ranges=ranges, intensities=np.zeros(0, np.float32)
        )

    def goal(self, latitude_deg: float, longitude_deg: float) -> None:
        types = self._types
        point = types["geographic_msgs/msg/GeoPoint"](latitude_deg, longitude_deg, 0.0)
        pose = types["geographic_msgs/msg/GeoPose"](point, types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0))
        stamp = types["builtin_interfaces/msg/Time"](0, 0)
        self._goal.publish(header=types["std_msgs/msg/Header"](stamp, ""), pose=pose)


def test_another_program_of_ros_hears_the_boat_and_steers_it_through_the_guests_door(tmp_path: Path, store: Any) -> None:
    """Again after the router was away."""
    port, state = free_port(), dict(STATE)
    asked = settings(tmp_path, port, free_port())

    async def voyage(figures: Callable[[], dict[str, Any]], sail: Callable[[], None], orders: list[bytes]) -> None:
        from zenoh_ros2_sdk import get_topic_names_and_types

        def steers(say: Callable[[], None], wanted: HeadingReference) -> bool:
            sail()
            say()
            return bool(orders) and reference(orders[-1]) == wanted

        await until(lambda: (sail(), not figures()["troubles"])[1])
        with peer(port, store) as session:
            other = Other(session, port)
            await until(lambda: steers(lambda: other.twist(1.0), HeadingReference(pytest.approx(131.65), 1.0)))
            await until(
                lambda: steers(lambda: other.goal(38.0, STATE["longitude_deg"]), HeadingReference(pytest.approx(180.0), 1.5))
            )
            await until(lambda: (sail(), other.scan(12.0), any(b'"target"' in line for line in orders))[2])
            line = next(line for line in orders if b'"target"' in line)
            (place,) = places([msgspec.convert(msgspec.json.decode(line)["target"], SeenVessel)])
            assert place == (pytest.approx(12.3, abs=0.05), pytest.approx(0.0, abs=0.5))
            assert sighted(line, State(), 0.0), "the boat hears it"
            await until(lambda: (sail(), len(other.heard) == 5)[1])
            assert other.heard["fix"].latitude == STATE["latitude_deg"]
            found = get_topic_names_and_types(router_ip="127.0.0.1", router_port=port)
            assert dict(found)["/test/fix"] == ["sensor_msgs/msg/NavSatFix"]

    async def main() -> None:
        async with vehicle(asked, state) as commands, guests_door(asked.guest) as orders:

            def sail() -> None:
                state["cycle"] += 1
                commands.publish()

            async with served(asked, rosd.serve, "rosd") as runtime:

                def figures() -> dict[str, Any]:
                    return dict(runtime.board["rosd"]())

                await until(lambda: figures()["troubles"]["router"] != "not connected yet")
                for _ in range(2):
                    with router(port):
                        await voyage(figures, sail, orders)
                    await until(lambda: figures()["troubles"].get("router"))
                    orders.clear()

    asyncio.run(main())


def test_nothing_of_it_runs_or_is_loaded_unless_the_file_asks_and_then_it_is_a_process_and_a_door(tmp_path: Path) -> None:
    quiet, asked = vehicle_file(tmp_path), settings(tmp_path, 7447, 4747)
    assert "rosd" not in {row.name for row in services(quiet)}
    assert [row.place for row in services(asked) if row.name == "rosd"] == ["process"]
    (door,) = (door for door in doors(asked, ["rosd"]) if door.service == "rosd")
    assert (door.reach, "steer" in door.may) == ("anyone", True)
    runtime: Any = SimpleNamespace(config=asked, status={"rosd": SimpleNamespace(place="runtime")})
    with pytest.raises(PermanentFailure, match="process"):
        asyncio.run(rosd.serve(runtime))
    assert loaded_by_delfimx({"zenoh", "delfim.parts.ros.rosd", "delfim.parts.ros.cdr"}) == set()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('router = "udp/127.0.0.1:7447"', "tcp/HOST:PORT"),
        ('router = "tcp/192.168.1.7:7447"\ncommands = true', "of this computer"),
        ("commands = true", "of this computer"),
        ('router = "tcp/127.0.0.1:7447"\ncommands = true\n[guest]\nenabled = false', "guest.enabled"),
        (
            'router = "tcp/127.0.0.1:7447"\ncommands = true\n[guest]\nenabled = true\nnetworks = ["10.0.0.0/8"]',
            "guest.networks must have 127.0.0.0/8",
        ),
        ('router = "tcp/192.168.1.7:7447"\nobstacles = true', "obstacles: whoever reaches the router"),
        ('router = "tcp/127.0.0.1:7447"\nobstacles = true\n[guest]\nenabled = false', "obstacles: it speaks as the guest"),
        (
            'router = "tcp/127.0.0.1:7447"\nobstacles = true\n[guest]\nenabled = true\n[traffic]\nhears = ["nmea2000"]',
            '"guest" in traffic.hears',
        ),
        ('router = "tcp/127.0.0.1:7447"\nnamespace = "7-otters"', "small letters"),
    ],
)
def test_the_file_is_refused_with_a_reason(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "boat.toml").write_text(f'[boat]\nname = "Otter"\n[ros]\n{text}\n')
    with pytest.raises(ConfigError, match=words):
        config.load(tmp_path / "boat.toml")
