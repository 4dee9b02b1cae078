"""The proof sail: two turns of 90 degrees, a stop, a minute of holding, by the boat with what was found, and the same by its
twin in the drift of the moment. A boat that does worse than its twin foretells was not understood: its gains are put back.
"""

import math
import time
from collections import deque
from collections.abc import Callable
from statistics import fmean
from typing import Any, Final, NamedTuple, Protocol

from delfim import config
from delfim.adoption.trial.boats import TrialCircle
from delfim.adoption.trial.manoeuvres import TrialEnded
from delfim.adoption.twin.twinvoyage import SETTLE_S, twin_of
from delfim.base.errors import DelfimError, Refused
from delfim.base.geodesy import wrap
from delfim.simulator.lockstep import Lockstep, uncollected
from delfim.simulator.tables import Sea
from delfim.vehicle import console
from delfim.vehicle.operator.link import Link
from delfim.vehicle.state import NoLog

WAY_S, TURN_S, STOP_S, DRIFT_S, HOLD_S = 12.0, 20.0, 15.0, 5.0, 60.0  # of the drift the last part of the stop
NEAR_DEG: Final = 5.0  # of a heading that she has settled on, as the mean of MEAN_S has it: a compass is not quiet
MEAN_S: Final = 1.0
AHEAD_S: Final = 3.0  # of way, that the point which she holds is ahead
CIRCLE_S: Final = 45.0  # at full speed of the proof, from the middle of the circle to its edge
FAR: Final = 0.3  # of the radius, from which on the first way leads inwards
OVER_DEG, SETTLED_S, SETTLED, STOP_M, STOP, HOLD_M = 3.0, 2.0, 0.2, 1.0, 0.2, 0.5  # worse than foretold, at most
CIRCLING: Final = 1.0  # of the foretold distance, more of a boat that steers
SEEDS: Final = 1, 2, 3  # of the twin's sensors and gusts: the worst of these is foretold
LOOK_S: Final = 0.2


class ProofSeen(NamedTuple):
    """What a boat tells: metres from the middle of the circle."""

    at_s: float
    north_m: float
    east_m: float
    heading_rad: float
    north_mps: float
    east_mps: float
    mode: str
    reason: str


class ProofBoat(Protocol):
    """A boat that sails a proof."""

    def wait(self) -> ProofSeen:
        """Let some time pass. Raises DelfimError."""

    def order(self, command: str, **words: Any) -> None:
        """Give an order of the console. Raises Refused."""


class ProofFigures(NamedTuple):
    """How she did it. Of both turns the better one counts: a gust is no fault of hers."""

    over_deg: float
    settled_s: float
    stop_m: float  # way through the water with the motors off
    hold_m: float  # rms from the point

    def worse(self, foretold: "ProofFigures", *, steers: bool = False) -> list[str]:
        """In what she did worse than that, in words. A boat that steers holds by going round: how far off is chance."""
        bounds = (
            ("goes {:.1f} deg beyond a new heading, foretold {:.1f}", foretold.over_deg + OVER_DEG),
            ("needs {:.1f} s for a turn of 90 deg, foretold {:.1f}", _bound(foretold.settled_s, SETTLED_S, SETTLED)),
            ("needs {:.1f} m to stop, foretold {:.1f}", _bound(foretold.stop_m, STOP_M, STOP)),
            (
                "holds a point within {:.1f} m rms, foretold {:.1f}",
                _bound(foretold.hold_m, HOLD_M, CIRCLING if steers else 0.0),
            ),
        )
        rows = zip(self, foretold, bounds, strict=True)
        return [f"she {words.format(had, was)}" for had, was, (words, most) in rows if had > most]


def _bound(foretold: float, more: float, part: float) -> float:
    return foretold + max(more, part * foretold)


class Drift(NamedTuple):
    """Of the boat with its motors off, m/s."""

    north_mps: float
    east_mps: float

    @property
    def sea(self) -> Sea:
        """A sea whose current does that."""
        to_deg = math.degrees(math.atan2(self.east_mps, self.north_mps)) % 360.0
        return Sea(current_mps=min(math.hypot(*self), 3.0), current_to_deg=to_deg)


def proved(boat: ProofBoat, settings: config.Vehicle, radius_m: float, tell: Callable[[str], object]) -> str:
    """Sail it, and compare. Returns in what she does worse than her twin, in words; empty: proven. `settings`: of the file as
    it is now. Raises DelfimError where the sail did not come to its end."""
    speed_mps = min(settings.control.speed.cruise_mps, radius_m / CIRCLE_S)
    tell(f"Proof: two turns of 90 degrees at {speed_mps:.1f} m/s, a stop, a minute of holding.")
    had, drift = sail(boat, speed_mps, radius_m)
    foretold = foretell(settings, speed_mps, drift)
    for words, found, was in zip(ProofFigures._fields, had, foretold, strict=True):
        tell(f"  {WORDS[words]:44}{found:9.2f}  foretold {was:.2f}")
    return "; ".join(had.worse(foretold, steers=settings.thrusters[0].steer is not None))


WORDS: Final = {
    "over_deg": "beyond a new heading, deg",
    "settled_s": "until a turn of 90 deg is settled, s",
    "stop_m": "way to stop, m",
    "hold_m": "from the point that she holds, rms, m",
}


def foretell(settings: config.Vehicle, speed_mps: float, drift: Drift) -> ProofFigures:
    """The worst of some sails of the twin in this drift."""
    twin, every = twin_of(settings, drift.sea), list[ProofFigures]()
    for seed in SEEDS:
        with uncollected():
            every.append(sail(SimulatedProof(Lockstep(twin, seed, lambda clock: NoLog())), speed_mps, math.inf)[0])
    return ProofFigures(*(max(column) for column in zip(*every, strict=True)))


def sail(boat: ProofBoat, speed_mps: float, radius_m: float) -> tuple[ProofFigures, Drift]:
    """Sail the proof within a circle. Raises DelfimError, with the reason in words; the boat holds then, or is stopped."""
    proof = _Proof(boat, radius_m)
    first = proof.seen
    is_far = math.hypot(first.north_m, first.east_m) > FAR * radius_m
    heading_rad = math.atan2(-first.east_m, -first.north_m) if is_far else first.heading_rad
    proof.turned(heading_rad, speed_mps, WAY_S)
    turns = list[tuple[float, float]]()
    for _ in range(2):  # both to one side: she comes back
        heading_rad += 0.5 * math.pi
        turns.append(proof.turned(heading_rad, speed_mps, TURN_S))
    stop_m, drift = proof.stopped()
    hold_m = proof.held()
    return ProofFigures(min(turn[0] for turn in turns), min(turn[1] for turn in turns), stop_m, hold_m), drift


class _Proof:
    """A proof sail under way."""

    def __init__(self, boat: ProofBoat, radius_m: float) -> None:
        self._boat, self._radius_m = boat, radius_m
        self.seen = boat.wait()

    def _watch(self, seconds: float, mode: str, look: Callable[[ProofSeen], object]) -> None:
        until_s = self.seen.at_s + seconds
        while self.seen.at_s < until_s - 1e-6:
            self.seen = self._boat.wait()
            if self.seen.mode != mode:
                raise TrialEnded(f"the proof sail ended: the boat is in {self.seen.mode}: {self.seen.reason}")
            if math.hypot(self.seen.north_m, self.seen.east_m) > self._radius_m:
                self._boat.order("mode", mode="hold")
                raise TrialEnded(f"the proof sail ended: edge of the circle, {self._radius_m:.0f} m from its middle; she holds")
            look(self.seen)

    def turned(self, goal_rad: float, speed_mps: float, seconds: float) -> tuple[float, float]:
        """Order a heading. Returns by how much, deg, she went beyond it, and when she stayed near it, s."""
        self._boat.order("heading", heading_deg=math.degrees(wrap(goal_rad)), speed_mps=speed_mps)
        began_s, over_deg, settled_s, last = self.seen.at_s, 0.0, 0.0, deque[tuple[float, float]]()

        def look(seen: ProofSeen) -> None:
            nonlocal over_deg, settled_s
            last.append((seen.at_s, math.degrees(wrap(seen.heading_rad - goal_rad))))
            while last[0][0] < seen.at_s - MEAN_S:
                last.popleft()
            off_deg = fmean(off for _, off in last)
            over_deg = max(over_deg, off_deg if off_deg < 90.0 else 0.0)
            if abs(off_deg) > NEAR_DEG:
                settled_s = seen.at_s - began_s

        self._watch(seconds, "heading", look)
        return over_deg, settled_s

    def stopped(self) -> tuple[float, Drift]:
        """Motors off. Returns the way through the water, m, and the drift at its end."""
        self._boat.order("stop")
        tape = list[ProofSeen]()
        self._watch(STOP_S, "idle", tape.append)
        late = [each for each in tape if each.at_s > self.seen.at_s - DRIFT_S]
        drift = Drift(fmean(each.north_mps for each in late), fmean(each.east_mps for each in late))
        seconds = tape[-1].at_s - tape[0].at_s
        north_m = tape[-1].north_m - tape[0].north_m - seconds * drift.north_mps
        east_m = tape[-1].east_m - tape[0].east_m - seconds * drift.east_mps
        return math.hypot(north_m, east_m), drift

    def held(self) -> float:
        """Hold. Returns the rms distance from the point, m."""
        now, far_m = self.seen, list[float]()
        point = now.north_m + AHEAD_S * now.north_mps, now.east_m + AHEAD_S * now.east_mps
        self._boat.order("mode", mode="hold")
        self._watch(HOLD_S, "hold", lambda seen: far_m.append(math.dist(point, (seen.north_m, seen.east_m))))
        return math.sqrt(fmean(each * each for each in far_m))


class SimulatedProof:
    """A boat in lock step."""

    def __init__(self, run: Lockstep, look: Callable[[Lockstep], object] = lambda run: None) -> None:
        self._run, self._look = run, look
        for _ in run.cycles(2.0 * SETTLE_S):
            pass
        motion = run.state.motion
        self._middle = motion.north_m, motion.east_m

    def wait(self) -> ProofSeen:
        self._run.cycle()
        self._look(self._run)
        state, motion = self._run.state, self._run.state.motion
        at = motion.north_m - self._middle[0], motion.east_m - self._middle[1]
        moves = motion.heading_rad, motion.north_mps, motion.east_mps
        return ProofSeen(self._run.elapsed_s, *at, *moves, state.mode.name.lower(), state.reason)

    def order(self, command: str, **words: Any) -> None:
        if (why := self._run.command(console.asked(console.KINDS[command], **words))) is not None:
            raise Refused(why)


class RunningProof:
    """A boat that runs, at its command socket. `is_ended`: whether the operator ends the sail, asked at each look."""

    def __init__(self, link: Link, middle: tuple[float, float] | None, radius_m: float, is_ended: Callable[[], bool]) -> None:
        """`middle`: of the circle, degrees; None: where she is."""
        self._link, self._is_ended, told = link, is_ended, link.ask("state")
        self.sails_by = str(told.get("sails_by", ""))
        here = told["latitude_deg"], told["longitude_deg"]
        if None in here:
            raise DelfimError("the boat has no position yet")
        latitude_deg, longitude_deg = middle or here
        self._circle, self._next_s = TrialCircle(latitude_deg, longitude_deg, radius_m), time.monotonic()

    def wait(self) -> ProofSeen:
        self._next_s = max(self._next_s + LOOK_S, time.monotonic())
        time.sleep(max(self._next_s - time.monotonic(), 0.0))
        told = self._link.ask("state")
        if self._is_ended():
            self._link.ask("stop")
            raise TrialEnded("the operator ended it")
        known = [told[key] for key in ("latitude_deg", "longitude_deg", "heading_deg", "speed_mps")]
        if None in known:
            raise DelfimError(f"the boat does not tell where it is and how it moves; it is in {told['mode']}: {told['reason']}")
        latitude_deg, longitude_deg, heading_deg, speed_mps = known
        course_rad = math.radians(told["course_deg"] or 0.0)
        moves = math.radians(heading_deg), speed_mps * math.cos(course_rad), speed_mps * math.sin(course_rad)
        at = self._circle.place(latitude_deg, longitude_deg)
        return ProofSeen(time.monotonic(), *at, *moves, told["mode"], told["reason"])

    def order(self, command: str, **words: Any) -> None:
        self._link.ask(command, **words)
