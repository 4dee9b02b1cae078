"""The navigation node: position, velocity and attitude (thesis figure 3-2)."""

import math
from random import Random
from typing import Final, NamedTuple

from delfim import config
from delfim.base.frames import Frame
from delfim.base.geodesy import from_plane, wrap
from delfim.canproxy.dsor.messages import NAVIGATION_ID, NAVIGATION_PRIORITY, Navigation, Node, pack_navigation
from delfim.canproxy.dsor.protocol import Message, message_filter, segments
from delfim.canproxy.socket import CanAddress
from delfim.simulator.model import Model
from delfim.simulator.nodes.period import Period
from delfim.simulator.tables import Simulation

POSITION_ERROR_S: Final = 60.0  # correlation time of a satellite receiver's error
YAW_RATE_NOISE_RADPS: Final = math.radians(0.2)
FIX, SATELLITES, HDOP = 3, 10, 0.9
MESSAGES: Final = CanAddress(*message_filter(source=Node.NAVIGATION))  # all frames of its messages
_ADDRESSED: Final = NAVIGATION_PRIORITY, Node.NAVIGATION, Node.BROADCAST, NAVIGATION_ID
_FORGED: Final = NAVIGATION_PRIORITY + 1, Node.NAVIGATION, Node.BROADCAST, NAVIGATION_ID  # behind it on the bus
_new = tuple.__new__  # a third of the time of Message(...)


class Noise(NamedTuple):
    """Standard deviations of the navigation node."""

    position_m: float  # per axis, of an error that wanders
    heading_rad: float  # white
    speed_mps: float  # per axis, white
    yaw_rate_radps: float = YAW_RATE_NOISE_RADPS  # white


class NavigationNode:
    """Position, velocity and attitude with the errors of sensors, as a broadcast segmented message."""

    hears = ()

    def __init__(self, model: Model, rate_hz: float, noise: Noise, seed: int) -> None:
        self._model, self._noise = model, noise
        self._random = Random(f"navigation {seed}")
        self._period = Period(1.0 / rate_hz)
        self._keep = math.exp(-1.0 / (rate_hz * POSITION_ERROR_S))
        self._north_m = self._random.gauss(0.0, noise.position_m)
        self._east_m = self._random.gauss(0.0, noise.position_m)
        self._counter = 0
        self.silent = False
        self.jump_m = 0.0  # error of the position, to the north
        self.satellites = SATELLITES
        self.frozen = False  # the sensors repeat their values
        self.forged_rad = 0.0  # another one sends each message again, with a heading that is turned by so much; 0: nobody
        self.repeating = False  # the node sends its last message again and again
        self.is_heard = True  # False: no socket of the bus takes its messages, so that it makes none
        self._said: Navigation | None = None

    @property
    def due_s(self) -> float:
        return self._period.due_s if self._model.alive else math.inf

    def feed(self, frame: Frame, now_s: float) -> None:
        """Ignore the frame."""

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        if not self._model.alive or not self._period.passed(now_s):
            return []
        self._model.taken()
        if self.silent or not self.is_heard:
            return []
        said = self._said
        if said is None or not (self.frozen or self.repeating):
            said = self.measured(utc_ns)
            if self.jump_m and said.latitude_rad is not None:
                said = said._replace(latitude_rad=said.latitude_rad + self.jump_m / self._model.origin.north_m_per_rad)
        elif not self.repeating:
            said = said._replace(utc_ns=utc_ns, counter=self._counter)
        self._said = said
        data = pack_navigation(said)
        self._counter += 1
        frames = segments(_new(Message, (*_ADDRESSED, data, 0, None, None)), self._counter)
        if self.forged_rad and said.heading_rad is not None:
            forged = said._replace(heading_rad=said.heading_rad + self.forged_rad, utc_ns=utc_ns + 1)
            frames += segments(_new(Message, (*_FORGED, pack_navigation(forged), 0, None, None)), self._counter)
        return frames

    def measured(self, utc_ns: int) -> Navigation:
        """The sensors' values. The position's error is a first-order Gauss-Markov process, as a receiver's is."""
        model, noise, gauss = self._model, self._noise, self._random.gauss
        new_m = noise.position_m * math.sqrt(1.0 - self._keep * self._keep)
        self._north_m = self._keep * self._north_m + gauss(0.0, new_m)
        self._east_m = self._keep * self._east_m + gauss(0.0, new_m)
        origin = model.origin
        latitude_rad, longitude_rad = from_plane(origin, model.north_m, model.east_m)
        values = (
            utc_ns,
            latitude_rad + self._north_m / origin.north_m_per_rad,
            wrap(longitude_rad + self._east_m / origin.east_m_per_rad),
            model.north_mps + gauss(0.0, noise.speed_mps),
            model.east_mps + gauss(0.0, noise.speed_mps),
            model.heading_rad + gauss(0.0, noise.heading_rad),
            model.yaw_rate_radps + gauss(0.0, noise.yaw_rate_radps),
            model.roll_rad,
            model.pitch_rad,
            FIX,
            self.satellites,
            HDOP,
            self._counter,
            None,
            None,
        )
        return _new(Navigation, values)


def nodes(settings: config.Vehicle, model: Model, seed: int) -> dict[str, NavigationNode]:
    there = settings.of(Simulation)
    noise = Noise(0.0, 0.0, 0.0, 0.0)
    if there.noise:
        noise = Noise(there.position_noise_m, math.radians(there.heading_noise_deg), there.speed_noise_mps)
    return {"navigation": NavigationNode(model, settings.navigation.rate_hz, noise, seed)}
