"""The black box in other formats: plain candump text, and through python-can Vector's ASC and BLF and ASAM's MF4."""

from collections.abc import Iterable
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any, Final

from delfim.base.errors import DelfimError
from delfim.base.frames import Frame
from delfim.logging.candump import format_line

FORMATS: Final = ("log", "asc", "blf", "mf4")


def write(frames: Iterable[tuple[str, Frame]], file: Path, form: str) -> int:
    """Write frames, each with the name of its device, to a file in one of FORMATS. Returns how many.

    Channels of formats that have numbers are counted from 1, in the order in which the devices first speak.
    """
    if form == "log":
        return _candump(frames, file)
    import can

    if form == "mf4":
        import asammdf  # noqa: F401  python-can's own message would say less

    first, rest = next(iter(frames := iter(frames)), None), frames
    if first is None:
        raise DelfimError("the black box has no frame in this time")
    begin_s = first[1].t_ns / 1e9
    writer = _asc(file, begin_s) if form == "asc" else _mf4(file, begin_s) if form == "mf4" else can.BLFWriter(str(file))
    channels: dict[str, int] = {}
    count = 0
    with writer:
        for device, frame in chain([first], rest):
            writer.on_message_received(message(frame, channels.setdefault(device, len(channels))))
            count += 1
    return count


def _asc(file: Path, begin_s: float) -> Any:
    """Open a writer of ASC. python-can puts the time of the export into the head; here it is that of the first frame, as in the
    lines below."""
    import can

    stream = file.open("w", encoding="utf-8")
    writer = can.ASCWriter(stream)
    stream.seek(0)
    stream.truncate()
    begin = datetime.fromtimestamp(begin_s)  # noqa: DTZ006  the format has the computer's own time
    stream.write(f"date {begin:%a %b %d %H:%M:%S}.{begin.microsecond // 1000:03} {begin.year}\n")
    stream.write("base hex  timestamps absolute\ninternal events logged\n")
    return writer


def _mf4(file: Path, begin_s: float) -> Any:
    """Open a writer of MF4, whose samples count from the head's time, and would be negative without this."""
    import can

    writer = can.MF4Writer(str(file))
    writer._mdf.header.start_time = datetime.fromtimestamp(begin_s, UTC)
    writer._start_time = writer.last_timestamp = begin_s
    return writer


def message(frame: Frame, channel: int | str | None = None) -> Any:
    """Convert a frame to python-can's; channels count from 0."""
    import can

    return can.Message(
        timestamp=frame.t_ns / 1e9,
        arbitration_id=frame.identifier,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        is_error_frame=frame.error,
        is_rx=not frame.sent_here,
        channel=channel,
        dlc=len(frame.data),
        data=None if frame.remote else frame.data,
    )


def _candump(frames: Iterable[tuple[str, Frame]], file: Path) -> int:
    count = 0
    with file.open("w", encoding="ascii", newline="\n") as text:
        for device, frame in frames:
            text.write(format_line(frame, device))
            count += 1
    return count
