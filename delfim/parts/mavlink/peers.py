"""Peers: the addresses that listen to the vehicle by MAVLink, the messages told to each, and texts to all of them."""

import math
from collections import deque
from collections.abc import Callable
from typing import Final

from delfim.base.clock import Clock
from delfim.parts.mavlink import telemetry
from delfim.parts.mavlink.codec import params
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.codec.wire import Address, Message, Sender, Speaker, dialect
from delfim.parts.mavlink.table import Mavlink
from delfim.parts.mavlink.telemetry import Profile, TelemetryRow

PEERS: Final = 16  # at once
HEARD_S: Final = 15.0  # a peer silent for longer gets only the heartbeat; one not in the vehicle's file is forgotten
PACKED_BYTES: Final = 1200  # several messages share a datagram up to this size
TEXT_BYTES: Final = 50
SAID_BYTES: Final = 4 * TEXT_BYTES  # of a reason, however long it is


class Peer:
    """An address that listens, and the messages it was told."""

    def __init__(self, address: Address, sender: Sender, profile: Profile, configured: bool) -> None:
        self.address, self.sender, self.profile, self.configured = address, sender, profile, configured
        self.source: Speaker | None = None  # the sender at this address
        self.heard_s = -math.inf
        self.asked_s: dict[int, float] = {}  # intervals that it asked for, by message
        self.due_s: dict[int, float] = {}
        self.turns: dict[int, int] = {}  # how often it was told, by message
        self.told: dict[int, object] = {}  # last value told, by message
        self.params: deque[str] = deque(maxlen=len(params.NAMES))  # to be told, a few a tick
        self.answered: tuple[str, float, Message] | None = None  # the last command, when, and its answer

    def interval_s(self, row: TelemetryRow) -> float:
        return self.asked_s.get(row.id, row.interval_s(self.profile))


class Peers:
    """All of them. `send` takes a datagram and its address; `signing` is None without a key; `count` counts
    refusals."""

    def __init__(
        self,
        system: int,
        settings: Mavlink,
        clock: Clock,
        send: Callable[[bytes, Address], object],
        signing: Signing | None,
        count: Callable[[str], None],
    ) -> None:
        self.known: dict[Address, Peer] = {}
        self._system, self._profile, self._clock = system, settings.profile, clock
        self._send, self._signing, self._count = send, signing, count
        self._text_id = 0
        for listen in settings.peers:
            host, _, port = listen.rpartition(":")
            self.at((host.strip("[]"), int(port)), None, configured=True)
        if settings.serial and (radio := self.at((settings.serial, settings.baud), None, configured=True)):
            radio.profile = "lean" if settings.profile == "lean" else "radio"

    def at(self, address: Address, commander: Speaker | None, configured: bool = False) -> Peer | None:
        """The peer at an address; None if there are too many and none can be dropped."""
        if address not in self.known:
            if len(self.known) >= PEERS and not self._makes_room(commander):
                self._count("peers_full")
                return None
            key, stamp = (None, _no_stamp) if self._signing is None else (self._signing.key, self._signing.stamp)
            sender = Sender(self._system, telemetry.COMPONENT, key, stamp)
            self.known[address] = Peer(address, sender, self._profile, configured)
        return self.known[address]

    def _makes_room(self, commander: Speaker | None) -> bool:
        """Forget the peer silent for longest, but none of the vehicle's file and not the one that commands."""
        others = [peer for peer in self.known.values() if not peer.configured and peer.source != commander]
        if not others:
            return False
        del self.known[min(others, key=lambda peer: peer.heard_s).address]
        self._count("peers_replaced")
        return True

    def forget_silent(self, now_s: float) -> None:
        """Forget silent peers that are not in the vehicle's file."""
        for peer in [peer for peer in self.known.values() if not peer.configured and now_s - peer.heard_s > HEARD_S]:
            del self.known[peer.address]

    def tell(self, peer: Peer, messages: list[Message]) -> None:
        packed = b""
        for message in messages:
            frame = peer.sender.pack(message)
            if packed and len(packed) + len(frame) > PACKED_BYTES:
                self._send(packed, peer.address)
                packed = b""
            packed += frame
        if packed:
            self._send(packed, peer.address)

    def present(self) -> list[Peer]:
        """Those that were heard lately."""
        now_s = self._clock.monotonic_s()
        return [peer for peer in self.known.values() if now_s - peer.heard_s <= HEARD_S]

    def tell_all(self, messages: list[Message]) -> None:
        """Send messages to every console that is present."""
        for peer in self.present():
            self.tell(peer, messages)

    def say(self, severity: int, text: str, only: list[Peer] | None = None) -> None:
        """Send a text to every console that is present, or to some of them."""
        self._text_id = self._text_id % 0xFFFF + 1
        data = text.encode("ascii", "replace")[:SAID_BYTES]
        chunks = [data[at : at + TEXT_BYTES] for at in range(0, max(len(data), 1), TEXT_BYTES)]
        number = self._text_id if len(chunks) > 1 else 0
        texts = [dialect.MAVLink_statustext_message(severity, chunk, number, i) for i, chunk in enumerate(chunks)]
        for peer in self.present() if only is None else only:
            self.tell(peer, texts)

    def hurry(self, *ids: int) -> None:
        """These messages are due at once, to everybody."""
        for peer in self.known.values():
            for each in ids:
                peer.due_s.pop(each, None)


def _no_stamp() -> int:
    return 0
