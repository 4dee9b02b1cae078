"""Torqeedo motors with TorqLink in lock step: each says on its bus, while it has power, that it is ready. The model pushes
them as they are told, as all motors whose devices are not simulated."""

from typing import Final

from delfim import config
from delfim.base.frames import Frame, extended
from delfim.canproxy.socket import CanAddress
from delfim.parts.torqeedo.table import TorqlinkTable
from delfim.parts.torqeedo.torqlink import READY, STATUS
from delfim.simulator.model import Model
from delfim.simulator.nodes.period import Period

SAY_S: Final = 0.1
ADDRESS: Final = 0x50  # of the motor
SAYS: Final = Frame(extended(6 << 26 | STATUS << 8 | ADDRESS), bytes((0xFF,) * 4 + (READY,) + (0xFF,) * 3))


class ReadyMotor:
    """The motor of a row."""

    hears: tuple[CanAddress, ...] = ()

    def __init__(self, model: Model, name: str, interface: str) -> None:
        self._drive, self.interface, self._period = model.drives[name], interface, Period(SAY_S)

    @property
    def due_s(self) -> float:
        return self._period.due_s

    def feed(self, frame: Frame, now_s: float) -> None:
        """Ignore the frame."""

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        return [SAYS] if self._period.passed(now_s) and self._drive.powered else []


def buses_of(settings: config.Vehicle, model: Model, seed: int) -> tuple[ReadyMotor, ...]:
    """The motors, each on its bus."""
    ports = settings.of(TorqlinkTable).ports
    rows = (row for row in settings.thrusters if row.driver == "torqlink")
    return tuple(ReadyMotor(model, row.name, ports[row.name].interface) for row in rows)
