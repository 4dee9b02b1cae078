"""A mission sailed in the simulator before it is sailed for real, in a process of its own."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from delfim.console.plan import written
from delfim.errors import DelfimError
from delfim.vehicle.mission import canonical

LIMIT_S: Final = 60.0


def dry_run(vehicle: Path, plan: dict[str, Any], start: tuple[float, float] | None) -> dict[str, Any]:
    """What `delfim.simulator.dryrun` says of a plan of the page, from where the boat is. Blocks for seconds; never raises for
    what the plan says."""
    command = [sys.executable, "-m", "delfim.simulator.dryrun", str(vehicle)]
    if start is not None:
        command += ["--set", f"simulation.latitude_deg={start[0]!r}", "--set", f"simulation.longitude_deg={start[1]!r}"]
    try:
        mission = canonical(written(plan))
        child = subprocess.run(command, input=mission, capture_output=True, text=True, timeout=LIMIT_S, check=True)
        answer: dict[str, Any] = json.loads(child.stdout)
        return answer
    except (DelfimError, OSError, subprocess.SubprocessError, ValueError, KeyError, TypeError) as error:
        return {"end": str(error), "well": False, "time_s": 0.0, "distance_m": 0.0, "track": []}
