"""NTRIP, the protocol of casters (RTCM 10410.1, versions 1 and 2): the request of a rover, and the stream that answers it.

One request serves both versions: a caster of version 1 does not look at what it does not know, and says "ICY". Nothing here
retries: whoever calls does.
"""

import asyncio
import base64
import re
import ssl
from collections.abc import AsyncIterator
from typing import Final, NamedTuple

from delfim import __version__
from delfim.base.errors import DelfimError, one_line

LINE_BYTES: Final = 2048  # of the answer's head
LINES_MAX: Final = 64  # of it
READ_BYTES: Final = 4096
CHUNK_MAX: Final = 1 << 20
SAID_CHARACTERS: Final = 80  # of a caster's words in ours
_CASTER: Final = re.compile(r"(ntrips?)://([^/:]+|\[[0-9A-Fa-f:]+\]):(\d+)/(.+)").fullmatch


class CasterRefusal(DelfimError):
    """The refusal of a caster to send corrections, with its reason."""


class Caster(NamedTuple):
    host: str
    port: int
    mountpoint: str
    tls: bool

    @classmethod
    def of(cls, place: str) -> "Caster":
        """The caster of the vehicle's file, which has checked its form."""
        found = _CASTER(place)
        assert found is not None
        kind, host, port, mountpoint = found.groups()
        return cls(host.strip("[]"), int(port), mountpoint, kind == "ntrips")


def request(caster: Caster, credentials: str, gga: bytes) -> bytes:
    """The request of the rover. `credentials` as USER:PASSWORD, or empty; `gga`: the sentence of the present position, or
    empty."""
    host = f"[{caster.host}]" if ":" in caster.host else caster.host
    lines = [
        f"GET /{caster.mountpoint} HTTP/1.1",
        f"Host: {host}:{caster.port}",
        "Ntrip-Version: Ntrip/2.0",
        f"User-Agent: NTRIP delfim/{__version__}",
        *([f"Ntrip-GGA: {gga.decode().strip()}"] if gga else []),
        *([f"Authorization: Basic {base64.b64encode(credentials.encode()).decode()}"] if credentials else []),
        "Connection: close",
    ]
    return "\r\n".join(lines).encode() + b"\r\n\r\n"


class CasterStream:
    """A connection to a caster that sends."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self.writer, self._is_chunked = reader, writer, False

    async def begin(self, caster: Caster, credentials: str, gga: bytes) -> None:
        """Send the request, and read the head of the answer. Raises CasterRefusal, OSError."""
        self.writer.write(request(caster, credentials, gga))
        first = await self._line()
        if first.startswith("ICY 200"):
            return
        _, _, rest = first.partition(" ")
        if first.startswith("SOURCETABLE") or rest.startswith("404"):
            raise CasterRefusal(f"it has no mountpoint {caster.mountpoint}")
        if rest.startswith(("401", "403")) or "password" in first.lower():
            raise CasterRefusal("it refuses user and password" if credentials else "it asks for user and password")
        if not (first.startswith("HTTP/1.") and rest.startswith("200")):
            raise CasterRefusal(f"it answers {one_line(first[:SAID_CHARACTERS]) or 'nothing'}")
        for _ in range(LINES_MAX):
            name, _, value = (await self._line()).lower().partition(":")
            if not name:
                return
            if name == "transfer-encoding" and "chunked" in value:
                self._is_chunked = True
            if name == "content-type" and "sourcetable" in value:
                raise CasterRefusal(f"it has no mountpoint {caster.mountpoint}")
        raise CasterRefusal("the head of its answer has no end")

    async def pieces(self) -> AsyncIterator[bytes]:
        """The data that it sends, as they come, until it ends the connection. Raises CasterRefusal, OSError."""
        while not self._is_chunked and (data := await self._reader.read(READ_BYTES)):
            yield data
        while self._is_chunked:
            size = (await self._line()).partition(";")[0].strip()
            if not re.fullmatch("[0-9A-Fa-f]{1,8}", size) or (left := int(size, 16)) > CHUNK_MAX:
                raise CasterRefusal("its stream is no sound HTTP" if size else "it ended the connection")
            if not left:
                return
            while left and (data := await self._reader.read(min(left, READ_BYTES))):
                left -= len(data)
                yield data
            await self._line()

    async def _line(self) -> str:
        """Read a line without its end; empty at the end of the stream. Raises CasterRefusal."""
        try:
            return (await self._reader.readline()).decode("latin-1").rstrip("\r\n")
        except ValueError:
            raise CasterRefusal("its answer is no NTRIP") from None


async def open_stream(caster: Caster) -> CasterStream:
    """Connect to a caster. Raises OSError, also where the certificate is not that of this caster."""
    context = ssl.create_default_context() if caster.tls else None
    reader, writer = await asyncio.open_connection(caster.host, caster.port, ssl=context, limit=LINE_BYTES)
    return CasterStream(reader, writer)
