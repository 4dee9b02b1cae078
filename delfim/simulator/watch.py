"""Invariants: what must never happen to a boat in lock step, whatever fails."""

import math
from typing import Final

from delfim.modes import Mode
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.fence import Fence
from delfim.vehicle.state import State
from delfim.vehicle.zones import clearance_m

TURNS: Final = 0.0857  # of full command; above this, 120 rpm of DelfimX, a thruster gives relevant thrust
COAST_S: Final = 4.0  # time in which a stopped one comes to rest
ASTRAY_S: Final = 12.0  # the same for one that does not obey: detected, disconnected, coasted
BLIND_S: Final = 0.5  # time beyond the limit until the watchdog acts
NOISE_M: Final = 1.5  # between the true and the measured position
DECEIVED_M: Final = 3.0  # with a larger error of position a boat cannot keep its fence
CUT: Final = "dsor"  # the driver whose thrusters the boat cuts off from their batteries


class Onlooker:
    """Call `look` after each cycle."""

    def __init__(self, run: Lockstep) -> None:
        self._run, self._model, self._settings = run, run.nodes.model, run.settings
        self.failures: list[str] = []
        self._uncut = {row.name for row in self._settings.thrusters if row.driver != CUT}
        self._turning_since_s = math.inf
        self._was_inside, self._astray, self._drifted = True, False, False

    def look(self) -> None:
        run, state = self._run, self._run.state
        now_s, sent, limits = run.elapsed_s, state.actuation, self._settings
        idle = state.mode is Mode.IDLE
        fastest = max(map(abs, sent.thrust))
        if not fastest <= 1.0 or (fastest and (idle or not sent.run)):
            self._fail(f"commanded {sent}")
        if idle and not state.reason:
            self._fail("stopped without a reason")
        if not idle and now_s - state.navigation_s > limits.failsafe.navigation_silent.after_s + BLIND_S:
            self._fail(f"sailing blind in mode {state.mode.name.lower()}")
        self._adrift(idle, now_s)
        if (around := run.vehicle.helm.plans.fence) is not None:
            self._fenced(around, state, idle)

    def _adrift(self, idle: bool, now_s: float) -> None:
        """Propellers give thrust while nothing steers the boat. Neither a failed bus nor a node that tells it nothing is the
        boat's fault: what turns then it learns afterwards. Nor is a thruster that does not obey and that it cannot cut off."""
        model, on = self._model, self._run.faults.on
        drives = [drive for name, drive in model.drives.items() if not (drive.fault and name in self._uncut)]
        turns = any(abs(drive.part) > TURNS for drive in drives)
        is_deaf = "bus_off" in on or "sensor_silent" in on or any(kind.startswith("frames_") for kind in on)
        if not (idle and turns) or is_deaf:
            self._turning_since_s, self._astray = math.inf, False
            return
        self._turning_since_s = min(self._turning_since_s, now_s)
        self._astray = self._astray or any(drive.fault for drive in model.drives.values())
        if now_s - self._turning_since_s > (ASTRAY_S if self._astray else COAST_S):
            self._fail("adrift under power")

    def _fenced(self, around: Fence, state: State, idle: bool) -> None:
        """A boat that obeys, knows its position and drives must not leave its fence. A stopped boat may drift, and one that was
        within the margin when it began to drive may go on while it turns, until it has the margin again."""
        model, origin = self._model, state.origin
        if origin is None:
            return
        north_m = (model.latitude_rad - origin.latitude_rad) * origin.north_m_per_rad
        east_m = (model.longitude_rad - origin.longitude_rad) * origin.east_m_per_rad
        clear_m = min((clearance_m(zone, north_m, east_m) for zone in around.zones), default=math.inf)
        inside, has_margin = clear_m > -NOISE_M, clear_m >= around.limits.margin_m
        self._drifted = not has_margin and (idle or self._drifted)
        deceived = math.dist((north_m, east_m), (state.motion.north_m, state.motion.east_m)) > DECEIVED_M
        obeys = not any(drive.fault for drive in model.drives.values())
        if self._was_inside and not inside and not self._drifted and not idle and obeys and not deceived:
            self._fail(f"outside the fence in mode {state.mode.name.lower()}")
        self._was_inside = inside

    def _fail(self, words: str) -> None:
        if not any(words in known for known in self.failures):
            self.failures.append(f"{words} at {self._run.elapsed_s:.1f} s ({self._run.state.reason})")
