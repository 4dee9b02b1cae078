"""Carries orders of payload programs to the vehicle: one connection to its command socket, one order after the other.

The vehicle decides and answers (`delfim/vehicle/orders/entrusting.py`). Here an order waits no longer than a moment, and of
each program no more than a few do; all others are refused at once.
"""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable
from typing import Final, NamedTuple

import msgspec

from delfim.base.clock import Clock
from delfim.base.errors import in_words
from delfim.vehicle import console

WAITING: Final = 8  # orders of one program that wait for the vehicle
WAIT_S: Final = 2.0  # an older order is not carried out any more
AGAIN_S: Final = 1.0  # before the vehicle is asked again

Answer = Callable[[str | None], None]  # called once, with the reason of a refusal, or None


class WaitingOrder(NamedTuple):
    """An order of a program that the vehicle has not answered yet."""

    program: str
    command: console.Commands
    answer: Answer
    since_s: float


class _Told(msgspec.Struct):
    ok: bool
    reason: str


_told: Final = msgspec.json.Decoder(_Told).decode
_encode: Final = msgspec.json.Encoder().encode


class OrderLine:
    """The connection to the vehicle. `order` hands in an order, `follow` carries them until it is cancelled."""

    def __init__(self, socket: str, clock: Clock) -> None:
        self._socket, self._clock = socket, clock
        self._waiting, self._of = asyncio.Queue[WaitingOrder](), Counter[str]()  # bounded by WAITING

    def order(self, program: str, command: console.Commands, answer: Answer) -> None:
        """Hand in an order; it may be refused before this returns."""
        if self._of[program] >= WAITING:
            answer(f"refused: {WAITING} orders wait for the vehicle already")
            return
        self._of[program] += 1
        self._waiting.put_nowait(WaitingOrder(program, command, answer, self._clock.monotonic_s()))

    async def follow(self) -> None:
        while True:
            try:
                reader, writer = await asyncio.open_unix_connection(self._socket)
                with contextlib.closing(writer):
                    while True:
                        await self._carry(reader, writer)
            except (OSError, ValueError, msgspec.DecodeError) as error:
                why = f"refused: the vehicle does not answer: {in_words(error)}"
            while not self._waiting.empty():
                self._end(self._waiting.get_nowait(), why)
            await asyncio.sleep(AGAIN_S)

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry the next order, and its answer. Raises OSError, ValueError, DecodeError where the vehicle gives none."""
        each = await self._waiting.get()
        why: str | None = "refused: the vehicle did not answer"
        try:
            if (waited_s := self._clock.monotonic_s() - each.since_s) > WAIT_S:
                why = f"refused: it waited {waited_s:.1f} s for the vehicle"
                return
            writer.write(_encode({"command": "ordered", "payload": each.program, "order": each.command}) + b"\n")
            told = _told(await reader.readline())
            why = None if told.ok else told.reason
        finally:
            self._end(each, why)

    def _end(self, each: WaitingOrder, why: str | None) -> None:
        self._of[each.program] -= 1
        each.answer(why)
