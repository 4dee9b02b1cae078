"""What sensors other than navigation keep, and how they are opened: by the rows of their parts, named in `sensors.names` of the
vehicle's file (CONTRIBUTING.md, "A part is a folder"). Here is only that of the boat's own computer, `sysstat`.
"""

from typing import Any, NamedTuple, Protocol

from delfim import config
from delfim.base import parts
from delfim.base.errors import ConfigError
from delfim.vehicle.links import Links, LoopInput


class Value(NamedTuple):
    """A number that a sensor measures: in `State.measured` under this name, shown with its age, a field of the state log, and
    told to consoles."""

    name: str  # with its unit: depth_m
    unit: str
    description: str
    short: str = ""  # its name of up to ten characters for MAVLink; empty: the first ten

    @property
    def told(self) -> bytes:
        return (self.short or self.name).encode()[:10]


class Sensor(LoopInput, Protocol):
    name: str  # as in `sensors.names`


def open_sensors(settings: config.Vehicle, links: Links) -> tuple[Sensor, ...]:
    """Opens the sensors, and loads their modules only then. Raises DelfimError, ConfigError where the file relies on a value
    that none measures."""
    known = {value.name for value in values(settings)}
    needed = [("sensors.required", name) for name in settings.sensors.required]
    needed += [("failsafe.shallow.min_depth_m", "depth_m")] if settings.failsafe.shallow.min_depth_m else []
    for side in ("above", "below"):
        bounds: dict[str, float] = getattr(settings.failsafe.beyond, side)
        needed += [(f"failsafe.beyond.{side}", name) for name in bounds if "." not in name]
        for program in (name.partition(".")[0] for name in bounds if "." in name):
            table = settings.table("payload").get(program)
            if table is None or "values" not in table.may:
                words = f'no program of this name has the right "values": [payload.{program}]'
                raise ConfigError("vehicle", f"failsafe.beyond.{side}", words)
    for key, name in needed:
        if name not in known:
            raise ConfigError("vehicle", key, f"no sensor of sensors.names measures {name}")
    return tuple(module(name, settings).open_sensor(settings, links) for name in settings.sensors.names)


def values(settings: config.Vehicle) -> tuple[Value, ...]:
    """The values of all sensors of the boat. Where several tell a value it is the newest."""
    told = (each for name in settings.sensors.names for each in module(name, settings).VALUES)
    return tuple({each.name: each for each in told}.values())


def module(name: str, settings: config.Vehicle) -> Any:
    """The module of a sensor. Raises PermanentFailure for a part's that cannot be imported."""
    return parts.module(settings.aboard, "sensor", name)
