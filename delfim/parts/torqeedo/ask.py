"""What `delfim new` asks of Torqeedo motors."""

from typing import Final

from delfim.base.questions import MotorsAnswer

MOTORS: Final = (
    MotorsAnswer(
        "torqeedo",
        "two Torqeedo motors, each on a serial port of RS-485 (docs/torqeedo.md)",
        "any number: its line is the one of its name",
        """\
[torqeedo.ports.starboard]
device = "/dev/ttyUSB1"  # a name that stays the same after each start: ls /dev/serial/by-id

[torqeedo.ports.port]
device = "/dev/ttyUSB2"
""",
    ),
)
