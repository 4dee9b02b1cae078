"""Arbitration field, kernel identifier and `struct can_frame`: three spellings of the same frame."""

import socket
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.base.frames import (
    CAN_ANY,
    CAN_ERR,
    CAN_FRAME,
    CAN_ID,
    CAN_IDE,
    CAN_RTR,
    Frame,
    extended,
    from_can_id,
    identifier,
    standard,
    to_can_frame,
    to_can_id,
)

standards = st.integers(0, 0x7FF)
extendeds = st.integers(0, 0x1FFFFFFF)
arbs = st.one_of(
    st.builds(standard, standards, st.booleans()),
    st.builds(extended, extendeds, st.booleans()),
    st.builds(lambda error_class: extended(error_class) | CAN_ERR, extendeds),
)
data = st.binary(max_size=8)


def test_bits_of_figure_5_5() -> None:
    assert standard(0x7FF) == 0xFFE00000
    assert extended(0x1FFFFFFF) == 0xFFFFFFFC
    assert (CAN_IDE, CAN_RTR, CAN_ERR) == (4, 2, 1)
    assert CAN_ID == 0xFFFFFFF8
    assert standard(1, remote=True) == 0x00200002
    assert extended(1, remote=True) == 0x0000000E


def test_constants_are_those_of_the_kernel() -> None:
    assert to_can_id(extended(0x12345)) == socket.CAN_EFF_FLAG | 0x12345
    assert to_can_id(standard(0x123, remote=True)) == socket.CAN_RTR_FLAG | 0x123
    assert from_can_id(socket.CAN_ERR_FLAG | 0x40) == extended(0x40) | CAN_ERR
    assert CAN_FRAME.size == 16


def test_image_of_a_frame() -> None:
    assert to_can_frame(standard(0x123), b"\1\2\3") == struct.pack("=I", 0x123) + b"\3\0\0\0\1\2\3\0\0\0\0\0"


@given(standards, st.booleans())
def test_standard(value: int, remote: bool) -> None:
    frame = Frame(standard(value, remote))
    assert (frame.identifier, frame.extended, frame.remote, frame.error) == (value, False, remote, False)
    assert identifier(frame.arb) == value


@given(extendeds, st.booleans())
def test_extended(value: int, remote: bool) -> None:
    frame = Frame(extended(value, remote))
    assert (frame.identifier, frame.extended, frame.remote, frame.error) == (value, True, remote, False)
    assert identifier(frame.arb) == value


@given(arbs)
def test_kernel_identifier_round_trip(arb: int) -> None:
    assert from_can_id(to_can_id(arb)) == arb


@given(arbs, data)
def test_the_bytes_of_the_kernels_frame(arb: int, payload: bytes) -> None:
    can_id, length, padded = struct.unpack("=IB3x8s", to_can_frame(arb, payload))
    assert (from_can_id(can_id), padded) == (arb, payload.ljust(8, b"\0"))
    assert length == len(payload)


def on_the_wire(frame: Frame) -> tuple[int, ...]:
    """The bits that arbitrate, in the order in which they are sent (CAN 2.0 B, 3.2): 0 is dominant."""
    if not frame.extended:
        return *(frame.identifier >> i & 1 for i in reversed(range(11))), int(frame.remote), 0
    base = (frame.identifier >> i & 1 for i in reversed(range(18, 29)))
    return *base, 1, 1, *(frame.identifier >> i & 1 for i in reversed(range(18))), int(frame.remote)


@given(extendeds, extendeds, st.booleans(), st.booleans())
def test_lower_number_wins_the_bus_in_extended_format(a: int, b: int, remote_a: bool, remote_b: bool) -> None:
    first, second = Frame(extended(a, remote_a)), Frame(extended(b, remote_b))
    assert (first.arb < second.arb) == (on_the_wire(first) < on_the_wire(second))


@given(standards, standards, st.booleans(), st.booleans())
def test_lower_number_wins_the_bus_in_standard_format(a: int, b: int, remote_a: bool, remote_b: bool) -> None:
    first, second = Frame(standard(a, remote_a)), Frame(standard(b, remote_b))
    assert (first.arb < second.arb) == (on_the_wire(first) < on_the_wire(second))


@given(standards, extendeds)
def test_lower_number_wins_the_bus_across_formats(a: int, b: int) -> None:
    first, second = Frame(standard(a)), Frame(extended(b))
    assert (first.arb < second.arb) == (on_the_wire(first) < on_the_wire(second))


@given(arbs)
def test_any_accepts_what_was_on_the_bus_and_no_error_frame(arb: int) -> None:
    assert ((arb ^ 0) & ~CAN_ANY & 0xFFFFFFFF == 0) == (not arb & CAN_ERR)


@pytest.mark.parametrize("value", [-1, 0x800])
def test_standard_identifier_out_of_range(value: int) -> None:
    with pytest.raises(FormatError, match="outside"):
        standard(value)


@pytest.mark.parametrize("value", [-1, 0x20000000])
def test_extended_identifier_out_of_range(value: int) -> None:
    with pytest.raises(FormatError, match="outside"):
        extended(value)


def test_nine_bytes_are_too_many() -> None:
    with pytest.raises(FormatError, match="9 bytes"):
        to_can_frame(standard(1), bytes(9))
