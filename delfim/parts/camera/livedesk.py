"""Cameras by WebRTC, as camerad has them: who looks, at what rate, and the program that shows them, a child of ours.

Without aiortc, or for cameras that do not ask for it in the vehicle's file, none is offered, and pictures go as before. The
program is started for the first who looks, and ended a while after the last; what it does, hangs or ends, nobody waits for.
"""

import contextlib
import logging
import socket
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any, Final, Protocol

import msgspec

from delfim.base.clock import Clock
from delfim.parts.camera import livetalk, livewire
from delfim.parts.camera.grabber import Picture, Watching, sizes
from delfim.parts.camera.sending import LEASE_S, PictureSource
from delfim.parts.camera.table import LIVE_PORTS, STREAMS, CameraTable

LACKS: Final = "aiortc is not installed: pip install 'delfim[webrtc]'"
STEPS_BPS: Final = (200_000, 400_000, 700_000, 1_200_000, 1_800_000)  # each change costs a key picture
SHARE: Final = 0.8  # of the rate: what the encoder does not always keep to has room
RISE_S: Final = 5.0
BITS: Final = 0.08  # of a pixel of the picture, at the least; else a smaller one is sent
IDLE_S: Final = 30.0  # after the last stream
ANSWER_S: Final = 10.0  # a slow computer reads the library for seconds
STUCK_S: Final = 5.0  # the program takes nothing
AGAIN_S: Final = 10.0  # after it has ended by itself
KNOWN: Final = 8  # streams, those that have ended included
PACKET_BYTES: Final = 4096

log = logging.getLogger(__name__)


class ShownSource(PictureSource, Protocol):
    table: CameraTable


class ShownStream:
    """A connection that somebody asks for."""

    def __init__(self, number: int, offer: livewire.LiveOffer, now_s: float) -> None:
        self.number, self.offer, self.begun_s, self.asked_s = number, offer, now_s, now_s
        self.answer: livetalk.StreamAnswer | None = None
        self.sent, self.why = 0, ""
        self.bps, self.step, self._step_s = -1, 0, now_s - RISE_S

    def next_bps(self, now_s: float) -> int:
        """For the encoder: one of the steps, or 0 for a while."""
        fitting = max((each for each in STEPS_BPS if each <= SHARE * self.offer.rate_bps), default=0)
        if not fitting:
            return 0
        if fitting < self.step or now_s - self._step_s >= RISE_S:
            self._step_s = now_s if fitting != self.step else self._step_s
            self.step = fitting
        return self.step


class LiveDesk:
    """`host` is where camerad listens."""

    def __init__(
        self, host: str, boat: int, cameras: Sequence[ShownSource], clock: Clock, watching: Watching, module: str = "aiortc"
    ) -> None:
        self._cameras, self._clock, self._watching = cameras, clock, watching
        self._place = host, str(LIVE_PORTS + STREAMS * boat)
        asked = tuple(each.name for each in cameras if each.table.webrtc)
        self.names = asked if find_spec(module) is not None else ()
        self.why = LACKS if asked and not self.names else ""
        if self.why:
            log.warning("camera %s: by WebRTC: %s", ", ".join(asked), self.why)
        self._streams = dict[tuple[Any, int], ShownStream]()
        self._child: subprocess.Popen[bytes] | None = None
        self._line: socket.socket | None = None
        self._number, self._shown = 0, dict[int, float]()  # by camera: when the picture was taken that went last
        self._used_s = self._took_s = self._due_s = clock.monotonic_s()

    def report(self) -> dict[str, object]:
        """JSON-ready."""
        return {"why": self.why, "streams": sum(not each.why for each in self._streams.values())}

    def ask(self, address: Any, offer: livewire.LiveOffer) -> livewire.LiveAnswer:
        """Somebody offers a connection, or says the rate of one."""
        now_s = self._clock.monotonic_s()
        stream = self._streams.get((address, offer.stream))
        if stream is None:
            why = self._refusal(offer, now_s)
            if why:
                return livewire.LiveAnswer(offer.at_us, offer.stream, livewire.ENDED, 0, 0, 0, bytes(32), "", "", why)
            stream = self._begin(address, offer, now_s)
        elif offer.at_us > stream.offer.at_us:
            stream.offer, stream.asked_s = stream.offer._replace(at_us=offer.at_us, rate_bps=offer.rate_bps), now_s
            if not offer.rate_bps:
                self._end(stream, "the page has ended it")
        return _answer(stream)

    def tick(self) -> None:
        """Often."""
        now_s = self._clock.monotonic_s()
        for key, stream in list(self._streams.items()):
            if now_s - stream.asked_s > LEASE_S:
                self._end(stream, "nobody asks for it")
                del self._streams[key]
            elif not stream.why and stream.answer is None and now_s - stream.begun_s > ANSWER_S:
                self._lose("the program for WebRTC does not answer")
        if self._child is None:
            return
        streams = [each for each in self._streams.values() if not each.why]
        self._used_s = now_s if streams else self._used_s
        code = self._child.poll()
        if code is not None:
            self._lose(f"the program for WebRTC ended with code {code}")
        elif now_s - self._took_s > STUCK_S and streams:
            self._lose("the program for WebRTC takes nothing")
        elif now_s - self._used_s > IDLE_S:
            self._stop()
        else:
            for stream in streams:
                self._rate(stream, now_s)
            looking = [each for each in streams if each.bps > 0]
            for at in {each.offer.camera for each in looking}:
                self._show(at, min(each.step for each in looking if each.offer.camera == at), now_s)

    def close(self) -> None:
        if self._child is not None:
            self._stop()

    def _refusal(self, offer: livewire.LiveOffer, now_s: float) -> str:
        if offer.camera >= len(self._cameras) or self._cameras[offer.camera].name not in self.names:
            return self.why or "this camera is not shown by WebRTC"
        if sum(not each.why for each in self._streams.values()) >= STREAMS or len(self._streams) >= KNOWN:
            return f"{STREAMS} look at it already"
        return "the program for WebRTC has just ended" if self._child is None and now_s < self._due_s else ""

    def _begin(self, address: Any, offer: livewire.LiveOffer, now_s: float) -> ShownStream:
        self._number += 1
        stream = self._streams[address, offer.stream] = ShownStream(self._number, offer, now_s)
        if self._child is None:
            self._start(now_s)
        begin = livetalk.StreamBegin(stream.number, offer.camera, offer.payload, offer.certificate, offer.user, offer.password)
        if not self._tell(begin):
            stream.why = "the program for WebRTC takes nothing"
        return stream

    def _rate(self, stream: ShownStream, now_s: float) -> None:
        bps = stream.next_bps(now_s)
        if bps != stream.bps and self._tell(livetalk.StreamRate(stream.number, bps)):
            stream.bps = bps

    def _show(self, at: int, bps: int, now_s: float) -> None:
        """The newest picture, in the largest size for which the rate is enough."""
        camera = self._cameras[at]
        enough = [wide * high * camera.table.rate_hz * BITS <= bps for wide, high in sizes(camera.table)]
        there = [each for each in camera.latest[enough.index(True) if True in enough else -1 :] if each is not None]
        if not there or there[0].taken_s <= self._shown.get(at, -1.0):
            return
        for picture in there:
            if self._tell(_frame(at, picture, now_s - camera.same_since_s)):
                break
        self._shown[at] = there[0].taken_s

    def _start(self, now_s: float) -> None:
        ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        for each in (ours, its):
            each.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        with its:
            self._child = subprocess.Popen(
                [sys.executable, "-m", "delfim.parts.camera.liveshow", *self._place, str(its.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[its.fileno()],
                start_new_session=True,
            )
        self._line, self._took_s, self._used_s = ours, now_s, now_s
        self._watching.reader(ours.fileno(), self._hear)

    def _tell(self, order: livetalk.Order) -> bool:
        """Without waiting; False: it is lost."""
        if self._line is None:
            return False
        try:
            self._line.send(livetalk.encode(order))
        except OSError:  # it is full, the picture is too large, or the program has ended
            return False
        self._took_s = self._clock.monotonic_s()
        return True

    def _hear(self) -> None:
        assert self._line is not None
        try:
            report = livetalk.read_report(self._line.recv(PACKET_BYTES))
        except BlockingIOError:
            return
        except (OSError, msgspec.MsgspecError):  # it has ended, and the next tick finds it
            self._watching.remove_reader(self._line.fileno())
            return
        for stream in self._streams.values():
            if stream.number == report.stream:
                _take(stream, report)

    def _end(self, stream: ShownStream, why: str) -> None:
        if not stream.why:
            self._tell(livetalk.StreamEnd(stream.number))
            stream.why = why

    def _lose(self, why: str) -> None:
        """The program is of no use any more."""
        log.warning("%s", why)
        self._stop()
        self._due_s = self._clock.monotonic_s() + AGAIN_S
        for stream in self._streams.values():
            stream.why = stream.why or why

    def _stop(self) -> None:
        if self._line is not None:
            self._watching.remove_reader(self._line.fileno())
            self._line.close()
        if self._child is not None:
            with contextlib.suppress(ProcessLookupError):
                self._child.kill()
            self._child.wait()
        self._child = self._line = None


def _frame(at: int, picture: Picture, same_s: float) -> livetalk.StreamPicture:
    return livetalk.StreamPicture(at, picture.taken_s, picture.taken_ms, max(same_s, 0.0), picture.jpeg)


def _take(stream: ShownStream, report: livetalk.Report) -> None:
    match report:
        case livetalk.StreamAnswer():
            stream.answer = report
        case livetalk.StreamSent():
            stream.sent = report.count
        case livetalk.StreamEnd():
            stream.why = stream.why or report.why or "it has ended"


def _answer(stream: ShownStream) -> livewire.LiveAnswer:
    offer, answer = stream.offer, stream.answer
    if answer is None or stream.why:
        state = livewire.ENDED if stream.why else livewire.WAITS
        return livewire.LiveAnswer(offer.at_us, offer.stream, state, stream.sent, 0, 0, bytes(32), "", "", stream.why)
    numbers = offer.at_us, offer.stream, livewire.ANSWERED, stream.sent, answer.port, answer.ssrc
    return livewire.LiveAnswer(*numbers, answer.certificate, answer.user, answer.password, "")
