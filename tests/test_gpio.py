"""The kernel's structures of a GPIO line, and a line that is played: no machine of the tests has a pin.

The structures are compared with the kernel's header where a C compiler has it. A socket plays the events; the level is
handed in beside it.
"""

import shutil
import socket
import subprocess
from pathlib import Path

import pytest

from delfim.base.errors import DelfimError
from delfim.lines import gpio

HEADER = Path("/usr/include/linux/gpio.h")
PROGRAM = """
#include <linux/gpio.h>
#include <stddef.h>
#include <stdio.h>
int main(void) {
    printf("%zu %zu %zu %zu %zu\\n", sizeof(struct gpiochip_info), sizeof(struct gpio_v2_line_info),
           sizeof(struct gpio_v2_line_request), sizeof(struct gpio_v2_line_values), sizeof(struct gpio_v2_line_event));
    printf("%lu %lu %lu %lu %lu\\n", (unsigned long)GPIO_GET_CHIPINFO_IOCTL, (unsigned long)GPIO_V2_GET_LINEINFO_IOCTL,
           (unsigned long)GPIO_V2_GET_LINE_IOCTL, (unsigned long)GPIO_V2_LINE_GET_VALUES_IOCTL,
           (unsigned long)GPIO_V2_LINE_SET_VALUES_IOCTL);
    printf("%d %d\\n", GPIO_V2_LINE_FLAG_OUTPUT, GPIO_V2_LINE_ATTR_ID_OUTPUT_VALUES);
    struct gpio_v2_line_request r = {.offsets = {7}, .consumer = "delfim", .num_lines = 1, .event_buffer_size = 16, .fd = -1};
    r.config.flags = GPIO_V2_LINE_FLAG_INPUT | GPIO_V2_LINE_FLAG_EDGE_RISING | GPIO_V2_LINE_FLAG_EDGE_FALLING
                     | GPIO_V2_LINE_FLAG_BIAS_PULL_UP;
    r.config.num_attrs = 1;
    r.config.attrs[0].attr.id = GPIO_V2_LINE_ATTR_ID_DEBOUNCE;
    r.config.attrs[0].attr.debounce_period_us = 5000;
    r.config.attrs[0].mask = 1;
    for (size_t i = 0; i < sizeof r; i++) printf("%02x", ((unsigned char *)&r)[i]);
}
"""


def event(what: int) -> bytes:
    return gpio.EVENT.pack(0, what, 7, 0, 0)


class Pin:
    """A line whose other end is here."""

    def __init__(self) -> None:
        self.far, near = socket.socketpair()
        near.setblocking(False)
        self.is_high = False
        self.line = gpio.GpioLine(near.detach(), lambda fd: self.is_high)

    def becomes(self, is_high: bool) -> None:
        self.is_high = is_high
        self.far.sendall(event(1 if is_high else 2))

    def close(self) -> None:
        self.line.close()
        self.far.close()


@pytest.fixture
def pin():
    pin = Pin()
    yield pin
    pin.close()


@pytest.mark.skipif(not (HEADER.exists() and shutil.which("cc")), reason="no C compiler, or not the kernel's headers")
def test_the_structures_are_the_kernels(tmp_path):
    (tmp_path / "gpio.c").write_text(PROGRAM)
    subprocess.run(["cc", "-o", tmp_path / "gpio", tmp_path / "gpio.c"], check=True)
    sizes, numbers, output, request = subprocess.run([tmp_path / "gpio"], capture_output=True, text=True).stdout.split("\n")
    structures = (gpio.CHIP, gpio.INFO, gpio.REQUEST, gpio.VALUES, gpio.EVENT)
    assert [int(each) for each in sizes.split()] == [each.size for each in structures]
    ours = [gpio.CHIP_INFO, gpio.LINE_INFO, gpio.GET_LINE, gpio.GET_VALUES, gpio.SET_VALUES]
    assert [int(each) for each in numbers.split()] == ours
    assert [int(each) for each in output.split()] == [gpio.OUTPUT, gpio.LEVELS]
    flags = gpio.INPUT | gpio.EDGES | gpio.BIASES["pull-up"]
    packed = gpio.REQUEST.pack(7, b"delfim", flags, 1, gpio.DEBOUNCE, 0, gpio.DEBOUNCE_US, 1, 1, gpio.EVENTS_MAX, -1)
    assert packed.hex() == request


def test_the_level_is_read_also_where_no_edge_came(pin):
    assert pin.line.read() == (False, {False})
    pin.is_high = True
    assert pin.line.read() == (True, {True})


def test_a_short_touch_between_two_looks_is_seen(pin):
    pin.becomes(True)
    pin.becomes(False)
    assert pin.line.read() == (False, {True, False})
    assert pin.line.read() == (False, {False})


def test_a_line_that_is_gone_says_so(pin):
    pin.far.close()
    assert pin.line.read() is None
    assert pin.line.trouble == "hung up"
    assert not pin.line.rebind()


def test_a_chip_that_there_is_not_is_named(tmp_path):
    with pytest.raises(DelfimError, match="No such file"):
        gpio.open_gpio(str(tmp_path / "gpiochip9"), "KILL", "pull-up")


def test_a_file_that_is_no_chip_is_refused_in_words(tmp_path):
    (tmp_path / "gpiochip9").touch()
    with pytest.raises(DelfimError, match="line KILL: "):
        gpio.open_gpio(str(tmp_path / "gpiochip9"), "KILL", "pull-up")


def test_a_line_is_found_by_its_name_on_a_chip_that_is_played(tmp_path, monkeypatch):
    """The kernel's answers, as linux/gpio.h has them."""
    (tmp_path / "gpiochip9").touch()
    asked, levels = [], []

    def answer(fd, number, data):
        if number == gpio.CHIP_INFO:
            data[:] = type(data)("B", gpio.CHIP.pack(b"gpiochip9", b"pinctrl", 3))
        elif number == gpio.LINE_INFO:
            offset = gpio.INFO.unpack(data.tobytes())[2]
            data[:] = type(data)("B", gpio.INFO.pack((b"LED", b"KILL", b"FAN")[offset], b"", offset))
        elif number == gpio.SET_VALUES:
            levels.append(gpio.VALUES.unpack(data.tobytes()))
        else:
            asked.append(gpio.REQUEST.unpack(data.tobytes()))
            granted = (*asked[-1][:-1], socket.socket().detach())
            data[:] = type(data)("B", gpio.REQUEST.pack(*granted))

    monkeypatch.setattr(gpio.fcntl, "ioctl", answer)
    gpio.open_gpio(str(tmp_path / "gpiochip9"), "KILL", "pull-up").close()
    assert asked[0][0] == 1
    output = gpio.open_output(str(tmp_path / "gpiochip9"), "FAN", True)
    output.put(False)
    output.close()
    assert asked[1][0] == 2
    assert asked[1][2:7] == (gpio.OUTPUT, 1, gpio.LEVELS, 0, 1), "high from the start"
    assert levels == [(0, 1)]
    with pytest.raises(DelfimError, match="has no line named STOP; gpioinfo lists them"):
        gpio.open_gpio(str(tmp_path / "gpiochip9"), "STOP", "pull-up")
