"""What `delfim new` asks of a board with ArduRover."""

from typing import Final

from delfim.base.questions import MotorsAnswer, PositionsAnswer

MOTORS: Final = (
    MotorsAnswer(
        "ardupilot",
        "the two motors of a board with ArduRover (docs/front-seat.md)",
        "0 is the starboard side, 1 the port side",
        """\
[mavlink_front_seat]
device = "tcp:127.0.0.1:5760"  # the board, or its serial port as "/dev/ttyACM0"
""",
        beside="ardupilot",
    ),
)
POSITIONS: Final = (
    PositionsAnswer(
        "ardupilot",
        "a Pixhawk or another board with ArduRover, and the receiver and compass on it (docs/front-seat.md)",
        """\
[navigation]
sources = ["mavlink_front_seat"]  # the board is asked for its position so often:
rate_hz = 10.0

[mavlink_front_seat]
device = "tcp:127.0.0.1:5760"  # the board, or its serial port as "/dev/ttyACM0"
""",
    ),
)
