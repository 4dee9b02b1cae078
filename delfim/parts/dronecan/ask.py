"""What `delfim new` asks of a DroneCAN bus."""

from typing import Final

from delfim.base.questions import MotorsAnswer, PositionsAnswer

MOTORS: Final = (
    MotorsAnswer(
        "dronecan",
        "two motors on DroneCAN controllers, port and starboard (docs/dronecan.md)",
        "its controller's ESC_INDEX",
        """\
[dronecan]
interface = "{interface}"
""",
    ),
)
POSITIONS: Final = (
    PositionsAnswer(
        "dronecan",
        "a receiver and a compass on a DroneCAN bus (docs/dronecan.md)",
        """\
[navigation]
sources = ["dronecan"]
rate_hz = 10.0
estimator = true  # makes one navigation of separate sensors: docs/estimator.md

[dronecan]
interface = "{interface}"
""",
    ),
)
