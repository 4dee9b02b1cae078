"""Requests to DroneCAN nodes, and answers to theirs (specification, chapter 4.1), for a tool: one request at a time, no clock.

A request and its answer are services: identifiers as in nodeservices.py. An answer has the number of its request. Parameters,
firmware and files: the DSDL definitions uavcan/protocol/param and uavcan/protocol/file.
"""

import math
import struct
from collections import Counter
from typing import Final, NamedTuple

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_IDE, Frame, extended
from delfim.canproxy.dronecan.fields import DataType
from delfim.canproxy.dronecan.nodeservices import GET_NODE_INFO, RESTART_NODE
from delfim.canproxy.dronecan.transfers import END, NUMBER, SERVICE, START, TOGGLE, checksum, framed

GET_SET: Final = DataType("GetSet", 11, 0xFB10, ())
EXECUTE_OPCODE: Final = DataType("ExecuteOpcode", 10, 0xD7D4, ())
BEGIN_FIRMWARE_UPDATE: Final = DataType("BeginFirmwareUpdate", 40, 0x729E, ())
READ: Final = DataType("Read", 48, 0x2F12, ())
SERVICES: Final = {
    kind.id: kind for kind in (GET_NODE_INFO, RESTART_NODE, GET_SET, EXECUTE_OPCODE, BEGIN_FIRMWARE_UPDATE, READ)
}
SAVE, ERASE = 0, 1  # of ExecuteOpcode
RESTART: Final = (0xACCE551B1E).to_bytes(5, "little")  # the number without which RestartNode is not meant
PRIORITY: Final = 30  # of a tool, which never keeps a motor's command waiting
ASKS: Final = 0x8000  # in the identifier
LENGTH_MAX: Final = 600  # bytes of a transfer, longer than any of these
STREAMS: Final = 16
NAME_MAX, TEXT_MAX, PATH_MAX = 92, 128, 200
CHUNK_BYTES: Final = 256  # of a file; fewer end it
Value = int | float | bool | str | None


class ServiceTransfer(NamedTuple):
    """A whole request or answer. `source` is the node that sent it, `number` the request's."""

    kind: DataType
    is_request: bool
    source: int
    number: int
    payload: bytes


class Parameter(NamedTuple):
    """A parameter of a node; None: not told."""

    name: str
    value: Value
    default: Value = None
    greatest: Value = None
    least: Value = None


def service_frames(kind: DataType, source: int, to: int, number: int, payload: bytes, *, asks: bool) -> list[tuple[int, bytes]]:
    """The frames of a request, or of an answer."""
    arb = PRIORITY << 24 | kind.id << 16 | (ASKS if asks else 0) | to << 8 | SERVICE | source
    return framed(extended(arb), kind.seed, number & NUMBER, payload)


class ServiceReceiver:
    """Assembles what comes to one node. Damaged transfers are counted in `errors`; whoever asked asks again."""

    def __init__(self, node: int) -> None:
        self._node, self._streams = node, dict[int, tuple[int, bytes]]()  # by identifier: the last byte due next, the data
        self.errors: Counter[str] = Counter()

    def feed(self, frame: Frame) -> ServiceTransfer | None:
        """The transfer that this frame completes."""
        word, data = frame.identifier, frame.data
        if frame.arb & 7 != CAN_IDE or not word & SERVICE or word >> 8 & 0x7F != self._node or not data:
            return None
        kind, tail = SERVICES.get(word >> 16 & 0xFF), data[-1]
        if kind is None:
            return None
        if tail & START:
            due, before = tail & ~END, b""
        else:
            due, before = self._streams.get(word, (-1, b""))
        self._streams.pop(word, None)
        if tail & ~END != due or bool(tail & START and tail & TOGGLE) or len(before) > LENGTH_MAX:
            self.errors["incomplete"] += 1
            return None
        data = before + data[:-1]
        if not tail & END:
            if len(self._streams) >= STREAMS:
                del self._streams[next(iter(self._streams))]
            self._streams[word] = (tail & ~START ^ TOGGLE, data)
            return None
        if not tail & START:
            if len(data) < 2 or checksum(data[2:], kind.seed) != int.from_bytes(data[:2], "little"):
                self.errors["wrong checksum"] += 1
                return None
            data = data[2:]
        return ServiceTransfer(kind, bool(word & ASKS), word & 0x7F, tail & NUMBER, data)


# Parameters.


def get_set(index: int = 0, name: str = "", value: Value = None) -> bytes:
    """The request for a parameter: by its name, or by its index where that is empty; with a value it is set first. Raises
    FormatError."""
    encoded = _text(name, NAME_MAX)
    tag, content = _value(value)
    return bytes((index & 0xFF, index >> 8 << 3 | tag)) + content + encoded


def _value(value: Value) -> tuple[int, bytes]:
    """The tag of the union, and what follows it."""
    if value is None:
        return 0, b""
    if isinstance(value, bool):
        return 3, bytes((value,))
    if isinstance(value, str):
        text = _text(value, TEXT_MAX)
        return 4, bytes((len(text),)) + text
    try:
        return (1, struct.pack("<q", value)) if isinstance(value, int) else (2, struct.pack("<f", value))
    except (struct.error, OverflowError):
        raise FormatError(f"{value} has no room in the message") from None


def _text(text: str, most: int) -> bytes:
    encoded = text.encode()
    if len(encoded) > most:
        raise FormatError(f"{text[:20]}...: {len(encoded)} bytes, and {most} are the most")
    return encoded


def read_parameter(payload: bytes) -> Parameter | None:
    """The parameter in an answer, None where there is none of that name or index. Raises FormatError."""
    values, at = list[Value](), 0
    for bits in (7, 7, 3, 3):  # of the tag: value, default, and the numbers greatest and least
        if at >= len(payload):
            raise FormatError("GetSet: cut short")
        value, at = _read_value(payload, at + 1, payload[at] & bits)
        values.append(value)
    name = payload[at:].decode("utf-8", "replace")
    return Parameter(name, *values) if name else None


def _read_value(payload: bytes, at: int, tag: int) -> tuple[Value, int]:
    try:
        if tag == 0:
            return None, at
        if tag == 1:
            return int(struct.unpack_from("<q", payload, at)[0]), at + 8
        if tag == 2:
            return float(struct.unpack_from("<f", payload, at)[0]), at + 4
        if tag == 3:
            return bool(payload[at]), at + 1
        if tag == 4:
            end = at + 1 + payload[at]
            if end <= len(payload):
                return payload[at + 1 : end].decode("utf-8", "replace"), end
    except (struct.error, IndexError):
        pass
    raise FormatError("GetSet: a value that is no value")


def meant(asked: str, now: Parameter) -> Value:
    """The value of these words, of the kind that the parameter has now. Raises FormatError with the reason."""
    try:
        value: Value = asked
        if isinstance(now.value, bool):
            value = {"0": False, "false": False, "1": True, "true": True}[asked.lower()]
        elif isinstance(now.value, int):
            value = int(asked, 0)
        elif isinstance(now.value, float):
            value = float(asked)
            if not math.isfinite(value):
                raise ValueError
    except (KeyError, ValueError):
        raise FormatError(f"{now.name}: {asked!r} is no value like {now.value}") from None
    for bound, is_beyond, word in ((now.least, _below, "least"), (now.greatest, _above, "greatest")):
        if is_beyond(value, bound):
            raise FormatError(f"{now.name}: {asked} is beyond {bound}, the {word} that the node takes")
    return value


def _below(value: Value, bound: Value) -> bool:
    return isinstance(value, int | float) and isinstance(bound, int | float) and not math.isnan(bound) and value < bound


def _above(value: Value, bound: Value) -> bool:
    return isinstance(value, int | float) and isinstance(bound, int | float) and not math.isnan(bound) and value > bound


def execute(code: int) -> bytes:
    """The request to save or erase all parameters."""
    return bytes((code,)) + bytes(6)


# Firmware.


def begin_firmware_update(server: int, path: str) -> bytes:
    """The request to fetch a new firmware from this node. Raises FormatError."""
    return bytes((server,)) + _text(path, PATH_MAX)


def read_request(payload: bytes) -> tuple[int, str]:
    """Offset and path of the file that a node asks for. Raises FormatError."""
    if len(payload) < 5:
        raise FormatError("file.Read: cut short")
    return int.from_bytes(payload[:5], "little"), payload[5:].decode("utf-8", "replace")


def chunk(data: bytes, error: int = 0) -> bytes:
    """The answer to a node that reads a file: at most CHUNK_BYTES of it, or the error."""
    return error.to_bytes(2, "little") + data
