"""What the runtime takes of a small computer: memory; and the time to its first command to the propellers, which is printed
(`pytest -rP`)."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from delfim.canproxy.dsor import messages
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress, CanSocket

ROOT = Path(__file__).parents[1]
VEHICLE = str(ROOT / "etc/delfimx.toml")
MEMORY_MB = 80.0


@pytest.fixture
def nodes(tmp_path: Path) -> Iterator[tuple[CanSocket, list[str]]]:
    """Navigation is on the bus already: the bus, bound to the commands of a propeller, and the boat's overrides."""
    bus = f"canloop:small-{os.getpid()}"
    settings = {
        "can.interface": f'"{bus}"',
        "console.socket": f'"{tmp_path}/command"',
        "log.directory": f'"{tmp_path}/log"',
        "runtime.run_directory": f'"{tmp_path}"',
        "guest.listen": '"127.0.0.1:0"',
        "cantcpd.listen": '["127.0.0.1:0"]',
        "mavlink.listen": '"127.0.0.1:0"',
        "httpd.listen": '"127.0.0.1:0"',
    }
    words = [VEHICLE, *(word for key, value in settings.items() for word in ("--set", f"{key}={value}"))]
    process = subprocess.Popen([sys.executable, "-m", "delfim", "nodes", *words])
    with open_can(bus) as socket:
        socket.settimeout(200)
        socket.bind(CanAddress(messages.sysstat_arb(messages.Node.PROPELLER_STARBOARD)))
        socket.recvmsg()
        socket.bind(CanAddress(messages.PROPELLER_STARBOARD))
        yield socket, words
    process.terminate()
    process.wait(200)


def test_from_its_start_to_the_first_command_and_all_its_memory(nodes):
    bus, words = nodes
    began_s = time.monotonic()
    runtime = subprocess.Popen([sys.executable, "-m", "delfim", "run", *words])
    try:
        bus.recvmsg()
        ready_s = time.monotonic() - began_s
        for _ in range(25):  # five seconds of cycles: all services run
            bus.recvmsg()
        status = Path(f"/proc/{runtime.pid}/status").read_text()
    finally:
        runtime.send_signal(signal.SIGTERM)
        runtime.wait(200)
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    assert found
    memory_mb = int(found[1]) / 1024
    print(f"first command after {ready_s:.2f} s, {memory_mb:.0f} MB resident")
    assert memory_mb <= MEMORY_MB
