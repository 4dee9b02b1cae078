"""A cycle of a boat in lock step, as its invariants see it: the boat before it, and after it."""

from collections.abc import Iterator
from typing import Final, NamedTuple, Protocol

from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.state import Actuation, Reference, Setpoint, State

NOTHING: Final = 0.0, 0.0, 0.0


class Before(NamedTuple):
    """The boat at the beginning of a cycle, after the last orders."""

    now_s: float
    mode: Mode
    mode_s: float
    reason: str
    setpoint: Setpoint
    memory: Memory
    reference: Reference
    sent: Actuation
    sent_s: float
    short: tuple[float, float, float]  # surge N, sway N, yaw N m that the thrusters could not give
    cycles: int
    navigation_s: float
    order: object  # of the guard, who steers then
    shaped: bool  # others than the mode have a hand in its steps
    handed: object  # the boat's program; a restart makes another


def before(run: Lockstep) -> Before:
    state, vehicle = run.state, run.vehicle
    helm, sends = vehicle.helm, vehicle.propulsion
    return Before(
        run.elapsed_s,
        state.mode,
        state.mode_s,
        state.reason,
        state.setpoint,
        helm.memory,
        state.reference,
        state.actuation,
        sends.sent_s,
        sends.short or NOTHING,
        state.cycles,
        state.navigation_s,
        state.traffic.order,
        bool(helm.shapes),
        vehicle,
    )


class CycleSeen:
    """One cycle, or, if `is_order`, the first step of a mode, which is done as soon as its order is obeyed. `steered`: the
    cycle had one message of navigation, and the boat is in the mode that it was in."""

    __slots__ = ("dt_s", "is_order", "memory", "now_s", "run", "state", "steered", "was")

    def __init__(self, run: Lockstep, was: Before, *, is_order: bool = False) -> None:
        state, self.run, self.was, self.is_order = run.state, run, was, is_order
        self.state: State = state
        self.now_s = was.now_s  # the clock is advanced at its end
        self.memory = run.vehicle.helm.memory
        self.dt_s = was.now_s - was.sent_s  # since control and propulsion were asked last
        is_same = (
            run.vehicle is was.handed and state.mode is was.mode and state.reason == was.reason and state.mode_s == was.mode_s
        )
        is_heard = state.cycles == was.cycles + 1 and state.navigation_s == was.now_s
        is_steady = was.now_s - was.navigation_s < 0.4 and self.dt_s <= 1.0 and state.traffic.order is was.order is None
        is_steady = is_steady and not (was.shaped or run.vehicle.helm.shapes)
        self.steered = is_steady and ("position" in state.motion.has if is_order else is_same and is_heard)


class Invariant(Protocol):
    """A rule; `look` after a cycle returns what is wrong, in words."""

    def look(self, cycle: CycleSeen) -> Iterator[str]: ...
