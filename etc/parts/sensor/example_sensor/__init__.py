"""A thermometer on a serial line: its row and its keys."""

from delfim.api import Baud, Device, Part, Table


class ThermometerTable(Table, frozen=True):
    """A thermometer in the water, on a serial line."""

    device: Device = "/dev/ttyUSB2"  # its serial port
    baud: Baud = 9_600  # of the port


PART = Part("example_sensor", ThermometerTable, sensor="example_sensor.sensor", played="example_sensor.played")
