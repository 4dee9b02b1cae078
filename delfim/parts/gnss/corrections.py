"""corrections: forwards RTCM 3 from an NTRIP caster, or from the consoles' link, to the receiver (docs/rtk.md).

A process of its own: it looks up names, waits for a network that comes and goes, and may have a cipher to reckon. It writes to
the receiver's port itself, so that the vehicle has nothing to do with corrections but to hear how old they are.
"""

import asyncio
import contextlib
import logging
import math
import os
import socket
import ssl
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Literal

import msgspec

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import PermanentFailure, in_words
from delfim.base.input.untrusted import read_credentials
from delfim.canproxy.dsor.messages import Navigation
from delfim.lines.nmea0183.speaking import gga
from delfim.lines.rtcm import FRAME_MAX, RtcmFrames, doorstep
from delfim.parts.gnss.ntrip import Caster, CasterRefusal, CasterStream, open_stream
from delfim.parts.gnss.receiverport import ReceiverPort
from delfim.parts.gnss.table import Corrections
from delfim.parts.nmea0183.table import Nmea0183
from delfim.services.runtime import Runtime
from delfim.vehicle.report import reported

LOOK_S: Final = 1.0
ANSWER_S: Final = 10.0  # for a connection, and for the caster's answer
SILENT_S: Final = 20.0  # without a sound frame, after which the connection is made anew
REFUSED_S: Final = 30.0  # before the next try after a refusal: casters lock out who asks too often
REST_S: Final = 10.0  # after the caster's last frame: until then the radio's are not used, for two bases differ
DATAGRAMS: Final = 16  # in one call
OLD_S: Final = 10.0  # an older position is not told
ANSWER_BYTES: Final = 1 << 20  # of the vehicle, at most
NEVER_S: Final = -1e9
Way = Literal["caster", "radio"]

log = logging.getLogger(__name__)


class CorrectionFeed:
    """Forwards corrections from their sources to the receiver."""

    def __init__(self, settings: config.Vehicle, port: ReceiverPort, clock: Clock) -> None:
        table = settings.of(Corrections)
        self._caster = Caster.of(table.caster) if table.caster else None
        self._credentials = read_credentials(table.credentials) if table.credentials else ""
        self._command, self._gga_s, self._clock, self._port = settings.console.socket, table.gga_s, clock, port
        self._frames: dict[Way, RtcmFrames] = {"caster": RtcmFrames(), "radio": RtcmFrames()}
        self._heard_s: dict[Way, float] = {"caster": NEVER_S, "radio": NEVER_S}
        self._stream: CasterStream | None = None
        self._gga = b""
        self._pauses = settings.supervisor
        self._unused = 0  # frames of the radio while the caster sends
        self._trouble = "" if self._caster is None else "not connected yet"

    def take(self, way: Way, data: bytes) -> bool:
        """Take bytes of a source. Returns whether a frame was among them."""
        found, now_s = self._frames[way].feed(data), self._clock.monotonic_s()
        if not found:
            return False
        self._heard_s[way] = now_s
        if way == "radio" and now_s - self._heard_s["caster"] <= REST_S:
            self._unused += len(found)
            return True
        for frame in found:
            self._port.send(frame.data)
        return True

    async def follow(self) -> None:
        """Keep connected to the caster, with growing pauses while it sends nothing."""
        assert self._caster is not None
        limits = self._pauses
        pause_s = limits.backoff_s
        while True:
            before_s, told = self._heard_s["caster"], self._trouble
            refused_s = 0.0
            try:
                await self._once(self._caster)
                reason = "it ended the connection"
            except TimeoutError:
                sends = self._stream is not None
                reason = f"no corrections for {SILENT_S:.0f} s" if sends else f"no answer for {ANSWER_S:.0f} s"
            except CasterRefusal as error:
                reason, refused_s = str(error), REFUSED_S
            except OSError as error:
                reason = _why(error)
            finally:
                self._end()
            self._trouble = f"{self._caster.host}:{self._caster.port}: {reason}"
            if self._trouble != told:
                log.warning("corrections: %s", self._trouble)
            if self._heard_s["caster"] > before_s:
                pause_s = limits.backoff_s
            await asyncio.sleep(max(pause_s, refused_s))
            pause_s = min(2.0 * pause_s, limits.backoff_max_s)

    async def _once(self, caster: Caster) -> None:
        """Keep one connection until it ends. Raises CasterRefusal, OSError, TimeoutError."""
        async with asyncio.timeout(ANSWER_S):
            stream = await open_stream(caster)
        try:
            async with asyncio.timeout(ANSWER_S):
                await stream.begin(caster, self._credentials, self._gga)
            self._stream = stream
            stream.writer.write(self._gga)
            loop = asyncio.get_running_loop()
            async with asyncio.timeout(SILENT_S) as silence:
                async for data in stream.pieces():
                    if self.take("caster", data):
                        if self._trouble:
                            log.info("corrections: %s sends", caster.host)
                        self._trouble = ""
                        silence.reschedule(loop.time() + SILENT_S)
        finally:
            stream.writer.close()

    def _end(self) -> None:
        self._stream = None
        self._frames["caster"].reset()

    async def tell_place(self) -> None:
        """Send the caster the boat's position: that of a network of bases computes corrections for it."""
        while True:
            try:
                async with asyncio.timeout(ANSWER_S):
                    self._gga = await self._place()
            except (OSError, ValueError, msgspec.DecodeError):
                self._gga = b""
            if self._stream is not None:
                self._stream.writer.write(self._gga)
            await asyncio.sleep(self._gga_s if self._gga else LOOK_S)

    async def _place(self) -> bytes:
        """The vehicle's position as GGA; empty while it has none. Raises OSError, ValueError, DecodeError."""
        reader, writer = await asyncio.open_unix_connection(self._command, limit=ANSWER_BYTES)
        with contextlib.closing(writer):
            writer.write(b'{"command": "state"}\n')
            state = reported(await reader.readline())
        age_s = state.age_s.get("navigation")
        if state.latitude_deg is None or state.longitude_deg is None or age_s is None or age_s > OLD_S:
            return b""
        place = math.radians(state.latitude_deg), math.radians(state.longitude_deg)
        unknown = None, None, None, None, None, None
        return gga(Navigation(state.utc_ns, *place, *unknown, state.fix, state.satellites, state.hdop, 0))

    async def look(self) -> None:
        """Keep the receiver's port open."""
        while True:
            self._port.look()
            await asyncio.sleep(LOOK_S)

    def figures(self) -> dict[str, object]:
        """Figures, JSON-ready."""
        now_s, troubles = self._clock.monotonic_s(), dict[str, str]()
        if self._trouble:
            troubles["caster"] = self._trouble
        if self._port.trouble:
            troubles["receiver"] = f"{self._port.device}: {self._port.trouble}"
        ways: dict[str, object] = {
            way: {
                "age_s": round(now_s - self._heard_s[way], 1),
                "messages": {str(number): count for number, count in sorted(frames.heard.items())},
                "noise_bytes": frames.noise,
            }
            for way, frames in self._frames.items()
            if self._heard_s[way] > NEVER_S
        }
        counts = {"written": self._port.written, "dropped": self._port.dropped, "unused": self._unused}
        return {"troubles": troubles, **ways, "receiver": counts}


def _why(error: OSError) -> str:
    """The reason of an error: asyncio's words for a failed connection are its own; the system's are known to everybody."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not to be trusted: {error.verify_message}"
    return os.strerror(error.errno) if isinstance(error, ConnectionError) and error.errno else in_words(error)


@contextlib.contextmanager
def listening(place: Path) -> Iterator[socket.socket]:
    """Open the socket at which the vehicle hands over what came by radio."""
    place.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as door:
        door.bind(str(place))
        os.chmod(place, 0o600)
        try:
            yield door
        finally:
            place.unlink(missing_ok=True)


def receiver_port(settings: config.Vehicle) -> ReceiverPort:
    """Open the port of the vehicle's file. One of its lines that the vehicle does not read is set up as a port of its own."""
    table = settings.of(Corrections)
    named = settings.of(Nmea0183).ports.get(table.to)
    if named is None:
        return ReceiverPort(table.to, table.baud, shared=False)
    is_read = any(named in each.values() for each in settings.ports.values())
    return ReceiverPort(named.device, named.baud, is_read)


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings = runtime.config
    status = runtime.status.get("corrections")
    if status is not None and status.place == "runtime":
        raise PermanentFailure("corrections: the vehicle waits for no network; write services.corrections.place = 'process'")
    table = settings.of(Corrections)
    port = receiver_port(settings)
    feed, loop = CorrectionFeed(settings, port, runtime.clock), asyncio.get_running_loop()

    def on_radio() -> None:
        with contextlib.suppress(BlockingIOError):
            for _ in range(DATAGRAMS):
                feed.take("radio", door.recv(FRAME_MAX))

    with contextlib.ExitStack() as links:
        links.callback(port.close)
        door = links.enter_context(listening(doorstep(settings.runtime.run_directory)))
        loop.add_reader(door, on_radio)
        links.callback(loop.remove_reader, door)
        links.enter_context(runtime.publishing("corrections", feed.figures))
        async with asyncio.TaskGroup() as group:
            group.create_task(feed.look())
            if table.caster:
                group.create_task(feed.follow())
            if table.caster and table.gga_s:
                group.create_task(feed.tell_place())
