"""The control multiplexer (control.c in the thesis), the one door by which a mode is entered. Pure functions: no input, no
output, no clock, no wait.
"""

import math
from importlib import import_module
from typing import Final, Protocol, cast

from delfim.base.modes import OF_PARTS, Mode
from delfim.vehicle.control.memory import Memory, Settings, lacking, settings_of
from delfim.vehicle.control.safe import STOP
from delfim.vehicle.state import Motion, Reference, Setpoint, Wanted

__all__ = ["MODES", "Memory", "Settings", "Stepped", "admit", "control", "enter", "lacking", "settings_of"]

FAR_M = 1e7  # a plane position beyond this is nonsense, and so are the numbers below
FAST_MPS = 100.0
SPIN = 1e3  # rad and rad/s
NONSENSE: Final = "set point makes no sense"
Stepped = tuple[Memory, Reference, Wanted]  # a step of a mode: its memory after it, where it is going, its command


class Program(Protocol):
    """The names that a mode's file provides."""

    NEEDS: frozenset[str]  # of "position", "heading", "velocity"
    SENTENCE: str  # for the operator

    def lacks(self, setpoint: Setpoint) -> str | None:
        """The value that the mode needs and the set point does not have, in words; None: nothing is missing."""

    def enter(self, motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory: ...

    def step(self, memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float) -> Stepped: ...


class PartError(ValueError):
    """A mode of a laboratory's part that cannot go on; the text is the reason."""


class ModePrograms(dict[Mode, Program]):
    """Of the modes. One of the boat's own is loaded when it is asked for first."""

    def __missing__(self, mode: Mode) -> Program:
        self[mode] = program = cast(Program, import_module(f"{__package__}.modes.{mode.name.lower()}"))
        return program

    def load(self) -> None:
        """Load all of the boat's own, before it sails: nothing is imported under way."""
        for mode in Mode:
            if mode not in OF_PARTS:
                self[mode]


MODES: Final = ModePrograms()


def admit(mode: Mode, has: frozenset[str], setpoint: Setpoint) -> str | None:
    """The one door: None when the mode may be entered and kept, otherwise why not, in words for a tired operator."""
    program = MODES[mode]
    if not has >= program.NEEDS:
        missing, known = " and no ".join(sorted(program.NEEDS - has)), " and ".join(sorted(has))
        return f"no {missing}: {known} only" if known else f"no {missing}"
    return program.lacks(setpoint)


def enter(mode: Mode, motion: Motion, setpoint: Setpoint, settings: Settings) -> Memory:
    """A mode's memory at its beginning. Never raises: the first step reports implausible inputs."""
    try:
        return MODES[mode].enter(motion, setpoint, settings) if _plausible(motion) else Memory()
    except (ValueError, ArithmeticError):
        return Memory()


def control(mode: Mode, memory: Memory, motion: Motion, setpoint: Setpoint, settings: Settings, dt_s: float) -> Stepped:
    """One step of a mode, `dt_s` after the one before. Missing inputs and numbers without meaning stop the propellers, leave
    the memory as it was, and say why in the reference.
    """
    reason = admit(mode, motion.has, setpoint)
    if reason is None and not (_plausible(motion) and 0.0 <= dt_s < FAR_M):
        reason = "navigation makes no sense"
    if reason is not None:
        return memory, Reference(reason=reason), STOP
    try:
        after, reference, wanted = MODES[mode].step(memory, motion, setpoint, settings, dt_s)
    except (
        ValueError,
        ArithmeticError,
    ) as error:  # an infinite set point; to fail here would leave the propellers as they were
        return memory, Reference(reason=str(error) if isinstance(error, PartError) else NONSENSE), STOP
    if not math.isfinite(wanted.surge_n + wanted.sway_n + wanted.yaw_nm):
        return memory, Reference(reason=NONSENSE), STOP
    return after, reference, wanted


def _plausible(motion: Motion) -> bool:
    """False also for a value that is not finite: every comparison with it is false."""
    _, north_m, east_m, heading_rad, yaw_rate_radps, north_mps, east_mps = motion
    return (
        -FAR_M < north_m < FAR_M
        and -FAR_M < east_m < FAR_M
        and -SPIN < heading_rad < SPIN
        and -SPIN < yaw_rate_radps < SPIN
        and -FAST_MPS < north_mps < FAST_MPS
        and -FAST_MPS < east_mps < FAST_MPS
    )
