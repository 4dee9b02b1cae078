"""The manoeuvres of a trial, one after the other: what the operator's computer asks of the boat, and why it goes on or ends.

Each is a stream of orders for the mode `trial`, a second each, which the boat bounds by itself. Power grows only until a
response is seen; nothing is built on the motors before they are proven. A manoeuvre that the edge of the circle or a quick turn
ended is no fault: the boat is brought back, and the trial goes on. Any other end ends the trial.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from random import Random
from statistics import fmean
from typing import Final, Literal, NamedTuple, Protocol

from delfim.adoption.trial import motors, several, steered
from delfim.adoption.trial.motors import Doublet, DriftNoise, MotorsFound, Response, Sample
from delfim.base.errors import DelfimError
from delfim.base.geodesy import wrap
from delfim.config import ThrusterTable

AGAIN_S: Final = 0.2  # an order is renewed so often ...
PIECE_S: Final = 1.0  # ... and lasts so long without
TURN_MOST_RADPS: Final = math.radians(50.0)  # asked for by no manoeuvre: a faster spin is a compass that jumps
TOO_QUICK: Final = "trial ended: turns at "
BRINGS_BACK: Final = ("trial ended: edge of the circle", TOO_QUICK, "trial done")  # ends that the trial survives
NEAR: Final = 0.2  # of the radius: this near the middle a manoeuvre may begin
DRIFTS: Final = 0.4  # of the radius: this far before the second motor was tried she is carried off
FAR: Final = 0.5  # of the radius: from beyond it she comes back before her motors are proven ...
OUT: Final = 1.1  # ... and may go so far for it
STILL_S: Final = 5.0  # until the doublets that prove them
GYRO_LOOKS: Final = 20  # at the boat, ten a second, whose turn by heading and by gyro are compared ...
GYRO_RAD2: Final = 0.02  # ... and this sum of squares is beyond noise
PROOF_RAD, PROOF_S, NEAR_RAD = math.radians(60.0), 60.0, math.radians(25.0)  # of a boat that steers: wind, and a rudder askew
LIMIT_S: Final = 20.0 * 60.0  # of the whole trial

Parts = tuple[float, ...]
Values = tuple[float, ...]


class MotionSeen(NamedTuple):
    """What the boat tells: places in metres from the middle of the circle."""

    at_s: float
    north_m: float
    east_m: float
    heading_rad: float
    turn_radps: float
    north_mps: float
    east_mps: float
    told: Parts  # what its thrusters were told
    is_on: bool  # it is in trial mode
    reason: str  # why it is in its mode, in words
    measured: dict[str, Values] | None = None  # behind an estimator: what each sensor said last, its time first, rad, m/s

    @property
    def ahead_mps(self) -> float:
        return self.north_mps * math.cos(self.heading_rad) + self.east_mps * math.sin(self.heading_rad)

    @property
    def far_m(self) -> float:
        return math.hypot(self.north_m, self.east_m)

    @property
    def inwards_rad(self) -> float:
        """The bearing of the middle."""
        return math.atan2(-self.east_m, -self.north_m)


class BoatOnTrial(Protocol):
    """A boat that a trial talks to."""

    @property
    def middle(self) -> tuple[float, float]:
        """Of the circle: latitude and longitude, degrees."""

    def wait(self) -> MotionSeen:
        """Let a tenth of a second pass, or what the boat needs to tell something new. Raises DelfimError."""

    def play(self, parts: Parts, for_s: float, name: str, *, begin: bool, comes_back: bool) -> None:
        """Give an order for the mode. Raises Refused."""

    def end(self, mode: str) -> None:
        """End the trial in this mode: idle, or hold."""


class TrialEnded(DelfimError):
    """The trial is over before its time; the text says why."""


class Played(NamedTuple):
    """A manoeuvre that was played."""

    name: str
    from_s: float
    to_s: float
    ended: str = ""  # by what, in words; empty: it went as it should


class StepTold(NamedTuple):
    """A manoeuvre of the list, when it begins and when it has ended."""

    name: str
    words: str
    state: Literal["under way", "done", "ended"]
    reason: str  # why it ended before its time, in words
    elapsed_s: float  # of the trial
    far_m: float  # from the middle


Push = Parts | Callable[[MotionSeen], Parts]
Until = Callable[[MotionSeen], bool]
Steered = Callable[[MotionSeen], float]  # a heading or a part


class SeaTrial:
    """One trial: what was found so far, and what was seen."""

    def __init__(
        self,
        boat: BoatOnTrial,
        length_m: float,
        radius_m: float,
        tell: Callable[[str], object],
        seed: int = 1,
        *,
        steers: bool = False,
        rows: Sequence[ThrusterTable] = (),
    ) -> None:
        """`tell` is given a sentence for each step; `steers`: the boat has one motor that steers; `rows`: of its file, where it
        has three or more."""
        self.steers, self.rows = steers, rows
        self.boat, self.length_m, self.radius_m, self.tell = boat, length_m, radius_m, tell
        self.tape, self.played = list[MotionSeen](), list[Played]()
        self.seen = boat.wait()
        self.began_s = self.seen.at_s
        self.motors: MotorsFound | None = None
        self.quiet = DriftNoise(0.0, 0.0)
        self.gain, self.full_radps = (
            1.2 if steers else 0.5,
            0.5,
        )  # of heading to differential; rate of turn of full differential
        self.turn_most_radps = TURN_MOST_RADPS  # less for a compass that is much bent
        self._name, self._random = "", Random(seed)
        self.step: Callable[[StepTold], object] = lambda told: None  # is given each step when it begins and when it has ended
        self._begun = self._ended_itself = False

    @property
    def elapsed_s(self) -> float:
        return self.seen.at_s - self.began_s

    def drive(self, push: Push, seconds: float, until: Until = lambda seen: False, *, comes_back: bool = False) -> str:
        """Ask for these parts, for so long or until that is seen. Returns what ended it before, in words; empty: nothing did.
        Raises TrialEnded where that ends the trial."""
        until_s, asked_s = self.seen.at_s + seconds, -math.inf
        while self.seen.at_s < until_s - 1e-6:
            if self.seen.at_s - asked_s >= AGAIN_S - 1e-6:
                parts = push(self.seen) if callable(push) else push
                if not self.seen.is_on:
                    self._may_begin()
                self.boat.play(parts, PIECE_S, self._name, begin=not self.seen.is_on, comes_back=comes_back)
                self._begun, asked_s = True, self.seen.at_s
            self._next()
            if not self.seen.is_on:
                return self._survived()
            if until(self.seen):
                break
        return ""

    def _may_begin(self) -> None:
        """An order that begins the mode is given where the trial itself, or its bounds, ended the one before."""
        if self._begun and not self.seen.reason.startswith(BRINGS_BACK):
            raise TrialEnded(self.seen.reason)

    def _survived(self) -> str:
        if not self.seen.reason.startswith(BRINGS_BACK):
            raise TrialEnded(self.seen.reason)
        return self.seen.reason

    def _next(self) -> None:
        self.seen = self.boat.wait()
        self.tape.append(self.seen)
        if self.elapsed_s > LIMIT_S:
            raise TrialEnded(f"{LIMIT_S / 60.0:.0f} minutes are over")

    def pause(self) -> None:
        """Motors off and out of the mode, for a question that may take its time."""
        self.boat.end("idle")
        self._begun = False
        self._next()

    def rest(self, seconds: float) -> str:
        return self.drive((0.0,) * len(self.seen.told or (0.0, 0.0)), seconds, comes_back=True)

    # Motors.

    def drift(self, seconds: float) -> None:
        """Motors off: what wind, current and noise do."""
        since_s = self.seen.at_s
        self.rest(seconds)
        self.quiet = motors.noise([_sample(each) for each in self.tape if each.at_s > since_s])

    def doublet(self, asked: Doublet) -> Response:
        """The answer to a doublet, cut short where it turns the boat quickly."""
        since_s, fast = self.seen.at_s, lambda seen: abs(seen.turn_radps) > TURN_MOST_RADPS
        ended = self.drive(asked.parts, asked.held_s, fast)
        held_s = self.seen.at_s - since_s
        ended = ended or self.drive(asked.back, held_s, fast) or self.rest(motors.LATE_S + 0.3)
        of = several.response if self.rows else motors.response
        answer = of([_sample(each) for each in self.tape if each.at_s >= since_s], since_s, held_s)
        self.rest(several.REST_S if self.rows else 2.0)
        if ended:
            raise TrialEnded(f"{ended}: no clear answer; begin upstream and upwind")
        return answer

    def find_motors(self) -> MotorsFound:
        """Raises TrialEnded where there is no clear answer."""
        if self.rows:
            asked = several.finding(self.rows, self.length_m, self.quiet)
        else:
            drifts = lambda: self.seen.far_m > DRIFTS * self.radius_m  # noqa: E731
            two = motors.finding(self.length_m, self.quiet, drifts)
            asked = steered.finding(self.length_m, self.quiet) if self.steers else two
        try:
            doublet = next(asked)
            while True:
                doublet = asked.send(self.doublet(doublet))
        except StopIteration as end:
            found: MotorsFound | str = end.value
        if isinstance(found, str):
            raise TrialEnded(found)
        self.motors = found
        return found

    @property
    def gyro_is_upside_down(self) -> bool:
        """Whether the rate of turn has the wrong sign, by what the heading did in pieces of two seconds."""
        together = alone = 0.0
        for first, last in pairwise(range(0, len(self.tape), GYRO_LOOKS)):
            piece = self.tape[first : last + 1]
            steps = pairwise(piece)
            by_gyro = sum(0.5 * (was.turn_radps + now.turn_radps) * (now.at_s - was.at_s) for was, now in steps)
            together += wrap(piece[-1].heading_rad - piece[0].heading_rad) * by_gyro
            alone += by_gyro * by_gyro
        return alone > GYRO_RAD2 and together < -0.5 * alone

    def push_ahead(self) -> None:
        """Both motors ahead for a person who looks whether the bow goes first."""
        self.drive(self.mix(0.25, 0.0), 3.0)
        self.rest(1.0)

    def prove_motors(self) -> None:
        """Raises TrialEnded where the turn does not prove what was found."""
        assert self.motors is not None
        if self.steers:
            self._prove_steering()
            return
        if self.rows:
            asked = several.proving(self.motors, self.rows, self.length_m, self.quiet)
        else:
            asked = motors.proving(self.motors, self.length_m, self.quiet)
        try:
            doublet = next(asked)
            while True:
                doublet = asked.send(self.doublet(doublet))
        except StopIteration as end:
            if end.value:
                raise TrialEnded(f"not proven: {end.value}") from None

    def _prove_steering(self) -> None:
        """Steer to a heading at either side. Raises TrialEnded where she does not come to both."""
        ahead_rad = self.seen.heading_rad
        for side, words in ((1.0, "starboard"), (-1.0, "port")):
            goal_rad = ahead_rad + side * PROOF_RAD
            self.drive(self.towards(goal_rad, lambda seen: steered.PUSH), PROOF_S, lambda seen: self._is_at(goal_rad))  # noqa: B023
            if not self._is_at(goal_rad):
                degrees = math.degrees(PROOF_RAD)
                raise TrialEnded(f"not proven: she does not come to a heading {degrees:.0f} degrees to {words}, steered to it")
        self.rest(2.0)

    def _is_at(self, heading_rad: float) -> bool:
        return abs(wrap(heading_rad - self.seen.heading_rad)) < NEAR_RAD

    # The hull.

    def mix(self, surge: float, turn: float) -> Parts:
        """Parts for a push ahead and a turn to starboard, of the rows of the file."""
        assert self.motors is not None
        if self.rows:
            return several.mix(self.motors, self.rows, surge, turn)
        return steered.mix(self.motors, surge, turn) if self.steers else motors.mix(self.motors, surge, turn)

    def towards(self, heading: float | Steered, surge: Steered) -> Callable[[MotionSeen], Parts]:
        """Steer a heading, carefully: turn first, then go."""

        def push(seen: MotionSeen) -> Parts:
            error_rad = wrap((heading(seen) if callable(heading) else heading) - seen.heading_rad)
            turn = max(-0.5, min(0.5, self.gain * (error_rad - 0.8 * seen.turn_radps)))
            return self.mix(surge(seen) * max(0.0, math.cos(error_rad)), self.slower(seen, turn))

        return push

    def back(self, limit_s: float = 80.0, *, is_proven: bool = True) -> None:
        """Bring the boat near the middle, harder where it comes no nearer. By motors that are not proven she may hardly go
        beyond the edge for it. Raises TrialEnded where she does."""
        near_m, least_m, since_s, more = max(4.0, NEAR * self.radius_m), self.seen.far_m, self.seen.at_s, 0.0
        until_s = self.seen.at_s + limit_s

        def surge(seen: MotionSeen) -> float:
            nonlocal least_m, since_s, more
            if seen.far_m < least_m - 1.0:
                least_m, since_s = seen.far_m, seen.at_s
            elif seen.at_s - since_s > 0.25 * limit_s:  # wind or current is stronger than this power
                since_s, more = seen.at_s, min(more + 0.15, 0.5)
            return min(0.45, 0.15 + 0.03 * seen.far_m) + more

        push, most_m = self.towards(lambda seen: seen.inwards_rad, surge), math.inf if is_proven else OUT * self.radius_m
        while self.seen.far_m > near_m and self.seen.at_s < until_s:
            ended = self.drive(push, until_s - self.seen.at_s, lambda seen: not near_m < seen.far_m < most_m, comes_back=True)
            if (self.rows or not is_proven) and ended.startswith(TOO_QUICK):
                self.gain = max(0.08, 0.5 * self.gain)
            if self.seen.far_m >= most_m:
                raise TrialEnded(f"{self.seen.far_m:.0f} m from the middle, and she does not come back by what was found")
        self.rest(1.0 if is_proven else STILL_S)

    def learn_gain(self) -> None:
        """A first gain from the rate of turn of a small differential."""
        rates = list[float]()
        for way in (1.0, -1.0):
            self.drive(self.mix(0.0, 0.3 * way), 4.0, lambda seen: abs(seen.turn_radps) > 0.6)
            rates.append(abs(self.seen.turn_radps))
            self.rest(2.0)
        self.full_radps = max(0.03, fmean(rates)) / 0.3
        self.gain = max(0.08, min(0.8, 0.35 / self.full_radps))

    def circles(self, turns: float = 1.15, rate_radps: float = math.radians(12.6), limit_s: float = 70.0) -> None:
        """Slowly round, once each way, creeping ahead: compass and antenna."""
        for way in (1.0, -1.0):
            turned_rad, last_rad, turn = 0.0, self.seen.heading_rad, 0.2

            def push(seen: MotionSeen, way: float = way) -> Parts:
                nonlocal turn
                turn = max(0.02, min(0.7, turn + 0.04 * (rate_radps - way * seen.turn_radps)))
                return self.mix(0.15, way * turn)

            def round_it(seen: MotionSeen) -> bool:
                nonlocal turned_rad, last_rad
                turned_rad, last_rad = turned_rad + wrap(seen.heading_rad - last_rad), seen.heading_rad
                return abs(turned_rad) > turns * math.tau

            self.drive(push, limit_s, round_it)
            self.rest(1.5)

    def leg(self, heading_rad: float, part: float, seconds: float = 7.0, coast_s: float = 4.0) -> None:
        """Ahead on a heading from near the middle, then motors off."""
        self.back()
        turned = lambda seen: abs(wrap(heading_rad - seen.heading_rad)) < 0.15 and abs(seen.turn_radps) < 0.15  # noqa: E731
        self.drive(self.towards(heading_rad, lambda seen: 0.0), 12.0, turned)
        self.rest(1.0)
        self.drive(self.towards(heading_rad, lambda seen: part), seconds)
        self.rest(coast_s)

    def legs(self) -> None:
        """Ahead with growing power and coast, both ways along a line; then astern. Full power after a coast from less."""
        heading_rad = self.seen.heading_rad
        for way in (0.0, math.pi):
            for part in (0.3, 0.6, 1.0):
                self.leg(heading_rad + way, part)
        self.back()
        for part in (-0.4, -0.8):
            self.drive(self.mix(part, 0.0), 5.0)
            self.rest(3.0)

    def slower(self, seen: MotionSeen, turn: float) -> float:
        """The differential, less of it the nearer she is to the rate of turn that she may have."""
        share = abs(seen.turn_radps) / self.turn_most_radps if turn * seen.turn_radps > 0.0 else 0.0
        return turn * min(1.0, max(0.0, 2.5 * (1.0 - share)))

    def spins(self) -> None:
        """On the spot both ways, with two powers."""
        for level in (0.35, 0.8):
            for way in (1.0, -1.0):
                turn = way * min(level, 0.9 * self.turn_most_radps / self.full_radps)
                self.drive(lambda seen, turn=turn: self.mix(0.0, self.slower(seen, turn)), 6.0)  # type: ignore[misc]
                self.rest(2.5)

    def wiggle(self, surge: float, seconds: float = 50.0) -> None:
        """Random turns about a way ahead, towards the middle where it is far."""
        until_s, next_s, turn = self.seen.at_s + seconds, -math.inf, 0.0
        depth = min(0.35, 0.8 * self.turn_most_radps / self.full_radps)

        def push(seen: MotionSeen) -> Parts:
            nonlocal next_s, turn
            if seen.at_s > next_s:
                next_s = seen.at_s + self._random.uniform(0.8, 2.5)
                turn = self._random.choice((-1.0, -0.5, 0.5, 1.0)) * depth
                if seen.far_m > 0.45 * self.radius_m and abs(wrap(seen.inwards_rad - seen.heading_rad)) > 0.5 * math.pi:
                    turn, next_s = math.copysign(depth, wrap(seen.inwards_rad - seen.heading_rad)), seen.at_s + 1.0
            return self.mix(surge, self.slower(seen, turn))

        while self.seen.at_s < until_s - 1.0:
            if self.drive(push, until_s - self.seen.at_s):
                self.back()

    # The whole.

    def play(self, name: str, words: str, manoeuvre: Callable[[], object]) -> None:
        """Play one, and note how it went."""
        self.tell(words)
        self._name, from_s = name, self.seen.at_s
        self.step(StepTold(name, words, "under way", "", self.elapsed_s, self.seen.far_m))
        try:
            manoeuvre()
        except DelfimError as end:
            self.played.append(Played(name, from_s, self.seen.at_s, str(end)))
            self.step(StepTold(name, words, "ended", str(end), self.elapsed_s, self.seen.far_m))
            raise
        self.played.append(Played(name, from_s, self.seen.at_s))
        self.step(StepTold(name, words, "done", "", self.elapsed_s, self.seen.far_m))

    def hull(self, done: Sequence[str] = (), did: Callable[[str], object] = lambda name: None) -> None:
        """All that follows once the motors are proven, but what was done already. `did` is told each that came to its end."""
        steps: tuple[tuple[str, str, Callable[[], object]], ...] = (
            ("gain", "Turns a little each way, to steer carefully from now on.", self.learn_gain),
            ("circles", "A slow circle each way: compass and antenna.", self.circles),
            ("legs", "Ahead with growing power and motors off, both ways: thrust, drag, stopping.", self.legs),
            ("spins", "Turns on the spot.", self.spins),
            ("wiggle slow", "Random turns at low speed.", lambda: self.wiggle(0.35)),
            ("wiggle fast", "Random turns at speed.", lambda: self.wiggle(0.7)),
            ("drift again", "Motors off: what wind and current did meanwhile.", lambda: self.drift(10.0)),
        )
        for name, words, manoeuvre in steps:
            if name not in done or name == "gain":
                self.play("back", "Back to the middle.", self.back)
                self.play(name, words, manoeuvre)
                did(name)


def _sample(seen: MotionSeen) -> Sample:
    return Sample(seen.at_s, seen.turn_radps, seen.ahead_mps, seen.north_mps, seen.east_mps, seen.heading_rad)
