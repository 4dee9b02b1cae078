"""CEVA's BNO085 (BNO080, BNO086), which reckons heading and attitude from its gyro, accelerometer and magnetometer."""

import math
from typing import Final

from delfim.base.errors import FormatError
from delfim.parts.i2c.buses import I2cBus
from delfim.parts.i2c.chips import ChipTurn
from delfim.parts.i2c.shtp import (
    CONTROL,
    EXECUTABLE,
    GYRO,
    HEAD,
    REPORTS,
    RESET,
    RESET_DONE,
    ROTATION,
    Rotation,
    feature,
    length_of,
    packed,
    reports,
)
from delfim.parts.i2c.table import I2cSensor

PACKETS: Final = 8  # in one reading


class Bno085:
    """Its x axis lies `turned_deg` clockwise from the bow, z is up."""

    def __init__(self, table: I2cSensor) -> None:
        self._at, self._rate_hz, self.period_s = table.at, table.rate_hz, 1.0 / table.rate_hz
        self._sure_rad = math.radians(table.heading_max_deg)
        turned_rad = math.radians(table.turned_deg)
        self._bow = math.cos(turned_rad), math.sin(turned_rad)  # in the chip's x and y: y is to port of x
        self._counters = {CONTROL: 0, EXECUTABLE: 0}
        self._heard = dict[int, int]()  # the counter of each report's last
        self._begun = False

    def begin(self, bus: I2cBus) -> None:
        """Ask for the reports, after a reset where that did not bring them."""
        self._heard.clear()
        if self._begun:
            self._begun = False
            self._write(bus, EXECUTABLE, bytes((RESET,)))
            return  # it tells when that is done
        self._begun = True
        self._ask(bus)

    def read(self, bus: I2cBus, now_s: float) -> ChipTurn | None:
        found = ChipTurn()
        for _ in range(PACKETS):
            if not (length := length_of(bus.read(self._at, HEAD.size))):
                break
            packet = bus.read(self._at, length)
            if length_of(packet[: HEAD.size]) != length:
                raise FormatError("a packet with another length than it began with")
            channel, cargo = packet[2], packet[HEAD.size :]
            if channel == EXECUTABLE and cargo[:1] == bytes((RESET_DONE,)):
                self._ask(bus)
            elif channel == REPORTS:
                found = self._take(cargo, found)
        return None if found == ChipTurn() else found

    def _take(self, cargo: bytes, found: ChipTurn) -> ChipTurn:
        for each in reports(cargo):
            kind = ROTATION if isinstance(each, Rotation) else GYRO
            if self._heard.get(kind) == each.counter:  # it repeats itself
                continue
            self._heard[kind] = each.counter
            found = self._turned(each, found) if isinstance(each, Rotation) else found._replace(rate_radps=-each.radps[2])
        return found

    def _turned(self, told: Rotation, found: ChipTurn) -> ChipTurn:
        """Heading of the bow, and attitude. Raises FormatError for a chip that lies on its back."""
        if not told.is_upright:
            raise FormatError("its z axis points down: it must lie with its top up")
        ahead, aside = self._bow
        east, north, up = told.axis(ahead, aside)
        port_up = told.axis(-aside, ahead)[2]
        pitch_rad = math.asin(min(max(up, -1.0), 1.0))
        roll_rad = math.asin(min(max(port_up / max(math.cos(pitch_rad), 1e-9), -1.0), 1.0))
        is_sure = told.quality and told.deviation_rad <= self._sure_rad
        return found._replace(
            heading_rad=math.atan2(east, north) % math.tau if is_sure else None, attitude=(roll_rad, pitch_rad)
        )

    def _ask(self, bus: I2cBus) -> None:
        for report in (ROTATION, GYRO):
            self._write(bus, CONTROL, feature(report, self._rate_hz))

    def _write(self, bus: I2cBus, channel: int, cargo: bytes) -> None:
        counter, self._counters[channel] = self._counters[channel], self._counters[channel] + 1
        bus.write(self._at, packed(channel, counter, cargo))
