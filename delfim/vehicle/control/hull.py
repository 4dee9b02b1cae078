"""The hull as control needs it, guessed where nobody measured it, and the autopilot's gains that follow from it.

The guesses are an engineer's, and right within a factor of two for boats of 1 to 8 m: mass from length and beam of catamarans
that people own (BlueBoat, Heron, Otter), inertia from a bar with its added mass (T. I. Fossen, Handbook of Marine Craft
Hydrodynamics and Motion Control, 2011, 6.5 and 7.5), damping from the time that a boat of that length needs to pass its own
length. Closed loops forgive that much (docs/propulsion.md shows how much); what is known is better stated.
"""

import math
from typing import Final, NamedTuple

import msgspec

from delfim import config
from delfim.vehicle.control.allocation import Allocation, thruster

KG_PER_M2: Final = 20.0  # mass of a light boat per length times beam
GYRATION: Final = 0.465  # radius of gyration in yaw, added mass included, per length
ADDED: Final = 1.05  # mass with its added mass in surge, per mass
DAMPING: Final = 10.0  # N m per rad/s, for the cube of the length: against a turn at cruising speed
TURN_RADPS: Final = 0.15  # of a usual turn, where the damping's square is known
FROUDE: Final = 0.45  # speed at full thrust, per root of g times length, at most
NATURAL_RADPS: Final = 0.83  # of the heading, for a boat of 4.5 m; a shorter one is quicker, up to the next
NATURAL_RADPS_MAX: Final = 1.0  # at a navigation rate of 5 Hz, with motors that need 0.3 s
NATURAL_M: Final = 4.5
DAMPED: Final = 1.2  # of critical
OWN: Final = 0.5  # of the damping of the heading, at least, is the autopilot's own: the water's is a guess
LEAST_RATE: Final = 0.3  # of natural frequency times inertia: the least gain against a rate of turn
SPEED_PER_S: Final = 0.8  # of the speed's loop, per mass
AUTHORITY: Final = 0.75  # of the most yaw moment, that a heading error may ask for
AGE_S: Final = 0.07  # of a heading when it is used, beyond half a period of navigation
LAG_S: Final = 0.3  # time constant of a motor that nobody measured
SIDEWAYS: Final = 0.8, 0.6, 0.4, 0.2  # of the most surge: a boat that gives less to the side has no sway
AT_ONCE_S: Final = 1.0  # it must give that within this time, from where everything points ahead
PURE: Final = 0.01  # of that force, which may be missing, or come ahead or as a moment at a metre


class Craft(NamedTuple):
    """The hull in the water, as control sees it."""

    mass_kg: float  # with added mass, in surge
    inertia_kgm2: float  # with added mass, in yaw
    damping_nm_per_radps: float  # against a rate of turn, at cruising speed
    drag_n_per_mps: float  # ahead, and ...
    drag_n_per_mps2: float  # ... with the square of the speed
    ahead_n: float  # most surge, of the sound boat at rest
    turn_nm: float  # most yaw moment to either side, of the sound boat at rest
    aside_n: float  # sway to either side without surge and yaw, of the sound boat at rest; 0: it cannot push sideways
    late_s: float = 0.0  # from a command until the heading tells of it
    astern_n: float = 0.0  # most surge astern, of the sound boat at rest


class Gains(NamedTuple):
    """The autopilot's gains, named and meant as in `control.heading` and `control.speed` of the vehicle's file."""

    p_nm_per_rad: float
    p_limit_nm: float
    d_nm_per_radps: float
    turn_nm_per_radps: float
    i_nm_per_rad_s: float
    i_limit_nm: float
    p_n_per_mps: float
    i_n_per_m: float
    i_limit_n: float


def craft(vehicle: config.Vehicle) -> Craft:
    """The hull of a vehicle's file. Without a drag it is what full thrust overcomes at `boat.full_mps`, which then holds the
    propellers' loss of thrust, too."""
    boat, thrusters = vehicle.boat, Allocation([thruster(row) for row in vehicle.thrusters])
    mass_kg = KG_PER_M2 * boat.length_m * boat.beam_m if boat.mass_kg is None else boat.mass_kg
    inertia_kgm2 = mass_kg * (GYRATION * boat.length_m) ** 2 if boat.inertia_kgm2 is None else boat.inertia_kgm2
    ahead_n = thrusters.surge_n[1]
    if boat.drag_n_per_mps is None and boat.drag_n_per_mps2 is None:
        linear, square = 0.0, ahead_n / full_mps(boat) ** 2
    else:
        linear, square = boat.drag_n_per_mps or 0.0, boat.drag_n_per_mps2 or 0.0
    damping = DAMPING * boat.length_m**3
    if boat.yaw_nm_per_radps is not None:
        damping = boat.yaw_nm_per_radps + TURN_RADPS * (boat.yaw_nm_per_radps2 or 0.0)
    forces = ahead_n, thrusters.yaw_nm, _aside_n(thrusters)
    return Craft(ADDED * mass_kg, inertia_kgm2, damping, linear, square, *forces, _late_s(vehicle), -thrusters.surge_n[0])


def _late_s(vehicle: config.Vehicle) -> float:
    rows = vehicle.thrusters
    motors_s = sum(row.delay_s + (LAG_S if row.lag_s is None else row.lag_s) for row in rows) / len(rows)
    return motors_s + 0.5 / vehicle.navigation.rate_hz + AGE_S


def full_mps(boat: config.BoatTable) -> float:
    """The file's, or a guess: no boat without planing is much faster, for the waves that it makes."""
    return FROUDE * math.sqrt(9.81 * boat.length_m) if boat.full_mps is None else boat.full_mps


def _aside_n(thrusters: Allocation) -> float:
    """The sway of a boat whose thrusters give it without the boat turning or gathering way."""
    ahead, nothing = [0.0] * len(thrusters.thrusters), (0.0, 0.0, 0.0)
    for part in SIDEWAYS:
        sway_n = part * thrusters.surge_n[1]
        short = [thrusters.allocate(0.0, each, 0.0, ahead, AT_ONCE_S)[2] or nothing for each in (sway_n, -sway_n)]
        if max(abs(missing) for each in short for missing in each) <= PURE * sway_n:
            return sway_n
    return 0.0


def gains(vehicle: config.Vehicle, hull: Craft) -> Gains:
    """The gains of a vehicle's file, and where it gives none those that follow from the hull: a heading of second order,
    over-damped because the damping is a guess, and a speed that answers within two seconds."""
    natural = min(NATURAL_RADPS * math.sqrt(NATURAL_M / vehicle.boat.length_m), NATURAL_RADPS_MAX)
    inertia, damping = hull.inertia_kgm2, hull.damping_nm_per_radps
    total = max(2.0 * DAMPED * natural * inertia, damping + LEAST_RATE * natural * inertia)  # of the water and of control
    p_nm = total * natural / (2.0 * DAMPED)
    limit_nm = min(p_nm, AUTHORITY * hull.turn_nm)
    surge = SPEED_PER_S * hull.mass_kg
    derived = Gains(
        p_nm_per_rad=p_nm,
        p_limit_nm=limit_nm,
        d_nm_per_radps=max(total - damping, OWN * total),
        turn_nm_per_radps=damping,
        i_nm_per_rad_s=p_nm / 23.0,
        i_limit_nm=0.22 * limit_nm,
        p_n_per_mps=surge,
        i_n_per_m=0.25 * surge,
        i_limit_n=0.5 * hull.ahead_n,
    )
    tables = vehicle.control.heading, vehicle.control.speed
    given = {name: each for table in tables for name in Gains._fields if (each := getattr(table, name, None)) is not None}
    return derived._replace(**given)


def filled(vehicle: config.Vehicle) -> config.Vehicle:
    """The vehicle's file with every gain, so that it can be told and changed while the boat sails."""
    told, replace, control = gains(vehicle, craft(vehicle))._asdict(), msgspec.structs.replace, vehicle.control
    heading, speed = (
        replace(table, **{name: each for name, each in told.items() if hasattr(table, name)})
        for table in (control.heading, control.speed)
    )
    return replace(vehicle, control=replace(control, heading=heading, speed=speed))
