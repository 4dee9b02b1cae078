"""A mission sailed in lock step before it is sailed for real: how long it takes, how far it is, and along which line.

python -m delfim.simulator.scenarios.dryrun FILE [--set KEY=VALUE]... reads a mission's text from standard input and prints one
JSON object: `end` in words, `well`, `time_s`, `distance_m`, `track` as [latitude_deg, longitude_deg] once a second or less
often. A process of its own, so that the caller need not wait: an hour's mission takes four seconds. It is given up after three
times of what its length and speeds ask for, and an hour, or two days.
"""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

from delfim import config
from delfim.base.errors import DelfimError
from delfim.base.geodesy import from_plane
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.plans.estimate import in_hours, mission_s
from delfim.vehicle.plans.mission import read_mission
from delfim.vehicle.state import NoLog

LONGEST_S: Final = 48 * 3600.0
POINTS_MAX: Final = 2000


def sail(settings: config.Vehicle, mission: str, limit_s: float | None = None, seed: int = 1) -> dict[str, Any]:
    """Sail a mission, and return the forecast, JSON-ready."""
    run = Lockstep(settings, seed, lambda clock: NoLog())
    track: list[tuple[float, float]] = []
    end, begun_s, next_s = run.command(console.LoadMission(mission)) or "", 0.0, 0.0
    if limit_s is None:
        limit_s = 0.0 if end else min(3600.0 + 3.0 * _expected_s(mission, settings), LONGEST_S)
    for state in run.cycles(0.0 if end else limit_s):
        if not begun_s:
            begun_s = run.elapsed_s if run.command(console.Play()) is None else 0.0
        elif state.reason.startswith("play done"):
            end = "mission done"
            break
        elif state.mode is Mode.IDLE:
            end = f"stopped: {state.reason}"
            break
        if run.elapsed_s >= next_s and state.origin is not None:
            next_s = run.elapsed_s + 1.0
            track.append((state.motion.north_m, state.motion.east_m))
    origin = run.state.origin
    run.close()
    thinned = track[:: max(len(track) // POINTS_MAX, 1)]
    line = [from_plane(origin, north_m, east_m) for north_m, east_m in thinned] if origin is not None else []
    return {
        "end": end or f"not done after {in_hours(limit_s)} at sea",
        "well": end == "mission done",
        "time_s": round(run.elapsed_s - begun_s, 1),
        "distance_m": round(sum(math.dist(a, b) for a, b in pairwise(track)), 1),
        "track": [[round(math.degrees(latitude), 7), round(math.degrees(longitude), 7)] for latitude, longitude in line],
    }


def _expected_s(mission: str, settings: config.Vehicle) -> float:
    return mission_s(read_mission(mission), settings.control.speed.cruise_mps)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("file")
    parser.add_argument("--set", action="append", default=[])
    asked = parser.parse_args(arguments)
    try:
        answer = sail(config.load(asked.file, asked.set), sys.stdin.read())
    except DelfimError as error:
        answer = {"end": str(error), "well": False, "time_s": 0.0, "distance_m": 0.0, "track": []}
    print(json.dumps(answer))
    return 0


if __name__ == "__main__":
    sys.exit(main())
