"""rosd: publishes the boat's topics for ROS 2, over Zenoh as rmw_zenoh does (docs/ros2.md), without ROS.

A process of its own: it watches the state over the local command socket and, if asked to, is the guest computer for what ROS
wants of the boat. It is a client of a Zenoh router and listens nowhere. A router that is away or slow costs messages.
"""

import asyncio
import contextlib
import json
import math
from collections import Counter
from collections.abc import Callable
from typing import Any, Final

from delfim import config
from delfim.base import geodesy
from delfim.base.clock import Clock
from delfim.base.errors import FormatError, PermanentFailure, one_line
from delfim.parts.ros import rosmessages as messages
from delfim.parts.ros.roskeys import RosNode, RosType, attachment
from delfim.parts.ros.rosseeing import Seeing
from delfim.parts.ros.rossteering import GuestLine, Steering
from delfim.parts.ros.table import RosTable
from delfim.services.report_feed import watch
from delfim.services.runtime import Runtime
from delfim.services.tables import GuestTable
from delfim.vehicle.report import BoatReport

TICK_S: Final = 0.1
SLOW_S: Final = 1.0  # between two reports of batteries and troubles
OPEN_MS: Final = 3000  # for a connection to the router
AGAIN_S: Final = 3.0
RING: Final = 8  # messages of a topic that wait; of more the oldest go
NAME: Final = "delfim"


class RosBoat:
    """The boat as a node of ROS 2. `session` is Zenoh's, opened."""

    def __init__(self, session: Any, library: Any, settings: config.Vehicle, clock: Clock) -> None:
        self._session, self._library, self._settings, self._clock = session, library, settings, clock
        self.namespace = "/" + (settings.of(RosTable).namespace or settings.boat.name.lower().replace("-", "_"))
        self._node = RosNode(settings.of(RosTable).domain, str(session.info.zid()), self.namespace, NAME)
        self._tokens = [session.liveliness().declare_token(self._node.token())]
        self._at: geodesy.Origin | None = None
        self._cycle, self._slow_s, self._heard_s = -1, -math.inf, -math.inf
        self._state: BoatReport | None = None
        self.sent, self.counts = Counter[str](), Counter[str]()
        space = self.namespace
        self._fix = self._publisher(f"{space}/fix", messages.FIX)
        self._odometry = self._publisher(f"{space}/odom", messages.ODOMETRY)
        self._imu = self._publisher(f"{space}/imu", messages.IMU)
        self._battery = self._publisher(f"{space}/battery", messages.BATTERY)
        self._diagnostics = self._publisher("/diagnostics", messages.DIAGNOSTICS)
        self._steering = Steering(settings.control.speed.cruise_mps)
        self._seeing = Seeing()
        self.guest = GuestLine(settings.of(GuestTable)) if settings.of(RosTable).is_guest else None
        self._inputs: list[tuple[Any, Callable[[bytes], None]]] = []
        if settings.of(RosTable).obstacles:
            self._subscribe(f"{space}/scan", messages.SCAN, self._on_scan)
        if settings.of(RosTable).commands:
            self._subscribe(f"{space}/cmd_vel", messages.TWIST, self._on_twist)
            self._subscribe(f"{space}/goal", messages.GEO_POSE, self._on_goal)

    def _publisher(self, topic: str, of: RosType) -> Callable[[bytes | None, int], None]:
        token = self._node.endpoint(len(self._tokens), "MP", topic, of)
        self._tokens.append(self._session.liveliness().declare_token(token))
        drop = self._library.CongestionControl.DROP  # nobody waits for a slow network
        publisher = self._session.declare_publisher(self._node.key(topic, of), congestion_control=drop)

        def publish(message: bytes | None, utc_ns: int) -> None:
            if message is not None:
                self.sent[topic] += 1
                publisher.put(message, attachment=attachment(self.sent[topic], utc_ns, token))

        return publish

    def _subscribe(self, topic: str, of: RosType, take: Callable[[bytes], None]) -> None:
        token = self._node.endpoint(len(self._tokens), "MS", topic, of)
        self._tokens.append(self._session.liveliness().declare_token(token))
        ring = self._library.handlers.RingChannel(RING)
        self._inputs.append((self._session.declare_subscriber(self._node.key(topic, of), ring), take))

    def _on_twist(self, data: bytes) -> None:
        self._steering.on_twist(*messages.twist(data), self._clock.monotonic_s())

    def _on_goal(self, data: bytes) -> None:
        self._steering.on_goal(*messages.geo_pose(data), self._clock.monotonic_s())

    def _on_scan(self, data: bytes) -> None:
        self._seeing.on_scan(messages.laser_scan(data), self._clock.monotonic_s())

    def heard(self, state: BoatReport) -> None:
        """Take a state that the vehicle just published. Navigation is published once, and not when it is old."""
        self._state, self._heard_s = state, self._clock.monotonic_s()
        age_s = state.age_s.get("navigation")
        if state.cycle == self._cycle or age_s is None or age_s > self._settings.navigation.stale_s:
            return
        self._cycle, utc_ns = state.cycle, state.utc_ns or self._clock.time_ns()
        if self._at is None and state.latitude_deg is not None and state.longitude_deg is not None:
            self._at = geodesy.origin(math.radians(state.latitude_deg), math.radians(state.longitude_deg))
        self._fix(messages.fix(state, utc_ns), utc_ns)
        self._imu(messages.imu(state, utc_ns), utc_ns)
        if self._at is not None:
            self._odometry(messages.odometry(state, utc_ns, self._at), utc_ns)

    def tick(self) -> None:
        """Serve ROS ten times a second, and publish once a second what changes slowly."""
        now_s = self._clock.monotonic_s()
        state = self._state if now_s - self._heard_s <= self._settings.navigation.stale_s else None
        for subscriber, take in self._inputs:
            for _ in range(RING):
                if (sample := subscriber.try_recv()) is None:
                    break
                self._take(bytes(sample.payload), take)
        if self.guest is not None and state is not None:
            self.guest.say(self._steering.step(state, now_s), self._seeing.step(state, now_s))
        if now_s - self._slow_s >= SLOW_S:
            self._slow_s = now_s
            self._tell_slowly(state)

    def _take(self, data: bytes, take: Callable[[bytes], None]) -> None:
        try:
            take(data)
            self.counts["heard"] += 1
        except FormatError:
            self.counts["refused"] += 1

    def _tell_slowly(self, state: BoatReport | None) -> None:
        utc_ns, name = self._clock.time_ns(), self._settings.boat.name
        if state is None:
            rows = [messages.Diagnosis(messages.STALE, "vehicle", "the vehicle does not answer")]
            self._diagnostics(messages.diagnostics(name, rows, utc_ns), utc_ns)
            return
        for message in messages.batteries(state, utc_ns):
            self._battery(message, utc_ns)
        self._diagnostics(messages.diagnostics(name, messages.diagnosis(state), utc_ns), utc_ns)

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        troubles = {} if list(self._session.info.routers_zid()) else {"router": "not connected"}
        if self.guest is not None and self.guest.reason:
            troubles["guest"] = self.guest.reason
        return {"troubles": troubles, "namespace": self.namespace, "sent": dict(self.sent), "counts": dict(self.counts)}


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings, status = runtime.config, runtime.status.get("rosd")
    if status is not None and status.place == "runtime":
        raise PermanentFailure("rosd: it has threads of its own, which the runtime must not; write place = 'process'")
    try:
        import zenoh
    except ModuleNotFoundError:
        raise PermanentFailure("eclipse-zenoh is not installed: pip install 'delfim[ros]'") from None
    with contextlib.ExitStack() as links:
        session = await _opened(zenoh, settings, runtime)
        links.callback(session.close)
        boat = RosBoat(session, zenoh, settings, runtime.clock)
        links.enter_context(runtime.publishing("rosd", boat.report))
        async with asyncio.TaskGroup() as group:
            group.create_task(watch(settings.console.socket, boat.heard, _ignore))
            group.create_task(_tick(boat))
            if boat.guest is not None:
                group.create_task(boat.guest.follow())


async def _tick(boat: RosBoat) -> None:
    while True:
        boat.tick()
        await asyncio.sleep(TICK_S)


def _ignore(why: str) -> None:
    """Do nothing: the age of the last state shows it."""


async def _opened(library: Any, settings: config.Vehicle, runtime: Runtime) -> Any:
    """Open a session, once the router answers. Later the client connects again by itself."""
    asked = library.Config()
    keys = {
        "mode": "client",
        "connect/endpoints": [settings.of(RosTable).router],
        "connect/timeout_ms": OPEN_MS,
        "scouting/multicast/enabled": False,  # it finds nobody by itself, and nobody finds it
    }
    for key, value in keys.items():
        asked.insert_json5(key, json.dumps(value))
    reason = "not connected yet"
    with runtime.publishing("rosd", lambda: {"troubles": {"router": reason}}):
        while True:
            try:
                return await asyncio.to_thread(library.open, asked)
            except library.ZError as error:
                reason = one_line(str(error).partition(" at /")[0])  # without the place in its sources
                await asyncio.sleep(AGAIN_S)
