"""The listener for the guest computer (docs/guest.md): who may connect, and the proof of a key.

A connection becomes the guest's, and replaces the one before, when its network may connect and, where the vehicle's file names
a key, when it has answered a challenge. Until then it hears nothing of the boat. The proof says who opened the connection;
nothing is encrypted. A proof takes some microseconds, so the loop checks it.
"""

import asyncio
import hmac
import logging
import secrets
from typing import Final, cast

import msgspec

from delfim.base.clock import Clock
from delfim.base.input.keys import read_key
from delfim.base.input.unreadable import UNREADABLE
from delfim.canproxy.cantcp.access import Networks
from delfim.services.access.connection_limits import ConnectionLimits
from delfim.services.tables import GuestTable
from delfim.vehicle.grex import Guest, proof
from delfim.vehicle.state import State

WAITING: Final = 8  # connections that have not answered yet
WAITING_PER_ADDRESS: Final = 4
ANSWER_S: Final = 5.0  # for the answer
ANSWER_BYTES: Final = 256
TOLD_S: Final = 10.0  # between two refusals in the log; all of them are counted

log = logging.getLogger(__name__)


class GuestAnswer(msgspec.Struct, frozen=True):
    """The line with which a guest answers the challenge."""

    proof: str


_decode = msgspec.json.Decoder(GuestAnswer).decode


class GuestListener:
    """Admits the guest. Raises ConfigError for a key that cannot be read."""

    def __init__(self, table: GuestTable, guest: Guest, state: State, clock: Clock) -> None:
        self.key = read_key(table.key) if table.key else None
        self.guest, self.waiting = guest, set[GuestVisitor]()
        self.door = ConnectionLimits(WAITING, WAITING_PER_ADDRESS)
        self._networks, self._state, self._clock = Networks(table.networks), state, clock
        self._told_s = -TOLD_S

    def visitor(self) -> "GuestVisitor":
        return GuestVisitor(self)

    def may_connect(self, host: str) -> bool:
        return host in self._networks

    def refused(self, host: str, reason: str) -> None:
        self._state.count("guest_refused")
        now_s = self._clock.monotonic_s()
        if now_s - self._told_s >= TOLD_S:
            self._told_s = now_s
            log.warning("guest: %s refused: %s", host, reason)

    def close(self) -> None:
        for visitor in tuple(self.waiting):
            visitor.hang_up()
        self.guest.close()


class GuestVisitor(asyncio.Protocol):
    """A connection that is not yet the guest's."""

    def __init__(self, door: GuestListener) -> None:
        self._door, self._challenge, self._said, self._is_inside = door, secrets.token_hex(16), b"", False
        self._transport: asyncio.Transport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._host = ""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's transports do not inherit from it
        self._host = str(transport.get_extra_info("peername")[0])
        if not self._door.may_connect(self._host):
            self._refuse("its network is not in guest.networks")
        elif self._door.key is None:
            self._let_in(b"")
        elif not self._door.door.enter(self._host):
            self._refuse("too many connections wait")
        else:
            self._is_inside = True
            self._door.waiting.add(self)
            self._timer = asyncio.get_running_loop().call_later(ANSWER_S, self._refuse, f"no answer within {ANSWER_S:.0f} s")
            self._transport.write(msgspec.json.encode({"challenge": self._challenge}) + b"\n")

    def data_received(self, data: bytes) -> None:
        if not self._is_inside:
            return
        self._said += data
        line, ended, rest = self._said.partition(b"\n")
        if ended and len(line) <= ANSWER_BYTES:
            self._judge(line, rest)
        elif len(self._said) > ANSWER_BYTES:
            self._refuse("what it said is no answer")

    def connection_lost(self, exc: Exception | None) -> None:
        self._leave()

    def hang_up(self) -> None:
        self._leave()
        if self._transport is not None:
            self._transport.abort()

    def _judge(self, line: bytes, rest: bytes) -> None:
        assert self._door.key is not None
        try:
            answer = _decode(line).proof.encode()
        except UNREADABLE:
            self._refuse("what it said is no answer")
            return
        if not hmac.compare_digest(answer, proof(self._door.key, self._challenge).encode()):
            self._refuse("wrong key")
        else:
            self._leave()
            self._let_in(rest)

    def _let_in(self, rest: bytes) -> None:
        assert self._transport is not None
        guest = self._door.guest
        self._transport.set_protocol(guest)
        guest.connection_made(self._transport)
        if rest:
            guest.data_received(rest)

    def _refuse(self, reason: str) -> None:
        self._door.refused(self._host, reason)
        self.hang_up()

    def _leave(self) -> None:
        """Stop waiting for its answer."""
        if self._timer is not None:
            self._timer.cancel()
        if self._is_inside:
            self._is_inside = False
            self._door.waiting.discard(self)
            self._door.door.leave(self._host)
