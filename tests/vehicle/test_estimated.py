"""The estimator's place between a source of separate sensors and the loop: what waited while the program came up."""

import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.canproxy.dsor.messages import Navigation
from delfim.vehicle.navigation.estimated import SETTLE_S, Estimated
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.state import State

KINDS = {"rate": (0.02,), "heading": (0.5,), "position": (0.675, -0.16), "velocity": (0.4, 0.2)}
START_S = 100.0
LATE = round(SETTLE_S / 0.1)  # ticks of which nothing is used
SAID = Navigation(*(None for _ in Navigation._fields))._replace(utc_ns=0, fix=3, satellites=9, counter=0)


class Receivers:
    """A source that was sent each kind ten times a second; `read` hands over all that waits, as a socket does."""

    name, input, heard_s, t_ns = "nmea2000", None, -math.inf, 0

    def __init__(self) -> None:
        self.waiting: list[tuple[float, str, tuple[float, ...]]] = []

    def tell(self, hearer: Any) -> None:
        self._hearer = hearer

    def read(self, now_s: float) -> Fix | None:
        fix = None
        for at_s, kind, value in self.waiting:
            self.t_ns = round(at_s * 1e9)
            if kind == "position":
                self.heard_s, fix = now_s, Fix(SAID, self.t_ns, now_s)
            self._hearer(kind, value, 0)
        self.waiting.clear()
        return fix

    def report(self, now_s: float) -> dict[str, object]:
        return {}


def messages(reads: list[int]) -> list[tuple[float | None, ...]]:
    """The motion in the messages of two seconds after the start, of a boat that read at these times before it had settled."""
    settings = config.read(SETTINGS, "test")
    source = Receivers()
    estimated = Estimated(source, settings, State())  # type: ignore[arg-type]  # it is played
    made = []
    for tick in range(20):
        at_s = START_S + 0.1 * tick - 0.001
        wobble = 1e-4 * (tick % 7)  # sensors never say the same twice
        source.waiting += [
            (at_s + 0.001 * i, kind, (value[0] + wobble, *value[1:])) for i, (kind, value) in enumerate(KINDS.items())
        ]
        now_s = at_s + 0.005
        if tick in (0, 3, *reads) or tick > LATE:  # what waits for longer than STEP_S is taken for a clock that was set
            fix = estimated.read(now_s)
            if fix is not None:
                made.append(fix.navigation[1:7])
    return made


SETTINGS = {
    "boat": {"name": "Test", "id": 1},
    "navigation": {"sources": ["nmea2000"], "rate_hz": 10.0, "estimator": True},
    "nmea2000": {"interface": "canloop:n2k"},
}


@given(reads=st.sets(st.integers(1, LATE - 1)))
def test_whatever_was_read_at_once_before_the_program_was_up_the_messages_are_the_same(reads):
    """A replay reads each value by itself, and the boat all that waited."""
    assert messages(sorted(reads)) == messages([*range(1, LATE)]) != []
