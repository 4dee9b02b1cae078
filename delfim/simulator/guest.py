"""A guest computer, as GREX was on DelfimX (thesis 3.4): it receives navigation from the vehicle and requests headings.

The vehicle is the TCP server; both directions are JSON, one object a line (`delfim/vehicle/grex.py`). `reference` is a pure
function of navigation to set points, so that a lock-step simulation can be its own guest. The guest always asks; the vehicle
obeys in GREX mode only.
"""

import asyncio
import logging
import math
from typing import Final, NamedTuple

import msgspec

from delfim.base import geodesy
from delfim.base.errors import FormatError
from delfim.base.input.unreadable import UNREADABLE
from delfim.vehicle.grex import proof

_log = logging.getLogger(__name__)

LINE_BYTES: Final = 4096  # a longer line is not navigation: the connection is closed
SILENCE_S: Final = 5.0  # a silent connection is closed too
BACKOFF_S: Final = (0.1, 5.0)  # first and longest pause before a new connection


class Heard(msgspec.Struct, frozen=True):
    """One line from the vehicle. None is unknown; other keys are for later guests."""

    utc_ns: int
    mode: str
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    heading_deg: float | None = None
    north_mps: float | None = None
    east_mps: float | None = None


class Asked(NamedTuple):
    """One line of the guest: the course, 0..360 degrees true, and the speed that it requests."""

    heading_deg: float
    speed_mps: float


class Circle(NamedTuple):
    """The plan of circles round a point, clockwise; anticlockwise with a negative radius."""

    latitude_deg: float
    longitude_deg: float
    radius_m: float = 30.0
    speed_mps: float = 1.2


class Zigzag(NamedTuple):
    """The plan of a zigzag of this many degrees to either side of a course, to starboard first, a leg every `leg_s` of UTC."""

    course_deg: float
    amplitude_deg: float = 30.0
    leg_s: float = 30.0
    speed_mps: float = 1.2


class Script(NamedTuple):
    """The plan of headings one after the other, each for `leg_s` of UTC, then from the first again. At least one."""

    headings_deg: tuple[float, ...]
    leg_s: float = 30.0
    speed_mps: float = 1.2


Plan = Circle | Zigzag | Script


class Challenge(msgspec.Struct, frozen=True):
    """The first line of a vehicle that asks for a key."""

    challenge: str


_decode = msgspec.json.Decoder(Heard).decode
_decode_challenge = msgspec.json.Decoder(Challenge).decode


def heard(line: bytes) -> Heard:
    """Parse a line of the vehicle. Raises FormatError for a line that is not navigation."""
    try:
        return _decode(line)
    except UNREADABLE as error:
        raise FormatError(f"not a line of the vehicle: {error}") from None


def reference(plan: Plan, at: Heard, start_ns: int) -> Asked | None:
    """The set point of a guest with this plan; None while it does not know enough. `start_ns` is when it began, UTC."""
    if isinstance(plan, Circle):
        return _around(plan, at)
    leg = int((at.utc_ns - start_ns) / 1e9 // plan.leg_s)
    if isinstance(plan, Zigzag):
        return Asked((plan.course_deg + (plan.amplitude_deg if leg % 2 == 0 else -plan.amplitude_deg)) % 360.0, plan.speed_mps)
    return Asked(plan.headings_deg[leg % len(plan.headings_deg)] % 360.0, plan.speed_mps)


def _around(plan: Circle, at: Heard) -> Asked | None:
    """The course along the tangent, and towards the circle in proportion to the distance from it: a vector field (Nelson et al.
    2007)."""
    if at.latitude_deg is None or at.longitude_deg is None:
        return None
    centre = geodesy.origin(math.radians(plan.latitude_deg), math.radians(plan.longitude_deg))
    north_m, east_m = geodesy.to_plane(centre, math.radians(at.latitude_deg), math.radians(at.longitude_deg))
    radius_m = abs(plan.radius_m)
    inwards = math.atan2(math.hypot(north_m, east_m) - radius_m, 0.5 * radius_m)
    course = math.atan2(east_m, north_m) + math.copysign(0.5 * math.pi + inwards, plan.radius_m)
    return Asked(math.degrees(geodesy.compass(course)), plan.speed_mps)


def answered(line: bytes, key: bytes) -> bytes:
    """Answer the vehicle's challenge, its first line where it asks for a key. Raises FormatError."""
    try:
        return msgspec.json.encode({"proof": proof(key, _decode_challenge(line).challenge)}) + b"\n"
    except UNREADABLE as error:
        raise FormatError(f"the vehicle asks for no key: {error}") from None


def written(asked: Asked) -> bytes:
    """Format the line to the vehicle."""
    return msgspec.json.encode(asked._asdict()) + b"\n"


async def guest(
    host: str, port: int, plan: Plan, *, key: bytes | None = None, backoff_s: tuple[float, float] = BACKOFF_S
) -> None:
    """Run a guest until it is cancelled. With a key it proves it first. It answers every line of navigation; without a vehicle
    it tries again, with an exponential back-off. Its plan starts with the first line that it hears and goes on after a break.
    """
    pause_s, start_ns = backoff_s[0], 0
    while True:
        try:
            reader, writer = await asyncio.open_connection(host, port, limit=LINE_BYTES)
            try:
                if key is not None:
                    writer.write(answered(await _line(reader), key))
                while line := await _line(reader):
                    at = heard(line)
                    start_ns = start_ns or at.utc_ns
                    pause_s = backoff_s[0]
                    if (asked := reference(plan, at, start_ns)) is not None:
                        writer.write(written(asked))
                        async with asyncio.timeout(SILENCE_S):
                            await writer.drain()
                why = "the vehicle closed the connection"
            finally:
                writer.close()
        except TimeoutError:
            why = f"the vehicle was silent or did not read for {SILENCE_S:.0f} s"
        except (OSError, ValueError) as error:  # no vehicle, connection lost, a line too long, or not navigation (FormatError)
            why = str(error)
        _log.info("guest of %s:%d: %s; again in %.3g s", host, port, why, pause_s)
        await asyncio.sleep(pause_s)
        pause_s = min(2.0 * pause_s, backoff_s[1])


async def _line(reader: asyncio.StreamReader) -> bytes:
    """Read the next line; empty at the end. Raises TimeoutError. It does not use wait_for, which may lose a cancellation."""
    async with asyncio.timeout(SILENCE_S):
        return await reader.readline()
