"""What `delfim new` asks of lines of NMEA 0183."""

from typing import Final

from delfim.base.questions import PositionsAnswer

POSITIONS: Final = (
    PositionsAnswer(
        "usb",
        "a GPS mouse and a compass that speak NMEA 0183, on a USB port each (docs/nmea0183.md)",
        """\
[navigation]
sources = ["nmea0183"]
rate_hz = 10.0
estimator = true  # makes one navigation of separate sensors: docs/estimator.md

[nmea0183]
variation_deg = 0.0  # the magnetic variation of your place, east positive, if the compass is magnetic

[nmea0183.ports.gps]
device = "/dev/ttyACM0"  # a name that stays the same after each start: ls /dev/serial/by-id
baud = 9600

[nmea0183.ports.compass]
device = "/dev/ttyUSB0"
baud = 4800  # not known? delfim sensors --find /dev/ttyUSB0
""",
        simulation="""\
instruments = ["gps:receiver", "compass:compass", "compass:gyro"]  # what each port is
""",
        usual=True,
    ),
)
