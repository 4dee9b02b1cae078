"""A motor on a serial line that hears lines of text: its row and its keys."""

from delfim.api import Baud, Device, Fraction, Part, Table


class MotorTable(Table, frozen=True):
    """A motor on a serial line."""

    device: Device = "/dev/ttyUSB1"  # its serial port
    baud: Baud = 115_200  # of the port
    most: Fraction = 1.0  # of full thrust, at most


PART = Part("example_motor", MotorTable, driver="example_motor.driver")
