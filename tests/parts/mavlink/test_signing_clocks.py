"""Signatures and clocks: whatever clocks, replays and restarts do, no frame is obeyed twice, and nobody whose clock is right is
shut out for long."""

import hashlib
import json

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from delfim.base.clock import MADE_NS, ManualClock
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.signing import (
    EPOCH_NS,
    OFF_S,
    PER_S,
    RECENT,
    STREAMS,
    FrameVerdict,
    Kept,
    Signing,
    read_stamps,
    write_stamps,
)
from delfim.parts.mavlink.codec.wire import dialect

KEY = bytes(range(32))
YEAR_S = 365.25 * 86_400.0
NOW_NS = 1_795_000_000_000_000_000  # in November 2026


def beat(sender: Signing, system: int, component: int = 190) -> bytes:
    """A signed heartbeat."""
    return wire.Sender(system, component, KEY, sender.stamp).pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))


def at(off_s: float = 0.0) -> ManualClock:
    return ManualClock(time_ns=NOW_NS + round(off_s * 1e9))


def stream(frame: bytes) -> tuple[int, int, int]:
    return frame[-13], frame[5], frame[6]


def stamp(frame: bytes) -> int:
    return int.from_bytes(frame[-12:-6], "little")


def restarted(signing: Signing, path, clock: ManualClock, **options: object) -> Signing:
    write_stamps(path, signing.kept())
    return Signing(KEY, clock, read_stamps(path), **options)


def test_a_console_a_year_ahead_shuts_nobody_out(tmp_path):
    clock = at()
    boat = Signing(KEY, clock)
    verdict = boat.judge(beat(Signing(KEY, at(YEAR_S)), 222))
    assert verdict.fault == "ahead"
    assert verdict.words == "signs 365 days ahead of the clock here, and is not believed: one of the two clocks is wrong"
    clock.advance(12.0)
    boat = restarted(boat, tmp_path / "stamps", clock)
    assert boat.judge(beat(Signing(KEY, clock), 223)).fault == ""
    assert boat.judge(beat(Signing(KEY, clock), 222)).fault == "", "the same console, its clock set"
    assert stamp(beat(boat, 1)) <= stamp(beat(Signing(KEY, clock), 1)) + PER_S, "nor does the boat sign ahead"


def test_stamps_that_were_kept_from_a_year_ahead_heal(tmp_path):
    """Those of the format before, too."""
    ahead = stamp(beat(Signing(KEY, at(YEAR_S)), 222))
    for text in (json.dumps([[[0, 222, 190], ahead]]), json.dumps({"sent": ahead, "forgotten": ahead, "heard": []})):
        (tmp_path / "stamps").write_text(text)
        clock = at()
        boat = Signing(KEY, clock, read_stamps(tmp_path / "stamps"))
        assert stamp(beat(boat, 1)) < ahead - PER_S * YEAR_S / 2
        boat.judge(beat(Signing(KEY, clock), 221))
        clock.advance(OFF_S + 1.0)
        assert boat.judge(beat(Signing(KEY, clock), 222)).fault == ""
        assert boat.judge(beat(Signing(KEY, clock), 223)).fault == ""


def test_a_boat_that_does_not_know_the_time_obeys_who_is_ahead_and_heals_when_it_does():
    """Its clock stopped with the boat, a week ago; nobody would be obeyed."""
    clock, known = at(-7 * 86_400.0), False
    boat = Signing(KEY, clock, is_right=lambda: known)
    right, wrong = Signing(KEY, at()), Signing(KEY, at(YEAR_S))
    for console, number in ((right, 250), (wrong, 222), (right, 250)):
        assert boat.judge(beat(console, number)).fault == ""
    assert boat.judge(beat(Signing(KEY, at(1.0)), 249)).fault == "", "one that is new, too"
    clock.step(7 * 86_400.0)
    known = True
    assert boat.judge(beat(wrong, 222)).fault == "ahead"
    clock.advance(2 * OFF_S)
    assert boat.judge(beat(Signing(KEY, clock), 222)).fault == ""


def test_the_speaker_that_was_heard_first_is_forgotten_first():
    clock = at()
    boat, console = Signing(KEY, clock), Signing(KEY, clock)
    old = beat(console, 250, 1)
    assert boat.judge(old).fault == ""
    for component in range(2, STREAMS + 2):
        clock.advance(0.1)
        assert boat.judge(beat(console, 250, component)).fault == ""
    assert len(boat.heard) == STREAMS
    assert boat.judge(old).fault == "replayed", "what was heard of it is not new"
    clock.advance(0.1)
    assert boat.judge(beat(console, 250, 1)).fault == ""


def test_a_console_whose_clock_is_set_back_is_not_late():
    """By less than a minute its stamps go on; by more they begin anew, and the boat never took those that were ahead."""
    clock, theirs = at(), at(30.0)
    boat, console = Signing(KEY, clock), Signing(KEY, theirs)
    for back_s in (0.0, 29.0, 10.0):
        theirs.step(-back_s)
        for _ in range(5):
            clock.advance(1.0)
            theirs.advance(1.0)
            verdict = boat.judge(beat(console, 250))
            assert (verdict.fault, round(verdict.age_s, 2)) == ("", 0.0)


def test_two_computers_with_one_number_are_each_judged_by_its_own_clock():
    """One after the other, five seconds apart: the second is not late for that."""
    clock = at()
    boat, first, second = Signing(KEY, clock), Signing(KEY, at(5.0)), Signing(KEY, at(10.0))
    assert boat.judge(beat(first, 250), ("192.0.2.7", 14550)).fault == ""
    clock.advance(60.0)
    assert boat.judge(beat(second, 250), ("192.0.2.8", 14550)).age_s == 0.0
    again = boat.judge(beat(first, 250), ("192.0.2.7", 14550))
    assert again.fault == "replayed"


def signed(number: int, system: int = 250, component: int = 190, link: int = 0) -> bytes:
    """A frame with this stamp."""
    frame = bytearray(beat(Signing(KEY, at()), system, component)[:-13]) + bytes((link,)) + number.to_bytes(6, "little")
    return bytes(frame + hashlib.sha256(KEY + frame).digest()[:6])


NOW = 37_492_960_000_000  # of the stamps, at NOW_NS
MINUTE = 6_000_000


def test_stamps_count_ten_microseconds_since_2015_and_grow():
    clock = at()
    boat = Signing(KEY, clock)
    assert [boat.stamp() for _ in range(3)] == [NOW, NOW + 1, NOW + 2]
    clock.advance(1.0)
    assert boat.stamp() == NOW + 100_000
    assert Signing(KEY, ManualClock(time_ns=1_420_070_400_000_010_000)).stamp() == 1
    assert Signing(KEY, ManualClock(time_ns=1_420_070_400_000_000_000)).stamp() == 1, "0 is sent by nobody"
    assert Signing(KEY, ManualClock(time_ns=0)).stamp() == 1


@pytest.mark.parametrize(
    ("off", "fault", "off_s"),
    [
        (0, "", 0.0),
        (MINUTE, "", 0.0),
        (MINUTE + 1, "ahead", 60.00001),
        (-MINUTE, "", 0.0),
        (-MINUTE - 1, "replayed", -60.00001),
    ],
)
def test_a_new_speakers_clock_is_off_by_a_minute_at_most(off: int, fault: str, off_s: float):
    boat = Signing(KEY, at())
    assert boat.judge(signed(NOW + off)) == FrameVerdict(fault, 0.0, off_s)
    assert boat.kept() == Kept(0, 0, [] if fault else [((0, 250, 190), NOW + off)])


def test_a_known_speaker_may_be_behind_and_is_known_by_link_system_and_component():
    boat = Signing(KEY, at())
    assert boat.judge(signed(NOW - MINUTE)).fault == ""
    assert boat.judge(signed(NOW - MINUTE)).fault == "replayed"
    assert boat.judge(signed(NOW - MINUTE - 1)).fault == "replayed"
    assert boat.judge(signed(NOW - MINUTE + 1)).fault == ""
    for other in ({"system": 251}, {"component": 191}, {"link": 1}):
        assert boat.judge(signed(NOW - MINUTE, **other)).fault == ""
    boat._clock.advance(1000.0)
    assert boat.judge(signed(NOW - MINUTE + 2)).fault == ""


def test_before_the_time_is_known_nobody_is_ahead_and_nobody_is_told_off():
    boat = Signing(KEY, at(), is_right=lambda: False)
    assert boat.judge(signed(NOW + 10 * MINUTE)) == FrameVerdict("")
    assert boat.judge(signed(NOW - 2 * MINUTE, 251)) == FrameVerdict("replayed")
    assert boat.kept().heard == [((0, 250, 190), NOW + 10 * MINUTE)]
    boat = Signing(KEY, at(), Kept(NOW + 9 * MINUTE), is_right=lambda: False)
    assert boat.judge(signed(NOW + 7 * MINUTE)).fault == "replayed", "the run before was later"
    clock = at()
    boat = Signing(KEY, clock)
    boat.stamp()
    clock.step(-30.0)
    assert boat.judge(signed(NOW)).fault == ""
    assert boat.judge(signed(NOW + MINUTE)).fault == "ahead", "of the clock, however long its own stamps go on"
    made = Signing(KEY, ManualClock(time_ns=MADE_NS))
    assert made.judge(signed((MADE_NS - EPOCH_NS) // 10_000 + 2 * MINUTE)).fault == "ahead"
    before = Signing(KEY, ManualClock(time_ns=MADE_NS - 1))
    assert before.judge(signed((MADE_NS - EPOCH_NS) // 10_000 + 2 * MINUTE)).fault == ""


@pytest.mark.parametrize(
    ("off_s", "words"),
    [
        (0.0, ""),
        (0.5, "signs 0 minutes ahead of"),
        (-90.0, "signs 2 minutes behind"),
        (172_799.0, "signs 2,880 minutes ahead of"),
        (172_800.0, "signs 2 days ahead of"),
        (-86_400_000.0, "signs 1,000 days behind"),
    ],
)
def test_how_far_a_clock_is_off_is_said_in_minutes_or_days(off_s: float, words: str):
    rest = " the clock here, and is not believed: one of the two clocks is wrong" if words else ""
    assert FrameVerdict("ahead", 0.0, off_s).words == words + rest


def test_of_more_speakers_than_there_is_room_for_the_newest_are_known():
    boat = Signing(KEY, at(), streams=2)
    assert boat.judge(signed(NOW + 2, 1)).fault == ""
    assert boat.judge(signed(NOW + 5, 2)).fault == ""
    assert boat.judge(signed(NOW + 2, 3)).fault == "replayed", "not newer than the oldest"
    assert boat.judge(signed(NOW + 3, 3)).fault == ""
    assert boat.kept() == Kept(0, NOW + 2, [((0, 2, 190), NOW + 5), ((0, 3, 190), NOW + 3)])
    assert boat.judge(signed(NOW + 2, 4)).fault == "replayed", "no newer than what was forgotten"
    assert boat.judge(signed(NOW + 4, 2)).fault == "replayed"
    many = Signing(KEY, at())
    assert {many.judge(signed(NOW + number, 1 + number)).fault for number in range(65)} == {""}
    assert len(many.heard) == 64
    kept = Signing(KEY, at(), Kept(0, NOW + 9, [((0, 1, 190), 1), ((0, 2, 190), 2), ((0, 3, 190), 3)]), streams=2)
    assert kept.kept() == Kept(0, NOW + 9, [((0, 1, 190), 1), ((0, 2, 190), 2)])
    assert kept.judge(signed(NOW + 9, 4)).fault == "replayed"
    assert kept.judge(signed(NOW + 10, 4)).fault == ""


def test_stamps_from_the_future_are_cut_when_the_time_is_known():
    for kept in (Kept(0, NOW + 9 * MINUTE), Kept(0, 5, [((0, 1, 190), NOW + 9 * MINUTE), ((0, 2, 190), NOW)])):
        boat = Signing(KEY, at(), kept)
        assert boat.judge(signed(NOW + 3, 3)).fault in ("", "replayed")
        cut = dict(boat.kept().heard)
        assert boat.kept().forgotten == min(kept.forgotten, NOW + MINUTE)
        assert [cut[stream] for stream, _ in kept.heard] == [NOW + MINUTE, NOW][: len(kept.heard)]
    known = False
    boat = Signing(KEY, at(), is_right=lambda: known)
    boat.judge(signed(NOW + 9 * MINUTE, 1), "a")
    boat.judge(signed(NOW, 2), "a")
    boat._clock.advance(3.0)
    known = True
    assert boat.judge(signed(NOW + 100_000, 2), "a").age_s == pytest.approx(2.0, abs=1e-3), "who was right is known to be late"
    boat._clock.advance(120.0)
    assert boat.judge(signed(NOW + 122 * 100_000, 1), "a").age_s == 0.0, "who was wrong begins anew"
    known = False
    boat = Signing(KEY, at(), is_right=lambda: known)
    boat.judge(signed(NOW + MINUTE, 1), "a")
    boat.judge(signed(NOW + 9 * MINUTE, 2), "a")
    known = True
    boat.judge(signed(NOW, 3))
    boat._clock.advance(5.0)
    assert boat.judge(signed(NOW + MINUTE + 100_000, 1), "a").age_s == pytest.approx(4.0, abs=1e-3), "it was just right enough"


def test_the_age_of_a_frame_is_what_it_took_longer_than_the_fastest_of_its_way():
    clock = at()
    boat = Signing(KEY, clock)
    assert boat.judge(signed(NOW), "a").age_s == 0.0
    clock.advance(1.5)
    assert boat.judge(signed(NOW + 100_000), "a").age_s == pytest.approx(0.5 - 1.5e-4, abs=1e-6)
    assert boat.judge(signed(NOW + 100_001), "b").age_s == 0.0, "another way"
    clock.advance(0.5)
    assert boat.judge(signed(NOW + 210_000), "a").age_s == 0.0, "faster than all before"
    clock.advance(1000.0)
    assert boat.judge(signed(NOW + 210_000 + 100_000_000), "a").age_s == 0.0, "as fast: clocks drift by no more than 0.1 s"
    clock.advance(1.0)
    assert boat.judge(signed(NOW + 100_300_000), "a").age_s == pytest.approx(0.1 - 1e-4, abs=1e-6)


def test_so_many_ways_are_known():
    clock = at()
    boat = Signing(KEY, clock, streams=2)
    for number in range(8):
        boat.judge(signed(NOW + number), number)
    clock.advance(1.0)
    assert boat.judge(signed(NOW + 8), 0).age_s > 0.9, "eight of them"
    clock.advance(1.0)
    assert boat.judge(signed(NOW + 9), "another").age_s == 0.0
    assert boat.judge(signed(NOW + 10), 1).age_s == 0.0, "the one that was heard of longest ago is forgotten"
    assert boat.judge(signed(NOW + 11), 3).age_s > 1.9


def test_a_clock_that_is_set_back_goes_on_by_less_than_a_minute_and_begins_anew_by_more():
    for back_s, first in ((59.0, NOW + 1), (60.0, NOW + 1), (60.001, NOW - 6_000_100), (-5.0, NOW + 500_000)):
        clock = ManualClock(50.0, NOW_NS)
        boat = Signing(KEY, clock)
        boat.stamp()
        clock.step(-back_s)
        assert boat.stamp() in (first, first + 1)
        clock.advance(1.0)
        assert boat.stamp() in (first + 100_000, first + 99_999)
    clock, known = ManualClock(50.0, NOW_NS), False
    boat = Signing(KEY, clock, Kept(NOW + MINUTE * 9), is_right=lambda: known)
    clock.advance(2.0)
    assert boat.stamp() == NOW + MINUTE * 9 + 200_000, "where the run before ended"
    known = True
    assert boat.stamp() == NOW + 200_001


class Clocks(RuleBasedStateMachine):
    """A boat that knows the time from some moment on, three consoles whose clocks are set back and forth, one whose clock is
    right, and somebody who hears everything and plays it again."""

    def __init__(self) -> None:
        super().__init__()
        self.true_s = 0.0
        self.aboard, self.known, self.streams = at(-1e6), False, 8
        self.boat = self._boat(None)
        self.clocks = [at(), at(40.0), at(YEAR_S)]
        self.consoles = [Signing(KEY, clock) for clock in self.clocks]
        self.right = at()
        self.good = Signing(KEY, self.right)
        self.heard: list[bytes] = []
        self.obeyed: dict[bytes, float] = {}
        self.last: dict[tuple[int, int, int], int] = {}

    def _boat(self, kept: Kept | None) -> Signing:
        return Signing(KEY, self.aboard, kept, self.streams, lambda: self.known)

    @initialize(streams=st.sampled_from((3, 8)))
    def begin(self, streams: int) -> None:
        """There are eight speakers."""
        self.streams = streams
        self.boat = self._boat(None)

    def _hear(self, frame: bytes) -> str:
        fault = self.boat.judge(frame).fault
        if not fault:
            assert frame not in self.obeyed, "a frame is obeyed once"
            assert stamp(frame) > self.last.get(stream(frame), -1) or self.known, "never an older one"
            self.obeyed[frame] = self.true_s
            self.last[stream(frame)] = stamp(frame)
        return fault

    @rule(who=st.integers(0, 2), component=st.integers(1, 2), arrives=st.booleans())
    def say(self, who: int, component: int, arrives: bool) -> None:
        frame = beat(self.consoles[who], 250 + who, component)
        self.heard.append(frame)
        if arrives:
            self._hear(frame)

    @rule(data=st.data())
    def play_again(self, data: st.DataObject) -> None:
        if self.heard:
            self._hear(data.draw(st.sampled_from(self.heard)))

    @rule(seconds=st.sampled_from((0.01, 1.0, 30.0, 61.0, 3600.0)))
    def wait(self, seconds: float) -> None:
        self.true_s += seconds
        for clock in (self.aboard, self.right, *self.clocks):
            clock.advance(seconds)

    @rule(who=st.integers(0, 2), seconds=st.sampled_from((-YEAR_S, -3600.0, -59.0, -5.0, 5.0, 59.0, 3600.0, YEAR_S)))
    def set_a_console(self, who: int, seconds: float) -> None:
        self.clocks[who].step(seconds)

    @rule(who=st.integers(0, 2))
    def restart_a_console(self, who: int) -> None:
        self.consoles[who] = Signing(KEY, self.clocks[who], self.consoles[who].kept())

    @rule()
    def restart_the_boat(self) -> None:
        self.boat = self._boat(self.boat.kept())

    @rule()
    def get_a_fix(self) -> None:
        self.aboard.step((self.right.time_ns() - self.aboard.time_ns()) / 1e9)
        self.known = True

    @rule()
    def a_right_console_is_obeyed(self) -> None:
        """Whatever the others say, and at once."""
        for component in (1, 2):
            frame = beat(self.good, 249, component)
            self.heard.append(frame)
            fault = self._hear(frame)
            assert fault == "" or self.streams == 3, "others have its place"

    @invariant()
    def stamps_only_grow(self) -> None:
        frames = [stamp(beat(console, 1)) for console in (self.good, self.good)]
        assert frames == sorted(set(frames))
        assert len(self.boat.heard) <= self.streams


Clocks.TestCase.settings = settings(max_examples=150, stateful_step_count=40, deadline=None)
test_clocks = Clocks.TestCase


def test_of_a_thousand_frames_in_a_moment_none_is_obeyed_twice():
    """More than are known one by one."""
    boat = Signing(KEY, at())
    frames = [signed(NOW + number) for number in range(RECENT + 2)]
    assert {boat.judge(frame).fault for frame in frames} == {""}
    assert {boat.judge(frame).fault for frame in (*frames[:3], *frames[-3:])} == {"replayed"}


def test_who_was_forgotten_and_speaks_again_is_new():
    boat = Signing(KEY, at(), streams=1)
    for number, system in ((0, 1), (10, 2), (30, 1)):
        assert boat.judge(signed(NOW + number, system)).fault == ""
    assert boat.judge(signed(NOW + 5, 1)).fault == "replayed", "as of any speaker, nothing from before its first frame"
    assert boat.judge(signed(NOW + 31, 1)).fault == ""


def test_who_has_no_number_for_all_links_has_none_after_a_restart(tmp_path):
    (tmp_path / "stamps").write_text('{"sent":5}')
    assert Signing(KEY, at(), read_stamps(tmp_path / "stamps")).link == Signing(KEY, at()).link == 0
