"""The whole boat with motors on a DroneCAN bus, which pydronecan plays: commanded, heard, stopped by the dead-man.

python -m tests.esc_voyage FOLDER INTERFACE
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

from delfim.base.errors import DelfimError
from delfim.canproxy.dronecan.datatypes import NODE_STATUS, RAW_COMMAND
from delfim.canproxy.dronecan.transfers import TransferReceiver
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanSocket
from delfim.parts.dronecan.table import Dronecan
from delfim.vehicle.operator.link import Link
from tests.afloat import ROOT, running

PAGE = 18_731
ALONE = """import sys
sys.modules["can"] = sys.modules["pymavlink"] = None  # pydronecan would load them, seconds and 100 MB, and needs neither
from tests.esc_pair import main
main()"""
ROWS = ", ".join(
    f'{{name="{name}", driver="dronecan", address={address}, x_m=-2.0, y_m={y_m}, thrust_n=[-300.0, 500.0], rpm_max=1400.0}}'
    for address, (name, y_m) in enumerate((("starboard", 1.0), ("port", -1.0)))
)
BOAT = (
    *("simulation.motors=false", f"thrusters=[{ROWS}]", 'sysstat.required=["gps"]', "failsafe.thruster.action='warn'"),
    'navigation.sources=["dsor", "dronecan"]',  # sensors may share the bus
)


@contextlib.contextmanager
def esc_pair(interface: str, silent_s: float) -> Iterator[subprocess.Popen[str]]:
    words = (sys.executable, "-c", ALONE, interface, str(silent_s))
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}
    ) as pair:
        try:
            yield pair
        finally:
            pair.terminate()


def said(pair: subprocess.Popen[str], word: str) -> list[str]:
    """What the controllers said until this."""
    assert pair.stdout is not None
    words = list[str]()
    while not words or words[-1] != word:
        words.append(pair.stdout.readline().strip())
        assert words[-1], "the controllers ended"
    return words


def asked(command: Path, fits: str, **words: object) -> dict:
    """The state of the boat as soon as it carries this command out."""
    while True:
        with contextlib.suppress(DelfimError), Link(command, 60.0) as link:  # it does not run yet, or is not fit yet
            return link.ask(fits, **words)


def often(bus: CanSocket) -> int:
    """Commands to the motors between two words of the boat's node on itself, which come each second."""
    commands, words = 0, 0
    while words < 2:
        identifier = bus.recvmsg().identifier
        if identifier & 0x7F != Dronecan().node:  # the controllers speak, too
            continue
        kind = identifier >> 8 & 0xFFFF
        words += kind == NODE_STATUS.id
        commands += kind == RAW_COMMAND.id and words == 1
    return commands


def voyage(folder: Path, bus: str) -> None:
    """From the start to the dead-man, on this bus. Raises AssertionError."""
    values = (
        *BOAT,
        f'dronecan.interface="{bus}"',
        f'httpd.listen="127.0.0.1:{PAGE}"',
        "mavlink.enabled=false",
        "supervisor.deadman_s=1.0",
    )
    with esc_pair(bus, silent_s=3600.0) as pair, running(folder, 14550, *values) as command:
        said(pair, "zero")
        state = asked(command, "manual", starboard=0.5, port=-0.25)
        said(pair, "turns")
        while not (state["thrusters"]["starboard"].get("rpm") and state["thrusters"]["port"].get("rpm")):
            state = asked(command, "manual", starboard=0.5, port=-0.25)
        assert state["thrusters"]["starboard"]["rpm"] > 0.0 > state["thrusters"]["port"]["rpm"]
        while "20" not in state["dronecan.sensors"]["devices"]:
            state = asked(command, "state")
        errors = state["dronecan"]["errors"]
        # The boat may begin to listen in the middle of a controller's word, and a busy computer may take its time for the rest.
        assert not errors.keys() - {"start lost", "incomplete"}, errors
        with urllib.request.urlopen(f"http://127.0.0.1:{PAGE}/api/state") as page:
            shown = json.load(page)["vehicle"]["thrusters"]
        assert shown["starboard"]["voltage_v"] == 24.0
        print(json.dumps(shown, indent=1))
        with open_can(bus) as onlooker:
            onlooker.bind(*TransferReceiver((NODE_STATUS, RAW_COMMAND)).filters)
            onlooker.settimeout(200)
            while often(onlooker) <= 12:  # navigation alone would give five or six; a busy computer may take some time for it
                pass
        asked(command, "stop")
        said(pair, "zero")
        asked(command, "manual", starboard=0.5, port=0.5)
        said(pair, "turns")
        told = json.loads((folder / "supervisor.json").read_text())
        began_s = time.monotonic()
        os.kill(told["programs"]["runtime"]["pid"], signal.SIGSTOP)
        said(pair, "zero")  # not one of them would have stopped by itself
        print(f"stopped {time.monotonic() - began_s:.2f} s after the runtime was hung")


if __name__ == "__main__":
    voyage(Path(sys.argv[1]), sys.argv[2])
