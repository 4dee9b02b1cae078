"""Chips on a bus that is played: their registers and packets as the data sheets have them."""

import errno
import math
import os
import struct
from collections import deque

from delfim.parts.i2c import ina226, shtp

TRIMMING = bytes.fromhex("236B5849F65CFFCEF42300EA636E79F3F6AA4312C4")  # of a real BMP388, with a reading of it:
AIR = bytes.fromhex("979F6D73D885")  # github.com/elixir-sensors/bmp3xx, test/bmp3xx/bmp388/calibration_test.exs
AIR_PA, AIR_C = 100_876.00634692199, 30.499314453874284


class PlayedChip:
    """A chip of registers, each a byte; those of `words` are of two."""

    words = False

    def __init__(self) -> None:
        self.at = dict[int, int]()
        self.written = list[tuple[int, bytes]]()

    def registers(self, first: int, size: int) -> bytes:
        if self.words:
            return self.at.get(first, 0).to_bytes(2, "big")
        return bytes(self.at.get(first + i, 0) for i in range(size))

    def put(self, register: int, data: bytes) -> None:
        self.written.append((register, data))
        self.at[register] = int.from_bytes(data, "big")

    def read(self, size: int) -> bytes:
        raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))

    def write(self, data: bytes) -> None:
        raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))


class PlayedIna226(PlayedChip):
    words = True

    def __init__(self, voltage_v: float = 12.5, drop_v: float = 0.01) -> None:
        super().__init__()
        self.at[ina226.MAKER] = ina226.TEXAS
        self.measure(voltage_v, drop_v)

    def measure(self, voltage_v: float, drop_v: float) -> None:
        self.at[ina226.BUS] = round(voltage_v / ina226.BUS_V)
        self.at[ina226.SHUNT] = round(drop_v / ina226.SHUNT_V) & 0xFFFF
        self.at[ina226.FLAGS] = ina226.READY

    def registers(self, first: int, size: int) -> bytes:
        data = super().registers(first, size)
        if first == ina226.FLAGS:
            self.at[first] = 0  # reading clears it
        return data


class PlayedBmp390(PlayedChip):
    def __init__(self) -> None:
        super().__init__()
        self.at[0x00] = 0x60
        self.at |= {0x31 + i: each for i, each in enumerate(TRIMMING)}
        self.measure()

    def measure(self, data: bytes = AIR) -> None:
        self.at |= {0x04 + i: each for i, each in enumerate(data)} | {0x03: 0x70}

    def registers(self, first: int, size: int) -> bytes:
        data = super().registers(first, size)
        if first == 0x04:
            self.at[0x03] = 0x10
        return data


def quaternion(heading_rad: float, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> tuple[float, float, float, float]:
    """x, y, z, w of a chip whose x axis has this heading, against east, north and up: turned about z, then y, then x."""
    yaw, pitch, roll = math.pi / 2.0 - heading_rad, -pitch_rad, roll_rad  # about z upwards, and y to port
    cy, sy, cp, sp, cr, sr = (f(a / 2.0) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


class PlayedBno085(PlayedChip):
    """It tells what it was asked for, each time that `measure` is called; before that, that it was reset."""

    def __init__(self) -> None:
        super().__init__()
        self.asked = set[int]()
        self.packets, self._counters, self._begun = deque[bytes](), dict[int, int](), False
        self.frozen, self.number = False, 0
        self.reset()

    def reset(self) -> None:
        self.asked.clear()
        self.packets.clear()
        self.say(0, bytes(272))  # what it can do, of no interest
        self.say(shtp.EXECUTABLE, bytes((shtp.RESET_DONE,)))

    def say(self, channel: int, cargo: bytes) -> None:
        number = self._counters[channel] = self._counters.get(channel, -1) + 1
        self.packets.append(shtp.packed(channel, number, cargo))

    def measure(
        self,
        heading_rad: float,
        rate_radps: float = 0.0,
        attitude: tuple[float, float] = (0.0, 0.0),
        sure_rad: float = 0.05,
        quality: int = 3,
    ) -> None:
        if len(self.packets) > 16:  # it keeps no more for a host that does not read
            return
        self.number = self.number if self.frozen else self.number + 1 & 0xFF
        number = self.number
        cargo = struct.pack("<Bi", shtp.TIME_BASE, 20)
        if shtp.ROTATION in self.asked:
            parts = (round(each / shtp.TURN_STEP) for each in quaternion(heading_rad, *attitude))
            cargo += struct.pack("<BBBB5h", shtp.ROTATION, number, quality, 0, *parts, round(sure_rad / shtp.SURE_STEP))
        if shtp.GYRO in self.asked:
            cargo += struct.pack("<BBBB3h", shtp.GYRO, number, 3, 0, 0, 0, round(-rate_radps / shtp.RATE_STEP))
        self.say(shtp.REPORTS, cargo)

    def read(self, size: int) -> bytes:
        """Of a packet, as much as is asked for; the head comes again with its rest."""
        if not self.packets:
            return bytes(size)
        packet = self.packets[0]
        if size >= len(packet):
            self.packets.popleft()
        head, begun = packet[:4], self._begun
        self._begun = size < len(packet)
        if begun:
            head = struct.pack("<H", len(packet) | shtp.CONTINUES) + packet[2:4]
        return (head + packet[4:])[:size].ljust(size, b"\0")

    def write(self, data: bytes) -> None:
        self.written.append((data[2], data[4:]))
        assert struct.unpack("<H", data[:2]) == (len(data),)
        if data[2] == shtp.EXECUTABLE and data[4] == shtp.RESET:
            self.reset()
        if data[2] == shtp.CONTROL and data[4] == shtp.SET_FEATURE:
            self.asked.add(data[5])


class PlayedIcm20948(PlayedChip):
    """Gyro and accelerometer; registers of the chosen bank alone answer. `mag` is its magnetometer."""

    def __init__(self) -> None:
        super().__init__()
        self.banks, self.bank, self.mag = {0: {0x00: 0xEA}, 2: dict[int, int]()}, 0, PlayedChip()
        self.mag.at[0x01] = 0x09
        self.bias = 0.0, 0.0, 0.0
        self.at = self.banks[0]

    def put(self, register: int, data: bytes) -> None:
        self.written.append((register, data))
        if register == 0x7F:
            self.at = self.banks[data[0] >> 4]
        else:
            self.at[register] = data[0]

    def measure(self, heading_rad: float, rate_radps: float = 0.0, attitude: tuple[float, float] = (0.0, 0.0)) -> None:
        """A field of 25 uT that dips by 56 degrees, for a boat that is turned about down, then right, then ahead."""
        (roll, pitch), yaw = attitude, heading_rad
        cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
        north, down = 25e-6, 25e-6 * math.tan(math.radians(56.0))
        ahead = (cp * cy, cp * sy, -sp)
        right = (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp)
        below = (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp)
        field = (round((north * axis[0] + down * axis[2]) / 0.15e-6) for axis in (ahead, right, below))
        force = (-9.80665 * axis[2] for axis in (ahead, right, below))
        rates = (rate_radps * axis[2] + bias for axis, bias in zip((ahead, right, below), self.bias, strict=True))
        signs = 1.0, -1.0, -1.0  # its y is to the left and its z up
        said = [round(s * f / (9.80665 / 8192.0)) for s, f in zip(signs, force, strict=True)]
        said += [round(s * math.degrees(r) * 65.5) for s, r in zip(signs, rates, strict=True)]
        if self.banks[2].get(0x01) == 0x1B and self.at.get(0x06) == 0x01:
            self.at |= {0x2D + i: each for i, each in enumerate(struct.pack(">6h", *said))} | {0x1A: 1}
        if self.mag.at.get(0x31) == 0x08 and self.at.get(0x0F) == 0x02:
            self.mag.at |= {0x10 + i: each for i, each in enumerate(struct.pack("<B3hBB", 1, *field, 0, 0))}

    def registers(self, first: int, size: int) -> bytes:
        data = super().registers(first, size)
        if first == 0x1A:
            self.at[0x1A] = 0
        return data


class PlayedBus:
    """A bus with chips by their addresses; `error` is what each transfer ends with."""

    def __init__(self, **chips: PlayedChip) -> None:
        self.chips = {int(name.removeprefix("at_"), 16): chip for name, chip in chips.items()}
        self.error, self.opened, self.transfers = 0, 0, 0

    def __call__(self, device: str) -> "PlayedBus":
        self.opened += 1
        self._fail()
        return self

    def _fail(self) -> None:
        if self.error:
            raise OSError(self.error, os.strerror(self.error))

    def _chip(self, address: int) -> PlayedChip:
        self.transfers += 1
        self._fail()
        if address not in self.chips:
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        return self.chips[address]

    def read(self, address: int, size: int) -> bytes:
        return self._chip(address).read(size)

    def write(self, address: int, data: bytes) -> None:
        self._chip(address).write(data)

    def registers(self, address: int, first: int, size: int) -> bytes:
        return self._chip(address).registers(first, size)

    def put(self, address: int, register: int, data: bytes) -> None:
        self._chip(address).put(register, data)

    def close(self) -> None:
        pass
