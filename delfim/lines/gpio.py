"""A line of a GPIO chip, by its name, over Linux' character device (GPIO v2 of linux/gpio.h, kernel 5.10).

Names and not numbers: a newer board of the same family may count its lines otherwise, as the Raspberry Pi 5 does.
"""

import array
import os
import struct
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from delfim.base.errors import DelfimError
from delfim.lines.forms import Bias, Level

with suppress(ImportError):  # Linux alone has it, and the console's dry run builds a boat on every system
    import fcntl

CHIP_INFO, LINE_INFO, GET_LINE, GET_VALUES, SET_VALUES = 0x8044B401, 0xC100B405, 0xC250B407, 0xC010B40E, 0xC010B40F  # ioctl
CHIP: Final = struct.Struct("=32s32sI")  # gpiochip_info: name, label, number of lines
INFO: Final = struct.Struct("=32s32sI188x")  # gpio_v2_line_info: name, consumer, offset
REQUEST: Final = struct.Struct("=I252x32sQI20xIIQQ216xII20xi")  # gpio_v2_line_request, with one line and one attribute
VALUES: Final = struct.Struct("=QQ")  # gpio_v2_line_values: bits, mask
EVENT: Final = struct.Struct("=QIIII24x")  # gpio_v2_line_event: time, what, line, numbers
RISING: Final = 1  # what an event is; 2 is falling
INPUT, OUTPUT, EDGES = 1 << 2, 1 << 3, 1 << 4 | 1 << 5
BIASES: Final[dict[Bias, int]] = {"pull-up": 1 << 8, "pull-down": 1 << 9, "none": 1 << 10}
LEVELS, DEBOUNCE = 2, 3  # attributes: of an output at its start, of an input
DEBOUNCE_US: Final = 5_000  # a contact bounces for a few milliseconds
EVENTS_MAX: Final = 16  # of the kernel's buffer, for one line


class GpioLine:
    """An input of a GPIO chip. `read` never raises and never waits."""

    def __init__(self, fd: int, level: Callable[[int], bool] | None = None) -> None:
        """`fd` gives the events, 48 bytes each, and does not block. `level` reads the present level of it; where the kernel
        does not, a test hands in another one, and a socket."""
        self._fd, self._level = fd, level or _level
        self.trouble = ""

    def fileno(self) -> int:
        return self._fd

    def rebind(self) -> bool:
        return not self.trouble

    def read(self) -> Level | None:
        """Read the level; None if the line cannot be read any more: `trouble` says why."""
        try:
            was = _seen(self._fd)
            now = self._level(self._fd)
        except OSError as error:
            self.trouble = str(error.strerror)
            return None
        return Level(now, frozenset((*was, now)))

    def close(self) -> None:
        os.close(self._fd)


class GpioOutput:
    """An output of a GPIO chip. It never waits."""

    def __init__(self, fd: int) -> None:
        self._fd = fd

    def put(self, is_high: bool) -> None:
        """Set the level. Raises OSError."""
        fcntl.ioctl(self._fd, SET_VALUES, array.array("B", VALUES.pack(is_high, 1)))

    def close(self) -> None:
        """Close the line; most chips keep the level."""
        os.close(self._fd)


def open_gpio(chip: str, name: str, bias: Bias) -> GpioLine:
    """Open an input. Raises DelfimError where there is no such chip or line, or another program has it."""
    line = _requested(chip, name, INPUT | EDGES | BIASES[bias], DEBOUNCE, DEBOUNCE_US, EVENTS_MAX)
    os.set_blocking(line, False)
    return GpioLine(line)


def open_output(chip: str, name: str, is_high: bool) -> GpioOutput:
    """Open an output with this level from the start. Raises as `open_gpio`."""
    return GpioOutput(_requested(chip, name, OUTPUT, LEVELS, int(is_high), 0))


def _requested(chip: str, name: str, flags: int, attribute: int, value: int, events: int) -> int:
    """Request the line for this program alone. Raises DelfimError."""
    try:
        fd = os.open(chip, os.O_RDWR | os.O_CLOEXEC)
    except OSError as error:
        raise DelfimError(f"{chip}: {error.strerror}") from None
    try:
        wanted = array.array("B", REQUEST.pack(
            _offset(fd, chip, name), b"delfim", flags, 1, attribute, 0, value, 1, 1, events, -1
        ))  # fmt: skip
        fcntl.ioctl(fd, GET_LINE, wanted)
    except OSError as error:
        raise DelfimError(f"{chip}: line {name}: {error.strerror}") from None
    finally:
        os.close(fd)
    line: int = REQUEST.unpack(wanted.tobytes())[-1]
    return line


def _offset(fd: int, chip: str, name: str) -> int:
    """The number of the line with this name. Raises DelfimError, OSError."""
    info = array.array("B", bytes(CHIP.size))
    fcntl.ioctl(fd, CHIP_INFO, info)
    for offset in range(CHIP.unpack(info.tobytes())[2]):
        line = array.array("B", INFO.pack(b"", b"", offset))
        fcntl.ioctl(fd, LINE_INFO, line)
        if INFO.unpack(line.tobytes())[0].rstrip(b"\0") == name.encode():
            return offset
    raise DelfimError(f"{chip} has no line named {name}; gpioinfo lists them")


def _level(fd: int) -> bool:
    values = array.array("B", VALUES.pack(0, 1))
    fcntl.ioctl(fd, GET_VALUES, values)
    return bool(VALUES.unpack(values.tobytes())[0] & 1)


def _seen(fd: int) -> list[bool]:
    """The level after each waiting event. Raises OSError, also where the other end has gone."""
    try:
        data = os.read(fd, EVENT.size * EVENTS_MAX)
    except BlockingIOError:
        return []
    if not data:
        raise OSError(0, "hung up")
    return [what == RISING for _, what, *_ in EVENT.iter_unpack(data[: len(data) // EVENT.size * EVENT.size])]
