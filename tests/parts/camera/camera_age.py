"""How old the pictures of an IP camera are when the boat has them: `python -m tests.parts.camera.camera_age`; half a minute.

The camera is that of the tests (H.264 within RTSP), at 30 and 15 pictures a second; of them ten are taken.
"""

import asyncio
import contextlib
import socket
import tempfile
from pathlib import Path
from statistics import median, quantiles

from delfim.base.clock import SystemClock
from delfim.parts.camera.grabber import Grabber, Picture
from delfim.parts.camera.played import BITS
from delfim.parts.camera.table import CameraTable
from tests.kit.ipcamera import LOGIN, SIZE, ip_camera
from tests.parts.camera.test_grabber import Readers
from tests.parts.camera.test_pictures import clock_in

SETTLE_S, MEASURE_S = 5.0, 8.0


class LoopReaders(Readers):
    """The loop's."""

    def reader(self, fd: int, handler: object) -> None:
        asyncio.get_running_loop().add_reader(fd, handler)  # type: ignore[arg-type]

    def remove_reader(self, fd: int) -> None:
        asyncio.get_running_loop().remove_reader(fd)


async def main(folder: Path, rate_hz: float) -> None:
    secret, door, ages_ms = folder / "login", socket.create_server(("127.0.0.1", 0)), list[int]()
    secret.write_text(LOGIN)
    secret.chmod(0o600)

    def took(level: int, picture: Picture) -> None:
        if level == 0:
            ages_ms.append((picture.taken_ms - clock_in(picture.jpeg)) % (1 << BITS))

    source = f"rtsp://127.0.0.1:{door.getsockname()[1]}/main"
    table = CameraTable(source=source, credentials=str(secret), width_px=SIZE[0], height_px=SIZE[1])
    async with ip_camera(folder, door, rate_hz):
        with contextlib.closing(Grabber("bow", table, SystemClock(), LoopReaders(), took)) as its:
            its.tick()
            await asyncio.sleep(SETTLE_S)
            ages_ms.clear()
            await asyncio.sleep(MEASURE_S)
    print(f"camera of {rate_hz:.0f} Hz: {len(ages_ms) / MEASURE_S:.1f} pictures a second, ", end="")
    print(f"age median {median(ages_ms):.0f} ms, 95 % {quantiles(ages_ms, n=20)[-1]:.0f} ms", flush=True)


if __name__ == "__main__":
    for each_hz in (30.0, 15.0):
        with tempfile.TemporaryDirectory() as name:
            asyncio.run(main(Path(name), each_hz))
