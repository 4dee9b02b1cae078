"""The state log of a vehicle as a tape: the boat as the console would have shown it at any time."""

import contextlib
import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.modes import PAYLOADS
from delfim.console.boats.boat import Boat, Measured
from delfim.console.link.mavlink import boatsize, mavlink
from delfim.console.plans.plan import item_of
from delfim.console.tapes.loggedmissions import logged_missions
from delfim.console.tapes.tape import GRAPHED, LAST_S, Graphs, Missions, Text, Track, between, sample
from delfim.logging.liblog import in_order
from delfim.logging.reading import read_events
from delfim.logging.statelog import read_state
from delfim.parts.nmea0183 import sensor as nmea0183
from delfim.parts.nmea2000 import sensor as nmea2000
from delfim.vehicle.navigation.gnss import FIXES
from delfim.vehicle.propulsion import thrusters

MEASURED: Final = {each.name: each.told.decode() for each in (*nmea0183.VALUES, *nmea2000.VALUES)}  # as the link tells them
SAID_S: Final = 900.0  # an order may last so long
STATE_S: Final = 0.1  # between records that are shown
Sides = dict[str, list[str]]  # "port" and "starboard": names of thrusters


class LogRow(NamedTuple):
    """A boat at one time of a state log."""

    at_s: float
    mode: int
    armed: bool
    values: dict[str, Any]
    reference: dict[str, Any]
    measured: dict[str, float]
    order_deg: float  # the course that keeps clear of another vessel; nan: there is none
    helmsman: str = ""  # the payload program that has the boat; empty: none


class States:
    """The state logs of one boat, which has this number in the replay. Raises OSError; FormatError if there is no record."""

    def __init__(self, files: Sequence[Path], number: int) -> None:
        self.name, self.complaint = "", ""
        self.days = frozenset(file.parent.parent for file in files)
        self._rows: list[LogRow] = []
        self.texts: list[Text] = []
        self._vessels: list[tuple[float, list[dict[str, Any]]]] = []  # when, and the other vessels
        self._number, self._size = number, _size(files)
        track: Track = []
        for file in in_order(files):
            self._read(file)
            self.texts += _texts(file, self._number)
            self._vessels += [(told["t_ns"] / 1e9, told["value"]) for told in _events(file) if told["event"] == "vessels"]
        if not self._rows:
            raise FormatError(f"{files[0] if files else 'no file'}: no record of a state")
        for row in self._rows:
            place = row.values["latitude_deg"], row.values["longitude_deg"]
            if place[0] is not None and (not track or row.at_s >= track[-1][0] + 1.0):
                track.append((round(row.at_s, 1), *place))
        self._times = [row.at_s for row in self._rows]
        self.texts.sort()
        self._vessels.sort(key=itemgetter(0))
        self.tracks = {self._number: track}
        given = sorted((told for file in files for told in _events(file)), key=lambda told: told.get("t_ns", 0))
        self._missions = logged_missions(given)
        self.missions: dict[int, Missions] = {self._number: self._missions}
        self.graphs: dict[int, Graphs] = {self._number: {}}
        for row in self._rows:
            told = {name: row.values[name] for name in GRAPHED} | row.measured
            sample(self.graphs[self._number], row.at_s, told)
        self.from_s, self.to_s = self._times[0], self._times[-1]

    def seek(self, boats: dict[int, Boat], at_s: float) -> None:
        self.play(boats, -math.inf, at_s)

    def play(self, boats: dict[int, Boat], from_s: float, to_s: float) -> Sequence[Text]:
        at = bisect_right(self._times, to_s) - 1
        if at >= 0 and self._rows[at].at_s > from_s:
            row = self._rows[at]
            boat = boats.setdefault(self._number, Boat(self._number, row.at_s))
            boat.name, boat.heard_s, boat.armed = self.name or boat.name, row.at_s, row.armed
            boat.size = self._size
            boat.link, boat.ready = "log", True  # it tells of no link, and of nothing that keeps the boat from starting
            if row.helmsman:
                boat.modes[row.mode] = f"payload {row.helmsman}"
            boat.enter(row.mode)
            boat.values |= row.values
            boat.reference |= row.reference | {"leg": self._item(row)}
            boat.measured = {name: Measured(value, 0, row.at_s) for name, value in row.measured.items()}
            boat.at_s |= dict.fromkeys(("GLOBAL_POSITION_INT", "ATTITUDE", "RAW_RPM", "SYS_STATUS"), row.at_s)
            track = self.tracks[self._number]
            begin, end = (bisect_right(track, (t_s, math.inf, math.inf)) for t_s in (from_s, to_s))
            boat.track.extend(track[begin:end])
            self._look(boat, row, from_s, to_s)
        return () if from_s < self.from_s else between(self.texts, from_s, to_s)

    def _item(self, row: LogRow) -> int | None:
        """The leg, as the item of the mission that the console counts."""
        known, leg = bisect_right(self._missions, row.at_s, key=itemgetter(0)), row.reference["leg"]
        if leg is None or not known or not 0 <= leg < len(self._missions[known - 1][1]["waypoints"]):
            return None
        return item_of(self._missions[known - 1][1], int(leg))

    def _look(self, boat: Boat, row: LogRow, from_s: float, to_s: float) -> None:
        """The other vessels, and what the boat does for them."""
        known = bisect_right(self._vessels, to_s, key=itemgetter(0)) - 1
        if known >= 0 and self._vessels[known][0] > from_s:
            at_s, vessels = self._vessels[known]
            boat.others.recall(vessels, at_s)
        for text in between(self.texts, max(from_s, to_s - SAID_S), to_s):
            boat.others.says(text.text.removeprefix("traffic: "))
        boat.others.ordered(row.order_deg, row.at_s)

    def _read(self, file: Path) -> None:
        schema, records, complaint = read_state(file)
        sides = _sides(file)
        self.name, self.complaint = schema.boat or self.name, complaint or self.complaint
        due_s = self._rows[-1].at_s + STATE_S if self._rows else -math.inf
        for record in records:
            told = dict(zip(schema.names, record, strict=True))
            at_s = told.get("t1", 0) / 1e9
            if due_s - 1e-6 <= at_s < LAST_S and isinstance(told.get("mode"), int):
                due_s = at_s + STATE_S
                self._rows.append(_row(at_s, told, sides))


def _row(at_s: float, told: dict[str, Any], sides: Sides) -> LogRow:
    def known(name: str, digits: int = 2) -> float | None:
        value = told.get(name, math.nan)
        return round(value, digits) if math.isfinite(value) else None

    def degrees(name: str, digits: int = 1) -> float | None:
        value = told.get(name, math.nan)
        return round(math.degrees(value), digits) if math.isfinite(value) else None

    def compass(value: float | None) -> float | None:
        return None if value is None else round(value % 360.0, 1)

    def mean(names: Sequence[str], times: float, *ends: str) -> float | None:
        """Of the first known value of each thruster."""
        each = [next((v for end in ends if (v := known(f"{name}_{end}", 4)) is not None), None) for name in names]
        values = [value for value in each if value is not None]
        return round(times * sum(values) / len(values)) if values else None

    north_mps, east_mps = known("north_speed", 3), known("east_speed", 3)
    moves = north_mps is not None and east_mps is not None
    charges = [value for name in ("port_charge", "starboard_charge") if (value := known(name, 3)) is not None]
    volts = [value for name in ("port_voltage", "starboard_voltage") if (value := known(name)) is not None]
    values = {
        "latitude_deg": degrees("latitude", 7),
        "longitude_deg": degrees("longitude", 7),
        "heading_deg": compass(degrees("heading")),
        "course_deg": compass(math.degrees(math.atan2(east_mps or 0.0, north_mps or 0.0))) if moves else None,
        "speed_mps": round(math.hypot(north_mps or 0.0, east_mps or 0.0), 2) if moves else None,
        "roll_deg": degrees("roll"),
        "pitch_deg": degrees("pitch"),
        **{f"{side}_rpm": mean(names, 1.0, "rpm_measured", "rpm") for side, names in sides.items()},
        **{f"{side}_pct": mean(names, 100.0, "command") for side, names in sides.items()},
        "battery_v": min(volts, default=None),
        "battery_pct": round(100.0 * min(charges)) if charges else None,
        "satellites": known("satellites"),
        "fix": FIXES.get(int(told.get("fix", -1))),
    }
    reference = {
        "heading_deg": compass(degrees("reference_heading")),
        "cross_track_m": known("cross_track"),
        "distance_m": known("distance", 1),
        "leg": known("leg"),
    }
    measured = {short: value for name, short in MEASURED.items() if (value := known(name, 3)) is not None}
    order_deg = math.degrees(told.get("order_course", math.nan))
    mode, helmsman = told["mode"], ""
    if number := told.get("helmsman", 0):
        programs = [name[len("payload_") : -len("_s")] for name in told if name.startswith("payload_") and name.endswith("_s")]
        mode, helmsman = PAYLOADS + number - 1, programs[number - 1]
    return LogRow(at_s, mode, bool(told.get("run")), values, reference, measured, order_deg, helmsman)


def _events(file: Path) -> Iterator[dict[str, Any]]:
    """The events in the sidecar of a log, if it has one."""
    sidecar = file.with_name(file.name.partition(".")[0] + ".meta.jsonl")
    with contextlib.suppress(OSError):
        yield from read_events(sidecar)


def number_of(files: Sequence[Path]) -> int | None:
    """The number that a boat had by the sidecars of its logs."""
    for told in (told for file in files for told in _events(file)):
        with contextlib.suppress(KeyError, TypeError, ValueError):
            return int(told["settings"]["boat"]["id"])
    return None


def _size(files: Sequence[Path]) -> boatsize.BoatSize | None:
    """By the settings in the logs' sidecars."""
    for told in (told for file in files for told in _events(file)):
        with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):
            settings = told["settings"]
            rpm = (settings.get(row["driver"], {}).get("rpm_max", row["rpm_max"]) for row in settings["thrusters"])
            boat = settings["boat"]
            return boatsize.heard(f"{boat['length_m']} {boat['beam_m']} {max(rpm, default=0.0)}")
    return None


def _sides(file: Path) -> Sides:
    """The names of the thrusters of each side, by the settings in the log's sidecar; otherwise those of DelfimX."""
    rows: Sequence[config.ThrusterTable] = config.DELFIMX
    for told in _events(file):
        with contextlib.suppress(KeyError, TypeError, msgspec.ValidationError):
            rows = msgspec.convert(told["settings"]["thrusters"], config.Thrusters)
            break
    port, starboard = thrusters.sides(rows)
    return {"port": [rows[i].name for i in port], "starboard": [rows[i].name for i in starboard]}


def _texts(file: Path, number: int) -> list[Text]:
    notice, info = mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_INFO
    result = []
    for told in _events(file):
        if told.get("event") == "note":
            result.append(Text(told["t_ns"] / 1e9, number, notice, str(told.get("value"))))
        elif told.get("event") == "mode":
            result.append(Text(told["t_ns"] / 1e9, number, info, f"{told.get('value')}: {told.get('reason')}"))
    return result
