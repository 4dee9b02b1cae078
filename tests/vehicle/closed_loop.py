"""Model and control in one loop, without bus, clock or messages: what control tests and the figures of docs/control.md use."""

import math
import random
from collections.abc import Iterator
from typing import NamedTuple

from delfim.config import ControlTable, Propulsion, Sea, Simulation
from delfim.geodesy import Origin, origin
from delfim.simulator.model import Hull, Model
from delfim.vehicle.control.control import MODES, Settings, admit, control, enter, limited
from delfim.vehicle.safe import STOP
from delfim.vehicle.state import Actuation, Mode, Motion, Reference, Setpoint

SETTINGS = Settings(ControlTable(), Propulsion())
ALL = frozenset({"position", "heading", "velocity"})
DT_S = 0.2
START: Origin = origin(math.radians(Simulation().latitude_deg), math.radians(Simulation().longitude_deg))


class Sample(NamedTuple):
    """One cycle: true state, what control saw and answered."""

    t_s: float
    mode: Mode
    north_m: float
    east_m: float
    heading_rad: float
    speed_mps: float
    motion: Motion
    reference: Reference
    actuation: Actuation


class Boat:
    """A boat at sea: `sail` runs a mode and yields a sample each 200 ms; `done` goes to hold, as the loop does."""

    def __init__(
        self, seed: int = 1, sea: Sea | None = None, heading_rad: float = 0.0, settings: Settings = SETTINGS, noise: float = 1.0
    ) -> None:
        self.settings, self.noise = settings, noise
        self.model = Model(Hull(), sea or Sea(), seed, START.latitude_rad, START.longitude_rad, heading_rad)
        self.random = random.Random(seed)
        self.t_s = 0.0
        self.sent = STOP
        self.has = ALL

    def motion(self) -> Motion:
        """What the sensors say: position noise 0.3 m, heading 0.5 degrees, speed 0.03 m/s, rate of turn 0.2 degrees/s."""
        gauss, model = self.random.gauss, self.model
        position, velocity, turn = 0.3 * self.noise, 0.03 * self.noise, math.radians(self.noise)
        return Motion(
            self.has,
            model.north_m + gauss(0.0, position),
            model.east_m + gauss(0.0, position),
            model.heading_rad + gauss(0.0, 0.5 * turn),
            model.yaw_rate_radps + gauss(0.0, 0.2 * turn),
            model.north_mps + gauss(0.0, velocity),
            model.east_mps + gauss(0.0, velocity),
        )

    def sail(self, mode: Mode, setpoint: Setpoint, seconds: float) -> Iterator[Sample]:
        motion = self.motion()
        assert admit(mode, motion.has, setpoint) is None
        memory = enter(mode, motion, setpoint, self.settings)
        for _ in range(round(seconds / DT_S)):
            memory, reference, wanted = control(mode, memory, motion, setpoint, self.settings, DT_S)
            self.sent = limited(wanted, self.sent, self.settings.propulsion, DT_S)
            yield self.sample(mode, motion, reference)
            if reference.done:
                mode = Mode.HOLD
                memory = enter(mode, motion, setpoint, self.settings)
            self.model.command("starboard", self.sent.starboard_rpm, self.sent.run)
            self.model.command("port", self.sent.port_rpm, self.sent.run)
            self.model.advance(DT_S)
            self.t_s += DT_S
            motion = self.motion()

    def sample(self, mode: Mode, motion: Motion, reference: Reference) -> Sample:
        model = self.model
        speed_mps = math.hypot(model.north_mps, model.east_mps)
        return Sample(
            self.t_s, mode, model.north_m, model.east_m, model.heading_rad, speed_mps, motion, reference, self.sent
        )


def rms(values: list[float]) -> float:
    return math.sqrt(sum(value * value for value in values) / len(values))


__all__ = ["ALL", "DT_S", "MODES", "SETTINGS", "START", "Boat", "Sample", "rms"]
