"""`delfim can nodes`, `param` and `firmware` against a node of pydronecan's on a loopback bus."""

import contextlib
import itertools
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dronecan
import pytest
from dronecan import uavcan
from dronecan.node import Node
from hypothesis import given
from hypothesis import strategies as st

from delfim.__main__ import main
from delfim.base.errors import FormatError
from delfim.base.frames import Frame, extended
from delfim.canproxy.dronecan import requests
from delfim.canproxy.dronecan.datatypes import ARMING_STATUS, ON
from delfim.canproxy.dronecan.requests import Parameter, ServiceReceiver, service_frames
from delfim.canproxy.dronecan.transfers import COMMAND, Publisher
from delfim.console.terminal import nodes
from tests.esc_pair import Bus

NUMBER = 42
PARAM = uavcan.protocol.param
_names = itertools.count()


class Device:
    """A node with parameters and a boot loader, in a thread of its own."""

    def __init__(self, interface: str) -> None:
        info = uavcan.protocol.GetNodeInfo.Response(name="org.example.esc")
        info.software_version.major = 1
        self.node = Node(Bus(interface), node_id=NUMBER, node_info=info)
        self.node.mode = 0
        self.values: dict[str, Any] = {"ESC_INDEX": 0, "KP": 0.25, "BI_DIRECTIONAL": False, "NAME": "esc"}
        self.saved: dict[str, Any] | None = None
        self.fetched, self.path, self.armed = b"", "", False
        self.begins = 0  # the error by which it refuses an update
        for kind, answer in (
            (PARAM.GetSet, self._get_set),
            (PARAM.ExecuteOpcode, self._execute),
            (uavcan.protocol.file.BeginFirmwareUpdate, self._begin),
        ):
            self.node.add_handler(kind, answer)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._arming = Publisher(ARMING_STATUS, 10, COMMAND)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.node.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            if self.armed:
                for arb, data in self._arming.frames(ON):
                    self.node.can_driver.can.sendmsg(Frame(arb, data))
            self.node.spin(0.01)

    def _get_set(self, event: Any) -> Any:
        name = event.request.name.decode()
        index = event.request.index
        if not name and index < len(self.values):
            name = list(self.values)[index]
        answer = PARAM.GetSet.Response()
        if name not in self.values:
            return answer
        asked = event.request.value
        kind = dronecan.get_active_union_field(asked)
        if kind != "empty":
            value = getattr(asked, kind)
            value = value.decode() if kind == "string_value" else bool(value) if kind == "boolean_value" else value
            if name != "KP" or value <= 1.0:
                self.values[name] = value
        value = self.values[name]
        fields = {bool: "boolean_value", int: "integer_value", float: "real_value", str: "string_value"}
        setattr(answer.value, fields[type(value)], value)
        if name == "ESC_INDEX":
            answer.min_value.integer_value, answer.max_value.integer_value = 0, 31
        answer.name = name
        return answer

    def _execute(self, event: Any) -> Any:
        self.saved = dict(self.values) if event.request.opcode == event.request.OPCODE_SAVE else None
        return PARAM.ExecuteOpcode.Response(ok=True)

    def _begin(self, event: Any) -> Any:
        if not self.begins:
            self.node.mode = uavcan.protocol.NodeStatus().MODE_SOFTWARE_UPDATE
            self.path, self.fetched = event.request.image_file_remote_path.path.decode(), b""
            self._fetch(event.request.source_node_id)
        return uavcan.protocol.file.BeginFirmwareUpdate.Response(error=self.begins)

    def _fetch(self, server: int) -> None:
        """As a boot loader does: again where no answer came, and the next piece until one is short."""
        asked = uavcan.protocol.file.Read.Request(offset=len(self.fetched))
        asked.path.path = self.path

        def came(event: Any) -> None:
            if event is not None:
                data = bytes(event.response.data)
                self.fetched += data
                if len(data) < 256:
                    self.node.mode, self.node.node_info.software_version.major = 0, 2
                    return
            self._fetch(server)

        self.node.request(asked, server, came)


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
    assert "42  org.example.esc                 1.0      well, operational" in capsys.readouterr().out
    assert main(["can", "param", name, "42"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "ESC_INDEX = 0  (least 0, greatest 31)",
        "KP = 0.25",
        "BI_DIRECTIONAL = False",
        "NAME = esc",
    ]
    words = ["ESC_INDEX=3", "KP=0.1", "BI_DIRECTIONAL=true", "NAME=port", "ESC_INDEX", "--save"]
    assert main(["can", "param", name, "42", *words]) == 0
    assert capsys.readouterr().out.splitlines()[-2:] == ["ESC_INDEX = 3  (least 0, greatest 31)", "node 42: saved"]
    assert device.saved == {"ESC_INDEX": 3, "KP": pytest.approx(0.1), "BI_DIRECTIONAL": True, "NAME": "port"}
    assert main(["can", "param", name, "42", "--erase"]) == 0
    assert device.saved is None


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


@pytest.mark.parametrize("words", [["nodes"], ["param", "42", "ESC_INDEX=3"], ["firmware", "42", "FILE"]])
def test_nothing_is_asked_while_motors_are_armed(
    device: Device, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    device.armed = True
    file = tmp_path / "esc.bin"
    file.write_bytes(b"program")
    verb, *rest = words
    assert main(["can", verb, name, *[str(file) if word == "FILE" else word for word in rest]]) != 0
    assert nodes.ARMED in capsys.readouterr().err
    assert (device.values["ESC_INDEX"], device.path) == (0, "")


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
