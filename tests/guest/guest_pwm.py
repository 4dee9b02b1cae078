"""Inside the guest: `delfim outlet` on an I2C bus, and the registers of its chip as another reader finds them."""

import ctypes
import fcntl
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from delfim.base.pulses import pack_command, socket_path, unpack_answer

FOLDER, BUS, CHIP = os.environ["FOLDER"], "/dev/i2c-0", 0x40
ROWS = ", ".join(
    f'{{name="{name}", driver="pwm", address={address}, y_m={y_m}, thrust_n=[-50.0, 50.0]}}'
    for address, name, y_m in ((0, "starboard", 0.5), (9, "port", -0.5))
)
HALF = (0.5, *(0.0,) * 8, -1.0, *(0.0,) * 6)
STEPS_PER_US = 25e6 / 122 / 1e6  # the data sheet's formula: 25 MHz, prescale 121


def register(number: int, value: int | None = None) -> int:
    """Read it, or write it: struct i2c_smbus_ioctl_data of linux/i2c-dev.h."""
    data = ctypes.create_string_buffer(bytes((value or 0,)), 34)
    bus = os.open(BUS, os.O_RDWR)
    fcntl.ioctl(bus, 0x0703, CHIP)
    fcntl.ioctl(bus, 0x0720, struct.pack("@BBIP", value is None, number, 2, ctypes.addressof(data)))
    os.close(bus)
    return data.raw[0]


def pulse_us(channel: int) -> float:
    start, end = (register(6 + 4 * channel + at) | register(7 + 4 * channel + at) << 8 for at in (0, 2))
    assert start == 0
    return 0.0 if end & 0x1000 else round(end / STEPS_PER_US / 10) * 10


def waited_for(what: str, ready: Callable[[], bool]) -> None:
    for _ in range(300):
        if ready():
            return
        time.sleep(0.1)
    raise SystemExit(f"{what} never came: pulses {[pulse_us(each) for each in range(16)]}")


values = (f"thrusters=[{ROWS}]", f'pwm.chip="{BUS}"', "pwm.arm_s=0.5", f'runtime.run_directory="{FOLDER}"')
words = [word for each in values for word in ("--set", each)]
outlet = subprocess.Popen([sys.executable, "-m", "delfim", "outlet", "etc/delfimx.toml", *words])
path = socket_path(FOLDER)
waited_for("the socket", path.exists)
client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
waited_for("the outlet", lambda: client.connect_ex(str(path)) == 0)
counter = 0


def asked() -> str:
    global counter
    counter += 1
    client.send(pack_command(counter, True, HALF))
    answer = unpack_answer(client.recv(1000))
    return answer.trouble or answer.state


assert register(0xFE) == 121, "50 pulses a second"
assert register(0x00) & 0x30 == 0x20, "awake, and counting its registers up"
assert [pulse_us(each) for each in (0, 1, 9)] == [1500, 0, 1500], "neutral where a motor is, low elsewhere"
assert asked() == "arming"
waited_for("the end of arming", lambda: asked() == "running")
assert [pulse_us(each) for each in (0, 9)] == [1700, 1100]
waited_for("neutral after silence", lambda: [pulse_us(each) for each in (0, 9)] == [1500, 1500])
waited_for("running again", lambda: asked() == "running" and pulse_us(0) == 1700)
register(0x00, 0x11)  # what it is after its power was gone: asleep
waited_for("the word of that", lambda: "was reset" in asked())
waited_for("arming again", lambda: asked() == "arming" and pulse_us(0) == 1500)
waited_for("running after that", lambda: asked() == "running" and pulse_us(0) == 1700)
outlet.kill()
outlet.wait()
assert pulse_us(0) == 1700, "its own death leaves the pulse: the supervisor starts it again"
outlet = subprocess.Popen([sys.executable, "-m", "delfim", "outlet", "etc/delfimx.toml", *words])
waited_for("neutral by the next one", lambda: [pulse_us(each) for each in (0, 9)] == [1500, 1500])
outlet.terminate()
assert outlet.wait() == 0
Path(FOLDER, "well").touch()
