"""The battery clock of an emulated PC: read before the programs start, written after they ended, by the image's own program."""

import re

import pytest

from tests.guest import boat_image
from tests.guest.pc import pc

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]  # the first one waits for the image to be built
BOOT_S = 240.0
TRIED = """
import time
from delfim.services.clock import kernel as k

def told(words):
    battery = time.strftime("%F %H:%M", time.gmtime((k.battery_ns() or 0) / 1e9))
    print(words, battery, time.strftime("%F %H:%M", time.gmtime()), flush=True)

time.clock_settime(time.CLOCK_REALTIME, 100.0)
told("in 1970")
k.set_from_battery("auto", ("can0",))
told("set")
time.clock_settime(time.CLOCK_REALTIME, 1.9e9)
k.write_battery("auto", ("can0",))
told("written")
time.clock_settime(time.CLOCK_REALTIME, 100.0)
k.write_battery("auto", ("can0",))
told("kept")
"""


def test_the_battery_clock_gives_the_time_to_1970_and_takes_no_other() -> None:
    if reason := boat_image.missing():
        pytest.skip(reason)
    image = boat_image.build()
    append = "console=ttyS0 quiet mitigations=off rdinit=/bin/sh"
    kernel = ("-kernel", str(image / "vmlinuz"), "-initrd", str(image / "initramfs.gz"), "-append", append)
    with pc(words=(*kernel, "-rtc", "base=2026-11-20T10:00:10")) as computer:
        computer.wait_for("# ", BOOT_S)
        computer.type("mount -t proc proc /proc; mount -t sysfs sysfs /sys; mount -t devtmpfs dev /dev; stty -echo; echo up")
        computer.wait_for("up\r\n", BOOT_S)
        for line in ("cat >/run/tried.py <<'END'", *TRIED.splitlines(), "END", "python3 /run/tried.py; echo ended"):
            computer.type(line)
        said = computer.wait_for("ended\r\n", BOOT_S)
    found = re.findall(r"(in 1970|set|written|kept) (\S+ \d\d):\d\d (\S+ \d\d):\d\d", said)
    assert found == [  # to the hour: an emulator on a busy host takes minutes to come up
        ("in 1970", "2026-11-20 10", "1970-01-01 00"),
        ("set", "2026-11-20 10", "2026-11-20 10"),
        ("written", "2030-03-17 17", "2030-03-17 17"),
        ("kept", "2030-03-17 17", "1970-01-01 00"),
    ], said
