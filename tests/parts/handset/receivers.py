"""What receivers of hand-sets send, made by the formats' definitions, and independent of the decoders."""

MIDDLE_CRSF = bytes.fromhex("c81816e0031ff8c0073ef0810f7ce0031ff8c0073ef0810f7cad")
MIDDLE_SBUS = bytes.fromhex("0fe0031ff8c0073ef0810f7ce0031ff8c0073ef0810f7c0000")


def packed(values: list[int]) -> bytes:
    """16 values of 11 bits, bit by bit, lowest first."""
    bits = "".join(format(value, "011b")[::-1] for value in values)
    return bytes(int(bits[at : at + 8][::-1], 2) for at in range(0, 176, 8))


def values(pulses_us: dict[int, float]) -> list[int]:
    """Of 16 channels at 1500 us, but for these; channels are counted from 1."""
    return [round(992 + (pulses_us.get(channel, 1500.0) - 1500.0) * 1.6) for channel in range(1, 17)]


def sbus(pulses_us: dict[int, float], flags: int = 0) -> bytes:
    return b"\x0f" + packed(values(pulses_us)) + bytes((flags, 0))


def crsf(pulses_us: dict[int, float]) -> bytes:
    return crsf_frame(0x16, packed(values(pulses_us)))


def crsf_link(quality_pct: int) -> bytes:
    return crsf_frame(0x14, bytes((60, 65, quality_pct, 5, 0, 2, 3, 50, 100, 5)))


def crsf_frame(kind: int, payload: bytes) -> bytes:
    body = bytes((kind,)) + payload
    return bytes((0xC8, len(body) + 1)) + body + bytes((_crc8(body),))


def _crc8(data: bytes) -> int:
    """The long division of CRC-8 with the polynomial 0xD5, without a table."""
    number = int.from_bytes(data) << 8
    for bit in range(8 * len(data) + 7, 7, -1):
        if number >> bit & 1:
            number ^= 0x1D5 << bit - 8
    return number
