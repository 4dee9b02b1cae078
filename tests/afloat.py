"""The boat's nodes and its program as processes, for consoles that others wrote."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]


@contextlib.contextmanager
def running(tmp_path: Path, port: int, *more: str, package: Path | str = ROOT) -> Iterator[Path]:
    """The boat's nodes and its program, as at sea but for the bus, speaking to a console on this port; the path of its command
    socket. `more`: values of the vehicle's file. `package`: the path of these programs, where `delfim` is."""
    bus = f"canloop:afloat-{os.getpid()}-{tmp_path.name[-8:]}"
    values = (
        f'can.interface="{bus}"',
        f'console.socket="{tmp_path}/command"',
        f'log.directory="{tmp_path}/log"',
        f'runtime.run_directory="{tmp_path}"',
        'supervisor.hardware_watchdog=""',
        "supervisor.deadman_s=30.0",  # a busy machine may stand still for a second; tests of the dead-man set 1 s
        'httpd.listen="127.0.0.1:0"',
        'cantcpd.listen=["127.0.0.1:0"]',
        'guest.listen="127.0.0.1:0"',
        'mavlink.listen="127.0.0.1:0"',
        f'mavlink.peers=["127.0.0.1:{port}"]',
        *more,
    )
    words = [str(ROOT / "etc/delfimx.toml"), *(word for value in values for word in ("--set", value))]
    there = os.environ | {"PYTHONPATH": str(package)}
    programs = [subprocess.Popen([sys.executable, "-m", "delfim", name, *words], env=there) for name in ("nodes", "supervise")]
    try:
        yield tmp_path / "command"
    finally:
        for program in reversed(programs):
            program.send_signal(signal.SIGTERM)
            program.wait(200)
