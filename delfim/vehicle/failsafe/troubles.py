"""Troubles: a function for each, which returns its reason in the present state or None, and its row in `Trigger`, or in that of
its part.

The class of its name in `delfim/config.py` gives how long it must last and the actions. Troubles with an age of their own
compare it with `after_s` themselves: their class is a `config.Silence`.
"""

import math
from collections.abc import Callable, Collection, Container, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple, Self

from delfim import config
from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.base.parts import OWN, TroubleRow
from delfim.canproxy.dsor.messages import BatteriesStatus, Node
from delfim.vehicle import inputhealth
from delfim.vehicle.failsafe import nodehealth
from delfim.vehicle.navigation import gnss
from delfim.vehicle.plans.fence import Fence, ahead, left, outside
from delfim.vehicle.report import HandsetReport
from delfim.vehicle.state import Actuation, State, ThrusterReport
from delfim.vehicle.target import NEVER_S

TURNING: Final = 0.04  # of full command; below this a propeller moves no boat
SURE: Final = 0.3  # of full command; above this a propeller turns, whatever its revolutions
DEAD_V: Final = 5.0  # no battery of a thruster is so low
STILL_RADPS: Final = math.radians(1.5)  # a slower turn is none: gyros have noise
_GOING: Final = Mode.HEADING, Mode.COURSE, Mode.GREX, Mode.GOTO, Mode.PLAY, Mode.PATH, Mode.HOME
_PROPELLERS: Final = (nodehealth.NAMES[Node.PROPELLER_STARBOARD], nodehealth.NAMES[Node.PROPELLER_PORT])
FRESH_S: Final = 1.0  # an older report of a propeller does not count
CHARGE_BACK: Final = 0.02  # a battery is low until it has this much more charge, ...
VOLTAGE_BACK: Final = 1.05  # ... or so many times the voltage: it rises when the load is gone
_BATTERIES: Final = (nodehealth.NAMES[Node.BATTERIES_STARBOARD], nodehealth.NAMES[Node.BATTERIES_PORT])


class Inputs(NamedTuple):
    """Inputs of the troubles other than the state."""

    log_reason: str  # why the log is not written, in words; empty while it is
    fence: Fence | None  # None: there is none
    astray: Mapping[str, str] = MappingProxyType({})  # thrusters that do not do as commanded, as `astray` tells them


@dataclass(slots=True)
class Look:
    """The data that a trouble is judged by. Slots, because all troubles together ask for some fifty fields."""

    settings: config.Vehicle
    state: State
    inputs: Inputs
    present: Container[int]  # the troubles that were there already
    now_s: float


def kill(look: Look) -> str | None:
    """The kill, and whether a relay cut the power of the thrusters, which is no fault of theirs then."""
    reason = look.state.killed.reason
    return f"kill: {reason}" + ("; the thrusters have no power" if _has_no_power(look) else "") if reason else None


def _has_no_power(look: Look) -> bool:
    """The boat is killed, and all thrusters that ever reported are silent or without voltage."""
    if not look.state.killed.reason:
        return False
    reports, stale_s = look.state.thrusters.values(), look.settings.sysstat.stale_s
    return bool(reports) and all(
        look.now_s - each.heard_s > stale_s or (each.voltage_v is not None and each.voltage_v < DEAD_V) for each in reports
    )


def handset_silent(look: Look) -> str | None:
    told = look.state.handset
    is_heard = told is not None and look.now_s - told.heard_s <= look.settings.failsafe.handset_silent.after_s
    return None if is_heard else handset_missed(look.settings.handset, told, look.now_s) or None


def handset_missed(settings: config.HandsetTable, told: HandsetReport | None, now_s: float) -> str:
    """Why the hand-set cannot take the boat, in words; empty: it can, or there is none."""
    if not settings.device:
        return ""
    if told is None:
        return "hand-set not heard yet"
    age_s = now_s - told.heard_s
    if told.lost:
        return f"hand-set lost for {age_s:.1f} s: {told.lost}"
    return f"hand-set silent for {age_s:.1f} s" if age_s > settings.silent_s else ""


def control(look: Look) -> str | None:
    reference = look.state.reference
    return reference.reason if look.state.mode is not Mode.IDLE and not reference.done else None


def navigation_jumping(look: Look) -> str | None:
    state, settings = look.state, look.settings
    after_s, stale_s = settings.failsafe.navigation_jumping.after_s, settings.navigation.stale_s
    if state.jumped_s - state.jumping_s >= after_s and look.now_s - state.jumped_s <= stale_s:
        return f"position jumped by {state.jumped_m:.0f} m"
    return inputhealth.jumping(_inputs(state), look.now_s, after_s, stale_s)


def _inputs(state: State) -> tuple[inputhealth.InputHealth, ...]:
    """Of the estimator that made the present navigation; none where no estimator did."""
    return state.inputs.get(state.source, ())


def navigation_silent(look: Look) -> str | None:
    age_s, after_s = look.now_s - look.state.navigation_s, look.settings.failsafe.navigation_silent.after_s
    if age_s <= after_s:
        return inputhealth.silent(_inputs(look.state), look.now_s, after_s)
    return "no navigation yet" if look.state.navigation is None else f"navigation silent for {age_s:.1f} s"


def navigation_frozen(look: Look) -> str | None:
    state, age_s, after_s = look.state, look.now_s - look.state.changed_s, look.settings.failsafe.navigation_frozen.after_s
    if state.mode is Mode.IDLE:
        return None
    words = f"navigation frozen for {age_s:.1f} s" if age_s > after_s else None
    if words is None and (words := inputhealth.frozen(_inputs(state), look.now_s, after_s)) is None:
        return None
    turns = state.actuation.run and max(map(abs, state.actuation.thrust), default=0.0) > TURNING
    return words if turns else None


def navigation_twice(look: Look) -> str | None:
    twice = look.state.twice
    if len(twice) < 3 or look.now_s - twice[0] > look.settings.failsafe.navigation_twice.after_s:
        return None
    return "two senders of navigation: messages of its node do not follow one another, and nobody knows which are true"


def sensor_bad(look: Look) -> str | None:
    state, since_s = look.state, look.state.started_s  # each has its time to report
    but: Collection[str] = _PROPELLERS if _has_no_power(look) else ()
    wrong = nodehealth.wrong(state, look.settings.sysstat, look.now_s, but, since_s)
    return wrong or unheard(look.settings.sensors, state, look.now_s, since_s)


def unheard(settings: config.Sensors, state: State, now_s: float, since_s: float = NEVER_S) -> str | None:
    """The first required value of a sensor that is not there, in words; one that never was counts as heard at `since_s`."""
    for name in settings.required:
        age_s = now_s - state.measured.get(name, (0.0, since_s))[1]
        if age_s > settings.stale_s:
            return f"{name} silent for {age_s:.1f} s" if name in state.measured else f"{name} not heard yet"
    return None


def battery_critical(look: Look) -> str | None:
    return low(
        look.settings, look.settings.failsafe.battery_critical, look.state, look.now_s, Trigger.BATTERY_CRITICAL in look.present
    )


def battery_low(look: Look) -> str | None:
    return low(look.settings, look.settings.failsafe.battery_low, look.state, look.now_s, Trigger.BATTERY_LOW in look.present)


def thruster(look: Look) -> str | None:
    state = look.state
    words = ", ".join({**look.inputs.astray, **state.failed}.values())
    return f"{words}: {state.unsteerable}" if words and state.unsteerable else words or None


def manual_silent(look: Look) -> str | None:
    age_s = look.now_s - look.state.manual_s
    silent = look.state.mode is Mode.MANUAL and age_s > look.settings.failsafe.manual_silent.after_s
    return f"no manual command for {age_s:.1f} s" if silent else None


def console_silent(look: Look) -> str | None:
    age_s = look.now_s - look.state.console_s
    silent = look.state.mode is not Mode.IDLE and age_s > look.settings.failsafe.console_silent.after_s
    return f"console silent for {age_s:.1f} s" if silent else None


def guest_silent(look: Look) -> str | None:
    state, name = look.state, look.state.helmsman  # a payload program that has the boat is a guest
    age_s = look.now_s - (state.payloads_s[name] if name else state.guest_s)
    silent = (name or state.mode is Mode.GREX) and age_s > look.settings.failsafe.guest_silent.after_s
    return f"{f'no word from payload {name}' if name else 'guest silent'} for {age_s:.1f} s" if silent else None


def fence(look: Look) -> str | None:
    around, mode, motion = look.inputs.fence, look.state.mode, look.state.motion
    if around is None:
        return None
    if "position" not in motion.has:
        return None if mode in (Mode.IDLE, Mode.MANUAL) else "no position: the fence cannot be watched"
    return outside(around, motion.north_m, motion.east_m) if mode is Mode.IDLE else ahead(around, motion)


def fence_left(look: Look) -> str | None:
    around, motion = look.inputs.fence, look.state.motion
    if around is None or look.state.mode is Mode.IDLE or "position" not in motion.has:
        return None
    return left(around, motion)


def gnss_poor(look: Look) -> str | None:
    return gnss.poor(look.settings.failsafe.gnss_poor, look.state.navigation)


def shallow(look: Look) -> str | None:
    least_m = look.settings.failsafe.shallow.min_depth_m
    depth_m, at_s = look.state.measured.get("depth_m", (math.inf, look.now_s))
    is_shallow = depth_m < least_m and look.now_s - at_s <= look.settings.sensors.stale_s
    return f"shallow: {depth_m:.1f} m of water" if is_shallow else None


def stuck(look: Look) -> str | None:
    state, motion, limits = look.state, look.state.motion, look.settings.failsafe.stuck
    asked = state.reference
    if state.mode not in _GOING or not state.actuation.run or "velocity" not in motion.has:
        return None
    speed_mps, push = math.hypot(motion.north_mps, motion.east_mps), _ahead(look.settings, state.actuation)
    if (asked.speed_mps or 0.0) >= 2.0 * limits.speed_mps > 2.0 * speed_mps and push >= limits.thrust:
        return f"stuck: {speed_mps:.1f} m/s at {push:.0%} thrust: aground, in weeds, or the current is as fast"
    if asked.heading_rad is None or "heading" not in motion.has or abs(motion.yaw_rate_radps) > STILL_RADPS:
        return None
    off_deg, most = abs(math.degrees(wrap(asked.heading_rad - motion.heading_rad))), max(map(abs, state.actuation.thrust))
    is_stuck = off_deg > limits.turn_deg and most >= limits.thrust
    return f"stuck: {off_deg:.0f} degrees off its heading, and it does not turn at {most:.0%} thrust" if is_stuck else None


def _ahead(settings: config.Vehicle, actuation: Actuation) -> float:
    """The thrust ahead, -1..1 of what all thrusters together give."""
    ahead = [math.cos(math.radians(row.angle_deg)) for row in settings.thrusters]
    pushes = zip(ahead, actuation.thrust, actuation.angle_rad, strict=False)
    return sum([each * part * math.cos(angle_rad) for each, part, angle_rad in pushes]) / (sum(map(abs, ahead)) or 1.0)


def capsized(look: Look) -> str | None:
    told = look.state.navigation
    roll_deg = abs(math.degrees(told.roll_rad)) if told is not None and told.roll_rad is not None else 0.0
    return f"capsized: {roll_deg:.0f} degrees of roll" if roll_deg > look.settings.failsafe.capsized.roll_deg else None


def beyond(look: Look) -> str | None:
    limits, measured, stale_s = look.settings.failsafe.beyond, look.state.measured, look.settings.sensors.stale_s
    for word, bounds, sign in ("above", limits.above, 1.0), ("below", limits.below, -1.0):
        for name, bound in bounds.items():
            value, at_s = measured.get(name, (math.nan, look.now_s))
            if sign * (value - bound) > 0.0 and look.now_s - at_s <= stale_s:
                return f"{name} is {value:g}, {word} {bound:g}"
    return None


def outlet(look: Look) -> str | None:
    return outlet_missed(look.settings, look.state, look.now_s) or None


def outlet_missed(settings: config.Vehicle, state: State, now_s: float) -> str:
    """Why motors that are told by pulses may turn whatever they are told, in words; empty: they do not, or there are none. A
    pulse stands until the outlet writes another one."""
    row = next((row for row in settings.thrusters if settings.drives(row).outlet), None)
    if row is None:
        return ""
    report = state.thrusters.get(row.name)
    if report is None:
        return "the motors may turn: the outlet, which writes their pulses, has not answered yet"
    age_s = now_s - report.heard_s
    if age_s > settings.failsafe.outlet.after_s:
        return f"the motors may turn: the outlet, which writes their pulses, has been silent for {age_s:.1f} s"
    return f"the motors may turn: {report.refuses}" if report.refuses and not state.actuation.run else ""


def log(look: Look) -> str | None:
    return f"log not written: {look.inputs.log_reason}" if look.inputs.log_reason else None


def restarted(look: Look) -> str | None:
    return look.state.restarted or None


class Trigger(IntEnum):
    """The troubles, named as in the vehicle's file, with their numbers (bits in the log) and detecting functions. Of two
    with the same action the first one gives the reason."""

    sees: Callable[[Look], str | None]

    def __new__(cls, number: int, sees: Callable[[Look], str | None]) -> Self:
        trigger = int.__new__(cls, number)
        trigger._value_, trigger.sees = number, sees
        return trigger

    CONTROL = 0, control  # the mode cannot go on: its inputs are missing or make no sense; always a stop
    NAVIGATION_JUMPING = 1, navigation_jumping
    NAVIGATION_SILENT = 2, navigation_silent
    NAVIGATION_FROZEN = 3, navigation_frozen
    SENSOR_BAD = 4, sensor_bad
    BATTERY_CRITICAL = 5, battery_critical
    THRUSTER = 6, thruster
    MANUAL_SILENT = 7, manual_silent
    CONSOLE_SILENT = 8, console_silent
    GUEST_SILENT = 9, guest_silent
    FENCE = 10, fence
    BATTERY_LOW = 11, battery_low
    LOG = 12, log
    GNSS_POOR = 13, gnss_poor
    KILL = 14, kill  # always a stop
    HANDSET_SILENT = 15, handset_silent
    SHALLOW = 16, shallow
    FENCE_LEFT = 20, fence_left
    RESTARTED = 22, restarted  # always a warning: what the boat did is told until somebody commands
    OUTLET = 23, outlet
    NAVIGATION_TWICE = 24, navigation_twice
    STUCK = 26, stuck
    CAPSIZED = 27, capsized
    BEYOND = 28, beyond


_SEEN: Final = tuple((trigger, trigger.sees) for trigger in Trigger)  # ten times a second: no look-ups in an enumeration


class PartTrigger(int):
    """A trouble that a part's row names. Like `Trigger`, a number with a name and a detecting function."""

    name: str
    sees: Callable[[Look], str | None]

    def __new__(cls, row: TroubleRow, sees: Callable[[Look], str | None]) -> Self:
        trigger = super().__new__(cls, row.number)
        trigger.name, trigger.sees = row.name.upper(), sees
        return trigger


NUMBERS: Final = {  # by names, also of parts that are not aboard; those of a laboratory as they come aboard
    name: number
    for number, name in sorted(
        [
            *((int(trigger), trigger.name.lower()) for trigger in Trigger),
            *((row.number, row.name) for part in OWN.values() for row in part.troubles),
        ]
    )
}


def troubles(look: Look, of_parts: Iterable[PartTrigger] = ()) -> list[tuple[Trigger | PartTrigger, str]]:
    """The present troubles, with their reasons in words."""
    found: list[tuple[Trigger | PartTrigger, str]] = [(trigger, reason) for trigger, sees in _SEEN if (reason := sees(look))]
    return found + [(each, reason) for each in of_parts if (reason := each.sees(look))]


def charge(state: State) -> tuple[float, str]:
    """Charge of the emptier side, 0..1, and its name; (1, "") if no side reports."""
    least, name, reports = 1.0, "", state.sysstat
    for batteries in _BATTERIES:
        report = reports.get(batteries)
        known = report[0].charge if report is not None and isinstance(report[0], BatteriesStatus) else None
        if known is not None and (known < least or not name):
            least, name = known, batteries
    return least, name


def voltage(settings: config.Vehicle, state: State, now_s: float) -> tuple[float, str]:
    """The lowest voltage, V, that a battery or a thruster told lately, and its name; (infinite, "") if none did."""
    told = [
        (name, report.voltage_v, at_s) for name, (report, at_s) in state.sysstat.items() if isinstance(report, BatteriesStatus)
    ]
    told += [(f"{name} thruster", report.voltage_v, report.heard_s) for name, report in state.thrusters.items()]
    fresh = [(volts, name) for name, volts, at_s in told if volts is not None and now_s - at_s <= settings.sysstat.stale_s]
    return min(((volts, name) for volts, name in fresh if volts > DEAD_V), default=(math.inf, ""))


def low(
    settings: config.Vehicle, limits: config.BatteryLow | config.BatteryCritical, state: State, now_s: float, was_low: bool
) -> str | None:
    """Which battery has no more than its limits, in words; None: none that tells."""
    least, name = charge(state)
    if name and least <= limits.charge + (CHARGE_BACK if was_low else 0.0):
        return f"{name.replace('_', ' ')} at {least:.0%}"
    if not limits.voltage_v:
        return None
    volts, name = voltage(settings, state, now_s)
    is_low = volts <= limits.voltage_v * (VOLTAGE_BACK if was_low else 1.0)
    return f"{name.replace('_', ' ')} at {volts:.1f} V" if is_low else None


def astray(settings: config.Vehicle, state: State, now_s: float) -> dict[str, str]:
    """The thrusters that do not do as commanded, by name, each with the reason in words. One that never reported
    does not count."""
    found: dict[str, str] = {}
    reports, (thrusts, angles_rad, runs) = state.thrusters, state.actuation
    for row, thrust, angle_rad in zip(settings.thrusters, thrusts, angles_rad, strict=False):
        report = reports.get(row.name)
        if report is None:
            continue
        age_s = now_s - report.heard_s
        if age_s > FRESH_S:
            if runs and age_s > settings.sysstat.stale_s and not settings.drives(row).nodes:  # which report themselves
                found[row.name] = f"{row.name} propeller silent for {age_s:.1f} s"
        elif report.refuses and runs:
            found[row.name] = f"{row.name} thruster does not obey: {report.refuses}"
        elif runs and (load := _overloaded(settings.failsafe.thruster, report)):
            found[row.name] = f"{row.name} thruster {load}"
        elif report.rpm is not None and (words := _revolving(settings, row, thrust if runs else None, report.rpm)):
            found[row.name] = f"{row.name} propeller {words}"
        elif report.angle_rad is not None and runs:
            off_deg = math.degrees(abs(wrap(report.angle_rad - angle_rad)))
            if off_deg > settings.failsafe.thruster.error_deg:
                stands_deg, asked_deg = math.degrees(report.angle_rad), math.degrees(angle_rad)
                found[row.name] = f"{row.name} thruster stands at {stands_deg:.0f} instead of {asked_deg:.0f} degrees"
    return found


def _overloaded(limits: config.ThrusterAstray, report: ThrusterReport) -> str:
    """Why a thruster must rest, in words; empty: it need not, or does not tell."""
    if limits.current_a and (report.current_a or 0.0) > limits.current_a:
        return f"is overloaded: {report.current_a:.0f} A of {limits.current_a:.0f}"
    if limits.temperature_c and (report.temperature_c or 0.0) > limits.temperature_c:
        return f"is too hot: {report.temperature_c:.0f} of {limits.temperature_c:.0f} degrees"
    return ""


def unstopped(settings: config.Vehicle, state: State, now_s: float) -> tuple[str, ...]:
    """The thrusters that turn although they were switched off."""
    return () if state.actuation.run else tuple(astray(settings, state, now_s))


def _revolving(settings: config.Vehicle, row: config.ThrusterTable, thrust: float | None, rpm: float) -> str | None:
    """Why a propeller does not turn as commanded, in words; None: it does. `thrust` None: it is switched off."""
    limits, most_rpm = settings.failsafe.thruster, settings.rpm_max(row)
    if thrust is None:
        return f"turns {rpm:.0f} instead of 0 rpm" if abs(rpm) > limits.idle_rpm else None
    if most_rpm:
        wanted_rpm = thrust * most_rpm
        is_off = abs(rpm - wanted_rpm) > limits.error_rpm + limits.error * abs(wanted_rpm)
        return f"turns {rpm:.0f} instead of {wanted_rpm:.0f} rpm" if is_off else None
    if abs(thrust) < SURE:
        return None
    if abs(rpm) < 1.0:
        return f"stands still at {thrust:.0%} thrust"
    return f"turns {rpm:.0f} rpm at {thrust:.0%} thrust" if rpm * thrust < 0.0 else None
