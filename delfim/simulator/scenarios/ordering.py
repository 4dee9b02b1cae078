"""An operator's orders as scenarios have them, by the names that they have in `delfim.simulator.scenarios.pairs`: with what
goes before them, and, where the boat must refuse them, with what makes it.
"""

from collections.abc import Callable
from random import Random
from typing import Any, Final

from delfim.base import tables

Words = dict[str, Any]
Place = Callable[[float, float], list[float]]  # [latitude_deg, longitude_deg] of north and east, m
FAR_M: Final = 90_000.0  # nobody goes so far
SMALL_M: Final = 7.0  # half the side of the mission that is sailed around the start
SWIM: Final[Words] = {"command": "mode", "mode": "swim"}


class DrawnOperator:
    """Draws orders to a boat. `thruster`: the name of one thruster."""

    def __init__(self, random: Random, place: Place, thruster: str) -> None:
        self._random, self._place = random, place
        mission = self._mission(SMALL_M)
        text = 'version = 1\nname = "Around"\n' + "".join(
            f"\n[[waypoint]]\n{tables.text_of(row)}" for row in mission["waypoint"]
        )
        self._made: dict[str, Callable[[], Words]] = {
            "mode": lambda: {
                "command": "mode",
                "mode": random.choice(("hold", "home", "heading", "course", "goto", "path", "manual", "idle")),
            },
            "manual": lambda: {"command": "manual", "starboard": self._part(), "port": self._part()},
            "actuate": lambda: {"command": "actuate", "thruster": thruster, "part": 0.08},
            "heading": lambda: {"command": "heading", "heading_deg": self._angle(), "speed_mps": random.uniform(0.5, 2.2)},
            "course": lambda: {"command": "course", "course_deg": self._angle(), "speed_mps": random.uniform(0.5, 2.2)},
            "speed": lambda: {"command": "speed", "speed_mps": random.uniform(0.2, 2.2)},
            "goto": lambda: self._goto(self._metres(), self._metres()),
            "mission": lambda: {"command": "mission", "text": text},
            "upload": lambda: {"command": "upload", "mission": mission},
            "leg": lambda: {"command": "leg", "leg": random.randint(0, 1)},
            "fence": lambda: self._fence([(-90.0, -90.0), (-90.0, 90.0), (90.0, 90.0), (90.0, -90.0)]),
            "rally": lambda: {"command": "rally", "points": [place(0.0, 0.0)]},
            "set": lambda: {"command": "set", "key": "control.hold.radius_m", "value": random.uniform(3.0, 8.0)},
            "actuate refused": lambda: {"command": "actuate", "thruster": "anchor", "part": 0.2},
            "goto refused": lambda: self._goto(FAR_M, 0.0),
            "mode refused": lambda: SWIM,
            "mission refused": lambda: {"command": "mission", "text": "version = 1\n"},
            "upload refused": lambda: {"command": "upload", "mission": self._mission(FAR_M)},
            "play refused": lambda: {"command": "play", "leg": 90},
            "leg refused": lambda: {"command": "leg", "leg": 90},
            "fence refused": lambda: self._fence([(-9.0, -9.0), (9.0, 9.0), (-9.0, 9.0), (9.0, -9.0)]),
            "set refused": lambda: {"command": "set", "key": "boat.name", "value": "Other"},
        }

    def word(self, name: str) -> Words:
        """Draw an order by its name; "goto refused" is one that is refused."""
        made = self._made.get(name) or self._made.get(name.partition(" ")[0])
        return {"command": name.partition(" ")[0]} if made is None else made()

    def enters(self, mode: str) -> Words:
        """Draw the order that enters a mode; idle is a stop."""
        if mode in ("heading", "course", "goto", "play", "manual"):
            return self.word(mode)
        return {"command": "stop"} if mode == "idle" else {"command": "mode", "mode": mode}

    def before(self, name: str) -> list[Words]:
        """Draw the orders without which this one would not be obeyed, or would not be refused."""
        match name:
            case "clear":
                return [self.word("kill")]
            case "continue":
                return [self.word("heading"), self.word("pause")]
            case "pause" | "reset refused":
                return [self.word("heading")]
            case "actuate" | "reset" | "pause refused" | "arm refused":
                return [self.word("stop")]
            case "play" | "unload":
                return [self.word("mission")]
            case "unload refused":
                return [self.word("mission"), self.word("play")]
        return []

    def _goto(self, north_m: float, east_m: float) -> Words:
        latitude_deg, longitude_deg = self._place(north_m, east_m)
        return {"command": "goto", "latitude_deg": latitude_deg, "longitude_deg": longitude_deg}

    def _mission(self, half_m: float) -> Words:
        places = [
            self._place(*corner) for corner in ((half_m, -half_m), (half_m, half_m), (-half_m, half_m), (-half_m, -half_m))
        ]
        rows = [{"latitude_deg": latitude_deg, "longitude_deg": longitude_deg} for latitude_deg, longitude_deg in places]
        return {"version": 1, "name": "Around", "waypoint": rows}

    def _fence(self, corners: list[tuple[float, float]]) -> Words:
        return {"command": "fence", "zones": {"keep_in": [{"polygon": [self._place(*corner) for corner in corners]}]}}

    def _part(self) -> float:
        return self._random.uniform(0.3, 0.9) * self._random.choice((-1.0, 1.0, 1.0))

    def _angle(self) -> float:
        return self._random.uniform(0.0, 360.0)

    def _metres(self) -> float:
        return self._random.uniform(-55.0, 55.0)
