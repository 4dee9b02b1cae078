"""The first connection of a sensor: its baud rate and its talkers; whether compass and gyro turn the right way."""

import contextlib
import math
import os
import select
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from delfim.base.clock import Clock
from delfim.base.errors import DelfimError
from delfim.base.input.ratelimit import UNREAD_BYTES
from delfim.desk.listen import Hearing
from delfim.lines.serialline import SerialLine
from delfim.parts.nmea0183.mixedline import MixedLine

RATES: Final = (4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800)
LISTEN_S: Final = 2.5  # at each rate: a sensor speaks once a second at least
ENOUGH: Final = 3  # sound sentences, and more than what is refused: it is this rate
BYTES_MAX: Final = 200_000  # at one rate: a port that floods ends the listening
TURN_DEG: Final = 60.0  # a turn by hand that tells
LOOK_S: Final = 0.2
BY_ID: Final = Path("/dev/serial/by-id")


class Found(NamedTuple):
    """The sentences and bytes of a port at a rate."""

    baud: int
    heard: dict[str, float]  # by sentence, how often a second
    has_checksum: bool
    came: int  # bytes


class Turned(NamedTuple):
    """How heading and rate of turn followed a turn by hand, positive to starboard; None: it was not reported."""

    heading_deg: float | None
    rate_dps: float | None  # the largest, with its sign


def listened_at(device: str, baud: int, clock: Clock) -> Found:
    """Listen at one rate. Raises DelfimError where the port cannot be opened, or not at this rate."""
    strict, lenient, came, began_s = MixedLine(), MixedLine(needs_checksum=False), 0, clock.monotonic_s()
    line = SerialLine(device, baud, clock)
    try:
        line.read(UNREAD_BYTES)  # what waited came at another rate
        while (left_s := began_s + LISTEN_S - clock.monotonic_s()) > 0.0 and came < BYTES_MAX and not line.trouble:
            select.select([line], [], [], left_s)
            data = line.read(UNREAD_BYTES)
            came += len(data)
            strict.feed(data)
            lenient.feed(data)
            if sum(strict.heard.values()) >= 10 * ENOUGH:
                break
    finally:
        line.close()
    if line.trouble != "closed":
        raise DelfimError(f"{device}: {line.trouble}")
    passed_s = max(clock.monotonic_s() - began_s, 1e-3)
    chosen = strict if _is_sound(strict) else lenient
    rates = {name: count / passed_s for name, count in chosen.heard.items()}
    return Found(baud, rates if _is_sound(chosen) else {}, chosen is strict, came)


def _is_sound(line: MixedLine) -> bool:
    return sum(line.heard.values()) >= max(ENOUGH, sum(line.refused.values()))


def find(device: str, clock: Clock) -> Iterator[str]:
    """Try each rate; yields lines for the terminal. Raises DelfimError."""
    if (user := user_of(device)) is not None:
        raise DelfimError(f"{device}: {user} reads it, and each of two readers gets a part: end it first")
    came = 0
    for baud in RATES:
        try:
            found = listened_at(device, baud, clock)
        except DelfimError as error:
            if "does not run at" not in str(error):
                raise
            yield str(error)
            continue
        came += found.came
        if found.heard:
            yield from _described(device, found)
            return
        yield f"{baud:6} baud: {f'{found.came} bytes, no sentence' if found.came else 'silent'}"
    if came:
        raise DelfimError(f"{device}: bytes, but no sentence at any rate: another protocol, or two wires exchanged")
    raise DelfimError(f"{device}: silent at every rate: is it switched on, and the sensor's TX on this port's RX?")


def _described(device: str, found: Found) -> Iterator[str]:
    yield f"{found.baud:6} baud: {sum(found.heard.values()):.0f} sentences a second"
    talkers = dict[str, list[str]]()
    for name, rate in found.heard.items():
        talkers.setdefault("UBX" if name.startswith("UBX") else name[:2], []).append(f"{name} {rate:.1f}")
    yield from (f"  {talker}: {', '.join(said)}" for talker, said in sorted(talkers.items()))
    yield from ("", "For the vehicle's file, with a name of your own in place of NAME:", "", "[nmea0183.ports.NAME]")
    yield f'device = "{named(device)}"'
    yield f"baud = {found.baud}"
    if not found.has_checksum:
        yield "checksum = false  # it sends none: a damaged sentence is not noticed"


def named(device: str, folder: Path = BY_ID) -> str:
    """The name that stays when devices are plugged in another order, if there is one."""
    real = os.path.realpath(device)
    return next((str(each) for each in sorted(folder.glob("*")) if os.path.realpath(each) == real), device)


def user_of(device: str) -> str | None:
    """Another program that has this port open, as far as we may see."""
    real = os.path.realpath(device)
    for handle in Path("/proc").glob("[0-9]*/fd/*"):
        with contextlib.suppress(OSError):  # it ended, or is none of ours
            if os.readlink(handle) == real and handle.parts[2] != str(os.getpid()):
                return f"{Path('/proc', handle.parts[2], 'comm').read_text().strip()} (process {handle.parts[2]})"
    return None


def turned(hearing: Hearing, for_s: float) -> Turned:
    """The turn of the boat while it lasts, until TURN_DEG or this time have passed."""
    turn_deg, last_rad, rates, waited_s = 0.0, None, list[float](), 0.0
    while waited_s < for_s and abs(turn_deg) < TURN_DEG:
        told = hearing.reports(LOOK_S)
        waited_s += LOOK_S
        heading = next((value[0] for (_, kind), value in told.values.items() if kind == "heading"), None)
        rates += [math.degrees(value[0]) for (_, kind), value in told.values.items() if kind == "rate"][:1]
        if heading is not None and last_rad is not None:
            turn_deg += math.degrees(math.remainder(heading - last_rad, math.tau))
        last_rad = heading if heading is not None else last_rad
    return Turned(None if last_rad is None else turn_deg, max(rates, key=abs, default=None))


def judged(turn: Turned) -> tuple[bool, list[str]]:
    """Whether a turn to starboard was reported as one, and the words about it."""
    if turn.heading_deg is None:
        return False, ["No heading was heard."]
    if abs(turn.heading_deg) < TURN_DEG / 2.0:
        return False, [f"The heading changed by {turn.heading_deg:+.0f} degrees: turn further, or the compass stands still."]
    is_right = turn.heading_deg > 0.0
    words = "the compass turns the right way" if is_right else "it must rise: the compass is upside down, or its sign is wrong"
    lines = [f"The heading changed by {turn.heading_deg:+.0f} degrees: {words}."]
    if turn.rate_dps is None:
        return is_right, [*lines, "No rate of turn was heard."]
    agrees = turn.rate_dps > 0.0
    words = "it has the right sign" if agrees else "it must be positive"
    return is_right and agrees, [*lines, f"The rate of turn was {turn.rate_dps:+.1f} degrees a second: {words}."]
