"""The model of a boat whose hull was measured (`[simulation.hull]`), and of one whose motors are late (`delay_s`).

Each force of the water has a number of its own here, found by a fit; the model of DelfimX derives them from masses and lift.
"""

import math
from collections import deque
from typing import Any, Final

from delfim import config
from delfim.simulator.model import Hull, Model, Push, hull_of
from delfim.simulator.propulsor import curve_of
from delfim.simulator.tables import SimulatedHull, Simulation

AT_ONCE_S: Final = 1e-9


class MeasuredModel(Model):
    """The simulator's model with the measured hull, if there is one, and motors that obey some time after a command."""

    def __init__(self, settings: config.Vehicle, measured: SimulatedHull, *rest: Any) -> None:
        """`rest` is that of `Model`."""
        super().__init__(hull_of(settings), *rest)
        self._late_s = {row.name: row.delay_s for row in settings.thrusters}
        self._waiting = deque[tuple[float, str, float, bool]]()  # commands, by the time when they are obeyed
        self._turning = deque[tuple[float, str, float]]()  # the same of angles
        self._measured = measured if measured.mass_kg else None
        if self._measured is not None:
            self._water = (
                1.0,
                1.0,
                1.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
                0.0,
            )  # no water: what is left is thrust and wind
            for row, drive in zip(settings.thrusters, self.drives.values(), strict=True):
                drive.curve = curve_of(row)
                drive.rpm_max = settings.rpm_max(row) or drive.rpm_max

    def push(self, name: str, part: float, angle_rad: float = 0.0, run: bool = True) -> None:
        """Set a thruster; what turns it obeys after the delay of its motor."""
        drive = self.drives[name]
        if run and drive.row.steer is not None and math.isfinite(angle_rad):
            self._turning.append((self.time_s + self._late_s[name], name, angle_rad))
        self.command(name, part * drive.rpm_max, run)

    def command(self, name: str, rpm: float, run: bool) -> None:
        """Set the reference of a thruster's motor controller, which obeys after its delay."""
        self._waiting.append((self.time_s + self._late_s[name], name, rpm, run))
        self._obey()

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` pass, in pieces between which motors begin to obey."""
        end_s = self.time_s + dt_s
        while self._waiting and (due_s := min(self._waiting)[0]) < end_s - AT_ONCE_S:  # angles come with commands
            super().advance(due_s - self.time_s)
            self._obey()
        super().advance(end_s - self.time_s)
        self._obey()

    def _obey(self) -> None:
        for each in [each for each in self._waiting if each[0] <= self.time_s + AT_ONCE_S]:
            self._waiting.remove(each)
            super().command(*each[1:])
        while self._turning and self._turning[0][0] <= self.time_s + AT_ONCE_S:
            _, name, angle_rad = self._turning.popleft()
            self.drives[name].reference_rad = angle_rad

    def _accelerations(
        self, u: float, v: float, r: float, c: float, s: float, pushes: list[Push], air: tuple[float, float] | None
    ) -> tuple[float, float, float]:
        its = self._measured
        if its is None:
            return super()._accelerations(u, v, r, c, s, pushes, air)
        surge_n, sway_n, yaw_nm = super()._accelerations(u, v, 0.0, c, s, self._kept(u, pushes), air)
        ahead = abs(u)
        surge_n += its.mass_turning_kg * v * r - (its.surge_n_per_mps + its.surge_n_per_mps2 * ahead) * u
        sway_n -= its.mass_kg * u * r + its.sway_yaw_n_per_radps * r
        sway_n -= (its.sway_n_per_mps + its.sway_n_per_mps2 * abs(v) + its.sway_ahead_n_per_mps2 * ahead) * v
        yaw_nm -= (its.yaw_nm_per_radps + its.yaw_nm_per_radps2 * abs(r) + its.yaw_ahead_nm_s_per_m * ahead) * r
        yaw_nm -= its.munk_nm_per_mps2 * u * v
        return surge_n / its.mass_kg, sway_n / its.mass_aside_kg, yaw_nm / its.inertia_kgm2

    def _kept(self, u: float, pushes: list[Push]) -> list[Push]:
        """The thrusters' forces, less what the way ahead takes from one that pushes ahead."""
        loss = self._measured.thrust_loss_s_per_m * u if self._measured is not None else 0.0
        kept = list[Push]()
        for (drive, _), (y, force, bollard, less) in zip(self._arms, pushes, strict=True):
            if force is not None and force[0] > 0.0:
                left = max(1.0 - loss * abs(drive.part) * drive.row.ends_n[1] / force[0], 0.0)
                force = left * force[0], left * force[1], left * force[2]
            kept.append((y, force, bollard, less))
        return kept


def measured(hull: Hull) -> SimulatedHull:
    """The numbers of the simulator's own hull, as [simulation.hull] has them: the same way in calm air. A turn under way sheds
    cross-flow astern, which takes a part of the force that pushes her aside; the numbers have all of that force, so that
    everything aside is as much larger. Only wind from abeam, which has its own numbers, then moves her less."""
    ahead_kg, aside_kg = hull.mass_kg + hull.added_surge_kg, hull.mass_kg + hull.added_sway_kg
    larger = ahead_kg / (ahead_kg - hull.lift_kg_per_m * hull.lift_m)
    return SimulatedHull(
        mass_kg=ahead_kg,
        mass_aside_kg=larger * aside_kg,
        mass_turning_kg=aside_kg,
        inertia_kgm2=hull.inertia_kgm2 + hull.added_yaw_kgm2,
        surge_n_per_mps=hull.surge_n_per_mps,
        surge_n_per_mps2=hull.surge_n_per_mps2,
        sway_n_per_mps=larger * hull.sway_n_per_mps,
        sway_n_per_mps2=larger * hull.sway_n_per_mps2,
        sway_ahead_n_per_mps2=larger * hull.lift_kg_per_m,
        yaw_nm_per_radps=hull.yaw_nm_per_radps,
        yaw_nm_per_radps2=hull.yaw_nm_per_radps2,
        yaw_ahead_nm_s_per_m=hull.lift_kg_per_m * hull.lift_m**2,
        munk_nm_per_mps2=aside_kg - ahead_kg - hull.lift_kg_per_m * hull.lift_m,
    )


def model_of(settings: config.Vehicle, seed: int) -> Model:
    """The model that a vehicle's file describes."""
    there = settings.of(Simulation)
    start = math.radians(there.latitude_deg), math.radians(there.longitude_deg), math.radians(there.heading_deg)
    rest = there.sea, seed, *start, settings.thrusters
    if there.hull.mass_kg or any(row.delay_s for row in settings.thrusters):
        return MeasuredModel(settings, there.hull, *rest)
    return Model(hull_of(settings), *rest)
