"""A console for tests: it has a MAVLink codec and nothing else, and hears what the station sends to its address."""

import json
import math
from typing import Any

from delfim.parts.mavlink.codec import ownorders, wire
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.codec.wire import Sender, dialect
from delfim.parts.mavlink.station import Station

HOME = ("127.0.0.1", 14550)


class Radio:
    """The station's way out: datagrams by address."""

    def __init__(self) -> None:
        self.sent: list[tuple[bytes, tuple[str, int]]] = []

    def __call__(self, datagram: bytes, address: tuple[str, int]) -> None:
        self.sent.append((datagram, address))


class Console:
    def __init__(
        self,
        station: Station,
        radio: Radio,
        system: int = 250,
        address: tuple[str, int] = HOME,
        signing: Signing | None = None,
        component: int = 190,
        link: int = 0,
    ) -> None:
        self.station, self.radio, self.address = station, radio, address
        self.party = (system, component)
        key, stamp = (None, lambda: 0) if signing is None else (signing.key, signing.stamp)
        self.sender = Sender(*self.party, key, stamp)
        self.sender._signing.link_id = link
        self.heard: list[Any] = []

    def frame(self, name: str, *fields: object) -> bytes:
        return self.sender.pack(getattr(dialect, f"MAVLink_{name}_message")(*fields))

    def deliver(self, datagram: bytes) -> list[Any]:
        """A datagram to the station; what came back at once."""
        before = len(self.radio.sent)
        self.station.receive(datagram, self.address)
        while self.station.turn():
            pass
        return self.listen(before)

    def say(self, name: str, *fields: object) -> list[Any]:
        return self.deliver(self.frame(name, *fields))

    def listen(self, since: int = 0) -> list[Any]:
        """What the station sent to this console, in order."""
        return messages([data for data, to in self.radio.sent[since:] if to == self.address])

    def beat(self) -> list[Any]:
        return self.say("heartbeat", 6, 8, 0, 0, 4, 3)

    def command(self, number: int, *p: float, target: int = 1, confirmation: int = 0) -> tuple[int, str]:
        """A COMMAND_LONG; (result, words) that came back."""
        seven = (*p, *[0.0] * (7 - len(p)))
        answers = self.say("command_long", target, 1, number, confirmation, *seven)
        acks = [m for m in answers if m.get_type() == "COMMAND_ACK"]
        assert [(m.command, m.target_system, m.target_component) for m in acks] == [(number, *self.party)], answers
        return acks[0].result, texts(answers)

    def reposition(
        self, latitude_deg: float | None, longitude_deg: float | None, flags: float = 1.0, frame: int = 6
    ) -> tuple[int, str]:
        """DO_REPOSITION as a COMMAND_INT; None is not given. (result, words)"""
        x, y = (0x7FFFFFFF if each is None else round(each * 1e7) for each in (latitude_deg, longitude_deg))
        numbers = (-1.0, flags, 0.0, math.nan, x, y, 0.0)
        answers = self.say("command_int", 1, 1, frame, 192, 0, 0, *numbers)
        return newest(answers, "COMMAND_ACK").result, texts(answers)

    def order(self, words: object, number: int = 1, target: int = 1) -> str | None:
        """An order in the boat's own words: why it was refused, or empty; None without an answer."""
        answers = self.deliver(self.sender.pack(ownorders.order((target, 1), number, json.dumps(words).encode())))
        found = [ownorders.numbered(m) for m in answers if m.get_type() == "V2_EXTENSION"]
        assert [its for its, _ in found] == [number] * len(found)
        return found[0][1].decode() if found else None

    def mode(self, number: int, sub: int = 0, **more: int) -> tuple[int, str]:
        return self.command(176, 1, number, sub, **more)


def messages(datagrams: list[bytes]) -> list[Any]:
    """All of them; a datagram that is not whole frames fails."""
    found = []
    for datagram in datagrams:
        cut, whole = wire.frames(datagram)
        assert whole
        found += [wire.decode(frame) for frame in cut]
    return found


def texts(heard: list[Any]) -> str:
    """All words, the pieces of long ones joined."""
    return "".join(("" if m.chunk_seq else " ") + m.text for m in heard if m.get_type() == "STATUSTEXT")


def newest(heard: list[Any], name: str) -> Any:
    return [m for m in heard if m.get_type() == name][-1]
