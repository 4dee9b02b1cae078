"""Wakes operators whose page is closed: grave alerts go to the push services of their browsers, each alert once.

A page subscribes; the service's address comes from its browser, so it is no word of ours: only public names by HTTPS are asked,
no address of a private network is connected to, nothing is followed and nothing of an answer is read.
"""

import asyncio
import ssl
from collections.abc import Callable, Iterable
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from socket import AF_UNSPEC, AddressFamily
from typing import TYPE_CHECKING, Annotated, Final

import msgspec
from aiohttp import ClientError, ClientSession, ClientTimeout, TCPConnector, web
from aiohttp.abc import AbstractResolver, ResolveResult
from aiohttp.resolver import ThreadedResolver

from delfim.base.clock import Clock
from delfim.base.errors import DelfimError, FormatError, in_words
from delfim.base.input.untrusted import read_file
from delfim.base.wholefile import replace_file
from delfim.console.pages import webpush
from delfim.console.pages.admission import OPERATOR
from delfim.console.pages.webpush import PushSubscription
from delfim.console.watch.alerts import StandingAlert
from delfim.console.watch.alertstate import UNSEEN, Priority
from delfim.console.watch.operators import OperatorsFile

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

BROWSERS_MAX: Final = 16  # the oldest gives way
WAITING_MAX: Final = 32  # messages; what is beyond is on the page
ASK_S: Final = 10.0  # for all of an answer
AGAIN_S: Final = (5.0, 30.0)  # until the second and the third try
LIFE_S: Final = 3600  # a service keeps it for a browser that is off; later it is no news
BODY_MAX: Final = 4096
GONE: Final = (404, 410)
TEXT_MAX: Final = 300


class KeptPush(msgspec.Struct):
    """The file: this console's key, and who is to be woken."""

    key: webpush.Coded = ""
    browsers: Annotated[list[PushSubscription], msgspec.Meta(max_length=BROWSERS_MAX)] = []


class PublicNames(AbstractResolver):
    """Resolves names to public addresses alone: a name may point into the boat's own network."""

    def __init__(self) -> None:
        self._names = ThreadedResolver()

    async def resolve(self, host: str, port: int = 0, family: AddressFamily = AF_UNSPEC) -> list[ResolveResult]:
        found = await self._names.resolve(host, port, family)
        if any(not ip_address(each["host"].partition("%")[0]).is_global for each in found):
            raise OSError(f"{host} is no public place")
        return found

    async def close(self) -> None:
        await self._names.close()


class PushDesk:
    """`reason` says why somebody could not be woken, or is empty. `names` and `trust` are what tests play."""

    def __init__(
        self,
        file: Path,
        operators: OperatorsFile,
        clock: Clock,
        contact: str = "",
        names: AbstractResolver | None = None,
        trust: ssl.SSLContext | None = None,
        again_s: tuple[float, ...] = AGAIN_S,
    ) -> None:
        self.reason = ""
        self._file, self._operators, self._clock, self._contact = file, operators, clock, contact
        self._names, self._trust, self._again_s = names, trust, again_s
        self._kept = KeptPush()
        try:
            self._kept = msgspec.json.decode(read_file(file), type=KeptPush) if file.exists() else self._kept
            for each in self._kept.browsers:
                each.check()
        except (DelfimError, OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
            self._kept, self.reason = KeptPush(), f"who is to be woken is lost: {in_words(error)}"
        self._told: set[int] | None = None  # numbers of alerts; None: those that stand at the start are not known yet
        self._waiting, self._sending = asyncio.Queue[bytes](maxsize=WAITING_MAX), False

    def routes(self, app: web.Application) -> None:
        app.router.add_get("/push", self._tell_key)
        app.router.add_post("/push", self._subscribe)
        app.router.add_post("/unpush", self._unsubscribe)

    @property
    def is_idle(self) -> bool:
        return self._waiting.empty() and not self._sending

    def look(self, alerts: Iterable[StandingAlert], name_of: Callable[[int], str]) -> None:
        """Called often: what is new and grave, and nobody has taken note of, is to be sent."""
        grave = {each.id: each for each in alerts if each.priority <= Priority.ALARM and each.state in UNSEEN}
        new = [] if self._told is None else [each for number, each in grave.items() if number not in self._told]
        self._told = set(grave)
        for each in new if self._kept.browsers else ():
            title = "console" if each.boat is None else name_of(each.boat) or f"boat {each.boat}"
            words = {"title": f"{title}: {each.priority.name.lower()}", "body": each.text[:TEXT_MAX], "tag": str(each.id)}
            with suppress(asyncio.QueueFull):
                self._waiting.put_nowait(msgspec.json.encode(words))

    async def follow(self) -> None:
        """Sends what is to be sent, until it is cancelled."""
        while True:
            self._sending = False
            message = await self._waiting.get()
            self._sending = True
            connector = TCPConnector(resolver=self._names or PublicNames(), ssl=self._trust or True)
            async with ClientSession(connector=connector, timeout=ClientTimeout(total=ASK_S), trust_env=False) as session:
                whys = await asyncio.gather(*(self._send(session, each, message) for each in self._awake()))
            self.reason = next(filter(None, whys), "")

    def _awake(self) -> list[PushSubscription]:
        """Those whose operator's key was not revoked."""
        known = {each.name for each in self._operators.known}
        return [each for each in self._kept.browsers if not self._operators.closed or each.by in known]

    async def _send(self, session: ClientSession, to: PushSubscription, message: bytes) -> str:
        """Tries a few times. Returns why it did not succeed, or nothing."""
        why = ""
        for wait_s in (0.0, *self._again_s):
            await asyncio.sleep(wait_s)
            try:
                why, is_final = await self._ask(session, to, message)
            except (ClientError, OSError, TimeoutError, DelfimError, ValueError) as error:  # a name that is none, too
                why, is_final = f"nobody is woken by push: {in_words(error) or type(error).__name__}", False
            if is_final:
                break
        return why

    async def _ask(self, session: ClientSession, to: PushSubscription, message: bytes) -> tuple[str, bool]:
        headers = {
            "Authorization": webpush.authorization(self._key(), to.endpoint, self._contact, self._clock.time_ns() / 1e9),
            "Content-Encoding": "aes128gcm",
            "TTL": str(LIFE_S),
            "Urgency": "high",
        }
        body = webpush.encrypted(message, to.keys)
        async with session.post(to.endpoint, data=body, headers=headers, allow_redirects=False) as answer:
            if answer.status in GONE:
                self._keep([each for each in self._kept.browsers if each.endpoint != to.endpoint])
                return "", True
            is_well = 200 <= answer.status < 300
            why = "" if is_well else f"nobody is woken by push: its service answered {answer.status}"
            return why, is_well or (answer.status < 500 and answer.status != 429)

    def _key(self) -> "EllipticCurvePrivateKey":
        return webpush.private_key(self._kept.key)

    def _keep(self, browsers: list[PushSubscription]) -> None:
        self._kept.browsers = browsers[-BROWSERS_MAX:]
        try:
            self._file.touch(mode=0o600)
            replace_file(self._file, msgspec.json.encode(self._kept))
        except OSError as error:
            self.reason = f"who is to be woken is not kept: {in_words(error)}"

    async def _tell_key(self, request: web.Request) -> web.Response:
        """The public key, which browsers want before they subscribe."""
        if not self._kept.key:
            self._kept.key = webpush.number_of(webpush.private_key())
            self._keep(self._kept.browsers)
        return web.Response(text=webpush.coded(webpush.point_of(self._key().public_key())))

    async def _subscribe(self, request: web.Request) -> web.Response:
        new = msgspec.structs.replace(await self._asked(request), by=request[OPERATOR].name if OPERATOR in request else "")
        try:
            new.check()
        except FormatError as error:
            raise web.HTTPBadRequest(text=f"{error}\n") from None
        self._keep([*(each for each in self._kept.browsers if each.endpoint != new.endpoint), new])
        return web.Response(text="")

    async def _unsubscribe(self, request: web.Request) -> web.Response:
        old = await self._asked(request)
        self._keep([each for each in self._kept.browsers if each.endpoint != old.endpoint])
        return web.Response(text="")

    async def _asked(self, request: web.Request) -> PushSubscription:
        if (request.content_length or BODY_MAX + 1) > BODY_MAX:
            raise web.HTTPRequestEntityTooLarge(BODY_MAX, request.content_length or 0)
        try:
            return msgspec.json.decode(await request.read(), type=PushSubscription)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise web.HTTPBadRequest(text=f"{error}\n") from None
