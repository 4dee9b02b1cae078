"""Debian's MQTT broker, on the loopback."""

import contextlib
import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.parts.gnss.caster import free_port

PROGRAM = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin:/usr/local/bin")
needs_mosquitto = pytest.mark.skipif(PROGRAM is None, reason="needs mosquitto")


@contextlib.contextmanager
def broker(folder: Path, port: int = 0, settings: str = "allow_anonymous true\n") -> Iterator[int]:
    """Its port, once it listens."""
    port = port or free_port()
    file = folder / f"mosquitto-{port}.conf"
    file.write_text(f"user root\nlistener {port} 127.0.0.1\n{settings}")
    assert PROGRAM is not None
    with (folder / "mosquitto.log").open("a") as log:
        program = subprocess.Popen((PROGRAM, "-c", file), stdout=log, stderr=log)
        (folder / f"mosquitto-{port}.pid").write_text(str(program.pid))
        try:
            deadline_s = time.monotonic() + 200
            while True:
                with contextlib.suppress(OSError):
                    socket.create_connection(("127.0.0.1", port), 1).close()
                    break
                said = (folder / "mosquitto.log").read_text()
                assert program.poll() is None, said
                assert time.monotonic() < deadline_s, said
            yield port
        finally:
            program.kill()
            program.wait(200)


def certified(folder: Path) -> str:
    """Settings for TLS and one user, ana, whose password is secret; `folder/cert.pem` is who signs."""
    words = ("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "9")
    names = ("-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost")
    files = ("-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem"))
    subprocess.run((*words, *names, *files), check=True, capture_output=True)
    assert ssl.create_default_context(cafile=str(folder / "cert.pem"))
    subprocess.run(("mosquitto_passwd", "-b", "-c", str(folder / "users"), "ana", "secret"), check=True, capture_output=True)
    (folder / "credentials").write_text("ana:secret\n")
    (folder / "credentials").chmod(0o600)
    return f"certfile {folder}/cert.pem\nkeyfile {folder}/key.pem\nallow_anonymous false\npassword_file {folder}/users\n"
