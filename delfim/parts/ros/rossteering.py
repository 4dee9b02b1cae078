"""Twist and goal of ROS 2 as set points of the guest computer (docs/ros2.md): the boat takes them from one listener, and obeys
in mode grex only.

The dead-man: a Twist counts for TWIST_S, a goal for GOAL_S, and must come again within that. When neither does, speed 0 is said
once, then nothing, so that the boat's own time-out (`failsafe.guest_silent`) makes it hold.
"""

import asyncio
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import msgspec

from delfim.base import geodesy
from delfim.base.errors import FormatError, in_words
from delfim.base.input.keys import read_key
from delfim.base.input.unreadable import UNREADABLE
from delfim.base.ranges import address
from delfim.services.tables import GuestTable
from delfim.vehicle.grex import SeenVessel, proof
from delfim.vehicle.report import BoatReport

TWIST_S: Final = 0.5
GOAL_S: Final = 3.0
TURN_MAX_RAD: Final = math.radians(60.0)  # the heading asked for is never further from the boat's
NEAR_M: Final = 5.0  # of a goal; there the speed is 0
SPEED_MAX_MPS: Final = 30.0
LINE_BYTES: Final = 4096
ANSWER_S: Final = 5.0
PAUSE_S: Final = 1.0


class AskedCourse(NamedTuple):
    """The set point of a guest: course, 0..360 degrees true, and speed, m/s ahead."""

    heading_deg: float
    speed_mps: float


class Steering:
    """Chooses the set point that is due. `now_s` is monotonic. It has no socket."""

    def __init__(self, cruise_mps: float) -> None:
        self._cruise_mps = cruise_mps
        self._twist, self._twist_s = (0.0, 0.0), -math.inf
        self._goal, self._goal_s = (0.0, 0.0), -math.inf
        self._heading_rad: float | None = None  # asked for, while a Twist counts
        self._stepped_s = -math.inf
        self._is_asking = False

    def on_twist(self, ahead_mps: float, turn_radps: float, now_s: float) -> None:
        """Take a Twist. Raises FormatError for numbers that are not finite."""
        if not (math.isfinite(ahead_mps) and math.isfinite(turn_radps)):
            raise FormatError("a Twist that is not finite")
        self._twist, self._twist_s = (min(max(ahead_mps, 0.0), SPEED_MAX_MPS), turn_radps), now_s

    def on_goal(self, latitude_deg: float, longitude_deg: float, now_s: float) -> None:
        """Take a goal. Raises FormatError for what is no position."""
        if not (abs(latitude_deg) <= 89.0 and abs(longitude_deg) <= 180.0):
            raise FormatError("a goal that is no place")
        self._goal, self._goal_s = (latitude_deg, longitude_deg), now_s

    def step(self, state: BoatReport, now_s: float) -> AskedCourse | None:
        """The set point for the boat as it is now; None: send nothing. A Twist counts before a goal."""
        dt_s, self._stepped_s = now_s - self._stepped_s, now_s
        asked = None
        if state.heading_deg is not None and now_s - self._twist_s <= TWIST_S:
            asked = self._turned(math.radians(state.heading_deg), min(dt_s, TWIST_S))
        else:
            self._heading_rad = None
            if now_s - self._goal_s <= GOAL_S:
                asked = self._towards(state)
        if asked is None and self._is_asking and state.heading_deg is not None:
            self._is_asking = False
            return AskedCourse(state.heading_deg, 0.0)
        self._is_asking = asked is not None
        return asked

    def _turned(self, heading_rad: float, dt_s: float) -> AskedCourse:
        """The heading after a turn as fast as the Twist's, from where the boat lay."""
        ahead_mps, turn_radps = self._twist
        asked_rad = heading_rad if self._heading_rad is None else self._heading_rad + turn_radps * dt_s
        off_rad = geodesy.wrap(asked_rad - heading_rad)
        self._heading_rad = heading_rad + min(max(off_rad, -TURN_MAX_RAD), TURN_MAX_RAD)
        return AskedCourse(math.degrees(geodesy.compass(self._heading_rad)), ahead_mps)

    def _towards(self, state: BoatReport) -> AskedCourse | None:
        if state.latitude_deg is None or state.longitude_deg is None or state.heading_deg is None:
            return None
        here = geodesy.origin(math.radians(state.latitude_deg), math.radians(state.longitude_deg))
        north_m, east_m = geodesy.to_plane(here, *map(math.radians, self._goal))
        if math.hypot(north_m, east_m) <= NEAR_M:
            return AskedCourse(state.heading_deg, 0.0)
        return AskedCourse(math.degrees(geodesy.compass(math.atan2(east_m, north_m))), self._cruise_mps)


class _Challenge(msgspec.Struct, frozen=True):
    challenge: str


class GuestLine:
    """The connection to the guest's listener. `reason`: why there is none, or empty. Raises ConfigError for a bad key."""

    def __init__(self, table: GuestTable) -> None:
        self._address = address(table.listen)
        self._key = read_key(table.key) if table.key else None
        self._writer: asyncio.StreamWriter | None = None
        self.reason = "not connected yet"

    def say(self, asked: AskedCourse | None, seen: Sequence[SeenVessel] = ()) -> None:
        """Send a set point and what is seen, now or never."""
        lines = [] if asked is None else [msgspec.json.encode(asked._asdict())]
        lines += [msgspec.json.encode({"target": each}) for each in seen]
        if lines and self._writer is not None and self._writer.transport.get_write_buffer_size() == 0:
            self._writer.write(b"".join(line + b"\n" for line in lines))

    async def follow(self) -> None:
        """Keep connected until cancelled."""
        while True:
            try:
                await self._once()
                self.reason = "the vehicle closed the connection: its log says why"
            except TimeoutError:
                self.reason = "the vehicle does not answer"
            except (OSError, ValueError, *UNREADABLE) as error:
                self.reason = in_words(error)
            self._writer = None
            await asyncio.sleep(PAUSE_S)

    async def _once(self) -> None:
        async with asyncio.timeout(ANSWER_S):
            reader, writer = await asyncio.open_connection(*self._address, limit=LINE_BYTES)
        try:
            if self._key is not None:
                async with asyncio.timeout(ANSWER_S):
                    if not (line := await reader.readline()):
                        return
                    challenge = msgspec.json.decode(line, type=_Challenge).challenge
                writer.write(msgspec.json.encode({"proof": proof(self._key, challenge)}) + b"\n")
            self._writer, self.reason = writer, ""
            while await reader.readline():
                pass
        finally:
            writer.close()
