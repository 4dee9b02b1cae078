"""What `delfim new` asks about a part, and what it then writes: a row names the module with its `MOTORS` and `POSITIONS`."""

from typing import NamedTuple


class MotorsAnswer(NamedTuple):
    """One word for the question of motors, two of which stand port and starboard."""

    word: str
    about: str
    address: str  # what the address of a motor is
    table: str  # of the part, as TOML; with {interface} where it needs a bus
    rudder: str = ""  # one motor alone, and this in its row: what steers it
    beside: str = ""  # the usual word for the question of positions; empty: that of all
    usual: bool = False  # taken where nobody answers


class PositionsAnswer(NamedTuple):
    """One word for the question where position and heading come from."""

    word: str
    about: str
    text: str  # tables, as TOML; with {interface} where it needs a bus
    simulation: str = ""  # lines of the table of the simulator
    usual: bool = False  # taken where nobody answers
