"""The thesis' rule (3.4): navigation or console silent, a sensor bad: stop, and do not go adrift under power."""

from delfim.config import Vehicle
from delfim.vehicle import sysstat
from delfim.vehicle.state import Mode, State


def unfit(state: State, settings: Vehicle, now_s: float, log_reason: str) -> str | None:
    """Why the boat may not leave idle now, in words; None when nothing is against it. `log_reason`: why nothing is logged."""
    age_s = now_s - state.navigation_s
    if age_s > settings.navigation.stale_s:
        return "no navigation yet" if state.navigation is None else f"navigation silent for {age_s:.1f} s"
    if log_reason and settings.log.required:
        return f"no log, no start: {log_reason}"
    return sysstat.wrong(state, settings.sysstat, now_s)


def alarm(state: State, settings: Vehicle, now_s: float) -> str | None:
    """Why the boat must stop now, in words; None while all is well. Never in idle: there is nothing to stop."""
    if state.mode is Mode.IDLE:
        return None
    limits = settings.watchdog
    if now_s - state.navigation_s > limits.navigation_s:
        return f"navigation silent for {now_s - state.navigation_s:.1f} s"
    if state.reference.reason:
        return state.reference.reason
    if now_s - state.console_s > limits.console_s:
        return f"console silent for {now_s - state.console_s:.1f} s"
    if state.mode is Mode.MANUAL and now_s - state.manual_s > limits.manual_s:
        return f"no manual command for {now_s - state.manual_s:.1f} s"
    if state.mode is Mode.GREX and now_s - state.guest_s > limits.guest_s:
        return f"guest silent for {now_s - state.guest_s:.1f} s"
    return sysstat.wrong(state, settings.sysstat, now_s)
