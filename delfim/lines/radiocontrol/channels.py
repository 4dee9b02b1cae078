"""The 16 channels of a hand-set as SBUS and CRSF both carry them: 11 bits each, lowest bit first, in 22 bytes."""

from typing import Final, Protocol

CHANNELS: Final = 16
PACKED: Final = 22  # bytes
MIDDLE: Final = 992  # 1500 us; 172 is 988 us, 1811 is 2012 us (Betaflight and the CRSF specification agree)
STEP_US: Final = 5.0 / 8.0

Pulses = tuple[float, ...]  # of all channels, in us, as a servo would get them: 880 to 2160


class Decoder(Protocol):
    """Decodes bytes of a receiver to channels. It never raises, and keeps less than one frame of what it was given."""

    lost: str  # why the last frame says that the radio is lost, in words; empty: it does not
    quality_pct: int | None  # of the radio, as the receiver tells it; None: it does not

    def feed(self, data: bytes) -> list[Pulses]: ...  # of each frame that came whole and fresh from the hand-set


def unpack(data: bytes) -> Pulses:
    """Unpack the pulses of 22 bytes."""
    bits = int.from_bytes(data, "little")
    return tuple([1500.0 + ((bits >> 11 * channel & 0x7FF) - MIDDLE) * STEP_US for channel in range(CHANNELS)])
