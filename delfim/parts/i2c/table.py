"""The keys of sensors on I2C in a vehicle's file (docs/i2c.md)."""

from typing import Annotated, Any, Literal

import msgspec

from delfim.base.ranges import PORT, Degrees, MicroTesla, Name, Shear, Stretch
from delfim.base.tables import Table, text

SENSORS_MAX = 8
LEAST_HZ = 5.0  # of a gyro whose rates are added up
MAGNETOMETER = 0x0C  # within an ICM-20948, at an address of its own
ADDRESSES = {  # the usual one first
    "bno085": (0x4A, 0x4B),
    "icm20948": (0x69, 0x68),
    "ina226": tuple(range(0x40, 0x50)),
    "bmp390": (0x77, 0x76),
}
I2cBusName = Annotated[str, text("/dev/i2c-[0-9]{1,3}", "/dev/i2c-NUMBER, as ls /dev/i2c-* lists them")]
Volts = Annotated[float, msgspec.Meta(ge=0.0, le=36.0)]  # an INA226 bears no more


class I2cSensor(Table, frozen=True):
    """A sensor on I2C. Each chip uses its own keys."""

    chip: Literal["bno085", "icm20948", "ina226", "bmp390"]  # two for heading and attitude; a battery; pressure of the air
    bus: I2cBusName = "/dev/i2c-1"  # that of a Raspberry Pi's pins
    address: Annotated[int, msgspec.Meta(ge=0, le=0x77)] = 0  # of the chip; 0: the one that most boards have
    rate_hz: Annotated[float, msgspec.Meta(ge=1.0, le=50.0)] = 10.0  # of a heading; the others tell once a second
    turned_deg: Degrees = 0.0  # bno085, icm20948: the x axis, clockwise from the bow; z is up
    hard_iron_ut: tuple[MicroTesla, MicroTesla, MicroTesla] = (0.0, 0.0, 0.0)  # icm20948: taken off ahead, right, down
    soft_iron: tuple[Stretch, Stretch, Stretch, Shear, Shear, Shear] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)  # then: xx yy zz xy xz yz
    heading_max_deg: Annotated[float, msgspec.Meta(gt=0.0, le=180.0)] = 15.0  # bno085: where it is less sure, none is told
    shunt_ohm: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.002  # ina226: 82 mV across it are the most that it measures
    reversed: bool = False  # ina226: its IN+ is on the load's side
    empty_v: Volts = 0.0  # ina226: of the battery at rest, and ...
    full_v: Volts = 0.0  # ... full; both 0: its charge is unknown
    inner_ohm: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.0  # ina226: of the battery and its cable, which a load shows

    def __post_init__(self) -> None:
        if self.address not in (0, *ADDRESSES[self.chip]):
            first, last = min(ADDRESSES[self.chip]), max(ADDRESSES[self.chip])
            raise ValueError(f"address: a {self.chip} has one of {first:#x} to {last:#x}, not {self.address:#x}")
        if self.chip == "icm20948" and self.rate_hz < LEAST_HZ:
            raise ValueError(f"rate_hz: an icm20948 needs {LEAST_HZ:g} or more, for its gyro is added up")
        if (self.empty_v or self.full_v) and not self.empty_v < self.full_v:
            raise ValueError(f"full_v: {self.full_v:g} V is not above empty_v, {self.empty_v:g} V")

    @property
    def at(self) -> int:
        """Its address."""
        return self.address or ADDRESSES[self.chip][0]


class I2cTable(Table, frozen=True):
    """Sensors on the computer's I2C buses. They are told as NMEA 0183 to a port of the boat (docs/i2c.md)."""

    to: Annotated[str, text(rf"(udp:127\.0\.0\.1:{PORT})?", "udp:127.0.0.1:PORT, or empty")] = ""  # device of that port
    sensors: dict[Name, I2cSensor] = msgspec.field(default_factory=dict)

    def settled(self, vehicle: Any) -> "I2cTable":
        if not self.sensors:
            return self
        if len(self.sensors) > SENSORS_MAX:
            raise ValueError(f"i2c.sensors: {SENSORS_MAX} at most")
        if self.to not in [port.device for port in vehicle.nmea0183.ports.values()]:
            raise ValueError(
                f"i2c.to: no port of nmea0183 has the device {self.to or '(empty)'}: nobody would hear the sensors"
            )
        taken = {(vehicle.pwm.chip, vehicle.pwm.i2c_address): "pwm"} if vehicle.driven("outlet") else {}
        for name, sensor in self.sensors.items():
            if other := taken.get((sensor.bus, sensor.at)):
                raise ValueError(f"i2c.sensors.{name}: {sensor.bus} has {other} at {sensor.at:#x} already")
            taken[sensor.bus, sensor.at] = name
            if sensor.chip == "icm20948":
                if other := taken.get((sensor.bus, MAGNETOMETER)):
                    raise ValueError(f"i2c.sensors.{name}: {sensor.bus} has the magnetometer of {other} at {MAGNETOMETER:#x}")
                taken[sensor.bus, MAGNETOMETER] = name
        return self

    @property
    def files(self) -> dict[str, str]:
        """Devices of this computer, by their keys."""
        return {f"i2c.sensors.{name}.bus": sensor.bus for name, sensor in self.sensors.items()}
