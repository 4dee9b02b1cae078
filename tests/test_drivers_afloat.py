"""Each way to motors with the whole boat: commanded, limited, and stopped when the runtime hangs. The motors are played."""

import contextlib
import json
import os
import pty
import select
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

import pytest

from delfim import config
from delfim.base.errors import DelfimError
from delfim.base.frames import extended
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress
from delfim.parts.frontseats.table import OtterTable
from delfim.services.supervision.stop import PropellerStop
from delfim.vehicle.operator.link import Link
from tests.afloat import running
from tests.parts.pwm.test_esc_telemetry import told as esc_frame
from tests.parts.pwm.test_outlet import chip, pulse_us
from tests.vehicle.played_devices import PlayedPx4, PlayedSeat, PlayedTorqeedo, PlayedTorqlink, PlayedVesc

PATIENCE_S = 200.0
ROWS = ", ".join(
    f'{{name="{name}", driver="DRIVER", address={address}, y_m={y_m}, thrust_n=[-50.0, 50.0], rate_per_s=0.5, rpm_max=1500.0}}'
    for address, name, y_m in ((0, "starboard", 0.5), (1, "port", -0.5))
)


class Motors(Protocol):
    values: tuple[str, ...]  # of the vehicle's file

    def efforts(self) -> tuple[float, float]: ...  # starboard and port, now
    def stopped(self) -> bool: ...  # whether somebody told them so, and they did not only miss their commands


class VescMotors:
    def __init__(self, place: Path, opened: contextlib.ExitStack) -> None:
        name = f"canloop:vesc-{os.getpid()}-{place.name[-8:]}"
        self.values = (f'vesc.interface="{name}"',)
        self._bus = opened.enter_context(open_can(name))
        self._bus.bind(ANYTHING)
        self._played = (PlayedVesc(0), PlayedVesc(1))

    def efforts(self) -> tuple[float, float]:
        while (frame := self._bus.receive()) is not None:
            for each in self._played:
                each.hear(frame.identifier, frame.data, time.monotonic())
        starboard, port = (each.effort(time.monotonic()) for each in self._played)
        return starboard, port

    def stopped(self) -> bool:
        return self.efforts() == (0.0, 0.0) and all(time.monotonic() - each.heard_s < each.timeout_s for each in self._played)


class SeatMotors:
    """A server as the boat's own computer is one. It takes two connections: the runtime's, and the supervisor's."""

    def __init__(self, name: str, opened: contextlib.ExitStack, stop: str = "") -> None:
        self._server = opened.enter_context(socket.create_server(("127.0.0.1", 0)))
        self.values = (f'{name}.device="tcp:127.0.0.1:{self._server.getsockname()[1]}"',)
        self._opened, self.present, self._stop = opened, list[socket.socket](), stop
        self._seat: PlayedSeat | PlayedPx4 = PlayedSeat(3.0)
        self.connections = 0

    def efforts(self) -> tuple[float, float]:
        readable, _, _ = select.select([self._server, *self.present], [], [], 0.01)
        for each in readable:
            if each is self._server:
                self.connections += 1
                self.present.append(self._opened.enter_context(self._server.accept()[0]))
                continue
            try:
                data = each.recv(4096)
            except ConnectionResetError:  # it left without reading what it was told
                data = b""
            if data:
                self._seat.hear(data, time.monotonic())
                each.sendall(self._seat.report(time.monotonic()))
            else:
                self.present.remove(each)
        return self._seat.efforts(time.monotonic())

    def stopped(self) -> bool:
        self.efforts()
        assert isinstance(self._seat, PlayedSeat)
        return self._seat.said[-1:] == [self._stop] and self.efforts() == (0.0, 0.0)


class BoardMotors(SeatMotors):
    """A board with PX4, which waits for its commands longer than the dead-man does."""

    def __init__(self, opened: contextlib.ExitStack) -> None:
        super().__init__("mavlink_front_seat", opened)
        self._seat = self._px4 = PlayedPx4(timeout_s=30.0)
        self.values += ('mavlink_front_seat.autopilot="px4"',)

    def stopped(self) -> bool:
        self.efforts()
        return not self._px4.armed


class TorqeedoMotors:
    """Two motors, each behind a converter of its line to the network."""

    def __init__(self, opened: contextlib.ExitStack) -> None:
        self._opened, names = opened, ("starboard", "port")
        self._servers = {opened.enter_context(socket.create_server(("127.0.0.1", 0))): PlayedTorqeedo() for _ in names}
        ports = (server.getsockname()[1] for server in self._servers)
        self.values = tuple(
            f'torqeedo.ports.{name}.device="tcp:127.0.0.1:{port}"' for name, port in zip(names, ports, strict=True)
        )
        self._present = dict[socket.socket, PlayedTorqeedo]()

    def efforts(self) -> tuple[float, float]:
        readable, _, _ = select.select([*self._servers, *self._present], [], [], 0.01)
        for each in readable:
            if each in self._servers:
                self._present[self._opened.enter_context(each.accept()[0])] = self._servers[each]
                continue
            with contextlib.suppress(ConnectionError):
                if data := each.recv(4096):
                    each.sendall(self._present[each].hear(data, time.monotonic()))
                    continue
            del self._present[each]
        starboard, port = (each.effort(time.monotonic()) for each in self._servers.values())
        return starboard, port

    def stopped(self) -> bool:
        return self.efforts() == (0.0, 0.0) and all(each.stopped for each in self._servers.values())


class TorqlinkMotors:
    """Two motors, each on a bus of its own, which say ten times a second that they are ready, however busy the test is."""

    def __init__(self, place: Path, opened: contextlib.ExitStack) -> None:
        buses = {name: f"canloop:tq-{name[0]}-{os.getpid()}-{place.name[-8:]}" for name in ("starboard", "port")}
        self.values = tuple(f'torqlink.ports.{name}.interface="{bus}"' for name, bus in buses.items())
        self._played = {opened.enter_context(open_can(bus)): PlayedTorqlink() for bus in buses.values()}
        for bus in self._played:
            bus.bind(ANYTHING)
        ended = threading.Event()
        speaking = threading.Thread(target=self._say, args=(ended,))
        speaking.start()
        opened.callback(speaking.join)
        opened.callback(ended.set)

    def _say(self, ended: threading.Event) -> None:
        while not ended.wait(0.1):
            for bus, motor in self._played.items():
                word, data = motor.status()
                bus.sendto(data, CanAddress(extended(word)))

    def efforts(self) -> tuple[float, float]:
        for bus, motor in self._played.items():
            while (frame := bus.receive()) is not None:
                motor.hear(frame.identifier, frame.data, time.monotonic())
        starboard, port = (motor.effort(time.monotonic()) for motor in self._played.values())
        return starboard, port

    def stopped(self) -> bool:
        return self.efforts() == (0.0, 0.0) and all(
            motor.stopped and time.monotonic() - motor.heard_s < motor.timeout_s for motor in self._played.values()
        )


class PwmMotors:
    def __init__(self, place: Path) -> None:
        self.place = chip(place / "pwmchip0", 0, 1)
        self.values = (f'pwm.chip="{self.place}"', "pwm.arm_s=0.2")

    def efforts(self) -> tuple[float, float]:
        starboard, port = ((pulse_us(self.place, each) - 1500) / 400 for each in (0, 1))
        return (0.0, 0.0) if starboard < -1.0 else (starboard, port)  # no pulses yet

    def stopped(self) -> bool:
        return self.efforts() == (0.0, 0.0)


MOTORS: dict[str, Callable[[Path, contextlib.ExitStack], Motors]] = {
    "vesc": VescMotors,
    "otter": lambda place, opened: SeatMotors("otter", opened, "PMARABT"),
    "heron": lambda place, opened: SeatMotors("heron", opened, "PYDIR"),
    "mavlink_front_seat": lambda place, opened: BoardMotors(opened),
    "pwm": lambda place, opened: PwmMotors(place),
    "torqeedo": lambda place, opened: TorqeedoMotors(opened),
    "torqlink": TorqlinkMotors,
}


@contextlib.contextmanager
def afloat(tmp_path: Path, driver: str, *more: str) -> Iterator[tuple[Motors, Path]]:
    with contextlib.ExitStack() as opened:
        motors = MOTORS[driver](tmp_path, opened)
        values = (
            f"thrusters=[{ROWS.replace('DRIVER', driver)}]",
            'sysstat.required=["gps"]',
            "mavlink.enabled=false",
            "simulation.motors=false",
            "supervisor.deadman_s=1.0",
            *motors.values,
            *more,
        )
        yield motors, opened.enter_context(running(tmp_path, 14550, *values))


def sailed(motors: Motors, command: Path, *, until: tuple[float, float]) -> list[tuple[float, float]]:
    """The efforts on the way to full ahead and full astern."""
    seen, deadline_s = [motors.efforts()], time.monotonic() + PATIENCE_S
    while seen[-1] != pytest.approx(until, abs=0.01):
        assert time.monotonic() < deadline_s, seen[-1]
        with contextlib.suppress(DelfimError), Link(command, PATIENCE_S) as link:  # it does not run yet, or is not fit yet
            link.ask("manual", starboard=until[0], port=until[1])
        seen.append(motors.efforts())
    return seen


def missed(command: Path) -> int:
    """Commands that no driver's link took, since the start."""
    with Link(command, PATIENCE_S) as link:
        return int(link.ask("state")["counts"].get("propulsion_unsent", 0))


def sailed_mps(command: Path) -> float:
    """The boat's speed, while it is driven ahead by hand."""
    with Link(command, PATIENCE_S) as link:
        return float(link.ask("manual", starboard=0.5, port=0.5)["speed_mps"] or 0.0)


def process(tmp_path: Path, name: str) -> int:
    return int(json.loads((tmp_path / "supervisor.json").read_text())["programs"][name]["pid"])


@pytest.mark.long
def test_a_boat_sails_by_the_position_and_heading_of_its_board(tmp_path: Path) -> None:
    """On a serial port, in real time; the board is played by `delfim nodes`."""
    values = (
        'navigation.sources=["mavlink_front_seat"]',
        f'mavlink_front_seat.device="{tmp_path}/board"',
        "mavlink.enabled=false",
    )
    with running(tmp_path, 14550, *values) as command:
        deadline_s, state = time.monotonic() + PATIENCE_S, dict[str, Any]()
        while not (state.get("mode") == "course" and (state["speed_mps"] or 0.0) > 0.5):
            assert time.monotonic() < deadline_s, state
            with contextlib.suppress(DelfimError), Link(command, PATIENCE_S) as link:  # it does not run yet, or is not fit yet
                state = link.ask("state")
                if state["mode"] == "idle":
                    link.ask("course", course_deg=90.0, speed_mps=1.0)
        told = state["mavlink_front_seat"]
        assert (state["source"], state["fix"], told["receiver"]["fix"]) == ("mavlink_front_seat", 3, 3)
        assert abs(state["utc_ns"] - time.time_ns()) < 60e9
        assert state["age_s"]["navigation"] < 1.0


@pytest.mark.long
@pytest.mark.parametrize("driver", MOTORS)
def test_motors_are_commanded_and_limited_and_stopped_by_the_dead_man(tmp_path: Path, driver: str) -> None:
    with afloat(tmp_path, driver) as (motors, command):
        seen = sailed(motors, command, until=(1.0, -1.0))
        assert [each for each, _ in seen if 0.0 < each < 1.0], "two seconds from rest to full"
        unsent = missed(command)  # while its links came up
        sailed(motors, command, until=(0.8, -0.8))
        assert missed(command) == unsent
        os.kill(process(tmp_path, "runtime"), signal.SIGSTOP)
        deadline_s = time.monotonic() + PATIENCE_S
        while not motors.stopped():
            assert time.monotonic() < deadline_s


@pytest.mark.long
def test_pulses_stop_at_the_death_of_the_runtime_and_of_the_outlet_and_go_on_when_both_are_back(tmp_path: Path) -> None:
    with afloat(tmp_path, "pwm") as (motors, command):
        for name in ("runtime", "outlet"):
            sailed(motors, command, until=(1.0, -1.0))
            os.kill(process(tmp_path, name), signal.SIGKILL)
            deadline_s = time.monotonic() + PATIENCE_S
            while not motors.stopped():
                assert time.monotonic() < deadline_s, name
        sailed(motors, command, until=(0.5, 0.5))
        deadline_s = time.monotonic() + PATIENCE_S
        while sailed_mps(command) < 0.1:  # the files move the boat of the simulator, too
            assert time.monotonic() < deadline_s
    assert motors.stopped(), "the end in order"


@pytest.mark.parametrize(
    "also_runtime", [pytest.param(False, id="the outlet"), pytest.param(True, id="and the runtime", marks=pytest.mark.long)]
)
def test_an_outlet_that_hangs_under_way_is_ended_and_the_boat_says_why(tmp_path: Path, also_runtime: bool) -> None:
    with afloat(tmp_path, "pwm", "failsafe.outlet.after_s=0.5") as (motors, command):  # the dead-man ends it after 1.0 s
        sailed(motors, command, until=(1.0, -1.0))
        os.kill(process(tmp_path, "outlet"), signal.SIGSTOP)
        if also_runtime:
            os.kill(process(tmp_path, "runtime"), signal.SIGKILL)
        deadline_s = time.monotonic() + PATIENCE_S
        while not motors.stopped():
            assert time.monotonic() < deadline_s
        outlet = json.loads((tmp_path / "supervisor.json").read_text())["programs"]["outlet"]
        assert outlet["restarts"] == 1
        assert "dead-man; it did not say where it stood: T (stopped)" in outlet["reason"]
        if not also_runtime:
            with Link(command, PATIENCE_S) as link:
                while "the motors may turn: the outlet" not in (state := link.ask("state"))["reason"]:
                    assert time.monotonic() < deadline_s, state["reason"]
                link.ask("stop")  # the stick was never let go
        sailed(motors, command, until=(0.5, 0.5))


def test_what_an_esc_tells_on_its_wire_is_in_the_boats_report(tmp_path: Path) -> None:
    """On a pseudo-terminal, which speaks each 30 ms as AM32 does."""
    with contextlib.ExitStack() as opened:
        esc, wire = pty.openpty()
        opened.callback(os.close, esc)
        opened.callback(os.close, wire)
        os.set_blocking(esc, False)  # nobody reads it yet
        motors = PwmMotors(tmp_path)
        rows = ROWS.replace("DRIVER", "pwm")
        values = (f"thrusters=[{rows}]", 'sysstat.required=["gps"]', "mavlink.enabled=false", "simulation.motors=false")
        values += (*motors.values, f'pwm.telemetry.starboard.device="{os.ttyname(wire)}"')
        command = opened.enter_context(running(tmp_path, 14550, *values))
        deadline_s, told = time.monotonic() + PATIENCE_S, dict[str, Any]()
        while told.get("rpm") != 1500.0:
            assert time.monotonic() < deadline_s, told
            with contextlib.suppress(BlockingIOError):
                os.write(esc, 2 * esc_frame())
            with contextlib.suppress(DelfimError), Link(command, PATIENCE_S) as link:
                told = link.ask("state")["thrusters"]["starboard"]
        assert (told["voltage_v"], told["current_a"], told["temperature_c"], told["faults"]) == (15.2, 4.5, 31.0, [])


def test_the_connection_of_a_stop_ends_with_it() -> None:
    """A boat's own computer that nobody reads would wait for us; and the next stop needs a connection again."""
    with contextlib.ExitStack() as opened:
        motors = SeatMotors("otter", opened, "PMARABT")
        rows = tuple(
            config.ThrusterTable(name=name, driver="otter", address=address, y_m=0.5 - address, thrust_n=(-50.0, 50.0))
            for address, name in enumerate(("starboard", "port"))
        )
        device = motors.values[0].partition("=")[2].strip('"')
        boat = config.Vehicle(boat=config.BoatTable(name="test"), thrusters=rows, otter=OtterTable(device=device))
        with contextlib.closing(PropellerStop(boat)) as stop:
            for connections in (1, 2):
                stop()
                stop()
                deadline_s = time.monotonic() + PATIENCE_S
                while not motors.stopped() or motors.connections < connections:
                    assert time.monotonic() < deadline_s
                stop.close()
                while motors.present:
                    motors.efforts()
                    assert time.monotonic() < deadline_s
