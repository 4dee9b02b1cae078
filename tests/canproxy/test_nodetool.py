"""`delfim can nodes`, `param`, `restart` and `firmware` against a node of pydronecan's on a loopback bus."""

import contextlib
import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import dronecan
import pytest
from dronecan import uavcan
from hypothesis import given
from hypothesis import strategies as st

from delfim.__main__ import main
from delfim.base.errors import FormatError
from delfim.base.frames import Frame, extended
from delfim.canproxy.dronecan import requests
from delfim.canproxy.dronecan.requests import Parameter, ServiceReceiver, service_frames
from delfim.console.terminal import nodes
from delfim.console.terminal.nodes import HandedFile
from tests.dronecan_device import PARAM, Device

_names = itertools.count()


@pytest.fixture
def name() -> str:
    return f"canloop:node-{os.getpid() % 100_000}-{next(_names)}"


@pytest.fixture
def device(name: str) -> Iterator[Device]:
    with contextlib.closing(Device(name)) as device:
        yield device


def test_a_node_is_listed_and_its_parameters_are_printed_set_saved_and_erased(
    device: Device, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["can", "nodes", name]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  42")]
    assert row.split() == ["42", "org.example.esc", "1.0", "well,", "operational", row.split()[5], "0.0", "00" * 16]
    assert main(["can", "param", name, "42"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "ESC_INDEX = 0  (integer, least 0, greatest 31)",
        "KP = 0.25  (real)",
        "BI_DIRECTIONAL = False  (boolean)",
        "NAME = esc  (text)",
    ]
    words = ["ESC_INDEX=3", "KP=0.1", "BI_DIRECTIONAL=true", "NAME=port", "ESC_INDEX", "--save"]
    assert main(["can", "param", name, "42", *words]) == 0
    assert capsys.readouterr().out.splitlines()[-2:] == ["ESC_INDEX = 3  (integer, least 0, greatest 31)", "node 42: saved"]
    assert device.saved == {"ESC_INDEX": 3, "KP": pytest.approx(0.1), "BI_DIRECTIONAL": True, "NAME": "port"}
    assert main(["can", "param", name, "42", "--erase"]) == 0
    assert device.saved is None


def test_what_a_node_says_of_itself_moves_no_terminal() -> None:
    assert nodes.shown(Parameter("K\x1b[2J", "a\nb", None, None, None)).startswith("K\\x1b[2J = a b  (")
    answer = bytes(41) + b"esc\x1b[2J"
    assert nodes.identity(answer).name == "esc\\x1b[2J"


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tool listens for long enough to hear a status, where that matters."""
    monkeypatch.setattr(nodes, "LISTEN_S", 0.1)


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize(
    ("word", "reason"),
    [
        ("NOTHING", "node 42 has no parameter NOTHING"),
        ("ESC_INDEX=32", "32 is beyond 31, the greatest that the node takes"),
        ("ESC_INDEX=-1", "-1 is beyond 0, the least that the node takes"),
        ("KP=much", "'much' is no value like 0.25"),
        ("BI_DIRECTIONAL=2", "'2' is no value like False"),
        ("KP=7", "node 42 keeps KP at 0.25"),
    ],
)
def test_what_a_node_does_not_take_is_told_in_words(
    device: Device, name: str, capsys: pytest.CaptureFixture[str], word: str, reason: str
) -> None:
    assert main(["can", "param", name, "42", word]) != 0
    assert reason in capsys.readouterr().err
    assert device.values["ESC_INDEX"] == 0


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("length", [1, 256, 5000, 5120])
def test_a_node_fetches_its_new_program(
    device: Device, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], length: int
) -> None:
    file = tmp_path / "esc-2.0.bin"
    file.write_bytes(os.urandom(length))
    assert main(["can", "firmware", name, "42", str(file)]) == 0
    assert (device.fetched, device.path) == (file.read_bytes(), "esc-2.0.bin")
    said = capsys.readouterr().out
    assert f"node 42: org.example.esc 1.0; it fetches esc-2.0.bin, {length} bytes" in said
    assert said.endswith("100 %\nnode 42 is back: org.example.esc 2.0\n")


@pytest.mark.usefixtures("at_once")
def test_a_node_that_refuses_an_update_or_is_not_there(
    device: Device, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "esc.bin"
    file.write_bytes(b"program")
    device.begins = 2
    assert main(["can", "firmware", name, "42", str(file)]) != 0
    assert "node 42 takes no firmware: an update is under way already" in capsys.readouterr().err
    assert main(["can", "param", name, "43"]) != 0
    assert "node 43 does not answer GetSet" in capsys.readouterr().err


def handing(name: str, file: Path, *words: str) -> int:
    return main(["can", "firmware", name, "42", str(file), *words])


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """A program of 100 kB."""
    file = tmp_path / "esc-2.0.bin"
    file.write_bytes(b"DELF" + os.urandom(102_396))
    return file


@pytest.mark.usefixtures("at_once")
def test_a_large_program_arrives_whole_though_the_bus_loses_frames(
    device: Device, name: str, image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of 997 frames, both ways: some five of a hundred pieces come damaged, and are asked for again."""
    device.bus.each = 997
    assert handing(name, image) == 0
    assert device.fetched == image.read_bytes()
    assert device.bus.lost > 10
    assert [line for line in capsys.readouterr().out.splitlines() if line.endswith("%")] == [f"{n}0 %" for n in range(1, 11)]


@pytest.mark.usefixtures("at_once")
def test_a_node_that_falls_silent_is_told_with_what_it_got(
    device: Device, name: str, image: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(nodes, "READ_S", 1.5)
    device.silent_at = 25_600
    assert handing(name, image) == 1
    told = "node 42 got no further for 2 s; node 42 was handed 25600 of 102400 bytes: it needs a whole program before it can"
    assert told in capsys.readouterr().err
    device.silent_at, device.is_silent = -1, False
    assert handing(name, image) == 0, "and gets it from its beginning"
    assert device.fetched == image.read_bytes()


@pytest.mark.usefixtures("at_once")
def test_a_program_that_the_node_does_not_run_is_told(
    device: Device, name: str, image: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its checksum is wrong, or it is another device's."""
    monkeypatch.setattr(nodes, "BACK_S", 1.5)
    device.wants_sound = True
    image.write_bytes(b"WRONG" * 60)
    assert handing(name, image) == 1
    assert "node 42 has the whole file, and does not run its program: critical, maintenance" in capsys.readouterr().err
    image.write_bytes(b"DELF" + bytes(300))
    assert handing(name, image) == 0


@pytest.mark.usefixtures("at_once")
def test_a_node_whose_answer_gets_lost_has_begun_all_the_same(device: Device, name: str, image: Path) -> None:
    device.is_mute = True
    assert handing(name, image) == 0
    assert device.fetched == image.read_bytes()


def test_a_tool_that_is_killed_half_way_leaves_a_node_that_takes_the_program_anew(
    device: Device, name: str, image: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = [sys.executable, "-m", "delfim", "can", "firmware", name, "42", str(image)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as tool:
        assert tool.stdout is not None
        while tool.stdout.readline() != "40 %\n":
            assert tool.poll() is None
        tool.send_signal(signal.SIGKILL)
    assert 0 < len(device.fetched) < 102_400
    monkeypatch.setattr(nodes, "LISTEN_S", 0.1)
    image.write_bytes(b"DELF" + os.urandom(102_396))
    assert handing(name, image) == 0
    assert device.fetched == image.read_bytes(), "and nothing of the one before"


@pytest.mark.usefixtures("at_once")
def test_an_update_that_is_broken_off_by_hand_says_what_the_node_lacks(
    device: Device, name: str, image: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(tool: object, file: object) -> Iterator[int]:
        yield 25_600
        raise KeyboardInterrupt

    monkeypatch.setattr(nodes.NodeTool, "serve", interrupted)
    assert handing(name, image) == 1
    assert "broken off; node 42 was handed" in capsys.readouterr().err


@pytest.mark.usefixtures("at_once")
def test_no_program_is_begun_while_a_boat_commands_motors_and_none_goes_on_while_they_are_armed(
    device: Device, name: str, image: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    device.says = "idle"
    assert handing(name, image) == 1
    assert nodes.COMMANDED in capsys.readouterr().err
    assert device.path == ""
    assert main(["can", "param", name, "42", "ESC_INDEX=3"]) == 0, "parameters may be set in idle"
    served = nodes.NodeTool.serve

    def armed_under_way(tool: nodes.NodeTool, file: HandedFile) -> Iterator[int]:
        for handed in served(tool, file):
            device.says = "armed" if handed > 25_600 else "idle"
            yield handed

    monkeypatch.setattr(nodes.NodeTool, "serve", armed_under_way)
    assert handing(name, image, "--idle") == 1
    told = capsys.readouterr().err
    assert f"{nodes.ARMED}; node 42 was handed " in told
    assert len(device.fetched) < 102_400


@pytest.mark.usefixtures("at_once")
def test_a_node_starts_again_whether_it_answers_or_not(
    device: Device, name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    device.node.start_time_monotonic -= 3600.0
    assert main(["can", "restart", name, "42"]) == 0
    assert device.restarts == 1
    assert "node 42 started again, and runs for" in capsys.readouterr().out
    device.node.start_time_monotonic -= 3600.0
    monkeypatch.setattr(requests, "RESTART", bytes(5))
    assert main(["can", "restart", name, "42"]) == 1
    assert "node 42 does not start again now" in capsys.readouterr().err
    assert device.restarts == 1


@given(st.lists(st.tuples(st.integers(0, 700), st.sampled_from(("esc.bin", "passwd"))), max_size=20), st.integers(1, 600))
def test_a_file_is_handed_over_from_its_beginning_alone_and_no_other_is(asked: list[tuple[int, str]], length: int) -> None:
    image, begun, ended = os.urandom(length), False, False
    file = HandedFile(42, "esc.bin", image)
    for offset, path in asked:
        answer = file.answer(offset.to_bytes(5, "little") + path.encode())
        if path != "esc.bin":
            assert answer == b"\x02\x00"
            continue
        begun = begun or offset == 0
        assert answer == (b"\0\0" + image[offset : offset + 256] if begun else None)
        ended = ended or (begun and length - 256 < offset <= length)
    assert file.handed <= length
    assert file.is_whole is ended


@given(st.binary(max_size=4))
def test_a_request_that_is_cut_short_is_none(data: bytes) -> None:
    with pytest.raises(FormatError):
        HandedFile(42, "esc.bin", b"program").answer(data)


@pytest.mark.parametrize(
    "words",
    [
        ["nodes"],
        ["param", "42", "ESC_INDEX=3"],
        ["restart", "42"],
        ["firmware", "42", "FILE"],
        ["firmware", "42", "FILE", "--idle"],
    ],
)
def test_nothing_is_asked_while_motors_are_armed(
    device: Device, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    device.says = "armed"
    file = tmp_path / "esc.bin"
    file.write_bytes(b"program")
    verb, *rest = words
    assert main(["can", verb, name, *[str(file) if word == "FILE" else word for word in rest]]) != 0
    assert nodes.ARMED in capsys.readouterr().err
    assert (device.values["ESC_INDEX"], device.path, device.restarts) == (0, "", 0)


# The codec.

values = st.one_of(
    st.none(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(width=32, allow_nan=False, allow_infinity=False),
    st.booleans(),
    st.text(max_size=30),
)


@given(st.integers(0, 8191), st.text(max_size=20), values)
def test_requests_are_byte_for_byte_those_of_pydronecan(index: int, name: str, value: requests.Value) -> None:
    asked = PARAM.GetSet.Request(index=index, name=name.encode())
    fields = {bool: "boolean_value", int: "integer_value", float: "real_value", str: "string_value"}
    if value is not None:
        setattr(asked.value, fields[type(value)], value.encode() if isinstance(value, str) else value)
    else:
        asked.value.empty = uavcan.protocol.param.Empty()
    transfer = dronecan.transport.Transfer(
        payload=asked, source_node_id=127, dest_node_id=42, transfer_id=5, service_not_message=True, request_not_response=True
    )
    transfer.transfer_priority = requests.PRIORITY
    told = [(extended(frame.message_id), bytes(frame.bytes)) for frame in transfer.to_frames()]
    assert service_frames(requests.GET_SET, 127, 42, 5, requests.get_set(index, name, value), asks=True) == told


@given(st.binary(max_size=400))
def test_an_answer_is_a_parameter_or_refused(data: bytes) -> None:
    with contextlib.suppress(FormatError):
        found = requests.read_parameter(data)
        assert found is None or isinstance(found, Parameter)


@given(st.binary(max_size=300), st.data())
def test_transfers_come_whole_or_not_at_all(payload: bytes, data: st.DataObject) -> None:
    frames = [Frame(arb, each) for arb, each in service_frames(requests.READ, 42, 127, 9, payload, asks=True)]
    receiver = ServiceReceiver(127)
    (whole,) = [each for frame in frames if (each := receiver.feed(frame)) is not None]
    assert (whole.payload, whole.source, whole.number, whole.is_request) == (payload, 42, 9, True)
    lost = data.draw(st.integers(0, len(frames) - 1))
    assert not [each for at, frame in enumerate(frames) if at != lost and receiver.feed(frame) is not None]
