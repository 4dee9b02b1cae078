"""The memory and the settings of the modes. All of it immutable: state goes in and comes out."""

from typing import NamedTuple

from delfim import config


class Settings(NamedTuple):
    """The tables of the vehicle's file that control obeys."""

    control: config.ControlTable
    propulsion: config.PropulsionTable
    dsor: config.Dsor


class Integrals(NamedTuple):
    """The autopilot's memory."""

    heading_rpm: float = 0.0
    speed_rpm: float = 0.0
    speed_mps: float = 0.0  # speed asked for, after the ramp


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
