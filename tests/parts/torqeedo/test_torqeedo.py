"""Torqeedo motors: frames as others tell them, any bytes at all, and all that drivers have in common, with a line for each."""

from collections import deque
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.errors import ConfigError
from delfim.lines.binaryframes import BinaryFrames
from delfim.parts.torqeedo import tqframes
from delfim.parts.torqeedo.driver import REPLY_S, STOP, Torqeedos, open_actuator
from delfim.parts.torqeedo.table import TorqeedoPort, TorqeedoTable
from delfim.parts.torqeedo.tqframes import FRAMING, TorqeedoParameters, TorqeedoStatus, crc8, framed, replied, unframed
from delfim.vehicle.links import Links
from delfim.vehicle.state import State, ThrusterReport
from tests.vehicle.played_devices import PlayedTorqeedo
from tests.vehicle.test_drivers import AHEAD, NAMES, OFF, Wire, near, settings

ROOT = Path(__file__).parents[3]
# As ArduPilot's AP_Torqeedo has them in its comments, from a tiller: +237, -84 with a byte turned over; and one of +500.
TOLD = ("ac00000500" + "00ed95ad", "ac00000500" + "ffae2c0cad", "ac00000500" + "01f450ad")


def fed(*pieces: bytes) -> list[bytes]:
    parser = BinaryFrames(FRAMING)
    return [frame for piece in pieces for frame in parser.feed(piece)]


@pytest.mark.parametrize("told", TOLD)
def test_frames_are_as_others_tell_them(told: str):
    data = bytes.fromhex(told)
    assert fed(data) == [data]
    assert framed(unframed(data)[:-1]) == data


def test_the_check_is_that_of_its_name():
    assert crc8(b"123456789") == 0xA1 == PlayedTorqeedo().crc(b"123456789")


@given(st.binary(min_size=2, max_size=34), st.integers(1, 40))
def test_a_frame_is_read_as_it_was_told(body: bytes, cut: int):
    data = framed(body)
    assert fed(b"\x01\xad" + data[:cut], data[cut:]) == [data]
    assert unframed(data)[:-1] == body


@given(st.lists(st.binary(max_size=60) | st.binary(min_size=2, max_size=20).map(framed), max_size=20))
def test_any_bytes_raise_nothing_and_little_is_kept(pieces: list[bytes]):
    bench = Bench()
    for piece in pieces:
        bench.wires[0].waiting.append(piece)
        bench.driver.inputs[0].read(State(), 1.0)
        assert len(bench.driver.inputs[0]._frames._rest) <= tqframes.FRAME_MAX


class Bench:
    """The driver and two played motors, of which port is mounted the wrong way round."""

    def __init__(self, **keys: int) -> None:
        ports = {name: TorqeedoPort(device=f"/dev/{name}") for name in NAMES}
        its = settings("torqeedo", torqeedo=TorqeedoTable(ports=ports, **keys))
        lines = {f"/dev/{name}": Wire() for name in NAMES}
        self.wires, self.motors, self.state = tuple(lines.values()), (PlayedTorqeedo(), PlayedTorqeedo()), State()
        self.driver: Torqeedos = open_actuator(its, Links(lambda *_: pytest.fail("no bus"), lambda device, baud: lines[device]))

    def pass_on(self, now_s: float) -> tuple[float, float]:
        """The efforts after all that was written has come, and the answers were read."""
        for wire, motor, its in zip(self.wires, self.motors, self.driver.inputs, strict=True):
            for data in wire.written:
                wire.waiting.append(motor.hear(data, now_s))
            wire.written.clear()
            its.read(self.state, now_s)
            assert motor.refused == 0
        starboard, port = (motor.effort(now_s) for motor in self.motors)
        return starboard, port


def test_motors_do_as_commanded_and_stop_whichever_way_they_are_mounted():
    bench = Bench()
    assert bench.driver.send(AHEAD, 1.0) == 0
    assert near(bench.pass_on(1.0), 0.5, 0.25)
    assert bench.driver.send(AHEAD._replace(thrust=(-1.0, 0.0)), 1.2) == 0
    assert near(bench.pass_on(1.2), -1.0, 0.0)
    bench.driver.send(AHEAD, 1.3)
    bench.driver.send(AHEAD._replace(run=False), 1.31)
    assert near(bench.pass_on(1.31), 0.0, 0.0), "a stop waits for nothing"
    bench.driver.send(AHEAD, 1.4)
    bench.driver.stop()
    assert near(bench.pass_on(1.4), 0.0, 0.0)


def test_the_stop_of_a_driver_that_sent_nothing_stops_them_and_silence_does():
    bench = Bench()
    bench.driver.stop()
    assert [wire.written for wire in bench.wires] == [[STOP], [STOP]]
    bench.driver.send(AHEAD, 1.0)
    assert near(bench.pass_on(1.0), 0.5, 0.25)
    assert near(bench.pass_on(1.6), 0.0, 0.0)


def test_repetitions_keep_them_running_and_tell_all_that_they_say():
    bench = Bench()
    bench.driver.send(AHEAD, 1.0)
    for step in range(1, 41):
        assert bench.driver.repeat(1.0 + 0.05 * step) == 0
        assert near(bench.pass_on(1.0 + 0.05 * step), 0.5, 0.25)
    assert bench.state.thrusters["starboard"] == ThrusterReport(pytest.approx(3.0, abs=0.11), 750.0, 5.5, 24.1, 31.4)
    assert bench.state.thrusters["port"].rpm == pytest.approx(-375.0), "as mounted the right way"
    told = bench.motors[0].told
    assert (told.count(0x82), told.count(0x01), told.count(0x03)) == (21, 10, 10)
    bench.driver.send(OFF, 4.0)
    for step in range(3):
        bench.driver.repeat(4.05 + 0.05 * step)
    assert near(bench.pass_on(4.2), 0.0, 0.0)


def test_nothing_but_a_stop_is_said_while_an_answer_may_be_under_way():
    bench = Bench()
    bench.driver.repeat(1.0)
    assert bench.driver.send(AHEAD, 1.0 + 0.5 * REPLY_S) == 0
    assert len(bench.wires[0].written) == 1
    bench.driver.repeat(1.05)
    bench.driver.repeat(1.10)
    assert near(bench.pass_on(1.10), 0.5, 0.25)


def test_what_went_wrong_is_told_in_words_and_forgotten_at_rest_alone():
    bench = Bench()
    bench.motors[0].errors, bench.motors[0].status = 0b100_0000_0010, 0x04
    bench.driver.send(AHEAD, 1.0)
    for step in range(1, 9):
        bench.driver.repeat(1.0 + 0.05 * step)
        bench.pass_on(1.0 + 0.05 * step)
    told = bench.state.thrusters["starboard"]
    assert told.faults == ("the propeller is blocked", "tilted out of the water")
    assert told.refuses == "its emergency stop is pulled"
    bench.motors[0].status = 0
    bench.driver.send(OFF, 2.0)
    for step in range(1, 9):
        bench.driver.repeat(2.0 + 0.05 * step)
        bench.pass_on(2.0 + 0.05 * step)
    assert bench.state.thrusters["starboard"].faults is None
    assert bench.state.thrusters["starboard"].refuses == ""


def test_a_line_that_takes_nothing_is_told_and_keeps_no_other_motor_from_its_stop():
    bench = Bench()
    bench.wires[0].is_full = True
    assert bench.driver.send(AHEAD, 1.0) == 1
    with pytest.raises(OSError, match="does not take the stop"):
        bench.driver.stop()
    assert bench.wires[1].written[-1] == STOP


def test_noise_raises_nothing_reports_nothing_and_is_counted():
    bench, chance = Bench(), Random(3)
    for _ in range(300):
        bench.wires[0].waiting = deque([b"\xac" + chance.randbytes(chance.randrange(1, 50)) + b"\xad"])
        bench.driver.inputs[0].read(bench.state, 1.0)
    bench.wires[1].waiting.append(framed(b"\0\0abcd"))
    bench.driver.inputs[1].read(bench.state, 1.0)
    assert bench.state.counts["torqeedo_malformed"] > 200
    assert bench.state.thrusters == {}


def test_a_motor_takes_no_more_power_than_the_file_says():
    bench = Bench(power_percent=60)
    bench.driver.send(AHEAD, 1.0)
    assert unframed(bench.wires[0].written[0])[3] == 60


def test_a_reply_tells_what_it_is_by_its_length():
    assert replied(framed(b"\0\0" + bytes((0x04, 0x01, 0x02)))) == TorqeedoStatus(True, 0x0102)
    data = bytes.fromhex("fa24 0084 096a 0037 00fa 013a".replace(" ", ""))
    assert replied(framed(b"\0\0" + data)) == TorqeedoParameters(-1500, 24.1, 5.5, 31.4)
    assert replied(framed(b"\0\0")) is None
    assert replied(framed(b"\x14\x01")) is None


def test_a_motor_without_a_line_is_refused():
    rows = 'thrusters=[{name="stern", driver="torqeedo", address=0, thrust_n=[-50.0, 50.0]}]'
    with pytest.raises(
        ConfigError, match=r"torqeedo.ports: stern needs a line: a table \[torqeedo.ports.stern\] with its device"
    ):
        config.load(ROOT / "etc/delfimx.toml", [rows, 'sysstat.required=["gps"]'])
