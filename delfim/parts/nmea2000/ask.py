"""What `delfim new` asks of an NMEA 2000 bus."""

from typing import Final

from delfim.base.questions import PositionsAnswer

POSITIONS: Final = (
    PositionsAnswer(
        "nmea2000",
        "a receiver and a compass on an NMEA 2000 bus (docs/nmea2000.md)",
        """\
[navigation]
sources = ["nmea2000"]
rate_hz = 10.0
stale_s = 2.5

[nmea2000]
interface = "{interface}"

[failsafe.navigation_silent]
after_s = 2.5
""",
    ),
)
