"""An inertial navigation system as a source: its position, velocity and heading, while it says that it is sure of them."""

import math
from typing import Final, cast

from delfim import config
from delfim.base.errors import FormatError
from delfim.lines.binaryframes import BinaryFrames
from delfim.parts.ins.insmessages import RECKONED, Readings
from delfim.parts.ins.languages import LANGUAGES
from delfim.parts.ins.table import InsTable
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.navigation.fusion import MOVING, SLOW_S, Fusion
from delfim.vehicle.state import State

NAME: Final = "ins"
KINDS: Final = {**MOVING, "attitude": 0.0, "accuracy": 0.0, "deviation": SLOW_S, "receiver": SLOW_S, "time": SLOW_S}
SPEED_MAX_MPS: Final = 200.0


class InsNavigation:
    """The system's messages; each that speaks of the position makes one of navigation, with the newest of all others."""

    name = NAME

    def __init__(self, table: InsTable, stale_s: float, line: ReadableLine, state: State) -> None:
        self.input, self._state, language = line, state, LANGUAGES[table.speaks]
        self._frames, self._read = BinaryFrames(language.framing), language.read
        self._position_max_m, self._heading_max_rad = table.position_max_m, math.radians(table.heading_max_deg)
        self._fusion, self.heard_s = Fusion[str](KINDS, stale_s), -1e9

    def read(self, now_s: float) -> Fix | None:
        """The newest position that has come. What cannot be read is counted."""
        fix, before = None, self._frames.refused
        while data := self.input.read():
            for frame in self._frames.feed(data):
                try:
                    said = _checked(self._read(frame))
                except FormatError:
                    self._state.count("ins_malformed")
                    continue
                fix = self._take(said, now_s) or fix
            if self.input.fileno() >= 0:
                break
        if self._frames.refused > before:
            self._state.count("ins_refused", self._frames.refused - before)
        return fix

    def _take(self, said: Readings, now_s: float) -> Fix | None:
        for kind, value in said.items():
            if kind == "time":
                self._fusion.set_time(NAME, None if value is None else int(value[0]), now_s)
            else:
                self._fusion.put(kind, NAME, value, now_s)
        if "position" not in said:
            return None
        self.heard_s = now_s
        kinds, position = self._fusion.kinds, said["position"]
        (accuracy_m,) = kinds["accuracy"].get(now_s) or (None,)
        (deviation_rad,) = kinds["deviation"].get(now_s) or (0.0,)
        fix, satellites = kinds["receiver"].get(now_s) or (0, 0)
        sure = accuracy_m is None or accuracy_m <= self._position_max_m
        n = self._fusion.message(
            cast(tuple[float, float], position) if sure else None,
            self._fusion.utc_ns(NAME, now_s),
            now_s,
            int(fix) or RECKONED,
            int(satellites),
            None,
            accuracy_m,
        )
        if not sure:
            n = n._replace(north_mps=None, east_mps=None)
        if deviation_rad > self._heading_max_rad:
            n = n._replace(heading_rad=None)
        elif n.heading_rad is not None:
            n = n._replace(heading_rad=n.heading_rad % math.tau)
        return Fix(n, self.input.t_ns, now_s)

    def report(self, now_s: float) -> dict[str, object]:
        """The age of each kind of data, and how sure the system is: metres of its position, degrees of its heading; None: it
        has not said."""
        kinds, used = self._fusion.kinds, self._fusion.used(now_s).items()
        (accuracy_m,), (deviation_rad,) = kinds["accuracy"].get(now_s) or (None,), kinds["deviation"].get(now_s) or (None,)
        return {
            "kinds": {kind: {"talker": talker, "age_s": age_s} for kind, (talker, age_s) in used},
            "accuracy_m": None if accuracy_m is None else round(accuracy_m, 3),
            "heading_deg": None if deviation_rad is None else round(math.degrees(deviation_rad), 2),
        }


def _checked(said: Readings) -> Readings:
    """Raises FormatError for what is no number, or beyond what a boat can have."""
    for kind, value in said.items():
        if value is not None and not all(map(math.isfinite, value)):
            raise FormatError(f"{kind} is no number")
    position, velocity = said.get("position"), said.get("velocity")
    if position is not None and not (abs(position[0]) < math.pi / 2.0 and abs(position[1]) <= math.tau):
        raise FormatError("no such place")
    if velocity is not None and math.hypot(*velocity) > SPEED_MAX_MPS:
        raise FormatError("no boat is so fast")
    if min((said.get("accuracy") or (0.0,))[0], (said.get("deviation") or (0.0,))[0]) < 0.0:
        raise FormatError("a deviation below zero")
    return said


def open_source(settings: config.Vehicle, links: Links, state: State) -> InsNavigation:
    """Raises DelfimError."""
    table = settings.of(InsTable)
    return InsNavigation(table, settings.navigation.stale_s, links.line(table.device, table.baud), state)
