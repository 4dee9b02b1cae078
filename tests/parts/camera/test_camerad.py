"""The service with a played camera, asked over UDP as a console asks."""

import asyncio
import contextlib
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from delfim import config
from delfim.base.clock import SystemClock
from delfim.console.pictures.picturelink import PictureLink
from delfim.parts.camera import camerad, wire
from delfim.parts.camera.exposure import entrances
from delfim.parts.camera.kept import PicturesByTime, cameras_under
from delfim.parts.camera.played import BITS
from delfim.parts.camera.table import PORTS, CameraTable
from delfim.parts.mavlink.table import Mavlink
from delfim.services.runtime import LoadedService, Runtime
from tests.parts.camera.test_pictures import clock_in
from tests.services.boat import vehicle_file

BOW = {"bow": CameraTable(source="test", rate_hz=30.0)}


async def ran(runtime: Runtime, done: Callable[[], object]) -> None:
    """The runtime with the service, until it is done."""
    running = asyncio.create_task(runtime.run([LoadedService("camerad", camerad.serve)]))
    async with asyncio.timeout(200):
        while not done():
            await asyncio.sleep(0.01)
        runtime.stop("the test is over")
        await running


def sailed(settings: config.Vehicle, done: Callable[[Runtime], object]) -> Runtime:
    runtime = Runtime(settings, SystemClock(), alone=True, new_loop=asyncio.new_event_loop)
    with asyncio.Runner(loop_factory=runtime._new_loop) as runner:
        runner.run(ran(runtime, lambda: done(runtime)))
    return runtime


def test_pictures_come_by_udp_and_to_the_disk(tmp_path: Path) -> None:
    settings = vehicle_file(tmp_path, camera=BOW)
    reports = list[dict[str, dict[str, object]]]()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as line:
        line.connect(("127.0.0.1", PORTS + settings.boat.id))

        def send(datagram: bytes) -> None:
            with contextlib.suppress(ConnectionError):  # it does not listen yet
                line.send(datagram)

        link = PictureLink(wire.mac_key(b""), send, time.monotonic())

        def done(runtime: Runtime) -> bool:
            link.tick(time.monotonic(), hold=False)
            with contextlib.suppress(BlockingIOError, ConnectionError):
                link.hear(line.recv(2048), time.monotonic())
            if link.picture is None or not any(map(len, map(PicturesByTime, cameras_under(tmp_path).values()))):
                return False
            reports.append(runtime.board["camerad"]())  # type: ignore[arg-type]
            return True

        sailed(settings, done)
    assert link.picture is not None
    assert clock_in(link.picture.jpeg) <= link.picture.taken_ms % (1 << BITS)
    assert reports[0]["bow"]["why"] == ""
    (files,) = cameras_under(tmp_path).values()
    assert files[0].relative_to(tmp_path / "log").parts[1] == "camera-bow"


def test_a_port_that_another_program_has_is_told(tmp_path: Path) -> None:
    settings = vehicle_file(tmp_path, camera=BOW)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", PORTS + settings.boat.id))
        runtime = sailed(settings, lambda runtime: runtime.status and runtime.status["camerad"].state == "failed")
    assert "camerad: port 14601: Address already in use" in runtime.status["camerad"].reason


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"source": "rtsp://ana:secret@10.0.0.5/main"}, "no place in this file"),
        ({"source": "test", "credentials": "/etc/login"}, "only an rtsp source"),
        ({"source": "test", "width_px": 641}, "multiples of 8"),
    ],
)
def test_wrong_keys_are_refused_in_words(keys: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        CameraTable(**keys)  # type: ignore[arg-type]


def test_where_the_film_is_shown_is_told_as_a_door(tmp_path: Path) -> None:
    """Of a boat with a key; without one it is this computer's alone, as all of its pictures."""
    both = {"bow": CameraTable(source="test", webrtc=True), "stern": CameraTable(source="test")}
    known = vehicle_file(tmp_path, camera=both, mavlink=Mavlink(listen="0.0.0.0:14555", key="/etc/delfim/key"))
    told = [(each.place, each.may) for each in entrances(known, ["camerad"])]
    assert told == [
        ("0.0.0.0:14601", "see the pictures of bow, stern"),
        ("0.0.0.0:14902-14903", "see the pictures of bow, by WebRTC"),
    ]
    assert [each.place for each in entrances(vehicle_file(tmp_path, camera=both), ["camerad"])] == ["127.0.0.1:14601"]
