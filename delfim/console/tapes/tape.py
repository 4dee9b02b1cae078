"""Recordings that can be played: a session of the console (.tlog), or the state log of a vehicle.

Both are tapes: they know their begin and end and the track of each boat, and set boats to the state known at a time.
"""

import contextlib
import math
import struct
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from delfim.base.errors import FormatError
from delfim.base.input.untrusted import read_file
from delfim.console.boats.boat import Boat
from delfim.console.boats.othervessels import VesselsTold
from delfim.console.link.mavlink import COMPONENT, FENCE, MISSION, RALLY, SYSTEM, Item, WaterDepth, mavlink
from delfim.console.link.session import STAMP
from delfim.console.link.statustext import Words
from delfim.console.plans.plan import KINDS, item_in, mission_of

SESSION_BYTES: Final = 1 << 30  # of a session that is replayed: a boat's day has a tenth of that
BEFORE_S: Final = 30.0  # every periodic message comes at least once in this time, lean links apart
VESSELS_S: Final = 1500.0  # the same of other vessels: one that lies, reports seldom and was lost is shown for so long
_V1, _V2, _SIGNED = 0xFE, 0xFD, 0x01
_SHOWS_PLACE: Final = (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_HIGH_LATENCY2)
_TOLD_ONCE: Final = (mavlink.MAVLINK_MSG_ID_PARAM_EXT_VALUE, mavlink.MAVLINK_MSG_ID_AVAILABLE_MODES)  # when the boat was found
_SAMPLED: Final = (
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    WaterDepth.id,
    mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT,
)
SAMPLED_MAX: Final = 4096
_MISSION: Final = (mavlink.MAVLINK_MSG_ID_MISSION_COUNT, mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT)
_FIRST_S, LAST_S = 1e9, 4e9  # 2001 to 2096: stamps that are times

GRAPHED: Final = ("speed_mps", "battery_pct")  # beside the values of sensors
GRAPH_S: Final = 1.0  # between points
GRAPHS_MAX: Final = 12
OLD_S: Final = 6.0  # a value of a sensor that is older is not drawn

Track = list[tuple[float, float, float]]
Graphs = dict[str, list[tuple[float, float]]]  # by name with unit: (at_s, value)
Missions = list[tuple[float, dict[str, Any]]]  # when it was known, in order of time


class Text(NamedTuple):
    """A text message of a boat."""

    at_s: float
    boat: int
    severity: int
    text: str


def between(texts: Sequence[Text], from_s: float, to_s: float) -> Sequence[Text]:
    """The texts after one time and until another."""
    return texts[bisect_right(texts, from_s, key=_at) : bisect_right(texts, to_s, key=_at)]


def _at(text: Text) -> float:
    return text.at_s


def sample(graphs: Graphs, at_s: float, told: Mapping[str, float | None]) -> None:
    """One more point of each graph whose value is known, unless the last is newer than GRAPH_S."""
    for name, value in told.items():
        points = graphs.get(name)
        if value is None or (points is None and len(graphs) >= GRAPHS_MAX):
            continue
        if points is None:
            points = graphs[name] = []
        if not points or at_s >= points[-1][0] + GRAPH_S:
            points.append((round(at_s, 1), round(value, 3)))


class Tape(Protocol):
    from_s: float  # since 1970
    to_s: float
    tracks: dict[int, Track]  # by boat: (at_s, latitude_deg, longitude_deg), a point a second
    missions: dict[int, Missions]  # by boat: the missions read from it
    graphs: dict[int, Graphs]  # by boat
    texts: list[Text]  # in order of time
    complaint: str  # the fault of the recording; empty if there is none
    days: frozenset[Path]  # folders of logs that it was read from: the boat's pictures lie beside it

    def seek(self, boats: dict[int, Boat], at_s: float) -> None:
        """Set new boats to the state known at that time."""

    def play(self, boats: dict[int, Boat], from_s: float, to_s: float) -> Sequence[Text]:
        """Advance boats from the state known at one time to that of a later one; the texts between them."""


class TlogTape:
    """A .tlog. Raises FormatError if no frame can be read, OSError."""

    def __init__(self, file: Path) -> None:
        self._data = read_file(file, SESSION_BYTES)
        self._mav = mavlink.MAVLink(None, SYSTEM, COMPONENT)
        self._times: list[float] = []  # a row a second: time, and where in the file it begins
        self._places: list[int] = []
        self.tracks: dict[int, Track] = {}
        self.missions: dict[int, Missions] = {}
        self.graphs: dict[int, Graphs] = {}
        self._sampled: dict[int, Boat] = {}  # with the values that are graphed
        self._sampled_s: dict[tuple[int, int, bytes], float] = {}  # by boat, message and name
        self.texts: list[Text] = []
        self._read: dict[tuple[int, int], tuple[int, list[Item]]] = {}  # by boat and type: how many, and those so far
        self._words: dict[int, Words] = {}  # by boat
        self._vessels: dict[int, list[tuple[float, int, int]]] = {}  # by boat: when, and where in the file
        self._known: dict[int, Boat] = {}  # sent once: name and modes
        self.complaint, self.days = "", frozenset[Path]()
        self.from_s = self.to_s = -math.inf
        at = 0
        for at_s, start, end in self._frames(0):
            at = end
            if self.from_s < 0.0:
                self.from_s = at_s
            self.to_s = max(self.to_s, at_s)
            if not self._times or at_s >= self._times[-1] + 1.0:
                self._times.append(at_s)
                self._places.append(start - STAMP.size)
            self._remember(at_s, start, end)
        if not self._times:
            raise FormatError(f"{file}: no session: it begins with something else than a time and a MAVLink frame")
        if at < len(self._data):
            self.complaint = f"{file}: damaged after {at} of {len(self._data)} bytes"

    def seek(self, boats: dict[int, Boat], at_s: float) -> None:
        self.play(boats, at_s - BEFORE_S, at_s)
        for number, track in self.tracks.items():
            seen = bisect_right(track, (at_s, math.inf, math.inf))
            if not seen:
                continue
            if number not in boats:  # silent since: its last messages
                silent: dict[int, Boat] = {}
                self.play(silent, track[seen - 1][0] - 5.0, track[seen - 1][0] + 1.0)
                boats |= {each: boat for each, boat in silent.items() if each == number}
            if number in boats:
                boats[number].track.clear()
                boats[number].track.extend(track[:seen])
        for number, boat in boats.items():
            self._look(number, boat.others, at_s)

    def _look(self, number: int, others: VesselsTold, at_s: float) -> None:
        """The other vessels that were told of before, and the sentence of an order that lasts."""
        told = self._vessels.get(number, [])
        begin, end = (bisect_right(told, (t_s, math.inf)) for t_s in (at_s - VESSELS_S, at_s))
        newest = {self._data[start + 10 : start + 14]: (t_s, start, end) for t_s, start, end in told[begin:end]}  # by MMSI
        for t_s, start, end in newest.values():
            message = self._message(start, end)
            if message is not None and message.MMSI not in others.tracks:
                others.hear(message, t_s)
        if others.order(at_s) is not None:
            for text in between(self.texts, at_s - VESSELS_S, at_s):
                others.says(text.text if text.boat == number else "")

    def play(self, boats: dict[int, Boat], from_s: float, to_s: float) -> Sequence[Text]:
        row = max(bisect_right(self._times, from_s) - 1, 0)
        for at_s, start, end in self._frames(self._places[row]):
            if at_s > to_s:
                break
            if at_s <= from_s or not self._of_boat(start):
                continue
            message = self._message(start, end)
            if message is None:
                continue
            number = message.get_srcSystem()
            if number not in boats:
                boats[number] = boat = Boat(number, at_s)
                known = self._known.get(number, boat)
                boat.name, boat.modes = known.name, known.modes
            boats[number].receive(message, at_s, at_s)
        return between(self.texts, from_s, to_s)

    def _remember(self, at_s: float, start: int, end: int) -> None:
        """Keeps a point of the track each second; names, missions, texts."""
        if not self._of_boat(start):
            return
        if self._number(start) == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
            self._remember_text(at_s, self._message(start, end))
        if self._number(start) in _TOLD_ONCE and (message := self._message(start, end)) is not None:
            number = message.get_srcSystem()
            self._known.setdefault(number, Boat(number, at_s)).receive(message, at_s, at_s)
        if self._number(start) == mavlink.MAVLINK_MSG_ID_AIS_VESSEL and self._data[start] == _V2:
            self._vessels.setdefault(self._system(start), []).append((at_s, start, end))
        if self._number(start) in _SAMPLED:
            self._sample(at_s, start, end)
        if self._number(start) in _MISSION:
            self._remember_mission(at_s, self._message(start, end))
        if self._number(start) not in _SHOWS_PLACE:
            return
        track = self.tracks.setdefault(self._system(start), [])
        if track and at_s < track[-1][0] + 1.0:
            return
        message = self._message(start, end)
        if message is None:
            return
        boat = Boat(message.get_srcSystem(), at_s)
        boat.receive(message, at_s, at_s)
        track.extend(boat.track)
        others = self._sampled.get(boat.number, boat)
        told = {name: {**others.values, **boat.values}.get(name) for name in GRAPHED}
        told |= {name: each.value for name, each in others.measured.items() if at_s - each.at_s < OLD_S}
        sample(self.graphs.setdefault(boat.number, {}), at_s, told)

    def _sample(self, at_s: float, start: int, end: int) -> None:
        """Values for the graphs, each once a second."""
        number = self._number(start)
        name = self._data[start + 18 : start + 28] if number == mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT else b""
        key = self._system(start), number, name
        if at_s < self._sampled_s.get(key, -math.inf) + GRAPH_S or len(self._sampled_s) >= SAMPLED_MAX:
            return
        message = self._message(start, end)
        if message is not None:
            self._sampled_s[key] = at_s
            self._sampled.setdefault(key[0], Boat(key[0], at_s)).receive(message, at_s, at_s)

    def _remember_text(self, at_s: float, message: Any) -> None:
        if message is None:
            return
        number = message.get_srcSystem()
        text = self._words.setdefault(number, Words()).hear(message)
        if text is not None:
            self.texts.append(Text(at_s, number, message.severity, text))

    def _remember_mission(self, at_s: float, message: Any) -> None:
        """Collects a boat's answer to a request for its mission: a count for each type, and as many items in their order."""
        if message is None:
            return
        number, kind = message.get_srcSystem(), message.mission_type
        if message.get_type() == "MISSION_COUNT":
            self._read[number, kind] = message.count, []
            if kind == MISSION:  # it comes first: fence and home before it belong to the previous reading
                self._read[number, FENCE] = self._read[number, RALLY] = -1, []
        count, items = self._read.get((number, kind), (0, []))
        if message.get_type() == "MISSION_ITEM_INT" and message.seq == len(items) < count:
            items.append(item_in(message))
        elif message.get_type() == "MISSION_ITEM_INT":
            return
        groups = [self._read.get((number, each), (-1, [])) for each in KINDS]
        if all(len(group) == wanted for wanted, group in groups):
            self.missions.setdefault(number, []).append((at_s, mission_of("aboard", [group for _, group in groups])))

    def _frames(self, at: int) -> Iterator[tuple[float, int, int]]:
        """(time, start, end) of the frames from a place on, up to the first damaged one. Time never goes back, though a
        computer's clock may."""
        data, size, last_s = self._data, len(self._data), -math.inf
        while at + STAMP.size + 12 <= size:
            at_s, start = STAMP.unpack_from(data, at)[0] / 1e6, at + STAMP.size
            magic, length, flags = data[start : start + 3]
            if magic == _V2:
                end = start + 12 + length + (13 if flags & _SIGNED else 0)
            elif magic == _V1:
                end = start + 8 + length
            else:
                return
            if end > size or not _FIRST_S < at_s < LAST_S:
                return
            last_s = max(last_s, at_s)
            yield last_s, start, end
            at = end

    def _system(self, start: int) -> int:
        return self._data[start + (5 if self._data[start] == _V2 else 3)]

    def _of_boat(self, start: int) -> bool:
        component = self._data[start + (6 if self._data[start] == _V2 else 4)]
        return component == mavlink.MAV_COMP_ID_AUTOPILOT1 and self._system(start) not in (0, SYSTEM)

    def _number(self, start: int) -> int:
        data = self._data
        return int.from_bytes(data[start + 7 : start + 10], "little") if data[start] == _V2 else data[start + 5]

    def _message(self, start: int, end: int) -> Any:
        """None for a damaged or unknown frame."""
        with contextlib.suppress(mavlink.MAVError, struct.error):
            return self._mav.decode(bytearray(self._data[start:end]))
        return None
