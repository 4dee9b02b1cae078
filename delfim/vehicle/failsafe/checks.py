"""The checks before the boat leaves idle, a line and a reason each: the page to read on the quay.

The one door uses the same lines: it does not refuse a boat that the page shows in order.
"""

from delfim import config
from delfim.base.modes import Mode
from delfim.vehicle import inputhealth
from delfim.vehicle.failsafe import nodehealth
from delfim.vehicle.failsafe.failsafe import Action, Rules
from delfim.vehicle.failsafe.troubles import Inputs, Trigger, charge, handset_missed, low, outlet_missed, unheard, voltage
from delfim.vehicle.navigation import gnss
from delfim.vehicle.plans.fence import outside
from delfim.vehicle.report import Check
from delfim.vehicle.state import HANDSET, State

EARLIEST_NS = 1_230_768_000_000_000_000  # 2009: a clock before that was never set
STARTING = "the program is still starting and the dead-man does not watch it yet; wait a few seconds"
UNPROVEN = "the motors are not proven: manual and trial only, and a failsafe stops; delfim adopt finds them"
HEARD_S = 5.0  # a console silent for longer counts as lost


_WATCHED = {  # lines that a trouble watches under way
    "navigation": Trigger.NAVIGATION_SILENT,
    "sensors": Trigger.SENSOR_BAD,
    "log": Trigger.LOG,
    "hand-set": Trigger.HANDSET_SILENT,
}
ADVISORY = frozenset({"clock", "mission", "link", "last shutdown", "image", "energy"})  # shown, but they forbid no mode


def checks(rules: Rules, state: State, inputs: Inputs, now_s: float, time_ns: int) -> list[Check]:
    """All lines, in the order in which they matter. `time_ns`: the computer's clock, since 1970."""
    age_s = now_s - state.navigation_s
    bad = nodehealth.wrong(state, rules.settings.sysstat, now_s) or unheard(rules.settings.sensors, state, now_s)
    critical = low(rules.settings, rules.table.battery_critical, state, now_s, was_low=False)
    plan = state.setpoint.plan
    missed = handset_missed(rules.settings.handset, state.handset, now_s)
    heard_s = now_s - state.console_s
    heard = f"console heard {heard_s:.1f} s ago" if heard_s < 1e8 else "console never heard"
    return [
        Check("kill", not state.killed.reason, f"kill: {state.killed.reason}" if state.killed.reason else "none"),
        Check("computer", not state.computer.is_starting, STARTING if state.computer.is_starting else "started"),
        _navigation(rules, state, age_s, now_s),
        Check("sensors", bad is None, bad or f"{len(rules.settings.sysstat.required or ())} nodes report good"),
        *_outlet(rules, state, now_s),
        _gnss(rules, state),
        _clock(rules, state, age_s, time_ns),
        Check("log", not inputs.log_reason, f"no log, no start: {inputs.log_reason}" if inputs.log_reason else "being written"),
        Check("battery", not critical, critical or _level(rules.settings, state, now_s)),
        *_energy(state),
        _fence(state, inputs),
        *_adopted(rules),
        Check("mission", True, f"{plan.name}, {len(plan.waypoints)} waypoints" if plan is not None else "none loaded"),
        Check("hand-set", not missed, missed or _handset(rules.settings.handset, state)),
        Check("link", heard_s < HEARD_S and not state.namesakes, state.namesakes or heard),
        *_parts(state),
        Check("last shutdown", not state.computer.last_shutdown, state.computer.last_shutdown or "no fault known"),
        Check("image", not state.computer.image, state.computer.image or "confirmed, or the computer has no image slots"),
    ]


def _level(settings: config.Vehicle, state: State, now_s: float) -> str:
    """The least charge, or the lowest voltage where no battery tells its charge."""
    least, batteries = charge(state)
    if batteries:
        return f"{batteries.replace('_', ' ')} at {least:.0%}"
    volts, name = voltage(settings, state, now_s)
    return f"{name.replace('_', ' ')} at {volts:.1f} V" if name else "no charge reported"


def _energy(state: State) -> list[Check]:
    """A line where the boat reckons its energy."""
    now = state.energy
    if now is None:
        return []
    if now.left_wh is None:
        return [Check("energy", False, now.why)]
    is_enough = now.left_wh - (now.plan_wh or 0.0) >= now.reserve_wh
    needs = "" if now.plan_wh is None else f"; the mission takes {now.plan_wh:.0f} Wh with the way home"
    keeps = f", and {now.reserve_wh:.0f} Wh are the reserve" if now.plan_wh is not None or not is_enough else ""
    return [Check("energy", is_enough, f"{now.left_wh:.0f} Wh left{needs}{keeps}")]


def refusal(rules: Rules, mode: Mode, lines: list[Check], is_at_sea: bool) -> str | None:
    """The reason of the first line that forbids a mode; None if none does. `is_at_sea`: the boat left idle in this voyage."""
    for line in lines:
        if not line.ok and line.name not in ADVISORY and not _allowed(rules, line.name, mode, is_at_sea):
            return line.reason
    return None


def _allowed(rules: Rules, name: str, mode: Mode, is_at_sea: bool) -> bool:
    """A boat outside its fence may be driven back by hand; with low batteries the failsafe table decides. A boat at sea that
    stopped, or was restarted, is not on the quay: what would not stop it under way does not keep it there."""
    if is_at_sea and name in _WATCHED and rules.actions[_WATCHED[name]][mode] < Action.STOP:
        return True
    if name == "fence":
        return mode is Mode.MANUAL
    if name == "adopted":
        return mode in (Mode.MANUAL, Mode.TRIAL)
    if name == "parts":
        return is_at_sea
    if name == "gnss":
        return rules.actions[Trigger.GNSS_POOR][mode] <= Action.WARN
    if name == "outlet":
        return rules.actions[Trigger.OUTLET][mode] <= Action.WARN
    if name == "battery":
        return rules.actions[Trigger.BATTERY_CRITICAL][mode] < Action.STOP
    if name == "hand-set":
        return not rules.settings.handset.mandatory
    return name == "log" and (not rules.settings.log.required or mode in (Mode.MANUAL, Mode.HOME))


def _adopted(rules: Rules) -> list[Check]:
    """A line where nobody knows yet what the motors do."""
    return [] if rules.settings.adopted.proven else [Check("adopted", False, UNPROVEN)]


def _parts(state: State) -> list[Check]:
    """A line where a laboratory's parts are aboard."""
    off = next((each.off for each in state.parts.values() if each.off), "")
    return [Check("parts", not off, off or f"{', '.join(state.parts)} aboard")] if state.parts else []


def _outlet(rules: Rules, state: State, now_s: float) -> list[Check]:
    """A line where motors are told by pulses."""
    missed = outlet_missed(rules.settings, state, now_s)
    return [Check("outlet", not missed, missed or "it answers")] if rules.settings.driven("outlet") else []


def _handset(settings: config.HandsetTable, state: State) -> str:
    if not settings.device or state.handset is None:
        return "the boat has none"
    radio = "" if state.handset.quality_pct is None else f", radio {state.handset.quality_pct}%"
    return f"{'has the boat' if state.operator == HANDSET else 'heard'}{radio}"


def _navigation(rules: Rules, state: State, age_s: float, now_s: float) -> Check:
    stale_s = rules.settings.navigation.stale_s
    if age_s > stale_s:
        return Check(
            "navigation", False, "no navigation yet" if state.navigation is None else f"navigation silent for {age_s:.1f} s"
        )
    inputs = state.inputs.get(state.source, ())
    if silent := inputhealth.silent(inputs, now_s, stale_s):
        return Check("navigation", False, silent)
    wrong = inputhealth.in_words(inputs, now_s, stale_s, rules.table.navigation_frozen.after_s)
    return Check("navigation", True, f"{state.source}, {age_s:.1f} s old" + (f"; {wrong}" if wrong else ""))


def _gnss(rules: Rules, state: State) -> Check:
    n = state.navigation
    wrong = gnss.poor(rules.table.gnss_poor, n)
    if n is None:
        return Check("gnss", True, "not heard")
    return Check("gnss", wrong is None, wrong or gnss.in_words(n.fix, n.satellites, n.hdop, n.accuracy_m, n.corrections_s))


def _clock(rules: Rules, state: State, age_s: float, time_ns: int) -> Check:
    """The log's times depend on this clock; navigation's UTC comes from satellites."""
    told, n = state.computer.clock, state.navigation
    kept = f"; {told.kept}" + (f", compared with {told.source}" if told.source else "") if told.kept else ""
    more = kept + (f"; {told.fault}" if told.fault else "")
    if time_ns < EARLIEST_NS:
        return Check("clock", False, f"the computer's clock was never set{more}")
    if n is None or not n.utc_ns:
        return Check("clock", not told.fault, f"navigation gives no time to compare with{more}")
    off_s = (time_ns - n.utc_ns) / 1e9 - age_s
    ok = abs(off_s) <= rules.settings.checks.clock_s and not told.fault
    return Check("clock", ok, f"the computer's clock is {off_s:+.1f} s off navigation's{more}")


def _fence(state: State, inputs: Inputs) -> Check:
    fence = inputs.fence
    if state.fence_lost:
        return Check("fence", False, state.fence_lost)
    if fence is None:
        return Check("fence", True, "none")
    if "position" not in state.motion.has:
        return Check("fence", False, "no position: the fence cannot be watched")
    if not fence.is_laid:
        return Check("fence", False, "its zones are still being prepared: wait a moment")
    away = outside(fence, state.motion.north_m, state.motion.east_m)
    return Check("fence", away is None, away or f"{len(fence.zones)} zones, the boat is where it may be")
