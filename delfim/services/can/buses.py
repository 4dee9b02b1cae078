"""The boat's CAN interfaces, set up by the machine's first process: bit rate, restart after bus off, up (ip-link(8)).

Where the board has an init of its own, that one does it (docs/boot.md).
"""

import logging
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final

LATE_S: Final = 10.0  # an adapter on USB appears seconds after its module was loaded
LOOK_S: Final = 0.2
RESTART_MS: Final = 100  # after bus off

log = logging.getLogger(__name__)


def bring_up(bit_rates: Mapping[str, int], present: Path = Path("/sys/class/net")) -> None:
    """Set up interfaces with their bit rates in bit/s; those whose name begins with vcan are made. A failure is logged: a boat
    without its bus starts, and its checks say why it stays in idle."""
    deadline_s = time.monotonic() + LATE_S
    for bus, bitrate_bps in bit_rates.items():
        if bus.startswith("vcan"):
            _ip("add", bus, "type", "vcan")
        else:
            while not (present / bus).exists() and time.monotonic() < deadline_s:
                time.sleep(LOOK_S)
            _ip("set", bus, "type", "can", "bitrate", str(bitrate_bps), "restart-ms", str(RESTART_MS))
        _ip("set", bus, "up")


def _ip(*words: str) -> None:
    try:
        done = subprocess.run(("ip", "link", *words), capture_output=True, text=True, check=False)
    except OSError as error:
        log.error("CAN: ip: %s", error.strerror)
        return
    if done.returncode:
        log.error("CAN: ip link %s: %s", " ".join(words), done.stderr.strip())
