"""A Ping echo sounder over the bed of the simulated sea. It sends each ping from the start on, as one that was asked."""

from random import Random

from delfim import config
from delfim.parts.ping.pingframes import PingDistance, told
from delfim.parts.ping.table import PingTable
from delfim.simulator.model import Model
from delfim.simulator.nodes.measuring import DEPTH_NOISE
from delfim.simulator.nodes.period import Period
from delfim.simulator.seabed import Echoes
from delfim.simulator.tables import Simulation

SURE, DOUBTFUL = (0.9, 1.0), (0.1, 0.45)  # confidence of echoes of the bottom, and of others


class PlayedPing:
    """The sounder, whose transducer is at the water line."""

    def __init__(self, settings: config.Vehicle, model: Model, seed: int) -> None:
        here = settings.of(Simulation)
        self._model, self._random, self._echoes = model, Random(f"ping {seed}"), Echoes(here, seed, "ping")
        self._noise, self._due = DEPTH_NOISE if here.noise else 0.0, Period(1.0 / settings.of(PingTable).rate_hz)
        self._number = 0

    @property
    def due_s(self) -> float:
        return self._due.due_s

    def step(self, now_s: float) -> PingDistance | None:
        if not self._due.passed(now_s):
            return None
        deep_m, self._number = self._model.depth_m, self._number + 1
        heard_m = self._echoes.heard(deep_m)
        confidence = self._random.uniform(*(SURE if heard_m == deep_m else DOUBTFUL))
        return PingDistance(max(heard_m * (1.0 + self._random.gauss(0.0, self._noise)), 0.0), confidence, self._number)

    def say(self, ping: PingDistance, utc_ns: int) -> bytes:
        return told(ping)


def instrument_of(settings: config.Vehicle, model: Model, seed: int) -> PlayedPing:
    return PlayedPing(settings, model, seed)
