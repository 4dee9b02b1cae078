"""Inside the guest: the whole suite on the kernel's own vcan0, driven, watched with candump, and its navigation pulled.

Prints one JSON object for the test outside: how many frames of each kind candump saw while the boat sailed, and how it ended
when the navigation node went silent.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from delfim.base.errors import DelfimError
from delfim.base.frames import identifier
from delfim.canproxy.dsor import messages
from delfim.vehicle.operator.link import Link

FOLDER = Path(os.environ["FOLDER"])
VEHICLE = "etc/delfimx.toml"
SETTINGS = {
    "can.interface": '"vcan0"',
    "console.socket": f'"{FOLDER}/command"',
    "log.directory": '"/run/log"',
    "runtime.run_directory": '"/run/delfim"',
    "guest.enabled": "false",
    "supervisor.hardware_watchdog": '""',
}
FOUR = [messages.PROPELLER_STARBOARD, messages.PROPELLER_PORT, messages.BATTERIES_STARBOARD, messages.BATTERIES_PORT]


def delfim(command: str) -> subprocess.Popen[bytes]:
    overrides = [word for key, value in SETTINGS.items() for word in ("--set", f"{key}={value}")]
    return subprocess.Popen([sys.executable, "-m", "delfim", command, VEHICLE, *overrides])


def link() -> Link:
    for _ in range(300):
        try:
            return Link(f"{FOLDER}/command")
        except DelfimError:
            time.sleep(0.1)
    raise SystemExit("the vehicle did not open its command socket")


def heading_home() -> Link:
    """Leave idle as soon as the boat is fit to. A boat that is slow to come up may let a link wait too long."""
    for _ in range(100):
        operator = link()
        try:
            operator.ask("heading", heading_deg=150.0, speed_mps=1.2)
            return operator
        except DelfimError as refusal:
            operator.close()
            last = str(refusal)
            time.sleep(0.1)
    raise SystemExit(f"the boat never became fit: {last}")


def sailed(operator: Link, seconds: float) -> dict[str, object]:
    """Sail for so long; the state at the end."""
    until = time.monotonic() + seconds
    state = operator.ask("alive")
    while time.monotonic() < until:
        time.sleep(0.5)
        operator.ask("alive")
        state = operator.ask("state")
    return state


def stopped(operator: Link) -> str:
    """Why the boat went to idle, when it has."""
    for _ in range(1000):
        state = operator.ask("state")
        if state["mode"] == "idle":
            return str(state["reason"])
        time.sleep(0.02)
    raise SystemExit("the boat did not stop")


def counted(dump: Path) -> dict[str, int]:
    """Frames in candump's file by identifier."""
    counts: dict[str, int] = {}
    for line in dump.read_text().splitlines():
        name = line.split()[2].split("#")[0]
        counts[name] = counts.get(name, 0) + 1
    return counts


def main() -> None:
    nodes, suite = delfim("nodes"), delfim("supervise")
    operator = heading_home()
    before = operator.ask("state")
    dump = FOLDER / "candump.log"
    with dump.open("wb") as file:
        candump = subprocess.Popen(["candump", "-L", "vcan0"], stdout=file)
        after = sailed(operator, 8.0)
        nodes.kill()
        nodes.wait()
        reason = stopped(operator)
        time.sleep(0.5)
        candump.send_signal(signal.SIGINT)
        candump.wait()
    suite.send_signal(signal.SIGTERM)
    code = suite.wait(60)
    last = [line for line in dump.read_text().splitlines() if line.split()[2].startswith("040#")][-1]
    counts = counted(dump)
    report = {
        "headers": sum(n for name, n in counts.items() if len(name) == 8 and int(name, 16) >> 12 & 0x1FF == 0x002),
        "propulsion": [counts.get(f"{identifier(arb):03X}", 0) for arb in FOUR],
        "before": before,
        "after": after,
        "reason": reason,
        "last_command": last.split("#")[1],
        "exit_code": code,
        "logs": [str(path) for path in Path("/run/log").rglob("*") if path.is_file()],
    }
    print("REPORT " + json.dumps(report))


main()
