"""Rules of single records and of one record after another: time, commands, plausibility."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from delfim.audit.evidence import IDLE, LOOK_S, SAME_S, Evidence, Unjudged, repeats, spells
from delfim.audit.rule import Finding, Rule

ROUND: Final = 1e-4  # commands are logged with 32 bits
STAMPS: Final = ("t0", "t1", "t2", "t3", "t4")
STEP_S: Final = 0.25  # by which the wall clock may differ from the time since boot between two records
CHECKED_S: Final = 1.0  # the longest pause of the watchdog on a busy computer
LATE_S: Final = 1.0  # a notice that is as late is late on a busy computer, too
WAY_S: Final = 20.0  # over which way and speed are compared
WAY_M: Final = 12.0  # that positions may wander in that time
TURN_RAD: Final = 0.6  # the same of heading and rate of turn


def time_forward(e: Evidence) -> Iterator[Finding]:
    for name, column, least in (("time since boot", e.t_s, 0.0), ("number of the cycle", e.cycle, 1)):
        for at in np.flatnonzero(np.diff(column) < least):
            yield Finding(e.t_s[at + 1], f"the {name} goes from {column[at]} to {column[at + 1]}")
    # The wall clock may be stepped, by this program or another one: a stamp before the one ahead of it is no more than that.
    stamps = np.column_stack([e.column(name).astype(np.int64) for name in STAMPS])
    for at in np.flatnonzero((np.diff(stamps[:, 1:], axis=1) < -int(STEP_S * 1e9)).any(axis=1) & ~_stepped(e)):
        yield Finding(e.t_s[at], f"the stamps t1 to t4 do not follow one another: {stamps[at, 1:].tolist()}")
    times = [float(each["monotonic_s"]) for each in e.events if "monotonic_s" in each]
    for before, after in pairwise(times):
        if after < before - 0.1:
            yield Finding(after, f"an event of the sidecar at {after:.2f} s stands after one at {before:.2f} s")


def _stepped(e: Evidence) -> NDArray[np.bool_]:
    steps = np.abs(np.diff(e.column("t4") / 1e9 - e.t_s, prepend=0.0)) > STEP_S
    steps[0] = False
    return steps


def words_age(e: Evidence) -> Iterator[Finding]:
    for name, whose in (("console_s", "console"), ("guest_s", "guest"), ("watchdog_s", "watchdog")):
        column = e.column(name)
        for at in np.flatnonzero(column > e.t_s + 0.01):
            yield Finding(e.t_s[at], f"the last word of the {whose} is {column[at] - e.t_s[at]:.2f} s ahead of the record")
        for at in np.flatnonzero(np.diff(column) < -1e-6):
            yield Finding(e.t_s[at + 1], f"the last word of the {whose} goes back from {column[at]} s to {column[at + 1]} s")


def watchdog_looks(e: Evidence) -> Iterator[Finding]:
    age_s = e.t_s - e.column("watchdog_s")
    began = e.t_s > e.t_s[0] + CHECKED_S
    for first, last in spells((age_s > CHECKED_S) & began):
        yield Finding(e.t_s[first], f"the watchdog had not looked for {age_s[first : last + 1].max():.1f} s")


def commands_bounded(e: Evidence) -> Iterator[Finding]:
    for row in e.thrusters:
        name = row["name"]
        command = e.column(f"{name}_command").astype(float)
        for at in np.flatnonzero(~(np.abs(command) <= 1.0 + ROUND)):
            yield Finding(e.t_s[at], f"{name} is commanded {command[at]:g}")
        for key, full in ((f"{name}_rpm", _rpm_max(e, row)), (f"{name}_angle", _angle_max_rad(row))):
            if full and key in e.columns:
                its = e.column(key).astype(float)
                for at in np.flatnonzero(np.abs(its) > full * (1.0 + ROUND) + ROUND):
                    yield Finding(e.t_s[at], f"{key} is {its[at]:g}, at most {full:g} is allowed")
        if (full := _rpm_max(e, row)) and f"{name}_rpm" in e.columns:
            its = e.column(f"{name}_rpm").astype(float)
            for at in np.flatnonzero(np.abs(its - command * full) > 1.0):
                yield Finding(e.t_s[at], f"{name} is commanded {command[at]:g}, which is not {its[at]:g} of {full:g} rpm")


def _rpm_max(e: Evidence, row: Any) -> float:
    return float(row["rpm_max"] or (e.setting("dsor.rpm_max") if row["driver"] == "dsor" else 0.0))


def _angle_max_rad(row: Any) -> float:
    return float(np.radians(row["steer"]["angle_max_deg"])) if row.get("steer") else 0.0


def commands_gradual(e: Evidence) -> Iterator[Finding]:
    dt_s = np.diff(e.t_s)
    stops = np.array([each.t_s for each in e.words] + [each.t_s for each in e.modes])
    stopped = np.searchsorted(np.sort(stops), e.t_s[:-1] - 1e-6) < np.searchsorted(np.sort(stops), e.t_s[1:] + 1e-6)
    for row in e.thrusters:
        command = e.column(f"{row['name']}_command").astype(float)
        most = float(row["rate_per_s"]) * dt_s + 10 * ROUND
        change = np.abs(np.diff(command))
        fast = (change > most) & (command[1:] != 0.0) & ~(stopped & (np.abs(command[1:]) <= most)) & ~e.lost & (dt_s > 0.01)
        for at in np.flatnonzero(fast):
            words = f"{row['name']} goes from {command[at]:.3f} to {command[at + 1]:.3f} within {dt_s[at]:.2f} s"
            yield Finding(e.t_s[at + 1], f"{words}; its file says {row['rate_per_s']:g} a second")


def idle_commands_nothing(e: Evidence) -> Iterator[Finding]:
    idle = e.record_modes == IDLE
    for first, _ in spells(idle & e.is_driven):
        yield Finding(e.t_s[first], f"commands of {np.round(e.commands[first], 3).tolist()} in idle")
    for first, _ in spells(idle & e.column("run").astype(bool)):
        yield Finding(e.t_s[first], "the thrusters are enabled in idle")


def idle_propellers_rest(e: Evidence) -> Iterator[Finding]:
    idle_rpm, after_s = e.setting("failsafe.thruster.idle_rpm"), e.setting("failsafe.thruster.after_s")
    idle = (e.record_modes == IDLE) & ~e.is_driven
    for row in e.thrusters:
        key = f"{row['name']}_rpm_measured"
        if key not in e.columns:
            continue
        turning = idle & (np.abs(e.column(key)) > idle_rpm + 5.0)
        for first, last in e.unbroken(turning):
            begin_s, end_s = e.t_s[first], e.t_s[last]
            # The report of a node that fell silent stays in the records.
            is_told = e.is_told(["thruster"], begin_s + after_s, LATE_S) or e.is_told(
                ["sensor_bad"], begin_s + after_s, 3 * LATE_S
            )
            if end_s - begin_s > after_s + LATE_S and not is_told:
                words = f"{row['name']} turned for {end_s - begin_s:.1f} s in idle, and nobody was told"
                yield Finding(begin_s + after_s, words)


def way_plausible(e: Evidence) -> Iterator[Finding]:
    north_m, east_m = e.column("north"), e.column("east")
    steps_s = np.diff(e.t_s)
    whole = ~e.lost & (steps_s < 1.0)
    moved_m = [np.where(whole, e.column(each)[1:].astype(float) * steps_s, np.nan) for each in ("north_speed", "east_speed")]
    frozen_s = e.t_s[repeats(e)]
    troubled = np.zeros(len(e.t_s), bool)
    for from_s, to_s in _stretches(frozen_s):
        troubled |= (e.t_s >= from_s) & (e.t_s < to_s + WAY_S + 1.0)
    for alarm in e.named("navigation_jumping", "navigation_twice", "navigation_silent", "navigation_frozen", "gnss_poor"):
        troubled |= (e.t_s > alarm.begin_s - WAY_S) & (e.t_s < alarm.end_s + WAY_S)
    for jump in np.flatnonzero(np.hypot(np.diff(north_m), np.diff(east_m)) > float(e.setting("navigation.jump_m"))):
        troubled |= (e.t_s > e.t_s[jump]) & (e.t_s < e.t_s[jump] + WAY_S + 1.0)  # positions-steady judges it
    number = int(WAY_S / max(float(np.median(steps_s)), 0.01)) if len(steps_s) else 0
    if not 0 < number < len(e.t_s):
        raise Unjudged(f"it is shorter than {WAY_S:g} s")
    for name, place_m, along_m in (("north", north_m, moved_m[0]), ("east", east_m, moved_m[1])):
        sums_m = np.concatenate(([0.0], np.cumsum(along_m)))
        off_m = (place_m[number:] - place_m[:-number]) - (sums_m[number:] - sums_m[:-number])
        for first, _ in spells((np.abs(off_m) > WAY_M) & ~troubled[number:]):
            at = first + number
            yield Finding(e.t_s[at], f"positions went {off_m[first]:.1f} m farther {name} in {WAY_S:g} s than the speeds say")


def _stretches(times_s: NDArray[np.float64]) -> list[tuple[float, float]]:
    """The first and last of times that are less than a second apart."""
    if not len(times_s):
        return []
    ends = np.flatnonzero(np.diff(times_s) > 1.0)
    return list(zip(times_s[np.concatenate(([0], ends + 1))], times_s[np.concatenate((ends, [-1]))], strict=True))


def positions_steady(e: Evidence) -> Iterator[Finding]:
    most_mps, near_m = e.setting("navigation.jump_mps"), e.setting("navigation.jump_m")
    jump_m = np.hypot(np.diff(e.column("north")), np.diff(e.column("east")))
    frozen = repeats(e)
    for at in np.flatnonzero(jump_m > most_mps * np.diff(e.t_s) + near_m + 1.0):
        told = e.is_told(["navigation_jumping"], e.t_s[at + 1], 1.0)
        if not told and not e.lost[at] and not frozen[at]:
            yield Finding(e.t_s[at + 1], f"the boat believed a jump of {jump_m[at]:.0f} m")


def batteries_plausible(e: Evidence) -> Iterator[Finding]:
    for name in [each for each in e.columns if each.endswith("_charge")]:
        charge = e.column(name).astype(float)
        for at in np.flatnonzero(~np.isnan(charge) & ((charge < 0.0) | (charge > 1.0 + ROUND))):
            yield Finding(e.t_s[at], f"{name} is {charge[at]:g}")
        rising = np.diff(charge[~np.isnan(charge)])
        times = e.t_s[~np.isnan(charge)]
        for at in np.flatnonzero((rising > 0.05) & e.is_driven[~np.isnan(charge)][1:]):
            yield Finding(times[at + 1], f"{name} rises by {rising[at]:.2f} from one record to the next under way")
    for name in [each for each in e.columns if each.endswith("_voltage")]:
        volts = e.column(name)
        for at in np.flatnonzero(volts < 0.0):
            yield Finding(e.t_s[at], f"{name} is {volts[at]:g} V")


def manual_as_ordered(e: Evidence) -> Iterator[Finding]:
    """By a console: sticks of a hand-set are not in the log."""
    if e.setting("handset.device"):
        raise Unjudged("the boat has a hand-set, whose sticks are not in the log")
    manual, orders = e.record_modes == "manual", [each for each in e.orders if each.name == "manual" and not each.refused]
    for row in e.thrusters:
        asked = [(each.t_s, float(each.value[row["name"]])) for each in orders if row["name"] in each.value]
        if not asked:
            continue
        times, values = np.array(asked).T
        changed = times[np.concatenate(([True], np.diff(values) != 0.0))]  # a stick that rests says the same again
        last = np.searchsorted(times, e.t_s - 0.01) - 1
        since_s = e.t_s - changed[np.maximum(np.searchsorted(changed, e.t_s + SAME_S) - 1, 0)]
        for begin, end in spells(manual):
            since_s[begin : end + 1] = np.minimum(since_s[begin : end + 1], e.t_s[begin : end + 1] - e.t_s[begin])
        command, full_s = e.column(f"{row['name']}_command").astype(float), 2.0 / float(row["rate_per_s"]) + LOOK_S
        wrong = manual & (last >= 0) & (command != 0.0) & (since_s > full_s)
        wrong &= np.abs(command - values[np.maximum(last, 0)]) > 0.01
        for first, _ in spells(wrong):
            words = f"{row['name']} is commanded {command[first]:.3f}"
            yield Finding(e.t_s[first], f"{words}, {values[last[first]]:.3f} was ordered by hand")


def steers_as_ordered(e: Evidence) -> Iterator[Finding]:
    if e.setting("traffic.guard.enabled") and np.isfinite(e.column("order_course")).any():
        raise Unjudged("the guard altered course for other vessels")
    heading = e.column("reference_heading")
    orders = [each for each in e.orders if not each.refused]
    for order, after in zip(orders, [*orders[1:], None], strict=False):
        asked = order.value.get("heading_deg")
        if order.name != "heading" or not isinstance(asked, float | int):
            continue
        until_s = min(after.t_s if after else e.end_s, *(m.t_s for m in e.modes if m.t_s > order.t_s + 0.01), e.end_s)
        during = (e.record_modes == "heading") & (e.t_s > order.t_s + LOOK_S) & (e.t_s < until_s - 0.01)
        off_rad = np.angle(np.exp(1j * (heading - np.radians(asked))))
        for at in np.flatnonzero(during & ~(np.abs(off_rad) < 0.01))[:1]:
            yield Finding(e.t_s[at], f"control steers for {np.degrees(heading[at]):.1f} degrees, {asked:.1f} was ordered")


RULES: Final = (
    Rule("time-forward", "Time since boot and cycles run forward, in records and events.", "log-format.md", time_forward),
    Rule(
        "words-age",
        "The last words of console, guest and watchdog lie in the past and never go back.",
        "log-format.md",
        words_age,
    ),
    Rule("watchdog-looks", "The boat looks for troubles all the time, ten times a second.", "failsafe.md", watchdog_looks),
    Rule(
        "commands-bounded",
        "Each command is finite and within ±1, and its revolutions and angle within theirs.",
        "control.md",
        commands_bounded,
    ),
    Rule(
        "commands-gradual", "No command grows faster than rate_per_s; only a stop is immediate.", "control.md", commands_gradual
    ),
    Rule("idle-commands-nothing", "In idle no thruster is commanded or enabled.", "control.md", idle_commands_nothing),
    Rule(
        "idle-propellers-rest",
        "A propeller that turns in idle for failsafe.thruster.after_s is told of.",
        "failsafe.md#the-table",
        idle_propellers_rest,
    ),
    Rule(
        "way-plausible",
        "Positions go where the speeds say, but for a jump that jump_m and jump_mps allow, unless a trouble is told.",
        "failsafe.md#the-table",
        way_plausible,
    ),
    Rule(
        "positions-steady",
        "A position more than navigation.jump_m beyond what navigation.jump_mps allows is not believed.",
        "failsafe.md#the-table",
        positions_steady,
    ),
    Rule(
        "batteries-plausible",
        "Charge is within 0 and 1 and does not rise under way; no voltage is negative.",
        "log-format.md",
        batteries_plausible,
    ),
    Rule("manual-as-ordered", "By hand a thruster does what was ordered, or nothing.", "control.md", manual_as_ordered),
    Rule(
        "steers-as-ordered", "In heading mode control steers for the heading that was ordered.", "control.md", steers_as_ordered
    ),
)
