"""Which device is believed, how long, and the navigation message of it all: the rules for every bus. What a bus decodes is
tested with the bus.
"""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.selection import Newest
from delfim.canproxy.dsor.messages import Navigation
from delfim.vehicle.navigation.fusion import MOVING, SLOW_S, VARIATION_S, Fusion, over_ground

STALE_S = 1.0
LISBON, PORTO = (0.675, -0.161), (0.718, -0.150)
KINDS = {**MOVING, "attitude": SLOW_S, "variation": VARIATION_S, "quality": SLOW_S, "time": SLOW_S}
FIELDS = {"velocity": "north_mps", "heading": "heading_rad", "rate": "yaw_rate_radps", "attitude": "roll_rad"}


def fusion(*preferred: int, stale_s: float = STALE_S, variation_deg: float = 0.0) -> Fusion[int]:
    return Fusion(KINDS, stale_s, preferred, variation_deg)


def place(f: Fusion[int], device: int, position: tuple[float, float] | None, now_s: float) -> Navigation | None:
    """A receiver speaks of its position: what goes on to the vehicle."""
    f.talking.put(device, True, now_s)
    if not f.place(device, position, now_s):
        return None
    f.tell("position", device, position, now_s, None, 2.0)
    return f.message(position, f.utc_ns(device, now_s), now_s, 3, 9, 0.8, 0.5, 2.0)


def placed(f: Fusion[int], device: int, position: tuple[float, float] | None, now_s: float) -> Navigation:
    message = place(f, device, position, now_s)
    assert message is not None
    return message


# The choice of one kind.


def test_the_lowest_address_is_chosen_and_kept_while_it_is_fresh() -> None:
    newest: Newest[int, str] = Newest((), 1.0)
    assert newest.choose(0.0) is None
    for address in (30, 20):
        newest.put(address, "old", 0.0)
    assert newest.choose(0.0) == 20
    newest.put(10, "lower", 0.5)
    assert newest.get(0.5) == "old"
    assert newest.choose(1.0) == 20  # exactly at its limit it is fresh
    newest.put(30, "newer", 1.0)
    assert newest.choose(1.01) == 10
    newest.put(20, "back", 1.1)
    assert newest.choose(1.1) == 10
    assert newest.choose(9.0) is None


def test_preferred_addresses_win_in_order_and_win_back() -> None:
    newest: Newest[int, int] = Newest((50, 60), 1.0)
    chosen = []
    for now_s, talking in enumerate([(1,), (1, 60), (1, 50, 60), (1, 60), (1, 50), (1,), ()]):
        for address in talking:
            newest.put(address, address, now_s * 2.0)
        chosen.append(newest.choose(now_s * 2.0))
    assert chosen == [1, 60, 50, 60, 50, 1, None]


@given(
    st.permutations((1, 2, 3)).map(lambda p: tuple(p[:2])),
    st.lists(st.tuples(st.floats(0, 0.7), st.integers(0, 4), st.booleans()), max_size=60),
)
def test_choice_keeps_its_rules(preferred: tuple[int, ...], events: list[tuple[float, int, bool]]) -> None:
    newest: Newest[int, float] = Newest(preferred, 1.0)
    said_s: dict[int, float] = {}
    now_s, before = 0.0, None
    for later_s, address, known in events:
        now_s += later_s
        newest.put(address, now_s if known else None, now_s)
        if known:
            said_s[address] = now_s
        else:
            said_s.pop(address, None)
        fresh = {a for a, t_s in said_s.items() if t_s >= now_s - 1.0}
        chosen = newest.choose(now_s)
        expected = next((a for a in (*preferred, before) if a in fresh), min(fresh, default=None))
        assert chosen == expected
        assert newest.get(now_s) == (said_s[chosen] if chosen is not None else None)
        assert newest.of(address, now_s) == said_s.get(address)
        before = chosen if chosen is not None else before


# The message.


def test_a_position_brings_the_newest_of_everything_and_counts_up() -> None:
    f = fusion()
    f.take("velocity", 2, (0.5, 1.5), 10.0)
    f.take("heading", 3, (1.0,), 10.0)
    f.take("rate", 3, (-0.1,), 10.0)
    f.put("attitude", 3, (-0.03, 0.02), 10.0)
    f.set_time(2, 1_700_000_000_000_000_000, 10.0)
    everything = (1_700_000_000_250_000_000, *PORTO, 0.5, 1.5, 1.0, -0.1, -0.03, 0.02, 3, 9, 0.8, 1, 0.5, 2.0)
    assert placed(f, 2, PORTO, 10.25) == Navigation(*everything)
    assert [placed(f, 2, PORTO, 10.25).counter for _ in range(256)] == [*range(2, 256), 0, 1]
    assert placed(f, 2, None, 10.25)[9:] == (0, 9, 0.8, 2, None, 2.0), "no position has no fix and no accuracy"


@pytest.mark.parametrize("stale_s", [STALE_S, 5.0, 90.0])
@pytest.mark.parametrize("kind", FIELDS)
def test_what_is_older_than_its_limit_or_ended_by_its_device_is_unknown(kind: str, stale_s: float) -> None:
    f, limit_s = fusion(stale_s=stale_s), max(stale_s, KINDS[kind])
    value = (0.1,) if kind in ("heading", "rate") else (0.1, 0.2)
    f.put(kind, 9, value, 0.0)
    assert getattr(placed(f, 9, LISBON, limit_s), FIELDS[kind]) == 0.1
    assert getattr(placed(f, 9, LISBON, limit_s + 0.01), FIELDS[kind]) is None
    for known, expected in ((value, 0.1), (None, None)):
        f.put(kind, 9, known, limit_s)
        assert getattr(placed(f, 9, LISBON, limit_s), FIELDS[kind]) == expected


def test_each_kind_has_a_device_of_its_own_and_the_report_says_which() -> None:
    f = fusion(7, 4)
    f.take("heading", 7, (1.0,), 0.0)
    f.take("heading", 4, (2.0,), 0.0)
    f.take("rate", 4, (0.1,), 0.0)
    assert placed(f, 9, LISBON, 0.5).heading_rad == 1.0
    used = f.used(0.5)
    assert list(used) == list(KINDS)
    assert (used["heading"], used["rate"], used["position"], used["velocity"]) == ((7, 0.5), (4, 0.5), (9, 0.0), (None, None))


def test_positions_of_other_devices_are_silent_until_the_chosen_one_is() -> None:
    f = fusion(20)
    assert placed(f, 5, LISBON, 0.0)
    assert placed(f, 20, PORTO, 0.1)
    assert place(f, 5, LISBON, 0.2) is place(f, 5, LISBON, 1.05) is None
    assert placed(f, 5, LISBON, 1.2).latitude_rad == LISBON[0]
    assert placed(f, 20, PORTO, 1.3), "the preferred one takes back"
    assert place(f, 20, None, 1.4) is None, "a device that loses its fix is left at once"
    assert placed(f, 5, LISBON, 1.4)


def test_without_any_position_the_word_of_one_device_is_passed_on() -> None:
    f = fusion()
    f.take("heading", 3, (1.0,), 0.0)
    n = placed(f, 5, None, 0.1)
    assert (n.latitude_rad, n.fix, n.heading_rad) == (None, 0, 1.0)
    assert place(f, 6, None, 0.1) is None
    assert placed(f, 6, LISBON, 0.2).fix == 3
    assert place(f, 5, None, 0.3) is None


# Time, true north, velocity.


def test_the_time_is_that_of_the_position_or_of_anybody_and_never_the_computers() -> None:
    f = fusion()
    assert placed(f, 2, LISBON, 0.0).utc_ns == 0
    f.set_time(9, 86_400_000_000_000, 1.0)
    assert placed(f, 2, LISBON, 1.5).utc_ns == 86_400_500_000_000
    f.set_time(2, 90_000_000_000_000, 1.5)
    assert placed(f, 2, LISBON, 2.0).utc_ns == 90_000_500_000_000
    f.set_time(2, None, 2.0)
    assert placed(f, 2, LISBON, 2.0).utc_ns == 86_401_000_000_000
    assert placed(f, 2, LISBON, 1.0 + SLOW_S + 0.01).utc_ns == 0


@pytest.mark.parametrize(
    ("own", "other", "expected_rad"), [(0.2, 0.3, 0.2), (0.0, 0.3, 0.0), (None, 0.3, 0.3), (None, None, 0.4)]
)
def test_a_variation_is_the_devices_own_or_the_chosen_ones_or_the_files(own, other, expected_rad):
    f = fusion(variation_deg=math.degrees(0.4))
    f.put("variation", 1, other, 0.0)
    f.put("variation", 9, own, 0.0)
    assert f.variation_rad(9, VARIATION_S) == pytest.approx(expected_rad)
    assert f.variation_rad(9, VARIATION_S + 0.1) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("course_rad", "speed_mps", "velocity"),
    [(math.pi / 2, 2.0, (0.0, 2.0)), (None, 0.1, (0.0, 0.0)), (None, 0.11, None), (1.0, None, None), (None, None, None)],
)
def test_at_rest_without_a_course_the_velocity_is_zero_and_at_speed_it_is_unknown(course_rad, speed_mps, velocity):
    assert over_ground(course_rad, speed_mps) == (None if velocity is None else pytest.approx(velocity))


# The estimator's side.


def test_a_hearer_gets_each_value_of_the_chosen_devices_with_its_deviation() -> None:
    f, told = fusion(1), list[tuple[object, ...]]()
    f.hearer = lambda *said: told.append(said)
    f.take("heading", 1, (1.0,), 0.0, 0.01)
    f.take("heading", 2, (2.0,), 0.0)  # not the chosen one
    f.take("heading", 1, None, 0.1)
    f.take("heading", 2, (2.1,), 0.1)
    placed(f, 3, LISBON, 0.2)
    placed(f, 1, None, 2.0)
    assert told == [("heading", (1.0,), 0, 0.01), ("heading", (2.1,), 0, 0.0), ("position", LISBON, 0, 2.0)]
