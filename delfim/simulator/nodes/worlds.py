"""Worlds of things that stand, and swimmers, drawn from a seed: each lies up to 400 m to the north of where the boat starts."""

from random import Random
from typing import Final, NamedTuple

SIZES_M: Final = (0.3, 0.5, 1.0, 3.0)
MOORED_M: Final = (2.0, 6.0)  # radius of a boat at its mooring
STRAIT_M: Final = (14.0, 30.0)  # half of the water in an entrance


class Standing(NamedTuple):
    """A thing, or a swimmer, as it was drawn."""

    north_m: float
    east_m: float
    radius_m: float
    kind: str = "thing"
    course_deg: float = 0.0
    speed_mps: float = 0.0
    follows_m: float | None = None  # of the boat: it is not there
    follows_deg: float = 0.0


def drawn(world: str, random: Random) -> list[Standing]:
    """The things of a world: "field", "moorings", "bathers", "entrance", "pocket" or "harbour"; none of another name."""
    if world == "field":
        return _scattered(random, random.randint(5, 50))
    if world == "moorings":  # rows of boats, 30 to 45 m from one to the next
        apart_m, shift_m = random.uniform(30.0, 45.0), random.uniform(-20.0, 20.0)
        rows = [(80.0 + apart_m * i, shift_m + apart_m * (k + 0.5 * (i % 2))) for i in range(6) for k in range(-3, 4)]
        boats = random.sample(rows, random.randint(5, len(rows)))
        return [Standing(n + random.gauss(0, 2), e + random.gauss(0, 2), random.uniform(*MOORED_M)) for n, e in boats]
    if world == "bathers":
        return _swimmers(random, 5) + _scattered(random, random.randint(0, 10))
    at_m, half_m = random.uniform(-60.0, 60.0), random.uniform(*STRAIT_M)
    if world in ("entrance", "harbour"):  # two walls, and a gap between them
        walls = [Standing(200.0 + random.uniform(-1, 1), float(e), 0.5) for e in range(-150, 150, 5) if abs(e - at_m) > half_m]
        if world == "entrance":
            return walls
        rows = [(240.0 + 40.0 * i, at_m + 40.0 * (k + 0.5 * (i % 2))) for i in range(3) for k in range(-3, 4)]
        boats = random.sample(rows, random.randint(5, 14))
        moored = [Standing(n + random.gauss(0, 2), e + random.gauss(0, 2), random.uniform(*MOORED_M)) for n, e in boats]
        return walls + moored + _swimmers(random, 4)
    if world == "pocket":  # three walls, open to the south
        back = [Standing(240.0, at_m + e, 0.5) for e in range(-35, 36, 6)]
        return back + [Standing(float(n), at_m + e, 0.5) for n in range(180, 240, 6) for e in (-35.0, 35.0)]
    return []


def _place(random: Random) -> tuple[float, float]:
    return random.uniform(40.0, 360.0), random.uniform(-100.0, 100.0)


def _swimmers(random: Random, count: int) -> list[Standing]:
    return [
        Standing(*_place(random), 0.3, "person", random.uniform(0.0, 360.0), random.uniform(0.0, 0.8)) for _ in range(count)
    ]


def _scattered(random: Random, count: int) -> list[Standing]:
    return [Standing(*_place(random), random.choice(SIZES_M)) for _ in range(count)]
