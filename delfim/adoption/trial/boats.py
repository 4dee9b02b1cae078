"""The boats of a trial: one that runs, at its command socket, and one in simulation, whose hull and wiring nobody was told."""

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

from delfim import config
from delfim.adoption.trial.hiddenhull import Hidden, LateModel
from delfim.adoption.trial.manoeuvres import MotionSeen, Parts, TrialEnded
from delfim.base import geodesy
from delfim.base.errors import DelfimError, Refused
from delfim.base.modes import Mode
from delfim.config import ThrusterTable
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.model import Model
from delfim.vehicle import console
from delfim.vehicle.operator.link import Link
from delfim.vehicle.state import NoLog

LOOK_S: Final = 0.1
TURN_DPS: Final = 70.0  # the boat's own bound, beyond that of the manoeuvres
SETTLE_S: Final = 8.0  # that a simulated boat's receivers have before the trial
BERTH_PART, BERTH_S = 0.15, 1.0  # at the berth, of each motor
MODE: Final = Mode.TRIAL.name.lower()


class TrialCircle:
    """The circle of a trial, about where the boat was at its beginning, and its orders, each with a number."""

    def __init__(self, latitude_deg: float, longitude_deg: float, radius_m: float) -> None:
        self.latitude_deg, self.longitude_deg, self.radius_m, self._number = latitude_deg, longitude_deg, radius_m, 0
        self._plane = geodesy.origin(math.radians(latitude_deg), math.radians(longitude_deg))

    def order(self, parts: Parts, for_s: float, name: str, *, begin: bool, comes_back: bool) -> dict[str, Any]:
        self._number += 1
        place = {"latitude_deg": self.latitude_deg, "longitude_deg": self.longitude_deg, "radius_m": self.radius_m}
        told = {"number": self._number, "pieces": ((for_s, parts),), "name": name, "turn_dps": TURN_DPS}
        return told | place | {"begin": begin, "comes_back": comes_back}

    @property
    def middle(self) -> tuple[float, float]:
        return self.latitude_deg, self.longitude_deg

    def place(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Metres to the north and east of the middle."""
        return geodesy.to_plane(self._plane, math.radians(latitude_deg), math.radians(longitude_deg))


def told_of(rows: Sequence[ThrusterTable], thrust: Sequence[float], angles_rad: Sequence[float]) -> Parts:
    """What thrusters are told, as the pieces of a trial have it: parts of full command, then of the greatest angles."""
    turned = (
        angle_rad / row.steer.as_told[2] for row, angle_rad in zip(rows, angles_rad, strict=True) if row.steer is not None
    )
    return (*thrust, *turned)


class SimulatedTrial:
    """A hidden boat in lock step. `look` is called after each cycle."""

    def __init__(
        self,
        settings: config.Vehicle,
        hidden: Hidden,
        seed: int,
        radius_m: float,
        look: Callable[["SimulatedTrial"], object] = lambda boat: None,
        model: Model | None = None,
    ) -> None:
        """`model`: of another hand, in place of the hidden hull; the sensors are the hidden ones all the same."""
        self.model = LateModel(settings, hidden, seed) if model is None else model
        self.run, self._look = Lockstep(settings, seed, lambda clock: NoLog(), self.model), look
        hidden.sensors.put(self.run.nodes)
        for _ in self.run.cycles(SETTLE_S):
            pass
        here = self.run.state.navigation
        if here is None or here.latitude_rad is None or here.longitude_rad is None or self.run.state.origin is None:
            raise DelfimError(f"the boat has no position {SETTLE_S:.0f} s after its start")
        self.circle = TrialCircle(math.degrees(here.latitude_rad), math.degrees(here.longitude_rad), radius_m)
        self._middle = geodesy.to_plane(self.run.state.origin, here.latitude_rad, here.longitude_rad)
        self.middle_m = self.model.north_m, self.model.east_m  # in truth

    def wait(self) -> MotionSeen:
        self.run.cycle()
        self._look(self)
        state, motion = self.run.state, self.run.state.motion
        rows, sent = self.run.settings.thrusters, state.actuation
        told = told_of(rows, sent.thrust if sent.run else (0.0,) * len(rows), sent.angle_rad)
        north_m, east_m = motion.north_m - self._middle[0], motion.east_m - self._middle[1]
        moves = motion.heading_rad, motion.yaw_rate_radps, motion.north_mps, motion.east_mps
        raw = {each.name: (each.heard_s, *each.value) for each in state.inputs.get(state.source, ()) if each.heard}
        return MotionSeen(
            state.navigation_s, north_m, east_m, *moves, told, state.mode is Mode.TRIAL, state.reason, raw or None
        )

    def play(self, parts: Parts, for_s: float, name: str, *, begin: bool, comes_back: bool) -> None:
        order = self.circle.order(parts, for_s, name, begin=begin, comes_back=comes_back)
        why = self.run.command(console.Try(**order))
        if why is not None and begin:
            raise Refused(why)

    def turn_alone(self, name: str) -> str:
        """Turn a motor at the berth; returns what it reports, in words."""
        for _ in self.run.cycles(BERTH_S):
            self.run.command(console.Actuate(name, BERTH_PART, BERTH_S))
        return _reported(self.run.vehicle.report().thrusters[name].rpm)

    @property
    def middle(self) -> tuple[float, float]:
        return self.circle.middle

    def end(self, mode: str) -> None:
        self.run.command(console.Stop() if mode == "idle" else console.SetMode(mode))


class RunningTrial:
    """A boat that runs, at its local command socket. `is_ended`: whether the operator ends the trial, asked at each look."""

    def __init__(
        self,
        link: Link,
        rows: Sequence[ThrusterTable],
        radius_m: float,
        is_ended: Callable[[], bool],
        middle: tuple[float, float] | None = None,
    ) -> None:
        """`middle`: of the circle of a trial that goes on, degrees."""
        self._rows, self._link, self._is_ended, told = rows, link, is_ended, link.ask("state")
        self.sails_by = str(told.get("sails_by", ""))
        if told["latitude_deg"] is None or told["longitude_deg"] is None:
            raise DelfimError("the boat has no position yet")
        middle = middle or (told["latitude_deg"], told["longitude_deg"])
        self.circle, self._next_s = TrialCircle(*middle, radius_m), time.monotonic()

    def wait(self) -> MotionSeen:
        self._next_s = max(self._next_s + LOOK_S, time.monotonic())
        time.sleep(max(self._next_s - time.monotonic(), 0.0))
        if self._is_ended():
            raise TrialEnded("the operator ended it")
        return self._seen(self._link.ask("state"))

    def _seen(self, told: dict[str, Any]) -> MotionSeen:
        known = [told[key] for key in ("latitude_deg", "longitude_deg", "heading_deg", "turn_dps", "speed_mps")]
        told_s = told["age_s"]["navigation"]
        if None in known or told_s is None:
            raise DelfimError(f"the boat does not tell where it is and how it moves; it is in {told['mode']}: {told['reason']}")
        latitude_deg, longitude_deg, heading_deg, turn_dps, speed_mps = known
        course_rad = math.radians(told["course_deg"] or 0.0)
        moves = (
            math.radians(heading_deg),
            math.radians(turn_dps),
            speed_mps * math.cos(course_rad),
            speed_mps * math.sin(course_rad),
        )
        each = [told["thrusters"][row.name] for row in self._rows]
        angles_rad = [math.radians(its["angle_deg"] or 0.0) for its in each]
        parts = told_of(self._rows, [its["thrust"] if told["run"] else 0.0 for its in each], angles_rad)
        at, now_s = self.circle.place(latitude_deg, longitude_deg), time.monotonic()
        raw = {kind: (now_s - age_s, *values) for kind, (age_s, *values) in told["heard"].items()}
        return MotionSeen(now_s - told_s, *at, *moves, parts, told["mode"] == MODE, told["reason"], raw or None)

    def play(self, parts: Parts, for_s: float, name: str, *, begin: bool, comes_back: bool) -> None:
        try:
            self._link.ask(MODE, **self.circle.order(parts, for_s, name, begin=begin, comes_back=comes_back))
        except Refused:  # of a mode that has just ended the next look says why
            if begin:
                raise

    def turn_alone(self, name: str) -> str:
        """Turn a motor at the berth; returns what it reports, in words."""
        end_s, told = time.monotonic() + BERTH_S, dict[str, Any]()
        while time.monotonic() < end_s:
            told = self._link.ask("actuate", thruster=name, part=BERTH_PART, for_s=BERTH_S)
            time.sleep(LOOK_S)
        self._link.ask("stop")
        return _reported(told["thrusters"][name]["rpm"])

    @property
    def middle(self) -> tuple[float, float]:
        return self.circle.middle

    def end(self, mode: str) -> None:
        self._link.ask("stop") if mode == "idle" else self._link.ask("mode", mode=mode)


def _reported(rpm: float | None) -> str:
    return f"{BERTH_PART:.0%} for {BERTH_S:g} s, " + ("nothing reported" if rpm is None else f"{rpm:.0f} rpm reported")
