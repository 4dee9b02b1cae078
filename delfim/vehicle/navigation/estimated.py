"""The estimator's place: between a source of separate sensors and the loop (docs/estimator.md).

The source hands over each value as it comes. A message goes to the loop `navigation.rate_hz` times a second, with a value that
came. As without the estimator, there are messages only while the source hears a receiver, even one that has no position.
"""

import math
from typing import Final, Protocol, cast

from delfim import config
from delfim.canproxy.dsor.messages import Navigation
from delfim.vehicle.inputhealth import HEADING, NEVER_S, POSITION, RATE, VELOCITY
from delfim.vehicle.navigation.estimator import LATE_MAX_S, Estimate, Estimator
from delfim.vehicle.navigation.fixes import Fix, Source
from delfim.vehicle.navigation.fusion import Hearer
from delfim.vehicle.state import State

STEP_S: Final = 0.5  # stamps that differ from the monotonic clock by more than they did come from a clock that was set
SOONER: Final = 0.8  # of a period: sensors are not punctual
FIX_2D: Final = 2
_new = tuple.__new__  # in half the time of Navigation(...): this is on the critical path
SETTLE_S: Final = 0.5  # after the start: what waited while the program came up has stamps that say nothing of its age


class SeparateSource(Source, Protocol):
    """A source that can hand over the values of its sensors one by one."""

    t_ns: int  # the stamp of what it read last

    def tell(self, hearer: Hearer) -> None: ...  # from now on, as they are read


class Estimated:
    """A source whose sensors go through an estimator."""

    def __init__(self, source: SeparateSource, settings: config.Vehicle, state: State) -> None:
        self.name, self.input, self._source = source.name, source.input, source
        limits = settings.navigation
        self.estimator = Estimator(settings.estimator, limits, settings.failsafe.navigation_frozen.after_s)
        state.inputs[self.name] = self.estimator.inputs
        self._period_s, self._stale_s = SOONER / limits.rate_hz, limits.stale_s
        self._zero_ns, self._zero_s, self._now_s = 0, 0.0, 0.0
        self._began_s, self._sent_s = math.inf, -math.inf
        self._has_begun = self._begins = False  # ever, and in this read
        self._said: Navigation | None = None  # the source's own last message ...
        self._said_ns = 0  # ... and its stamp
        self._due: tuple[Estimate, int] | None = None  # the motion for the next message, and the stamp of its newest value
        self._counter = 0
        source.tell(self._hear)

    @property
    def heard_s(self) -> float:
        return self._source.heard_s

    @heard_s.setter
    def heard_s(self, at_s: float) -> None:
        self._source.heard_s = at_s

    def read(self, now_s: float) -> Fix | None:
        """The motion at the value with which the message was due; None while it is not."""
        self._now_s, self._due, self._begins = now_s, None, False
        self._began_s = min(self._began_s, now_s)
        fix = self._source.read(now_s)
        if now_s - self._began_s < SETTLE_S:
            self._source.heard_s = NEVER_S
            return None
        if fix is not None:
            self._said, self._said_ns = fix.navigation, fix.t0_ns
        if self._due is None or self._said is None:
            return None
        estimate, t_ns = self._due
        return _new(Fix, (self._message(self._said, estimate, t_ns), t_ns, now_s))

    def report(self, now_s: float) -> dict[str, object]:
        """The source's figures, and the estimator's."""
        inputs = {
            each.name: {"age_s": round(now_s - each.heard_s, 1), "heard": each.heard, "refused": each.refused}
            for each in self.estimator.inputs
            if each.heard
        }
        return {**self._source.report(now_s), "estimator": {**inputs, "begun_again": self.estimator.restarts}}

    def _message(self, said: Navigation, e: Estimate, t_ns: int) -> Navigation:
        """The estimate, with what it does not estimate as the source said it last."""
        self._counter = self._counter + 1 & 0xFF
        utc_ns = said.utc_ns + t_ns - self._said_ns if said.utc_ns else 0
        fix = 0 if e.latitude_rad is None else said.fix or FIX_2D
        fields = (
            *(utc_ns, *e[:6], said.roll_rad, said.pitch_rad, fix, said.satellites, said.hdop, self._counter),
            *(said.accuracy_m, said.corrections_s),
        )
        return _new(Navigation, fields)

    def _hear(self, kind: str, value: tuple[float, ...], utc_ns: int, deviation: float = 0.0) -> None:
        """A value. After a silence, as at the start, everything begins with a position: what came before it was perhaps heard,
        perhaps not, and a replay does not know which."""
        at_s, estimator = self._time_s(self._source.t_ns), self.estimator
        if at_s - self._began_s < SETTLE_S:
            return  # by its stamp: values of that time may be read at once afterwards
        if not self._has_begun or not self._now_s - self._source.heard_s <= self._stale_s:
            if kind != POSITION:
                return
            estimator.begin(at_s)
            self._sent_s, self._due = -math.inf, None
            self._has_begun = self._begins = True
        late_s = (self._source.t_ns - utc_ns) / 1e9 if utc_ns else -1.0
        told_s = late_s if 0.0 <= late_s <= LATE_MAX_S else None  # the clocks agree, or the settings say it
        if kind == POSITION:
            estimator.position(at_s, value[0], value[1], told_s, deviation)
        elif kind == VELOCITY:
            estimator.velocity(at_s, value[0], value[1], told_s, deviation)
        elif kind == HEADING:
            estimator.heading(at_s, value[0], told_s, deviation)
        elif kind == RATE:
            estimator.rate(at_s, value[0])
        if self._begins and self._due is not None:
            return  # the first message has the stamp of the position with which everything began, by which a replay finds it
        if at_s - self._sent_s >= self._period_s:  # now, however many values are read at once: a replay reads others together
            self._sent_s, self._due = at_s, (estimator.estimate(at_s), self._source.t_ns)

    def _time_s(self, t_ns: int) -> float:
        """A stamp on the axis of the monotonic clock. Stamps are the kernel's: a busy computer makes nothing late, and a
        replay has the same ones."""
        at_s = self._zero_s + (t_ns - self._zero_ns) / 1e9
        if not abs(self._now_s - at_s) <= STEP_S:
            self._zero_ns, self._zero_s, at_s = t_ns, self._now_s, self._now_s
        return at_s


def between(sources: tuple[Source, ...], settings: config.Vehicle, state: State) -> tuple[Source, ...]:
    """The sources, each of separate sensors behind an estimator of its own."""
    return tuple(Estimated(cast(SeparateSource, each), settings, state) if hasattr(each, "tell") else each for each in sources)
