"""The text of `candump -l`, which every CAN tool reads: one frame a line.

    (1262304000.000123) can0 123#1122 R            standard frame; extended ones have eight digits
    (1262304000.000123) can0 123#R7 T              remote frame with its data length code, sent by this computer
    (1262304000.000123) can0 20000004#00040000 R   error frame: the class with bit 0x20000000, the controller's data

Stamps are cut to microseconds. Lines other than CAN 2.0 frames (comments, CAN FD) are not read. Facts from can-utils' lib.h.
"""

import re
from typing import Final

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame, extended, from_can_id, standard

_ERROR: Final = 1 << 29  # CAN_ERR_FLAG
_LINE: Final = re.compile(
    r"\(([0-9]{1,10})\.([0-9]{6}(?:[0-9]{3})?)\)\s+([!-~]+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    r"#(?:[Rr]([0-8]?)|((?:[0-9A-Fa-f]{2}){0,8}))(?:_[0-9A-Fa-f])?(?:\s+([RT]))?\s*"
)


def format_line(frame: Frame, device: str) -> str:
    """The line of a frame, with its end. `device` is a name without blanks; `t_ns` is not negative."""
    arb, data, t_ns, _, sent_here = frame
    stamp = str(t_ns).zfill(19)  # a format specification takes twice as long
    if arb & CAN_ERR:
        identifier = f"{arb >> 3 | _ERROR:08X}"
    elif arb & CAN_IDE:
        identifier = f"{arb >> 3:08X}"
    else:
        identifier = f"{arb >> 21:03X}"
    body = data.hex().upper() if not arb & CAN_RTR else f"R{len(data) or ''}"
    return f"({stamp[:-9]}.{stamp[-9:-3]}) {device} {identifier}#{body} {'T' if sent_here else 'R'}\n"


def parse_line(line: str) -> tuple[str, Frame]:
    """Parse a line to device and frame. Raises FormatError if it holds no CAN 2.0 frame."""
    match = _LINE.fullmatch(line)
    if not match:
        raise FormatError(f"not a frame in candump's format: {line.strip()[:80]!r}")
    seconds, fraction, device, digits, length, data, direction = match.groups()
    number = int(digits, 16)
    if number & _ERROR and len(digits) == 8:
        if number >> 30 or data is None:
            raise FormatError(f"not an error frame: {line.strip()[:80]!r}")
        arb = from_can_id(number)
    else:
        arb = (extended if len(digits) == 8 else standard)(number, remote=data is None)
    payload = bytes(int(length or 0)) if data is None else bytes.fromhex(data)
    t_ns = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0"))
    return device, Frame(arb, payload, t_ns, sent_here=direction == "T")
