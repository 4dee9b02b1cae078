"""The black box in the formats of others: plain candump text, and through python-can Vector's ASC and BLF and ASAM's MF4."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from delfim.frames import Frame
from delfim.logging.candump import format_line
from delfim.logging.export import needed

FORMATS: Final = ("log", "asc", "blf", "mf4")


def write(frames: Iterable[tuple[str, Frame]], file: Path, form: str) -> int:
    """Frames, each with the name of its device, to a file in one of FORMATS. Returns how many.

    Channels of formats that have numbers are counted from 1, in the order in which the devices first speak. Raises DelfimError
    for a package that is missing.
    """
    if form == "log":
        return _candump(frames, file)
    import can

    if form == "mf4":
        needed("asammdf")
    writer = {"asc": can.ASCWriter, "blf": can.BLFWriter, "mf4": can.MF4Writer}[form](str(file))
    channels: dict[str, int] = {}
    count = 0
    with writer:
        for device, frame in frames:
            writer.on_message_received(message(frame, channels.setdefault(device, len(channels))))
            count += 1
    return count


def message(frame: Frame, channel: int | str | None = None) -> Any:
    """A frame as python-can has it; channels count from 0."""
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
    with file.open("w", encoding="ascii") as text:
        for device, frame in frames:
            text.write(format_line(frame, device))
            count += 1
    return count
