"""A payload that has the boat: it follows the warmth of the water up to where it is warmest, and waits there.

Its thermometer is played: warm water lies round a peak. A real program reads its instrument in `Peak.measure` instead. What it
says is in docs/payloads.md: a line of values for each line of navigation, orders once a second while the boat is its own, and
`alive` otherwise.
"""

import argparse
import json
import math
import sys
from collections import deque
from typing import Any, Final

METRES_A_DEGREE: Final = 111_120.0
SAMPLES: Final = 30  # one a second: the gradient is that of the last 30 s of the way
SURE: Final = 12  # fewer samples make no plane
LEG_S: Final = 15  # the boat weaves: a straight line says nothing of what lies beside it
WEAVE_DEG: Final = 20.0
SPEED_MPS: Final = 1.5
PAST_S: Final = 30  # after the warmest place came nothing warmer for so long: that was the peak

Point = tuple[float, float]  # metres north and east of where it began


class Peak:
    """The warmth of the water, degrees Celsius."""

    def __init__(self, latitude_deg: float, longitude_deg: float, width_m: float) -> None:
        self._at, self._width_m = (latitude_deg, longitude_deg), width_m

    def warmth(self, away_m: float) -> float:
        return 14.0 + 4.0 * math.exp(-0.5 * (away_m / self._width_m) ** 2)

    def measure(self, latitude_deg: float, longitude_deg: float) -> float:
        return round(self.warmth(math.hypot(*metres(self._at, (latitude_deg, longitude_deg)))), 3)


def metres(origin: Point, place: Point) -> Point:
    """North and east of the origin, for two places in degrees."""
    east = (place[1] - origin[1]) * math.cos(math.radians(origin[0]))
    return (place[0] - origin[0]) * METRES_A_DEGREE, east * METRES_A_DEGREE


def gradient(samples: deque[tuple[float, float, float]]) -> Point | None:
    """Of the plane through (north, east, warmth), by least squares; None: they lie on a line, or there are too few."""
    if len(samples) < SURE:
        return None
    n, e, t = (sum(each[i] for each in samples) / len(samples) for i in range(3))
    nn = sum((each[0] - n) ** 2 for each in samples)
    ee = sum((each[1] - e) ** 2 for each in samples)
    ne = sum((each[0] - n) * (each[1] - e) for each in samples)
    nt = sum((each[0] - n) * (each[2] - t) for each in samples)
    et = sum((each[1] - e) * (each[2] - t) for each in samples)
    area = nn * ee - ne * ne
    return None if area < 1e-3 * (nn + ee) ** 2 else ((ee * nt - ne * et) / area, (nn * et - ne * nt) / area)


class Climb:
    """One climb: begun when the boat is given, over at the peak."""

    def __init__(self, origin: Point) -> None:
        self._origin, self._samples = origin, deque[tuple[float, float, float]](maxlen=SAMPLES)
        self._seconds = self._best_s = 0
        self._best, self._warmest = origin, -math.inf
        self.is_over = False

    def order(self, place: Point, warmth: float) -> dict[str, Any]:
        """The order of this second."""
        self._seconds += 1
        self._samples.append((*metres(self._origin, place), warmth))
        if warmth > self._warmest:
            self._warmest, self._best, self._best_s = warmth, place, self._seconds
        if self.is_over:
            return {"command": "alive"}
        if self._seconds - self._best_s > PAST_S:
            self.is_over = True
            return {"command": "goto", "latitude_deg": self._best[0], "longitude_deg": self._best[1], "speed_mps": SPEED_MPS}
        return {"command": "heading", "heading_deg": round(self._heading_deg(), 1) % 360.0, "speed_mps": SPEED_MPS}

    def _heading_deg(self) -> float:
        """Up, and to one side of it and the other by turns."""
        leg = self._seconds // LEG_S
        slope = gradient(self._samples)
        if slope is None:
            return 90.0 * leg
        return math.degrees(math.atan2(slope[1], slope[0])) + (WEAVE_DEG if leg % 2 else -WEAVE_DEG)


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--name", default="uphill", help="its own in the vehicle's file")
    words.add_argument("--peak", type=float, nargs=3, required=True, metavar=("LATITUDE", "LONGITUDE", "WIDTH_M"))
    asked = words.parse_args()
    peak, climb, said_s = Peak(*asked.peak), None, 0
    for line in sys.stdin:  # ends when the boat's program ends
        told = json.loads(line)
        if "event" in told:
            if told["event"] == "answer" and not told["ok"]:
                print(told["reason"], file=sys.stderr)
            continue
        if told["latitude_deg"] is None:
            print('{"temperature_c": null}', flush=True)
            continue
        place = told["latitude_deg"], told["longitude_deg"]
        warmth, now_s = peak.measure(*place), told["utc_ns"] // 1_000_000_000
        if now_s != said_s:
            said_s = now_s
            climb = (climb or Climb(place)) if told["helmsman"] == asked.name else None
            print(json.dumps(climb.order(place, warmth) if climb else {"command": "alive"}))
        print(json.dumps({"temperature_c": warmth, "found": bool(climb and climb.is_over)}), flush=True)


if __name__ == "__main__":
    main()
