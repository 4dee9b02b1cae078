"""Numbers for DroneCAN devices, on a loopback bus, as pydronecan's messages ask for them; the disk keeps them."""

import os

import pytest
from dronecan import transport, uavcan

from delfim.canproxy.dronecan.datatypes import ALLOCATION, NODE_STATUS, decode, node_status
from delfim.canproxy.dronecan.transfers import STATUS, Publisher, TransferReceiver
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING
from delfim.clock import SystemClock
from delfim.frames import Frame, extended
from delfim.services.numbering import Numbering, keep, known_numbers

IDENTITY = bytes(range(16))


@pytest.fixture
def devices(tmp_path):
    with open_can(f"canloop:numbers-{os.getpid()}-{tmp_path.name[-8:]}") as bus:
        bus.bind(ANYTHING)
        bus.settimeout(60)
        yield bus


@pytest.fixture
def numbering(devices, tmp_path):
    receiver = TransferReceiver((ALLOCATION, NODE_STATUS))
    with open_can(f"canloop:{devices.name.removeprefix('canloop:')}") as bus:
        bus.setblocking(False)
        bus.bind(*receiver.filters)
        yield Numbering(bus, receiver, 10, tmp_path / "numbers.json", SystemClock())


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
