"""A serial radio: a real port (a pseudo terminal), noise, and a port that goes and comes."""

import asyncio
import json
import os
import threading
import tty
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.clock import ManualClock, SystemClock
from delfim.base.errors import ConfigError
from delfim.console.boats.fleet import BOATS_MAX, Fleet
from delfim.console.link.mavlink import Codec, mavlink
from delfim.console.link.radio import READ_BYTES, radio
from tests.console.fakeboat import FakeBoat


async def test_a_boat_is_found_and_commanded_over_a_serial_line() -> None:
    boat_end, console_end = os.openpty()
    tty.setraw(console_end)
    os.set_blocking(boat_end, False)
    clock, answers = SystemClock(), list[tuple[bool, str]]()
    port = radio(f"{os.ttyname(console_end)}:57600", lambda address, data: fleet.receive(address, data))
    fleet = Fleet(clock, lambda address, data: port.send(data), lambda message: None)
    boat = FakeBoat(3, clock, lambda data: os.write(boat_end, data))  # type: ignore[arg-type]
    loop = asyncio.get_running_loop()
    loop.add_reader(boat_end, lambda: boat.hear(os.read(boat_end, 4096)))
    port.start()
    try:
        await until(lambda: not port.reason)
        os.write(boat_end, b"\xfd\x30noise of a modem that starts\xfd")
        await until(lambda: (boat.tick(), 3 in fleet.boats)[1])
        assert fleet.boats[3].snapshot(clock.monotonic_s())["link"]["kind"] == "serial"
        fleet.command(3, "mode", {"mode": "hold"}, lambda well, why: answers.append((well, why)))
        await until(lambda: answers)
        assert (answers, boat.mode) == ([(True, "")], 5)
    finally:
        loop.remove_reader(boat_end)
        await asyncio.to_thread(port.close)
        os.close(boat_end)
        os.close(console_end)


async def until(is_so: Callable[[], object]) -> None:
    async with asyncio.timeout(200):
        while not is_so():
            await asyncio.sleep(0.02)


async def test_a_port_that_is_not_there_has_a_reason_and_drops(tmp_path: Path) -> None:
    port = radio(f"{tmp_path}/none:9600", lambda address, data: None)
    port.start()
    await until(lambda: "No such file" in port.reason)
    port.send(b"x")
    assert port.dropped == 1
    await asyncio.to_thread(port.close)


@pytest.mark.parametrize("words", ["", ":", "/dev/ttyUSB0:fast", "/dev/ttyUSB0:1", ":9600"])
def test_what_is_no_port_is_refused(words: str) -> None:
    with pytest.raises(ConfigError, match="no serial port"):
        radio(words, lambda address, data: None)


def frames(count: int) -> tuple[list[bytes], FakeBoat]:
    said: list[bytes] = []
    boat = FakeBoat(1, ManualClock(), said.append)
    for n in range(count):
        boat.say(mavlink.MAVLink_named_value_int_message(n, b"N", n))
    return said, boat


@given(seed=st.integers(0, 2**32), pieces=st.integers(1, 40))
def test_frames_are_found_however_the_stream_is_cut(seed: int, pieces: int) -> None:
    random, (said, _) = Random(seed), frames(20)
    stream = b"".join(said)
    cuts = sorted(random.randrange(len(stream)) for _ in range(pieces))
    codec, heard = Codec(stream=True), list[Any]()
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        heard += codec.decode(stream[begin:end])
    assert [m.value for m in heard] == list(range(20))
    assert codec.counts == {"heard": 20, "refused": 0}


@given(st.lists(st.binary(max_size=60), min_size=20, max_size=20))
def test_noise_between_frames_hides_none_of_them(noise: list[bytes]) -> None:
    said, _ = frames(20)
    codec, heard = Codec(stream=True), list[Any]()
    for before, frame in zip(noise, said, strict=True):
        heard += codec.decode(before + frame)
    heard += codec.decode(bytes(300))  # what a broken frame at the end was waiting for
    assert [m.value for m in heard] == list(range(20))


@given(st.binary(max_size=400))
def test_bytes_that_mean_nothing_are_bounded_and_harmless(data: bytes) -> None:
    codec = Codec(stream=True)
    assert list(codec.decode(data)) == []
    assert len(codec._cutter.rest) <= 292


class EndlessPort:
    """A port that always has more. `READ_ON` is set when it was read 20 times."""

    in_waiting, out_waiting = 4096, 0

    def __init__(self, *_: object, **__: object) -> None:
        self.reads = 0

    def __enter__(self) -> "EndlessPort":
        return self

    def __exit__(self, *_: object) -> None: ...

    def read(self, size: int) -> bytes:
        self.reads += 1
        if self.reads == 20:
            READ_ON.set()
        return b"\xfe" * size


READ_ON = threading.Event()


async def test_bytes_that_the_loop_cannot_take_stay_in_the_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """A radio that never stops would fill the memory, and the loop's turn would be as long as all that waits."""
    monkeypatch.setattr(serial, "Serial", EndlessPort)
    READ_ON.clear()
    turns, over = list[tuple[int, bool]](), asyncio.Event()

    def receive(address: Any, data: bytes) -> None:
        turns.append((len(data), not turns and READ_ON.wait(0.2)))  # a slow turn
        over.set()

    port = radio("/dev/radio", receive)
    port.start()
    await over.wait()
    await asyncio.to_thread(port.close)
    assert turns[0][0] <= READ_BYTES + 1
    assert not turns[0][1], "it was read on"


def test_whatever_comes_over_a_radio_the_console_shows_its_boats(mutations: int) -> None:
    """2,000 mutated pieces of a boat's stream, 100,000 with --mutations 2000; what the page gets is JSON all the time."""
    chance, clock, said = Random(1), ManualClock(), list[bytes]()
    fleet = Fleet(clock, lambda address, data: None, lambda message: json.dumps(message, allow_nan=False))
    boat = FakeBoat(3, clock, said.append)
    for _ in range(30):
        clock.advance(0.1)
        boat.tick()
    for number in range(50 * mutations):
        fleet.receive(("serial", "/dev/radio"), mutated(chance, chance.choice(said)))
        clock.advance(0.01)
        if number % 50 == 0:
            fleet.tick()
            json.dumps(fleet.snapshot(), allow_nan=False)
        assert len(fleet._peers["serial", "/dev/radio"]._cutter.rest) <= 292
    assert len(fleet.boats) <= BOATS_MAX
    assert fleet._peers["serial", "/dev/radio"].counts["heard"] > 5 * mutations


def mutated(chance: Random, said: bytes) -> bytes:
    """As it is, with a bit turned, cut, of beginnings only, or of any content and any boat with the right checksum."""
    frame, how = bytearray(said), chance.randrange(6)
    if how == 0:
        frame[chance.randrange(len(frame))] ^= 1 << chance.randrange(8)
    elif how == 1:
        del frame[chance.randrange(len(frame)) :]
    elif how == 2:
        return chance.choice((b"\xfd", b"\xfe", b"\xfd\xff\0")) * chance.randrange(200)
    elif how == 3:
        frame[10:-2] = chance.choice((chance.randbytes(len(frame) - 12), bytes([255]) * (len(frame) - 12)))
        frame[5] = chance.randrange(256)
        crc = mavlink.x25crc(bytes(frame[1:-2]))
        crc.accumulate(bytes((mavlink.mavlink_map[int.from_bytes(frame[7:10], "little")].crc_extra,)))
        frame[-2:] = int(crc.crc).to_bytes(2, "little")
    return bytes(frame)
