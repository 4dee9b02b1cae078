"""Delfim as a device of an NMEA 2000 bus: it claims an address and identifies itself (docs/nmea2000.md).

Frames in, messages out; no sockets, time and chance handed in. Nothing that it hears changes anything but its own address: it
obeys no command, and hands none on.
"""

import zlib
from collections import Counter
from random import Random
from typing import Final, Literal, NamedTuple

from delfim import __version__, config
from delfim.base.frames import CAN_IDE, Frame
from delfim.canproxy.nmea2000 import ownpgns
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.canproxy.nmea2000.parcels import (
    ACKNOWLEDGE,
    CLAIM,
    CONFIGURATION,
    EVERYBODY,
    GROUP_FUNCTION,
    HEARTBEAT,
    NOBODY,
    PGN_LIST,
    PRODUCT,
    REQUEST,
    ROLL_CALL,
    Parcel,
    addressed,
    any_of,
)
from delfim.canproxy.nmea2000.pgns import ADDRESS_MAX

FIRST: Final = 100  # the address that it asks for when it never had one
CLAIM_S: Final = 0.25  # a claim that nobody contests for so long holds (ISO 11783-5)
SPREAD_S: Final = 0.153  # two devices that are switched on together do not ask at the same moment
AGAIN_S: Final = 30.0  # until a device without address tries again, and as much again by chance
ROLL_CALL_S: Final = 60.0  # how often all devices are asked for their names: a reader that started later learns them
REPEAT_S: Final = 0.5  # one description of the device serves all who asked for it meanwhile
ANSWERS: Final = 8  # to others, at most, in one step
MAKER: Final = 2046  # nobody's code: the makers' codes are given out by NMEA, and Delfim has none
CLASS, FUNCTION, MARINE = 60, 175, 4  # navigation, integrated navigation system
_DESCRIPTIONS: Final = (PRODUCT, CONFIGURATION, PGN_LIST, HEARTBEAT)
_RECEIVED: Final = (REQUEST, CLAIM, GROUP_FUNCTION)
# Of group functions (126208): the kinds; the errors that an acknowledgement tells of a PGN, an interval and each parameter.
_ASK, _COMMAND, _READ, _WRITE = 0, 1, 3, 5
_DONE, _PGN_UNKNOWN, _PGN_DENIED, _PGN_NO_READ = 0, 1, 3, 6
_INTERVAL_FIXED = 1
_PARAMETER_DENIED, _PARAMETER_NOT_SUPPORTED, _PARAMETER_NO_READ = 4, 5, 6
_KEEP_INTERVALS: Final = (0xFFFFFFFF, 0xFFFFFFFE)  # no change; the default


class DeviceFacts(NamedTuple):
    """The texts that describe the device, up to 32 characters each."""

    boat: str
    version: str  # of the program
    unique: int  # its number, 0..2^21 - 1


def facts_of(settings: config.Vehicle) -> DeviceFacts:
    """The facts of the vehicle's file. A boat that has no number gets one from its name."""
    boat = settings.boat.name
    return DeviceFacts(boat, __version__, settings.table("nmea2000").unique_number or zlib.crc32(boat.encode()) & 0x1FFFFF)


def device_name(unique: int) -> int:
    """The 64-bit NAME (ISO 11783-5): the device with the lower one keeps an address. This device can have any address."""
    return 1 << 63 | MARINE << 60 | CLASS << 49 | FUNCTION << 40 | MAKER << 21 | unique


class Device:
    """The device's state machine. Feed it the frames that `FILTERS` pass, and send what `step` returns, in its order.

    `sent`: the PGNs that the owner sends. `address`: the one that it had before. An address is its own after CLAIM_S without
    a contest; before that it says nothing else. A device with a lower NAME takes it, and then it takes another one.
    """

    def __init__(self, facts: DeviceFacts, sent: tuple[int, ...], chance: Random, address: int = FIRST) -> None:
        self.name, self._facts, self._sent, self._chance = device_name(facts.unique), facts, sent, chance
        self.state: Literal["asking", "claiming", "claimed", "silent"] = "asking"
        self.address = address
        self.trouble = ""  # why it has no address, in words
        self.names: dict[int, int] = {}  # of the other devices, by address
        self.counts: Counter[str] = Counter()  # frames refused, and contests, by reason
        self.wanted = set[int]()  # PGNs of the owner that somebody asked for; the owner clears it
        self._fast = FastPacket(self.counts)
        self._due_s = 0.0  # when its state changes
        self._roll_call_s = self._heartbeat_s = 0.0  # when the next one is due
        self._beats = 0
        self._must_claim = False
        self._asked = dict[int, float]()  # descriptions that somebody wants, and when they may be sent
        self._told_s = dict[int, float]()  # when each was sent last
        self._answers: list[Parcel] = []

    FILTERS: Final = any_of(REQUEST, CLAIM, GROUP_FUNCTION)

    @property
    def is_claimed(self) -> bool:
        return self.state == "claimed"

    @property
    def source(self) -> int:
        """The address under which it may send now."""
        return self.address if self.state in ("claiming", "claimed") else NOBODY

    def begin(self, now_s: float) -> list[Parcel]:
        """Join the bus, or join it again after it was away: others may have come or gone. Asks who is there first."""
        self.state, self._due_s = "asking", now_s + CLAIM_S + self._chance.uniform(0.0, SPREAD_S)
        self.names.clear()
        self._answers.clear()
        self._asked.clear()
        self.wanted.clear()
        self._must_claim = False
        return [self._roll_call(now_s)]

    def step(self, now_s: float) -> list[Parcel]:
        """The messages to send now. Call it some tens of times a second, and after `feed`."""
        said = list[Parcel]()
        if now_s >= self._due_s:
            said += self._advance(now_s)
        if self._must_claim and self.state != "asking":
            self._must_claim = False
            said.append(Parcel(CLAIM, self.name.to_bytes(8, "little"), self.source))
        if self.is_claimed:
            said += self._answers
            said += self._descriptions(now_s)
            if now_s >= self._roll_call_s:
                said.append(self._roll_call(now_s))
        self._answers.clear()
        return said

    def _advance(self, now_s: float) -> list[Parcel]:
        """Go to the next state when the time of the present one is over."""
        if self.state == "asking":
            self._choose(now_s)
        elif self.state == "claiming":
            self.state, self._due_s, self.trouble = "claimed", float("inf"), ""
            self._heartbeat_s = now_s
        elif self.state == "silent":
            return self.begin(now_s)
        return []

    def _choose(self, now_s: float) -> None:
        """Claim the address that it had, or the next one that is free."""
        order = ((self.address + i) % (ADDRESS_MAX + 1) for i in range(ADDRESS_MAX + 1))
        free = next((address for address in order if address not in self.names), None)
        if free is None:
            self._be_silent(now_s, "all 252 addresses of the bus are taken")
        else:
            self.state, self.address, self._due_s = "claiming", free, now_s + CLAIM_S
        self._must_claim = True

    def _be_silent(self, now_s: float, why: str) -> None:
        self.state, self.trouble = "silent", why
        self._due_s = now_s + AGAIN_S * (1.0 + self._chance.random())

    # Messages that are heard.

    def feed(self, frame: Frame, now_s: float) -> None:
        """Take a frame of the bus. Never raises; what it refuses is counted by its reason."""
        if frame.arb & 7 != CAN_IDE:
            self.counts["not an extended data frame"] += 1
            return
        pgn, source, destination = addressed(frame.arb)
        if source > ADDRESS_MAX and not (source == NOBODY and pgn in (CLAIM, REQUEST)):
            self.counts["source address that nobody can have"] += 1
        elif pgn == CLAIM:
            self._hear_claim(source, frame.data, now_s)
        elif destination not in (EVERYBODY, self.address):
            self.counts["for another device"] += 1
        elif pgn == REQUEST:
            self._hear_request(source, destination, frame.data, now_s)
        elif pgn == GROUP_FUNCTION and destination == self.address:
            data = self._fast.feed(source, frame.data, now_s)
            if data is not None:
                self._hear_group(source, data, now_s)

    def _hear_claim(self, source: int, data: bytes, now_s: float) -> None:
        if len(data) != 8:
            self.counts["claim: malformed"] += 1
            return
        name = int.from_bytes(data, "little")
        for address in [address for address, held in self.names.items() if held == name]:
            del self.names[address]
        if source == NOBODY:
            return
        if name == self.name:
            self.counts["another device has our NAME"] += 1
            number = self._facts.unique
            self._be_silent(now_s, f"another device has our NAME: give this boat a nmea2000.unique_number other than {number}")
            return
        self.names[source] = name
        if source != self.address or self.state not in ("claiming", "claimed"):
            return
        if name < self.name:
            self.counts["address lost to another device"] += 1
            self._choose(now_s)
        else:
            self.counts["address claimed by another device, and kept"] += 1
            del self.names[source]
            self._must_claim = True

    def _hear_request(self, source: int, destination: int, data: bytes, now_s: float) -> None:
        if len(data) < 3:
            self.counts["request: malformed"] += 1
            return
        pgn = int.from_bytes(data[:3], "little")
        if pgn == CLAIM:
            self._must_claim = True
        elif not self._take(pgn, now_s) and destination != EVERYBODY:
            self._answer(Parcel(ACKNOWLEDGE, ownpgns.refusal(pgn), self.address, destination=source))

    def _take(self, pgn: int, now_s: float) -> bool:
        """Note a request for a message; return whether there is something to send."""
        if pgn in _DESCRIPTIONS:
            self._asked.setdefault(pgn, max(now_s, self._told_s.get(pgn, now_s - REPEAT_S) + REPEAT_S))
        elif pgn in self._sent:
            self.wanted.add(pgn)
        return pgn in _DESCRIPTIONS or pgn in self._sent

    def _hear_group(self, source: int, data: bytes, now_s: float) -> None:
        """Answer a group function: a request as far as it asks for what is sent anyway; a command is refused."""
        kind, pgn = data[0], int.from_bytes(data[1:4], "little")
        counted = {_ASK: 10, _COMMAND: 5, _READ: 6, _WRITE: 6}.get(kind)  # where the number of parameters stands
        if counted is None:  # somebody's answer
            self.counts["group function: not a question"] += 1
            return
        if len(data) <= counted:
            self.counts["group function: malformed"] += 1
            return
        parameters, known = data[counted], pgn == CLAIM or pgn in _DESCRIPTIONS or pgn in self._sent
        keeps = int.from_bytes(data[4:8], "little") in _KEEP_INTERVALS  # what a request begins with
        if not known:
            errors = _PGN_UNKNOWN, _DONE, _PARAMETER_NOT_SUPPORTED
        elif kind == _COMMAND:
            errors = _PGN_DENIED, _DONE, _PARAMETER_DENIED
        elif kind in (_READ, _WRITE):
            errors = _PGN_NO_READ, _DONE, _PARAMETER_NO_READ
        elif parameters or not keeps:
            errors = _DONE, _DONE if keeps else _INTERVAL_FIXED, _PARAMETER_NOT_SUPPORTED
        else:
            self._must_claim |= pgn == CLAIM
            self._take(pgn, now_s)
            return
        if kind in (_COMMAND, _WRITE):
            self.counts["command refused"] += 1
        said = ownpgns.group_acknowledge(pgn, *errors, parameters)
        self._answer(Parcel(GROUP_FUNCTION, said, self.address, 3, source))

    def _answer(self, parcel: Parcel) -> None:
        if len(self._answers) < ANSWERS:
            self._answers.append(parcel)
        else:
            self.counts["too many questions at once"] += 1

    # Messages that are said.

    def _roll_call(self, now_s: float) -> Parcel:
        self._roll_call_s = now_s + ROLL_CALL_S
        return ROLL_CALL._replace(source=self.source)

    def _descriptions(self, now_s: float) -> list[Parcel]:
        said = list[Parcel]()
        if now_s >= self._heartbeat_s:
            self._heartbeat_s = now_s + ownpgns.HEARTBEAT_S
            self._asked[HEARTBEAT] = now_s
        for pgn in [pgn for pgn, at_s in self._asked.items() if now_s >= at_s]:
            del self._asked[pgn]
            self._told_s[pgn] = now_s
            said += [Parcel(pgn, data, self.address, 7 if pgn == HEARTBEAT else 6) for data in self._described(pgn)]
        return said

    def _described(self, pgn: int) -> list[bytes]:
        boat, version, unique = self._facts
        if pgn == PRODUCT:
            return [ownpgns.product("Delfim", version, boat, f"{unique}")]
        if pgn == CONFIGURATION:
            return [ownpgns.configuration(boat, "obeys no command from this bus", "Delfim")]
        if pgn == PGN_LIST:
            sent = (ACKNOWLEDGE, *_RECEIVED, *_DESCRIPTIONS, *self._sent)
            return [ownpgns.pgn_list(False, sent), ownpgns.pgn_list(True, _RECEIVED)]
        self._beats += 1
        return [ownpgns.heartbeat(self._beats - 1)]

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        names = {str(address): f"{name:016x}" for address, name in sorted(self.names.items())}
        return {
            "address": self.address if self.is_claimed else None,
            "name": f"{self.name:016x}",
            "devices": names,
            "refused": dict(self.counts),
        }
