"""The hardware of pulses for motors and servos: the kernel's PWM by sysfs, and a PCA9685 by the kernel's I2C. Everything here
may block, for milliseconds on I2C: it is for the outlet's process alone (docs/pwm.md).

Sources: Documentation/driver-api/pwm.rst and linux/i2c-dev.h of the kernel; NXP's PCA9685 data sheet, revision 4.
"""

import array
import errno
import fcntl
import glob
import os
import struct
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final, Protocol

from delfim.base.errors import DelfimError
from delfim.base.pulses import CHANNELS
from delfim.parts.pwm.table import Pwm

# linux/i2c-dev.h, linux/i2c.h
I2C_SLAVE: Final = 0x0703
I2C_SMBUS: Final = 0x0720
WRITE, READ = 0, 1
BYTE, BLOCK = 2, 8  # one byte of a register; up to 32 bytes from a register on
CHANNELS_A_WRITE: Final = 8  # of four registers each

MODE1, LED0, PRESCALE = 0x00, 0x06, 0xFE  # registers
ASLEEP, INCREMENT = 0x10, 0x20  # bits of MODE1; the prescaler takes a value only asleep
STEPS: Final = 4096  # of a period
AWAKE_S: Final = 0.0006  # the oscillator needs 500 us


class PulsePort(Protocol):
    """An output of pulses. Both methods may block, and raise OSError."""

    def put(self, pulses_us: Mapping[int, float]) -> None: ...  # the length of the pulse of each channel that is used
    def close(self) -> None: ...  # the last pulses go on


class SysfsPort:
    """The channels of a PWM chip of the kernel, a folder as /sys/class/pwm/pwmchip0. Raises OSError."""

    def __init__(self, chip: Path, rate_hz: float, pulses_us: Mapping[int, float]) -> None:
        """Open the channels, which start with these pulses."""
        self._duty = dict[int, int]()
        with ExitStack() as opening:
            for channel, pulse_us in pulses_us.items():
                place = chip / f"pwm{channel}"
                if not place.is_dir():
                    (chip / "export").write_text(f"{channel}\n")
                fd = os.open(place / "duty_cycle", os.O_WRONLY | os.O_CLOEXEC)
                opening.callback(os.close, fd)
                self._duty[channel] = fd
                with suppress(OSError):  # EINVAL before the first period; a duty beyond a shorter new period would refuse it
                    _rewrite(fd, 0)
                (place / "period").write_text(f"{round(1e9 / rate_hz)}\n")
                _rewrite(fd, pulse_us)
                (place / "enable").write_text("1\n")
            self._opened = opening.pop_all()

    def put(self, pulses_us: Mapping[int, float]) -> None:
        for channel, pulse_us in pulses_us.items():
            _rewrite(self._duty[channel], pulse_us)

    def close(self) -> None:
        self._opened.close()


def _rewrite(fd: int, pulse_us: float) -> None:
    os.pwrite(fd, b"%d\n" % round(pulse_us * 1000.0), 0)


class Pca9685Port:
    """The chip on a bus of the kernel, as /dev/i2c-1. Eight channels are one transfer: 3.1 ms at 100 kHz. Raises OSError."""

    def __init__(self, device: str, address: int, clock_hz: float, rate_hz: float, pulses_us: Mapping[int, float]) -> None:
        """Open the chip. Channels that are not used get no pulses; the others start with these."""
        prescale = min(max(round(clock_hz / (STEPS * rate_hz)) - 1, 3), 255)
        self._steps_per_us = clock_hz / (prescale + 1) / 1e6
        self._fd = os.open(device, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.ioctl(self._fd, I2C_SLAVE, address)
            self._write(MODE1, bytes((ASLEEP,)))
            self._write(PRESCALE, bytes((prescale,)))
            self._blocks(pulses_us, range(0, CHANNELS, CHANNELS_A_WRITE))
            self._write(MODE1, bytes((INCREMENT,)))
            time.sleep(AWAKE_S)
        except OSError:
            self.close()
            raise

    def put(self, pulses_us: Mapping[int, float]) -> None:
        """Write pulses. A chip that lost its power since sends nothing: that is an error, too."""
        mode = self._read(MODE1)
        if mode & (ASLEEP | INCREMENT) != INCREMENT:
            raise OSError(errno.EIO, "the PCA9685 was reset: is its supply sound?")
        self._blocks(pulses_us, sorted({each // CHANNELS_A_WRITE * CHANNELS_A_WRITE for each in pulses_us}))

    def close(self) -> None:
        os.close(self._fd)

    def _blocks(self, pulses_us: Mapping[int, float], firsts: Sequence[int]) -> None:
        """Write the channels of each block, by its first one."""
        for first in firsts:
            ends = (self._end(pulses_us.get(each)) for each in range(first, first + CHANNELS_A_WRITE))
            self._write(LED0 + 4 * first, b"".join(struct.pack("<HH", 0, end) for end in ends))

    def _end(self, pulse_us: float | None) -> int:
        """The step at which a pulse ends. STEPS sets the bit that keeps a channel low."""
        return STEPS if pulse_us is None else min(round(pulse_us * self._steps_per_us), STEPS - 1)

    def _write(self, register: int, data: bytes) -> None:
        if len(data) == 1:
            self._transfer(WRITE, register, BYTE, data)
        else:
            self._transfer(WRITE, register, BLOCK, bytes((len(data),)) + data)

    def _read(self, register: int) -> int:
        return self._transfer(READ, register, BYTE, b"\0")[0]

    def _transfer(self, direction: int, register: int, kind: int, data: bytes) -> bytes:
        """Make one transfer of `struct i2c_smbus_ioctl_data`: direction, register, kind, and the address of the data."""
        buffer = array.array("B", data.ljust(34, b"\0"))
        fcntl.ioctl(self._fd, I2C_SMBUS, struct.pack("@BBIP", direction, register, kind, buffer.buffer_info()[0]))
        return buffer.tobytes()


def open_port(pwm: Pwm, pulses_us: Mapping[int, float]) -> PulsePort:
    """Open the hardware of the vehicle's file, with these pulses already on its channels. Raises OSError, DelfimError."""
    found = glob.glob(pwm.chip)
    if len(found) != 1:
        raise DelfimError(f"pwm.chip: {pwm.chip} names {len(found)} chips: is the driver of the hardware loaded?")
    chip = Path(found[0])
    if chip.is_dir():
        return SysfsPort(chip, pwm.rate_hz, pulses_us)
    return Pca9685Port(str(chip), pwm.i2c_address, pwm.clock_hz, pwm.rate_hz, pulses_us)
