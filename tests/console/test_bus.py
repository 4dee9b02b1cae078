"""`delfim can`: candump's notation and output, and each tool on a canloop bus and by TCP."""

import contextlib
import gzip
import itertools
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.__main__ import main
from delfim.base.errors import ConfigError, DelfimError, FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, Frame, extended, identifier, standard
from delfim.canproxy.canloop import open_canloop
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.console.terminal import busstat
from delfim.console.terminal.bus import logged
from delfim.console.terminal.busstat import Statistics, parse_link
from delfim.console.terminal.framefilter import Filter, Stamps, decoder, long_text, parse_filter, parse_frame

ROOT = Path(__file__).parents[2]
_numbers = itertools.count()
TIMEOUT_S = 200.0
ERROR = Frame(4 << 3 | CAN_IDE | CAN_ERR, b"\x00\x04\x00\x00\x00\x00\x60\x00", 1_000_000_000)


@pytest.fixture
def name() -> str:
    return f"b{os.getpid() % 100000}-{next(_numbers)}"


@pytest.fixture
def bus(name: str) -> Iterator[CanSocket]:
    with open_canloop(name) as one:
        one.settimeout(TIMEOUT_S)
        one.bind(ANYTHING)
        yield one


@contextlib.contextmanager
def traffic(name: str, *frames: Frame) -> Iterator[None]:
    """These frames again and again."""
    stop = threading.Event()

    def run() -> None:
        with open_canloop(name) as source:
            while not stop.wait(0.005):
                for frame in frames:
                    source.sendmsg(frame)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


# Notation.


@pytest.mark.parametrize(
    ("text", "passing", "refused"),
    [
        ("can0", [Frame(standard(1)), Frame(extended(1)), Frame(standard(1, True))], [ERROR]),
        ("can0,123:7FF", [Frame(standard(0x123)), Frame(extended(0x18000123))], [Frame(standard(0x124)), ERROR]),
        ("can0,123:C00007FF", [Frame(standard(0x123))], [Frame(extended(0x123)), Frame(standard(0x123, True))]),
        ("can0,00000123:DFFFFFFF", [Frame(extended(0x123))], [Frame(standard(0x123)), Frame(extended(0x123, True))]),
        ("can0,400~700", [Frame(standard(0x300))], [Frame(standard(0x4FF))]),
        ("can0,1:7FF,2:7FF", [Frame(standard(1)), Frame(standard(2))], [Frame(standard(3))]),
        ("can0,100:700,101~7FF,j", [Frame(standard(0x102))], [Frame(standard(0x101)), Frame(standard(0x200))]),
        ("can0,0~0,#FFFFFFFF", [ERROR], [Frame(standard(0)), Frame(extended(0))]),
        ("can0,#00000040", [Frame(standard(1))], [ERROR]),
    ],
)
def test_filters_mean_what_they_mean_to_candump(text: str, passing: list[Frame], refused: list[Frame]) -> None:
    interface, wanted = parse_filter(text)
    assert interface == "can0"
    assert [frame for frame in [*passing, *refused] if wanted.passes(frame)] == passing


@pytest.mark.parametrize("text", ["can0,", "can0,123", "can0,123:", "can0,#", "can0,x:7FF", "can0,123456789:7FF", "can0,k"])
def test_what_is_no_filter_is_refused(text: str) -> None:
    with pytest.raises(FormatError, match="not a filter"):
        parse_filter(text)


def test_an_interface_may_have_colons() -> None:
    assert parse_filter("socketcand:10.0.0.1:29536:can0,1:7FF") == (
        "socketcand:10.0.0.1:29536:can0",
        Filter(((1, 0x7FF, False),)),
    )


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("123#", Frame(standard(0x123))),
        ("7ff#11.22.aa", Frame(standard(0x7FF), b"\x11\x22\xaa")),
        ("00000123#DEADBEEF", Frame(extended(0x123), b"\xde\xad\xbe\xef")),
        ("123#R", Frame(standard(0x123, remote=True))),
        ("123#R4", Frame(standard(0x123, remote=True), bytes(4))),
    ],
)
def test_frames_are_written_as_for_cansend(text: str, frame: Frame) -> None:
    assert parse_frame(text) == frame


@given(st.text(max_size=20) | st.from_regex(r"[0-9A-F]{0,9}#{0,3}[0-9A-FR._ ]{0,20}"))
def test_what_is_no_frame_is_refused(text: str) -> None:
    try:
        frame = parse_frame(text)
    except FormatError:
        return
    assert identifier(frame.arb) == int(text.partition("#")[0], 16) & 0x1FFFFFFF


def test_stamps() -> None:
    at_ns = 1_262_304_000_000_123_999

    def told(kind: str) -> list[str]:
        stamps = Stamps(kind)
        return [stamps.text(at_ns), stamps.text(at_ns + 1_500_000_000), stamps.text(at_ns + 1_600_000_000)]

    assert told("") == ["", "", ""]
    assert told("a")[:2] == ["(1262304000.000123) ", "(1262304001.500123) "]
    assert told("d") == ["(000.000000) ", "(001.500000) ", "(000.100000) "]
    assert told("z") == ["(000.000000) ", "(001.500000) ", "(001.600000) "]
    assert re.fullmatch(r"\((2010-01-01|2009-12-31) \d\d:\d\d:00\.000123\) ", told("A")[0])


@pytest.mark.parametrize(
    ("frame", "wide", "text"),
    [
        (Frame(standard(0x12), b"\x11A"), False, "012   [2]  11 41" + " " * 21 + "'.A'"),
        (Frame(standard(0x12), b"\x11A"), True, "     012   [2]  11 41" + " " * 21 + "'.A'"),
        (Frame(extended(0x12), b"12345678"), True, "00000012   [8]  31 32 33 34 35 36 37 38   '12345678'"),
        (Frame(standard(0x12), b""), False, "012   [0] " + " " * 27 + "''"),
        (Frame(standard(0x12, remote=True), bytes(4)), False, "012   [4]  remote request"),
        (ERROR, True, "20000004   [8]  00 04 00 00 00 00 60 00   ERRORFRAME"),
    ],
)
def test_frames_on_a_terminal(frame: Frame, wide: bool, text: str) -> None:
    assert long_text(frame, wide=wide, ascii_too=True) == text


def test_decoding() -> None:
    decoded = decoder(str(ROOT / "etc/delfimx.dbc"))
    assert decoded(Frame(standard(0x40), b"\x58\x02\x01\x07")) == "PropellerStarboardCommand Rpm=600rpm Run=run Counter=7"
    assert decoded(Frame(standard(0x123), b"")) == ""
    assert decoded(Frame(extended(0x40), b"\x58\x02\x01\x07")) == ""
    assert decoded(Frame(standard(0x40, remote=True), bytes(4))) == ""
    assert decoded(Frame(standard(0x40), b"")).startswith("PropellerStarboardCommand: ")
    with pytest.raises(DelfimError, match=r"nothing\.dbc"):
        decoder("nothing.dbc")


# The tools.


def test_dump_and_send(bus: CanSocket, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with traffic(name, Frame(standard(0x40), b"\x58\x02\x01\x07"), Frame(standard(0x41)), Frame(extended(0x123), b"\1")):
        options = ["--dbc", str(ROOT / "etc/delfimx.dbc")]
        assert main(["can", "dump", "-ta", "-x", "-n", "20", *options, f"canloop:{name},40:7FF,00000123:9FFFFFFF"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 20
    pattern = rf" \(\d{{10}}\.\d{{6}}\)  {name}  TX - -  +040   \[4\]  58 02 01 07   PropellerStarboardCommand Rpm=600rpm .*"
    assert sum(bool(re.fullmatch(pattern, line)) for line in lines) == 10
    assert sum(line.endswith(f"{name}  TX - -  00000123   [1]  01") for line in lines) == 10
    assert main(["can", "send", f"canloop:{name}", "321#01.02", "00000321#"]) == 0
    while (frame := bus.recvmsg()).arb != standard(0x321):
        pass
    assert frame.data == b"\1\2"
    assert bus.recvmsg().arb == extended(0x321)


def test_dump_in_log_format_and_into_a_file(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with traffic(name, Frame(standard(0x123), b"\xab")):
        assert main(["can", "dump", "-L", "-n", "3", f"canloop:{name}"]) == 0
        assert main(["can", "dump", "-l", "-x", "-n", "3", f"canloop:{name}"]) == 0
    told = capsys.readouterr()
    assert re.fullmatch(rf"(\(\d{{10}}\.\d{{6}}\) {name} 123#AB\n){{3}}", told.out)
    (file,) = tmp_path.iterdir()
    assert re.fullmatch(r"candump-\d{4}-\d\d-\d\d_\d{6}\.log", file.name)
    assert told.err == f"Enabling Logfile '{file.name}'\n"
    assert re.fullmatch(rf"(\(\d{{10}}\.\d{{6}}\) {name} 123#AB T\n){{3}}", file.read_text())


def test_dump_of_several_buses_ends_in_silence(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with traffic(name, Frame(standard(1))), traffic(f"{name}-long", Frame(standard(2))):
        assert main(["can", "dump", "-n", "40", f"canloop:{name}", f"canloop:{name}-long"]) == 0
    assert main(["can", "dump", "-T", "50", f"canloop:{name}"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 40
    assert {line.split()[0] for line in lines} == {name, f"{name}-long"}
    assert len({line.index("[0]") for line in lines}) == 1  # in columns


def test_error_frames_in_words(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with traffic(name, ERROR):
        assert main(["can", "dump", "-e", "-n", "1", f"canloop:{name},#FFFFFFFF"]) == 0
    assert "ERRORFRAME   error warning" in capsys.readouterr().out


def test_the_log_format_has_no_room_for_more(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["can", "dump", "-L", "-a", f"canloop:{name}"]) == 2
    assert "no room" in capsys.readouterr().err


def test_gen_repeats_itself_from_its_seed(bus: CanSocket, name: str) -> None:
    for _ in range(2):
        assert main(["can", "gen", "-g", "0", "-n", "50", "--seed", "7", f"canloop:{name}"]) == 0
    heard = [bus.recvmsg()[:2] for _ in range(100)]
    assert heard[:50] == heard[50:]
    assert len({arb for arb, _ in heard}) > 30
    assert {len(data) for _, data in heard} == set(range(9))


def test_gen_with_fixed_and_incremented_values(bus: CanSocket, name: str) -> None:
    assert main(["can", "gen", "-g", "1", "-n", "3", "-I", "42A", "-L", "2", "-D", "i", f"canloop:{name}"]) == 0
    assert [bus.recvmsg()[:2] for _ in range(3)] == [(standard(0x42A), bytes([number, 0])) for number in range(3)]
    assert main(["can", "gen", "-g", "0", "-n", "3", "-e", "-I", "i", "-D", "1122", f"canloop:{name}"]) == 0
    assert [bus.recvmsg().arb for _ in range(3)] == [extended(number) for number in range(3)]


@pytest.mark.parametrize("words", [["-I", "x"], ["-L", "9"], ["-D", "1"]])
def test_gen_says_what_it_does_not_understand(words: list[str], name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["can", "gen", "-n", "1", *words, f"canloop:{name}"]) == 2
    assert f"{words[0]} {words[1]}: " in capsys.readouterr().err


LOG = """comment
(1.000000) can0 001#01 R
(1.050000) can1 002#02
(1.060000) can0 20000004#0004000000000000 R
(1.100000) can0 00000003#R4 T
not a line
(9.000000) can0 004#
"""


def test_replay_keeps_the_time_between_frames(bus, name, tmp_path, capsys):
    file = tmp_path / "one.log"
    file.write_text(LOG)
    assert main(["can", "replay", str(file), f"canloop:{name}=can0", "-s", "1"]) == 0
    heard = [bus.recvmsg() for _ in range(3)]
    assert [frame[:2] for frame in heard] == [(standard(1), b"\1"), (extended(3, remote=True), bytes(4)), (standard(4), b"")]
    assert (heard[1].t_ns - heard[0].t_ns) / 1e9 == pytest.approx(0.1, abs=0.09)
    assert capsys.readouterr().err == "delfim can replay: 3 frames sent, 2 left out\n"


def test_replay_of_a_log_that_a_power_cut_left(bus, name, tmp_path, capsys):
    file = tmp_path / "one.log.gz"
    file.write_bytes(gzip.compress(LOG.encode())[:-8])
    assert main(["can", "replay", "-t", "-l", "2", str(file), f"canloop:{name}=can0"]) == 0
    assert [bus.recvmsg().arb for _ in range(6)] == [standard(1), extended(3, remote=True), standard(4)] * 2
    assert "ends early" in capsys.readouterr().err
    with pytest.raises(FormatError, match="No such file"):
        list(logged(str(tmp_path / "none.log")))
    with pytest.raises(SystemExit):
        main(["can", "replay"])
    assert main(["can", "replay", str(file), "can0"]) == 2


def test_stat(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with traffic(name, Frame(standard(0x123), b"\xab"), Frame(extended(0x123)), ERROR):
        assert main(["can", "stat", "-n", "2", "-i", "0.3", "-b", "125000", "--json", f"canloop:{name}"]) == 0
        reports = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert main(["can", "stat", "-n", "1", "-i", "0.2", f"canloop:{name}"]) == 0
    assert [row["id"] for row in reports[1]["identifiers"]] == ["00000123", "123"]  # as they win the bus
    assert reports[1]["total"] > reports[0]["total"] > 20
    assert reports[1]["state"] == "error warning"
    one, two = (row["load_percent"] for row in reports[1]["identifiers"])
    assert one + two == pytest.approx(reports[1]["load_percent"])
    assert reports[1]["load_percent"] == pytest.approx(reports[1]["rate_hz"] / 2 * (56 + 71) / 1250, rel=0.15)
    text = capsys.readouterr().out
    assert "of 1000 kbit/s" in text
    assert re.search(r"^ +123 +\d+\.\d +\d\.\d\d +\d+  AB$", text, re.MULTILINE)


def test_stat_is_bounded_and_says_what_is_wrong(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    statistics = Statistics()
    for number in range(busstat.IDENTIFIERS_MAX + 10):
        statistics.add(Frame(extended(number)))
    assert len(statistics.rows) == busstat.IDENTIFIERS_MAX
    assert statistics.total == busstat.IDENTIFIERS_MAX + 10
    assert main(["can", "stat", "-i", "0", f"canloop:{name}"]) == 2
    assert isinstance(ConfigError("", "", ""), DelfimError)
    assert "more than 0" in capsys.readouterr().err


def test_the_kernel_knows_more_of_a_controller() -> None:
    info = {"state": "ERROR-PASSIVE", "berr_counter": {"tx": 128, "rx": 3}, "bittiming": {"bitrate": 500000}}
    counts = {"bus_error": 5, "bus_off": 1, "restarts": 1, "arbitration_lost": 0}
    stats = {"rx": {"dropped": 2, "over_errors": 1}, "tx": {"dropped": 4}}
    link = [{"ifname": "can0", "linkinfo": {"info_kind": "can", "info_data": info, "info_xstats": counts}, "stats64": stats}]
    assert parse_link(json.dumps(link)) == {
        "bitrate": 500000,
        "state": "error passive",
        "transmit_errors": 128,
        "receive_errors": 3,
        "bus_errors": 5,
        "bus_off": 1,
        "restarts": 1,
        "interface_dropped": 7,
    }
    for nothing in ("", "[]", "[{}]", "null"):
        assert parse_link(nothing) == {}


def test_the_command_itself_and_its_end() -> None:
    """`delfim can dump` in a process of its own ends without a traceback when it is interrupted."""
    name = f"b{os.getpid()}-{next(_numbers)}"
    command = [sys.executable, "-m", "delfim", "can", "dump", f"canloop:{name}"]
    with (
        traffic(name, Frame(standard(0x123))),
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process,
    ):
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().endswith("123   [0] \n")
        process.send_signal(2)
        assert process.wait(TIMEOUT_S) == 130
        assert process.stderr.read() == ""


def test_deadlines_of_gen(bus: CanSocket, name: str) -> None:
    began_s = time.monotonic()
    assert main(["can", "gen", "-g", "20", "-n", "6", f"canloop:{name}"]) == 0
    assert time.monotonic() - began_s >= 0.1
    assert bus.recvmsg().data is not None
    bus.sendto(b"", CanAddress(standard(1)))
