"""Rules of the black box: the frames on the bus of DelfimX agree with the records (etc/delfimx.dbc)."""

import struct
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from delfim.audit.evidence import IDLE, SAME_S, Evidence, Sent, Unjudged
from delfim.audit.rule import Finding, Rule

COMMANDS: Final = (0x40, 0x41)  # PropellerStarboardCommand, PropellerPortCommand, by the row's address
REPORTS: Final = (0x1019_0001, 0x1019_1001)  # the same of their status
USED: Final = frozenset((*COMMANDS, *REPORTS))  # of a day's frames no others are kept
SURE_S: Final = 1.0
NEAR_NS: Final = 20_000_000  # between a stamp of a record and that of its frame
LOST: Final = "lost"  # in the names of events that tell of lost frames


def _bus(e: Evidence) -> list[Sent]:
    """The frames of the boat's own bus. Raises Unjudged where there are none, or not all of them."""
    name = str(e.setting("can.interface")).split(":")[-1].split("@")[0]
    if not (frames := e.boxes.get(name, ())):
        raise Unjudged(f"there is no black box of {name}")
    if lost := [str(each["event"]) for each in e.box_events if LOST in str(each["event"])]:
        raise Unjudged(f"the black box of {name} is not whole: {lost[0]}")
    return list(frames)


def _rows(e: Evidence) -> list[Any]:
    rows = [row for row in e.thrusters if row["driver"] == "dsor" and row["address"] < len(COMMANDS)]
    if not rows:
        raise Unjudged("no thruster is driven by dsor frames")
    return rows


def _of(frames: list[Sent], identifier: int, form: str) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Times, revolutions and whether it runs, of frames with this identifier."""
    size = struct.calcsize(form)
    its = [
        (each.t_ns, *struct.unpack_from(form, each.data))
        for each in frames
        if each.identifier == identifier and len(each.data) >= size
    ]
    table = np.array([row[:2] for row in its], np.int64).reshape(-1, 2)
    return table[:, 0], table[:, 1], np.array([bool(row[2]) for row in its], bool)


def frames_as_records(e: Evidence) -> Iterator[Finding]:
    frames, sent_ns = _bus(e), e.column("t3").astype(np.int64)
    for row in _rows(e):
        sign, name = -1 if row["reversed"] else 1, row["name"]
        t_ns, rpm, runs = _of(frames, COMMANDS[row["address"]], "<hB")
        if not len(t_ns):
            raise Unjudged(f"the black box has no command to {name}")
        wanted = np.rint(e.column(f"{name}_rpm").astype(float)).astype(np.int64) * sign
        at = np.searchsorted(sent_ns, t_ns + NEAR_NS) - 1
        near = [np.clip(at + each, 0, len(wanted) - 1) for each in (0, -1)]
        wrong = (rpm != 0) & (np.abs(rpm - wanted[near[0]]) > 1) & (np.abs(rpm - wanted[near[1]]) > 1) & (at >= 0)
        wrong &= ~np.concatenate((e.lost, [True]))[near[0]]  # the log was not written then
        for i in [each for each in np.flatnonzero(wrong) if not _just_ordered(e, t_ns[each])][:3]:
            yield Finding(_seconds(e, t_ns[i]), f"{rpm[i]} rpm went to {name}; the records say {wanted[near[0][i]]}")
        for i in np.flatnonzero((rpm != 0) & ~runs)[:3]:
            yield Finding(_seconds(e, t_ns[i]), f"{rpm[i]} rpm went to {name} without leave to run")
        places = np.searchsorted(t_ns, sent_ns - NEAR_NS)
        inside = (sent_ns > t_ns[0]) & (sent_ns < t_ns[-1] - NEAR_NS)
        for i in np.flatnonzero(inside & (wanted != 0)):
            if not (np.abs(rpm[places[i] : places[i] + 6] - wanted[i]) <= 1).any():
                yield Finding(e.t_s[i], f"the records say {wanted[i]} rpm for {name}, and no frame took it there")


def _just_ordered(e: Evidence, t_ns: int) -> bool:
    """Whether an order came at this time: it is commanded at once, between two records."""
    t_s = _seconds(e, t_ns)
    return bool(e.obeyed(t_s, SAME_S))


def _seconds(e: Evidence, t_ns: int) -> float:
    """The time since boot, s, by the nearest record."""
    stamps = e.column("t1").astype(np.int64)
    at = int(np.clip(np.searchsorted(stamps, t_ns), 0, len(stamps) - 1))
    return float(e.t_s[at]) + (int(t_ns) - int(stamps[at])) / 1e9


def silence_on_bus(e: Evidence) -> Iterator[Finding]:
    frames, heard_ns = _bus(e), e.column("t1").astype(np.int64)
    if e.lost.any():
        raise Unjudged("records are missing, so nobody knows when navigation was heard")
    after_s = float(e.setting("failsafe.navigation_silent.after_s")) + SURE_S
    for row in _rows(e):
        t_ns, rpm, _ = _of(frames, COMMANDS[row["address"]], "<hB")
        at = np.searchsorted(heard_ns, t_ns) - 1
        age_s = (t_ns - heard_ns[np.maximum(at, 0)]) / 1e9
        for i in np.flatnonzero((rpm != 0) & (at >= 0) & (age_s > after_s))[:3]:
            yield Finding(
                _seconds(e, t_ns[i]), f"{rpm[i]} rpm went to {row['name']} {age_s[i]:.1f} s after the last navigation"
            )
        idle = np.concatenate((e.record_modes == IDLE, [False]))
        for i in np.flatnonzero((rpm != 0) & (at >= 0) & idle[np.maximum(at, 0)] & (age_s < 0.1))[:3]:
            if e.mode_at(_seconds(e, t_ns[i])) == IDLE:
                yield Finding(_seconds(e, t_ns[i]), f"{rpm[i]} rpm went to {row['name']} in idle")


def reports_as_records(e: Evidence) -> Iterator[Finding]:
    frames, heard_ns = _bus(e), e.column("t4").astype(np.int64)
    for row in _rows(e):
        t_ns, rpm, _ = _of(frames, REPORTS[row["address"]], "<2xhB")
        if not len(t_ns):
            raise Unjudged(f"the black box has no report of {row['name']}")
        sign, known = -1 if row["reversed"] else 1, e.column(f"{row['name']}_rpm_measured").astype(float)
        at = np.searchsorted(t_ns, heard_ns + NEAR_NS) - 1
        last = [rpm[np.clip(at + each, 0, len(rpm) - 1)] * sign for each in (1, 0, -1, -2)]
        wrong = np.all([np.abs(known - each) > 0.5 for each in last], axis=0) & (at >= 2) & np.isfinite(known)
        for i in np.flatnonzero(wrong)[:3]:
            yield Finding(e.t_s[i], f"{row['name']} reported {last[1][i]} rpm, and the records say {known[i]:g}")


_LOG: Final = "log-format.md#the-black-box-log"
RULES: Final = (
    Rule("frames-as-records", "Each command of the records went to its propeller, and no other did.", _LOG, frames_as_records),
    Rule(
        "silence-on-bus", "Without navigation, and in idle, nothing turns a propeller.", "failsafe.md#the-table", silence_on_bus
    ),
    Rule("reports-as-records", "The records say what the propellers reported.", _LOG, reports_as_records),
)
