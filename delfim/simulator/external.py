"""A model in another program, in any language, over UDP (thesis 3.6.2, figure 3-16).

The other program sends position and motion of the boat, at any time; the answer to each datagram is the present state of the
propellers. Motors, batteries and all CAN nodes stay in this program, so the vehicle sees no difference.
`docs/external-model.md` has the protocol and an example that a test runs.
"""

import math
import socket
from typing import Annotated

import msgspec

from delfim.clock import Clock
from delfim.config import Sea, address
from delfim.errors import DelfimError
from delfim.geodesy import origin
from delfim.outside import UNREADABLE
from delfim.simulator.model import Hull, Model

SILENT_S = 1.0  # a model silent for longer counts as silent sensors
DATAGRAMS = 16  # taken at once

Finite = Annotated[float, msgspec.Meta(gt=-1e7, lt=1e7)]


class Moved(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A datagram of the model: metres north and east of the simulation's start, rad, m/s over ground."""

    north_m: Finite
    east_m: Finite
    heading_rad: Finite
    north_mps: Finite
    east_mps: Finite
    yaw_rate_radps: Finite = 0.0


_decode = msgspec.json.Decoder(Moved).decode


class ExternalModel(Model):
    """The world modelled by another program. `listen` is HOST:PORT; raises DelfimError if it cannot be bound."""

    def __init__(self, hull: Hull, clock: Clock, listen: str, latitude_rad: float, longitude_rad: float) -> None:
        super().__init__(hull, Sea(), 0, latitude_rad, longitude_rad, 0.0)
        self.origin = origin(latitude_rad, longitude_rad)
        self.malformed = 0
        self._clock, self._heard_s = clock, -math.inf
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(address(listen))
        except OSError as error:
            self._socket.close()
            raise DelfimError(f"simulation.external: {listen}: {error.strerror}") from None
        self._socket.setblocking(False)

    @property
    def alive(self) -> bool:
        return self._clock.monotonic_s() - self._heard_s < SILENT_S

    def fileno(self) -> int:
        """Readable when the other program sent: call `listen` then."""
        return self._socket.fileno()

    def advance(self, dt_s: float) -> None:
        """Advance motors and batteries, the only parts modelled here."""
        self._turn(self.starboard, dt_s)
        self._turn(self.port, dt_s)
        self.time_s += dt_s
        self.listen()

    def listen(self) -> None:
        """Take the other program's datagrams and answer them. Malformed ones are counted."""
        for _ in range(DATAGRAMS):
            try:
                data, peer = self._socket.recvfrom(2048)
            except OSError:  # no more datagrams; or the last answer was not received
                return
            try:
                self._take(_decode(data))
            except UNREADABLE:
                self.malformed += 1
                continue
            rpm = {"time_s": self.time_s, "starboard_rpm": self.starboard_rpm, "port_rpm": self.port_rpm}
            self._socket.sendto(msgspec.json.encode(rpm), peer)

    def _take(self, moved: Moved) -> None:
        self._heard_s = self._clock.monotonic_s()
        c, s = math.cos(moved.heading_rad), math.sin(moved.heading_rad)
        self.north_m, self.east_m, self.heading_rad = moved.north_m, moved.east_m, moved.heading_rad % math.tau
        self.surge_mps = moved.north_mps * c + moved.east_mps * s
        self.sway_mps = moved.east_mps * c - moved.north_mps * s
        self.yaw_rate_radps = moved.yaw_rate_radps
