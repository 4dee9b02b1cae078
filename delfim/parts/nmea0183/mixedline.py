"""A line with UBX frames and NMEA 0183 sentences in any order: both become the sentences that delfim.lines.nmea0183 combines.

What UBX tells has the talker UB. A receiver that sends both is believed in UBX, which has the accuracy, and in NMEA 0183 when
UBX ends.
"""

import math
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.lines.nmea0183.framing import NAMES_MAX, OTHERS, Sentence, Sentences
from delfim.lines.nmea0183.sentences import ActiveSatellites, Bearing, Located, Movement, Spread
from delfim.lines.ubx.ubxframes import UbxFrame, UbxFrames
from delfim.lines.ubx.ubxmessages import NAMES, READERS, Baseline, Solution
from delfim.parts.nmea0183.combining import UBX
from delfim.vehicle.navigation.fusion import SQRT2

LENGTH_OFF: Final = 0.2  # of the baseline's length: a solution that differs more is a wrong one
_DAY_MS: Final = 86_400_000


class Antennas(NamedTuple):
    """Two antennas of one boat, whose line is a compass."""

    length_m: float  # from one to the other, measured; 0: there are none
    angle_rad: float  # of the line from the base's to the rover's antenna, clockwise from the bow


NO_ANTENNAS: Final = Antennas(0.0, 0.0)


class MixedLine:
    """Reads a line as delfim.lines.nmea0183.framing.Sentences does, and UBX."""

    def __init__(self, needs_checksum: bool = True, antennas: Antennas = NO_ANTENNAS) -> None:
        """needs_checksum: a sentence without a checksum is refused; a UBX frame always has one."""
        self._sentences, self._frames, self._antennas = Sentences(needs_checksum), UbxFrames(), antennas
        self.heard = self._sentences.heard
        self.refused = self._sentences.refused = self._frames.refused

    def feed(self, data: bytes) -> list[Sentence]:
        """Parse the sentences that end in these bytes, in their order. Never raises."""
        found: list[Sentence] = []
        for piece in self._frames.feed(data):
            found += self._sentences.feed(piece) if isinstance(piece, bytes) else self._read(piece)
        return found

    def _read(self, frame: UbxFrame) -> list[Sentence]:
        """Convert a sound frame, counted by its name, to sentences; none if it is not used here."""
        name = NAMES.get(frame.kind) or f"UBX {frame.kind >> 8:02X}-{frame.kind & 0xFF:02X}"
        name = name if name in self.heard or len(self.heard) < NAMES_MAX else OTHERS
        self.heard[name] = self.heard.get(name, 0) + 1
        if frame.kind not in READERS:
            return []
        length, reader = READERS[frame.kind]
        try:
            if len(frame.payload) != length:
                raise FormatError("of another length")
            message = reader(frame.payload)
        except FormatError as error:
            self._refuse(f"{name}: {error}")
            return []
        if isinstance(message, Solution):
            return _solution(message)
        if isinstance(message, Baseline):
            return self._heading(message)
        return [Sentence(UBX, "DOP", ActiveSatellites(3, message.hdop))]

    def _heading(self, b: Baseline) -> list[Sentence]:
        """Take the heading of two antennas aboard. One that is not to be believed ends it at once, and is counted by its
        reason."""
        length_m, angle_rad = self._antennas
        if not length_m or not b.is_moving:  # the vector to a base ashore is no heading
            return []
        reason = ""
        if b.bearing_rad is None or not b.is_fixed:
            reason = "no heading without a fixed solution"
        elif abs(b.length_m - length_m) > LENGTH_OFF * length_m:
            reason = "the antennas are not that far apart"
        if reason or b.bearing_rad is None:
            self._refuse(f"NAV-RELPOSNED: {reason}")
            return [Sentence(UBX, "REL", Bearing(None))]
        heading_rad = (b.bearing_rad - angle_rad) % math.tau
        return [Sentence(UBX, "REL", Bearing(heading_rad, deviation_rad=b.accuracy_rad))]

    def _refuse(self, reason: str) -> None:
        self.refused[reason] = self.refused.get(reason, 0) + 1


def _solution(s: Solution) -> list[Sentence]:
    """The sentences of a solution: its accuracy, then position and velocity, which are complete with it."""
    movement = Movement(None, None, None)
    if s.north_mps is not None and s.east_mps is not None:
        course_rad = math.atan2(s.east_mps, s.north_mps) % math.tau
        deviation_mps = 0.0 if s.velocity_accuracy_mps is None else s.velocity_accuracy_mps / SQRT2
        movement = Movement(course_rad, None, math.hypot(s.north_mps, s.east_mps), deviation_mps)
    each_m = None if s.accuracy_m is None else s.accuracy_m / SQRT2
    located = Located(
        s.week_ms % _DAY_MS / 1000.0,  # of the GPS day, which differs from UTC's; it only tells one instant from another
        s.latitude_rad,
        s.longitude_rad,
        s.fix,
        min(s.satellites, 99),
        None,
        s.utc_ns,
        movement,
        corrections_s=s.corrections_s,
        height_m=s.height_m,
    )
    return [Sentence(UBX, "ACC", Spread(each_m, each_m)), Sentence(UBX, "PVT", located)]
