"""A hand-set in lock step: sticks and switches set by the scenario, sent as a CRSF receiver sends them."""

from typing import Annotated

import msgspec

from delfim import config
from delfim.base import tables
from delfim.lines.radiocontrol.channels import CHANNELS, MIDDLE, STEP_US
from delfim.lines.radiocontrol.crsf import CHANNELS as CHANNELS_FRAME
from delfim.lines.radiocontrol.crsf import LINK, checksum
from delfim.simulator.line import LockstepLine

FRAMES = 4  # of channels, at once: a cycle has several of them
ON_US, OFF_US = 2000.0, 1000.0
Position = Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)]


class HandsetAt(tables.Table, frozen=True):
    """The position of all sticks and switches from this time on, until the next row."""

    at_s: Annotated[float, msgspec.Meta(ge=0.0, le=86_400.0)]
    throttle: Position = 0.0  # ahead
    steer: Position = 0.0  # to starboard
    take: bool = False
    kill: bool = False
    radio: bool = True  # false: it is lost


class SimulatedReceiver:
    """The receiver at the other end of the boat's serial line."""

    def __init__(self, settings: config.HandsetTable, rows: tuple[HandsetAt, ...], line: LockstepLine) -> None:
        self._settings, self._line = settings, line
        self._rows = sorted(rows, key=lambda row: row.at_s)

    def speak(self, now_s: float) -> None:
        """Send the channels; call it at each cycle."""
        due = [row for row in self._rows if row.at_s <= now_s]
        if not due:
            return
        link = _frame(LINK, bytes((60, 60, 99 if due[-1].radio else 0, 5, 0, 2, 3, 60, 99, 5)))
        channels = _frame(CHANNELS_FRAME, self._packed(due[-1])) if due[-1].radio else b""
        self._line.put(link + FRAMES * channels)

    def _packed(self, row: HandsetAt) -> bytes:
        pulses_us = dict.fromkeys(range(1, CHANNELS + 1), 1500.0)
        for stick, part in ((self._settings.throttle, row.throttle), (self._settings.steer, row.steer)):
            way = -part if stick.reversed else part
            end_us = stick.high_us if way > 0.0 else stick.low_us
            pulses_us[stick.channel] = stick.middle_us + abs(way) * (end_us - stick.middle_us)
        for switch, is_on in ((self._settings.take, row.take), (self._settings.kill, row.kill)):
            pulses_us[switch.channel] = ON_US if is_on is (switch.on == "high") else OFF_US
        numbers = [round((pulses_us[channel] - 1500.0) / STEP_US) + MIDDLE for channel in range(1, CHANNELS + 1)]
        return sum(number << 11 * channel for channel, number in enumerate(numbers)).to_bytes(22, "little")


def _frame(kind: int, payload: bytes) -> bytes:
    body = bytes((kind,)) + payload
    return bytes((0xC8, len(body) + 1)) + body + bytes((checksum(body),))
