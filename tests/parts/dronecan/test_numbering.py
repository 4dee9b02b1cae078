"""Numbers for DroneCAN devices, on a loopback bus, as pydronecan's messages ask for them; the disk keeps them."""

import os
import struct

import pytest
from dronecan import transport, uavcan
from dronecan.app.node_monitor import NodeMonitor
from dronecan.node import Node

from delfim.base.clock import SystemClock
from delfim.base.frames import Frame, extended
from delfim.canproxy.dronecan.datatypes import ALLOCATION, NODE_STATUS, decode, node_status
from delfim.canproxy.dronecan.nodeservices import ANSWERS_PER_S, GET_NODE_INFO, RESTART_NODE, Identity, NodeServices
from delfim.canproxy.dronecan.transfers import STATUS, Publisher, TransferReceiver, checksum
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING
from delfim.parts.dronecan.numbering import Numbering, identity, keep, known_numbers
from tests.esc_pair import Bus

IDENTITY = bytes(range(16))


@pytest.fixture
def devices(tmp_path):
    with open_can(f"canloop:numbers-{os.getpid()}-{tmp_path.name[-8:]}") as bus:
        bus.bind(ANYTHING)
        bus.settimeout(200)
        yield bus


@pytest.fixture
def numbering(devices, tmp_path):
    receiver = TransferReceiver((ALLOCATION, NODE_STATUS))
    with open_can(f"canloop:{devices.name.removeprefix('canloop:')}") as bus:
        bus.setblocking(False)
        node = NodeServices(10, Identity("delfim.boat", (0, 1), IDENTITY))
        bus.bind(*receiver.filters, *node.filters)
        yield Numbering(bus, receiver, node, tmp_path / "numbers.json", SystemClock())


def ask(devices, identity=IDENTITY, preferred=0):
    """The three parts, each in an anonymous frame of pydronecan's."""
    for number, part in enumerate((identity[:6], identity[6:12], identity[12:])):
        message = uavcan.protocol.dynamic_node_id.Allocation(node_id=preferred, first_part_of_unique_id=number == 0)
        message.unique_id = part
        transfer = transport.Transfer(payload=message, source_node_id=0, transfer_id=number, discriminator=0x1234)
        (frame,) = transfer.to_frames()
        devices.sendmsg(Frame(extended(frame.message_id), bytes(frame.bytes)))


def answers(devices, count):
    receiver, heard = TransferReceiver((ALLOCATION,)), []
    while len(heard) < count:
        if (transfer := receiver.feed(devices.recvmsg(), 0.0)) is not None:
            heard.append(decode(transfer))
    return heard


def test_a_device_gets_a_number_and_keeps_it_when_the_computer_starts_again(devices, numbering, tmp_path):
    (arb, data), *_ = Publisher(NODE_STATUS, 125, STATUS).frames(node_status(1.0))
    devices.sendmsg(Frame(arb, data))
    ask(devices)
    numbering.on_frames()
    told = answers(devices, 3)
    assert [each.identity for each in told] == [IDENTITY[:6], IDENTITY[:12], IDENTITY]
    assert told[-1].node == 124, "125 speaks on the bus"
    assert known_numbers(tmp_path / "numbers.json") == {IDENTITY: 124}
    assert numbering.report()["numbers"] == {"124": IDENTITY.hex()}


def test_the_disk_that_does_not_take_it_costs_no_number(devices, numbering, tmp_path, caplog):
    numbering._place = tmp_path / "missing" / "numbers.json"
    ask(devices)
    numbering.on_frames()
    assert answers(devices, 3)[-1].node == 125
    assert "may be another one tomorrow" in caplog.text


DAMAGED = ["", "[]", "{", '{"00": 5}', '{"zz": 1}', f'{{"{IDENTITY.hex()}": 126}}', f'{{"{IDENTITY.hex()}": "x"}}']


@pytest.mark.parametrize("text", DAMAGED)
def test_a_damaged_table_is_begun_anew_and_said(tmp_path, caplog, text):
    (tmp_path / "numbers.json").write_text(text)
    assert known_numbers(tmp_path / "numbers.json") == {}
    assert "is damaged" in caplog.text


def test_a_table_that_was_kept_is_the_same(tmp_path):
    keep(tmp_path / "numbers.json", {IDENTITY: 5})
    assert known_numbers(tmp_path / "numbers.json") == {IDENTITY: 5}
    assert known_numbers(tmp_path / "other.json") == {}


def say_status(devices, uptime_s=77.0, node=10):
    """As the boat's own driver does, in another process."""
    ((arb, data),) = Publisher(NODE_STATUS, node, STATUS).frames(node_status(uptime_s))
    devices.sendmsg(Frame(arb, data))


@pytest.fixture
def tool(devices):
    """A node of pydronecan's, as the GUI tool has one."""
    node = Node(Bus(devices.name), node_id=126)
    yield node
    node.close()


def asked(tool, numbering, request):
    """The answer to a request, or None without one."""
    told = []
    tool.request(request, 10, lambda event: told.append(event and event.response))
    while not told:
        numbering.on_frames()
        tool.spin(0.005)
    return told[0]


def test_a_tool_on_the_bus_sees_who_this_node_is(devices, numbering, tool):
    monitor = NodeMonitor(tool)
    while not (monitor.exists(10) and monitor.get(10).info):
        say_status(devices)
        numbering.on_frames()
        tool.spin(0.02)
    info = monitor.get(10).info
    assert bytes(info.name).decode() == "delfim.boat"
    assert (info.software_version.major, info.software_version.minor) == (0, 1)
    assert bytes(info.hardware_version.unique_id) == IDENTITY
    assert bytes(info.hardware_version.certificate_of_authenticity) == b""
    assert (info.status.uptime_sec, info.status.health, info.status.mode) == (77, 0, 0)
    monitor.close()


def test_the_status_of_a_boat_that_is_not_heard_is_an_error(numbering, tool):
    status = asked(tool, numbering, uavcan.protocol.GetNodeInfo.Request()).status
    assert (status.health, status.mode) == (status.HEALTH_ERROR, status.MODE_INITIALIZATION)


def test_nobody_on_the_bus_starts_the_computer_again(numbering, tool, caplog):
    request = uavcan.protocol.RestartNode.Request(magic_number=uavcan.protocol.RestartNode.Request().MAGIC_NUMBER)
    for _ in range(3):
        assert not asked(tool, numbering, request).ok
    assert caplog.text.count("node 126 asks this computer to start again: refused") == 1


def test_a_flood_of_requests_is_answered_no_more_than_so_often(devices):
    node = NodeServices(10, Identity("delfim.boat", (0, 1), IDENTITY))
    flood = [Frame(extended(30 << 24 | 1 << 16 | 0x8000 | 10 << 8 | 0x80 | 126), bytes((0xC0 | n & 31,))) for n in range(100)]
    answered = [node.answer(frame, 1.0 + n / 100) for n, frame in enumerate(flood)]
    assert len([each for each in answered if each]) == ANSWERS_PER_S
    assert node.refused == 90
    assert node.answer(flood[0], 2.0)


OTHERS = [
    (30 << 24 | 1 << 16 | 0x8000 | 11 << 8 | 0x80 | 126, b"\xc0"),  # to another node
    (30 << 24 | 1 << 16 | 10 << 8 | 0x80 | 126, b"\xc0"),  # an answer
    (30 << 24 | 1 << 16 | 0x8000 | 10 << 8 | 0x80, b"\xc0"),  # from nobody
    (30 << 24 | 11 << 16 | 0x8000 | 10 << 8 | 0x80 | 126, b"\xc0"),  # for a parameter
    (30 << 24 | 1 << 16 | 0x8000 | 10 << 8 | 0x80 | 126, b""),
    (30 << 24 | 1 << 16 | 0x8000 | 10 << 8 | 0x80 | 126, bytes(7) + b"\x80"),  # of several frames
    (30 << 24 | 1 << 16 | 0x8000 | 10 << 8 | 126, b"\xc0"),  # a message
]


@pytest.mark.parametrize(("identifier", "data"), OTHERS)
def test_what_is_no_request_to_this_node_is_not_answered(identifier, data):
    node = NodeServices(10, Identity("delfim.boat", (0, 1), IDENTITY))
    assert node.answer(Frame(extended(identifier), data), 1.0) == []


def test_without_numbers_it_still_says_who_it_is(devices, numbering, tool):
    numbering._place = None
    ask(devices)
    numbering.on_frames()
    assert numbering.report()["numbers"] == {}
    assert bytes(asked(tool, numbering, uavcan.protocol.GetNodeInfo.Request()).name) == b"delfim.boat"


@pytest.mark.parametrize("kind", [GET_NODE_INFO, RESTART_NODE], ids=lambda kind: kind.name)
def test_the_answers_are_those_of_the_published_definition(kind):
    definition = getattr(uavcan.protocol, kind.name)
    assert kind.id == definition.default_dtid
    assert checksum(struct.pack("<Q", definition.get_data_type_signature())) == kind.seed


def test_the_unique_id_is_the_computers_and_does_not_tell_the_machines(tmp_path):
    (tmp_path / "machine-id").write_text("0123456789abcdef0123456789abcdef\n")
    told = identity(tmp_path / "machine-id")
    assert told == identity(tmp_path / "machine-id")
    assert len(told.unique_id) == 16
    assert told.unique_id.hex() not in (tmp_path / "machine-id").read_text()
    assert identity(tmp_path / "missing").unique_id != told.unique_id
