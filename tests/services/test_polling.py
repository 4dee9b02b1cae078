"""Several boats on one frequency, on a model of the half-duplex line with delays and losses: nobody talks over another one,
whatever is lost."""

import heapq
import itertools
import random
import struct
from collections import Counter
from collections.abc import Callable
from typing import Final

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from delfim.services.radio.packetqueue import IPTOS_LOWDELAY, QUEUE_MAX
from delfim.services.radio.polling import (
    ANSWER,
    AWAY_S,
    DONE,
    IDLE_S,
    MISSES,
    POLL,
    UNPOLLED_S,
    PolledBoat,
    PollingShore,
    opened,
    sealed,
)
from delfim.services.radio.slip import PACKET_MAX, Deframer

BYTES_PER_S: Final = 10_000.0  # 100 kbit/s, 8N1
DELAY_S: Final = 0.01  # through both radios
REACT_S: Final = 0.005  # at most, until a program reads what came
TURNAROUND_S: Final = 0.05
MTU: Final = 296
SLICE_BYTES: Final = 50
ADDRESSES = (b"\x0a\0\0\2", b"\x0a\0\0\1", b"\x0a\0\0\3")  # the shore's, and the boats' of stations 1 and 2


def packet(to: int, number: int, size: int = MTU, tos: int = 0, *, source: int = 0) -> bytes:
    head = struct.pack("!BBHHHBBH4s4s", 0x45, tos, size, 0, 0, 64, 17, 0, ADDRESSES[source], ADDRESSES[to])
    return (head + number.to_bytes(4, "big")).ljust(size, b"\xc0" if number % 3 == 2 else b"x")  # some of it is escaped


class Air:
    """One frequency: the shore is end 0. Time is its own; each loses what the others send with a probability of `loss`."""

    def __init__(self, seed: int = 1, loss: float = 0.0, airtime_s: float = 0.1) -> None:
        boats = dict(zip(ADDRESSES[1:], (1, 2), strict=True))
        self.shore = PollingShore(boats, True, BYTES_PER_S, TURNAROUND_S, airtime_s, MTU)
        self.boats = [PolledBoat(station, True, 0.0) for station in (1, 2)]
        self.ends: list[PollingShore | PolledBoat] = [self.shore, *self.boats]
        self.now_s, self.loss = 0.0, loss
        self.deaf: set[int] = set()  # ends that hear nothing and are not heard
        self.overlaps = 0
        self.received: list[list[tuple[float, bytes]]] = [[], [], []]
        self.polls = Counter[int]()
        self._random, self._order = random.Random(seed), itertools.count()
        self._free_s, self._buffers = [0.0, 0.0, 0.0], [b"", b"", b""]
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._speak(0)

    def at(self, t_s: float, event: Callable[[], None]) -> None:
        heapq.heappush(self._events, (t_s, next(self._order), event))

    def offer(self, end: int, data: bytes) -> None:
        """A packet of the network's."""
        self.ends[end].offer(data, self.now_s)
        self._speak(end)

    def run(self, seconds: float) -> None:
        until_s = self.now_s + seconds
        while self._events and self._events[0][0] <= until_s:
            self.now_s, _, event = heapq.heappop(self._events)
            event()
        self.now_s = until_s

    def _speak(self, end: int) -> None:
        data = self.ends[end].speak(self.now_s)
        if data:
            self.overlaps += any(free_s > self.now_s for free_s in self._free_s)
            if end == 0:
                self.polls.update(body[1] for body in opened(Deframer(), data) if body and body[:1] == POLL)
        for at in range(0, len(data), SLICE_BYTES):
            piece = data[at : at + SLICE_BYTES]
            self._free_s[end] = max(self._free_s[end], self.now_s) + len(piece) / BYTES_PER_S
            for other in {0, 1, 2} - {end}:
                if self._random.random() >= self.loss and not {end, other} & self.deaf:
                    self.at(self._free_s[end] + DELAY_S, lambda other=other, piece=piece: self._arrives(other, piece))
        if self.ends[end].due_s() < 1e9:
            self.at(max(self.ends[end].due_s(), self.now_s), lambda: self._wakes(end))

    def _wakes(self, end: int) -> None:
        if self.ends[end].due_s() <= self.now_s:
            self._speak(end)

    def _arrives(self, end: int, piece: bytes) -> None:
        if not self._buffers[end]:
            self.at(self.now_s + self._random.uniform(0.0, REACT_S), lambda: self._reads(end))
        self._buffers[end] += piece

    def _reads(self, end: int) -> None:
        data, self._buffers[end] = self._buffers[end], b""
        self.received[end] += ((self.now_s, each) for each in self.ends[end].received(data, self.now_s))
        self._speak(end)


TRAFFIC = st.lists(
    st.tuples(st.floats(0.5, 5.0), st.sampled_from([(0, 1), (0, 2), (1, 0), (2, 0)]), st.integers(24, MTU)), max_size=60
)


@settings(max_examples=60)
@given(st.integers(0, 1000), st.sampled_from([0.0, 0.02, 0.2, 0.7]), TRAFFIC)
@example(1, 0.2, [(2.0 + number / 100, (1 + number % 2, 0), MTU) for number in range(60)])
def test_nobody_talks_over_another_one_and_a_packet_comes_once_or_never(seed: int, loss: float, traffic: list) -> None:
    air, sent = Air(seed, loss), [Counter[bytes](), Counter[bytes](), Counter[bytes]()]
    for number, (t_s, (end, to), size) in enumerate(traffic):
        each = packet(to, number, size, source=end)
        sent[to][each] += 1
        air.at(t_s, lambda end=end, each=each: air.offer(end, each))
    air.run(15.0)
    assert air.overlaps == 0
    dropped = air.shore.dropped + sum(boat.dropped for boat in air.boats)
    received = [Counter(each for _, each in packets) for packets in air.received]
    assert all(some <= all_ for some, all_ in zip(received, sent, strict=True))
    if loss == 0.0:
        assert dropped + sum(map(Counter.total, received)) == len(traffic)


def loaded(air: Air) -> None:
    """From now on, both boats have more to say than the line carries."""

    def fill() -> None:
        for boat in (1, 2):
            for _ in range(QUEUE_MAX):
                air.offer(boat, packet(0, 3 * boat, source=boat))
        air.at(air.now_s + 0.05, fill)

    fill()


def test_two_boats_share_the_line_and_an_urgent_packet_has_its_turn() -> None:
    """The figures are printed (pytest -rP)."""
    air = Air()
    air.run(1.0)
    loaded(air)
    for number in range(200):
        end, to = ((0, 2), (2, 0), (0, 1), (1, 0))[number % 4]
        urgent = packet(to, 1000 + number, 100, IPTOS_LOWDELAY, source=end)
        air.at(2.0 + 0.1037 * number, lambda end=end, urgent=urgent: air.offer(end, urgent))
    air.run(22.0)
    bytes_of = Counter[int]()
    latencies: list[list[float]] = [[], [], []]
    for end, packets in enumerate(air.received):
        for t_s, each in packets:
            number = int.from_bytes(each[20:24], "big")
            if number >= 1000:
                latencies[end].append(t_s - 2.0 - 0.1037 * (number - 1000))
            else:
                bytes_of[number] += len(each)
    shares = [bytes_of[3 * boat] / 22.0 for boat in (1, 2)]
    print(f"two boats at 100 kbit/s: {shares[0]:.0f} and {shares[1]:.0f} bytes/s of packets")
    for name, times in (("to a boat", latencies[1] + latencies[2]), ("of a boat", latencies[0])):
        print(f"urgent packets {name}: median {sorted(times)[len(times) // 2] * 1e3:.0f} ms, longest {max(times) * 1e3:.0f} ms")
    assert list(map(len, latencies)) == [100, 50, 50], "none was lost"
    assert air.overlaps == 0
    assert shares == pytest.approx([sum(shares) / 2.0] * 2, rel=0.02)
    assert sum(shares) > 0.6 * BYTES_PER_S
    assert max(map(max, latencies)) < 0.35


def test_an_idle_line_is_nearly_silent_and_its_boats_are_asked_often_enough() -> None:
    air = Air()
    air.run(1.0)
    air.polls.clear()
    for number in range(10):
        air.at(2.0 + number, lambda number=number: air.offer(1, packet(0, number, 100, source=1)))
    air.run(10.0)
    assert max(t_s - 2.0 - int.from_bytes(each[20:24], "big") for t_s, each in air.received[0]) < IDLE_S + 0.08
    assert air.polls[2] == pytest.approx(10.0 / IDLE_S, rel=0.2)


def test_a_boat_that_is_gone_costs_the_other_little_is_named_and_comes_back() -> None:
    air = Air()
    air.run(1.0)
    assert [end.silence(air.now_s) for end in air.ends] == ["", "", ""]
    loaded(air)
    air.deaf = {2}
    air.run(UNPOLLED_S + 1.0)
    assert air.shore.silence(air.now_s) == "no answer from 10.0.0.3 (station 2)"
    assert air.boats[1].silence(air.now_s) == "no poll for station 2: the shore is out of reach, or does not poll"
    begun, air.polls[2] = len(air.received[0]), 0
    air.run(10.0)
    assert air.polls[2] <= 10.0 / AWAY_S + 1
    assert (len(air.received[0]) - begun) * MTU / 10.0 > 0.65 * BYTES_PER_S, "for the boat that is there"
    dropped = air.boats[1].dropped
    assert dropped > 100, "what it has to say is not kept until it is stale"
    air.deaf = set()
    air.run(AWAY_S + 0.5)
    assert [end.silence(air.now_s) for end in air.ends] == ["", "", ""]
    assert air.overlaps == 0


def test_a_station_that_the_shore_does_not_know_is_told_so() -> None:
    boat = PolledBoat(7, True, 0.0)
    assert boat.silence(1.0) == ""
    boat.received(sealed(POLL, b"\1", b"\x04\0"), 6.0)
    assert boat.speak(6.0) == b""
    assert boat.silence(6.0) == "the shore polls other boats, but not station 7"


def test_noise_in_place_of_answers_is_told_from_silence() -> None:
    """As when two boats have one station: both answer, and destroy each other's answer."""
    shore, now_s = PollingShore({ADDRESSES[1]: 1}, True, BYTES_PER_S, TURNAROUND_S, 0.1, MTU), 0.0
    for _ in range(MISSES):
        shore.speak(now_s)
        shore.received(b"\xc0" + bytes(20) + b"x\xc0", now_s + 0.01)
        now_s = shore.due_s()
    shore.speak(now_s)
    assert shore.silence(now_s) == "only noise from 10.0.0.1 (station 1): out of reach, or another boat has this station"
    now_s = shore.due_s()
    shore.speak(now_s)
    shore.received(sealed(DONE, b"\1", b"\0"), now_s + 0.01)
    assert shore.silence(now_s) == ""


@pytest.mark.parametrize("more", [sealed(POLL, b"\2", b"\x04\0"), sealed(POLL, b"\2", b"\x04\0")[:4], b"\xc0noise\xc0"])
def test_a_boat_that_reads_its_poll_too_late_is_silent(more: bytes) -> None:
    poll = sealed(POLL, b"\1", b"\x04\0")
    boat = PolledBoat(1, True, 0.0)
    boat.received(poll, 1.0)
    assert boat.speak(1.0) == sealed(DONE, b"\1", b"\0")
    boat.received(poll + more, 2.0)
    assert boat.speak(2.0) == b""
    boat.received(poll, 3.0)
    boat.received(more, 3.0)
    assert boat.speak(3.0) == b""


def test_a_packet_too_long_for_a_turn_is_dropped_and_keeps_nobody_waiting() -> None:
    boat = PolledBoat(1, True, 0.0)
    boat.received(sealed(POLL, b"\1", b"\x02\0"), 1.0)
    for each in (packet(0, 1, 1500), packet(0, 2, 100)):
        boat.offer(each, 1.0)
    answer = [body for body in opened(Deframer(), boat.speak(1.0)) if body]
    assert ([each[2:] for each in answer], boat.dropped) == ([packet(0, 2, 100), b"\0"], 1)


@given(st.lists(st.binary(max_size=100), max_size=20), st.booleans())
def test_noise_hurts_nobody(pieces: list[bytes], is_sealed: bool) -> None:
    boat, shore = PolledBoat(1, True, 0.0), PollingShore({ADDRESSES[1]: 1}, True, BYTES_PER_S, TURNAROUND_S, 0.1, MTU)
    for number, each in enumerate(pieces):
        data = sealed(each[:1], each[1:2], each[2:]) if is_sealed and len(each) > 2 else each
        for end in (boat, shore):
            end.offer(each, float(number))
            end.received(data, float(number))
            assert len(end.speak(float(number))) <= 4000


@pytest.mark.parametrize(
    "forged",
    [
        packet(2, 1, 100, source=1),  # to the second boat: a computer that forwards would send it on
        packet(2, 1, 100, source=0),  # ... as if the shore commanded it
        packet(0, 1, 100, source=2),  # as if the second boat said it
        b"\x46" + packet(0, 1, 100, source=1)[1:],  # with options, which may name a way
        packet(0, 1, 100, source=1)[:15],
    ],
    ids=["to another boat", "in the shore's name", "in another boat's name", "with options", "cut"],
)
def test_a_boat_speaks_in_its_own_name_and_to_the_shore(forged: bytes) -> None:
    air = Air()
    air.run(3.0)
    turn = sealed(ANSWER, b"\1", forged) + sealed(ANSWER, b"\1", packet(0, 2, 100, source=1)) + sealed(DONE, b"\1", b"\0")
    air.shore._turn, dropped = air.shore._peers[ADDRESSES[1]], air.shore.dropped
    assert air.shore.received(turn, air.now_s) == [packet(0, 2, 100, source=1)]
    assert air.shore.dropped == dropped + 1


def test_whatever_a_boat_sends_ashore_it_reaches_no_other_boat(mutations: int) -> None:
    """4,000 mutated turns of a hostile boat, 100,000 with --mutations 1000; the other one is asked as often as ever."""
    chance, shore, polled, now_s = random.Random(1), Air().shore, Counter[int](), 0.0
    for _ in range(100 * mutations):
        now_s = max(shore.due_s(), now_s) + 0.001
        polled.update(body[1] for body in opened(Deframer(), shore.speak(now_s)) if body and body[:1] == POLL)
        kind, station = (
            chance.choice((ANSWER, ANSWER, ANSWER, DONE, POLL, b"\x01", b"\xff")),
            chance.choice((b"\1", b"\1", b"\2")),
        )
        body = bytearray(packet(chance.randrange(3), 1, chance.randrange(24, MTU), source=chance.randrange(3)))
        for _ in range(chance.randrange(4)):
            body[chance.randrange(len(body))] = chance.randrange(256)
        frame = sealed(kind, station, bytes(body[: chance.choice((1, 20, MTU))]))
        noise = chance.choice((b"", b"", b"", chance.randbytes(chance.randrange(5000))))
        for each in shore.received(frame + noise + sealed(DONE, b"\1", b"\1"), now_s):
            assert each[12:16] in ADDRESSES[1:]
            assert each[16:20] not in ADDRESSES[1:]
        assert len(shore._deframer._rest) <= 2 * PACKET_MAX
    assert polled[2] >= now_s / (AWAY_S + 1.0)
