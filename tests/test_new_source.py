"""A new source of navigation on a serial line: one file, one row, and its table. It drives the boat like any other."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from delfim.console.link import Link
from delfim.errors import DelfimError
from tests.afloat import running
from tests.enlarged import ROOT, Enlarged

COMPASS = '''"""A satellite compass: a line of text a message, latitude and longitude and heading in rad, a number."""

from delfim import config
from delfim.messages import Navigation
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.navigation import Fix
from delfim.vehicle.state import State


class Compass:
    name = "compass"

    def __init__(self, line: ReadableLine, state: State) -> None:
        self.input, self._state = line, state
        self.heard_s, self._rest = -1e9, b""

    def read(self, now_s: float) -> Fix | None:
        *lines, self._rest = (self._rest + self.input.read()).split(b"\\n")
        fix = None
        for line in lines:
            try:
                latitude, longitude, heading, number = map(float, line.split())
            except ValueError:
                self._state.count("compass_malformed")
                continue
            self.heard_s = now_s
            said = Navigation(0, latitude, longitude, 0.0, 0.0, heading, 0.0, 0.0, 0.0, 3, 9, 0.9, int(number) & 255)
            fix = Fix(said, self.input.t_ns, now_s)
        return fix

    def report(self, now_s: float) -> dict[str, object]:
        return {}


def open_source(settings: config.Vehicle, links: Links, state: State) -> Compass:
    return Compass(links.line(settings.compass.device, settings.compass.baud), state)
'''
TABLE = '''class Compass(Table, frozen=True):
    """A satellite compass on a serial line."""

    device: str = "/dev/ttyUSB0"  # its serial port
    baud: Annotated[int, msgspec.Meta(ge=1200, le=4_000_000)] = 115_200  # of the port


'''


class Instrument:
    """What hangs on the other end of the line, and an operator who looks."""

    def __init__(self, device: Path, command: Path) -> None:
        self.end, self._port = os.openpty()
        device.symlink_to(os.ttyname(self._port))
        self._command, self.said = command, 0

    def state(self, command: str = "state", **words: object) -> dict[str, Any]:
        with Link(self._command, 60.0) as link:
            return link.ask(command, **words)

    def speak(self, until: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """A message a look at the state, until it is as wanted; by the way something that makes no sense."""
        while True:
            self.said += 1
            os.write(self.end, b"%.9f -0.16 0.%02d %d\n" % (0.675 + 1e-9 * self.said, self.said % 10, self.said))
            try:
                state = self.state()
            except DelfimError:  # it does not run yet
                continue
            if until(state):
                return state

    def asked(self, command: str, **words: object) -> None:
        """Speaks until the command is carried out."""

        def accepted(_: dict[str, Any]) -> bool:
            try:
                self.state(command, **words)
            except DelfimError:
                return False
            return True

        self.speak(accepted)


@pytest.fixture
def enlarged(tmp_path: Path) -> Enlarged:
    copy = Enlarged(tmp_path / "copy")
    copy.file("delfim/vehicle/sources/compass.py", COMPASS)
    copy.row("delfim/config.py", '"mavlink_front_seat"]  # files in delfim/vehicle/sources', '"compass", ')
    copy.row("delfim/config.py", "class Vehicle(Table, frozen=True):", TABLE)
    copy.row("delfim/config.py", "    nmea2000: Nmea2000 = Nmea2000()", "    compass: Compass = Compass()\n")
    return copy


def test_a_new_source_on_a_serial_line_drives_the_boat_and_its_log_is_repeated(tmp_path, enlarged):
    device = tmp_path / "gnss"
    values = ('navigation.sources=["compass"]', f'compass.device="{device}"', "mavlink.enabled=false")
    compass = Instrument(device, tmp_path / "command")
    with running(tmp_path, 14550, *values, package=enlarged.place):
        compass.asked("heading", heading_deg=90.0, speed_mps=1.0)
        state = compass.speak(lambda state: state["run"] and state["thrusters"]["starboard"]["thrust"])
        assert state["source"] == "compass"
        assert state["age_s"]["navigation"] < 1.0
        assert next(line for line in state["checks"] if line["name"] == "navigation")["reason"].startswith("compass, ")
        assert state["-".join(("", *device.parts[1:]))]["trouble"] == "", "the line shows how it fares, by the name of its log"
        os.write(compass.end, b"nonsense\n")
        compass.speak(lambda state: state["counts"].get("compass_malformed"))
        while (state := compass.state())["mode"] != "idle":  # it says nothing any more
            assert state["age_s"]["navigation"] < 60.0
        assert "navigation silent" in state["reason"]
    told = enlarged.told("log", "replay", str(tmp_path / "log"))
    assert "all the same, bit by bit" in told, told
    assert int(told.split()[0]) > 3, "cycles"


def test_a_serial_line_has_one_reader(tmp_path, enlarged):
    values = ("can.interface='canloop:x'", "navigation.sources=['compass']", "compass.device='/dev/ttyUSB0'")
    words = [word for value in (*values, "slipd.device='/dev/ttyUSB0'") for word in ("--set", value)]
    command = [sys.executable, "-m", "delfim", "check", str(ROOT / "etc/delfimx.toml"), *words]
    refused = subprocess.run(command, env=enlarged.env, capture_output=True, text=True, timeout=120)
    assert refused.returncode, refused.stdout
    assert "compass.device: /dev/ttyUSB0 is read by slipd.device already" in refused.stderr, refused.stderr


def test_a_line_that_was_lost_is_taken_up_again(tmp_path, enlarged):
    device = tmp_path / "gnss"
    values = ('navigation.sources=["compass"]', f'compass.device="{device}"', "mavlink.enabled=false")
    compass = Instrument(device, tmp_path / "command")
    with running(tmp_path, 14550, *values, package=enlarged.place):
        before = compass.speak(lambda state: state["cycle"] > 2)
        for end in (compass.end, compass._port):
            os.close(end)
        device.unlink()
        name = "-".join(("", *device.parts[1:]))
        while not compass.state()[name]["trouble"]:
            pass
        again = Instrument(device, tmp_path / "command")
        again.said = compass.said
        again.speak(lambda state: state["cycle"] > before["cycle"] + 2 and not state[name]["trouble"])
