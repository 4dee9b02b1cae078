"""The recordings of real boats with damaged frames: every reader of an NMEA 2000 bus counts what it refuses, and goes on."""

import math
import tracemalloc
from random import Random
from typing import NamedTuple

import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.frames import CAN_ERR, CAN_RTR, Frame
from delfim.canproxy.dsor.messages import Navigation
from delfim.parts.nmea2000.combining import Nmea2000Source
from delfim.parts.nmea2000.sensor import Nmea2000Instruments
from delfim.parts.nmea2000.table import Nmea2000
from delfim.parts.traffic.aisbus import AisBus
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle.state import State
from tests.canproxy.test_recordings import BUSY, RAYMARINE, recording
from tests.mutations import cut, dropped, flipped, spliced

PER_ROUND = 50_000
MANGLED = (flipped, cut, dropped, spliced)


class Readers(NamedTuple):
    """All that listen on such a bus."""

    source: Nmea2000Source
    instruments: Nmea2000Instruments
    ais: AisBus
    state: State

    def hear(self, frame: Frame, now_s: float) -> Navigation | None:
        self.instruments.hear(self.state, frame, now_s)
        self.ais.hear(self.state, frame, now_s)
        self.state.heard.clear()  # the boat looks at other vessels once a second
        return self.source.feed(frame, now_s)


def readers() -> Readers:
    settings = config.Vehicle(boat=config.BoatTable(name="test"), nmea2000=Nmea2000(batteries=(0, 1)))
    bus = LockstepBus(ManualClock()).bound()
    return Readers(Nmea2000Source(settings.nmea2000, 2.5), Nmea2000Instruments(settings, bus), AisBus(bus), State())


def damaged(frame: Frame, chance: Random) -> Frame:
    """Half of the frames: other data, another identifier, or another kind of frame."""
    data, arb = frame.data, frame.arb
    if chance.random() < 0.3:
        data = chance.choice(MANGLED)(data, chance)[: chance.choice((8, 8, 8, 64))]
    if chance.random() < 0.2:
        arb ^= chance.choice((CAN_RTR, CAN_ERR, *(1 << bit for bit in range(3, 32))))
    return Frame(arb, data)


def play(heard: Readers, seed: int) -> int:
    """A round of frames; how many messages of navigation came of it."""
    chance, taken, now_s = Random(seed), 0, 1000.0 * seed
    frames = [line.frame for name in (BUSY, RAYMARINE) for line in recording(name)][:PER_ROUND]
    for frame in frames:
        now_s += 0.001
        told = heard.hear(damaged(frame, chance), now_s)
        if told is not None:
            taken += 1
            assert all(math.isfinite(value) for value in told if value is not None), told
    assert all(math.isfinite(value) for value, _ in heard.state.measured.values())
    return taken


def refusals(heard: Readers) -> dict[str, int]:
    return heard.source.status(0.0).errors | heard.state.counts


def test_damaged_frames_are_refused_by_their_reasons_and_the_rest_is_used() -> None:
    heard = readers()
    assert play(heard, 1) > 200
    told = refusals(heard)
    assert told.pop("not an extended data frame") > 500
    assert sum(told.values()) > 500
    assert any(reason.endswith("_malformed") for reason in told)
    assert len(told) < 80, "by kind, whatever comes"


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_million_damaged_frames_leave_memory_flat() -> None:
    heard = readers()
    play(heard, 1)
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for seed in range(2, 22):
        play(heard, seed)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 1 << 20
    assert len(refusals(heard)) < 80
    assert len(heard.source.status(0.0).sources) <= 252
