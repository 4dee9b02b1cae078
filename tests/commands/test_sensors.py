"""`delfim sensors`: ports of a boat that does not run, a port whose rate nobody knows, and a turn by hand, over ptys."""

import contextlib
import math
import os
import re
import socket
import subprocess
import sys
import termios
from collections.abc import Callable
from itertools import count
from pathlib import Path

import pytest

from delfim import config
from delfim.base.clock import SystemClock
from delfim.desk.firstcontact import Turned, judged, named, user_of
from delfim.desk.listen import Opened, Running, SensorsTold, listener
from delfim.desk.sensor_table import table
from delfim.lines.nmea0183.framing import framed

ROOT = Path(__file__).parents[2]
GGA = "GPGGA,1200{:02d}.00,3841.4420,N,00912.9180,W,4,12,0.7,0.0,M,,M,,"
RMC = "GPRMC,1200{:02d}.00,A,3841.4420,N,00912.9180,W,2.0,90.0,221126,,,A"
FILE = """
[boat]
name = "tried"
[navigation]
sources = ["nmea0183"]
[sensors]
names = ["nmea0183"]
[console]
socket = "{place}/command"
[nmea0183.ports.gnss]
device = "{place}/gnss"
[nmea0183.ports.compass]
device = "{place}/compass"
baud = 9600
[nmea0183.ports.lost]
device = "{place}/lost"
"""


class Player:
    """A sensor at the other end of a pty, which nobody but the command has open."""

    def __init__(self, name: Path) -> None:
        self.end, port = os.openpty()
        os.set_blocking(self.end, False)
        name.symlink_to(os.ttyname(port))
        os.close(port)

    def say(self, data: bytes) -> None:
        with contextlib.suppress(OSError):  # nobody reads
            os.write(self.end, data)

    def baud(self) -> int:
        return termios.tcgetattr(self.end)[4]


def sensors(*words: str, speak: Callable[[int], object]) -> tuple[int, str]:
    """Exit code and words of the command, while the sensors speak twenty times a second."""
    command = [sys.executable, "-m", "delfim", "sensors", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT)
    for number in count():
        assert number < 1200, "it does not end"
        speak(number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(0.05), process.communicate()[0]
    raise AssertionError


@pytest.fixture
def file(tmp_path: Path) -> Path:
    place = tmp_path / "boat.toml"
    place.write_text(FILE.format(place=tmp_path))
    return place


def test_a_boat_that_does_not_run_has_its_ports_heard(file, tmp_path):
    gnss, compass = Player(tmp_path / "gnss"), Player(tmp_path / "compass")

    def speak(number: int) -> None:
        if number % 10 == 0:
            gnss.say(framed(GGA.format(number // 10 % 60)) + framed(RMC.format(number // 10 % 60)))
        compass.say(framed("HCHDG,88.4,,,1.4,W") + (b"$HCHDG,99.9*00\r\n" if number % 10 == 0 else b""))
        gnss.say(framed("SDDPT,7.5,0.3,"))

    code, told = sensors(str(file), "--for", "3", speak=speak)
    assert code == 0, told
    assert told.startswith("tried: no boat runs: its ports and buses are opened to listen\n")
    assert re.search(r"^nmea0183 +heading +compass:HC +0\.[0-9] s +087\.0 deg$", told, re.MULTILINE), told
    assert re.search(r"^nmea0183 +position +gnss:GN +0\.[0-9] s +38\.690700 N 9\.215300 W$", told, re.MULTILINE), told
    assert re.search(r"^nmea0183 +depth +gnss:SD +0\.[0-9] s$", told, re.MULTILINE), told
    assert re.search(r"^nmea0183 compass +0\.[0-9] s +HCHDG [0-9.]+$", told, re.MULTILINE), told
    assert re.search(r"^ +refused: wrong checksum [0-9.]+$", told, re.MULTILINE), told
    assert re.search(r"^nmea0183 lost +- +nothing\n +No such file or directory$", told, re.MULTILINE), told
    assert re.search(r"^depth_m +7\.500$", told, re.MULTILINE), told


def test_the_baud_rate_and_the_talkers_of_a_port_are_found(tmp_path):
    device = Player(tmp_path / "port")

    def speak(number: int) -> None:
        device.say(framed("HEHDT,88.4,T") + framed("TIROT,1.0,A") if device.baud() == termios.B9600 else b"\xf3\x81\x00\x99")

    code, told = sensors("--find", str(tmp_path / "port"), speak=speak)
    assert code == 0, told
    assert re.fullmatch(
        r"  4800 baud: [0-9]+ bytes, no sentence\n  9600 baud: [0-9]+ sentences a second\n"
        r"  HE: HEHDT [0-9.]+\n  TI: TIROT [0-9.]+\n"
        r"\nFor the vehicle's file, with a name of your own in place of NAME:\n\n"
        rf'\[nmea0183\.ports\.NAME\]\ndevice = "{tmp_path}/port"\nbaud = 9600\n',
        told,
    ), told


def test_a_port_that_another_program_reads_is_left_alone(tmp_path):
    _, port = os.openpty()
    code, told = sensors("--find", os.ttyname(port), speak=lambda _: None)
    assert code == 2
    assert f"(process {os.getpid()}) reads it" in told
    assert user_of(os.ttyname(port)) is None, "this program itself"
    code, told = sensors("--find", str(tmp_path / "none"), speak=lambda _: None)
    assert (code, "No such file" in told) == (2, True)


@pytest.mark.parametrize(("sign", "code"), [(1.0, 0), (-1.0, 1)])
def test_a_turn_to_starboard_must_be_told_as_one(file, tmp_path, sign, code):
    """The gyro is the right way up in both."""
    compass = Player(tmp_path / "compass")

    def speak(number: int) -> None:
        compass.say(framed(f"HCHDT,{(350.0 + sign * number) % 360.0:.1f},T") + framed("TIROT,1200.0,A"))

    ended, told = sensors(str(file), "--turn", speak=speak)
    assert ended == code, told
    assert ("the compass turns the right way" in told) is (sign > 0)
    assert ("the compass is upside down, or its sign is wrong" in told) is (sign < 0)
    assert "The rate of turn was +20.0 degrees a second: it has the right sign." in told


def test_no_turn_and_no_sensor_are_told_and_no_turn_to_port_is_called_right():
    assert judged(Turned(None, None)) == (False, ["No heading was heard."])
    assert "turn further, or the compass stands still" in judged(Turned(2.0, None))[1][0]
    assert judged(Turned(70.0, None))[0]
    right, words = judged(Turned(70.0, -8.0))
    assert (right, words[1]) == (False, "The rate of turn was -8.0 degrees a second: it must be positive.")


def test_of_a_boat_that_runs_no_port_is_opened(file, tmp_path):
    """Even if it does not answer: its bytes are its own."""
    settings = config.load(file)
    opened = listener(settings, SystemClock())
    assert isinstance(opened, Opened)
    opened.close()
    with socket.socket(socket.AF_UNIX) as boat:
        boat.bind(settings.console.socket)
        boat.listen(2)
        running = listener(settings, SystemClock())
        assert isinstance(running, Running)
        running.close()


def test_sensors_and_motors_on_one_dronecan_bus_are_told_apart():
    settings = config.load(ROOT / "etc/boats/float.toml")
    kinds = {"heading": {"node": 41, "age_s": 0.1}, "rate": {"node": None, "age_s": None}}
    iron = {"hard_iron_ut": [12.0, -30.0, 0.0], "soft_iron": [0.9, 1.1, 1.0, 0.0, 0.0, 0.0]}
    state = {
        **dict.fromkeys(("latitude_deg", "longitude_deg", "speed_mps", "course_deg", "turn_dps", "fix")),
        "heading_deg": 87.0,
        "measured": {},
        "source": "dronecan",
        "figures_s": 100.0,
        "dronecan": {"node": 10, "devices": {"20": {"uptime_s": 9, "health": 0}}, "errors": {}},
        "dronecan.sensors": {
            "kinds": kinds,
            "devices": {"20": {"health": 0, "age_s": 0.2}, "41": {"health": 1, "age_s": 0.3}},
            "compasses": {"41": {"flat": True, "calibration": iron}},
            "refused": {},
        },
    }

    class Asked:
        def ask(self, command: str) -> dict:
            return state

    told = Running(settings, Asked()).reports(0.0)
    lines = table(settings, Running.where, told, told)
    assert f"{'dronecan':10} {'heading':14} {'41':18}   0.1 s  087.0 deg" in lines
    assert f"{'dronecan 41':22} {'':18}   0.3 s  health 1" in lines
    words = "hard_iron_ut = [12.0, -30.0, 0.0], soft_iron = [0.9, 1.1, 1.0, 0.0, 0.0, 0.0]"
    assert f"{'':49}  compass 41 is taken to lie flat: {words}" in lines


def test_the_name_that_stays_is_preferred(tmp_path):
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "by-id").mkdir()
    (tmp_path / "by-id/usb-FTDI-port0").symlink_to(tmp_path / "ttyUSB0")
    assert named(str(tmp_path / "ttyUSB0"), tmp_path / "by-id") == str(tmp_path / "by-id/usb-FTDI-port0")
    assert named("/dev/ttyS7", tmp_path / "by-id") == "/dev/ttyS7"


def test_the_table_is_the_one_in_the_document():
    settings = config.load(ROOT / "etc/sensors.toml")
    place = math.radians(38.690672), math.radians(-9.215242)
    nmea2000 = {
        "kinds": {"position": [43, 0.2], "velocity": [43, 0.2], "heading": [204, 0.1], "rate": [204, 0.1], "time": [43, 0.4]},
        "sources": {"43": [0.2, 117, ""], "204": [0.1, 150, "c07891002fb34d62"]},
    }
    nmea0183 = {
        "kinds": {
            "position": {"talker": "gnss:GN", "age_s": 0.2},
            "heading": {"talker": None, "age_s": None},
            "depth": {"talker": "masthead:SD", "age_s": 0.4},
        },
        "talkers": {"gnss:GN": 0.2, "masthead:SD": 0.4, "masthead:WI": 0.6},
        "ports": {
            "gnss": {"heard": {"GPGGA": 35, "GPRMC": 35}, "refused": {"wrong checksum": 2}},
            "compass": {"heard": {}, "refused": {}},
            "masthead": {"heard": {"SDDPT": 7, "WIMWV": 7}, "refused": {}},
        },
    }
    old = {
        "nmea2000": {"sources": {"43": [0.1, 34, ""], "204": [0.1, 50, ""]}},
        "nmea0183": {"ports": {"gnss": {"heard": {"GPGGA": 10, "GPRMC": 10}}, "masthead": {"heard": {"SDDPT": 2, "WIMWV": 2}}}},
    }
    old["nmea0183"]["ports"]["gnss"]["refused"] = {}
    values = {
        ("nmea2000", "position"): place,
        ("nmea2000", "velocity"): (-1.07, 0.77),
        ("nmea2000", "heading"): (math.radians(148.3),),
        ("nmea2000", "rate"): (math.radians(2.8),),
    }
    troubles = {"compass": "No such file or directory"}
    figures = {"nmea2000": nmea2000, "nmea0183": nmea0183}
    now = SensorsTold(105.0, figures, troubles, values, {"depth_m": 12.04}, "nmea2000")
    lines = table(settings, Running.where, SensorsTold(100.0, old, {}, {}, {}), now)
    assert "\n".join(lines) in (ROOT / "docs/sensors.md").read_text(), "\n".join(lines)
