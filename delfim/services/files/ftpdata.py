"""The data connection of FTP: a transfer from its announcement to its end or abort."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any, Final

from delfim.base.errors import DelfimError
from delfim.services.files.uploads import NoRoom

DATA_S: Final = 30.0  # for the client to open a data connection; a radio is slow
STALL_S: Final = 60.0  # a client that neither reads nor sends for so long is gone
BLOCK_BYTES: Final = 64 << 10


class Answered(DelfimError):
    """Signals that the client has had its answer."""


@contextlib.asynccontextmanager
async def carried(connection: Any) -> AsyncIterator[Any]:
    """Carry a transfer: announce it, move its data, answer its end."""
    if not connection.is_data_secret:
        connection.response("521", "send PROT P first")
        raise Answered
    if not connection.future.passive_server.done():
        connection.response("425", "send PASV or EPSV first")
        raise Answered
    connection.response("150", "transfer begins")
    connection.aborted, connection.awaited = False, True
    try:
        async with asyncio.timeout(DATA_S):
            stream = connection.carrying = await connection["data_connection"]
    except (TimeoutError, ConnectionAbortedError):
        connection.response("425", "no data connection")
        raise Answered from None
    finally:
        connection.awaited = False
        del connection.data_connection
    try:
        yield stream
        stream.writer.close()
        async with asyncio.timeout(STALL_S):
            await stream.writer.wait_closed()
        connection.response("226", "transfer complete")
    except (DelfimError, OSError) as error:
        words = str(error) if isinstance(error, DelfimError) else "transfer broken off"
        connection.response("452" if isinstance(error, NoRoom) else "426", words)
        raise Answered from None
    finally:
        cut(stream.writer.transport)
        del connection.carrying


def cut(transport: asyncio.WriteTransport) -> None:
    """End a data connection at once, if it has not ended: asyncio's is not to be aborted once it has sent its last bytes after
    it was closed, and shows that by having no loop."""
    with contextlib.suppress(AttributeError):
        transport.abort()


async def abor(connection: Any, rest: Any) -> bool:
    """End the transfer that is under way; its own answer comes first."""
    if not connection.idle.is_set():
        connection.aborted = True
        if connection.future.carrying.done():
            cut(connection.carrying.writer.transport)
        elif connection.awaited and not connection["data_connection"].done():
            connection["data_connection"].set_exception(ConnectionAbortedError("aborted"))
        await connection.idle.wait()
    connection.response("226", "ok")
    return True
