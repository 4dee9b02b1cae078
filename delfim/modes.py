"""The modes of the boat, one row each: names and numbers stand nowhere else. A mode is its row and the file of its name in
`delfim/vehicle/control/` (CONTRIBUTING.md, "How to add a mode").
"""

from enum import IntEnum

from delfim.errors import FormatError


class Mode(IntEnum):
    """Numbers are those of the console's link (ArduRover's where it has the mode)."""

    MANUAL = 0
    HEADING = 3
    IDLE = 4
    HOLD = 5
    PLAY = 10
    HOME = 12  # SMART_RTL: back along the driven track, not straight
    GOTO = 15
    PATH = 100
    GREX = 101
    COURSE = 102


PAYLOADS = 200  # on the console's link, from this number on: a payload program has the boat, by its place in the vehicle's file


def mode_named(text: str) -> Mode:
    """Raises FormatError for a mode that does not exist, naming those that do."""
    try:
        return Mode[text.upper()]
    except KeyError:
        raise FormatError(f"no mode {text!r}: there are {', '.join(m.name.lower() for m in Mode)}") from None
