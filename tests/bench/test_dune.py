"""The comparison with DUNE where that is not there: its datagrams, its log, and a turn with a program that plays it."""

import math
import struct
import sys
from pathlib import Path

import pytest

from bench.dune import CHECKSUM, HEADER, ORDER, STATE, SYNC, THRUST, Dune, checksum, dune, latencies_us, logged, order
from delfim.base.errors import DelfimError

PLAYED = """#!{python}
import contextlib, pathlib, re, socket, sys, time
sys.path.insert(0, {root!r})
from tests.bench.test_dune import line
settings = pathlib.Path(sys.argv[sys.argv.index("-d") + 1])
port = int(re.search("Local Port = (.*)", (settings / "peers.ini").read_text())[1])
log = settings.parent / "bin/log/boat/Data.lsf"
log.parent.mkdir(parents=True)
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link, log.open("wb", buffering=0) as file:
    link.bind(("127.0.0.1", port))
    print("now in 'SERVICE' mode", flush=True)
    link.recv(1000)
    link.settimeout(0.01)
    while True:
        now_s = time.time()
        file.write(line(350, now_s) + line(301, now_s + 1e-4, 0, 0.5) + line(301, now_s + 2e-4, 1, 0.5))
        with contextlib.suppress(TimeoutError):
            link.recv(1000)
"""


def line(number: int, at_s: float, *thrust: float) -> bytes:
    """A message as DUNE logs it."""
    fields = struct.pack("<Bf", int(thrust[0]), thrust[1]) if thrust else b"\0" * 10
    told = HEADER.pack(SYNC, number, len(fields), at_s, 1, 2, 3, 4) + fields
    return told + CHECKSUM.pack(checksum(told))


def test_the_checksum_is_the_one_of_the_catalogue() -> None:
    assert checksum(b"123456789") == 0xBB3D, "CRC-16/ARC"


def test_the_order_is_a_whole_message_with_the_place_in_it() -> None:
    told = order(1e9)
    sync, number, size, at_s, *_ = HEADER.unpack_from(told)
    assert (sync, number, size, at_s) == (SYNC, ORDER, len(told) - HEADER.size - CHECKSUM.size, 1e9)
    assert CHECKSUM.unpack_from(told, len(told) - 2)[0] == checksum(told[:-2])
    goto, _, latitude_rad = struct.unpack_from("<HHd", told, HEADER.size + 4)
    assert goto == 450
    assert math.degrees(latitude_rad) == pytest.approx(41.195)


def test_a_cut_message_ends_the_log(tmp_path: Path) -> None:
    (tmp_path / "log/boat").mkdir(parents=True)
    whole = line(STATE, 5.0) + line(THRUST, 5.1, 1, 0.25)
    for cut in (1, len(line(THRUST, 0.0, 1, 0.0)) - 1):
        (tmp_path / "log/boat/Data.lsf").write_bytes(whole + line(STATE, 6.0)[:cut])
        assert [(each.number, each.at_s) for each in logged(tmp_path)] == [(STATE, 5.0), (THRUST, 5.1)]
    assert struct.unpack("<Bf", list(logged(tmp_path))[1].fields) == (1, 0.25)


def test_a_cycle_lasts_until_the_second_motor_has_its_order(tmp_path: Path) -> None:
    rows = [
        (THRUST, 0.5),
        (THRUST, 0.6),
        (STATE, 1.0),
        (THRUST, 1.25),
        (STATE, 2.0),
        (THRUST, 2.25),
        (THRUST, 2.5),
        (THRUST, 2.75),
    ]
    rows[2], rows[6] = rows[6], rows[2]  # it is not written in the order of its stamps
    data = b"".join(line(number, at_s, 0, 0.0) if number == THRUST else line(number, at_s) for number, at_s in rows)
    (tmp_path / "Data.lsf").write_bytes(data)
    assert latencies_us(logged(tmp_path)) == [500_000.0]


def test_where_it_is_not_built_there_is_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    assert list(dune(tmp_path)) == []
    (tmp_path / "bin/dune").touch(mode=0o755)
    with pytest.raises(DelfimError, match=r"has no otter\.ini"):
        next(dune(tmp_path))
    (tmp_path / "sources/etc").mkdir(parents=True)
    (tmp_path / "sources/etc/otter.ini").touch()
    (tmp_path / "bin/CMakeCache.txt").write_text(f"CMAKE_HOME_DIRECTORY:INTERNAL={tmp_path / 'sources'}\n")
    assert next(dune(tmp_path)).label.startswith("DUNE")


def test_a_turn_with_a_program_that_plays_it(tmp_path: Path) -> None:
    program = tmp_path / "dune"
    program.write_text(PLAYED.format(python=sys.executable, root=str(Path(__file__).parents[2])))
    program.chmod(0o755)
    turn = Dune(program, tmp_path, tmp_path).turn(0.2)
    assert turn.start_s > 0.0
    assert turn.stopped_s is None, "nothing is left that could stop the motors"
    assert turn.latency_us, "cycles after the start"
    assert all(us == pytest.approx(200.0, abs=1.0) for us in turn.latency_us)
