"""An inertial navigation system in simulation: a receiver and a compass of the simulator, told in the protocol of the file."""

import math
from typing import Final

from delfim import config
from delfim.parts.ins.insmessages import InsState
from delfim.parts.ins.languages import LANGUAGES
from delfim.parts.ins.table import InsTable
from delfim.simulator.model import Model
from delfim.simulator.nodes.measuring import Compass, GnssReceiver, Turn
from delfim.simulator.nodes.navigation import FIX
from delfim.simulator.tables import Simulation

STATED_M: Final = 0.5  # of a simulated receiver without noise
SQRT2: Final = math.sqrt(2.0)  # two axes


class PlayedIns:
    """The system. Its receiver and its compass may be broken by faults."""

    def __init__(self, settings: config.Vehicle, model: Model, seed: int) -> None:
        here = settings.of(Simulation)
        self.receiver, self.compass = GnssReceiver(model, here, seed, "ins"), Compass(model, here, seed, "ins")
        self._told, self._model = LANGUAGES[settings.of(InsTable).speaks].told, model
        self._deviation_rad = math.radians(max(here.heading_noise_deg, 0.1))
        self._turn: Turn | None = None

    @property
    def due_s(self) -> float:
        return min(self.receiver.due_s, self.compass.due_s)

    def step(self, now_s: float) -> InsState | None:
        """What it knows when its receiver has a position; a silent compass makes its heading unsure."""
        turn = self.compass.step(now_s)
        self._turn = None if self.compass.silent else turn or self._turn
        moved = self.receiver.step(now_s)
        if moved is None:
            return None
        heading_rad, rate_radps = self._turn or (0.0, 0.0)
        return InsState(
            0,
            (moved.latitude_rad, moved.longitude_rad),
            (self.receiver.stated_m or STATED_M) * SQRT2,
            (moved.north_mps, moved.east_mps),
            heading_rad % math.tau,
            math.pi if self._turn is None else self._deviation_rad,
            rate_radps,
            (0.0, 0.0),
            FIX,
            self.receiver.satellites,
        )

    def say(self, state: InsState, utc_ns: int) -> bytes:
        return self._told(state._replace(utc_ns=utc_ns))


def instrument_of(settings: config.Vehicle, model: Model, seed: int) -> PlayedIns:
    return PlayedIns(settings, model, seed)
