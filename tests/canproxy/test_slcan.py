"""slcan: the protocol without sockets, and python-can's client against the service."""

import itertools
import os
from collections.abc import Iterator

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.frames import Frame, extended, standard
from delfim.canproxy.canloop import open_canloop
from delfim.canproxy.cantcp import slcan
from delfim.canproxy.cantcp.slcan import DONE, REFUSED, SlcanSession
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.canproxy.socketcand import Close, Enter, Open, Reply, Transmit
from tests.canproxy.test_cantcpd import TIMEOUT_S, Served, raw

ARBS = st.one_of(st.integers(0, 0x7FF).map(standard), st.integers(0, 0x1FFFFFFF).map(extended))
_numbers = itertools.count()


def opened() -> SlcanSession:
    session = SlcanSession("can0")
    assert list(session.feed(b"O\r")) == [Open("can0"), Enter("raw"), Reply(DONE)]
    return session


@given(ARBS, st.binary(max_size=8))
def test_a_frame_comes_back_from_its_text(arb: int, data: bytes) -> None:
    assert list(opened().feed(slcan.raw_text(Frame(arb, data)))) == [Transmit(arb, data), Reply(DONE)]


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (Frame(standard(0x123), b"\x11\xaa"), b"t123211AA\r"),
        (Frame(standard(7), b""), b"t0070\r"),
        (Frame(extended(0x1FFFFFFF), b"\0"), b"T1FFFFFFF100\r"),
    ],
)
def test_text_of_frames(frame: Frame, text: bytes) -> None:
    assert slcan.raw_text(frame) == text


@pytest.mark.parametrize(
    "line",
    ["t", "t12", "t123", "t1239", "t1232AA", "t1231A", "tGGG0", "t-120", "t8000", "T200000000", "r1230", "d1230", "Z1", "?"],
)
def test_what_means_nothing_is_refused_and_counted(line: str) -> None:
    session = opened()
    assert list(session.feed(line.encode() + b"\r")) == [Reply(REFUSED)]
    assert session.malformed == 1


def test_what_clients_say_before_they_open() -> None:
    session = SlcanSession("can0")
    said = list(session.feed(b"\r\r\rC\rS6\rs0014\rV\rN\rF\rZ0\r"))
    told = (slcan.VERSION, slcan.SERIAL, slcan.STATUS)
    assert said == [Reply(text) for text in (*[DONE] * 6, *told, DONE)]
    assert list(session.feed(b"t1230\r")) == [Reply(REFUSED)], "not open"


def test_open_twice_and_closed() -> None:
    session = opened()
    assert list(session.feed(b"O\rC\rC\rL\r")) == [
        Reply(DONE),
        Close(),
        Reply(DONE),
        Reply(DONE),
        Open("can0"),
        Enter("raw"),
        Reply(DONE),
    ]


def test_lines_may_be_cut_anywhere() -> None:
    session, said = opened(), []
    for byte in b"t1230\r\nT000000011AB\r":
        said += session.feed(bytes([byte]))
    assert [action for action in said if isinstance(action, Transmit)] == [
        Transmit(standard(0x123), b""),
        Transmit(extended(1), b"\xab"),
    ]


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_nothing_escapes_and_nothing_piles_up(pieces: list[bytes]) -> None:
    session = opened()
    for piece in pieces:
        list(session.feed(piece))
        assert len(session._rest) <= slcan.LINE_BYTES


@pytest.fixture
def name() -> str:
    return f"s{os.getpid() % 100000}-{next(_numbers)}"


@pytest.fixture
def bus(name: str) -> Iterator[CanSocket]:
    with open_canloop(name) as one:
        one.settimeout(TIMEOUT_S)
        one.bind(ANYTHING)
        yield one


def test_python_can_over_tcp(bus: CanSocket, name: str) -> None:
    with (
        Served([f"canloop:{name}"], slcan=("127.0.0.1:0",)) as served,
        can.Bus(
            interface="slcan", channel=f"socket://127.0.0.1:{served.slcan_port}", sleep_after_open=0, bitrate=1_000_000
        ) as client,
    ):
        served.wait_for(
            lambda: [one for one in served.server.clients.inside if one.session.mode == "raw" and not one._outbox.is_held]
        )
        for number in range(100):
            bus.sendto(bytes([number]), CanAddress(extended(number)))
        heard = []
        while len(heard) < 100:
            message = client.recv(TIMEOUT_S)
            assert message is not None
            heard.append((message.arbitration_id, message.is_extended_id, bytes(message.data)))
        assert heard == [(number, True, bytes([number])) for number in range(100)]
        client.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\1\2"))
        assert bus.recvmsg()[:2] == (standard(0x123), b"\1\2")
        client.send(can.Message(arbitration_id=0x40, is_extended_id=False, data=b"barred"))
        served.wait_for(lambda: [one for one in served.server.clients.inside if one.counts["refused"] == 1])


def test_beside_a_client_of_socketcand(bus: CanSocket, name: str) -> None:
    with Served([f"canloop:{name}"], slcan=("127.0.0.1:0",)) as served, raw(served, name) as peer:
        with can.Bus(interface="slcan", channel=f"socket://127.0.0.1:{served.slcan_port}", sleep_after_open=0) as client:
            served.wait_for(
                lambda: all(one.session.mode == "raw" and not one._outbox.is_held for one in served.server.clients.inside)
            )
            client.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\1"))
            assert peer.frame() == ("123", "01"), "what one client sends the other hears"
            peer.say("< send 124 1 2 >")
            message = client.recv(TIMEOUT_S)
            assert message is not None
            assert (message.arbitration_id, bytes(message.data)) == (0x124, b"\2")
        assert peer.silent()
        served.wait_for(lambda: len(served.server.clients.inside) == 1)
