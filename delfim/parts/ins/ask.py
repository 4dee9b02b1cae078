"""What `delfim new` asks of an inertial navigation system."""

from typing import Final

from delfim.base.questions import PositionsAnswer

POSITIONS: Final = (
    PositionsAnswer(
        "ins",
        "an inertial navigation system of VectorNav, Xsens, SBG or Advanced Navigation, on a serial port (docs/ins.md)",
        """\
[navigation]
sources = ["ins"]
rate_hz = 10.0

[ins]
device = "/dev/ttyUSB0"  # a name that stays the same after each start: ls /dev/serial/by-id
speaks = "vectornav"  # or "xsens", "sbg", "anpp"
""",
    ),
)
