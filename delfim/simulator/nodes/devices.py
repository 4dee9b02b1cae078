"""Off-the-shelf devices on an NMEA 2000 bus: a receiver of satellite navigation, and a compass, with a gyro if wished.

They are there where the vehicle's file names the source `nmea2000`. Their errors are those of the navigation node.
"""

import math
from typing import Final

from delfim import config
from delfim.base.frames import Frame
from delfim.canproxy.nmea2000.parcels import CLAIM, REQUEST, ROLL_CALL, Parcel, addressed, any_of, frames
from delfim.canproxy.nmea2000.pgns import (
    CourseSpeed,
    GnssPosition,
    Message,
    NorthReference,
    PositionRapid,
    RateOfTurn,
    VesselHeading,
    encode,
)
from delfim.canproxy.socket import CanAddress
from delfim.simulator.model import Model
from delfim.simulator.nodes.measuring import AntennaMotion, Compass, GnssReceiver, Turn, bent_by
from delfim.simulator.nodes.navigation import HDOP
from delfim.simulator.nodes.period import Period
from delfim.simulator.tables import Simulation

RECEIVER, COMPASS = 43, 204  # their addresses, as on a boat in docs/nmea2000.md
NAMES: Final = {RECEIVER: "c07891002fb34d62", COMPASS: "c050a0002fb30d62"}  # as on another boat there
QUALITY_S: Final = 1.0  # the receiver's period of time, fix and satellites
GNSS: Final = 1  # method of a fix


class Devices:
    """All devices of the bus. They keep their addresses, and send their NAMEs at the start and to all who ask for them."""

    hears = tuple(CanAddress(arb, mask) for arb, mask in any_of(REQUEST))

    def __init__(self, settings: config.Vehicle, model: Model, seed: int) -> None:
        self.interface, self._must_claim = settings.table("nmea2000").interface, True
        self.receiver = GnssReceiver(model, settings.of(Simulation), seed)
        self.compass = Compass(model, settings.of(Simulation), seed)
        self.has_gyro = settings.of(Simulation).gyro
        self._variation_rad = math.radians(settings.table("nmea2000").variation_deg)
        self.compass.bent = bent_by(settings.compass, self._variation_rad)
        self._quality, self._number = Period(QUALITY_S), 0

    @property
    def due_s(self) -> float:
        """The time when `step` is due next."""
        return min(self.receiver.due_s, self.compass.due_s)

    def feed(self, frame: Frame, now_s: float) -> None:
        """Take a request for addresses."""
        self._must_claim |= addressed(frame.arb)[0] == REQUEST and frame.data[:3] == ROLL_CALL.data

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        """The frames that the devices send now; the model was advanced by the nodes."""
        said = self._claims() if self._must_claim else []
        self._must_claim = False
        if (turn := self.compass.step(now_s)) is not None:
            said += self._turning(turn)
        if (movement := self.receiver.step(now_s)) is not None:
            said += self._moving(movement, now_s, utc_ns)
        return said

    def _claims(self) -> list[Frame]:
        there = (RECEIVER, self.receiver), (COMPASS, self.compass)
        claims = (
            Parcel(CLAIM, int(NAMES[each], 16).to_bytes(8, "little"), each) for each, device in there if not device.silent
        )
        return [Frame(arb, data) for claim in claims for arb, data in frames(claim, 0)]

    def _turning(self, turn: Turn) -> list[Frame]:
        told = VesselHeading(turn.heading_rad, None, None, NorthReference.TRUE)
        if self.compass.bent is not None:  # iron is about a magnetic compass
            magnetic_rad = (turn.heading_rad - self._variation_rad) % math.tau
            told = VesselHeading(magnetic_rad, None, self._variation_rad, NorthReference.MAGNETIC)
        heading = encode(told, COMPASS)
        return heading + (encode(RateOfTurn(turn.rate_radps), COMPASS) if self.has_gyro else [])

    def _moving(self, m: AntennaMotion, now_s: float, utc_ns: int) -> list[Frame]:
        course_rad, speed_mps = math.atan2(m.east_mps, m.north_mps) % math.tau, math.hypot(m.north_mps, m.east_mps)
        said: list[Message] = [
            PositionRapid(m.latitude_rad, m.longitude_rad),
            CourseSpeed(NorthReference.TRUE, course_rad, speed_mps),
        ]
        if self._quality.passed(now_s):
            self._number += 1
            satellites = self.receiver.satellites
            said.append(GnssPosition(utc_ns, m.latitude_rad, m.longitude_rad, GNSS, satellites, HDOP))
        return [frame for message in said for frame in encode(message, RECEIVER, self._number & 7)]


def devices_of(settings: config.Vehicle, model: Model, seed: int) -> Devices | None:
    return Devices(settings, model, seed) if "nmea2000" in settings.navigation.sources else None
