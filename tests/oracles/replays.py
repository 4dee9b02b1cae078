"""Days at sea that were recorded once, and must be replayed bit by bit by every later version. They are recorded anew only when
somebody says so: `make oracles ARGS=days`.
"""

import shutil
import tempfile
from pathlib import Path
from typing import Final

from delfim.logging.ashore.tree import files
from delfim.simulator.replay.rerun import RerunResult, rerun
from delfim.vehicle import console
from tests.logging.sailing import MISSION, Day
from tests.oracles.keeping import KEPT

DAYS: Final = KEPT / "days"
VESCS: Final = ", ".join(
    f'{{name="{name}", driver="vesc", address={n}, x_m=-1.0, y_m={0.5 - n}, thrust_n=[-200.0, 300.0], rpm_max=1800.0}}'
    for n, name in enumerate(("starboard", "port"))
)
BOATS: Final = {"delfimx": (), "vesc": (f"thrusters=[{VESCS}]", 'sysstat.required=["gps"]')}


def record() -> None:
    """A mission, a heading and manual thrust of each boat."""
    for name, overrides in BOATS.items():
        with tempfile.TemporaryDirectory() as place:
            day = Day(Path(place), *overrides)
            day.sail(3.0)
            for commands in (
                (console.LoadMission(MISSION), console.Play()),
                (console.Heading(200.0, 1.2),),
                (console.Manual(0.5, 0.25),),
                (console.Stop(),),
            ):
                for command in commands:
                    assert day.command(command) is None
                day.sail(3.0)
            day.end()
            for sidecar in Path(place).glob("*/*/*.jsonl"):
                sidecar.write_text(sidecar.read_text().replace(place, "/log"))
            shutil.rmtree(DAYS / name, ignore_errors=True)
            shutil.copytree(place, DAYS / name)


def replayed(name: str) -> RerunResult:
    return rerun(files([DAYS / name]), None)
