"""The guest computer (grex.c in the thesis): navigation out, set points in, obeyed only in GREX mode.

The vehicle is the TCP server. Both directions are JSON, one object a line (`docs/guest.md`). One guest at a time: a new
connection replaces the one before, so that a restarted guest need not wait for its old connection to end. The service that
listens decides who may be the guest (`delfim/services/access/guest_listener.py`).
"""

import asyncio
import hmac
import math
from collections.abc import Callable
from typing import Annotated, Literal, cast

import msgspec

from delfim.base.clock import Clock
from delfim.base.input.unreadable import UNREADABLE
from delfim.base.vessels import ThingSeen, VesselFacts, VesselPosition
from delfim.vehicle.state import Setpoint, State

LINE_BYTES = 1024  # longer input is not a set point
LINES_A_CALL = 8  # the newest of the lines that came at once; the guest sends two a second
BACKLOG_BYTES = 16384  # a guest that does not read loses the newest lines; the vehicle does not wait


class HeadingReference(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A set point of the guest: a heading, 0..360 degrees true, and a speed in m/s."""

    heading_deg: float
    speed_mps: float = 0.0


class SeenVessel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A vessel, a thing or a person that a payload sees by radar, camera or lidar: degrees, m/s, m. Unknown values are left
    out."""

    id: Annotated[str, msgspec.Meta(pattern="^[ -~]{1,24}$")]  # the same as long as it is the same one
    latitude_deg: Annotated[float, msgspec.Meta(ge=-90.0, le=90.0)]
    longitude_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
    course_deg: Annotated[float, msgspec.Meta(ge=0.0, le=360.0)] | None = None
    speed_mps: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] | None = None
    heading_deg: Annotated[float, msgspec.Meta(ge=0.0, le=360.0)] | None = None
    length_m: Annotated[float, msgspec.Meta(gt=0.0, le=500.0)] | None = None
    beam_m: Annotated[float, msgspec.Meta(gt=0.0, le=100.0)] | None = None
    kind: Literal["vessel", "thing", "person"] = "vessel"
    radius_m: Annotated[float, msgspec.Meta(ge=0.0, le=50.0)] = 0.5  # of a thing or a person
    confidence: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 1.0  # of a thing or a person; 0: it is not there


class _Seen(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    target: SeenVessel


_decode_seen = msgspec.json.Decoder(_Seen).decode
_decode = msgspec.json.Decoder(HeadingReference).decode
_encode = msgspec.json.Encoder().encode


class Guest(asyncio.Protocol):
    """The link to the guest. `send` after each critical path; `on_line` is called with its lines."""

    def __init__(self, state: State, clock: Clock) -> None:
        self._state, self._clock = state, clock
        self._transport: asyncio.Transport | None = None
        self._buffer = b""
        self.on_line: Callable[[bytes], None] = lambda line: None  # takes the lines: the loop's fifth input
        self.is_connected = False

    def send(self) -> None:
        """Navigation and mode to the guest, if one is there and reads."""
        transport, n = self._transport, self._state.navigation
        if transport is None or n is None:
            return
        if transport.get_write_buffer_size() > BACKLOG_BYTES:
            self._state.count("guest_not_reading")
            return
        transport.write(
            _encode(
                {
                    "utc_ns": n.utc_ns,
                    "latitude_deg": None if n.latitude_rad is None else math.degrees(n.latitude_rad),
                    "longitude_deg": None if n.longitude_rad is None else math.degrees(n.longitude_rad),
                    "heading_deg": None if n.heading_rad is None else math.degrees(n.heading_rad),
                    "north_mps": n.north_mps,
                    "east_mps": n.east_mps,
                    "mode": self._state.mode.name.lower(),
                }
            )
            + b"\n"
        )

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if self._transport is not None:
            self._transport.abort()
        self._transport, self._buffer = cast(asyncio.Transport, transport), b""  # uvloop's transports do not inherit from it
        self.is_connected = True

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is not None and self._transport.is_closing():
            self._transport = None
            self.is_connected = False

    def data_received(self, data: bytes) -> None:
        *lines, self._buffer = (self._buffer + data).rsplit(b"\n", LINES_A_CALL)
        if len(lines) == LINES_A_CALL and b"\n" in lines[0]:
            self._state.count("guest_hasty")
            lines[0] = lines[0].rpartition(b"\n")[2]
        if len(self._buffer) > LINE_BYTES:
            self._buffer = b""
            self._state.count("guest_malformed")
        for line in lines:
            self.hear(line)

    def hear(self, line: bytes) -> None:
        """A line came in."""
        self.on_line(line)

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


def proof(key: bytes, challenge: str) -> str:
    """The guest's answer to the vehicle's challenge: HMAC-SHA256 (RFC 2104) of its text, 64 hexadecimal digits."""
    return hmac.new(key, challenge.encode(), "sha256").hexdigest()


def reference(line: bytes) -> HeadingReference | None:
    """The set point in a line; None if it is malformed or not finite."""
    try:
        asked = _decode(line if len(line) <= LINE_BYTES else b"")
    except UNREADABLE:
        return None
    return asked if math.isfinite(asked.heading_deg) and math.isfinite(asked.speed_mps) else None


def sighted(line: bytes, state: State, now_s: float) -> bool:
    """Another vessel in a line, into the state; False: there is none, or it is malformed."""
    try:
        vessel = _decode_seen(line if len(line) <= LINE_BYTES else b"").target
    except UNREADABLE:
        return False
    seen(vessel, "guest", state, now_s)
    return True


def seen(vessel: SeenVessel, by: str, state: State, now_s: float) -> None:
    """Another vessel or a thing, into the state. `by`: "guest", or "payload " and the program's name, or a sensor."""
    place = math.radians(vessel.latitude_deg), math.radians(vessel.longitude_deg)
    course_rad, heading_rad = (None if each is None else math.radians(each) for each in (vessel.course_deg, vessel.heading_deg))
    if vessel.kind != "vessel":
        name, motion = f"{by.removeprefix('payload ')} {vessel.id}", (course_rad, vessel.speed_mps)
        state.hear(ThingSeen(*place, vessel.radius_m, vessel.kind, vessel.confidence, *motion), by, now_s, name)
        return
    key = f"payload {vessel.id}"
    state.hear(VesselPosition(0, *place, course_rad, vessel.speed_mps, heading_rad, None, "payload"), by, now_s, key)
    state.hear(VesselFacts(0, vessel.id, None, None, vessel.length_m, vessel.beam_m, None, None), by, now_s, key)


def told(line: bytes, state: State, is_lookout: bool, now_s: float) -> Setpoint | None:
    """The set points with what a line of the guest asks for; None: it asks for nothing. A vessel that it sees is heard, where
    the guest is a look-out; a malformed line is counted."""
    asked = reference(line)
    if asked is None:
        if not (is_lookout and sighted(line, state, now_s)):
            state.count("guest_malformed")
        return None
    heading_rad, speed_mps = math.radians(asked.heading_deg % 360.0), max(asked.speed_mps, 0.0)
    return state.setpoint._replace(guest_heading_rad=heading_rad, guest_speed_mps=speed_mps)
