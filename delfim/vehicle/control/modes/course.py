"""Course: steers a course over ground at a speed, so that current and wind do not carry the boat aside.

The heading is the course less the measured angle between the two, as in guidance. Below `guidance.COURSE_MPS` ahead over ground
that angle means nothing: the boat then steers the course as a heading, and finds the angle when it moves again.
"""

from delfim.base.geodesy import wrap
from delfim.vehicle.control.autopilot import entered, steer
from delfim.vehicle.control.guidance import course_to_steer
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

NEEDS = frozenset({"heading", "velocity"})
SENTENCE = "Steers a course over ground at a speed."


def lacks(setpoint: Setpoint) -> str | None:
    return None


def enter(motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    return Memory(entered(motion))


def step(
    memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float
) -> tuple[Memory, Reference, Wanted]:
    asked_rad = setpoint.heading_rad
    course, heading_rad = course_to_steer(memory.course, motion, asked_rad, 0.0, settings.control.path, dt_s)
    integrals, wanted = steer(memory.integrals, motion, heading_rad, setpoint.speed_mps, settings, dt_s)
    reference = Reference(wrap(heading_rad), setpoint.speed_mps, course_rad=asked_rad)
    return Memory(integrals, course, *memory[2:]), reference, wanted
