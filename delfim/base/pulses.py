"""The records between the program that commands motors by pulses, and the outlet, the process that writes them.

A command is RECORD: a counter, which a new command raises, whether motors may turn, and a fraction for each of the CHANNELS of
the hardware in ten-thousandths. The outlet answers each one: its counter, a word of STATES, and its trouble in words.
"""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from delfim.base.errors import FormatError

CHANNELS: Final = 16  # a PCA9685 has as many
FULL: Final = 10_000
SILENT_S: Final = 0.7  # of the commanding program; its own repetition begins after 0.5 to 0.6 s without navigation
WORDS: Final = 200  # bytes of a trouble, at most
STATES: Final = ("stopped", "arming", "running")
_RECORD: Final = struct.Struct(f"<IB{CHANNELS}h")
_ANSWER: Final = struct.Struct("<IB")  # the head of a command, too
_new = tuple.__new__  # in half the time of PulseAnswer(...)


class PulseCommand(NamedTuple):
    counter: int  # 32 bits
    run: bool  # False: every motor stops, whatever the fractions
    fractions: tuple[float, ...]  # of each channel, -1 to 1


class PulseAnswer(NamedTuple):
    counter: int  # of the last command that was taken
    state: str  # one of STATES
    trouble: str  # of the hardware; empty: none


def socket_path(run_directory: str) -> Path:
    """The path of the outlet's socket."""
    return Path(run_directory) / "outlet"


def pack_command(counter: int, run: bool, fractions: Sequence[float]) -> bytes:
    """Pack a command of all channels' fractions, -1 to 1, finite."""
    return _RECORD.pack(counter & 0xFFFF_FFFF, run, *[round(each * FULL) for each in fractions])


def unpack_command(data: bytes) -> PulseCommand:
    """Unpack a command. Raises FormatError for another length or a fraction beyond full."""
    if len(data) != _RECORD.size:
        raise FormatError(f"{len(data)} bytes are no command")
    counter, run, *fractions = _RECORD.unpack(data)
    if max(fractions) > FULL or min(fractions) < -FULL:
        raise FormatError("a fraction is beyond full")
    return PulseCommand(counter, run == 1, tuple([each / FULL for each in fractions]))


def unpack_head(data: bytes) -> tuple[int, bool]:
    """Counter and `run` of a command, for an outlet that is played and turns no motors."""
    counter, run = _ANSWER.unpack_from(data)
    return counter, run == 1


def pack_answer(answer: PulseAnswer) -> bytes:
    return _ANSWER.pack(answer.counter, STATES.index(answer.state)) + answer.trouble.encode()[:WORDS]


def unpack_answer(data: bytes) -> PulseAnswer:
    """Unpack an answer of the outlet. Raises FormatError."""
    if len(data) < _ANSWER.size or data[4] >= len(STATES):
        raise FormatError("no answer of an outlet")
    counter, state = _ANSWER.unpack_from(data)
    return _new(PulseAnswer, (counter, STATES[state], data[_ANSWER.size :].decode(errors="replace")))
