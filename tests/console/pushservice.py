"""A browser's push service on loopback, and the browser's end of its messages: decrypted as RFC 8291 says, by other code than
ours."""

import asyncio
import contextlib
import ssl
import struct
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from socket import AF_INET, AddressFamily
from typing import Any, cast

from aiohttp import web
from aiohttp.abc import AbstractResolver, ResolveResult
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.hmac import HMAC

from delfim.console.pages import webpush
from delfim.console.pages.webpush import PushKeys, PushSubscription

AUTH = bytes(range(16))


class Browser:
    """Its key, and what it reads."""

    def __init__(self) -> None:
        self._key = ec.generate_private_key(ec.SECP256R1())
        public = webpush.coded(webpush.point_of(self._key.public_key()))
        self.keys = PushKeys(p256dh=public, auth=webpush.coded(AUTH))

    def at(self, place: str) -> PushSubscription:
        return PushSubscription(endpoint=f"https://push.example.org/{place}", keys=self.keys)

    def reads(self, body: bytes) -> bytes:
        salt, (record, length) = body[:16], struct.unpack(">IB", body[16:21])
        sender, coded = body[21 : 21 + length], body[21 + length :]
        assert len(coded) <= record
        theirs = ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), sender)
        own = webpush.decoded(self.keys.p256dh)
        shared = self._key.exchange(ec.ECDH(), theirs)
        secret = hashed(hashed(AUTH, shared), b"WebPush: info\0" + own + sender + b"\1")
        base = hashed(salt, secret)
        key, nonce = hashed(base, b"Content-Encoding: aes128gcm\0\1")[:16], hashed(base, b"Content-Encoding: nonce\0\1")[:12]
        plain = AESGCM(key).decrypt(nonce, coded, None)
        assert plain.endswith(b"\2")
        return plain[:-1]


def hashed(key: bytes, data: bytes) -> bytes:
    made = HMAC(key, SHA256())
    made.update(data)
    return made.finalize()


@contextlib.asynccontextmanager
async def ended(app: web.Application) -> AsyncIterator[None]:
    """At the end of the block no connection of this application is left: one of TLS would wait for its visitor's goodbye."""
    lines = set[asyncio.Transport]()

    @web.middleware
    async def remember(request: web.Request, handler: Callable[[web.Request], Any]) -> web.StreamResponse:
        lines.add(cast(asyncio.Transport, request.transport))
        answer: web.StreamResponse = await handler(request)
        return answer

    app.middlewares.insert(0, remember)
    try:
        yield
    finally:
        for each in lines:
            each.abort()
        for _ in range(3):
            await asyncio.sleep(0)


class PlayedService(AbstractResolver):
    """`heard`: path, headers and body of each message. It answers with `statuses` in turn, and then with the last of them."""

    def __init__(self) -> None:
        self.heard: list[tuple[str, dict[str, str], bytes]] = []
        self.statuses = [201]
        self._port = 0

    async def resolve(self, host: str, port: int = 0, family: AddressFamily = AF_INET) -> list[ResolveResult]:
        """Every name is here."""
        told = {"hostname": host, "host": "127.0.0.1", "port": self._port, "family": AF_INET, "proto": 0, "flags": 0}
        return [ResolveResult(**told)]  # type: ignore[typeddict-item]

    async def close(self) -> None:
        """It stays."""

    @contextlib.asynccontextmanager
    async def serving(self, pem: Path) -> AsyncIterator[ssl.SSLContext]:
        """Until the end of the block; whom a sender trusts."""
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.load_cert_chain(pem)
        app = web.Application()
        app.router.add_post("/{place}", self._take)
        runner = web.AppRunner(app, shutdown_timeout=0.2)
        trust = ssl.create_default_context(cafile=str(pem))
        trust.check_hostname = False  # it has any name
        async with ended(app):
            await runner.setup()
            await web.TCPSite(runner, "127.0.0.1", 0, ssl_context=context).start()
            self._port = int(runner.addresses[0][1])
            try:
                yield trust
            finally:
                await runner.cleanup()

    async def _take(self, request: web.Request) -> web.Response:
        self.heard.append((request.path, dict(request.headers), await request.read()))
        status = self.statuses.pop(0) if len(self.statuses) > 1 else self.statuses[0]
        return web.Response(status=status, headers={"Location": "https://push.example.org/elsewhere"})
