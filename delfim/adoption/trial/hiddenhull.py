"""A boat that is not as its file says: for trying out adoption. Hull, motors, wiring, delay and sea are drawn from a seed."""

import math
from collections import deque
from random import Random
from typing import Final, NamedTuple

import msgspec

from delfim import config
from delfim.config import ThrusterTable
from delfim.simulator.model import Hull, Model, hull_of
from delfim.simulator.tables import Sea, Simulation

STEP_S: Final = 0.05  # a late command comes within one


class Hidden(NamedTuple):
    """What was drawn."""

    hull: Hull
    rows: tuple[ThrusterTable, ...]  # what the motors do that the rows of the file reach
    swapped: bool
    reversed: tuple[bool, ...]
    delay_s: float
    sea: Sea
    heading_rad: float

    def words(self) -> str:
        """The truth, in a line."""
        back = [row.name for row, is_so in zip(self.rows, self.reversed, strict=True) if is_so]
        wired = ("exchanged, " if self.swapped else "") + (f"reversed: {' and '.join(back)}" if back else "none reversed")
        dead = ", ".join(f"{row.dead:.2f}" for row in self.rows)
        wind, current = self.sea.wind_mps, self.sea.current_mps
        return f"{wired}; dead band {dead}; delay {self.delay_s:.2f} s; wind {wind:.1f}, current {current:.2f} m/s"


def drawn(settings: config.Vehicle, seed: int) -> Hidden:
    """A boat near that of the file: coefficients up to 40 % off, inertia by up to three times, its two motors wired anyhow."""
    random = Random(f"hidden hull {seed}")

    def about(value: float, by: float = 1.4) -> float:
        return value * float(by ** random.uniform(-1.0, 1.0))

    told = hull_of(settings)
    hull = told._replace(
        mass_kg=about(told.mass_kg, 1.2),
        inertia_kgm2=about(told.inertia_kgm2, 3.0),
        surge_n_per_mps=about(told.surge_n_per_mps),
        surge_n_per_mps2=about(told.surge_n_per_mps2),
        sway_n_per_mps=about(told.sway_n_per_mps),
        sway_n_per_mps2=about(told.sway_n_per_mps2),
        yaw_nm_per_radps=about(told.yaw_nm_per_radps),
        yaw_nm_per_radps2=about(told.yaw_nm_per_radps2),
        motor_s=random.uniform(0.1, 0.4),
    )
    is_swapped = random.random() < 0.5
    backwards = tuple(random.random() < 0.5 for _ in settings.thrusters)
    dead, power, push = random.uniform(0.0, 0.15), random.uniform(1.3, 2.0), random.uniform(0.7, 1.3)
    rows = list[ThrusterTable]()
    for index, row in enumerate(settings.thrusters):
        at = settings.thrusters[::-1][index] if is_swapped else row
        ahead_n = row.ends_n[1] * push * random.uniform(0.9, 1.1)
        astern_n = ahead_n * random.uniform(0.4, 0.7)
        is_back = backwards[index]  # what its file calls ahead pushes astern, with the strength that it has astern
        ends_n = (-ahead_n, astern_n) if is_back else (-astern_n, ahead_n)
        changed = {"thrust_n": ends_n, "angle_deg": 180.0 if is_back else 0.0, "curve": (), "dead": dead, "power": power}
        rows.append(msgspec.structs.replace(row, y_m=at.y_m, **changed))
    there = settings.of(Simulation).sea
    sea = msgspec.structs.replace(
        there,
        current_mps=random.uniform(0.0, 0.3),
        current_to_deg=random.uniform(0.0, 360.0),
        wind_mps=random.uniform(0.0, 4.0),
        wind_from_deg=random.uniform(0.0, 360.0),
    )
    return Hidden(hull, tuple(rows), is_swapped, backwards, random.uniform(0.0, 0.5), sea, random.uniform(0.0, math.tau))


class LateModel(Model):
    """The model of a hidden boat, whose motors hear their commands late."""

    def __init__(self, settings: config.Vehicle, hidden: Hidden, seed: int) -> None:
        there = settings.of(Simulation)
        place = math.radians(there.latitude_deg), math.radians(there.longitude_deg)
        super().__init__(hidden.hull, hidden.sea, seed, *place, hidden.heading_rad, hidden.rows)
        self._delay_s, self._late = hidden.delay_s, deque[tuple[float, str, float, bool]]()

    def command(self, name: str, rpm: float, run: bool) -> None:
        self._late.append((self.time_s + self._delay_s, name, rpm, run))

    def advance(self, dt_s: float) -> None:
        steps = max(1, math.ceil(dt_s / STEP_S - 1e-9))
        for _ in range(steps):
            while self._late and self._late[0][0] <= self.time_s + 1e-9:
                _, name, rpm, run = self._late.popleft()
                super().command(name, rpm, run)
            super().advance(dt_s / steps)
