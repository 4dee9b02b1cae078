"""Who commands: whatever happens to the links of two operators, one page or nobody, and never one who does not know it."""

from collections import deque
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import Refused
from delfim.console.watch.bridge import CARRY_S, LEASE_S, TOLD_S, Bridge, accept, know, leave, offer, take

SEEDS = 1000
STEPS = 400
STEP_S = 0.1
SILENT_S = 3.0  # of the page's net.ts


class Wire:
    """One direction of a link: in order, late by chance, and for some time not at all."""

    def __init__(self, chance: Random) -> None:
        self._chance, self._frames, self._free_s = chance, deque[tuple[float, tuple[int, ...]]](), 0.0

    def stall(self, until_s: float) -> None:
        self._free_s = until_s

    def put(self, now_s: float, *frame: int) -> None:
        due_s = max(now_s, self._free_s) + self._chance.choice((0.0, 0.05, 0.3))
        self._frames.append((max(due_s, self._frames[-1][0] if self._frames else 0.0), frame))

    def come(self, now_s: float) -> list[tuple[int, ...]]:
        """What has arrived, but for what is stalled now."""
        come = []
        while self._frames and self._frames[0][0] <= now_s and now_s >= self._free_s:
            come.append(self._frames.popleft()[1])
        return come

    def cut(self) -> None:
        self._frames.clear()


class WatchingPage:
    """A page: it takes what it heard last for true until it has heard nothing for SILENT_S."""

    def __init__(self, number: int, chance: Random) -> None:
        self.number, self.down, self.up = number, Wire(chance), Wire(chance)
        self.proven_s = self._heard_s = -10.0
        self._commands = False

    def hear(self, now_s: float) -> None:
        for n, holder, granted, grant in self.down.come(now_s):
            self._heard_s, self._commands = now_s, self.number in (holder, granted)
            self.up.put(now_s, n, grant if granted == self.number else 0)

    def believes(self, now_s: float) -> bool:
        return self._commands and now_s - self._heard_s < SILENT_S


def acted(bridge: Bridge, pages: list[WatchingPage], chance: Random, now_s: float) -> Bridge:
    """Somebody presses something, at the gateway's end of the wire."""
    page, other = chance.sample(pages, 2)
    proof_s = now_s - page.proven_s
    try:
        match chance.randrange(5):
            case 0:
                return take(bridge, page.number, proof_s)
            case 1 | 2:
                return offer(bridge, page.number, other.number)
            case 3:
                return accept(bridge, page.number, proof_s)
            case _:
                return leave(bridge, page.number) if chance.random() < 0.2 else bridge
    except Refused:
        return bridge


def faulty(pages: list[WatchingPage], chance: Random, now_s: float) -> None:
    page = chance.choice(pages)
    if chance.random() < 0.7:
        chance.choice((page.down, page.up)).stall(now_s + chance.uniform(0.2, 8.0))
    else:
        for wire in (page.down, page.up):
            wire.cut()


def watch(seed: int) -> tuple[int, int]:
    """A watch of two operators. How often the command changed hands, and how long one had it, steps."""
    chance = Random(seed)
    pages, bridge, sent, held, changes = [WatchingPage(1, chance), WatchingPage(2, chance)], Bridge(), dict[int, float](), 0, 0
    for step in range(STEPS):
        now_s = step * STEP_S
        if step % round(TOLD_S / STEP_S) == 0:
            sent[step] = now_s
            for page in pages:
                page.down.put(now_s, step, bridge.holder, bridge.granted, bridge.grant)
        if chance.random() < 0.03:
            faulty(pages, chance, now_s)
        for page in pages:
            page.hear(now_s)
            for n, grant in page.up.come(now_s):
                page.proven_s = max(page.proven_s, sent[n])
                before, bridge = bridge.holder, know(bridge, page.number, grant)
                changes += bridge.holder != before
            if now_s - page.proven_s > LEASE_S:
                bridge = leave(bridge, page.number)
        if chance.random() < 0.2:
            bridge = acted(bridge, pages, chance, now_s)
        obeyed = [page for page in pages if page.number == bridge.holder]
        assert len(obeyed) <= 1
        assert all(page.believes(now_s) for page in obeyed), (seed, now_s)
        held += len(obeyed)
    return changes, held


def test_in_a_thousand_watches_with_faults_of_their_links_one_commands_or_nobody_and_knows_it() -> None:
    changes, held = (sum(each) for each in zip(*map(watch, range(SEEDS)), strict=True))
    assert changes > SEEDS
    assert held > SEEDS * STEPS / 4, "it is of use"


NUMBERS = st.integers(0, 3)


@given(
    st.lists(st.tuples(st.sampled_from(["take", "offer", "accept", "know", "leave"]), NUMBERS, NUMBERS, st.floats(0.0, 2.0)))
)
def test_the_command_comes_by_a_grant_that_is_known_and_by_nothing_else(deeds: list[tuple[str, int, int, float]]) -> None:
    bridge = Bridge()
    for deed, page, other, proof_s in deeds:
        before = bridge
        try:
            match deed:
                case "take":
                    bridge = take(bridge, page or 1, proof_s)
                case "offer":
                    bridge = offer(bridge, page, other)
                case "accept":
                    bridge = accept(bridge, page, proof_s)
                case "know":
                    bridge = know(bridge, page, other)
                case _:
                    bridge = leave(bridge, page)
        except Refused:
            assert bridge == before
        assert not (bridge.holder and bridge.granted)
        assert not bridge.offered or bridge.holder
        if bridge.holder not in (0, before.holder):
            assert (deed, page, other) == ("know", before.granted, before.grant)
        if bridge.granted not in (0, before.granted):
            assert proof_s <= CARRY_S
            assert before.offered == bridge.granted if deed == "accept" else before.is_free


@pytest.mark.parametrize("proof_s", [CARRY_S + 0.1, float("inf")])
def test_a_link_that_cannot_carry_a_stop_gets_no_command(proof_s: float) -> None:
    with pytest.raises(Refused, match="cannot carry a stop"):
        take(Bridge(), 1, proof_s)
    with pytest.raises(Refused, match="cannot carry a stop"):
        accept(Bridge(holder=1, offered=2), 2, proof_s)
