"""The telemetry of ESCs on their wires: frames as others tell them, noise, silence, and what becomes of it in the driver."""

import itertools
import struct
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.errors import ConfigError, DelfimError
from delfim.base.pulses import PulseAnswer, pack_answer
from delfim.parts.pwm.driver import Pulses, open_actuator
from delfim.parts.pwm.table import Pwm, PwmTelemetry
from delfim.parts.pwm.telemetry import BAUD, EscReport, EscTelemetry, crc8
from delfim.simulator.workspace import Workspace, settings_of
from delfim.vehicle.links import Links
from delfim.vehicle.state import State, ThrusterReport
from tests.vehicle.test_drivers import AHEAD, NAMES, OFF, Wire, settings

ROOT = Path(__file__).parents[3]


def told(rpm: float = 1500.0, volts: float = 15.2, amperes: float = 4.5, celsius: int = 31) -> bytes:
    """A frame, its sum by long division: the polynomial 0x107."""
    body = struct.pack(">bHHHH", celsius, round(100 * volts), round(100 * amperes), 321, round(rpm * 7 / 100))
    value = int.from_bytes(body, "big") << 8
    for bit in range(value.bit_length() - 1, 7, -1):
        if value >> bit & 1:
            value ^= 0x107 << bit - 8
    return body + bytes((value,))


def heard(*pieces: bytes) -> tuple[EscReport | None, int]:
    """What an ESC told with these bytes, and how much of them was nothing."""
    wire, state = Wire(), State()
    telemetry = EscTelemetry(wire, 7)
    for piece in pieces:
        wire.waiting.append(piece)
        telemetry.read(state, 1.0)
    return telemetry.told(1.0)[0], state.counts.get("esc_malformed", 0)


def test_the_check_is_that_of_its_name():
    assert crc8(b"123456789") == 0xF4


def test_a_frame_is_read_as_it_was_told():
    assert told() == bytes.fromhex("1f 05f0 01c2 0141 0069") + told()[-1:]
    assert heard(told(), told()) == (EscReport(1500.0, 4.5, 15.2, 31.0), 0)
    assert heard(told(), told(celsius=-5, rpm=0))[0] == EscReport(0.0, 4.5, 15.2, -5.0)


@given(st.integers(1, 19), st.integers(0, 9))
def test_frames_are_found_wherever_the_first_read_begins_and_ends(cut: int, late: int):
    data = told(rpm=600) + told(rpm=600) + told(rpm=600)
    assert heard(data[late:cut], data[max(late, cut) :])[0] == EscReport(600.0, 4.5, 15.2, 31.0)


def test_one_frame_alone_and_zeros_are_nothing():
    """Any ten bytes are a frame by chance, one of 256."""
    assert heard(told())[0] is None
    assert heard(bytes(400))[0] is None
    assert heard(told(), b"\x01" + told())[0] is None


@given(st.lists(st.binary(max_size=60), max_size=20))
def test_any_bytes_raise_nothing_and_little_is_kept(pieces: list[bytes]):
    wire = Wire()
    telemetry = EscTelemetry(wire, 7)
    for piece in pieces:
        wire.waiting.append(piece)
        telemetry.read(State(), 1.0)
        assert len(telemetry._frames._rest) < 10


def test_of_noise_few_frames_are_believed():
    random = Random(7)
    wire, state, believed = Wire(), State(), 0
    telemetry = EscTelemetry(wire, 7)
    for second in range(1000):
        wire.waiting.append(random.randbytes(100))
        telemetry.read(state, float(second))
        believed += telemetry.told(float(second))[0] is not None and telemetry._heard_s == second
    assert believed < 10, "of 100,000 bytes"
    assert state.counts["esc_malformed"] > 90_000


class Bench:
    """The driver, its outlet, and two ESCs with a wire each; port is mounted the wrong way round."""

    def __init__(self, lacks: str = "") -> None:
        wires = {name: PwmTelemetry(device=f"/dev/{name}") for name in NAMES}
        self.lines = {f"/dev/{name}": Wire() for name in NAMES}
        self.outlet, self.state = Wire(), State()

        def line(device: str, baud: int) -> Wire:
            if device == lacks:
                raise DelfimError(f"{device}: No such file or directory")
            if device in self.lines:
                assert baud == BAUD
                return self.lines[device]
            return self.outlet

        links = Links(lambda *_: pytest.fail("no bus"), line)
        self.driver: Pulses = open_actuator(settings("pwm", pwm=Pwm(telemetry=wires)), links)

    def pass_on(self, now_s: float, *, starboard: bytes = b"", port: bytes = b"", trouble: str = "") -> None:
        """What the ESCs say, and an answer of the outlet."""
        for name, data in (("starboard", starboard), ("port", port)):
            self.lines[f"/dev/{name}"].waiting.append(data)
        self.outlet.waiting.append(pack_answer(PulseAnswer(1, "running", trouble)))
        for each in reversed(self.driver.inputs):
            each.read(self.state, now_s)


def test_what_an_esc_tells_is_its_thrusters_with_the_sign_of_the_last_command():
    bench = Bench()
    bench.driver.send(AHEAD, 1.0)
    bench.pass_on(1.0, starboard=2 * told(), port=2 * told(rpm=300))
    assert bench.state.thrusters["starboard"] == ThrusterReport(1.0, 1500.0, 4.5, 15.2, 31.0)
    assert bench.state.thrusters["port"].rpm == -300.0, "as commanded, whichever way it is mounted"
    bench.driver.send(OFF, 1.1)
    bench.pass_on(1.1, starboard=told(rpm=900), port=told(rpm=100))
    assert [bench.state.thrusters[name].rpm for name in NAMES] == [900.0, -100.0], "it runs out"


def test_the_silence_of_an_esc_is_told_and_is_none_of_the_outlet():
    bench = Bench()
    bench.pass_on(1.0, starboard=2 * told())
    assert bench.state.thrusters["port"] == ThrusterReport(1.0, faults=("its ESC has told nothing yet",))
    bench.pass_on(2.5, trouble="Remote I/O error")
    fault = "its ESC has told nothing for 2 s"
    assert bench.state.thrusters["starboard"] == ThrusterReport(
        2.5, faults=("Remote I/O error", fault), refuses="Remote I/O error"
    )


def test_an_esc_that_tells_does_not_hide_an_outlet_that_is_silent():
    bench = Bench()
    bench.pass_on(1.0, starboard=2 * told())
    for tenths in itertools.islice(itertools.count(11), 30):
        bench.lines["/dev/starboard"].waiting.append(told())
        for each in bench.driver.inputs:
            each.read(bench.state, tenths / 10)
    assert bench.state.thrusters["starboard"].heard_s == 1.0


def test_a_wire_that_is_not_there_keeps_no_motor_from_its_commands():
    bench = Bench("/dev/port")
    assert bench.driver.send(AHEAD, 1.0) == 0
    bench.driver.stop()
    bench.pass_on(1.0, starboard=2 * told())
    assert bench.state.thrusters["starboard"].rpm == 1500.0
    why = "its ESC's telemetry, until the next start: /dev/port: No such file or directory"
    assert bench.state.thrusters["port"].faults == (why,)


def test_the_telemetry_of_a_thruster_that_is_not_there_is_refused():
    rows = 'thrusters=[{name="stern", driver="pwm", address=0, thrust_n=[-50.0, 50.0], y_m=1.0}]'
    with pytest.raises(ConfigError, match=r"pwm.telemetry: bow is no thruster that is told by pulses"):
        config.load(ROOT / "etc/delfimx.toml", [rows, 'sysstat.required=["gps"]', 'pwm.telemetry.bow.device="/dev/ttyS1"'])


def test_a_simulation_leaves_the_real_wires_alone(tmp_path: Path):
    row = 'name="stern", driver="pwm", x_m=-1.0, thrust_n=[-50.0, 50.0], steer={kind="rudder", address=1}'
    rows = f"thrusters=[{{{row}}}]"
    wires = ('sysstat.required=["gps"]', 'pwm.telemetry.stern.device="/dev/ttyS1"')
    vehicle = config.load(ROOT / "etc/delfimx.toml", [rows, *wires])
    assert vehicle.outside("device")["pwm.telemetry.stern.device"] == "/dev/ttyS1"
    own = settings_of(vehicle, Workspace(1, tmp_path), ()).overrides
    assert config.load(ROOT / "etc/delfimx.toml", [rows, *wires, *own]).of(Pwm).telemetry == {}
