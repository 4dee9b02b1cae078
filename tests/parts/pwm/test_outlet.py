"""The outlet: when it lets motors turn, and that they stop. A tree of files stands for the kernel's PWM."""

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import pytest

from delfim.base.errors import DelfimError, FormatError
from delfim.base.pulses import (
    CHANNELS,
    SILENT_S,
    WORDS,
    PulseAnswer,
    pack_answer,
    pack_command,
    socket_path,
    unpack_answer,
    unpack_command,
)
from delfim.parts.pwm.outlet import Channels, Guard, OutletServer, serve
from delfim.parts.pwm.pulseports import SysfsPort, open_port
from delfim.parts.pwm.table import Pwm, PwmChannel
from tests.mutations import cut, flipped, spliced

ROOT = Path(__file__).parents[3]
PATIENCE_S = 200.0
HALF = (0.5, -0.25, *(0.0,) * (CHANNELS - 2))
REST = (0.0,) * CHANNELS


def told(counter: int, run: bool = True, fractions: tuple[float, ...] = HALF) -> bytes:
    return pack_command(counter, run, fractions)


def test_records_say_what_was_put_in() -> None:
    assert unpack_command(told(7)) == (7, True, HALF)
    assert unpack_command(told(1 << 32, False, REST)) == (0, False, REST)
    answer = PulseAnswer(9, "arming", "no such chip")
    assert unpack_answer(pack_answer(answer)) == answer
    assert len(unpack_answer(pack_answer(PulseAnswer(0, "stopped", "x" * 1000))).trouble) == WORDS


def test_records_that_are_none_are_refused() -> None:
    beyond = bytearray(told(1))
    beyond[5:7] = (10_001).to_bytes(2, "little")
    for data in (b"", b"x", told(1)[:-1], told(1) + b"x", bytes(beyond)):
        with pytest.raises(FormatError):
            unpack_command(data)
    for data in (b"", b"\0\0\0\0", b"\0\0\0\0\3"):
        with pytest.raises(FormatError):
            unpack_answer(data)


class Heard:
    """A guard and its clock."""

    def __init__(self) -> None:
        self.guard, self.now_s = Guard(), 100.0

    def after(self, s: float, data: bytes = b"", sender: str = "runtime") -> tuple[float, ...] | None:
        self.now_s += s
        if data:
            self.guard.hear(sender, data, self.now_s)
        return self.guard.fractions(self.now_s)


def test_nothing_turns_before_a_command_and_a_command_is_obeyed() -> None:
    heard = Heard()
    assert heard.after(0.0) is None
    assert heard.after(0.0, told(1)) == HALF
    assert heard.after(SILENT_S / 2, told(2, fractions=REST)) == REST


def test_silence_stops_until_there_is_a_new_command() -> None:
    heard = Heard()
    assert heard.after(0.0, told(1)) == HALF
    assert heard.after(SILENT_S - 0.01) == HALF
    assert heard.after(0.02) is None
    assert heard.after(0.0, told(1)) is None
    assert heard.after(0.0, told(2)) == HALF
    guard = Guard()
    guard.hear("runtime", told(1), 0.0)
    assert guard.fractions(SILENT_S) == HALF


def test_a_sender_that_repeats_itself_keeps_no_motor_running() -> None:
    heard = Heard()
    heard.after(0.0, told(1))
    for _ in range(6):
        assert heard.after(0.1, told(1)) == HALF
    assert heard.after(0.11, told(1)) is None
    assert heard.after(1.0, told(1)) is None


def test_the_end_of_the_one_who_commands_stops_and_another_end_does_not() -> None:
    heard = Heard()
    heard.after(0.0, told(1))
    heard.guard.lose("bench")
    assert heard.after(0.0) == HALF
    heard.guard.lose("runtime")
    assert heard.after(0.0) is None
    assert heard.after(0.0, told(1)) == HALF, "it is connected again, and counts anew"


def test_anybody_stops_and_the_last_who_commands_holds_the_motors() -> None:
    heard = Heard()
    heard.after(0.0, told(1))
    assert heard.after(0.0, told(0, False, REST), "supervisor") is None
    assert heard.after(0.0, told(1, fractions=REST), "bench") == REST
    heard.guard.lose("runtime")
    assert heard.after(0.0) == REST
    heard.guard.lose("bench")
    assert heard.after(0.0) is None


def test_garbage_changes_nothing_and_does_not_count_as_speech() -> None:
    heard = Heard()
    heard.after(0.0, told(1))
    random = Random(16)
    for _ in range(3000):
        data = random.choice((flipped, cut, spliced))(told(2), random)
        try:
            command = unpack_command(data)
        except FormatError:
            with pytest.raises(FormatError):
                heard.guard.hear("noise", data, heard.now_s + 10.0)
        else:
            assert all(-1.0 <= each <= 1.0 for each in command.fractions)
    assert heard.after(0.0) == HALF
    assert heard.after(SILENT_S + 0.001) is None


def test_pulses_of_fractions() -> None:
    usual, one_way = PwmChannel(), PwmChannel(astern_us=1000.0, neutral_us=1000.0, ahead_us=2000.0)
    assert [usual.pulse_us(each) for each in (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0)] == [
        1100,
        1100,
        1300,
        1500,
        1700,
        1900,
        1900,
    ]
    assert [one_way.pulse_us(each) for each in (-1.0, 0.0, 0.5)] == [1000, 1000, 1500]
    assert PwmChannel(astern_us=1900.0, ahead_us=1100.0).pulse_us(0.5) == 1300
    for wrong in ({"neutral_us": 1950.0}, {"ahead_us": 1500.0}):
        with pytest.raises(ValueError, match="not between"):
            PwmChannel(**wrong)


def chip(place: Path, *channels: int) -> Path:
    """Files for the channels of a PWM chip, as the kernel's driver shows them."""
    for each in channels:
        (place / f"pwm{each}").mkdir(parents=True)
        for name in ("period", "duty_cycle", "enable"):
            (place / f"pwm{each}" / name).write_text("0\n")
    return place


def pulse_us(place: Path, channel: int) -> int:
    """A file is empty for a moment while it is written; an attribute of the kernel is not."""
    while not (lines := (place / f"pwm{channel}/duty_cycle").read_text().splitlines()):
        pass
    return int(lines[0]) // 1000


def test_channels_of_the_kernel_start_with_neutral(tmp_path: Path) -> None:
    place = chip(tmp_path, 0, 3)
    port = SysfsPort(place, 50.0, {0: 1500.0, 3: 1000.0})
    assert [(place / f"pwm3/{name}").read_text() for name in ("period", "enable")] == ["20000000\n", "1\n"]
    assert (pulse_us(place, 0), pulse_us(place, 3)) == (1500, 1000)
    port.put({0: 1900.0, 3: 1100.4})
    assert (pulse_us(place, 0), pulse_us(place, 3)) == (1900, 1100)
    port.close()
    (tmp_path / "export").touch()
    with pytest.raises(OSError, match="pwm5"):  # the kernel makes the folder; here nobody does
        SysfsPort(place, 50.0, {5: 1500.0})
    assert (tmp_path / "export").read_text() == "5\n"


def test_a_chip_that_is_not_there_is_told_in_words(tmp_path: Path) -> None:
    with pytest.raises(DelfimError, match=r"pwmchip9 names 0 chips: is the driver"):
        open_port(Pwm(chip=f"{tmp_path}/pwmchip9"), {0: 1500.0})
    open_port(Pwm(chip=f"{chip(tmp_path / 'deep/pwmchip7', 0).parent}/pwmchip*"), {0: 1500.0}).close()


class FlakyPort:
    """Hardware that fails when it is told to."""

    def __init__(self) -> None:
        self.written, self.fails, self.opened, self.closed = dict[int, float](), False, 0, 0

    def open(self, pwm: Pwm, pulses_us: dict[int, float]) -> "FlakyPort":
        self.opened += 1
        self.put(pulses_us)
        return self

    def put(self, pulses_us: dict[int, float]) -> None:
        if self.fails:
            raise OSError(5, "Remote I/O error")
        self.written = dict(pulses_us)

    def close(self) -> None:
        self.closed += 1


def test_an_esc_is_armed_by_neutral_and_again_after_a_fault(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    port = FlakyPort()
    channels = Channels(Pwm(arm_s=3.0, chip="pca9685:1"), (0, 1), port.open)
    channels.put(HALF, 10.0)
    assert (channels.state, port.written) == ("arming", {0: 1500.0, 1: 1500.0})
    channels.put(HALF, 13.0)
    assert (channels.state, port.written) == ("running", {0: 1700.0, 1: 1400.0})
    port.fails = True
    channels.put(HALF, 13.1)
    assert (channels.state, channels.trouble) == ("stopped", "Remote I/O error")
    assert port.closed == 1
    channels.put(HALF, 13.2)  # it was opened at 10.0
    port.fails = False
    channels.put(HALF, 14.1)
    assert (channels.state, port.opened) == ("stopped", 2)
    channels.put(HALF, 14.2)
    assert (channels.state, channels.trouble, port.written) == ("arming", "", {0: 1500.0, 1: 1500.0})
    channels.put(None, 20.0)
    assert (channels.state, port.written) == ("stopped", {0: 1500.0, 1: 1500.0})
    channels.put(HALF, 21.0)
    channels.close()
    assert (port.written, port.closed) == ({0: 1500.0, 1: 1500.0}, 2)
    told = [("INFO", "outlet: pca9685:1 is open"), ("ERROR", "outlet: Remote I/O error")]
    assert [(each.levelname, each.message) for each in caplog.records] == [*told, told[0]]
    Channels(Pwm(), (0,), port.open).put(None, 0.0)
    port.fails = True
    never = Channels(Pwm(), (0,), port.open)
    never.close()
    assert (never.trouble, port.closed) == ("Remote I/O error", 2)


class Served:
    """A server with its socket, on a clock that waiting moves; each step of `steps` is done before a turn."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, place: Path) -> None:
        self.path, self.port, self.now_s, self.waits_s, self.steps = place / "outlet", FlakyPort(), 100.0, list[float](), 0
        clock, look = SimpleNamespace(monotonic=lambda: self.now_s), select.select

        def waits(read: list[object], write: list[object], error: list[object], wait_s: float) -> object:
            self.waits_s.append(wait_s)
            found = look(read, write, error, 0.0)
            self.now_s += 0.0 if found[0] else wait_s
            return found

        monkeypatch.setattr("delfim.parts.pwm.outlet.time", clock)
        monkeypatch.setattr("delfim.parts.pwm.outlet.select", SimpleNamespace(select=waits))
        self.channels = Channels(Pwm(arm_s=0.0), (0, 1), self.port.open)
        self.path.touch()  # an outlet that was killed leaves its socket
        self.server = OutletServer(self.path, self.channels)
        assert not self.server._listening.getblocking()
        self.clients = list[socket.socket]()

    def client(self) -> socket.socket:
        client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        client.setblocking(False)
        client.connect(str(self.path))
        self.clients.append(client)
        return client

    def run(self, steps: Iterator[None]) -> str:
        def ended() -> str:
            self.steps += 1
            assert self.steps < 1000
            assert not any(each.getblocking() for each in self.server._clients)
            return next(steps, "over") or ""  # type: ignore[func-returns-value]

        return self.server.serve(ended)

    def pulses(self) -> list[float]:
        return list(self.port.written.values())


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Served]:
    served = Served(monkeypatch, tmp_path)
    yield served
    served.server.close()
    for client in served.clients:
        client.close()


RUNS, RESTS = [1700.0, 1400.0], [1500.0, 1500.0]


def test_the_server_writes_the_pulses_of_the_last_word_at_once_and_answers(served: Served) -> None:
    def steps() -> Iterator[None]:
        yield
        assert served.waits_s == [0.1]
        client = served.client()
        yield
        client.send(told(1, fractions=REST))
        client.send(told(2))
        at_s = served.now_s
        yield
        assert (served.pulses(), served.now_s) == (RUNS, at_s), "not a turn later"
        assert unpack_answer(client.recv(1000)) == PulseAnswer(2, "running", "")
        with pytest.raises(BlockingIOError):
            client.recv(1000)
        while served.now_s < at_s + SILENT_S - 0.05:
            yield
        assert served.pulses() == RUNS
        for _ in range(3):
            yield
        assert served.pulses() == RESTS
        client.send(told(3))
        yield
        assert served.pulses() == RUNS

    assert served.run(steps()) == "over"
    assert served.pulses() == RESTS
    assert served.path.stat().st_mode & 0o777 == 0o600


def test_the_server_keeps_to_four_clients_and_lets_go_of_those_that_are_gone(served: Served) -> None:
    def steps() -> Iterator[None]:
        clients = []
        for _ in range(5):
            clients.append(served.client())
            yield
        for client in clients:
            with contextlib.suppress(BrokenPipeError):
                client.send(told(1))
        yield
        assert [len(client.recv(1000)) > 0 for client in clients] == [True] * 4 + [False]
        clients[3].close()
        at_s = served.now_s
        yield
        assert (served.pulses(), served.now_s) == (RESTS, at_s), "it commanded last"
        clients.append(served.client())
        yield
        clients[-1].send(told(1))
        yield
        assert clients[-1].recv(1000)
        clients[0].close()
        yield
        assert served.pulses() == RUNS

    served.run(steps())


def test_one_who_floods_or_talks_nonsense_gets_one_turn(served: Served, caplog: pytest.LogCaptureFixture) -> None:
    def steps() -> Iterator[None]:
        client, other = served.client(), served.client()
        yield
        yield
        client.send(b"x")
        yield
        assert unpack_answer(client.recv(1000)).counter == 0
        assert len(caplog.messages) == 1
        for number in range(65):
            client.send(told(number))
        yield
        assert served.server._guard.counter == 63
        yield
        assert served.server._guard.counter == 64
        client.send(told(65) + bytes(300))
        client.send(b"x")
        yield
        assert served.server._guard.counter == 64
        assert len(caplog.messages) == 1
        assert caplog.messages[0].startswith("outlet: ")
        assert caplog.messages[0].endswith("; the next ones are not told")
        other.send(told(1))
        yield
        assert unpack_answer(other.recv(1000)).counter == 1

    caplog.set_level("ERROR")
    served.run(steps())


def test_clients_that_are_reset_or_do_not_read_hold_up_nobody(served: Served) -> None:
    def steps() -> Iterator[None]:
        client, deaf = served.client(), served.client()
        yield
        yield
        for number in range(400):  # its answers fill the socket
            deaf.send(told(number))
            yield
        client.send(told(1))
        yield
        assert served.pulses() == RUNS
        broken: Any = Broken()
        served.server._clients.append(broken)
        served.server._hear(broken)
        assert (closed, broken in served.server._clients) == ([broken], False)

    class Broken:
        def recv(self, size: int) -> bytes:
            raise ConnectionResetError

        def close(self) -> None:
            closed.append(self)

    closed = list[object]()
    served.run(steps())


@pytest.mark.parametrize("how", ["signal", "supervisor"])
def test_the_process_beats_until_a_signal_or_the_end_of_its_supervisor(tmp_path, monkeypatch, caplog, how):
    reading, beat_fd = os.pipe()
    os.set_blocking(reading, False)
    looks, closed = list[str](), list[OutletServer]()

    def turns(server: OutletServer, ended: Callable[[], str]) -> str:
        assert not os.get_blocking(beat_fd)
        looks.append(ended())
        assert os.read(reading, 10) == b"."
        while select.select([], [beat_fd], [], 0.0)[1]:
            os.write(beat_fd, bytes(4096))
        looks.append(ended())
        if how == "signal":
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)
        else:
            os.close(reading)
        return ended()

    monkeypatch.setattr(OutletServer, "serve", turns)
    monkeypatch.setattr(OutletServer, "close", lambda server: (closed.append(server), server._listening.close()))
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    caplog.set_level("INFO")
    try:
        serve(tmp_path / "outlet", Pwm(), (0,), beat_fd)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        os.close(beat_fd)
    assert looks == ["", ""]
    assert caplog.messages == [f"outlet: stops: {'SIGINT' if how == 'signal' else 'the supervisor is gone'}"]
    assert len(closed) == 1
    if how == "signal":
        os.close(reading)


def test_a_pipe_may_be_file_0_and_without_one_there_is_no_beat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = list[object]()
    played = {"write": lambda fd, data: done.append((fd, data)), "set_blocking": lambda fd, blocks: done.append((fd, blocks))}
    monkeypatch.setattr("delfim.parts.pwm.outlet.os", SimpleNamespace(chmod=os.chmod, **played))
    monkeypatch.setattr("delfim.parts.pwm.outlet.signal.signal", lambda number, handler: done.append(number))
    monkeypatch.setattr(OutletServer, "serve", lambda server, ended: done.append(ended()))
    for beat_fd in (0, -1):
        serve(tmp_path / "outlet", Pwm(), (0,), beat_fd)
    numbers = [signal.SIGTERM, signal.SIGINT]
    assert done == [*numbers, (0, False), (0, b"."), "", *numbers, ""]


ROWS = ", ".join(
    f'{{name="{name}", driver="pwm", address={address}, y_m={y_m}, thrust_n=[-50.0, 50.0]}}'
    for address, name, y_m in ((0, "starboard", 0.5), (3, "port", -0.5))
)


class Outlet:
    """`delfim outlet` on a tree of files, and somebody who speaks to it."""

    def __init__(self, place: Path, opened: contextlib.ExitStack) -> None:
        self.chip = chip(place / "pwmchip0", 0, 3)
        values = (f"thrusters=[{ROWS}]", f'pwm.chip="{self.chip}"', "pwm.arm_s=0.0", f'runtime.run_directory="{place}"')
        self.beats, beat = os.pipe()
        words = [word for value in values for word in ("--set", value)]
        command = [sys.executable, "-m", "delfim", "outlet", str(ROOT / "etc/delfimx.toml"), *words, "--beat-fd", str(beat)]
        self.process = subprocess.Popen(command, pass_fds=(beat,))
        opened.callback(self.process.wait, PATIENCE_S)
        opened.callback(self.process.terminate)
        os.close(beat)
        assert os.read(self.beats, 1) == b".", "it beats"
        self.client = opened.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        self.client.settimeout(PATIENCE_S)
        self.client.connect(str(socket_path(str(place))))

    def asked(self, counter: int) -> tuple[str, list[int]]:
        """A command to run, the state that it answers, and the pulses then."""
        self.client.send(told(counter))
        return unpack_answer(self.client.recv(1000)).state, self.pulses()

    def pulses(self) -> list[int]:
        return [pulse_us(self.chip, each) for each in (0, 3)]

    def stops(self) -> bool:
        """Waits for neutral."""
        deadline_s = time.monotonic() + PATIENCE_S
        while self.pulses() != [1500, 1500]:
            assert time.monotonic() < deadline_s
            select.select([], [], [], 0.01)
        return True


@pytest.fixture
def outlet(tmp_path: Path) -> Iterator[Outlet]:
    with contextlib.ExitStack() as opened:
        yield Outlet(tmp_path, opened)


def test_a_command_is_a_pulse_and_silence_is_neutral(outlet: Outlet) -> None:
    assert outlet.pulses() == [1500, 1500]
    assert outlet.asked(1) == ("running", [1700, 1500])
    assert outlet.stops()
    assert outlet.asked(2) == ("running", [1700, 1500])


def test_a_frozen_counter_is_silence(outlet: Outlet) -> None:
    outlet.asked(1)
    deadline_s = time.monotonic() + PATIENCE_S
    while outlet.asked(1) != ("stopped", [1500, 1500]):
        assert time.monotonic() < deadline_s
    assert outlet.asked(2) == ("running", [1700, 1500])


def test_the_end_of_the_connection_is_neutral(outlet: Outlet) -> None:
    outlet.asked(1)
    outlet.client.close()
    assert outlet.stops()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_is_neutral(outlet: Outlet, number: int) -> None:
    outlet.asked(1)
    outlet.process.send_signal(number)
    assert outlet.process.wait(PATIENCE_S) == 0
    assert outlet.pulses() == [1500, 1500]


def test_the_end_of_the_supervisor_is_neutral(outlet: Outlet) -> None:
    outlet.asked(1)
    os.close(outlet.beats)
    assert outlet.process.wait(PATIENCE_S) == 0
    assert outlet.pulses() == [1500, 1500]


def test_what_nobody_understands_changes_nothing_and_more_clients_than_it_has_room_for_harm_nobody(outlet: Outlet) -> None:
    outlet.asked(1)
    with contextlib.ExitStack() as opened:
        for _ in range(10):
            other = opened.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
            with contextlib.suppress(OSError):
                other.connect(outlet.client.getpeername())
                other.send(b"x" * 300)
        assert outlet.asked(2) == ("running", [1700, 1500])
    assert outlet.asked(3) == ("running", [1700, 1500])
