"""The rover's end of NTRIP against casters of both versions, hostile ones among them."""

import asyncio
import contextlib
import ssl
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from delfim.base.errors import ConfigError
from delfim.base.input.untrusted import read_credentials
from delfim.parts.gnss.ntrip import LINE_BYTES, Caster, CasterRefusal, open_stream, request

GGA = b"$GPGGA,120000.00,3841.4,N,00912.9,W,1,09,0.9,,M,,M,,*5B\r\n"


@contextlib.asynccontextmanager
async def caster(answer: bytes, tls: ssl.SSLContext | None = None) -> AsyncIterator[tuple[Caster, list[bytes]]]:
    """One that gives everybody this answer and ends the connection; and what it was asked."""
    asked = list[bytes]()

    async def served(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            asked.append(await reader.readuntil(b"\r\n\r\n"))
            writer.write(answer)
            await writer.drain()
        writer.close()

    server = await asyncio.start_server(served, "127.0.0.1", 0, ssl=tls)
    async with server:
        yield Caster("127.0.0.1", server.sockets[0].getsockname()[1], "BASE", tls is not None), asked


async def heard(place: Caster, credentials: str = "") -> bytes:
    """All that a caster sends."""
    stream = await open_stream(place)
    try:
        async with asyncio.timeout(200):
            await stream.begin(place, credentials, b"")
            return b"".join([data async for data in stream.pieces()])
    finally:
        stream.writer.close()


@pytest.mark.parametrize(
    "answer",
    [
        b"ICY 200 OK\r\n12345678",
        b"HTTP/1.1 200 OK\r\nContent-Type: gnss/data\r\n\r\n12345678",
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n5\r\n12345\r\n3;x=y\r\n678\r\n0\r\n\r\n",
    ],
)
async def test_both_versions_are_heard(answer):
    async with caster(answer) as (place, _):
        assert await heard(place) == b"12345678"


@pytest.mark.parametrize(
    ("answer", "credentials", "words"),
    [
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", "ana:wrong", "it refuses user and password"),
        (b"HTTP/1.0 401 Unauthorized\r\n\r\n", "", "it asks for user and password"),
        (b"ERROR - Bad Password\r\n", "ana:wrong", "it refuses user and password"),
        (b"SOURCETABLE 200 OK\r\n\r\nENDSOURCETABLE\r\n", "", "it has no mountpoint BASE"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "", "it has no mountpoint BASE"),
        (b"HTTP/1.1 200 OK\r\nContent-Type: gnss/sourcetable\r\n\r\n", "", "it has no mountpoint BASE"),
        (b"HTTP/1.1 503 Too busy\x1b[2J\r\n\r\n", "", "it answers HTTP/1.1 503 Too busy\\x1b[2J"),
        (b"SSH-2.0-OpenSSH\r\n", "", "it answers SSH-2.0-OpenSSH"),
        (b"", "", "it answers nothing"),
        (b"HTTP/1.1 200 OK\r\n" + b"X: y\r\n" * 200, "", "the head of its answer has no end"),
        (b"HTTP/1.1 200 OK" + bytes(2 * LINE_BYTES), "", "its answer is no NTRIP"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n", "", "its stream is no sound HTTP"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nffffffff\r\n", "", "its stream is no sound HTTP"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n5\r\n12345\r\n", "", "it ended the connection"),
    ],
)
async def test_a_caster_that_does_not_send_is_told_in_words(answer, credentials, words):
    async with caster(answer) as (place, _):
        with pytest.raises(CasterRefusal) as refused:
            await heard(place, credentials)
        assert str(refused.value) == words


def test_the_request_is_of_version_2_with_user_place_and_program():
    lines = request(Caster("caster.example", 2101, "BASE", tls=False), "ana:secret", GGA).decode().split("\r\n")
    assert lines[0] == "GET /BASE HTTP/1.1"
    assert {"Host: caster.example:2101", "Ntrip-Version: Ntrip/2.0", "Authorization: Basic YW5hOnNlY3JldA=="} <= {*lines}
    assert f"Ntrip-GGA: {GGA.decode().strip()}" in lines
    assert [line for line in lines if line.startswith("User-Agent: NTRIP delfim/")]
    assert lines[-2:] == ["", ""]


def test_a_place_of_the_vehicles_file():
    assert Caster.of("ntrip://caster.example:2101/BASE") == Caster("caster.example", 2101, "BASE", tls=False)
    assert Caster.of("ntrips://[fe80::1]:443/a/b?c") == Caster("fe80::1", 443, "a/b?c", tls=True)


async def test_tls_asks_for_a_certificate_that_is_the_casters(certificate, monkeypatch):
    """The test's own one says "boat", and nobody vouches for it."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    async with caster(b"ICY 200 OK\r\n1234", context) as (place, asked):
        with pytest.raises(ssl.SSLCertVerificationError):
            await heard(place, "ana:secret")
        assert asked == [], "nobody hears the password"
        monkeypatch.setattr(ssl, "create_default_context", lambda: unverified)
        unverified = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        unverified.check_hostname, unverified.verify_mode = False, ssl.CERT_NONE
        assert await heard(place, "ana:secret") == b"1234"


@pytest.mark.parametrize(
    ("text", "mode", "words"),
    [
        ("ana:secret\n", 0o600, ""),
        ("ana:secret\n", 0o640, "others may read it"),
        ("secret\n", 0o600, "no user and password"),
        ("ana:se\ncret\n", 0o600, "no user and password"),
        ("ana:sécret\n", 0o600, "not ASCII"),
    ],
)
def test_a_file_of_user_and_password(tmp_path: Path, text: str, mode: int, words: str):
    file = tmp_path / "ntrip"
    file.write_text(text)
    file.chmod(mode)
    if not words:
        assert read_credentials(str(file)) == "ana:secret"
        return
    with pytest.raises(ConfigError, match=words):
        read_credentials(str(file))
    with pytest.raises(ConfigError, match="No such file"):
        read_credentials(str(tmp_path / "none"))
