"""What `delfim new` asks of VESC motor controllers."""

from typing import Final

from delfim.base.questions import MotorsAnswer

MOTORS: Final = (
    MotorsAnswer(
        "vesc",
        "two motors on VESC controllers on a CAN bus (docs/vesc.md)",
        "its controller's number, as VESC Tool has it",
        """\
[vesc]
interface = "{interface}"
command = "duty"  # a part of the battery's voltage; "rpm" is steadier, and needs rpm_max of each motor
""",
    ),
)
