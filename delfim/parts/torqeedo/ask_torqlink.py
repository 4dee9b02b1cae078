"""What `delfim new` asks of Torqeedo motors with TorqLink."""

from typing import Final

from delfim.base.questions import MotorsAnswer

MOTORS: Final = (
    MotorsAnswer(
        "torqlink",
        "two Torqeedo motors with TorqLink, each on a CAN bus of its own (docs/torqeedo.md)",
        "any number: its bus is the one of its name",
        """\
[torqlink.ports.starboard]
interface = "can1"  # a bus where nothing but this motor is

[torqlink.ports.port]
interface = "can2"
""",
    ),
)
