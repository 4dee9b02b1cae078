"""Rules of the failsafe table: a trouble is noticed in its time, acted upon as the table says, and ends."""

import math
import re
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from delfim.audit.evidence import (
    ACTIONS,
    IDLE,
    LEADS,
    LOOK_S,
    SAME_S,
    TROUBLES,
    Evidence,
    LoggedTrouble,
    Noted,
    Unjudged,
    repeats,
    spells,
)
from delfim.audit.rule import Finding, Rule

FOR_S: Final = re.compile(r"(?:silent|lost|frozen|command|hanging) for ([0-9.]+) s")
PAUSE: Final = re.compile(r"; home in [0-9.]+ s")
HARMLESS: Final = ("warn", "disconnect")
SURE_S: Final = 1.0  # a notice that is as late is late on a busy computer, too
HANGS_S: Final = 5.0  # a writer that hangs is noticed only then
FIXES: Final = {"2d": 2, "3d": 3}  # the numbers of those that need no corrections


def table_obeyed(e: Evidence) -> Iterator[Finding]:
    for alarm in e.alarms:
        for told in alarm.told:
            yield from _told_as_table(e, alarm, told)


def _told_as_table(e: Evidence, alarm: LoggedTrouble, told: Noted) -> Iterator[Finding]:
    """Whether the action agrees with the row of one of the modes about this time: the mode before counts."""
    modes = e.modes_about(told.t_s, LOOK_S)
    rows = {mode: e.action(alarm.name, mode) for mode in modes}
    if told.action == "disconnect":
        if alarm.name != "thruster" or not e.setting("failsafe.thruster.disconnect"):
            yield Finding(told.t_s, f"{alarm.name}: {told.action}, which no row of the table says")
        idle_s, after_s = told.t_s - e.entered_s(told.t_s), float(e.setting("failsafe.thruster.after_s"))
        if modes != {IDLE} or idle_s < after_s - LOOK_S:
            yield Finding(
                told.t_s, f"{alarm.name} ({told.words}): {told.action} after {idle_s:.1f} s in idle; after_s is {after_s:g}"
            )
        return
    allowed = set(rows.values())
    if allowed & {"home", "back", "unstick"}:
        allowed |= {"hold"}  # the pause before, and without a driven track
    if "; cannot hold" in told.words or "; cannot" in told.words:
        allowed |= {"stop"}
    if told.action not in allowed and ACTIONS.index(told.action) > max(map(ACTIONS.index, allowed)):
        said = ", ".join(f"{action} in {mode}" for mode, action in sorted(rows.items()))
        yield Finding(told.t_s, f"{alarm.name} ({told.words}): {told.action}; the table says {said}")
    elif told.action == "warn" and "warn" not in allowed and told is alarm.told[0] and not _is_excused(e, alarm):
        mode, action = min(rows.items())
        yield Finding(told.t_s, f"{alarm.name} ({told.words}) only warns; the table says {action} in {mode}")


def _is_excused(e: Evidence, alarm: LoggedTrouble) -> bool:
    """Whether the documents allow it only to warn: other thrusters carry on; the boat is where the action leads to."""
    return alarm.name in ("thruster", "handset_silent", "manual_silent") or e.mode_at(alarm.begin_s) in (
        *LEADS[e.action(alarm.name, e.mode_at(alarm.begin_s))],
        IDLE,
    )


def action_taken(e: Evidence) -> Iterator[Finding]:
    for alarm in e.alarms:
        for told in alarm.told:
            if told.action in HARMLESS:
                continue
            reached = {e.mode_at(told.t_s), *(each.mode for each in e.changes(told.t_s + LOOK_S / 2, LOOK_S / 2))}
            if not reached & {*LEADS[told.action], IDLE} and not _is_ordered(e, told.t_s):
                yield Finding(
                    told.t_s, f"{alarm.name} ({told.words}): {told.action}, but the boat went on in {', '.join(reached)}"
                )


def _is_ordered(e: Evidence, t_s: float) -> bool:
    return bool(e.obeyed(t_s, LOOK_S))


def home_after_pause(e: Evidence) -> Iterator[Finding]:
    pause_s, clear_s = (float(e.setting(f"failsafe.{key}")) for key in ("pause_s", "clear_s"))
    for alarm in e.alarms:
        pauses = [told for told in alarm.told if told.action == "hold" and PAUSE.search(told.words)]
        home = next((told for told in alarm.told if told.action == "home"), None)
        if pauses and home and home.t_s - pauses[0].t_s < pause_s - LOOK_S:
            words = f"{alarm.name}: home {home.t_s - pauses[0].t_s:.1f} s after it was told"
            yield Finding(home.t_s, f"{words}; the operator has failsafe.pause_s, {pause_s:g} s, to overrule")
        over_s = pauses[0].t_s + pause_s if pauses else math.inf
        last_s = min(alarm.end_s, e.end_s)
        if over_s + SURE_S > last_s or home:
            continue
        warned_s = alarm.told[-1].t_s if alarm.told[-1].action == "warn" else math.inf
        near = (each for each in e.modes if pauses[0].t_s - SAME_S < each.t_s < min(warned_s, over_s) + LOOK_S)
        entered = any(each.mode != "hold" or each.reason.startswith("operator") for each in near)
        if not entered and (warned_s > over_s + SURE_S or last_s - warned_s > clear_s + SURE_S):
            yield Finding(over_s, f"{alarm.name}: the pause is over, and the boat does not go home")


def told_in_time(e: Evidence) -> Iterator[Finding]:
    for alarm in e.alarms:
        first = alarm.told[0]
        match = FOR_S.search(first.words)
        if not match or alarm.name == "sensor_bad" or alarm.name == "log":
            continue
        since_s, after_s = float(match[1]), float(e.setting(f"failsafe.{alarm.name}.after_s"))
        own_s = float(e.setting("failsafe.ais_silent.own_s")) if alarm.name == "ais_silent" else after_s
        if since_s < min(after_s, own_s) - 0.06:
            yield Finding(first.t_s, f"{alarm.name} ({first.words}) is told too early: after_s is {after_s:g}")
        if alarm.name == "navigation_frozen":
            continue  # it counts from before the thrusters turned
        is_new = first.t_s - e.entered_s(first.t_s) > SURE_S or _acted(e, alarm)
        if is_new and since_s > after_s + SURE_S and first.t_s - e.t_s[0] > after_s + SURE_S and not _again(e, alarm):
            yield Finding(first.t_s, f"{alarm.name} ({first.words}) is told too late: after_s is {after_s:g}")


def _acted(e: Evidence, alarm: LoggedTrouble) -> bool:
    return any(each.reason == alarm.told[0].words for each in e.changes(alarm.begin_s, SAME_S))


def _again(e: Evidence, alarm: LoggedTrouble) -> bool:
    """Whether it ended a moment ago, as where another mode required it."""
    return any(each.end_s <= alarm.begin_s < each.end_s + SURE_S for each in e.named(alarm.name))


def notices_end(e: Evidence) -> Iterator[Finding]:
    clear_s = float(e.setting("failsafe.clear_s"))
    for alarm in e.alarms:
        lasted_s = alarm.end_s - alarm.told[0].t_s
        if math.isfinite(alarm.end_s) and lasted_s < clear_s - LOOK_S:
            yield Finding(
                alarm.end_s, f"{alarm.name} is over after {lasted_s:.1f} s; it must be absent for clear_s, {clear_s:g} s"
            )


def bits_as_notices(e: Evidence) -> Iterator[Finding]:
    bits = e.column("troubles").astype(np.int64)
    for number, name in enumerate(TROUBLES):
        is_set = (bits >> number & 1).astype(bool)
        least, most = np.zeros(len(bits), bool), np.zeros(len(bits), bool)
        for alarm in e.named(name):
            least |= (e.t_s > alarm.begin_s + LOOK_S) & (e.t_s < alarm.end_s - LOOK_S)
            most |= (e.t_s > alarm.begin_s - LOOK_S) & (e.t_s < alarm.end_s + LOOK_S)
        for first, _ in spells(is_set & ~most):
            yield Finding(e.t_s[first], f"the records tell of {name}, and no note does")
        for first, _ in spells(~is_set & least):
            yield Finding(e.t_s[first], f"{name} was told and is not over, and the records know nothing of it")


def _due(e: Evidence, name: str, present: NDArray[np.bool_], after_s: float, what: str) -> Iterator[Finding]:
    """The stretches of records in which a condition lasts longer than its time, and was not reported."""
    for first, last in e.unbroken(present):
        due_s = e.t_s[first] + after_s + SURE_S
        if e.t_s[last] > due_s and not any(each.begin_s <= due_s and each.end_s > e.t_s[first] for each in e.named(name)):
            yield Finding(due_s, f"{what} since {e.t_s[first]:.1f} s, and {name} was not told within {after_s:g} s")


def navigation_heard(e: Evidence) -> Iterator[Finding]:
    """Without messages there are no records: the next one comes late, and its cycle is the next."""
    after_s = max(float(e.setting("failsafe.navigation_silent.after_s")), 0.0)
    for at in np.flatnonzero((np.diff(e.t_s) > after_s + SURE_S) & ~e.lost):
        begin_s, end_s = float(e.t_s[at]), float(e.t_s[at + 1])
        due_s = begin_s + after_s + SURE_S
        if not e.is_told(["navigation_silent"], due_s, 0.0):
            yield Finding(due_s, f"no navigation from {begin_s:.1f} to {end_s:.1f} s, and nobody was told")
        mode = e.mode_at(due_s)
        if e.action("navigation_silent", e.mode_at(begin_s)) == "stop" and mode != IDLE:
            yield Finding(due_s, f"no navigation since {begin_s:.1f} s, and the boat goes on in {mode}")


def navigation_moves(e: Evidence) -> Iterator[Finding]:
    if e.setting("navigation.estimator"):
        raise Unjudged("the estimator's navigation never repeats; its inputs are not in the records")
    after_s = float(e.setting("failsafe.navigation_frozen.after_s"))
    same = repeats(e) & ~np.concatenate(([False], e.lost))
    yield from _due(e, "navigation_frozen", same & e.is_driven, after_s, "navigation repeats itself while thrusters turn")


def console_heard(e: Evidence) -> Iterator[Finding]:
    after_s = float(e.setting("failsafe.console_silent.after_s"))
    heard_s = e.column("console_s")
    silent = (e.t_s - heard_s > after_s) & (heard_s > 0.0) & (e.record_modes != IDLE)
    yield from _due(e, "console_silent", silent, 0.0, "the console was silent for longer than its limit")
    for alarm in e.named("console_silent"):
        at = e.last(alarm.begin_s)
        if at is not None and alarm.begin_s - heard_s[at] < after_s - SURE_S and heard_s[at] > 0:
            yield Finding(alarm.begin_s, f"console_silent is told {alarm.begin_s - heard_s[at]:.1f} s after its last word")


def guest_heard(e: Evidence) -> Iterator[Finding]:
    after_s = float(e.setting("failsafe.guest_silent.after_s"))
    silent = (e.t_s - e.column("guest_s") > after_s) & (e.record_modes == "grex")
    programs = (name for name in e.columns if name.startswith("payload_") and name.endswith("_s"))
    for number, name in enumerate(programs, 1):
        silent |= (e.t_s - e.column(name) > after_s) & (e.column("helmsman") == number)
    yield from _due(e, "guest_silent", silent, 0.0, "who steered the boat was silent for longer than the limit")


def manual_heard(e: Evidence) -> Iterator[Finding]:
    """Thrust by hand ends with the orders; after after_s the mode does."""
    if e.setting("handset.device"):
        raise Unjudged("the boat has a hand-set, whose sticks are not in the log")
    thrust_s, after_s = (float(e.setting(f"failsafe.manual_silent.{key}")) for key in ("thrust_s", "after_s"))
    given = [each.t_s for each in e.orders if each.name in ("manual", "mode") and not each.refused]
    if not given:
        return
    times = np.array(given)
    places = np.searchsorted(times, e.t_s + 1e-6) - 1
    age_s = np.where(places >= 0, e.t_s - times[np.maximum(places, 0)], 0.0)
    manual = e.record_modes == "manual"
    for first, _ in spells(manual & e.is_driven & (age_s > thrust_s + LOOK_S + SURE_S)):
        yield Finding(e.t_s[first], f"thrust by hand {age_s[first]:.1f} s after the last order; thrust_s is {thrust_s:g}")
    if e.action("manual_silent", "manual") == "stop":
        for first, _ in spells(manual & (age_s > after_s + SURE_S)):
            yield Finding(e.t_s[first], f"manual mode {age_s[first]:.1f} s after the last order; after_s is {after_s:g}")


def batteries_watched(e: Evidence) -> Iterator[Finding]:
    sides = [name for name in e.columns if name.endswith("_charge")]
    if not sides:
        raise Unjudged("the log has no field of a battery's charge")
    charges = np.column_stack([e.column(name).astype(float) for name in sides])
    least = np.where(np.isnan(charges).all(axis=1), np.nan, np.nanmin(np.where(np.isnan(charges), 9.0, charges), axis=1))
    for name in ("battery_low", "battery_critical"):
        charge, after_s = (float(e.setting(f"failsafe.{name}.{key}")) for key in ("charge", "after_s"))
        what = f"a battery has {charge:.0%} or less"
        yield from _due(e, name, least <= charge - 0.003, after_s, what)
        if float(e.setting(f"failsafe.{name}.voltage_v")):
            continue
        for alarm in e.named(name):
            at = e.last(alarm.begin_s)
            if at is not None and least[at] > charge + 0.008:
                yield Finding(alarm.begin_s, f"{name} is told with {least[at]:.1%} in the emptier battery")


def reception_watched(e: Evidence) -> Iterator[Finding]:
    table = e.setting("failsafe.gnss_poor")
    satellites, fix = e.column("satellites").astype(int), e.column("fix").astype(int)
    poor = (satellites > 0) & (satellites < int(table["satellites"]))
    poor |= (fix > 0) & (fix < FIXES.get(table["fix"], 0)) & (satellites > 0)
    if table["accuracy_m"]:
        poor |= e.column("accuracy") > table["accuracy_m"]
    if table["corrections_s"]:
        poor |= e.column("corrections_age") > table["corrections_s"]
    yield from _due(e, "gnss_poor", poor, float(table["after_s"]), "satellite navigation is poor")
    for alarm in e.named("gnss_poor"):
        match = re.search(r"poor: ([0-9]+) satellites", alarm.told[0].words)
        if match and int(match[1]) >= int(table["satellites"]):
            yield Finding(alarm.begin_s, f"gnss_poor is told with {match[1]} satellites")


def thrusters_obey(e: Evidence) -> Iterator[Finding]:
    """Judged against all commands of the time that the table allows, so that none is late because it has just changed."""
    table = e.setting("failsafe.thruster")
    driven, after_s = e.record_modes != IDLE, float(table["after_s"])
    for row in e.thrusters:
        name = row["name"]
        if f"{name}_rpm" not in e.columns or f"{name}_rpm_measured" not in e.columns:
            continue
        command, measured = e.column(f"{name}_rpm").astype(float), e.column(f"{name}_rpm_measured").astype(float)
        limit = float(table["error_rpm"]) + float(table["error"]) * np.abs(command)
        for first, last in e.unbroken(driven & (np.abs(measured - command) > limit)):
            due_s = e.t_s[first] + after_s + SURE_S
            if e.t_s[last] <= due_s or e.is_told(["thruster"], due_s, 0.0):
                continue
            window = command[first : int(np.searchsorted(e.t_s, due_s))]
            at = measured[first : first + len(window)]
            low, high = window.min() - limit[first : first + len(window)], window.max() + limit[first : first + len(window)]
            if ((at < low) | (at > high)).all():
                words = f"{name} turns {at[-1]:.0f} instead of {window[-1]:.0f} rpm since {e.t_s[first]:.1f} s"
                yield Finding(due_s, f"{words}, and nobody was told")


def log_kept(e: Evidence) -> Iterator[Finding]:
    after_s = float(e.setting("failsafe.log.after_s"))
    missing = np.diff(e.cycle) - 1
    unlogged_s = missing * float(np.median(np.diff(e.t_s))) if len(missing) else missing
    for at in np.flatnonzero(unlogged_s > after_s + HANGS_S + SURE_S):
        if not any(each.begin_s <= e.t_s[at + 1] + LOOK_S and each.end_s >= e.t_s[at] for each in e.named("log")):
            yield Finding(e.t_s[at], f"{missing[at]} records are missing until {e.t_s[at + 1]:.1f} s, and nobody was told")


_TABLE: Final = "failsafe.md#the-table"
RULES: Final = (
    Rule(
        "table-obeyed", "A trouble is told with the action of its row and mode, and with no stronger one.", _TABLE, table_obeyed
    ),
    Rule("action-taken", "The mode of the action follows at once.", _TABLE, action_taken),
    Rule("home-after-pause", "Home begins failsafe.pause_s after it was told, and it begins.", _TABLE, home_after_pause),
    Rule("told-in-time", "A silence is told when it has lasted for after_s, neither sooner nor later.", _TABLE, told_in_time),
    Rule("notices-end", "A trouble is over when it was absent for clear_s, not sooner.", _TABLE, notices_end),
    Rule(
        "bits-as-notices",
        "The bits of the records and the notes of the sidecar tell the same troubles.",
        _TABLE,
        bits_as_notices,
    ),
    Rule(
        "navigation-heard",
        "Without navigation for navigation_silent.after_s the boat tells, and acts, in every mode.",
        _TABLE,
        navigation_heard,
    ),
    Rule(
        "navigation-moves", "Navigation that repeats itself while thrusters turn is told as frozen.", _TABLE, navigation_moves
    ),
    Rule(
        "console-heard",
        "A console that is silent for console_silent.after_s under way is told of, and no other.",
        _TABLE,
        console_heard,
    ),
    Rule(
        "guest-heard",
        "A guest that is silent for guest_silent.after_s in GREX mode, or a payload program that has the boat, is told of.",
        _TABLE,
        guest_heard,
    ),
    Rule("manual-heard", "Thrust by hand ends thrust_s, and the mode after_s after the last order.", _TABLE, manual_heard),
    Rule(
        "batteries-watched",
        "An emptier battery at its charge is told of after after_s, and no other.",
        _TABLE,
        batteries_watched,
    ),
    Rule("reception-watched", "Poor satellite navigation is told of after after_s.", _TABLE, reception_watched),
    Rule(
        "thrusters-obey",
        "A thruster that reports other revolutions than commanded for after_s is told of.",
        _TABLE,
        thrusters_obey,
    ),
    Rule("log-kept", "Records that are missing for log.after_s are told of.", _TABLE, log_kept),
)
