"""The modes of the boat, one row each: names and numbers stand nowhere else. A mode is its row and the file of its name in
`delfim/vehicle/control/modes/` (CONTRIBUTING.md, "How to add a mode").
"""

from enum import IntEnum

from delfim.base.errors import FormatError


class Mode(IntEnum):
    """The modes by number: that of the console's link (ArduRover's where it has the mode)."""

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
    TRIAL = 103
    UNSTICK = 104


PAYLOADS = 200  # on the console's link, from this number on: a payload program has the boat, by its place in the vehicle's file
OF_PARTS = range(120, 140)  # numbers for the modes of a laboratory's parts


def join(name: str, number: int) -> Mode:
    """Add the mode of a laboratory's part, for this process. Raises ValueError where the number is not one of OF_PARTS, or
    another mode has it or the name."""
    key = name.upper()
    if number in OF_PARTS and key in Mode.__members__ and Mode[key] == number:
        return Mode[key]
    if number not in OF_PARTS or number in Mode._value2member_map_ or key in Mode.__members__:
        raise ValueError(
            f"mode {name} cannot have the number {number}: 120 to 139 are for parts, and each name and number is one"
        )
    mode = int.__new__(Mode, number)  # as the enumeration makes its own
    mode._name_, mode._value_ = key, number
    Mode._member_names_.append(key)
    Mode._member_map_[key] = Mode._value2member_map_[number] = mode
    return mode


def mode_named(text: str) -> Mode:
    """The mode of this name. Raises FormatError for a mode that does not exist, naming those that do."""
    try:
        return Mode[text.upper()]
    except KeyError:
        raise FormatError(f"no mode {text!r}: there are {', '.join(m.name.lower() for m in Mode)}") from None
