"""After a restart: the boat goes on as `failsafe.restarted` of the vehicle's file says, once it knows where it is.

The program gives itself the command `return` when it starts, then what the operator had sent (`voyage.py`). All that follows
from the state and these commands, so a replay of the log does the same.
"""

import math
from typing import Final

from delfim import config
from delfim.base import geodesy
from delfim.base.errors import DelfimError, Refused
from delfim.base.modes import Mode
from delfim.vehicle import console
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.orders import handlers
from delfim.vehicle.plans.legs import NOTHING, Behind
from delfim.vehicle.plans.underway import Paused
from delfim.vehicle.state import State

RESTART: Final = "restart"  # the operator who gives these commands
NEAR_M: Final = 100.0  # a boat that sails on is no farther from where it was ...
DRIFT_MPS: Final = 3.0  # ... and what a current took it


class Returning:
    """`obey` the commands of the restart, `look` ten times a second, `overruled` when others command."""

    def __init__(self, settings: config.Vehicle, helm: Helm, state: State) -> None:
        self._limits, self._helm, self._state = settings.failsafe.restarted, helm, state
        self._back: console.Return | None = None  # what is still to be done
        self._began_s = 0.0
        self._is_loaded = True  # the plan is aboard, or there was none

    @property
    def is_pending(self) -> bool:
        """The boat does not do what the record says yet: the record of before must outlast another restart until it does."""
        return self._back is not None or not self._is_loaded

    def obey(self, command: console.Commands, operator: str, now_s: float) -> str | None:
        """The program tells itself the voyage of before; nobody commands by that. Returns why not, or None."""
        if operator != RESTART:
            return "refused: the program alone goes on with a voyage, when it starts"
        why = ""
        try:
            if isinstance(command, console.Return):
                self._begin(command, now_s)
            else:
                handlers.obey(self._helm, command, now_s)
        except DelfimError as refusal:
            why = str(refusal)
        if isinstance(command, console.Plan):
            self._loaded(why)
        return why or None

    def _begin(self, back: console.Return, now_s: float) -> None:
        """Raises Refused for a boat that sails."""
        state, sailed = self._state, back.sailed
        if state.armed or state.navigation is not None:
            raise Refused("return refused: the boat sails already")
        state.killed, state.operator, state.has_left_idle = sailed.killed, sailed.operator, sailed.has_left_idle
        state.traffic = state.traffic._replace(beside=sailed.beside)
        if sailed.origin is not None:
            self._helm.plans.found(geodesy.origin(*sailed.origin))
            self._helm.track.restore(sailed.track, sailed.spacing_m)
        self._helm.plans.spared = Behind(*sailed.behind)
        state.stations = sailed.stations if back.mission and not back.lost else ()
        if back.fence:
            state.fence_lost = _lost(back.why_not if back.lost else "they are being loaded")
        self._is_loaded = not (back.mission or back.fence) or back.lost
        if sailed.killed.reason:
            self._helm.stop("")
        if back.why_not:
            state.restarted = f"{back.why_not}; the boat stays idle"
        elif sailed.mode != "idle":
            self._back, self._began_s = back, now_s
            state.restarted = self._was()

    def _loaded(self, refused: str) -> None:
        """The plan of before was sent; `refused`: why it is not aboard, in words; empty: it is."""
        self._is_loaded = True
        if refused:
            self._state.stations = ()
        if refused and self._state.fence_lost:
            self._state.fence_lost = _lost(refused)
        elif not refused:
            self._state.fence_lost = ""
        if refused and self._back is not None:
            self._give_up(refused)

    def overruled(self, command: console.Commands) -> None:
        """Somebody commands: the boat does that, and nothing of before."""
        self._back, self._state.restarted, self._is_loaded = None, "", True
        if isinstance(command, console.Plan | console.Unload):
            self._state.fence_lost, self._helm.plans.spared = "", NOTHING

    def look(self, now_s: float) -> None:
        """Go on, as soon as that is possible."""
        back, state = self._back, self._state
        if back is None:
            return
        if state.killed.reason:
            self._give_up(f"kill: {state.killed.reason}")
        elif now_s - self._began_s > self._limits.within_s:
            self._give_up("the boat could not go on for too long")
        elif "position" not in state.motion.has or now_s - state.navigation_s > self._helm.settings.navigation.stale_s:
            state.restarted = f"{self._was()}; waits for navigation"
        elif why := self._elsewhere(back):
            self._helm.track.restore((), self._helm.settings.control.home.spacing_m)
            self._give_up(why)
        elif self._is_loaded:
            self._go_on(back, now_s)

    def _elsewhere(self, back: console.Return) -> str:
        """Why this is not the voyage of before, in words; empty: it is."""
        state, here = self._state, back.sailed.here
        age_s = back.age_s
        if age_s is None:
            utc_ns = state.navigation.utc_ns if state.navigation is not None else 0
            if not utc_ns:
                return "how long the boat was off is not known"
            age_s = (utc_ns - back.t_ns) / 1e9
            if not 0.0 <= age_s <= self._limits.within_s:
                return f"the boat was off for {age_s:.0f} s"
        if here is None:
            return ""
        away_m = math.dist(here, (state.motion.north_m, state.motion.east_m))
        return f"the boat is {away_m:.0f} m from where it was" if away_m > NEAR_M + DRIFT_MPS * age_s else ""

    def _go_on(self, back: console.Return, now_s: float) -> None:
        """In the mode that the vehicle's file says, or else hold."""
        was = Mode[back.sailed.mode.upper()]
        action = self._limits.after(back.sailed.mode)
        if action == "resume" and back.sailed.helmsman:  # an operator gives the boat to a program, nobody else
            action = "hold"
        if action == "idle":
            self._give_up("so the boat's file says for this mode")
            return
        wanted = was if action == "resume" else Mode[action.upper()]
        refusal = ""
        for mode in dict.fromkeys((wanted, Mode.HOLD)):
            try:
                self._enter(mode, was, back, now_s)
            except Refused as why:
                refusal = refusal or str(why)
                continue
            more = f"; {refusal}" if refusal else ""
            self._state.restarted = f"{self._was()}; {mode.name.lower()} now{more}"
            self._back = None
            return
        self._state.restarted = f"{self._was()}; {refusal}"

    def _enter(self, mode: Mode, was: Mode, back: console.Return, now_s: float) -> None:
        """Raises Refused."""
        sailed, helm, state = back.sailed, self._helm, self._state
        setpoint = sailed.wanted(state.setpoint)
        if was is Mode.PLAY:
            setpoint = setpoint._replace(leg=sailed.memory.leg)
        is_same = mode is was and mode is not Mode.HOME  # whose legs are those of the track, which may have changed
        helm.request(mode, setpoint, now_s, sailed.memory if is_same else None, f"restarted: {self._was()}")
        paused = sailed.paused if was is Mode.HOLD else (sailed.mode, sailed.memory)
        if mode is Mode.HOLD and paused is not None and paused[0] != "manual":
            plan = state.setpoint.plan
            helm.paused = Paused(Mode[paused[0].upper()], paused[1], plan.number if plan is not None else 0)

    def _give_up(self, why: str) -> None:
        self._state.restarted, self._back = f"{self._was()}; {why}: the boat stays idle", None

    def _was(self) -> str:
        """What the boat was doing, in words."""
        sailed = self._back.sailed if self._back is not None else None
        if sailed is None:
            return ""
        leg = f" on leg {sailed.memory.leg + 1}" if sailed.mode == "play" else ""
        leg = f" on piece {sailed.memory.leg + 1}" if sailed.mode == "path" and sailed.memory.leg >= 0 else leg
        whose = f" of payload {sailed.helmsman}" if sailed.helmsman else ""
        return f"it was in {sailed.mode}{leg}{whose}"


def _lost(why: str) -> str:
    return f"zones were aboard before the restart and are not in force: {why}; send them again, or clear them"
