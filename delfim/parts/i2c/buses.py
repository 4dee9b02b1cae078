"""The computer's I2C buses, by the kernel's /dev/i2c-N. Everything here may block, for TIMEOUT_S where a chip holds the clock
low, and for good where the bus's driver is broken: it is for the threads of the service alone.

Sources: linux/i2c.h, linux/i2c-dev.h and Documentation/i2c/dev-interface.rst of the kernel.
"""

import array
import fcntl
import os
import struct
from typing import Final, Protocol

I2C_TIMEOUT, I2C_SLAVE, I2C_RDWR, I2C_SMBUS = 0x0702, 0x0703, 0x0707, 0x0720  # ioctl
TIMEOUT_S: Final = 0.1
TICKS_PER_S: Final = 100  # of I2C_TIMEOUT
READS: Final = 1  # flag of a message, and direction of a transfer of registers
BYTE, WORD, BLOCK = 2, 3, 8  # kinds of transfers of registers
BLOCK_MAX: Final = 32  # bytes


class I2cBus(Protocol):
    """A bus, whose chips are asked by their addresses. Each method may block, and raises OSError."""

    def read(self, address: int, size: int) -> bytes: ...
    def write(self, address: int, data: bytes) -> None: ...
    def registers(self, address: int, first: int, size: int) -> bytes: ...  # BLOCK_MAX at most, from a register on
    def put(self, address: int, register: int, data: bytes) -> None: ...  # a register of one or two bytes
    def close(self) -> None: ...


class KernelBus:
    """A bus of the kernel. Registers go by the transfers of SMBus, which every adapter has, and i2c-stub, too."""

    def __init__(self, device: str) -> None:
        """Raises OSError."""
        self._fd = os.open(device, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.ioctl(self._fd, I2C_TIMEOUT, round(TIMEOUT_S * TICKS_PER_S))
        except OSError:
            self.close()
            raise

    def read(self, address: int, size: int) -> bytes:
        return self._message(address, READS, bytes(size))

    def write(self, address: int, data: bytes) -> None:
        self._message(address, 0, data)

    def registers(self, address: int, first: int, size: int) -> bytes:
        if size > 2:
            return self._transfer(address, READS, first, BLOCK, bytes((size,)))[1 : 1 + size]
        return self._transfer(address, READS, first, WORD if size == 2 else BYTE, b"")[:size]

    def put(self, address: int, register: int, data: bytes) -> None:
        self._transfer(address, 0, register, WORD if len(data) == 2 else BYTE, data)

    def close(self) -> None:
        os.close(self._fd)

    def _message(self, address: int, flags: int, data: bytes) -> bytes:
        """Make one message of `struct i2c_rdwr_ioctl_data`: address, flags, length and address of its data."""
        buffer = array.array("B", data)
        message = array.array("B", struct.pack("@HHHP", address, flags, len(data), buffer.buffer_info()[0]))
        fcntl.ioctl(self._fd, I2C_RDWR, struct.pack("@PI", message.buffer_info()[0], 1))
        return buffer.tobytes()

    def _transfer(self, address: int, direction: int, register: int, kind: int, data: bytes) -> bytes:
        """Make one transfer of `struct i2c_smbus_ioctl_data`: direction, register, kind, and the address of the data."""
        buffer = array.array("B", data.ljust(2 + BLOCK_MAX, b"\0"))
        fcntl.ioctl(self._fd, I2C_SLAVE, address)
        fcntl.ioctl(self._fd, I2C_SMBUS, struct.pack("@BBIP", direction, register, kind, buffer.buffer_info()[0]))
        return buffer.tobytes()
