"""Hulls of another hand: a program of its own, over UDP in lock step (docs/external-model.md), without the simulator's code.

    python -m bench.otherhulls PORT HULL SEED

Fossen's Otter (Handbook of Marine Craft Hydrodynamics, 2021), the Heron of PX4's simulation, the WAM-V of VRX (Bingham et al.,
OCEANS 2019), and a slim monohull by strip theory, by their published numbers; every hull behind these four has them drawn:
coefficients up to 40 % off, inertia from a third to three times. Its motors have dead band, power law, delay, lag, and the
wiring of the seed.
"""

import json
import math
import socket
import sys
from collections import deque
from random import Random
from typing import Any, Final, NamedTuple

STEP_S: Final = 0.02
AIR, WATER = 1.225, 1025.0
Motors = dict[str, float]


class Published(NamedTuple):
    """A hull: masses with the water's, damping (linear, quadratic), a motor, and what the wind feels."""

    boat: str  # of etc/boats, whose file its owner has ...
    told: tuple[str, ...]  # ... with these keys
    m11: float
    m22: float
    m33: float
    m23: float
    surge: tuple[float, float]
    sway: tuple[float, float]
    yaw: tuple[float, float]
    yaw_ahead: float
    munk: float
    draught_m: float  # of strips of cross-flow
    length_m: float
    push_n: float  # of one motor ahead at full command
    astern: float
    aside_m: float
    wind_m2: tuple[float, float]


_OTTER_M33: Final = (55.0 * (0.25 + 0.153**2) + 0.0625 + 80.0 * 0.153**2) * (1.0 + 1.7 / 2.7)
PUBLISHED: Final = (
    Published(
        *("otter", (), 85.5, 162.5, _OTTER_M33, 12.25, (77.6, 0.0), (162.5, 0.0), (_OTTER_M33, 10.0 * _OTTER_M33)),
        *(0.0, 1.0, 0.195, 2.0, 119.7, 0.557, 0.395, (0.4, 0.8)),
    ),
    Published(
        *("heron", (), 33.0, 33.0, 5.0, 0.0, (20.0, 4.0), (20.0, 20.0), (7.0, 6.0), 0.0, 1.0, 0.0, 1.35, 33.6, 0.59, 0.37),
        (0.2, 0.35),
    ),
    Published(
        *("wam-v", (), 220.0, 410.0, 920.0, 0.0, (100.0, 150.0), (100.0, 100.0), (800.0, 800.0), 0.0, 1.0, 0.0, 4.9),
        *(250.0, 0.4, 1.03, (1.2, 1.8)),
    ),
    Published(
        *(
            "otter",
            ("boat.length_m=3.0", "boat.beam_m=0.7", "boat.mass_kg=60.0"),
            63.0,
            102.0,
            65.0,
            2.0,
            (6.0, 9.0),
            (12.0, 138.0),
            (12.0, 110.0),
            29.0,
            0.5,
            0.0,
            3.0,
            60.0,
            0.5,
            0.25,
        ),
        (0.3, 1.0),
    ),
)


class Drawn(NamedTuple):
    """A hull on a day."""

    hull: Published
    dead: tuple[float, float]  # starboard, port
    push: tuple[float, float]
    power: float
    delay_s: float
    lag_s: float
    swapped: bool
    reversed: tuple[bool, bool]  # by row, starboard's first
    current: tuple[float, float]
    wind: tuple[float, float]
    heading_rad: float


def drawn(hull: int, seed: int) -> Drawn:
    """The hull of this number, from 0, on the day of this seed."""
    of_hull, day = Random(f"another hull {hull}"), Random(f"another day {hull} {seed}")

    def about(value: float, by: float = 1.4) -> float:
        return value * float(by ** of_hull.uniform(-1.0, 1.0))

    its = PUBLISHED[hull % len(PUBLISHED)]
    if hull >= len(PUBLISHED):
        pairs = [(about(first), about(second)) for first, second in (its.surge, its.sway, its.yaw)]
        m33 = about(its.m33, 3.0)
        its = its._replace(m33=m33, surge=pairs[0], sway=pairs[1], yaw=pairs[2], yaw_ahead=about(its.yaw_ahead), m23=0.0)
    dead = of_hull.uniform(0.0, 0.15), of_hull.uniform(0.0, 0.15)
    push = its.push_n, its.push_n * of_hull.uniform(0.85, 1.15)
    motors = dead, push, of_hull.uniform(1.3, 2.0), of_hull.uniform(0.0, 0.5), of_hull.uniform(0.1, 0.4)
    wired = day.random() < 0.5, (day.random() < 0.5, day.random() < 0.5)
    flows = [
        (speed * math.cos(to), speed * math.sin(to))
        for speed, to in (
            (day.uniform(0.0, 0.3), day.uniform(0.0, math.tau)),
            (day.uniform(0.0, 4.0), day.uniform(0.0, math.tau)),
        )
    ]
    return Drawn(its, *motors, *wired, flows[0], flows[1], day.uniform(0.0, math.tau))


class Craft:
    """A hull that moves: north, east, heading, and velocities through the water along and across the keel, and of turn."""

    def __init__(self, its: Drawn, seed: int = 0) -> None:
        self.its, self._random, self._gust = its, Random(f"gusts {seed}"), [0.0, 0.0]
        self.now_s = self.north_m = self.east_m = self.u = self.v = self.r = 0.0
        self.heading_rad = its.heading_rad
        self._told, self._parts, self._turns = deque[tuple[float, tuple[float, float]]](), (0.0, 0.0), [0.0, 0.0]

    def tell(self, starboard: float, port: float) -> None:
        """Commands of both rows of the file, from now on."""
        parts = [-each if back else each for each, back in zip((starboard, port), self.its.reversed, strict=True)]
        if self.its.swapped:
            parts.reverse()
        self._told.append((self.now_s + self.its.delay_s, (parts[0], parts[1])))

    def move(self, until_s: float) -> None:
        while self.now_s < until_s - 1e-9:
            self._step(min(STEP_S, until_s - self.now_s))

    def _step(self, dt_s: float) -> None:
        its, hull = self.its, self.its.hull
        while self._told and self._told[0][0] <= self.now_s + 1e-9:
            self._parts = self._told.popleft()[1]
        x = n = 0.0
        for side in (0, 1):
            self._turns[side] += (self._parts[side] - self._turns[side]) * (1.0 - math.exp(-dt_s / its.lag_s))
            part, dead = self._turns[side], its.dead[side]
            share = max((abs(part) - dead) / (1.0 - dead), 0.0) ** its.power
            push = its.push[side] * (share if part > 0.0 else -hull.astern * share)
            x, n = x + push, n + (1 - 2 * side) * -hull.aside_m * push
        y = 0.0
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        air_u, air_v, air_n = self._air(c, s, dt_s)
        x, y, n = x + air_u, y + air_v, n + air_n
        u, v, r = self.u, self.v, self.r
        x += (hull.m22 * v + hull.m23 * r) * r - (hull.surge[0] + hull.surge[1] * abs(u)) * u
        y -= hull.m11 * u * r + (hull.sway[0] + hull.sway[1] * abs(v)) * v
        n -= (hull.m22 - hull.m11) * u * v * hull.munk + hull.m23 * u * r
        n -= (hull.yaw[0] + hull.yaw[1] * abs(r) + hull.yaw_ahead * abs(u)) * r
        for strip in range(8) if hull.draught_m else ():
            at_m = ((strip + 0.5) / 8 - 0.5) * hull.length_m
            across = v + at_m * r
            drag = 0.5 * WATER * hull.draught_m * abs(across) * across * hull.length_m / 8
            y, n = y - drag, n - at_m * drag
        both = hull.m22 * hull.m33 - hull.m23 * hull.m23
        self.u += dt_s * x / hull.m11
        self.v += dt_s * (hull.m33 * y - hull.m23 * n) / both
        self.r += dt_s * (hull.m22 * n - hull.m23 * y) / both
        north, east = self.over_ground(c, s)
        self.north_m, self.east_m = self.north_m + dt_s * north, self.east_m + dt_s * east
        self.heading_rad += dt_s * self.r
        self.now_s += dt_s

    def _air(self, c: float, s: float, dt_s: float) -> tuple[float, float, float]:
        """Forces of the wind, whose gusts last some seconds."""
        its, hull = self.its, self.its.hull
        speed = math.hypot(*its.wind)
        keep = math.exp(-dt_s / 5.0)
        new = 0.15 * speed * math.sqrt(1.0 - keep * keep)
        self._gust = [keep * each + self._random.gauss(0.0, new) for each in self._gust]
        north, east = (
            wind + gust - over for wind, gust, over in zip(its.wind, self._gust, self.over_ground(c, s), strict=True)
        )
        along, across = north * c + east * s, east * c - north * s
        q = 0.5 * AIR * math.hypot(along, across)
        frontal, lateral = hull.wind_m2
        return q * 0.7 * frontal * along, q * 0.8 * lateral * across, -0.1 * AIR * lateral * hull.length_m * along * across

    def over_ground(self, c: float, s: float) -> tuple[float, float]:
        north, east = self.its.current
        return north + self.u * c - self.v * s, east + self.u * s + self.v * c

    def state(self) -> dict[str, float]:
        north, east = self.over_ground(math.cos(self.heading_rad), math.sin(self.heading_rad))
        place = {
            "time_s": self.now_s,
            "north_m": self.north_m,
            "east_m": self.east_m,
            "heading_rad": self.heading_rad % math.tau,
        }
        return place | {"north_mps": north, "east_mps": east, "yaw_rate_radps": self.r}


def full_mps(its: Drawn) -> float:
    """Its speed in calm water with all power ahead."""
    craft = Craft(its._replace(current=(0.0, 0.0), wind=(0.0, 0.0)))
    its = craft.its._replace(swapped=False, reversed=(False, False), delay_s=0.0)
    craft.its = its
    craft.tell(1.0, 1.0)
    craft.move(80.0)
    return craft.u


def main(port: int, hull: int, seed: int) -> None:
    """Speak with the simulator until it is silent for ten seconds."""
    its = drawn(hull, seed)
    craft = Craft(its, seed)
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.connect(("127.0.0.1", port))
    link.settimeout(10.0)
    link.send(json.dumps(craft.state()).encode())
    while True:
        try:
            answer: dict[str, Any] = json.loads(link.recv(4096))
        except OSError:
            return
        if answer["next_s"] == 0.0:
            craft = Craft(its, seed)
        else:
            rows = list(answer["thrusters"].values())
            craft.tell(rows[0]["command"], rows[1]["command"])
            craft.move(answer["next_s"])
        link.send(json.dumps(craft.state()).encode())


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]))
