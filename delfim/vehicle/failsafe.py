"""What goes wrong, and what the boat does about it: one table, trouble by trouble and mode by mode (thesis 2.12, 3.4).

The table is `[failsafe]` of the vehicle's file, `docs/failsafe.md` explains it. Nothing here moves anything: `failsafe` is a
function of the state that says what should be done, ten times a second, and the loop does it. No action takes the boat back
to what it was taken from. When a trouble ends, nothing is resumed: the operator acts.
"""

import math
from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple

from delfim import config
from delfim.messages import BatteriesStatus, Node, PropellerStatus
from delfim.modes import Mode
from delfim.vehicle import sysstat
from delfim.vehicle.control.control import admit
from delfim.vehicle.fence import Fence, ahead, outside
from delfim.vehicle.state import Notice, Setpoint, State


class Action(IntEnum):
    """By severity."""

    NONE = 0
    WARN = 1
    HOLD = 2
    HOME = 3
    STOP = 4
    DISCONNECT = 5  # the batteries of a propeller that turns although it was stopped


class Trigger(IntEnum):
    """The troubles, named as in the vehicle's file; their numbers are bits in the log. Of two that ask for the same action the
    first one gives the reason."""

    CONTROL = 0  # the mode cannot go on: its inputs are missing or make no sense; always a stop
    NAVIGATION_JUMPING = 1
    NAVIGATION_SILENT = 2
    NAVIGATION_FROZEN = 3
    SENSOR_BAD = 4
    BATTERY_CRITICAL = 5
    THRUSTER = 6
    MANUAL_SILENT = 7
    CONSOLE_SILENT = 8
    GUEST_SILENT = 9
    FENCE = 10
    BATTERY_LOW = 11
    LOG = 12


class Inputs(NamedTuple):
    """What the table needs to know beside the state."""

    log_reason: str  # why the log is not written, in words; empty while it is
    fence: Fence | None  # None: there is none


class Episode(NamedTuple):
    """A trouble from its first sight until it has been away for `clear_s`."""

    reason: str
    since_s: float
    seen_s: float  # last time it was there
    acting_s: float  # when it had lasted for `after_s`; infinite before
    answered: bool = False  # the boat went home for it, or the operator overruled that


Memory = Mapping[Trigger, Episode]
Found = list[tuple[Trigger, str]]


class Verdict(NamedTuple):
    memory: Memory
    action: Action
    reason: str  # of the action
    notices: tuple[Notice, ...]


_DOES: Final = {Action.HOME: (Mode.HOME, Mode.HOLD), Action.HOLD: (Mode.HOLD,), Action.STOP: ()}
NO_TROUBLE: Final[Memory] = MappingProxyType({})
_WELL: Final = Verdict(NO_TROUBLE, Action.NONE, "", ())
_NEVER_S: Final = math.inf
TURNING_RPM: Final = 50.0  # below this a propeller moves no boat
FRESH_S: Final = 1.0  # an older report of a propeller is no measurement
CHARGE_BACK: Final = 0.02  # a battery is low until it has this much more
SIDES: Final = ("starboard", "port")
_PROPELLERS: Final = tuple(zip(SIDES, ("propeller_starboard", "propeller_port"), strict=True))
_BATTERIES: Final = (sysstat.NAMES[Node.BATTERIES_STARBOARD], sysstat.NAMES[Node.BATTERIES_PORT])


class Rules:
    """The table of a vehicle's file, looked up by trigger and mode."""

    def __init__(self, settings: config.Vehicle) -> None:
        self.settings, self.table, self.pause_s = settings, settings.failsafe, settings.failsafe.pause_s
        self.clear_s = settings.failsafe.clear_s
        self.lasting_s = {trigger: _lasting_s(self.table, trigger) for trigger in Trigger}
        self.actions = {trigger: {mode: _action(self.table, trigger, mode) for mode in Mode} for trigger in Trigger}


def _lasting_s(table: config.Failsafe, trigger: Trigger) -> float:
    """How long a trouble that has no age of its own must be there."""
    own = (Trigger.SENSOR_BAD, Trigger.BATTERY_LOW, Trigger.BATTERY_CRITICAL, Trigger.THRUSTER, Trigger.FENCE, Trigger.LOG)
    after_s: float = getattr(table, trigger.name.lower()).after_s if trigger in own else 0.0
    return after_s


def _action(table: config.Failsafe, trigger: Trigger, mode: Mode) -> Action:
    if mode is Mode.IDLE:
        return Action.DISCONNECT if trigger is Trigger.THRUSTER and table.thruster.disconnect else Action.WARN
    if trigger is Trigger.CONTROL:
        return Action.STOP
    row: config.Trouble = getattr(table, trigger.name.lower())
    own: str = getattr(row, mode.name.lower())
    return Action[(row.action if own == "same" else own).upper()]


def failsafe(rules: Rules, memory: Memory, state: State, inputs: Inputs, now_s: float) -> Verdict:
    """One look at everything that can go wrong."""
    found = troubles(rules, memory, state, inputs, now_s)
    if not found and not memory:
        return _WELL
    after = _remembered(rules, memory, found, now_s)
    worst, reason = Action.NONE, ""
    notices = []
    for trigger in sorted(after):
        episode = after[trigger]
        if episode.acting_s == _NEVER_S:
            continue
        action, why = _answer(rules, trigger, episode, state, now_s)
        if action is Action.HOME:
            after[trigger] = episode._replace(answered=True)
        if action > worst:
            worst, reason = action, why
        notices.append(Notice(trigger.name.lower(), why, episode.since_s, action.name.lower()))
    notices.sort(key=lambda notice: -Action[notice.action.upper()])
    return Verdict(after, worst, reason, tuple(notices))


def fallback(action: Action, reason: str, has: frozenset[str], setpoint: Setpoint) -> tuple[Mode, str]:
    """The mode that does an action, or the next safer one whose inputs are there: home, hold, idle. And why."""
    cannot = None
    for mode in _DOES[action]:
        cannot = admit(mode, has, setpoint)
        if cannot is None:
            return mode, reason
    return Mode.IDLE, reason if cannot is None else f"{reason}; cannot hold: {cannot}"


def news(before: tuple[Notice, ...], after: tuple[Notice, ...]) -> list[str]:
    """What a log should say of the change from one look to the next."""
    known, present = {(n.name, n.action) for n in before}, {n.name for n in after}
    lines = [f"{n.name}: {n.reason}: {n.action}" for n in after if (n.name, n.action) not in known]
    return lines + [f"{n.name}: over" for n in before if n.name not in present]


def overruled(memory: Memory) -> Memory:
    """After a command of the operator that was accepted: what is there now sends nobody home any more."""
    if not memory:
        return memory
    return {
        trigger: episode if episode.acting_s == _NEVER_S else episode._replace(answered=True)
        for trigger, episode in memory.items()
    }


def bits(notices: tuple[Notice, ...]) -> int:
    """The troubles as the log has them: bit n is trigger n."""
    return sum(1 << Trigger[notice.name.upper()] for notice in notices) if notices else 0


def _remembered(rules: Rules, memory: Memory, found: Found, now_s: float) -> dict[Trigger, Episode]:
    """The memory with what was found. A trouble that has not lasted yet is forgotten as soon as it is away."""
    after = {}
    for trigger, reason in found:
        was = memory.get(trigger)
        since_s, acting_s, answered = (now_s, _NEVER_S, False) if was is None else (was.since_s, was.acting_s, was.answered)
        if acting_s == _NEVER_S and now_s - since_s >= rules.lasting_s[trigger]:
            acting_s = now_s
        after[trigger] = Episode(reason, since_s, now_s, acting_s, answered)
    for trigger, was in memory.items():
        if trigger not in after and was.acting_s != _NEVER_S and now_s - was.seen_s < rules.clear_s:
            after[trigger] = was
    return after


def _answer(rules: Rules, trigger: Trigger, episode: Episode, state: State, now_s: float) -> tuple[Action, str]:
    """What to do about one trouble now, and why. What is away but not over yet is only told."""
    action, why = rules.actions[trigger][state.mode], episode.reason
    if episode.seen_s != now_s:
        return Action.WARN, why
    if action is Action.DISCONNECT and now_s - state.mode_s < rules.lasting_s[trigger]:
        return Action.WARN, why  # it was stopped just now and may still be coming to rest
    if action is not Action.HOME:
        return action, why
    if episode.answered or state.mode is Mode.HOME:
        return Action.WARN, why
    left_s = episode.acting_s + rules.pause_s - now_s
    return (Action.HOME, why) if left_s <= 0.0 else (Action.HOLD, f"{why}; home in {left_s:.0f} s")


def troubles(rules: Rules, memory: Memory, state: State, inputs: Inputs, now_s: float) -> Found:
    """What is wrong at this moment, with its reason in words."""
    table, mode = rules.table, state.mode
    found: Found = []
    jumping_s = state.jumped_s - state.jumping_s
    if jumping_s >= table.navigation_jumping.after_s and now_s - state.jumped_s <= rules.settings.navigation.stale_s:
        found.append((Trigger.NAVIGATION_JUMPING, f"position jumped by {state.jumped_m:.0f} m"))
    age_s = now_s - state.navigation_s
    if age_s > table.navigation_silent.after_s:
        silent = "no navigation yet" if state.navigation is None else f"navigation silent for {age_s:.1f} s"
        found.append((Trigger.NAVIGATION_SILENT, silent))
    if mode is not Mode.IDLE:
        _driving(table, state, now_s, found)
    if (wrong := sysstat.wrong(state, rules.settings.sysstat, now_s)) is not None:
        found.append((Trigger.SENSOR_BAD, wrong))
    _batteries(table, memory, state, found)
    if astray := unfollowed(table.thruster, state, now_s):
        found.append((Trigger.THRUSTER, _astray(state, astray)))
    if inputs.fence is not None:
        _fence(inputs.fence, state, found)
    if inputs.log_reason:
        found.append((Trigger.LOG, f"log not written: {inputs.log_reason}"))
    return found


def _driving(table: config.Failsafe, state: State, now_s: float, found: Found) -> None:
    """What only matters while the boat does something."""
    mode = state.mode
    if state.reference.reason:
        found.append((Trigger.CONTROL, state.reference.reason))
    if now_s - state.changed_s > table.navigation_frozen.after_s:
        sent = state.actuation
        if sent.run and max(abs(sent.starboard_rpm), abs(sent.port_rpm)) > TURNING_RPM:
            frozen = f"navigation frozen for {now_s - state.changed_s:.1f} s"
            found.append((Trigger.NAVIGATION_FROZEN, frozen))
    if now_s - state.console_s > table.console_silent.after_s:
        found.append((Trigger.CONSOLE_SILENT, f"console silent for {now_s - state.console_s:.1f} s"))
    if mode is Mode.MANUAL and now_s - state.manual_s > table.manual_silent.after_s:
        found.append((Trigger.MANUAL_SILENT, f"no manual command for {now_s - state.manual_s:.1f} s"))
    elif mode is Mode.GREX and now_s - state.guest_s > table.guest_silent.after_s:
        found.append((Trigger.GUEST_SILENT, f"guest silent for {now_s - state.guest_s:.1f} s"))


def charge(state: State) -> tuple[float, str]:
    """Of the emptier side, 0..1, and its name; (1, "") where no side tells."""
    least, name = 1.0, ""
    for batteries in _BATTERIES:
        report = state.sysstat.get(batteries)
        if report is not None and isinstance(report[0], BatteriesStatus):
            known = report[0].charge
            if known is not None and (known < least or not name):
                least, name = known, batteries
    return least, name


def _batteries(table: config.Failsafe, memory: Memory, state: State, found: Found) -> None:
    least, name = charge(state)
    if least > table.battery_low.charge + CHARGE_BACK or not name:
        return
    words = f"{name.replace('_', ' ')} at {least:.0%}"
    for trigger, row in ((Trigger.BATTERY_CRITICAL, table.battery_critical), (Trigger.BATTERY_LOW, table.battery_low)):
        if least <= row.charge + (CHARGE_BACK if trigger in memory else 0.0):
            found.append((trigger, words))


def unfollowed(limits: config.ThrusterAstray, state: State, now_s: float) -> tuple[str, ...]:
    """The sides whose propeller does not turn as commanded. One that does not report its revolutions is not among them."""
    sent, reports = state.actuation, state.sysstat
    astray: tuple[str, ...] = ()
    for side, node in _PROPELLERS:
        report = reports.get(node)
        if report is None or now_s - report[1] > FRESH_S or not isinstance(report[0], PropellerStatus) or report[0].rpm is None:
            continue
        wanted = (sent.starboard_rpm if side == "starboard" else sent.port_rpm) if sent.run else 0.0
        if abs(report[0].rpm - wanted) > (limits.error_rpm + limits.error * abs(wanted) if sent.run else limits.idle_rpm):
            astray += (side,)
    return astray


def _astray(state: State, sides: tuple[str, ...]) -> str:
    def words(side: str) -> str:
        report = state.sysstat[f"propeller_{side}"][0]
        measured = report.rpm if isinstance(report, PropellerStatus) else None
        wanted = (
            (state.actuation.starboard_rpm if side == "starboard" else state.actuation.port_rpm) if state.actuation.run else 0
        )
        return f"{side} propeller turns {measured} instead of {wanted:.0f} rpm"

    return ", ".join(map(words, sides))


def _fence(fence: Fence, state: State, found: Found) -> None:
    motion, idle = state.motion, state.mode is Mode.IDLE
    if "position" not in motion.has:
        if not idle and state.mode is not Mode.MANUAL:
            found.append((Trigger.FENCE, "no position: the fence cannot be watched"))
        return
    near = None if idle else ahead(fence, motion)
    if near is not None:
        found.append((Trigger.FENCE, near))
    elif idle and (away := outside(fence, motion.north_m, motion.east_m)) is not None:
        found.append((Trigger.FENCE, away))
