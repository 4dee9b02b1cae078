"""The black box onto a bus: the distances in time, and what is left out."""

import pytest

from delfim.base.frames import CAN_ERR, CAN_IDE, Frame, extended, standard
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING
from delfim.simulator.replay.playback import play

BUS = "canloop:playback-test"
T0 = 1_262_304_000_000_000_000
FRAMES = [
    ("can0", Frame(standard(1), b"a", T0)),
    ("can0", Frame(4 << 3 | CAN_IDE | CAN_ERR, bytes(8), T0 + 100)),
    ("can0", Frame(extended(2), b"bb", T0 + 2_000_000_000, sent_here=True)),
    ("can0", Frame(standard(3), b"", T0 + 3_000_000_000)),
]


class Wait:
    """Time that passes by waiting."""

    def __init__(self) -> None:
        self.now_s, self.waits = 50.0, []

    def __call__(self) -> float:
        return self.now_s

    def wait(self, seconds: float) -> None:
        self.waits.append(round(seconds, 9))
        self.now_s += seconds


@pytest.mark.parametrize(("speed", "waits"), [(1.0, [2.0, 1.0]), (10.0, [0.2, 0.1]), (0, [])])
def test_frames_keep_their_distances(speed, waits):
    clock = Wait()
    with open_can(BUS) as listener:
        listener.bind(ANYTHING)
        listener.settimeout(200.0)
        count, late_s = play(FRAMES, BUS, speed, now_s=clock, wait_s=clock.wait)
        heard = [listener.recvmsg() for _ in range(count)]
    assert clock.waits == waits
    assert late_s == pytest.approx(0.0)
    assert [(frame.arb, frame.data) for frame in heard] == [(f.arb, f.data) for _, f in FRAMES if not f.error]


def test_one_direction_may_be_asked_for():
    clock = Wait()
    assert play(FRAMES, BUS, 0, "sent", now_s=clock, wait_s=clock.wait)[0] == 1
    assert play(FRAMES, BUS, 0, "received", now_s=clock, wait_s=clock.wait)[0] == 2


def test_lateness_is_told():
    clock = Wait()

    def slow(seconds: float) -> None:
        clock.now_s += seconds + 0.25

    assert play(FRAMES, BUS, 1.0, now_s=clock, wait_s=slow)[1] == pytest.approx(0.25)
