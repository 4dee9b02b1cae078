"""The service with an IP camera: RTSP within TCP, H.264, a login; the system's ffmpeg at both ends."""

import asyncio
import socket
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from pathlib import Path
from typing import Any

from delfim.base.clock import SystemClock
from delfim.console.pictures.picturelink import HeardPicture, PictureLink
from delfim.parts.camera import camerad, wire
from delfim.parts.camera.played import BITS
from delfim.parts.camera.table import PORTS, CameraTable
from delfim.services.runtime import LoadedService, Runtime
from tests.kit.ipcamera import LOGIN, SIZE, IpCamera, ip_camera
from tests.parts.camera.test_pictures import clock_in
from tests.services.boat import vehicle_file


class Boat:
    """A boat's camerad, and a console that looks."""

    def __init__(self, runtime: Runtime, line: socket.socket) -> None:
        self._runtime, self._line = runtime, line
        self.link = PictureLink(wire.mac_key(b""), self._send, time.monotonic())

    def _send(self, datagram: bytes) -> None:
        with suppress(ConnectionError):  # it does not listen yet
            self._line.send(datagram)

    @property
    def bow(self) -> dict[str, Any]:
        """What the service reports of its camera."""
        report: Any = self._runtime.board.get("camerad", dict)()
        return report.get("bow", {"why": "", "pictures": 0})

    async def until(self, done: Callable[[], object]) -> None:
        async with asyncio.timeout(200):
            while not done():
                self.link.tick(time.monotonic(), hold=False)
                with suppress(BlockingIOError, ConnectionError):
                    self.link.hear(self._line.recv(2048), time.monotonic())
                await asyncio.sleep(0.01)

    async def picture(self, but: HeardPicture | None = None) -> HeardPicture:
        """One that is another than that."""
        await self.until(lambda: self.link.picture is not None and self.link.picture is not but)
        assert self.link.picture is not None
        return self.link.picture


def sailed(folder: Path, login: str, story: Callable[[Boat, IpCamera], Coroutine[Any, Any, None]]) -> None:
    """The story with a boat that knows that login of its camera."""
    secret = folder / "login"
    secret.write_text(f"{login}\n")
    secret.chmod(0o600)
    door = socket.create_server(("127.0.0.1", 0))
    source = f"rtsp://127.0.0.1:{door.getsockname()[1]}/main"
    bow = CameraTable(source=source, credentials=str(secret), width_px=SIZE[0], height_px=SIZE[1])
    settings = vehicle_file(folder, camera={"bow": bow})
    runtime = Runtime(settings, SystemClock(), alone=True, new_loop=asyncio.new_event_loop)

    async def told() -> None:
        async with asyncio.TaskGroup() as group, ip_camera(folder, door) as camera:
            group.create_task(runtime.run([LoadedService("camerad", camerad.serve)]))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as line:
                line.connect(("127.0.0.1", PORTS + settings.boat.id))
                await story(Boat(runtime, line), camera)
            runtime.stop("the test is over")

    with asyncio.Runner(loop_factory=runtime._new_loop) as runner:
        runner.run(told())


def test_its_pictures_come_to_the_console_and_come_again_when_it_was_away(tmp_path: Path) -> None:
    async def story(boat: Boat, camera: IpCamera) -> None:
        first = await boat.picture()
        assert 0 <= (first.taken_ms - clock_in(first.jpeg)) % (1 << BITS) < 60_000, "the clock that the camera saw"
        camera.hang_up()
        await boat.until(lambda: boat.bow["why"])
        await boat.until(lambda: not boat.bow["why"])
        assert clock_in((await boat.picture(boat.link.picture)).jpeg) > clock_in(first.jpeg)

    sailed(tmp_path, LOGIN, story)


def test_a_wrong_login_is_told_without_it(tmp_path: Path) -> None:
    async def story(boat: Boat, camera: IpCamera) -> None:
        await boat.until(lambda: "401" in boat.bow["why"])
        assert "guessed" not in boat.bow["why"]
        assert boat.bow["pictures"] == 0

    sailed(tmp_path, "ana:guessed", story)
