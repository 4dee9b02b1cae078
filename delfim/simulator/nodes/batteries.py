"""The banks of batteries with their contactors."""

from typing import Final

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.frames import Frame
from delfim.canproxy.dsor.messages import (
    BATTERIES_PORT,
    BATTERIES_STARBOARD,
    RESET,
    BatteriesStatus,
    Fault,
    Node,
    Status,
    pack_batteries_status,
    sysstat_arb,
    unpack_batteries_command,
)
from delfim.simulator.model import Model
from delfim.simulator.nodes.period import Period

BATTERIES_STATUS_S: Final = 1.0
LOW_CHARGE: Final = 0.2
EMPTY_CHARGE: Final = 0.05


class BatteriesNode:
    """One bank: it obeys its contactor command, starts with an open contactor, and counts its charge."""

    def __init__(self, model: Model, row: config.ThrusterTable) -> None:
        self._drive = model.drives[row.name]
        self._drive.connected = False
        self._node = (Node.BATTERIES_STARBOARD, Node.BATTERIES_PORT)[row.address]
        self.hears = ((BATTERIES_STARBOARD, BATTERIES_PORT)[row.address], RESET)
        self._status = Period(BATTERIES_STATUS_S)
        self.malformed = 0
        self.silent = self.bad = False

    @property
    def due_s(self) -> float:
        return self._status.due_s

    def feed(self, frame: Frame, now_s: float) -> None:
        """Take a command to this side. Malformed ones are counted and change nothing."""
        if frame.arb == RESET:
            self._status.reset(frame.data, self._node, now_s)
            return
        try:
            self._drive.connected = unpack_batteries_command(frame.data).connected
        except FormatError:
            self.malformed += 1

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        if not self._status.passed(now_s) or self.silent:
            return []
        drive = self._drive
        status = Status.BAD if drive.charge < EMPTY_CHARGE else Status.DEGRADED if drive.charge < LOW_CHARGE else Status.GOOD
        faults = Fault(0) if status is Status.GOOD else Fault.LOW_VOLTAGE
        if self.bad:
            status, faults = Status.BAD, faults | Fault.HARDWARE
        report = BatteriesStatus(status, faults, drive.voltage_v, drive.current_a, drive.charge, round(drive.temperature_c))
        return [Frame(sysstat_arb(self._node), pack_batteries_status(report))]


def nodes(settings: config.Vehicle, model: Model, seed: int) -> dict[str, BatteriesNode]:
    rows = [row for _, row in settings.driven("nodes")]
    return {("batteries_starboard", "batteries_port")[row.address]: BatteriesNode(model, row) for row in rows}
