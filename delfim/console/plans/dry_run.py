"""The dry run: sails a mission in the simulator, in a process of its own."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from delfim.base.errors import DelfimError
from delfim.console.plans.plan import checked_tables
from delfim.vehicle.plans.mission import canonical

LIMIT_S: Final = 600.0  # of this computer: two days at sea take it three minutes


def dry_run(
    vehicle: Path, plan: dict[str, Any], start: tuple[float, float] | None, chart: Path | None = None
) -> dict[str, Any]:
    """The result of `delfim.simulator.scenarios.dryrun` for a plan of the page, from the boat's position. `chart`:
    what the boat's file calls so, where it lies on this computer. Blocks for seconds;
    never raises for a bad plan."""
    command = [sys.executable, "-m", "delfim.simulator.scenarios.dryrun", str(vehicle)]
    if chart is not None:
        command += ["--set", f"fence.chart={json.dumps(str(chart))}"]
    if start is not None:
        command += ["--set", f"simulation.latitude_deg={start[0]!r}", "--set", f"simulation.longitude_deg={start[1]!r}"]
    try:
        mission = canonical(checked_tables(plan))
        child = subprocess.run(command, input=mission, capture_output=True, text=True, timeout=LIMIT_S, check=True)
        answer: dict[str, Any] = json.loads(child.stdout)
        return answer
    except subprocess.TimeoutExpired:
        reason = f"this computer did not sail it in {LIMIT_S:.0f} s: close other programs, or try a part of it"
    except (DelfimError, OSError, subprocess.SubprocessError, ValueError, KeyError, TypeError) as error:
        reason = str(error)
    return {"end": reason, "well": False, "time_s": 0.0, "distance_m": 0.0, "track": []}
