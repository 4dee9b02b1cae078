"""Each trouble of docs/failsafe.md is reported when its condition has lasted, is over when its cause is, and is followed by its
action and by no other."""

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from delfim import config
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Status
from delfim.simulator.invariants.cycle import CycleSeen
from delfim.simulator.invariants.fence import PlainFence
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.state import Actuation, Notice, Setpoint, State

TURNING: Final = 0.04  # of full command; below this a propeller moves no boat
FRESH_S: Final = 1.0  # an older report of a propeller does not count
NEVER_S: Final = math.inf
BATTERIES: Final = ("batteries_starboard", "batteries_port")
SEVERITY: Final = ("warn", "hold", "back", "unstick", "home", "stop", "disconnect")
NAVIGATES: Final = frozenset({"position", "heading", "velocity"})
NEEDS: Final = {  # docs/control.md
    **dict.fromkeys((Mode.GOTO, Mode.PLAY, Mode.PATH, Mode.HOLD, Mode.HOME, Mode.TRIAL, Mode.UNSTICK), NAVIGATES),
    **dict.fromkeys((Mode.HEADING, Mode.GREX), frozenset({"heading"})),
    Mode.COURSE: frozenset({"heading", "velocity"}),
}
# Troubles that act by themselves in all modes.
ENDING: Final = Mode.HOME, Mode.GOTO, Mode.PLAY, Mode.PATH, Mode.UNSTICK
FIXED: Final = {"control": "stop", "kill": "stop", "restarted": "warn"}


@dataclass(slots=True)
class Glance:
    """The state that the boat checks ten times a second, in the mode that it had then."""

    settings: config.Vehicle
    state: State
    sent: Actuation | None  # None: it changed meanwhile, so it is not known what the boat saw
    mode: Mode
    now_s: float
    fence: PlainFence
    log_reason: str
    was_low: frozenset[str]
    up_s: float  # time since the program's start
    astray: Sequence[bool | None] = ()  # of each thruster, by `is_astray`


Condition = Callable[[Glance], bool | None]  # None: not known here

_TOLD: Final[dict[Mode, Callable[[Setpoint], bool]]] = {  # whether the mode was told what to do
    Mode.GREX: lambda setpoint: setpoint.guest_heading_rad is not None,
    Mode.PLAY: lambda setpoint: setpoint.plan is not None,
    Mode.PATH: lambda setpoint: setpoint.plan is not None,
    Mode.HOME: lambda setpoint: bool(setpoint.track),
    Mode.TRIAL: lambda setpoint: setpoint.trial is not None,
}


def control(look: Glance) -> bool | None:
    m, setpoint = look.state.motion, look.state.setpoint
    if look.mode is Mode.IDLE:
        return False
    if look.mode in NEEDS and not m.has >= NEEDS[look.mode]:
        return True
    of_mode = _TOLD.get(look.mode)
    is_told = of_mode is None or of_mode(setpoint)
    is_sane = (
        abs(m.north_m) + abs(m.east_m) < 1e6 and abs(m.north_mps) + abs(m.east_mps) < 50.0 and abs(m.yaw_rate_radps) < 100.0
    )
    return False if is_told and is_sane else None


def navigation_silent(look: Glance) -> bool | None:
    after_s = look.settings.failsafe.navigation_silent.after_s
    return look.now_s - look.state.navigation_s > after_s or (None if look.state.inputs else False)


def navigation_jumping(look: Glance) -> bool | None:
    state, after_s = look.state, look.settings.failsafe.navigation_jumping.after_s
    lasts = state.jumped_s - state.jumping_s >= after_s and look.now_s - state.jumped_s <= look.settings.navigation.stale_s
    return lasts or (None if state.inputs else False)


def navigation_frozen(look: Glance) -> bool | None:
    if look.mode is Mode.IDLE:
        return False
    if look.state.inputs:
        return None
    if look.now_s - look.state.changed_s <= look.settings.failsafe.navigation_frozen.after_s:
        return False
    return None if look.sent is None else look.sent.run and max(map(abs, look.sent.thrust), default=0.0) > TURNING


def navigation_twice(look: Glance) -> bool | None:
    twice = look.state.twice
    return len(twice) >= 3 and look.now_s - twice[0] <= look.settings.failsafe.navigation_twice.after_s


def sensor_bad(look: Glance) -> bool | None:
    state, sysstat, sensors = look.state, look.settings.sysstat, look.settings.sensors
    for name in sysstat.required or ():
        report = state.sysstat.get(name)
        is_new = look.up_s <= sysstat.stale_s
        if report is None:
            is_wrong = not is_new
        else:
            is_bad = report[0].status is Status.BAD and not (is_new and report[0].faults == Fault.NO_COMMAND)
            is_wrong = is_bad or look.now_s - report[1] > sysstat.stale_s
        if is_wrong:
            return None if state.killed.reason else True
    ages_s = [look.now_s - state.measured[name][1] if name in state.measured else look.up_s for name in sensors.required]
    return max(ages_s, default=0.0) > sensors.stale_s


def battery(name: str) -> Condition:
    def is_low(look: Glance) -> bool | None:
        limits: config.BatteryLow | config.BatteryCritical = getattr(look.settings.failsafe, name)
        reports = [look.state.sysstat[side][0] for side in BATTERIES if side in look.state.sysstat]
        charges = [each.charge for each in reports if isinstance(each, BatteriesStatus) and each.charge is not None]
        if min(charges, default=2.0) <= limits.charge + (0.02 if name in look.was_low else 0.0):
            return True
        return None if limits.voltage_v else False

    return is_low


def thruster(look: Glance) -> bool | None:
    if look.state.failed:
        return True
    found = look.astray
    return True if True in found else None if None in found else False


def is_astray(look: Glance, i: int) -> bool | None:
    """Whether one thruster does not do as commanded."""
    limits, row, sent = look.settings.failsafe.thruster, look.settings.thrusters[i], look.sent
    report, rpm_max = look.state.thrusters.get(row.name), look.settings.rpm_max(row)
    if sent is None:
        return None
    if report is None:
        return False
    if limits.current_a or limits.temperature_c:
        return None
    is_old = look.now_s - report.heard_s > FRESH_S
    if is_old or report.rpm is None or not rpm_max or report.refuses or report.angle_rad is not None:
        return False if look.settings.drives(row).nodes or not sent.run else None
    asked_rpm = sent.thrust[i] * rpm_max
    if not sent.run:
        return abs(report.rpm) > limits.idle_rpm
    return abs(report.rpm - asked_rpm) > limits.error_rpm + limits.error * abs(asked_rpm)


class Unrest:
    """The earliest and the latest time since when thrusters turn although they were switched off, whatever is ordered
    meanwhile."""

    def __init__(self, unknown: Collection[int]) -> None:
        """`unknown`: thrusters that were not observed before."""
        self._since_s, self._first_s = dict.fromkeys(unknown, -NEVER_S), dict.fromkeys(unknown, -NEVER_S)
        self._sure_s, self._last_s = dict[int, float](), dict[int, float]()  # the same two, surely and not perhaps
        self._looked_s = self._ran_s = 0.0

    def look(self, look: Glance) -> None:
        is_idle, mode_s = look.mode is Mode.IDLE, look.state.mode_s
        is_off = is_idle and look.sent is not None and not look.sent.run
        for i, holds in enumerate(look.astray):
            for times in () if holds else (self._sure_s, self._last_s):  # it may have obeyed
                times.pop(i, None)
            for times in () if holds is not False else (self._since_s, self._first_s):
                times.pop(i, None)
            if holds is False:
                continue
            since_s = self._since_s.setdefault(i, look.now_s)
            if is_idle or mode_s >= self._looked_s:  # or it may have been, between two looks
                self._first_s.setdefault(i, max(since_s, mode_s if is_idle else self._looked_s))
            if holds:
                sure_s = self._sure_s.setdefault(i, look.now_s)
                if is_off:
                    self._last_s.setdefault(i, max(sure_s, mode_s) if mode_s >= self._ran_s else look.now_s)
        self._looked_s, self._ran_s = look.now_s, self._ran_s if is_off else look.now_s

    def is_over(self, after_s: float, now_s: float) -> bool | None:
        """Whether one turns on for too long."""
        if any(now_s - at_s >= after_s for at_s in self._last_s.values()):
            return True
        return None if any(now_s - at_s >= after_s for at_s in self._first_s.values()) else False


def manual_silent(look: Glance) -> bool | None:
    return look.mode is Mode.MANUAL and look.now_s - look.state.manual_s > look.settings.failsafe.manual_silent.after_s


def console_silent(look: Glance) -> bool | None:
    return look.mode is not Mode.IDLE and look.now_s - look.state.console_s > look.settings.failsafe.console_silent.after_s


def guest_silent(look: Glance) -> bool | None:
    state, after_s = look.state, look.settings.failsafe.guest_silent.after_s
    if state.helmsman:  # which loses the boat by that
        return look.now_s - state.payloads_s[state.helmsman] > after_s
    if look.settings.helmsmen:
        return None
    return look.mode is Mode.GREX and look.now_s - state.guest_s > after_s


def fence(look: Glance) -> bool | None:
    zones = look.fence.zones()
    if zones is None or "position" not in look.state.motion.has:
        return None
    return look.fence.is_outside(look.state.motion) if look.mode is Mode.IDLE else look.fence.is_near(look.state.motion)


def fence_left(look: Glance) -> bool | None:
    if look.mode is Mode.IDLE or "position" not in look.state.motion.has:
        return False
    return look.fence.is_left(look.state.motion)


def gnss_poor(look: Glance) -> bool | None:
    limits, n = look.settings.failsafe.gnss_poor, look.state.navigation
    if n is None or not n.fix:
        return False
    told = 0 < n.satellites < limits.satellites or (n.hdop is not None and n.hdop > limits.hdop)
    return told or (None if limits.accuracy_m or limits.corrections_s or limits.fix != "2d" else False)


def shallow(look: Glance) -> bool | None:
    depth_m, at_s = look.state.measured.get("depth_m", (math.inf, look.now_s))
    return depth_m < look.settings.failsafe.shallow.min_depth_m and look.now_s - at_s <= look.settings.sensors.stale_s


def capsized(look: Glance) -> bool | None:
    n, most_deg = look.state.navigation, look.settings.failsafe.capsized.roll_deg
    return n is not None and n.roll_rad is not None and abs(math.degrees(n.roll_rad)) > most_deg


def beyond(look: Glance) -> bool | None:
    limits, stale_s = look.settings.failsafe.beyond, look.settings.sensors.stale_s
    fresh = {name: value for name, (value, at_s) in look.state.measured.items() if look.now_s - at_s <= stale_s}
    is_high = any(fresh.get(name, -math.inf) > most for name, most in limits.above.items())
    return is_high or any(fresh.get(name, math.inf) < least for name, least in limits.below.items())


CONDITIONS: Final[dict[str, Condition]] = {
    "control": control,
    "navigation_jumping": navigation_jumping,
    "navigation_silent": navigation_silent,
    "navigation_frozen": navigation_frozen,
    "sensor_bad": sensor_bad,
    "battery_critical": battery("battery_critical"),
    "thruster": thruster,
    "manual_silent": manual_silent,
    "console_silent": console_silent,
    "guest_silent": guest_silent,
    "fence": fence,
    "battery_low": battery("battery_low"),
    "log": lambda look: bool(look.log_reason),
    "gnss_poor": gnss_poor,
    "kill": lambda look: bool(look.state.killed.reason),
    "shallow": shallow,
    "capsized": capsized,
    "beyond": beyond,
    "fence_left": fence_left,
    "restarted": lambda look: bool(look.state.restarted),
    "navigation_twice": navigation_twice,
}


@dataclass(slots=True)
class Lasting:
    """A trouble that is there, or was until a moment ago."""

    since_s: float
    acting_s: float = NEVER_S
    seen_s: float = -NEVER_S
    is_known: bool = True  # False: whether and since when it is there was not known all the time
    is_answered: bool | None = False  # the boat went home for it, or the operator overruled that; None: not known


class Troubles:
    """The troubles that the boat reports, and its actions, follow from their conditions in docs/failsafe.md."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self._fence, self._clear_s = run, PlainFence(run), run.settings.failsafe.clear_s
        is_new = run.elapsed_s == 0.0  # otherwise nobody saw since when a trouble is there
        self._lasting = {} if is_new else {name: Lasting(NEVER_S, is_known=False) for name in CONDITIONS}
        self._unrest = Unrest(() if is_new else range(len(run.settings.thrusters)))

    def overruled(self) -> None:
        """Note that an order of the operator was obeyed that overrules what is reported."""
        for each in self._lasting.values():
            each.is_answered = each.is_answered or each.acting_s < NEVER_S

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        state, was, run = cycle.state, cycle.was, cycle.run
        if state.watchdog_s != cycle.now_s:
            return
        settings, told = run.vehicle.helm.settings, {notice.name: notice for notice in state.notices}
        mode = run.vehicle.judged_in  # a mode may begin, and end, before and after the boat looks
        sent = state.actuation if (state.mode, state.reason) == (was.mode, was.reason) else None
        low = frozenset(name for name, each in self._lasting.items() if each.acting_s < NEVER_S or each.seen_s > -NEVER_S)
        look = Glance(
            settings, state, sent, mode, cycle.now_s, self._fence, run.vehicle.log.reason(), low, cycle.now_s - run.started_s
        )
        look.astray = [is_astray(look, i) for i in range(len(settings.thrusters))]
        self._unrest.look(look)
        severities = [SEVERITY.index(notice.action) for notice in state.notices]
        if severities != sorted(severities, reverse=True):
            yield f"the worst trouble is not told first: {', '.join(told)}"
        for name, condition in CONDITIONS.items():
            holds = condition(look)
            if holds is not False or name in told or name in self._lasting:
                yield from self._compare(name, holds, look, told.get(name))
        for notice in state.notices:
            if notice.name in self._lasting and (wrong := self._acts(notice, look)):
                yield wrong
        yield from _followed(SEVERITY[max(severities)] if severities else "", cycle, mode)

    def _compare(self, name: str, holds: bool | None, look: Glance, notice: Notice | None) -> Iterator[str]:
        """The memory of one trouble after this look, and whether the boat reports it."""
        now_s, each = look.now_s, self._lasting.get(name)
        if holds is None or (each is not None and not each.is_known):
            yield from self._believe(name, holds, look, notice)
            return
        if holds:
            each = self._lasting.setdefault(name, Lasting(now_s))
            each.seen_s = now_s
            if each.acting_s == NEVER_S and now_s - each.since_s >= _lasts_s(look.settings.failsafe, name):
                each.acting_s = now_s
        elif each is not None and (each.acting_s == NEVER_S or now_s - each.seen_s >= self._clear_s):
            del self._lasting[name]
            each = None
        is_told = each is not None and each.acting_s < NEVER_S
        if is_told and notice is None and each is not None:
            yield f"{name} is there since {each.since_s:.1f} s, and is not told"
        elif notice is not None and not is_told:
            yield f"{name} is told ({notice.reason}), and is not there"
        elif notice is not None and each is not None and notice.since_s != each.since_s:
            yield f"{name} is told to be there since {notice.since_s:.1f} s, not since {each.since_s:.1f} s"

    def _believe(self, name: str, holds: bool | None, look: Glance, notice: Notice | None) -> Iterator[str]:
        """The memory of a trouble whose beginning is not known, or whether it is there: the boat's report is accepted if it
        comes in time."""
        now_s, was = look.now_s, self._lasting.get(name)
        if notice is None:
            self._lasting.pop(name, None)
            if holds is not False:
                since_s = NEVER_S if not holds else now_s if was is None else min(was.since_s, now_s)
                self._lasting[name] = Lasting(since_s, is_known=False)
                if now_s - since_s >= _lasts_s(look.settings.failsafe, name):
                    yield f"{name} is there since {since_s:.1f} s or longer, and is not told"
            return
        each = self._lasting.setdefault(name, Lasting(now_s))
        each.since_s, each.acting_s, each.is_known, each.is_answered = (
            notice.since_s,
            min(each.acting_s, now_s),
            bool(holds),
            None,
        )
        if holds is not False:
            each.seen_s = now_s

    def _acts(self, notice: Notice, look: Glance) -> str:
        """The reason, in words, why the action reported for a trouble is not that of the table."""
        each, name, mode, table = self._lasting[notice.name], notice.name, look.mode, look.settings.failsafe
        action = FIXED.get(name) or self._of_table(table, name, mode)
        if not each.is_known and notice.action == "warn":
            return ""  # it may be absent already
        if mode is Mode.HOME and notice.action == "home" and look.state.mode_s == look.now_s:
            each.is_answered = True
            return ""  # home was done, and began anew within this cycle
        if each.seen_s != look.now_s:
            action = "warn"  # absent, and not over yet
        elif name == "thruster" and look.state.failed and not look.state.unsteerable:
            action = "warn"
        elif action == "disconnect":
            is_over = self._unrest.is_over(table.thruster.after_s, look.now_s)
            action = notice.action if is_over is None else "disconnect" if is_over else "warn"
        elif action == "home":
            if mode is Mode.HOME or each.is_answered:
                action = "warn"
            elif each.is_answered is None:
                return ""
            elif each.acting_s + table.pause_s - look.now_s > 0.0:
                action = "hold"
            else:
                each.is_answered = True
        if mode is not look.state.mode and mode in ENDING:
            return ""  # it may have been done, and become hold, before the boat looked
        return "" if action == notice.action else f"{name} brings {notice.action} in {mode.name.lower()}, not {action}"

    @staticmethod
    def _of_table(table: config.Failsafe, name: str, mode: Mode) -> str:
        if mode is Mode.IDLE and name != "kill":
            return "disconnect" if name == "thruster" and table.thruster.disconnect else "warn"
        row: config.Trouble = getattr(table, name)
        own: str = getattr(row, mode.name.lower())
        return row.action if own == "same" else own


def _lasts_s(table: config.Failsafe, name: str) -> float:
    """The time, s, that a condition without an age of its own must last."""
    row: object = getattr(table, name, None)
    return row.after_s if isinstance(row, config.Trouble) and not isinstance(row, config.Silence) else 0.0


_DOES: Final[dict[str, tuple[Mode, ...]]] = {
    "hold": (Mode.HOLD,),
    "back": (Mode.HOLD,),
    "unstick": (Mode.UNSTICK, Mode.HOLD),
    "home": (Mode.HOME, Mode.HOLD),
    "stop": (),
}


def _followed(action: str, cycle: CycleSeen, mode: Mode) -> Iterator[str]:
    """Whether the worst action is done, and none but it changed the mode."""
    state, was = cycle.state, cycle.was
    does = _DOES.get(action)
    if does is None:
        if state.mode is not was.mode and not _by_itself(cycle):
            yield f"from {was.mode.name.lower()} to {state.mode.name.lower()}, and nothing asks for it"
    elif state.mode is not Mode.IDLE and state.mode not in does:
        yield f"{action} is told, and the boat is in {state.mode.name.lower()}"
    elif state.mode is Mode.IDLE and does and "cannot hold" not in state.reason and mode is not Mode.IDLE:
        yield f"{action} is told, and the boat stopped"


def _by_itself(cycle: CycleSeen) -> bool:
    """Whether a mode ended or began without a trouble: at its end, after a restart, by a hand aboard, or on a detour."""
    reason, was = cycle.state.reason, cycle.was.mode.name.lower()
    return (
        reason.startswith((f"{was} done", f"{was} ended: ", "restarted: ", "operator", "kill: "))
        or cycle.run.vehicle is not cycle.was.handed
    )
