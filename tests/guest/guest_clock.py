"""Inside the guest: the whole suite sails and is visited while its wall clock is set again and again, a day on, a day back, to
1970, over the roll-over of the GPS's weeks and past 2038.

Prints one JSON object for the test outside: the state after each step, how often whom was served, restarts, and what the logs
tell of the steps.
"""

import argparse
import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

from bench import critical_path, soak
from bench.critical_path import until
from bench.soak import Boat, Visitors
from delfim.logging.ashore import tree
from delfim.logging.statelog import columns
from delfim.vehicle.operator.link import Link

DAY_S = 86_400.0
ROLL_OVER_S = 1_554_595_200.0  # 2019-04-07, the GPS's week 2048 is its week 0 again
END_2038_S = float(1 << 31)
HERE_S = 4.0  # how long each time lasts
FOLDER = Path(os.environ["FOLDER"])


class Sea(Boat):
    """On the kernel's bus, with the time service, under way."""

    def _overrides(self) -> list[str]:
        # A busy host makes everybody late, but by no days. The other nodes and the kernel's part of the network run on the
        # one slow processor, too: beside a runtime in real time they would hardly get it.
        patient = (
            *("navigation.stale_s=30.0", "failsafe.navigation_silent.after_s=30.0", "sysstat.stale_s=30.0"),
            *("supervisor.deadman_s=60.0", "runtime.fifo_priority=0"),
        )
        return [*super()._overrides(), 'can.interface="vcan0"', 'timed.mode="master"', "log.free_bytes_min=0", *patient]


def sailed(operator: Link, seconds: float) -> list[dict[str, Any]]:
    """The states meanwhile, twice a second."""
    states, until_s = [], time.monotonic() + seconds
    while time.monotonic() < until_s:
        operator.ask("alive")
        states.append(operator.ask("state"))
        time.sleep(0.5)
    return states


def told(state: dict[str, Any]) -> dict[str, Any]:
    """What of a state a step of the clock could spoil."""
    return {key: state[key] for key in ("mode", "reason", "notices")}


def main() -> None:
    asked = argparse.Namespace(file="etc/delfimx.toml", set=[])
    critical_path.START_S = 100.0  # type: ignore[misc]  # the guest's only processor may be that of a busy host
    soak.TIMEOUT_S = 60.0  # type: ignore[misc]
    boot_s = time.time()
    (FOLDER / "boat").mkdir()
    with Sea(asked, FOLDER / "boat") as boat, Link(boat.place / "command") as operator:
        boat.bus = "vcan0"
        until(lambda: operator.ask("heading", heading_deg=150.0, speed_mps=1.2), "heading")
        candump = subprocess.Popen(["candump", "-L", "vcan0,0C0:7FF"], stdout=(FOLDER / "times").open("wb"))
        visitors, report = Visitors(boat), []
        sailed(operator, HERE_S)
        for at_s in (boot_s + DAY_S, boot_s - DAY_S, DAY_S, ROLL_OVER_S - 2.0, END_2038_S - 2.0, boot_s):
            time.clock_settime(time.CLOCK_REALTIME, at_s)
            states = sailed(operator, HERE_S)
            report.append([told(state) for state in states])
        visitors.end()
        candump.terminate()
        candump.wait()
        programs = boat.programs()
    files = tree.files([boat.place / "log"])
    stepped = [event for event in tree.events(files) if event["event"] == "clock step"]
    stepped.sort(key=lambda event: event["monotonic_s"])  # files have the names of their days
    told_s = columns(file.path for file in files if file.id == "state")["monotonic_s"]
    print(
        "REPORT "
        + json.dumps(
            {
                "states": report,
                "programs": programs,
                "visits": visitors.visits,
                "failures": visitors.failures,
                "reasons": visitors.reasons,
                "files": [file.path for file in files],
                "steps": stepped,
                "gap_s": max(b - a for a, b in zip(sorted(told_s), sorted(told_s)[1:], strict=False)),
            }
        )
    )


main()
