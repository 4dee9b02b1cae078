"""Depth and wind as ArduPilot tells them: two messages of its own set, which pymavlink's `development` does not contain.

Importing ArduPilot's whole set for them would take five megabytes of memory. Numbers, fields and check bytes are those of the
public definition (ardupilotmega.xml); `tests/vehicle/test_measured.py` compares them with pymavlink's.
"""

import struct
from typing import Any, Final

from pymavlink.dialects.v20 import development


class _Message(development.MAVLink_message):  # type: ignore[misc]
    """Fields are given in the order of `fieldnames` and packed in that of `ordered_fieldnames`."""

    def __init__(self, *values: float) -> None:
        super().__init__(self.id, self.msgname)
        self._fieldnames, self._instance_field = self.fieldnames, self.instance_field
        for name, value in zip(self.fieldnames, values, strict=True):
            setattr(self, name, value)

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        payload = self.unpacker.pack(*(getattr(self, name) for name in self.ordered_fieldnames))
        packed: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return packed


class WaterDepth(_Message):
    """WATER_DEPTH: depth below the transducer, m, with the place where it was measured; temperature NaN: not known."""

    id, msgname, crc_extra = 11038, "WATER_DEPTH", 47
    fieldnames = [  # noqa: RUF012
        "time_boot_ms", "id", "healthy", "lat", "lng", "alt", "roll", "pitch", "yaw", "distance", "temperature",
    ]  # fmt: skip
    ordered_fieldnames = [fieldnames[0], *fieldnames[3:], *fieldnames[1:3]]  # noqa: RUF012
    orders = [0, 9, 10, 1, 2, 3, 4, 5, 6, 7, 8]  # noqa: RUF012
    lengths, array_lengths = 11 * [1], 11 * [0]
    unpacker = struct.Struct("<IiiffffffBB")


class Wind(_Message):
    """WIND: where the true wind comes from, degrees from true north; its speed, m/s, and its vertical part."""

    id, msgname, crc_extra = 168, "WIND", 1
    fieldnames = ordered_fieldnames = ["direction", "speed", "speed_z"]  # noqa: RUF012
    orders = [0, 1, 2]  # noqa: RUF012
    lengths, array_lengths = 3 * [1], 3 * [0]
    unpacker = struct.Struct("<fff")


MESSAGES: Final = (WaterDepth, Wind)
