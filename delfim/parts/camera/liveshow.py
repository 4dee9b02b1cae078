"""`python -m delfim.parts.camera.liveshow`: a boat's cameras by WebRTC, a program of its own beside camerad.

It needs aiortc, whose codecs are GPL: no other part of Delfim imports them (docs/decisions/0019-webrtc-apart.md). Told on the
command line: the address and the first of its UDP ports, and the descriptor on which camerad speaks. It reads no SDP from
outside, asks no server for its address, and sends to nobody but whoever has proved to know the password of its answer.
"""

import asyncio
import contextlib
import math
import socket
import struct
import sys
import time
from collections.abc import Callable, Coroutine
from fractions import Fraction
from io import BytesIO
from typing import Any, Final

import aiortc
import av
from aioice import ice
from aiortc import rtp
from aiortc.codecs import vpx
from av.video.frame import PictureType

from delfim.base.errors import in_words
from delfim.parts.camera import livetalk
from delfim.parts.camera.table import STREAMS

PACKET_BYTES: Final = 1 << 20
CONNECT_S: Final = 8.0
SILENT_S: Final = 3.0  # the page says its time twice a second
TICK_S: Final = 0.25
HERTZ: Final = 90_000  # of RTP's clock for video
OVER: Final = 54  # bytes of each packet beside its payload: IP, UDP, RTP, SRTP
PAYLOAD: Final = 1100
AT_ONCE: Final = (5, bytes(3))  # number of the header that forbids a browser to hold pictures back, and its value: 0 to 0 s
_page_time = struct.Struct(">d")
_age = struct.Struct(">IdHQ")
OFFER: Final = """v=0
o=- 1 1 IN IP4 127.0.0.1
s=-
t=0 0
a=group:BUNDLE 0 1
m=video 9 UDP/TLS/RTP/SAVPF {payload}
c=IN IP4 0.0.0.0
a=rtcp:9 IN IP4 0.0.0.0
{login}
a=setup:actpass
a=mid:0
a=recvonly
a=rtcp-mux
a=rtpmap:{payload} VP8/90000
a=rtcp-fb:{payload} nack
a=rtcp-fb:{payload} nack pli
m=application 9 UDP/DTLS/SCTP webrtc-datachannel
c=IN IP4 0.0.0.0
{login}
a=setup:actpass
a=mid:1
a=sctp-port:5000
"""


class LiveTrack(aiortc.MediaStreamTrack):  # type: ignore[misc]
    """The newest pictures of a camera, as a track. `sent` is told each picture once all of it is on its way."""

    kind = "video"

    def __init__(self, sent: Callable[[livetalk.StreamPicture], None]) -> None:
        super().__init__()
        self._sent = sent
        self._next: tuple[livetalk.StreamPicture, Any] | None = None
        self._last: livetalk.StreamPicture | None = None
        self._there = asyncio.Event()

    def put(self, told: livetalk.StreamPicture, picture: Any) -> None:
        """Takes the place of one that was not yet sent."""
        self._next = told, picture
        self._there.set()

    async def recv(self) -> Any:
        if self._last is not None:
            self._sent(self._last)
        await self._there.wait()
        self._there.clear()
        assert self._next is not None
        (self._last, picture), self._next = self._next, None
        made = picture.reformat(format="yuv420p")
        made.pts, made.time_base = round(self._last.taken_s * HERTZ), Fraction(1, HERTZ)
        made.pict_type = PictureType.NONE  # a JPEG is a key picture, which the stream need not have each time
        return made


class LiveStream:
    """A connection to one page."""

    def __init__(self, begin: livetalk.StreamBegin, tell: Callable[[livetalk.Report], None]) -> None:
        self.begin, self._tell = begin, tell
        self._peer = aiortc.RTCPeerConnection(aiortc.RTCConfiguration(iceServers=[]))
        self._peer.on("datachannel", self._opened)
        self._track = LiveTrack(self._sent)
        self._sender = self._peer.addTrack(self._track)
        self._channel: Any = None
        self._since_s = self._heard_s = time.monotonic()
        self._page_ms, self._page_s = math.nan, 0.0
        self.bps = self._told = 0

    async def answer(self) -> None:
        print_ = ":".join(f"{each:02X}" for each in self.begin.certificate)
        login = f"a=ice-ufrag:{self.begin.user}\na=ice-pwd:{self.begin.password}\na=fingerprint:sha-256 {print_}"
        sdp = OFFER.format(payload=self.begin.payload, login=login).replace("\n", "\r\n")
        await self._peer.setRemoteDescription(aiortc.RTCSessionDescription(sdp, "offer"))
        await self._peer.setLocalDescription(await self._peer.createAnswer())
        said = dict[str, str]()
        for line in self._peer.localDescription.sdp.splitlines():
            name, _, value = line.removeprefix("a=").partition(":")
            said.setdefault(name if name != "fingerprint" else value.partition(" ")[0], value)
        self._tell(
            livetalk.StreamAnswer(
                self.begin.stream,
                int(said["candidate"].split()[5]),
                int(said["ssrc"].split()[0]),
                bytes.fromhex(said["sha-256"].split()[1].replace(":", "")),
                said["ice-ufrag"],
                said["ice-pwd"],
            )
        )

    def show(self, told: livetalk.StreamPicture, picture: Any) -> None:
        encoder = self._sender._RTCRtpSender__encoder
        if encoder is not None:
            encoder.target_bitrate = self.bps
        if self.bps and self._peer.connectionState == "connected":
            self._track.put(told, picture)

    async def tick(self, now_s: float) -> str:
        """Often; why it ends, in words, or nothing."""
        for each in (await self._sender.getStats()).values():
            if each.type == "outbound-rtp" and self._told != each.bytesSent + OVER * each.packetsSent:
                self._told = each.bytesSent + OVER * each.packetsSent
                self._tell(livetalk.StreamSent(self.begin.stream, self._told))
        if self._peer.connectionState in ("failed", "closed"):
            return "the connection broke"
        if self._peer.connectionState != "connected":
            return "the page does not reach the boat by UDP" if now_s - self._since_s > CONNECT_S else ""
        return "the page is not heard" if now_s - self._heard_s > SILENT_S else ""

    async def close(self) -> None:
        await self._peer.close()

    def _opened(self, channel: Any) -> None:
        if self._channel is None:
            self._channel = channel
            self._heard_s = time.monotonic()
            channel.on("message", self._hear)

    def _hear(self, said: object) -> None:
        if isinstance(said, bytes) and len(said) == _page_time.size:
            page_ms = _page_time.unpack(said)[0]
            if math.isfinite(page_ms):
                self._page_ms, self._page_s = page_ms, time.monotonic()
                self._heard_s = self._page_s

    def _sent(self, frame: livetalk.StreamPicture) -> None:
        """Tells the page when this picture was taken, by the page's clock, and never too late: all of the way of its word to
        here is taken for its age."""
        if self._channel is None or self._channel.readyState != "open" or self._channel.bufferedAmount > 10 * _age.size:
            return
        if math.isfinite(self._page_ms):
            taken_ms = self._page_ms - (self._page_s - frame.taken_s) * 1e3
            stamp = self._sender._RTCRtpSender__rtp_timestamp
            self._channel.send(_age.pack(stamp, taken_ms, min(int(frame.same_s), 0xFFFF), frame.taken_ms))


class LiveShow:
    """All streams."""

    def __init__(self, line: socket.socket, do: Callable[[Coroutine[Any, Any, None]], object]) -> None:
        self._line, self._do = line, do
        self._streams = dict[int, LiveStream]()
        self.ended = asyncio.Event()

    def hear(self) -> None:
        try:
            data = self._line.recv(PACKET_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.ended.set()
            return
        order = livetalk.read_order(data)
        match order:
            case livetalk.StreamBegin():
                self._do(self._begin(order))
            case livetalk.StreamRate() if order.stream in self._streams:
                self._streams[order.stream].bps = order.bps
            case livetalk.StreamEnd() if order.stream in self._streams:
                self._do(self._streams.pop(order.stream).close())
            case livetalk.StreamPicture():
                self._show(order)

    def tell(self, report: livetalk.Report) -> None:
        with contextlib.suppress(OSError):
            self._line.send(livetalk.encode(report))

    async def tick(self) -> None:
        for number, stream in list(self._streams.items()):
            why = await stream.tick(time.monotonic())
            if why:
                self.tell(livetalk.StreamEnd(number, why))
                del self._streams[number]
                await stream.close()

    async def close(self) -> None:
        for each in self._streams.values():
            await each.close()

    async def _begin(self, begin: livetalk.StreamBegin) -> None:
        if begin.stream in self._streams or len(self._streams) >= STREAMS:
            return
        stream = self._streams[begin.stream] = LiveStream(begin, self.tell)
        try:
            await stream.answer()
        except (ValueError, OSError, KeyError, aiortc.exceptions.InvalidStateError) as error:
            self._streams.pop(begin.stream, None)
            self.tell(livetalk.StreamEnd(begin.stream, in_words(error)))
            await stream.close()

    def _show(self, told: livetalk.StreamPicture) -> None:
        watching = [each for each in self._streams.values() if each.begin.camera == told.camera]
        if not watching:
            return
        try:
            with av.open(BytesIO(told.jpeg), format="mjpeg") as file:
                picture = next(file.decode(video=0))
        except (av.FFmpegError, StopIteration):  # a camera's torn picture: the next one comes
            return
        for each in watching:
            each.show(told, picture)


def _at(host: str, port: int) -> None:
    """Has each connection take one of our ports, at our address alone."""

    async def candidates(connection: Any, component: int, addresses: object, timeout: int = 5) -> list[Any]:
        for at in range(port, port + STREAMS):
            try:
                _, protocol = await asyncio.get_running_loop().create_datagram_endpoint(
                    lambda: ice.StunProtocol(connection), local_addr=(host, at)
                )
            except OSError:
                continue
            base = ice.candidate_foundation("host", "udp", host)
            priority = ice.candidate_priority(component, "host")
            protocol.local_candidate = ice.Candidate(base, component, "udp", priority, host, at, "host")
            connection._protocols.append(protocol)
            return [protocol.local_candidate]
        raise OSError(f"UDP port {port} and the next are taken")

    ice.Connection.get_component_candidates = candidates
    rtp.HeaderExtensionsMap.set = lambda *_: rtp.pack_header_extensions([AT_ONCE])
    vpx.MIN_BITRATE, vpx.MAX_BITRATE, vpx.PACKET_MAX = 100_000, 2_000_000, PAYLOAD


async def main() -> None:
    host, port, fd = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    _at(host, port)
    with socket.socket(fileno=fd) as line:
        async with asyncio.TaskGroup() as group:
            await _serve(line, LiveShow(line, group.create_task))


async def _serve(line: socket.socket, show: LiveShow) -> None:
    line.setblocking(False)
    asyncio.get_running_loop().add_reader(line, show.hear)
    while not show.ended.is_set():
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(show.ended.wait(), TICK_S)
        await show.tick()
    asyncio.get_running_loop().remove_reader(line)
    await show.close()


if __name__ == "__main__":
    asyncio.run(main())
