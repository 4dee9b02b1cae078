"""The hand-set of a radio control as an operator of the boat: a switch takes it, sticks drive it, a switch kills it.

The position of the take-over switch counts, not its movement: whenever the radio reaches the boat with the switch on, the
hand-set has it. It gives the boat back in idle: who lets go of it may stand beside the propellers, and hold would start them.
"""

import math
from collections.abc import Iterator
from typing import Final

from delfim import config
from delfim.base.modes import Mode
from delfim.lines.radiocontrol import crsf, sbus
from delfim.lines.radiocontrol.channels import Decoder, Pulses
from delfim.parts.handset.killswitch import change
from delfim.vehicle import console
from delfim.vehicle.links import Links, Readable, ReadableLine
from delfim.vehicle.report import HandsetReport
from delfim.vehicle.state import HANDSET, State

ALIKE: Final = 3  # readings in a row before a switch counts
HIGH_US, LOW_US = 1700.0, 1300.0  # a switch between these is on its way, or a third position: it stays as it was
REPEAT_S: Final = 0.2  # sticks that rest are told this often: the dead-man of manual thrust asks for it
CHANGE_S: Final = 0.05  # sticks that move, at most this often
PIECES: Final = 4  # of the line, at once: more than 20 ms of the fastest one


class Debounced:
    """A switch of the hand-set."""

    def __init__(self, settings: config.Switch) -> None:
        self._settings = settings
        self.forget()

    def forget(self) -> None:
        """Forget the position."""
        self.on, self._seen, self._alike = False, False, 0
        self.is_known = not self._settings.channel

    def see(self, pulses: Pulses) -> None:
        if not self._settings.channel:
            return
        us = pulses[self._settings.channel - 1]
        if LOW_US < us < HIGH_US:
            self._alike = 0
            return
        seen = (us >= HIGH_US) is (self._settings.on == "high")
        self._alike = self._alike + 1 if seen is self._seen else 1
        self._seen = seen
        if self._alike >= ALIKE:
            self.on, self.is_known = seen, True


def fraction(stick: config.Stick, pulses: Pulses, neutral: float) -> float:
    """The part of a stick's way, -1 to 1; 0 around the middle."""
    off_us = pulses[stick.channel - 1] - stick.middle_us
    part = off_us / (stick.high_us - stick.middle_us if off_us > 0.0 else stick.middle_us - stick.low_us)
    part = 0.0 if abs(part) <= neutral else max(-1.0, min(1.0, part))
    return -part if stick.reversed else part


class Handset:
    """A hand-set as a `Hand`."""

    name = HANDSET

    def __init__(self, settings: config.HandsetTable, line: ReadableLine, decoder: Decoder) -> None:
        self.input: Readable = line
        self._line = line
        self._settings, self._decoder = settings, decoder
        self._take, self._kill = Debounced(settings.take), Debounced(settings.kill)
        self._throttle = self._steer = 0.0
        self._heard_s = -math.inf
        self._ready = False  # the sticks were in the middle since the boat was taken, or stopped
        self._drove = self._was_off = False  # the boat was in manual mode; the take-over switch was off
        self._told, self._told_s = (0.0, 0.0), -math.inf  # the thrust that was asked for last

    def read(self, state: State, now_s: float) -> None:
        for pulses in self._waiting():
            self._heard_s = now_s
            self._take.see(pulses)
            self._kill.see(pulses)
            neutral = self._settings.neutral
            self._throttle = fraction(self._settings.throttle, pulses, neutral)
            self._steer = fraction(self._settings.steer, pulses, neutral)
        if self._was_heard:
            switches = self._take.on, self._kill.on
            told = self._heard_s, self._throttle, self._steer, *switches, self._decoder.lost, self._decoder.quality_pct
            state.handset = HandsetReport(*told)

    def _waiting(self) -> Iterator[Pulses]:
        """All data that came, unless the line floods: it is read fifty times a second."""
        for _ in range(PIECES):
            if not (data := self._line.read()):
                return
            yield from self._decoder.feed(data)

    def orders(self, state: State, now_s: float) -> Iterator[console.Commands]:
        """Loss, the switches, then the sticks."""
        lost, has = self._lost(now_s), state.operator == HANDSET
        missed = lost if self._settings.mandatory and self._was_heard else ""  # before, a check keeps the boat in idle
        yield from change(HANDSET, "its kill switch" if self._kill.on and not lost else missed, state)
        if lost:
            self._take.forget()
            self._kill.forget()
            self._ready = self._was_off = False
            if has:
                yield console.Leave(f"{HANDSET} {lost}")
        elif not self._take.is_known:
            pass
        elif not self._take.on:
            self._was_off = True
            if has:
                yield console.Leave()
        elif not has:
            yield from self._taking(state)
        else:
            yield from self._driving(state, now_s)

    @property
    def _was_heard(self) -> bool:
        return math.isfinite(self._heard_s)

    def _lost(self, now_s: float) -> str:
        """The reason, in words, why the hand-set is lost; empty: it is not."""
        if self._decoder.lost:
            return f"lost: {self._decoder.lost}"
        if now_s - self._heard_s > self._settings.silent_s:
            return "silent" if self._was_heard else "not heard yet"
        return ""

    def _taking(self, state: State) -> Iterator[console.Commands]:
        """Manual without thrust; a boat that cannot, stops. Who moved the switch with the sticks in the middle also ends the
        kill of the hand-set's own, for there may be no console."""
        killed = state.killed
        if self._was_off and killed.by == HANDSET and not killed.held and not self._throttle and not self._steer:
            yield console.Clear()
        self._ready = self._was_off = False
        yield console.Take()
        yield console.SetMode("manual")
        if state.mode is not Mode.MANUAL:
            yield console.Stop()

    def _driving(self, state: State, now_s: float) -> Iterator[console.Commands]:
        """After anything that ended manual mode, the sticks go to the middle before they drive again."""
        drives = state.mode is Mode.MANUAL
        self._ready = self._ready and (drives or not self._drove)
        self._drove = drives
        rests = not self._throttle and not self._steer
        self._ready = self._ready or rests
        push = self._thrust() if self._ready else (0.0, 0.0)
        waited_s = now_s - self._told_s
        if waited_s < (CHANGE_S if push != self._told else REPEAT_S):
            return
        self._told, self._told_s = push, now_s
        if drives:
            yield console.Manual(*push)
        elif rests or not self._ready:
            yield console.Alive()
        else:
            yield console.Manual(*push)
            self._ready = self._drove = state.mode is Mode.MANUAL

    def _thrust(self) -> tuple[float, float]:
        """The thrust of starboard and port, in hundredths."""
        starboard, port = (self._throttle + side * self._steer for side in (-1.0, 1.0))
        return round(max(-1.0, min(1.0, starboard)), 2), round(max(-1.0, min(1.0, port)), 2)


def open_handset(settings: config.HandsetTable, links: Links) -> Handset:
    """Open the hand-set. Raises DelfimError where its port cannot be opened."""
    if settings.protocol == "sbus":
        return Handset(settings, links.line(settings.device, settings.baud or sbus.BAUD, "8E2"), sbus.Sbus())
    return Handset(settings, links.line(settings.device, settings.baud or crsf.BAUD), crsf.Crsf())
