"""A satellite compass on a serial line that tells lines of text: its row and its keys."""

from delfim.api import Baud, Device, Part, Table


class CompassTable(Table, frozen=True):
    """A satellite compass on a serial line."""

    device: Device = "/dev/ttyUSB0"  # its serial port
    baud: Baud = 115_200  # of the port


PART = Part("example_source", CompassTable, source="example_source.source", played="example_source.played")
