"""rtklib's str2str as a caster, and a base that feeds it."""

import contextlib
import shutil
import socket
import subprocess
from collections.abc import Iterator

import pytest

needs_str2str = pytest.mark.skipif(not shutil.which("str2str"), reason="needs str2str of rtklib")


def free_port() -> int:
    with socket.socket() as any_socket:
        any_socket.bind(("127.0.0.1", 0))
        number: int = any_socket.getsockname()[1]
        return number


class Base:
    """What the caster hands on: bytes that the test speaks."""

    def __init__(self) -> None:
        self._door = socket.create_server(("127.0.0.1", 0))
        self._door.settimeout(200)
        self.port = self._door.getsockname()[1]
        self._line: socket.socket | None = None

    def meet(self) -> None:
        """Wait for the caster."""
        self._line, _ = self._door.accept()

    def say(self, data: bytes) -> None:
        assert self._line is not None
        self._line.sendall(data)

    def close(self) -> None:
        for each in (self._line, self._door):
            if each is not None:
                each.close()


@contextlib.contextmanager
def casting(port: int, user: str = "ana:secret") -> Iterator[Base]:
    """A caster on the loopback with the mountpoint BASE."""
    base = Base()
    words = ["-in", f"tcpcli://127.0.0.1:{base.port}", "-out", f"ntripc://{user}@:{port}/BASE", "-s", "0", "-r", "100"]
    program = subprocess.Popen(["str2str", *words], stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        base.meet()
        yield base
    finally:
        base.close()
        program.kill()
        program.wait(200)
