"""What `delfim new` asks of motors that are told by pulses."""

from typing import Final

from delfim.base.questions import MotorsAnswer

PULSES: Final = """\
[pwm]
chip = "/sys/class/pwm/pwmchip0"  # the computer's own; "/dev/i2c-1" for a PCA9685 or a Navigator
"""
RUDDER: Final = """\
steer = { kind = "rudder", address = 1, angle_max_deg = 35.0, rate_dps = 60.0 }  # the channel of its servo
"""
MOTORS: Final = (
    MotorsAnswer(
        "esc",
        "two motors on ESCs, port and starboard, told by pulses (docs/pwm.md)",
        "its channel on the chip that makes the pulses",
        PULSES,
        usual=True,
    ),
    MotorsAnswer(
        "rudder",
        "one motor on an ESC, and a rudder on a servo, told by pulses (docs/pwm.md)",
        "the channel of its ESC on the chip that makes the pulses",
        PULSES,
        rudder=RUDDER,
    ),
)
