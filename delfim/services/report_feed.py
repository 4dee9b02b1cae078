"""Feeds the vehicle's report to services in processes of their own, over the local command socket, as to a console."""

import asyncio
import contextlib
from collections.abc import Callable
from typing import Final

import msgspec

from delfim.base.errors import in_words
from delfim.vehicle.report import BoatReport, reported

AGAIN_S: Final = 1.0  # before the vehicle is asked again
ANSWER_BYTES: Final = 1 << 20  # of the vehicle, at most


async def watch(path: str, heard: Callable[[BoatReport], None], failed: Callable[[str], None], quick: bool = False) -> None:
    """Hand over what the vehicle publishes, about five times a second, or ten times if `quick`, until it is cancelled; `failed`
    gets words while it does not answer."""
    asked = b'{"command": "watch", "quick": true}\n' if quick else b'{"command": "watch"}\n'
    while True:
        try:
            reader, writer = await asyncio.open_unix_connection(path, limit=ANSWER_BYTES)
            with contextlib.closing(writer):
                writer.write(asked)
                while line := await reader.readline():
                    heard(reported(line))
            failed("the vehicle closed the connection")
        except (OSError, ValueError, msgspec.DecodeError) as error:
            failed(f"the vehicle does not answer: {in_words(error)}")
        await asyncio.sleep(AGAIN_S)
