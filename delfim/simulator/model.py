"""The boat, the sea and the wind of the simulator: surge, sway and yaw of a hull with its thrusters (thesis 2.13, 3.6).

Equations: Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2011: rigid body and added mass with velocity
through the water in an irrotational current of constant speed (8.3), wind (8.1.2), bilinear thruster. `docs/simulator.md`
writes them out, says how to describe another hull, and shows what the numbers give.

Not modelled: waves as a force (roll and pitch are for show), shallow water, wind shadow, ropes, running aground.
"""

import math
from collections.abc import Sequence
from random import Random
from typing import Final, Literal, NamedTuple

from delfim.base.geodesy import from_plane, origin
from delfim.base.parts import OWN_NODES
from delfim.config import DELFIMX, ThrusterTable, Vehicle
from delfim.simulator.propulsor import AMBIENT_C, VOLTAGE_V, W_PER_N, Drive
from delfim.simulator.seabed import SeaBed
from delfim.simulator.tables import Sea
from delfim.vehicle.control.hull import full_mps

Side = Literal["starboard", "port"]  # the thrusters of DelfimX

STEP_S: Final = 0.1  # longest integration step; `advance` divides longer times
WATER: Final = 1025.0  # kg/m3
AIR: Final = 1.225  # kg/m3
GUST_S: Final = 5.0  # time constant of the wind's changes, as the VRX simulator has it
DEPTH_M: Final = 12.0  # of the water without a bed
BANK_M: Final = 15.0  # radius of a bank
LENGTH_M, BEAM_M, MASS_KG = 4.5, 2.45, 210.0  # of DelfimX


class Hull(NamedTuple):
    """A twin-propeller catamaran. The defaults describe the WAM-V 16 class, the size of DelfimX.

    VRX      wamv_base.urdf, wamv_gazebo_dynamics_plugin.xacro and wamv_aft_thrusters.xacro of the VRX simulator
             (Bingham et al., "Toward Maritime Robotic Simulation in Gazebo", OCEANS 2019)
    strip    strip theory for two floating semicircular hulls, 4 m long in the water (Newman, Marine Hydrodynamics, 1977)
    Fossen   middle of the range that Fossen 2011, 8.1.2 gives
    assumed  an engineer's guess that gives the documented behaviour; no source
    """

    length_m: float = 4.9  # VRX
    mass_kg: float = 210.0  # VRX: 180 of the boat and 15 of each engine
    inertia_kgm2: float = 650.0  # VRX: 446 about the vertical, and the engines where they hang
    added_surge_kg: float = 10.0  # assumed: 5 % of the mass
    added_sway_kg: float = 200.0  # strip: the displaced mass
    added_yaw_kgm2: float = 270.0  # strip
    surge_n_per_mps: float = 51.3  # VRX xU
    surge_n_per_mps2: float = 72.4  # VRX xUU
    sway_n_per_mps: float = 40.0  # VRX yV
    sway_n_per_mps2: float = 500.0  # strip: cross-flow drag, coefficient 1 on the side of both hulls
    yaw_nm_per_radps: float = 400.0  # VRX nR
    yaw_nm_per_radps2: float = 500.0  # strip: cross-flow drag of the turning hulls
    lift_kg_per_m: float = 50.0  # strip: added mass per length where the hulls end; slender-body lift
    lift_m: float = 2.0  # strip: from the centre of gravity to that end
    propeller_m: float = 1.03  # VRX: from the centre line to each propeller
    propeller_diameter_m: float = 0.25  # assumed, as all of the propellers: 1,000 rpm drive the boat at about 2 m/s
    thrust: float = 0.35  # thrust coefficient at rest ...
    thrust_per_j: float = 0.35  # ... and its loss per advance ratio
    torque: float = 0.045
    torque_per_j: float = 0.03
    astern: float = 0.6  # fraction of the thrust left astern
    hull_efficiency: float = 0.95  # wake and thrust deduction
    rpm_max: float = 1400.0  # limit of the motor controller
    rpm_per_s_max: float = 1000.0  # assumed
    motor_s: float = 0.3  # assumed: time constant of the motor under control
    coast_s: float = 0.8  # assumed: of the motor without current
    motor_efficiency: float = 0.85  # assumed
    idle_a: float = 0.5  # assumed: drawn by the electronics of each side
    capacity_ah: float = 200.0  # assumed: of each side's batteries
    frontal_m2: float = 1.2  # assumed; with its coefficient 0.5 N/(m/s)2, as VRX has it
    lateral_m2: float = 1.8  # assumed
    wind_surge: float = 0.7  # Fossen
    wind_sway: float = 0.8  # Fossen
    wind_yaw: float = 0.1  # Fossen


def hull_of(vehicle: Vehicle) -> Hull:
    """The default hull, which is that of DelfimX, scaled to the size of the vehicle's file: forces and masses by Froude's law
    from length and mass. The drag ahead is that of the file where it gives one."""
    boat, same = vehicle.boat, Hull()
    long = boat.length_m / LENGTH_M
    heavy = boat.length_m * boat.beam_m / (LENGTH_M * BEAM_M) if boat.mass_kg is None else boat.mass_kg / MASS_KG
    side, root = math.sqrt(heavy * long), math.sqrt(long)  # its area under water, and the speed of like motion
    arms = [abs(row.y_m) for _, row in vehicle.driven("nodes")]
    hull = Hull(
        length_m=boat.length_m,
        mass_kg=same.mass_kg * heavy,
        inertia_kgm2=same.inertia_kgm2 * heavy * long**2,
        added_surge_kg=same.added_surge_kg * heavy,
        added_sway_kg=same.added_sway_kg * heavy,
        added_yaw_kgm2=same.added_yaw_kgm2 * heavy * long**2,
        surge_n_per_mps=same.surge_n_per_mps * side * root,
        surge_n_per_mps2=same.surge_n_per_mps2 * side,
        sway_n_per_mps=same.sway_n_per_mps * side * root,
        sway_n_per_mps2=same.sway_n_per_mps2 * side,
        yaw_nm_per_radps=same.yaw_nm_per_radps * side * root * long**2,
        yaw_nm_per_radps2=same.yaw_nm_per_radps2 * side * long**3,
        lift_kg_per_m=same.lift_kg_per_m * heavy / long,
        lift_m=same.lift_m * long,
        propeller_m=max(arms, default=same.propeller_m),
        frontal_m2=same.frontal_m2 * long**2,
        lateral_m2=same.lateral_m2 * long**2,
        motor_s=lag_s(vehicle, same.motor_s),
        capacity_ah=_capacity_ah(vehicle, same.capacity_ah),
    )
    return _dragged(hull, vehicle)


def _capacity_ah(vehicle: Vehicle, otherwise_ah: float) -> float:
    """Of the batteries of each thruster, where the file says what all hold together."""
    whole_wh: float = getattr(vehicle.table("energy"), "capacity_wh", 0.0)
    return whole_wh / VOLTAGE_V / len(vehicle.thrusters) if whole_wh else otherwise_ah


def lag_s(vehicle: Vehicle, otherwise_s: float) -> float:
    """The time constant of the motors, the mean of those that the file knows."""
    known = [row.lag_s for row in vehicle.thrusters if row.lag_s is not None]
    return sum(known) / len(known) if known else otherwise_s


def _dragged(hull: Hull, vehicle: Vehicle) -> Hull:
    """The hull with the drag ahead of the file, or with that which full thrust overcomes at the file's speed, or at the
    autopilot's default speed; a fifth of it linear. This does not hold for the propellers of DelfimX, which lose thrust with
    speed."""
    boat = vehicle.boat
    if boat.drag_n_per_mps is not None or boat.drag_n_per_mps2 is not None:
        return hull._replace(surge_n_per_mps=boat.drag_n_per_mps or 0.0, surge_n_per_mps2=boat.drag_n_per_mps2 or 0.0)
    if vehicle.driven("nodes"):
        return hull
    ahead_n = sum(max(row.ends_n[1] * math.cos(math.radians(row.angle_deg)), 0.0) for row in vehicle.thrusters)
    most_mps = full_mps(boat)
    return hull._replace(surge_n_per_mps=0.2 * ahead_n / most_mps, surge_n_per_mps2=0.8 * ahead_n / most_mps**2)


Push = tuple[float, tuple[float, float, float] | None, float, float]
"""Of a thruster in a step: its place to starboard of the middle, m; surge N, sway N and yaw Nm where the water's speed means
nothing; for a propeller of DelfimX None, its thrust coefficients at rest and their loss per m/s of speed ahead."""


FOULED: Final = 3.0  # times the current of a propeller that turns freely


class Bank(NamedTuple):
    """A round shoal, BANK_M about its middle."""

    north_m: float
    east_m: float
    depth_m: float


class Model:
    """The world of one boat. `command` the motor controllers, `advance` the time, read the attributes.

    It starts adrift: without motion through the water. The same hull, sea, seed, commands and steps give the same bytes.
    """

    def __init__(
        self,
        hull: Hull,
        sea: Sea,
        seed: int,
        latitude_rad: float,
        longitude_rad: float,
        heading_rad: float,
        rows: Sequence[ThrusterTable] = DELFIMX,
    ) -> None:
        self.hull = hull
        self.drives = {row.name: Drive(row, hull.rpm_max, hull.rpm_per_s_max) for row in rows}
        arms = [math.copysign(hull.propeller_m, row.y_m) if row.driver == OWN_NODES else row.y_m for row in rows]
        self._arms = list(zip(self.drives.values(), arms, strict=True))  # m to starboard of the middle
        self._motors = hull.motor_s, hull.coast_s, hull.idle_a, 3600.0 * hull.capacity_ah
        self._propeller = hull.thrust * hull.propeller_diameter_m, hull.thrust_per_j, hull.astern
        self._torque = (
            *(hull.propeller_diameter_m, WATER * hull.propeller_diameter_m**4, hull.torque, hull.torque_per_j),
            hull.motor_efficiency * VOLTAGE_V,
        )
        self._water = (  # of a mass, and of what the water does to the hull
            *(hull.mass_kg + hull.added_surge_kg, hull.mass_kg + hull.added_sway_kg, hull.inertia_kgm2 + hull.added_yaw_kgm2),
            *(hull.surge_n_per_mps, hull.surge_n_per_mps2, hull.sway_n_per_mps, hull.sway_n_per_mps2),
            *(hull.yaw_nm_per_radps, hull.yaw_nm_per_radps2, hull.lift_kg_per_m, -hull.lift_m),
            WATER * hull.propeller_diameter_m**3 * hull.hull_efficiency,
        )
        self._wind = (
            *(hull.wind_surge, hull.frontal_m2, hull.wind_sway, hull.lateral_m2),
            AIR * hull.wind_yaw * hull.lateral_m2 * hull.length_m,
        )
        self.origin = origin(latitude_rad, longitude_rad)
        self.time_s = 0.0
        self.north_m = self.east_m = 0.0  # from where it started
        self.bed: SeaBed | None = None
        self.bank: Bank | None = None
        self.weeds_s = 0.0  # weeds hold the hull until it was pulled astern for so long; 0: none do
        self.heel_rad = 0.0  # of a boat that has capsized
        self.heading_rad = heading_rad % math.tau  # 0..2 pi, true north
        self.surge_mps = self.sway_mps = 0.0  # through the water, positive ahead and to starboard
        self.yaw_rate_radps = 0.0  # positive to starboard
        to, wind_to = math.radians(sea.current_to_deg), math.radians(sea.wind_from_deg) + math.pi
        self.current_north_mps, self.current_east_mps = sea.current_mps * math.cos(to), sea.current_mps * math.sin(to)
        self._mean_north_mps, self._mean_east_mps = sea.wind_mps * math.cos(wind_to), sea.wind_mps * math.sin(wind_to)
        self._gust_mps = sea.wind_mps * sea.gusts
        self._random = Random(seed)
        self._gust_north_mps = self._random.gauss(0.0, self._gust_mps)
        self._gust_east_mps = self._random.gauss(0.0, self._gust_mps)
        # Waves for the eye: half a degree in a calm, eight in a gale, of periods that such a catamaran has.
        self._wave_rad = 0.009 + 0.006 * sea.wind_mps
        self._roll_phase, self._pitch_phase = self._random.uniform(0.0, math.tau), self._random.uniform(0.0, math.tau)

    @property
    def depth_m(self) -> float:
        """The depth of the water here, m: on the bank, else over the bed, else the same everywhere."""
        bank, bed = self.bank, self.bed
        if bank is not None and math.hypot(self.north_m - bank.north_m, self.east_m - bank.east_m) <= BANK_M:
            return bank.depth_m
        return DEPTH_M if bed is None else bed.depth_at(self.latitude_rad, self.longitude_rad, self.time_s)

    def command(self, name: str, rpm: float, run: bool) -> None:
        """Set the reference of a thruster's motor controller, which limits it. NaN is motor off."""
        drive = self.drives[name]
        drive.run = run and math.isfinite(rpm)
        most = drive.rpm_max
        drive.reference_rpm = 0.0 if not drive.run else rpm if -most <= rpm <= most else math.copysign(most, rpm)

    def push(self, name: str, part: float, angle_rad: float = 0.0, run: bool = True) -> None:
        """Set a thruster to -1..1 of full command, with the angle of one that turns, as drivers command it. Without `run` it
        stays where it points."""
        drive = self.drives[name]
        if run and drive.row.steer is not None and math.isfinite(angle_rad):
            drive.reference_rad = angle_rad
        self.command(name, part * drive.rpm_max, run)

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` pass, in equal steps of at most STEP_S."""
        steps = max(1, math.ceil(dt_s / STEP_S - 1e-9))
        h = dt_s / steps
        self._gust(dt_s)
        air = self._air()
        for _ in range(steps):
            pushes = self._pushing(h)
            if self.weeds_s:
                self._stay(h, pushes)
            else:
                self._move(h, pushes, air)
        self.time_s += dt_s

    @property
    def alive(self) -> bool:
        """Whether there is something to measure: False while a model in another program has sent nothing new."""
        return True

    def taken(self) -> None:
        """Note that navigation was made from the present state."""

    @property
    def starboard(self) -> Drive:
        """The starboard propeller of DelfimX."""
        return self.drives["starboard"]

    @property
    def port(self) -> Drive:
        return self.drives["port"]

    @property
    def north_mps(self) -> float:
        """Velocity over ground to the north, m/s."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return self.surge_mps * c - self.sway_mps * s + self.current_north_mps

    @property
    def east_mps(self) -> float:
        """Velocity over ground to the east, m/s."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return self.surge_mps * s + self.sway_mps * c + self.current_east_mps

    @property
    def latitude_rad(self) -> float:
        return from_plane(self.origin, self.north_m, self.east_m)[0]

    @property
    def longitude_rad(self) -> float:
        return from_plane(self.origin, self.north_m, self.east_m)[1]

    @property
    def wind_north_mps(self) -> float:
        """Velocity of the air over ground to the north, m/s, with the present gust."""
        return self._mean_north_mps + self._gust_north_mps

    @property
    def wind_east_mps(self) -> float:
        return self._mean_east_mps + self._gust_east_mps

    @property
    def roll_rad(self) -> float:
        return self.heel_rad + self._wave_rad * math.sin(2.1 * self.time_s + self._roll_phase)

    @property
    def pitch_rad(self) -> float:
        return 0.5 * self._wave_rad * math.sin(2.9 * self.time_s + self._pitch_phase)

    def _gust(self, dt_s: float) -> None:
        """Advance the gust, whose components are first-order Gauss-Markov processes; exact for any step."""
        if self._gust_mps:
            keep = math.exp(-dt_s / GUST_S)
            new = self._gust_mps * math.sqrt(1.0 - keep * keep)
            self._gust_north_mps = keep * self._gust_north_mps + self._random.gauss(0.0, new)
            self._gust_east_mps = keep * self._gust_east_mps + self._random.gauss(0.0, new)

    def _air(self) -> tuple[float, float] | None:
        """Velocity of the water through the air, north and east, m/s; None: no wind blows, and that of a current does not
        count."""
        if not (self._gust_mps or self._mean_north_mps or self._mean_east_mps):
            return None
        north_mps = self.current_north_mps - self._mean_north_mps - self._gust_north_mps
        return north_mps, self.current_east_mps - self._mean_east_mps - self._gust_east_mps

    def _turn(self, drive: Drive, h: float) -> float:
        """Advance a motor, its steering, and their load on the batteries; returns the mean rpm of the step."""
        if drive.row.steer is not None:
            drive.turn(h)
        motor_s, coast_s, idle_a, capacity_as = self._motors
        before_rpm, powered, motor_a = drive.rpm, drive.connected and drive.charge > 0.0, 0.0
        driven, reference_rpm = drive.run and powered, drive.reference_rpm
        if drive.fault is not None:
            driven, reference_rpm = drive.failing()
        if driven:
            step, most = (reference_rpm - before_rpm) * (1.0 - math.exp(-h / motor_s)), drive.rpm_per_s_max * h
            drive.rpm = rpm = before_rpm + (step if -most <= step <= most else math.copysign(most, step))
            motor_a = (
                self._motor_a(rpm) if drive.curve is None else W_PER_N * abs(drive.curve.force(rpm / drive.rpm_max)) / VOLTAGE_V
            )
        else:
            drive.rpm = rpm = before_rpm * math.exp(-h / coast_s)
        if drive.fault == "fouled":
            motor_a *= FOULED
        drive.motor_a = motor_a
        drive.current_a = current_a = motor_a + idle_a if powered else 0.0
        left = drive.charge - current_a * h / capacity_as
        drive.charge = left if left > 0.0 else 0.0
        drive.temperature_c += (AMBIENT_C + 0.01 * motor_a * motor_a - drive.temperature_c) * h / 300.0
        return 0.5 * (before_rpm + rpm)

    def _motor_a(self, rpm: float) -> float:
        """The current into the motor of a propeller of DelfimX at these revolutions, A."""
        d, water, torque, per_j, voltage_v = self._torque
        n, ahead_mps = abs(rpm) / 60.0, math.copysign(self.surge_mps, self.surge_mps * rpm)
        torque_nm = water * n * (torque * n * d - per_j * ahead_mps)
        return torque_nm * math.tau * n / voltage_v if torque_nm > 0.0 else 0.0

    def _pushing(self, h: float) -> list[Push]:
        """Run the motors for a step; returns the forces that push the boat then."""
        pushes: list[Push] = []
        thrust, per_j, astern = self._propeller
        for drive, y in self._arms:
            rpm = self._turn(drive, h)
            if drive.curve is None:
                n = rpm / 60.0
                bollard = thrust * n * abs(n) * (1.0 if n > 0.0 else astern)
                pushes.append((y, None, bollard, per_j * abs(n)))
            else:
                x_n, y_n = drive.push_n(rpm / drive.rpm_max)
                pushes.append((y, (x_n, y_n, drive.row.x_m * y_n - y * x_n), 0.0, 0.0))
        return pushes

    def _move(self, h: float, pushes: list[Push], air: tuple[float, float] | None) -> None:
        """Advance the hull by one step of the midpoint rule (second-order Runge-Kutta)."""
        u, v, r, heading = self.surge_mps, self.sway_mps, self.yaw_rate_radps, self.heading_rad
        half = 0.5 * h
        du, dv, dr = self._accelerations(u, v, r, math.cos(heading), math.sin(heading), pushes, air)
        um, vm, rm, at = u + half * du, v + half * dv, r + half * dr, heading + half * r
        c, s = math.cos(at), math.sin(at)
        du, dv, dr = self._accelerations(um, vm, rm, c, s, pushes, air)
        self.surge_mps, self.sway_mps, self.yaw_rate_radps = u + h * du, v + h * dv, r + h * dr
        self.heading_rad = (heading + h * rm) % math.tau
        self.north_m += h * (um * c - vm * s + self.current_north_mps)
        self.east_m += h * (um * s + vm * c + self.current_east_mps)

    def _stay(self, h: float, pushes: list[Push]) -> None:
        """Weeds hold the hull for a step, and give when it is pulled astern."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        self.surge_mps = -self.current_north_mps * c - self.current_east_mps * s
        self.sway_mps = self.current_north_mps * s - self.current_east_mps * c
        self.yaw_rate_radps = 0.0
        if sum([bollard if force is None else force[0] for _, force, bollard, _ in pushes]) < 0.0:
            self.weeds_s = max(self.weeds_s - h, 0.0)

    def _accelerations(
        self, u: float, v: float, r: float, c: float, s: float, pushes: list[Push], air: tuple[float, float] | None
    ) -> tuple[float, float, float]:
        """Accelerations of surge, sway and yaw, for velocities through the water. `c` and `s`: the heading's cosine and sine.
        Letters are those of Fossen 2011."""
        m11, m22, m66, surge, surge2, sway, sway2, yaw, yaw2, a, x, thrust = self._water
        surge_n = sway_n = yaw_nm = 0.0
        for y, force, bollard, loss in pushes:
            if force is None:
                push_n = thrust * (bollard - loss * (u - y * r))
                surge_n += push_n
                yaw_nm -= y * push_n
            else:
                surge_n += force[0]
                sway_n += force[1]
                yaw_nm += force[2]
        # A slender body sheds its cross-flow where it ends: astern of the water that it meets.
        abs_u = abs(u)
        surge_n = surge_n - (surge + surge2 * abs_u) * u + m22 * v * r
        sway_n = sway_n - (sway + sway2 * abs(v)) * v - a * (abs_u * v + x * u * r) - m11 * u * r
        yaw_nm -= (yaw + yaw2 * abs(r)) * r
        yaw_nm -= a * (x * u * v + x * x * abs_u * r) + (m22 - m11) * u * v
        if air is not None:
            (north, east), (ahead, frontal_m2, aside, lateral_m2, turn) = air, self._wind
            ua, va = u + north * c + east * s, v + east * c - north * s  # through the air
            q = 0.5 * AIR * math.hypot(ua, va)
            surge_n -= q * ahead * frontal_m2 * ua
            sway_n -= q * aside * lateral_m2 * va
            yaw_nm -= turn * ua * va
        return surge_n / m11, sway_n / m22, yaw_nm / m66
