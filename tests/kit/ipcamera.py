"""An IP camera: the played pictures as H.264 by the system's ffmpeg, behind RTSP (RFC 2326) within TCP, as cameras have it.
What asks for a login and hands packets on is ours, because no small program of Debian serves RTSP.
"""

import asyncio
import base64
import contextlib
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

LOGIN = "ana:secret"
SIZE = (640, 360)
TOLD_S = 60.0  # until ffmpeg has told of what it sends


class IpCamera:
    """It plays for any number of clients that know the login."""

    def __init__(self, sdp: bytes) -> None:
        self._sdp = sdp
        self._watching = set[asyncio.StreamWriter]()

    async def answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError), contextlib.closing(writer):
            while True:
                first, *lines = (await reader.readuntil(b"\r\n\r\n")).decode().strip().split("\r\n")
                method, url, _ = first.split()
                writer.write(self._answer(method, url, dict(line.split(": ", 1) for line in lines)))
                if method == "PLAY":
                    self._watching.add(writer)
        self._watching.discard(writer)

    def _answer(self, method: str, url: str, words: dict[str, str]) -> bytes:
        number = f"CSeq: {words['CSeq']}\r\n"
        known = "Basic " + base64.b64encode(LOGIN.encode()).decode()
        if method == "DESCRIBE" and words.get("Authorization") != known:
            return f'RTSP/1.0 401 Unauthorized\r\n{number}WWW-Authenticate: Basic realm="camera"\r\n\r\n'.encode()
        more, body = "Session: 1\r\n", b""
        if method == "DESCRIBE":
            more, body = f"Content-Base: {url}/\r\nContent-Type: application/sdp\r\n", self._sdp
        elif method == "SETUP":
            more += "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n"
        return f"RTSP/1.0 200 OK\r\n{number}{more}Content-Length: {len(body)}\r\n\r\n".encode() + body

    def hand_on(self, packet: bytes) -> None:
        for each in self._watching:
            each.write(b"$\0" + len(packet).to_bytes(2, "big") + packet)

    def hang_up(self) -> None:
        """On all that watch; who asks again is answered."""
        for each in self._watching:
            each.close()
        self._watching.clear()


@contextlib.asynccontextmanager
async def ip_camera(folder: Path, door: socket.socket, rate_hz: float = 15.0) -> AsyncIterator[IpCamera]:
    """A camera that listens at the door, which it closes; `folder` is for what ffmpeg tells of its stream."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as packets:
        packets.bind(("127.0.0.1", 0))
        packets.setblocking(False)
        with _sent(folder / "sdp", packets.getsockname()[1], rate_hz):
            camera = IpCamera(await _told(folder / "sdp"))
            clients = set[asyncio.Task[None]]()

            def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
                task = asyncio.create_task(camera.answer(reader, writer))
                clients.add(task)
                task.add_done_callback(clients.discard)

            server = await asyncio.start_server(connected, sock=door)
            asyncio.get_running_loop().add_reader(packets, lambda: camera.hand_on(packets.recv(1 << 16)))
            try:
                yield camera
            finally:
                asyncio.get_running_loop().remove_reader(packets)
                server.close()
                camera.hang_up()
                for each in clients:
                    each.cancel()
                await asyncio.gather(*clients, return_exceptions=True)


@contextlib.contextmanager
def _sent(sdp: Path, port: int, rate_hz: float) -> Iterator[None]:
    """The pictures, as RTP to that port."""
    played = [sys.executable, "-m", "delfim.parts.camera.played", str(rate_hz), f"{SIZE[0]}x{SIZE[1]}:1"]
    encoder = ["ffmpeg", "-loglevel", "error", "-fflags", "nobuffer", "-use_wallclock_as_timestamps", "1"]
    encoder += ["-f", "mpjpeg", "-i", "pipe:0", "-c:v", "libx264", "-preset", "ultrafast", "-tune", "zerolatency"]
    encoder += ["-pix_fmt", "yuv420p", "-g", "15", "-flags", "+global_header", "-b:v", "2M"]
    encoder += ["-f", "rtp", "-sdp_file", str(sdp), f"rtp://127.0.0.1:{port}?pkt_size=1200"]
    with subprocess.Popen(played, stdout=subprocess.PIPE) as pictures, subprocess.Popen(encoder, stdin=pictures.stdout) as sent:
        assert pictures.stdout is not None
        pictures.stdout.close()
        try:
            yield
        finally:
            sent.kill()
            pictures.kill()


async def _told(file: Path) -> bytes:
    """What it sends, once ffmpeg has said it whole."""
    async with asyncio.timeout(TOLD_S):
        while not file.exists() or b"a=fmtp" not in (sdp := file.read_bytes()):
            await asyncio.sleep(0.02)
    return sdp.replace(b"SDP:\n", b"").replace(b"\n", b"\r\n") + b"a=control:track\r\n"
