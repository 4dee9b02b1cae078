"""Inside a guest that is about to lose its power: mounts the log partition as the boat's init does, starts the suite and full
bus load, and returns as soon as everything sails and logs. What it started goes on until the guest is killed."""

import os
import subprocess
import sys
import time
from pathlib import Path

from delfim.base.errors import DelfimError
from delfim.canproxy.dsor.messages import Node
from delfim.vehicle.operator.link import Link

LOG = Path("/mnt/log")
FOLDER = os.environ["FOLDER"]
FRAMES_PER_S, DEVICE, FILE_BYTES = sys.argv[1:]
HEART = """
import os, sys, time
fd = os.open(sys.argv[1] + "/alive", os.O_WRONLY | os.O_CREAT)
while True:
    os.pwrite(fd, f"{time.time():.3f}".encode(), 0)
    os.fsync(fd)  # on the host now
    time.sleep(0.02)
"""
TALKER = """
import logging, time
from delfim.canproxy.dsor.protocol import BROADCAST, Message, segments
from delfim.canproxy.opening import open_can
from delfim.logging.systemlog import begin
from delfim.canproxy.dsor.messages import LOG_ID, Node
begin("/run/delfim", "talker", {})
with open_can("vcan0") as bus:
    number = 0
    while True:
        text = f"fix {number}, as long as a line of a legacy node is".encode()
        for frame in segments(Message(192, Node.GPS, BROADCAST, LOG_ID, text), number):
            bus.sendmsg(frame)
        logging.getLogger("delfim.talker").info("fix %d, as long as what a program says", number)
        number += 1
        time.sleep(0.05)
"""
SETTINGS = {
    "can.interface": '"vcan0"',
    "console.socket": '"/run/delfim/command"',
    "failsafe.console_silent.after_s": "3600.0",  # nobody commands it again: it would hold before a late cut
    "log.directory": f'"{LOG}"',
    "log.free_bytes_min": "1_000_000",
    "log.file_bytes": FILE_BYTES,
    "logd.nodes": f"[{Node.GPS:d}]",
    "navigation.rate_hz": "20.0",
    "runtime.fifo_priority": "0",  # the whole bus is computed on the one slow processor, too: writers would hardly get it
    "runtime.run_directory": '"/run/delfim"',
    "supervisor.hardware_watchdog": '""',
}


def start(*command: str) -> None:
    """Goes on when this program has ended."""
    with open(f"{FOLDER}/suite.out", "ab") as output:
        subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True)


def delfim(command: str) -> None:
    overrides = [word for key, value in SETTINGS.items() for word in ("--set", f"{key}={value}")]
    start(sys.executable, "-m", "delfim", command, "etc/delfimx.toml", *overrides)


def until(true: object, what: str) -> None:
    for _ in range(600):
        if true():
            return
        time.sleep(0.05)
    raise SystemExit(f"{what}\n{Path(FOLDER, 'suite.out').read_text(errors='replace')[-3000:]}")


def heading() -> bool:
    try:
        with Link("/run/delfim/command") as operator:
            operator.ask("heading", heading_deg=45.0, speed_mps=1.2)
    except DelfimError:
        return False
    return True


def growing() -> bool:
    """Whether this boot's logs of all kinds are on the disk."""
    begun = os.stat(f"{FOLDER}/begun").st_mtime
    new = [path for path in LOG.glob("*/*/*.gz") if path.stat().st_mtime > begun and path.stat().st_size > 500]
    return {path.parent.name for path in new} >= {"state", "vcan0", "gps", "system"}


def main() -> None:
    for name, centiseconds in (("writeback", 500), ("expire", 3000)):  # as everywhere but in a guest: the kernel is in no hurry
        Path(f"/proc/sys/vm/dirty_{name}_centisecs").write_text(str(centiseconds))
    LOG.mkdir()
    Path("/run/delfim").mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "ext2", DEVICE, LOG], check=True)
    Path(f"{FOLDER}/begun").touch()
    start(sys.executable, "-c", HEART, FOLDER)
    start(sys.executable, "-c", TALKER)
    delfim("nodes")
    delfim("supervise")
    until(heading, "the boat never became fit")
    start("cangen", "vcan0", "-g", f"{1000 / float(FRAMES_PER_S):.3f}", "-i")
    until(growing, "the logs do not grow")


main()
