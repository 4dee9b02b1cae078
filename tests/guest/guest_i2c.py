"""Inside the guest: `i2cd` on a bus of a real kernel, whose chips' registers are set here, and what it tells."""

import contextlib
import ctypes
import fcntl
import os
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

from tests.parts.i2c.played import AIR, AIR_PA, TRIMMING

FOLDER, BUS, WORD, BYTE = os.environ["FOLDER"], "/dev/i2c-0", 3, 2
BATTERY, BAROMETER = 0x40, 0x76


def transfer(chip: int, direction: int, register: int, kind: int, data: bytes) -> bytes:
    """struct i2c_smbus_ioctl_data of linux/i2c-dev.h."""
    buffer = ctypes.create_string_buffer(data, 34)
    bus = os.open(BUS, os.O_RDWR)
    fcntl.ioctl(bus, 0x0703, chip)
    fcntl.ioctl(bus, 0x0720, struct.pack("@BBIP", direction, register, kind, ctypes.addressof(buffer)))
    os.close(bus)
    return buffer.raw


def word(register: int, value: int) -> None:
    """A word that the chip sends high byte first: SMBus takes its low byte first."""
    transfer(BATTERY, 0, register, WORD, value.to_bytes(2, "big"))


word(0xFE, 0x5449)
word(0x02, 0x2570)  # 11.98 V
word(0x01, 0x1000)  # 10.24 mV
word(0x06, 0x0008)
for first, data in ((0x00, b"\x60"), (0x03, b"\x70"), (0x04, AIR), (0x31, TRIMMING)):
    for at, each in enumerate(data, first):
        transfer(BAROMETER, 0, at, BYTE, bytes((each,)))

heard = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
heard.bind(("127.0.0.1", 0))
heard.settimeout(60.0)
port = heard.getsockname()[1]
values = (
    f'runtime.run_directory="{FOLDER}"',
    f'nmea0183.ports.i2c.device="udp:127.0.0.1:{port}"',
    f'i2c.to="udp:127.0.0.1:{port}"',
    f'i2c.sensors.battery={{chip="ina226", bus="{BUS}", shunt_ohm=0.001}}',
    f'i2c.sensors.air={{chip="bmp390", bus="{BUS}", address=0x76}}',
    f'i2c.sensors.compass={{chip="bno085", bus="{BUS}"}}',
    f'i2c.sensors.other={{chip="ina226", bus="{BUS}", address=0x41}}',
)
words = [each for value in values for each in ("--set", value)]
said = open(Path(FOLDER, "said"), "wb")  # noqa: SIM115 - it outlives this line
service = subprocess.Popen(
    [sys.executable, "-m", "delfim", "run", "etc/boats/bait-boat.toml", "--service", "i2cd", *words], stdout=said, stderr=said
)


def told(begin: bytes) -> bytes:
    end_s = time.monotonic() + 60.0
    with contextlib.suppress(TimeoutError):
        while time.monotonic() < end_s:
            for sentence in heard.recv(4096).splitlines():
                if begin in sentence:
                    return sentence
    raise SystemExit(f"{begin!r} never came: {Path(FOLDER, 'said').read_text()}")


assert b"U,11.980,V,battery,I,10.240,A,battery*" in told(b",battery")
assert f"P,{AIR_PA / 1e5:.6f},B,air,C,30.5,C,air*".encode() in told(b",air")
assert transfer(BATTERY, 1, 0x00, WORD, b"")[:2] == b"\x47\x27", "as the chip is set up"
assert transfer(BAROMETER, 1, 0x1B, BYTE, b"")[:1] == b"\x33"
word(0x01, 0xF000)
while b",I,-10.240,A," not in told(b",battery"):
    pass
word(0x06, 0x0000)  # it measures nothing new
time.sleep(6.0)
service.terminate()
assert service.wait(30.0) == 0
words_said = Path(FOLDER, "said").read_text()
for wanted in (
    "battery (ina226 at 0x40 of /dev/i2c-0): it answers, and measures nothing new for 3 s",
    "compass (bno085 at 0x4a of /dev/i2c-0): this bus has the transfers of SMBus alone, and the chip needs others",
    "other (ina226 at 0x41 of /dev/i2c-0): nothing answers there",
):
    assert wanted in words_said, (wanted, words_said)
print(words_said)
Path(FOLDER, "well").touch()
