"""candump's text, both ways, against python-can, and on recorded traffic."""

import contextlib
import gzip
import io

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, Frame, extended, from_can_id, standard
from delfim.logging.candump import format_line, parse_line

T_NS = 1_262_304_000_000_123_000
REMOTE_ID = st.one_of(
    st.builds(standard, st.integers(0, 0x7FF), st.just(True)), st.builds(extended, st.integers(0, 0x1FFFFFFF), st.just(True))
)
DATA_ID = st.one_of(
    st.builds(standard, st.integers(0, 0x7FF)),
    st.builds(extended, st.integers(0, 0x1FFFFFFF)),
    st.builds(lambda kind: from_can_id(kind | 1 << 29), st.integers(0, 0x1FFFFFFF)),
)
TIMES = st.integers(0, 9_999_999_999_999_999).map(lambda microseconds: microseconds * 1000)
FRAMES = st.one_of(
    st.builds(Frame, DATA_ID, st.binary(max_size=8), TIMES, st.just(0), st.booleans()),
    st.builds(Frame, REMOTE_ID, st.integers(0, 8).map(bytes), TIMES, st.just(0), st.booleans()),
)
DEVICES = st.from_regex(r"[a-z][A-Za-z0-9_.-]{0,14}", fullmatch=True)


@pytest.mark.parametrize(
    ("frame", "line"),
    [
        (Frame(standard(0x123), b"\x11\x22", T_NS), "(1262304000.000123) can0 123#1122 R"),
        (Frame(extended(0x12345678), b"\xab", T_NS, 3, True), "(1262304000.000123) can0 12345678#AB T"),
        (Frame(extended(0x123), b"", T_NS), "(1262304000.000123) can0 00000123# R"),
        (Frame(standard(1, remote=True), b"", T_NS), "(1262304000.000123) can0 001#R R"),
        (Frame(standard(1, remote=True), bytes(7), T_NS), "(1262304000.000123) can0 001#R7 R"),
        (Frame(extended(1, remote=True), bytes(8), T_NS), "(1262304000.000123) can0 00000001#R8 R"),
        (Frame(4 << 3 | CAN_IDE | CAN_ERR, b"\0\4\0\0\0\0\0\0", T_NS), "(1262304000.000123) can0 20000004#0004000000000000 R"),
        (Frame(standard(0), b"", 999), "(0000000000.000000) can0 000# R"),
    ],
)
def test_lines_are_those_of_candump(frame, line):
    assert format_line(frame, "can0") == line + "\n"


@given(FRAMES, DEVICES)
def test_a_frame_comes_back(frame, device):
    assert parse_line(format_line(frame, device)) == (device, frame)


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        ("(1262304000.000123) can0 123#1122\n", Frame(standard(0x123), b"\x11\x22", T_NS)),
        (" (1262304000.000123)  can0  123#aabb".strip(), Frame(standard(0x123), b"\xaa\xbb", T_NS)),
        ("(1262304000.000123456)    can0 123#", Frame(standard(0x123), b"", T_NS + 456)),
        ("(1262304000.000123) can0 123#R8_9", Frame(standard(0x123, remote=True), bytes(8), T_NS)),
        (
            "(1262304000.000123) can0 123#1122334455667788_E T",
            Frame(standard(0x123), bytes.fromhex("1122334455667788"), T_NS, 0, True),
        ),
    ],
)
def test_what_candump_s_other_options_write_is_read(line, frame):
    assert parse_line(line) == ("can0", frame)


@pytest.mark.parametrize(
    "line",
    [
        "",
        "# a comment",
        "DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)",
        "(1262304000.000123) can0 123##1AABB",
        "(1262304000.000123) can0 123#112",
        "(1262304000.000123) can0 123#112233445566778899",
        "(1262304000.000123) can0 800#11",
        "(1262304000.000123) can0 40000000#11",
        "(1262304000.000123) can0 60000000#11",
        "(1262304000.000123) can0 20000000#R1",
        "(1262304000.000123) can0 123#R9",
        "(1262304000.000123) can0 1234#11",
        "(1262304000.12) can0 123#11",
        "(1262304000.000123) can0 123#11 X",
        "(1262304000.000123) 123#11",
        "(١٢٦٢٣٠٤٠٠٠.000123) can0 123#11",
    ],
)
def test_what_is_no_can_2_frame_is_refused(line):
    with pytest.raises(FormatError):
        parse_line(line)


@given(st.text())
def test_any_text_is_a_frame_or_refused(line):
    with contextlib.suppress(FormatError):
        _, frame = parse_line(line)
        assert len(frame.data) <= 8


@given(st.lists(FRAMES, max_size=5))
def test_python_can_reads_what_we_write(frames):
    read = list(can.CanutilsLogReader(io.StringIO("".join(format_line(frame, "can0") for frame in frames))))
    assert len(read) == len(frames)
    for frame, message in zip(frames, read, strict=True):
        if message.is_error_frame:  # it keeps nothing else of them
            assert frame.error
            continue
        assert (message.arbitration_id, message.is_extended_id) == (frame.identifier, frame.extended)
        assert (message.is_remote_frame, message.dlc) == (frame.remote, len(frame.data))
        assert bytes(message.data) == (b"" if frame.remote else frame.data)
        assert message.is_rx != frame.sent_here
        assert message.timestamp == pytest.approx(frame.t_ns / 1e9, abs=3e-6)  # a float's own step in the year 2286


def test_recorded_traffic_comes_back_as_it_was(recordings):
    with gzip.open(recordings / "can0-1.candump.log.gz", "rt") as packed:
        lines = packed.read().splitlines()
    plain = [(recordings / "actisense-522.candump.log").read_text().splitlines()]
    plain.append(gzip.decompress((recordings / "raymarine-p70.candump.log.gz").read_bytes()).decode().splitlines())
    lines += [line for text in plain for line in text if line[:1] == "("]
    assert len(lines) > 50_000
    for line in lines:
        device, frame = parse_line(line)
        assert format_line(frame, device) == line + " R\n"
