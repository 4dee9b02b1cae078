"""A serial radio: a real port (a pseudo terminal), noise, and a port that goes and comes."""

import asyncio
import os
import tty
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.clock import ManualClock, SystemClock
from delfim.console.fleet import Fleet
from delfim.console.mavlink import Codec, mavlink
from delfim.console.radio import radio
from delfim.errors import ConfigError
from tests.console.fakeboat import FakeBoat


def test_a_boat_is_found_and_commanded_over_a_serial_line() -> None:
    async def main() -> None:
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
            fleet.command(3, "hold", {}, lambda well, why: answers.append((well, why)))
            await until(lambda: answers)
            assert (answers, boat.mode) == ([(True, "")], 5)
        finally:
            loop.remove_reader(boat_end)
            await asyncio.to_thread(port.close)
            os.close(boat_end)
            os.close(console_end)

    asyncio.run(main())


async def until(is_so: Callable[[], object]) -> None:
    async with asyncio.timeout(60):
        while not is_so():
            await asyncio.sleep(0.02)


def test_a_port_that_is_not_there_has_a_reason_and_drops(tmp_path: Path) -> None:
    async def main() -> None:
        port = radio(f"{tmp_path}/none:9600", lambda address, data: None)
        port.start()
        await until(lambda: "No such file" in port.reason)
        port.send(b"x")
        assert port.dropped == 1
        await asyncio.to_thread(port.close)

    asyncio.run(main())


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
