"""The rows of a laboratory's parts: what a vehicle's file may say of them, in the words that its other keys have."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from delfim import config
from delfim.base import parts
from delfim.base.errors import ConfigError
from delfim.base.frames import standard
from delfim.canproxy.socket import CanAddress
from delfim.console.terminal.describe import describe
from delfim.services.suite import services
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle.state import Actuation, NoLog, State
from tests.parts.laboratory import ROOT, installed, known, laboratory

__all__ = ["laboratory"]
DELFIMX = ROOT / "etc/delfimx.toml"
ALL = ("motor", "source", "sensor", "trouble", "service")


def load(*values: str) -> config.Vehicle:
    return config.load(DELFIMX, values)


def refused(*values: str) -> str:
    with pytest.raises(ConfigError) as error:
        load(*values)
    return str(error.value).removeprefix(f"{DELFIMX}: ")


def test_a_file_that_names_no_part_looks_for_none():
    """In a program of its own: what looks for packages is not even loaded."""
    words = "import sys; from delfim import config; kind = type(config.load('etc/delfimx.toml')); "
    told = subprocess.run(
        [sys.executable, "-c", words + "print(kind is config.Vehicle, 'importlib.metadata' in sys.modules)"],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout == "True False\n"


def test_each_motor_of_the_example_is_commanded_heard_and_stopped(laboratory):
    """Two of them are a boat: a driver that knows only its first row turns in a simulation, and in circles on the water."""
    installed(laboratory, "motor")
    from example_motor.driver import open_actuator

    rows = ", ".join(
        f'{{name="{name}", driver="example_motor", address={at}, y_m={y_m}, thrust_n=[-30, 50]}}'
        for name, at, y_m in (("port", 3, -0.2), ("starboard", 1, 0.2))
    )
    line = Spoken()
    motor = open_actuator(load('parts.example_motor="1.0"', f"thrusters=[{rows}]"), SimpleNamespace(line=lambda *_: line))
    assert motor.send(Actuation((0.25, -0.5), (0.0, 0.0), run=True), 0.0) == 0
    assert line.said() == ["thrust 3 0.250", "thrust 1 -0.500"]
    motor.stop()
    assert line.said() == ["thrust 3 0", "thrust 1 0"]
    state, line.heard = State(), b"1 900\n3 1200\n2 7\n"
    motor.read(state, 5.0)
    assert {name: told.rpm for name, told in state.thrusters.items()} == {"starboard": 900.0, "port": 1200.0}
    assert state.counts["example_motor_malformed"] == 1, "of a motor that the file does not have"


class Spoken:
    """A line that keeps what it is told."""

    def __init__(self) -> None:
        self.heard, self._told = b"", b""

    def read(self) -> bytes:
        return self.heard

    def write(self, data: bytes) -> bool:
        self._told += data
        return True

    def said(self) -> list[str]:
        lines, self._told = self._told.decode().split("\n"), b""
        return [line for line in lines if line]


def test_its_keys_are_those_of_the_file_and_are_checked_in_the_same_words(laboratory):
    installed(laboratory, *ALL)
    aboard = [f'parts.example_{kind}="1.0"' for kind in ALL]
    told = load(
        *aboard, "example_motor.most=0.5", "failsafe.few_satellites.hold='home'", "failsafe.few_satellites.satellites=6"
    )
    assert [part.name for part in told.aboard] == [f"example_{kind}" for kind in ALL]
    assert (told.example_motor.most, told.failsafe.few_satellites.hold) == (0.5, "home")
    assert isinstance(told, config.Vehicle)
    for value, words in (
        ("example_motor.most=7", "example_motor.most: 7 is not allowed (allowed: 0.0 to 1.0)"),
        ("example_motor.mots=0.5", "example_motor.mots: unknown key; did you mean most?"),
        (
            "failsafe.few_satellites.action='flee'",
            'failsafe.few_satellites.action: "flee" is not allowed (allowed: warn, hold, ',
        ),
        ("sensors.names=['example_sensr']", 'sensors.names[0]: "example_sensr" is not allowed (allowed: sysstat, dronecan, '),
    ):
        assert refused(*aboard, value).startswith(words)
    assert refused("example_motor.most=0.5").startswith("example_motor: unknown key")


def test_only_what_is_named_is_imported(laboratory):
    installed(laboratory, "sensor")
    known(laboratory, "trap", "trap:PART")
    (laboratory / "trap.py").write_text("raise SystemExit('imported because it is installed')")
    load('parts.example_sensor="1.0"')
    assert refused('parts.trap="1.0"') == "parts.trap: it cannot be imported: SystemExit: imported because it is installed"


@pytest.mark.parametrize(
    ("entry", "text", "words"),
    [
        ("odd:PART", "", "it cannot be imported: ModuleNotFoundError: No module named 'odd'"),
        ("odd:PART", "1 / 0", "it cannot be imported: ZeroDivisionError: division by zero"),
        ("odd:PART", "PART = 3", "odd:PART is no delfim.api.Part"),
        ("odd:PART", "from delfim.api import Part\nPART = Part('even')", "its row has another name, even"),
        (
            "odd:PART",
            "from delfim.api import Part\nPART = Part('odd', api=9)",
            "it was made for interface 9 of parts, and this",
        ),
        (
            "odd:PART",
            "from delfim.api import *\nPART = Part('odd', troubles=(TroubleRow('wet', 3, Trouble, 'odd:wet'),))",
            "trouble wet has number 3 (allowed: 29 to 30)",
        ),
    ],
)
def test_a_row_that_makes_no_sense_is_refused_by_name(laboratory, entry, text, words):
    known(laboratory, "odd", entry)
    if text:
        (laboratory / "odd.py").write_text(text)
    assert refused('parts.odd="1.0"').startswith(f"parts.odd: {words}")


def test_versions_twins_and_names_that_the_boat_has_itself(laboratory):
    installed(laboratory, "sensor")
    assert refused('parts.example_sensor="1.1"') == (
        "parts.example_sensor: version 1.0 is installed, and the file is made for 1.1"
    )
    assert refused('parts.exampel_sensor="1.0"').endswith("has a part of this name; did you mean example_sensor?")
    known(laboratory, "example_sensor", "example_sensor:PART", package="twin")
    parts.forget()
    assert refused('parts.example_sensor="1.0"').startswith("parts.example_sensor: example_sensor and twin both have a part")
    known(laboratory, "dsor", "dsor_of_ours:PART")
    (laboratory / "dsor_of_ours.py").write_text("from delfim.api import Part\nPART = Part('dsor')")
    parts.forget()
    assert refused('parts.dsor="1.0"') == "parts.dsor: dsor is a name of the boat's own; it needs another one"


def test_the_file_is_checked_against_what_a_driver_can_drive(laboratory):
    known(laboratory, "duo", "duo:PART")
    (laboratory / "duo.py").write_text(
        "from delfim.api import *\nclass Keys(Table, frozen=True):\n    interface: Interface = 'can1'\n"
        "PART = Part('duo', Keys, driver='duo', source='duo', protocol='NMEA 2000', drives=Drives(sides='mixed'))"
    )
    row = '{name="%s", driver="%s", address=%d, y_m=%g, thrust_n=[-10.0, 20.0]}'
    two = [f"thrusters=[{row % ('starboard', driver, 0, 1.0)}, {row % ('port', 'duo', 1, -1.0)}]" for driver in ("dsor", "duo")]
    assert "duo mixes two sides: it needs two thrusters, address 0 and 1" in refused('parts.duo="1.0"', two[0])
    beside = 'navigation.sources=["nmea2000"]'
    assert load('parts.duo="1.0"', two[1], beside).buses == ("can0", "can1")
    words = "can1 carries DroneCAN (dronecan.interface) already, and this is NMEA 2000"
    assert words in refused('parts.duo="1.0"', two[1], beside.replace("nmea2000", "dronecan"))


def test_two_troubles_with_one_number_are_refused(laboratory):
    installed(laboratory, "trouble")
    known(laboratory, "wet", "wet:PART")
    row = "from delfim.api import *\nPART = Part('wet', troubles=(TroubleRow('wet', 29, Trouble, 'wet:sees'),))"
    (laboratory / "wet.py").write_text(row)
    words = refused('parts.example_trouble="1.0"', 'parts.wet="1.0"')
    assert words == "parts.wet: its trouble wet has number 29, as few_satellites has"


def test_a_service_has_a_process_of_its_own_unless_the_file_says_otherwise(laboratory):
    installed(laboratory, "service")
    rows = {row.name: row for row in services(load('parts.example_service="1.0"'))}
    assert rows["example_service"].place == "process"
    assert list(rows)[-1] == "vehicle", "which starts last and is stopped first"
    inside = services(load('parts.example_service="1.0"', "services.example_service.place='runtime'"))
    assert {row.name: row.place for row in inside}["example_service"] == "runtime"


def test_the_page_of_a_files_keys_has_those_of_its_parts(laboratory):
    installed(laboratory, *ALL, "mode")
    tree = {"boat": {"name": "lab"}, "parts": {f"example_{kind}": "1.0" for kind in (*ALL, "mode")}}
    page = describe(config.kind_of(tree, "lab.toml"))
    for words in (
        "## `[example_motor]`\n\nA motor on a serial line.\n",
        "| `most` | `1.0` | 0.0 to 1.0 | of full thrust, at most |",
        "## `[failsafe.few_satellites]`\n\nFewer satellites than the boat shall sail by.\n",
        '| `weave` | `"same"` | same, warn, hold, back, home, stop | in weave mode; "same": as `action` |',
        "## `[[thrusters]]`\n\nA thruster: who drives it",
        "otter, pwm, torqeedo, torqlink, vesc, example_motor | who commands it |",
    ):
        assert words in page
    assert len(page) > len(describe())


def test_a_serial_line_has_one_reader(laboratory):
    installed(laboratory, "source")
    words = refused('parts.example_source="1.0"', "navigation.sources=['example_source']", "slipd.device='/dev/ttyUSB0'")
    assert words.startswith("example_source.device: /dev/ttyUSB0 is read by slipd.device already")


HORN = """
import math
from delfim.api import CanAddress, Frame, Part, standard

PART = Part("horn", played="horn")


class Horn:
    interface, hears, due_s, blown = "canloop:horn", (CanAddress(standard(0x160)),), math.inf, 0

    def feed(self, frame, now_s):
        self.blown += 1
        self.due_s = now_s

    def step(self, now_s, utc_ns):
        if now_s < self.due_s:
            return []
        self.due_s = math.inf
        return [Frame(standard(0x161), bytes([self.blown]))]


def devices_of(settings, model, seed):
    return Horn()
"""


def test_a_device_on_a_bus_hears_and_answers_in_simulation(laboratory):
    known(laboratory, "horn", "horn:PART")
    (laboratory / "horn.py").write_text(HORN)
    run = Lockstep(load('parts.horn="1.0"'), 1, lambda clock: NoLog())
    ear = run.buses["canloop:horn"].bound(CanAddress(standard(0x161)), computer="a test")
    for blown in (1, 2):
        ear.sendto(b"", CanAddress(standard(0x160)))
        for _ in run.cycles(1.0):
            pass
        assert [frame.data for frame in ear.receive_many()] == [bytes([blown])]
