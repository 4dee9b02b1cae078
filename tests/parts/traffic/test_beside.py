"""Vessels that come along with the boat: its own transponder that the file does not name, and those that are really there."""

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from random import Random

import msgspec
import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.geodesy import compass, from_plane
from delfim.base.modes import Mode
from delfim.base.vessels import VesselPosition
from delfim.parts.traffic.beside import BESIDE_M, BESIDE_S, FRESH_S, Company, company
from delfim.parts.traffic.encounter import Own
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.state import NoLog, State
from delfim.vehicle.target import Target

VEHICLE = Path(__file__).parents[3] / "etc/delfimx.toml"
NUMBER, LENGTH_M = 263_000_009, 4.5
WORDS = f"{NUMBER} moves as this boat does and is not avoided. Its own transponder? Then traffic.mmsi = {NUMBER}"
Place = tuple[float, float, float, float]  # north_m, east_m, north_mps, east_mps


class Notes(NoLog):
    def __init__(self, clock: ManualClock) -> None:
        self.lines: list[str] = []

    def note(self, text: str) -> None:
        self.lines.append(text)


class Voyage:
    """The boat is ordered north at 1.5 m/s; a transponder speaks of a vessel each `every_s`, with the noise of a receiver."""

    def __init__(self, vessel: Callable[[State, float], Place], every_s: float, kind: str = "B") -> None:
        self.notes = list[str]()
        self.run = Lockstep(config.load(VEHICLE, ("simulation.heading_deg=0.0",)), 1, self._log)
        self._vessel, self._every_s, self._kind = vessel, every_s, kind
        list(self.run.cycles(10.0))
        assert self.run.command(console.Course(0.0, 1.5)) is None

    def _log(self, clock: ManualClock) -> Notes:
        notes = Notes(clock)
        self.notes = notes.lines
        return notes

    def sail(self, seconds: float) -> Iterator[State]:
        due_s, error, chance = 0.0, (0.0, 0.0), Random(1)
        for state in self.run.cycles(seconds):
            now_s = self.run.elapsed_s
            if now_s >= due_s:
                due_s = now_s + self._every_s
                error = 0.9 * error[0] + chance.gauss(0.0, 1.5), 0.9 * error[1] + chance.gauss(0.0, 1.5)
                north_m, east_m, north_mps, east_mps = self._vessel(state, now_s)
                assert state.origin is not None
                place = from_plane(state.origin, north_m + error[0], east_m + error[1])
                moves = compass(math.atan2(east_mps, north_mps)), math.hypot(north_mps, east_mps)
                second = int(now_s) % 60
                state.hear(VesselPosition(NUMBER, *place, *moves, None, None, self._kind, 15, second), "nmea2000", now_s)
            yield state


def itself(state: State, now_s: float) -> Place:
    own = state.motion
    return own.north_m, own.east_m, own.north_mps, own.east_mps


@pytest.mark.parametrize(("every_s", "kind"), [(2.0, "B"), (10.0, "A"), (30.0, "B")])
def test_a_boat_stops_swerving_for_its_own_transponder_and_says_so(every_s: float, kind: str) -> None:
    """On the bus without the mark of its own; by a second receiver aboard."""
    voyage = Voyage(itself, every_s, kind)
    *_, state = voyage.sail(150.0)
    begun_m, order = state.motion.north_m, state.traffic.order
    assert order is None
    for state in voyage.sail(100.0):
        assert state.traffic.order is None
    assert state.motion.north_m - begun_m == pytest.approx(150.0, abs=8.0), "the way is made again"
    assert state.mode is Mode.COURSE
    assert [(each.key, each.level, each.words) for each in state.traffic.dangers] == [(str(NUMBER), "near", WORDS)]
    assert {each.name: each.reason for each in state.notices} == {"traffic": WORDS}
    assert voyage.notes.count(f"traffic: {WORDS}") == 1


@pytest.mark.parametrize(
    ("every_s", "kind", "more"),
    [(2.0, "B", {}), (30.0, "B", {}), (10.0, "A", {"in_order": True}), (2.0, "B", {"digest": "0"})],
    ids=["killed", "killed, seldom heard", "ended in order", "another file"],
)
def test_a_boat_that_starts_again_keeps_its_course_with_its_own_transponder_aboard(every_s, kind, more):
    voyage = Voyage(itself, every_s, kind)
    list(voyage.sail(150.0))
    kept, _, rest = voyage.run.kept().partition(b"\n")
    voyage.run.restart(1.0, msgspec.json.encode(msgspec.json.decode(kept) | more) + b"\n" + rest)
    list(voyage.sail(10.0))
    assert voyage.run.command(console.Course(0.0, 1.5)) is None
    begun_m = voyage.run.state.motion.north_m
    for state in voyage.sail(100.0):
        assert state.traffic.order is None
    assert state.motion.north_m - begun_m == pytest.approx(147.0, abs=8.0)
    assert [each.words for each in state.traffic.dangers] == [WORDS]


class Tender:
    """It lies alongside, 5 m off, until it leaves to the east; after a while it comes back towards the bow of the boat."""

    def __init__(self, leaves_s: float, returns_s: float, meets_s: float) -> None:
        self._leaves_s, self._returns_s, self._meets_s = leaves_s, returns_s, meets_s
        self._at, self._was_s, self._velocity = (0.0, 0.0), 0.0, (0.0, 3.0)

    def __call__(self, state: State, now_s: float) -> Place:
        own, passed_s = state.motion, now_s - self._was_s
        self._was_s = now_s
        if now_s < self._leaves_s:
            self._at = own.north_m, own.east_m + 5.0
            return *self._at, own.north_mps, own.east_mps
        if now_s >= self._returns_s and self._velocity == (0.0, 3.0):
            left_s = self._meets_s - now_s
            meet = own.north_m + 1.5 * left_s, own.east_m
            self._velocity = (meet[0] - self._at[0]) / left_s, (meet[1] - self._at[1]) / left_s
        self._at = self._at[0] + self._velocity[0] * passed_s, self._at[1] + self._velocity[1] * passed_s
        return *self._at, *self._velocity


def test_a_tender_that_was_alongside_is_given_way_to_once_it_is_off() -> None:
    voyage = Voyage(Tender(leaves_s=150.0, returns_s=300.0, meets_s=500.0), 2.0)
    *_, state = voyage.sail(135.0)
    assert (state.traffic.order, state.traffic.dangers[0].words) == (None, WORDS)
    *_, state = voyage.sail(40.0)
    assert state.traffic.dangers[0].words != WORDS, "a vessel like others, soon after it left"
    least_m, words = math.inf, set[str]()
    for state in voyage.sail(370.0):
        if voyage.run.elapsed_s > 310.0:
            least_m = min(least_m, math.dist(state.motion[1:3], state.traffic.targets[0][2:4]))
            words |= {state.traffic.order.words.partition(",")[0]} if state.traffic.order else set()
    assert words == {f"keeping clear of {NUMBER}"}
    assert least_m > 30.0


OWN = Own(0.0, 0.0, 0.0, 1.5)


def seen(
    north_m: Callable[[float], float], age_s: Callable[[int], float] = lambda t: 1.0, kind: str = "B", own_mps: float = 1.5
) -> list[bool]:
    """Second by second for ten minutes: whether a vessel that is so far ahead of the boat is taken for a companion."""
    memory, found = Company(), list[bool]()
    for t in range(600):
        own = OWN._replace(north_m=own_mps * t, speed_mps=own_mps)
        place = own.north_m + north_m(t), 0.0
        margin_m, age = 10.0 + 0.15 * age_s(t), age_s(t)
        vessel = Target("1", "TUG", *place, 0.0, own_mps, math.nan, 15.0, 5.0, False, margin_m, age, False, kind, 0)
        memory = company(memory, own, LENGTH_M, (vessel,), float(t))
        found.append(memory.has("1"))
        assert len(memory.vessels) <= 1
    return found


def test_whoever_stays_where_the_boat_is_for_a_minute_and_some_way_is_one() -> None:
    found = seen(lambda t: 6.0)
    assert BESIDE_S <= found.index(True) <= BESIDE_S + 3.0
    assert all(found[found.index(True) :])
    slow = seen(lambda t: 6.0, own_mps=0.5)
    assert slow.index(True) == pytest.approx(BESIDE_M / 0.5, abs=4.0)
    assert not any(seen(lambda t: 6.0, own_mps=0.1)), "two that lie in a harbour are none"
    assert not any(seen(lambda t: 40.0)), "a tug on a long line is a vessel like others"
    assert not any(seen(lambda t: 6.0, kind=kind)[-1] for kind in ("distress", "payload", "fleet"))
    assert not any(seen(lambda t: 80.0 - t)), "who overtakes or is overtaken close by goes on"


def test_reports_that_are_old_neither_begin_nor_end_it() -> None:
    assert not any(seen(lambda t: 6.0, age_s=lambda t: FRESH_S + 1.0))
    each_half_minute = seen(lambda t: 6.0 if t % 30 <= FRESH_S else 300.0, age_s=lambda t: float(t % 30))
    assert each_half_minute.index(True) in range(60, 64)
    assert all(each_half_minute[64:])


def test_who_is_remembered_is_one_with_its_first_report_from_the_boat_s_place_or_no_longer() -> None:
    def first(far_m: float, age_s: float = 1.0, kind: str = "B", others: int = 0) -> Company:
        vessel = Target("1", "TUG", far_m, 0.0, 0.0, 1.5, math.nan, 15.0, 5.0, False, 10.0, age_s, False, kind, 0)
        nearer = [vessel._replace(key=f"other {i}", east_m=20.0 + i) for i in range(others)]
        return company(Company(remembered=("1",)), OWN, LENGTH_M, (*nearer, vessel), 100.0)

    assert (first(6.0).has("1"), first(6.0).remembered) == (True, ("1",))
    assert (first(25.0).has("1"), first(25.0).remembered) == (False, ()), "so far off it has to stay for a minute again"
    assert (first(3000.0, others=9).has("1"), first(3000.0, others=9).remembered) == (False, ())
    assert (first(6.0, age_s=FRESH_S + 1.0).has("1"), first(6.0, age_s=FRESH_S + 1.0).remembered) == (False, ("1",))
    assert not first(6.0, kind="payload").has("1")


def test_one_that_is_off_is_a_vessel_like_others_at_once_and_has_to_stay_for_a_minute_again() -> None:
    found = seen(lambda t: 6.0 if not 200 <= t < 203 else 45.0)
    assert [i for i, (was, now) in enumerate(pairwise(found), 1) if was != now] == pytest.approx([61, 200, 263], abs=3)
