"""The memory and the settings of the modes. All of it immutable: state goes in and comes out."""

from typing import NamedTuple

from delfim import config
from delfim.vehicle.control.hull import Craft, Gains, craft, gains

_new = tuple.__new__


class Settings(NamedTuple):
    """The settings of control: the tables of the vehicle's file, and the gains and the hull that follow from them."""

    control: config.ControlTable
    gains: Gains
    hull: Craft


def settings_of(vehicle: config.Vehicle) -> Settings:
    hull = craft(vehicle)
    return Settings(vehicle.control, gains(vehicle, hull), hull)


class Integrals(NamedTuple):
    """The autopilot's memory."""

    yaw_nm: float = 0.0
    surge_n: float = 0.0
    speed_mps: float = 0.0  # speed asked for, after the ramp
    yaw_short_nm: float = 0.0  # of the last step: asked for minus what the thrusters give
    surge_short_n: float = 0.0
    sway_n: float = 0.0
    sway_short_n: float = 0.0


class LineOfSight(NamedTuple):
    """The guidance's memory."""

    crab_rad: float = 0.0  # course over ground minus heading, smoothed
    shift_m: float = 0.0  # offset that the integral adds to the cross-track error


class Memory(NamedTuple):
    """One shape for all modes; a mode uses what it needs and leaves the rest alone."""

    integrals: Integrals = Integrals()
    course: LineOfSight = LineOfSight()
    north_m: float = 0.0  # where the present leg began; the point that hold keeps
    east_m: float = 0.0
    leg: int = 0
    swept_rad: float = 0.0  # of the present arc
    driving: int = 0  # hold: 0 rests, 1 comes back ahead, -1 astern
    left_s: float = 0.0  # play: of the time at the waypoint of the present leg, once it is reached
    heading_rad: float | None = None  # that hold keeps while it rests, or that of a turn's reference; None: the present one
    room: float = 1.0  # part of the radius of hold that the fence leaves at the point
    turn_radps: float = 0.0  # of a turn's reference
    line_m: float = 0.0  # path: left of the straight piece that the boat is on, or from where on it goes back to it


def lacking(memory: Memory, short: tuple[float, float, float]) -> Memory:
    """The memory after a step whose surge, sway and yaw the thrusters could not give: integrals wait."""
    surge_short_n, sway_short_n, yaw_short_nm = short
    yaw_nm, surge_n, speed_mps, _, _, sway_n, _ = memory[0]
    integrals = _new(Integrals, (yaw_nm, surge_n, speed_mps, yaw_short_nm, surge_short_n, sway_n, sway_short_n))
    return _new(Memory, (integrals, *memory[1:]))  # a fifth of the time of _replace: this is on the critical path
