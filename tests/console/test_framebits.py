"""Frame lengths against the specification done bit by bit."""

from hypothesis import given
from hypothesis import strategies as st

from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame, extended, standard
from delfim.console.terminal.busstat import frame_bits

frames = st.builds(
    lambda arb, data: Frame(arb, data),
    st.builds(standard, st.integers(0, 0x7FF), st.booleans()) | st.builds(extended, st.integers(0, 0x1FFFFFFF), st.booleans()),
    st.binary(max_size=8) | st.integers(0, 8).map(bytes) | st.integers(0, 8).map(lambda length: b"\xff" * length),
)


def bit_by_bit(frame: Frame) -> int:
    def field(value: int, length: int) -> list[int]:
        return [value >> place & 1 for place in reversed(range(length))]

    remote = int(bool(frame.arb & CAN_RTR))
    bits = [0, *field(frame.identifier >> 18 if frame.extended else frame.identifier, 11)]
    bits += [1, 1, *field(frame.identifier & 0x3FFFF, 18), remote, 0, 0] if frame.extended else [remote, 0, 0]
    bits += field(len(frame.data), 4)
    if not remote:
        bits += [bit for byte in frame.data for bit in field(byte, 8)]
    crc = 0
    for bit in bits:
        following = bit ^ (crc >> 14 & 1)
        crc = crc << 1 & 0x7FFF
        if following:
            crc ^= 0x4599
    sent: list[int] = []
    for bit in bits + field(crc, 15):
        sent.append(bit)
        if len(sent) >= 5 and len(set(sent[-5:])) == 1:
            run = next((back for back, old in enumerate(reversed(sent)) if old != bit), len(sent))
            if run == 5:
                sent.append(1 - bit)
    return len(sent) + 13


@given(frames)
def test_as_the_specification_says(frame: Frame) -> None:
    assert frame_bits(frame) == bit_by_bit(frame)


@given(frames)
def test_between_no_stuff_bit_and_one_in_four(frame: Frame) -> None:
    payload = 0 if frame.remote else 8 * len(frame.data)
    plain, stuffable = (67, 54) if frame.extended else (47, 34)
    assert plain + payload <= frame_bits(frame) <= plain + payload + (stuffable + payload - 1) // 4


def test_an_error_frame_is_the_controllers_own() -> None:
    assert frame_bits(Frame(4 << 3 | CAN_IDE | CAN_ERR, bytes(8))) == 0
