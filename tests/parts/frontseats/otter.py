"""Fossen's model of the Maritime Robotics Otter, as he publishes it with his numbers: T. I. Fossen, Handbook of Marine Craft
Hydrodynamics and Motion Control, 2nd edition, 2021, and his PythonVehicleSimulator. Written here from the equations, in the
horizontal plane: roll, pitch and heave are left out. It moves a `closed_loop.Boat` in place of the simulator's model.
"""

import math
from typing import Final

import msgspec

from delfim.config import BoatTable, ThrusterTable, Vehicle
from delfim.simulator.tables import Sea
from tests.vehicle.closed_loop import DELFIMX

LENGTH_M, BEAM_M, PONTOON_M, PONTOON_BEAM_M = 2.0, 1.08, 0.395, 0.25
HULL_KG, PAYLOAD_KG = 55.0, 25.0
HULL_X_M, PAYLOAD_X_M = 0.2, 0.05  # centres of gravity ahead of the middle
BLOCK, WATER, G = 0.4, 1025.0, 9.81
SURGE_ADDED, SWAY_ADDED, YAW_ADDED = 0.1, 1.5, 1.7  # of the hull's mass, and of its inertia
FULL_MPS, YAW_S = 6.0 * 0.5144, 1.0
AHEAD, ASTERN = 0.02216 / 2.0, 0.01289 / 2.0  # N per (rad/s)^2 of each propeller
AHEAD_N, ASTERN_N = 0.5 * 24.4 * G, 0.5 * 13.6 * G  # most of each
MOTOR_S = 0.1
CROSS_FLOW = 1.0  # drag coefficient of Hoerner for pontoons of that breadth and draught
STRIPS = 20
STEP_S = 0.02

TOTAL_KG: Final = HULL_KG + PAYLOAD_KG
CENTRE_M: Final = (HULL_KG * HULL_X_M + PAYLOAD_KG * PAYLOAD_X_M) / TOTAL_KG
HULL_KGM2: Final = HULL_KG * ((0.25 * LENGTH_M) ** 2 + CENTRE_M**2) + PAYLOAD_KG * PAYLOAD_X_M**2
INERTIA_KGM2: Final = HULL_KGM2 + TOTAL_KG * CENTRE_M**2
M11: Final = TOTAL_KG + SURGE_ADDED * HULL_KG
M22: Final = TOTAL_KG + SWAY_ADDED * HULL_KG
M23: Final = TOTAL_KG * CENTRE_M
M33: Final = INERTIA_KGM2 + YAW_ADDED * HULL_KGM2
DRAUGHT_M: Final = TOTAL_KG / WATER / (2.0 * BLOCK * PONTOON_BEAM_M * LENGTH_M)

DESCRIBED: Final[Vehicle] = msgspec.structs.replace(
    DELFIMX,  # no gains, of either
    boat=BoatTable(name="Otter", length_m=LENGTH_M, beam_m=BEAM_M, mass_kg=TOTAL_KG, full_mps=3.1),
    thrusters=tuple(
        ThrusterTable(name=name, driver="dsor", address=address, y_m=y_m, thrust_n=(-66.7, 119.7), rate_per_s=5.0)
        for address, (name, y_m) in enumerate((("starboard", PONTOON_M), ("port", -PONTOON_M)))
    ),
)


class Otter:
    """Velocities are through the water but for `north_mps` and `east_mps`."""

    def __init__(self, sea: Sea, heading_rad: float = 0.0) -> None:
        self.north_m = self.east_m = 0.0
        self.heading_rad = heading_rad
        self.surge_mps = self.sway_mps = self.yaw_rate_radps = 0.0
        to = math.radians(sea.current_to_deg)
        self._current = sea.current_mps * math.cos(to), sea.current_mps * math.sin(to)
        self._asked, self._turns = {"starboard": 0.0, "port": 0.0}, {"starboard": 0.0, "port": 0.0}  # rad/s

    def command(self, side: str, rpm: float, run: bool) -> None:
        """In parts of `dsor.rpm_max`, which is full command."""
        part = rpm / DELFIMX.dsor.rpm_max if run else 0.0
        full = math.sqrt(AHEAD_N / AHEAD) if part > 0.0 else math.sqrt(ASTERN_N / ASTERN)
        self._asked[side] = part * full

    def advance(self, dt_s: float) -> None:
        for _ in range(round(dt_s / STEP_S)):
            self._step()

    @property
    def north_mps(self) -> float:
        return self.surge_mps * math.cos(self.heading_rad) - self.sway_mps * math.sin(self.heading_rad) + self._current[0]

    @property
    def east_mps(self) -> float:
        return self.surge_mps * math.sin(self.heading_rad) + self.sway_mps * math.cos(self.heading_rad) + self._current[1]

    def _step(self) -> None:
        u, v, r = self.surge_mps, self.sway_mps, self.yaw_rate_radps
        forces = {}
        for side, asked in self._asked.items():
            self._turns[side] += (asked - self._turns[side]) * STEP_S / MOTOR_S
            n = self._turns[side]
            forces[side] = (AHEAD if n > 0.0 else ASTERN) * n * abs(n)
        sway_n, yaw_nm = self._cross_flow(v, r)
        damping = M33 / YAW_S
        # The Coriolis forces of the rigid body; those of the added mass, with the Munk moment, he neglects.
        x = forces["starboard"] + forces["port"] - 24.4 * G / FULL_MPS * u + (TOTAL_KG * v + M23 * r) * r
        y = sway_n - TOTAL_KG * u * r
        z = (
            PONTOON_M * (forces["port"] - forces["starboard"])
            - damping * r
            - 10.0 * damping * abs(r) * r
            + yaw_nm
            - M23 * u * r
        )
        determinant = M22 * M33 - M23 * M23
        self.surge_mps += STEP_S * x / M11
        self.sway_mps += STEP_S * (M33 * y - M23 * z) / determinant
        self.yaw_rate_radps += STEP_S * (M22 * z - M23 * y) / determinant
        self.north_m += STEP_S * self.north_mps
        self.east_m += STEP_S * self.east_mps
        self.heading_rad = (self.heading_rad + STEP_S * self.yaw_rate_radps) % math.tau

    def _cross_flow(self, v: float, r: float) -> tuple[float, float]:
        """Strips along the hull."""
        sway_n = yaw_nm = 0.0
        for strip in range(STRIPS):
            x = ((strip + 0.5) / STRIPS - 0.5) * LENGTH_M
            across = v + x * r
            drag_n = -0.5 * WATER * DRAUGHT_M * CROSS_FLOW * abs(across) * across * LENGTH_M / STRIPS
            sway_n, yaw_nm = sway_n + drag_n, yaw_nm + x * drag_n
        return sway_n, yaw_nm
