"""What `delfim new` asks of sensors on I2C."""

from typing import Final

from delfim.base.questions import PositionsAnswer

POSITIONS: Final = (
    PositionsAnswer(
        "i2c",
        "a GPS mouse on USB, and a BNO085 as compass on the I2C pins of a Raspberry Pi (docs/i2c.md)",
        """\
[navigation]
sources = ["nmea0183"]
rate_hz = 10.0
estimator = true  # makes one navigation of separate sensors: docs/estimator.md

[nmea0183]
variation_deg = 0.0  # the magnetic variation of your place, east positive
pitch = "compass_pitch"
roll = "compass_roll"

[nmea0183.ports.gps]
device = "/dev/ttyACM0"  # a name that stays the same after each start: ls /dev/serial/by-id
baud = 9600

[nmea0183.ports.i2c]
device = "udp:127.0.0.1:10120"  # where the sensors on I2C are heard

[i2c]
to = "udp:127.0.0.1:10120"

[i2c.sensors.compass]
chip = "bno085"
bus = "/dev/i2c-1"
turned_deg = 0.0  # its x axis, clockwise from the bow
""",
        simulation="""\
instruments = ["gps:receiver", "i2c:compass", "i2c:gyro"]  # what each port is
""",
    ),
)
