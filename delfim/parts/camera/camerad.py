"""camerad: the boat's cameras (docs/camera.md). A process of its own: nothing that steers waits for it, or needs it.

It answers at the address of MAVLink, at port 14600 and the boat's number, whoever has the boat's key, or without one this
computer alone.
"""

import asyncio
import contextlib
import errno
import functools
import logging
import socket
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import FormatError, PermanentFailure, in_words
from delfim.base.input.keys import read_key
from delfim.base.ranges import address
from delfim.parts.camera import wire
from delfim.parts.camera.grabber import LEVELS, Grabber, Picture
from delfim.parts.camera.kept import PictureKeeper
from delfim.parts.camera.livedesk import LiveDesk
from delfim.parts.camera.sending import PictureSender
from delfim.parts.camera.table import PORTS, CameraTable
from delfim.parts.mavlink.table import Mavlink
from delfim.services.runtime import Runtime

BULK: Final = 0x08  # IPTOS_THROUGHPUT: what is interactive overtakes it
TICK_S: Final = 0.005  # while somebody looks
IDLE_S: Final = 0.1
GRAB_S: Final = 0.2
HEARD: Final = 16  # datagrams in one go
DATAGRAM_BYTES: Final = 2048

log = logging.getLogger(__name__)


class Camera:
    """One camera: the newest picture of each size, and the files of those that are kept."""

    def __init__(self, name: str, table: CameraTable, directory: Path, runtime: Runtime) -> None:
        self.name, self.table, self.latest = name, table, list[Picture | None](None for _ in range(LEVELS))
        self.same_since_s = runtime.clock.monotonic_s()
        self._grabber = Grabber(name, table, runtime.clock, runtime, self._took)
        self._keeper = PictureKeeper(directory, name, table.kept_mb << 20) if table.kept_mb else None
        self._clock: Clock = runtime.clock
        self.kept_why = ""
        self.close, self.tick = self._grabber.close, self._grabber.tick

    @property
    def why(self) -> str:
        return self._grabber.why

    def _took(self, level: int, picture: Picture) -> None:
        before = self.latest[level]
        if level == 0 and (before is None or before.jpeg != picture.jpeg):
            self.same_since_s = picture.taken_s
        self.latest[level] = picture

    def keep(self) -> None:
        """In a thread: the newest picture, to the disk."""
        picture = self.latest[0]
        if self._keeper is None or picture is None:
            return
        try:
            self._keeper.put(picture.taken_ms, picture.jpeg)
            why = ""
        except OSError as error:
            self._keeper.close()
            why = f"its pictures are not kept: {in_words(error)}"
        if why and why != self.kept_why:
            log.warning("camera %s: %s", self.name, why)
        self.kept_why = why

    def report(self) -> dict[str, object]:
        newest = self.latest[0]
        age_s = None if newest is None else round(self._clock.monotonic_s() - newest.taken_s, 1)
        return self._grabber.report() | {"picture_age_s": age_s, "kept": self.kept_why}


def open_port(listen: str, boat: int, key: str) -> socket.socket:
    """The socket on which consoles ask. Raises OSError."""
    host = address(listen)[0]
    host = host if key or ip_address(host).is_loopback else "127.0.0.1"
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    door = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
    try:
        door.bind((host, PORTS + boat))
        with contextlib.suppress(OSError):
            door.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, BULK)
    except OSError:
        door.close()
        raise
    return door


def _key_of(settings: config.Vehicle) -> bytes:
    key = settings.of(Mavlink).key
    return wire.mac_key(read_key(key) if key else b"")


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings, loop = runtime.config, asyncio.get_running_loop()
    link, directory = settings.of(Mavlink), Path(settings.log.directory)
    try:
        door, key = open_port(link.listen, settings.boat.id, link.key), _key_of(settings)
    except (OSError, FormatError) as error:
        raise PermanentFailure(f"camerad: port {PORTS + settings.boat.id}: {in_words(error)}") from None
    with contextlib.ExitStack() as closing:
        closing.callback(door.close)
        tables: dict[str, CameraTable] = settings.table("camera")
        cameras = [Camera(name, table, directory, runtime) for name, table in tables.items()]
        for each in cameras:
            closing.callback(each.close)
        live = LiveDesk(door.getsockname()[0], settings.boat.id, cameras, runtime.clock, runtime)
        closing.callback(live.close)
        sender = PictureSender(key, cameras, runtime.clock, functools.partial(_send, door), live)
        closing.enter_context(runtime.reading(door.fileno(), functools.partial(_hear, door, sender)))
        closing.enter_context(runtime.publishing("camerad", lambda: _report(cameras, live)))
        due_s, keeping = 0.0, None
        while True:
            now_s = runtime.clock.monotonic_s()
            if now_s >= due_s:
                due_s = now_s + GRAB_S
                for each in cameras:
                    each.tick()
                if keeping is None or keeping.done():
                    keeping = loop.run_in_executor(None, _keep, cameras)
            sender.tick()
            live.tick()
            await asyncio.sleep(TICK_S if sender.is_watched else IDLE_S)


def _report(cameras: list[Camera], live: LiveDesk) -> dict[str, object]:
    shown = {"by WebRTC": live.report()} if any(each.table.webrtc for each in cameras) else {}
    return {**{each.name: each.report() for each in cameras}, **shown}


def _keep(cameras: list[Camera]) -> None:
    for each in cameras:
        each.keep()


def _hear(door: socket.socket, sender: PictureSender) -> None:
    for _ in range(HEARD):
        try:
            datagram, source = door.recvfrom(DATAGRAM_BYTES)
        except BlockingIOError:
            return
        except ConnectionError:  # a console is gone
            continue
        sender.hear(source, datagram)


def _send(door: socket.socket, to: Any, datagram: bytes) -> None:
    try:
        door.sendto(datagram, to)
    except OSError as error:
        if error.errno not in (errno.EAGAIN, errno.ECONNREFUSED, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENOBUFS):
            raise
