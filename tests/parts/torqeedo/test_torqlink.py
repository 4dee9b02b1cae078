"""Torqeedo motors with TorqLink: frames as others tell them, and all that drivers have in common, with a bus for each."""

import contextlib
import itertools
import os
from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.errors import ConfigError
from delfim.base.frames import extended, identifier
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket, accepts
from delfim.parts.torqeedo.sim import ReadyMotor
from delfim.parts.torqeedo.table import TorqlinkPort, TorqlinkTable
from delfim.parts.torqeedo.torqlink import HEARD, NEUTRAL_S, SETTLE_S, SILENT_S, Torqlinks, command, open_actuator
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.links import Links
from delfim.vehicle.state import NoLog, State, ThrusterReport
from tests.vehicle.played_devices import PlayedTorqlink
from tests.vehicle.test_drivers import AHEAD, NAMES, OFF, near, settings

ROOT = Path(__file__).parents[3]
STEP_S = 0.05
_names = itertools.count()


class Bench:
    """The driver and two played motors, of which port is mounted the wrong way round. Time goes on by `pass_time`."""

    def __init__(self, opened: contextlib.ExitStack) -> None:
        number = f"{os.getpid()}-{next(_names)}"
        ports = {name: TorqlinkPort(interface=f"canloop:torqlink-{name}-{number}") for name in NAMES}
        its = settings("torqlink", torqlink=TorqlinkTable(ports=ports))
        self.far = [opened.enter_context(open_bound(its.can, port.interface, (ANYTHING,))) for port in ports.values()]

        def bus(name: str, filters: tuple[CanAddress, ...]) -> CanSocket:
            return opened.enter_context(open_bound(its.can, name, filters))

        self.motors, self.state, self.now_s = (PlayedTorqlink(), PlayedTorqlink()), State(), 100.0
        self.driver: Torqlinks = open_actuator(its, Links(bus, lambda device, baud: pytest.fail("no line")))

    def say(self, data: bytes | None = None, which: int = 0) -> None:
        """A status of this motor, and its way to the state."""
        word, told = self.motors[which].status()
        self.far[which].sendto(told if data is None else data, CanAddress(extended(word)))
        self.driver.inputs[which].read(self.state, self.now_s)

    def efforts(self) -> tuple[float, float]:
        """After all that was sent has come."""
        for far, motor in zip(self.far, self.motors, strict=True):
            while (frame := far.receive()) is not None:
                motor.hear(frame.identifier, frame.data, self.now_s)
        starboard, port = (motor.effort(self.now_s) for motor in self.motors)
        return starboard, port

    def pass_time(self, seconds: float, silent: bool = False) -> tuple[float, float]:
        """Both motors say ten times a second whether they are ready, and the driver repeats its command."""
        for step in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            if step % 2 == 0 and not silent:
                self.say(which=0)
                self.say(which=1)
            self.driver.repeat(self.now_s)
            efforts = self.efforts()
        return efforts


@pytest.fixture
def bench() -> Iterator[Bench]:
    with contextlib.ExitStack() as opened:
        yield Bench(opened)


@pytest.fixture
def ready(bench: Bench) -> Bench:
    """Both motors have been ready for long enough."""
    bench.pass_time(SETTLE_S + 0.2)
    return bench


def test_frames_are_as_others_tell_them() -> None:
    told = [(f"{identifier(arb):08X}", data.hex()) for arb, data in command(125) + command(-250) + command(0)]
    assert told == [
        ("0CF003D0", "ff7dffffffffffff"),
        ("0CF005D0", "7effffffffffffff"),
        ("0CF003D0", "fffaffffffffffff"),
        ("0CF005D0", "7cffffffffffffff"),
        ("0CF003D0", "ff00ffffffffffff"),
        ("0CF005D0", "7dffffffffffffff"),
    ]


@given(st.integers(0, 0x1FFFFFFF))
def test_only_the_status_is_heard_whoever_sends_it(word: int) -> None:
    assert accepts(HEARD, extended(word)) is (word >> 8 & 0x3FFFF == 65299)


def test_motors_do_as_commanded_and_stop_whichever_way_they_are_mounted(ready: Bench) -> None:
    assert ready.driver.send(AHEAD, ready.now_s) == 0
    assert near(ready.efforts(), 0.5, 0.248)
    assert ready.driver.send(AHEAD._replace(thrust=(1.0, -1.0)), ready.now_s) == 0
    assert near(ready.efforts(), 1.0, 1.0)
    ready.driver.send(AHEAD._replace(run=False), ready.now_s)
    assert near(ready.efforts(), 0.0, 0.0)
    ready.driver.send(AHEAD, ready.now_s)
    ready.driver.stop()
    assert near(ready.efforts(), 0.0, 0.0)
    assert all(motor.stopped for motor in ready.motors)


def test_the_stop_of_a_driver_that_heard_nothing_stops_them(bench: Bench) -> None:
    """The supervisor's, after the runtime's own sent commands."""
    for motor in bench.motors:
        motor.hear(0x0CF003D0, bytes((255, 200, *[255] * 6)), bench.now_s)
        motor.hear(0x0CF005D0, bytes((126, *[255] * 7)), bench.now_s)
    assert near((bench.motors[0].effort(bench.now_s), bench.motors[1].effort(bench.now_s)), 0.8, 0.8)
    bench.driver.stop()
    assert near(bench.efforts(), 0.0, 0.0)


def test_repetitions_keep_them_running_and_silence_stops_them(ready: Bench) -> None:
    ready.driver.send(AHEAD, ready.now_s)
    assert near(ready.pass_time(5.0), 0.5, 0.248)
    ready.now_s += 0.6
    assert near(ready.efforts(), 0.0, 0.0)
    ready.driver.send(OFF, ready.now_s)
    assert near(ready.pass_time(0.2), 0.0, 0.0)


def test_between_ahead_and_astern_there_is_neutral_for_a_second(ready: Bench) -> None:
    astern = AHEAD._replace(thrust=(-1.0, -0.25))
    ready.driver.send(AHEAD, ready.now_s)
    ready.pass_time(1.0)
    changed_s = ready.now_s
    assert ready.driver.send(astern, ready.now_s) == 0
    assert near(ready.efforts(), 0.0, 0.248), "the other motor goes on"
    assert near(ready.pass_time(NEUTRAL_S - 0.1), 0.0, 0.248)
    assert near(ready.pass_time(0.2), -1.0, 0.248)
    assert [way for way, _ in ready.motors[0].turned] == [0, 1, 0, -1]
    assert ready.motors[0].turned[-1][1] - changed_s == pytest.approx(NEUTRAL_S, abs=STEP_S + 1e-6)
    ready.driver.send(AHEAD, ready.now_s)
    ready.driver.send(astern, ready.now_s)
    assert near(ready.efforts(), -1.0, 0.248), "a wish that was taken back at once costs nothing"


@given(st.lists(st.tuples(st.sampled_from((-1.0, -0.001, 0.0, 0.5)), st.sampled_from((0.0, 0.05, 0.4, 1.1))), max_size=30))
def test_no_order_of_commands_leads_from_one_way_to_the_other_at_once(told: list[tuple[float, float]]) -> None:
    with contextlib.ExitStack() as opened:
        bench = Bench(opened)
        bench.pass_time(SETTLE_S + 0.2)
        for part, after_s in told:
            bench.driver.send(AHEAD._replace(thrust=(part, part)), bench.now_s)
            bench.efforts()
            if after_s:
                bench.pass_time(after_s)
        for turned in (motor.turned for motor in bench.motors):
            assert all(way * after == 0 for (way, _), (after, _) in itertools.pairwise(turned))
            for (before, _), (_, at_s), (after, then_s) in zip(turned, turned[1:], turned[2:], strict=False):
                assert before * after >= 0 or then_s - at_s >= NEUTRAL_S - STEP_S - 1e-6


def test_a_motor_is_told_nothing_but_neutral_until_it_was_ready_for_two_seconds(bench: Bench) -> None:
    assert bench.driver.send(AHEAD, bench.now_s) == 2, "two commands that no motor gets"
    assert near(bench.efforts(), 0.0, 0.0)
    assert bench.driver.report() == dict.fromkeys(NAMES, "it does not say that it is ready")
    assert bench.state.thrusters == {}
    assert near(bench.pass_time(SETTLE_S - 0.2), 0.0, 0.0)
    assert bench.state.thrusters["port"].refuses == "it is ready again, and rests for 2 s"
    assert near(bench.pass_time(0.4), 0.5, 0.248)
    assert bench.state.thrusters["port"] == ThrusterReport(pytest.approx(bench.now_s, abs=0.11))
    assert bench.driver.report() == {}


@pytest.mark.parametrize("how", ["says so", "is silent"])
def test_a_motor_that_is_no_longer_ready_gets_neutral_and_two_seconds_afterwards(ready: Bench, how: str) -> None:
    ready.driver.send(AHEAD, ready.now_s)
    if how == "says so":
        ready.motors[0].ready = False
        ready.pass_time(0.1)
        assert ready.state.thrusters["starboard"].refuses == "it does not say that it is ready"
        assert not ready.state.thrusters["port"].refuses
        assert near(ready.efforts(), 0.0, 0.248)
        ready.motors[0].ready = True
    else:
        ready.pass_time(SILENT_S - 0.1, silent=True)
        assert near(ready.efforts(), 0.5, 0.248)
        ready.pass_time(0.2, silent=True)
    assert ready.motors[0].stopped
    assert ready.pass_time(SETTLE_S - 0.1)[0] == 0.0
    assert near(ready.pass_time(0.3), 0.5, 0.248)


def test_a_bus_that_takes_nothing_is_told_and_keeps_no_other_motor_from_its_stop(
    ready: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ready.driver.inputs[0], "input", Full())
    assert ready.driver.send(AHEAD, ready.now_s) == 2
    with pytest.raises(OSError, match="does not take the stop"):
        ready.driver.stop()
    assert ready.efforts()[1] == 0.0


class Full:
    """A bus whose queue is full."""

    def send_many(self, messages: list[tuple[int, bytes]]) -> int:
        return len(messages)


def test_noise_raises_nothing_reports_nothing_and_is_counted(bench: Bench) -> None:
    random = Random(16)
    for _ in range(200):
        bench.say(random.randbytes(random.randrange(5)))
    assert bench.state.counts["torqlink_malformed"] == 200
    assert bench.state.thrusters == {}


def loaded(*values: str) -> config.Vehicle:
    rows = ", ".join(
        f'{{name="{name}", driver="torqlink", address={at}, y_m={0.5 - at}, thrust_n=[-50.0, 50.0]}}'
        for at, name in enumerate(NAMES)
    )
    return config.load(ROOT / "etc/delfimx.toml", [f"thrusters=[{rows}]", 'sysstat.required=["gps"]', *values])


def test_each_motor_has_a_bus_of_its_own_which_nobody_else_shares() -> None:
    ports = [f'torqlink.ports.{name}.interface="can{at + 1}"' for at, name in enumerate(NAMES)]
    vehicle = loaded(*ports)
    assert vehicle.bit_rates == {"can0": 500_000, "can1": 250_000, "can2": 250_000}
    assert vehicle.closed_buses == ("can1", "can2")
    with pytest.raises(ConfigError, match=r"port needs a bus: a table \[torqlink.ports.port\] with its interface"):
        loaded(ports[0])
    with pytest.raises(ConfigError, match="starboard and port have one bus, can1: both would obey each command"):
        loaded(ports[0], 'torqlink.ports.port.interface="can1"')
    with pytest.raises(ConfigError, match=r"can0 carries DSOR \(can.interface\) already, and this is torqlink"):
        loaded(ports[0], 'torqlink.ports.port.interface="can0"')


def boat(*values: str) -> Lockstep:
    ports = [f'torqlink.ports.{name}.interface="can{at + 1}"' for at, name in enumerate(NAMES)]
    return Lockstep(loaded(*ports, *values), 1, lambda clock: NoLog())


def test_a_boat_is_driven_in_lock_step() -> None:
    run = boat()
    list(run.cycles(3.0))
    for _ in run.cycles(10.0):
        assert run.command(console.Manual(starboard=0.6, port=0.6)) is None
    assert run.nodes.model.surge_mps > 0.5
    assert not run.state.notices
    assert [run.state.thrusters[name].refuses for name in NAMES] == ["", ""]
    run.close()


def test_motors_that_were_never_heard_are_told_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ReadyMotor, "step", lambda motor, now_s, utc_ns: [])
    run = boat()
    list(run.cycles(3.0))
    for _ in run.cycles(8.0):
        run.command(console.Manual(starboard=0.6, port=0.6))
    assert any("propeller silent for" in each.reason for each in run.state.notices), run.state.notices
    run.close()
