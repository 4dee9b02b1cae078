"""A connection to an MQTT broker, for boats and for the console (docs/fleets.md): the frames and states of boats, by topic.

Only news is sent: while the broker is away nothing is kept but the newest of each state, and what waited too long is dropped
and counted. Nobody waits for the broker.
"""

import asyncio
import contextlib
import errno
import re
import secrets
import socket
import ssl
from collections import Counter, deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from delfim.base.clock import Clock
from delfim.base.errors import ConfigError, in_words
from delfim.base.input.untrusted import read_credentials

if TYPE_CHECKING:
    import aiomqtt

STALE_S: Final = 2.0  # a frame that waited longer for the broker is not sent
ALIVE_S: Final = 10  # of silence, after which the two ask each other; after half as much again the broker tells the last will
ANSWER_S: Final = 5.0  # for each step with the broker
END_S: Final = 0.5  # for the last word
FLUSH_LOOKS: Final = 25  # in this time
PAUSES_S: Final = 1.0, 15.0  # before the next try: the first, and the longest
SOCKET: Final = (  # what leaves leaves at once; bytes that the kernel keeps of it and of what came: on a bad link they grow old
    (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
    (socket.SOL_SOCKET, socket.SO_SNDBUF, 16_384),
    (socket.SOL_SOCKET, socket.SO_RCVBUF, 65_536),
)
PAYLOAD_BYTES: Final = 2048  # a larger message is none of ours
PACKET_BYTES: Final = 1 << 16  # a larger one ends the connection before it is read: the library would keep all of it
PUBLISH, QUALITY = 0x30, 0x06  # in the first byte of a packet
UP, DOWN, STATE, LINK = "up", "down", "state", "link"  # frames of the boat, frames to it, its state, whether it is there
_BROKER: Final = re.compile(r"(mqtts?)://([A-Za-z0-9.-]+|\[[0-9A-Fa-f:]+\]):(\d{1,5})(?:/([A-Za-z0-9_-]{1,40}))?").fullmatch


class BrokerPlace(NamedTuple):
    """The address of a broker, and the first part of the topics of one fleet."""

    host: str
    port: int
    root: str
    tls: bool

    @classmethod
    def of(cls, words: str) -> "BrokerPlace":
        """Parse `mqtts://HOST:PORT/FLEET`. Raises ConfigError."""
        found = _BROKER(words)
        if found is None or int(found[3]) >= 1 << 16:
            raise ConfigError("broker", words, "no broker", "mqtts://HOST:PORT or mqtts://HOST:PORT/FLEET, or mqtt without TLS")
        return cls(found[2].strip("[]"), int(found[3]), found[4] or "delfim", found[1] == "mqtts")

    def topic(self, boat: str, of: str) -> str:
        return f"{self.root}/{boat}/{of}"


class BrokerLine:
    """One connection. `hear` gets topic and payload of what comes for `topic`; `held` frames wait at most. `boat`: its name is
    this end's, and its link is published, also by the last will. `reason` says why there is no connection; empty: there is one.
    Raises ConfigError for files that cannot be read."""

    def __init__(
        self,
        place: BrokerPlace,
        topic: str,
        hear: Callable[[str, bytes], None],
        clock: Clock,
        *,
        credentials: str = "",
        authorities: str = "",
        boat: str = "",
        held: int = 64,
    ) -> None:
        self.place, self.reason, self.counts = place, "not connected yet", Counter[str]()
        self._topic, self._hear, self._clock, self._boat = topic, hear, clock, boat
        user, _, password = read_credentials(credentials).partition(":") if credentials else ("", "", "")
        self._login: dict[str, Any] = {"username": user, "password": password} if credentials else {}
        self._tls = _context(authorities) if place.tls else None
        self._frames: deque[tuple[float, str, bytes]] = deque(maxlen=held)
        self._kept: dict[str, bytes] = {}  # by topic: the newest, not sent yet
        self._identifier = f"delfim-{place.root}-{boat}-{secrets.token_hex(8)}" if boat else None
        self._news = asyncio.Event()
        self._is_cancelled = False

    def put(self, topic: str, frame: bytes) -> None:
        """Send a frame soon or never: the oldest gives way."""
        if self.reason or len(self._frames) == self._frames.maxlen:
            self.counts["dropped"] += 1
        if not self.reason:
            self._frames.append((self._clock.monotonic_s(), topic, frame))
            self._news.set()

    def keep(self, topic: str, state: bytes) -> None:
        """Send a state as soon as that is possible, in place of the one before; the broker retains it."""
        self._kept[topic] = state
        self._news.set()

    async def flush(self) -> None:
        """Wait a moment for what was put last."""
        for _ in range(FLUSH_LOOKS):
            if self._frames and not self.reason:
                await asyncio.sleep(END_S / FLUSH_LOOKS)

    async def follow(self) -> None:
        """Keep connected until cancelled. Raises ModuleNotFoundError without the package."""
        import aiomqtt

        pause_s, longest_s = PAUSES_S
        while True:
            self.reason = self.reason or "not connected"
            try:
                await self._once(aiomqtt)
            except* (aiomqtt.MqttError, OSError) as errors:
                self.reason = _why(errors)
            if self._is_cancelled:
                raise asyncio.CancelledError
            pause_s = PAUSES_S[0] if self.counts["connected"] > self.counts["tried"] else min(2.0 * pause_s, longest_s)
            self.counts["tried"] = self.counts["connected"]
            await asyncio.sleep(pause_s)

    async def _once(self, library: Any) -> None:
        """Keep one connection until it ends."""
        place, link = self.place, self.place.topic(self._boat, LINK)
        client = library.Client(
            place.host,
            place.port,
            identifier=self._identifier,  # another one that names it puts this one off, so nobody knows it
            will=library.Will(link, b"lost", qos=1, retain=True) if self._boat else None,
            keepalive=ALIVE_S,
            timeout=ANSWER_S,
            tls_context=self._tls,
            socket_options=SOCKET,
            queue_type=lambda maxsize: _Handover(self._take),
            **self._login,
        )
        _bound(client)
        async with client:
            try:
                await self._converse(client, link)
            except asyncio.CancelledError:
                self._is_cancelled = True  # the client may say something else when it cannot say goodbye
                raise
            finally:
                self.reason = "the connection ended"
                if self._boat:
                    with contextlib.suppress(library.MqttError, OSError):
                        await client.publish(link, b"ended", qos=1, retain=True, timeout=END_S)

    async def _converse(self, client: "aiomqtt.Client", link: str) -> None:
        await client.subscribe(self._topic, qos=0)
        if self._boat:
            await client.publish(link, b"here", qos=1, retain=True)
        self._frames.clear()
        self.counts["connected"] += 1
        self.reason = ""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._send(client))
            if self._boat:
                group.create_task(self._tell_again(client, link))
            group.create_task(self._listen(client))

    async def _tell_again(self, client: "aiomqtt.Client", link: str) -> None:
        """Publish the link again: the will of a connection that this boat lost may be published after it is back."""
        await asyncio.sleep(2.0 * ALIVE_S)
        await client.publish(link, b"here", qos=1, retain=True)

    async def _send(self, client: "aiomqtt.Client") -> None:
        """Send the waiting frames. A slow broker slows this down, and frames are dropped."""
        task = asyncio.current_task()
        while task is None or not task.cancelling():  # asyncio.wait_for of Python 3.11 gives an answer that comes with the end
            await self._news.wait()
            self._news.clear()
            while self._kept:
                topic, state = self._kept.popitem()
                await client.publish(topic, state, qos=0, retain=True)
            while self._frames:
                came_s, topic, frame = self._frames.popleft()
                if self._clock.monotonic_s() - came_s > STALE_S:
                    self.counts["dropped"] += 1
                    continue
                await client.publish(topic, frame, qos=0)
                self.counts["sent"] += 1

    async def _listen(self, client: "aiomqtt.Client") -> None:
        """Receive messages until the connection ends."""
        async for _ in client.messages:
            raise AssertionError("messages are handed over, none comes this way")

    def _take(self, message: "aiomqtt.Message") -> None:
        payload = message.payload
        is_ours = isinstance(payload, bytes) and 0 < len(payload) <= PAYLOAD_BYTES and message.topic.matches(self._topic)
        if message.retain or not is_ours:
            self.counts["refused"] += 1  # a retained order is an old one
            return
        self.counts["heard"] += 1
        self._hear(str(message.topic), bytes(payload))


class _Handover(asyncio.Queue["aiomqtt.Message"]):
    """Replaces the client's queue: messages are taken as they come. If they come too fast they wait at the broker, which drops
    them, and not here."""

    def __init__(self, take: "Callable[[aiomqtt.Message], None]") -> None:
        super().__init__()
        self._take = take

    def put_nowait(self, item: "aiomqtt.Message") -> None:
        self._take(item)


def _bound(client: "aiomqtt.Client") -> None:
    """Bound the client: a message that is too long is refused as soon as its length is read, and so is one that needs an
    acknowledgement: the library keeps each such message."""
    library: Any = client._client
    receive = library._sock_recv

    def bounded(size: int) -> bytes:
        command: int = library._in_packet["command"]
        if size > PACKET_BYTES or (command & 0xF0 == PUBLISH and command & QUALITY):
            raise OSError(errno.EMSGSIZE, "the broker sends what nobody asked for")
        data: bytes = receive(size)
        return data

    library._sock_recv = bounded


def _context(authorities: str) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=authorities or None)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(authorities, "authorities", in_words(error) or "no certificates in it") from None


def _why(errors: BaseException) -> str:
    """The first of these errors, in words."""
    while isinstance(errors, BaseExceptionGroup):
        errors = errors.exceptions[0]
    return str(errors) or type(errors).__name__
