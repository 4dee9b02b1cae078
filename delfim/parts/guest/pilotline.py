"""The guest that speaks NMEA 0183: survey software or a plotter steers as it does any autopilot (docs/guest.md).

It enters by the guest's one door: a line to steer becomes a heading and a speed, and goes to `Guest.hear` as every guest's set
point does. A port of its own is read here, because what steers must not be taken for what tells the boat where it is.
"""

import math
from typing import Final

import msgspec

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.input.ratelimit import PIECE_BYTES
from delfim.base.modes import Mode
from delfim.lines.nmea0183.proprietary import FieldReader
from delfim.lines.nmea0183.tracklines import TrackLine, track_line
from delfim.vehicle.aboard import Added, OpenedWith
from delfim.vehicle.control.guidance import course_to_steer
from delfim.vehicle.control.memory import LineOfSight
from delfim.vehicle.grex import Guest, HeadingReference
from delfim.vehicle.links import Readable, ReadableLine
from delfim.vehicle.state import State

HELD_S: Final = 3.0  # the direction of APB stands so long for XTE, and for so long RMB adds nothing
STEP_MAX_S: Final = 2.0  # most time between two sentences that the guidance integrates over

_encode = msgspec.json.Encoder().encode


class PilotLine:
    """Turns sentences into set points: line-of-sight guidance on their line."""

    def __init__(self, settings: config.Vehicle, line: ReadableLine, guest: Guest) -> None:
        (self._table,), self._guest = settings.facts("guest"), guest
        self._path = msgspec.structs.replace(settings.control.path, lookahead_m=self._table.lookahead_m)
        self.input: Readable = line
        self._line, self._fields = line, FieldReader()
        self._course_rad, self._course_s = 0.0, -math.inf  # the line of the last APB, and when it came
        self._memory, self._heard_s = LineOfSight(), -math.inf

    def read(self, state: State, now_s: float) -> None:
        """Read the next sentences; the newest set point counts. Malformed sentences, warnings and magnetic bearings without a
        known variation are counted, and give none: the guest is silent then."""
        asked, taken, malformed = None, 0, self._fields.malformed
        while taken < PIECE_BYTES and (data := self._line.read()):
            taken += len(data)
            for fields in self._fields.feed(data):
                try:
                    told = track_line(fields)
                except FormatError:
                    state.count("guest_malformed")
                    continue
                if told is not None:
                    asked = self._steered(fields[0][2:], told, state, now_s) or asked
        if self._fields.malformed > malformed:
            state.count("guest_malformed", self._fields.malformed - malformed)
        if asked is not None:
            self._guest.is_connected = True
            self._guest.hear(_encode(asked))

    def _steered(self, form: str, told: TrackLine, state: State, now_s: float) -> HeadingReference | None:
        """The set point for a line; None: it gives none."""
        has_apb = now_s - self._course_s <= HELD_S
        if form == "RMB" and has_apb:
            return None
        if told.cross_m is None:
            self._course_s = -math.inf
            state.count("guest_warns")
            return None
        course_rad = told.course_rad
        if course_rad is None:
            if not has_apb:
                return None
            course_rad = self._course_rad
        elif told.is_magnetic:
            if self._table.variation_deg is None:
                state.count("guest_magnetic")
                return None
            course_rad += math.radians(self._table.variation_deg)
        if form == "APB":
            self._course_rad, self._course_s = course_rad, now_s
        was = self._memory if state.mode is Mode.GREX else LineOfSight()  # nobody obeys: nothing is integrated
        dt_s, self._heard_s = min(now_s - self._heard_s, STEP_MAX_S), now_s
        self._memory, heading_rad = course_to_steer(was, state.motion, course_rad, told.cross_m, self._path, dt_s)
        override_mps = state.setpoint.override_mps
        speed_mps = self._table.speed_mps if override_mps is None else override_mps
        return HeadingReference(math.degrees(heading_rad) % 360.0, speed_mps)


def opened(boat: OpenedWith) -> Added:
    """Open the guest's line. Raises DelfimError."""
    (table,) = boat.settings.facts("guest")
    line = boat.links.line(table.device, table.baud)
    return Added(inputs=(PilotLine(boat.settings, line, boat.guest),))
