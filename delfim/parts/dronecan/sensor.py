"""Batteries on a DroneCAN bus (docs/dronecan.md): battery 0 is the starboard one, or the only one, battery 1 the port one. And
what rangefinders see."""

from typing import Final

from delfim import config
from delfim.base.selection import Newest
from delfim.canproxy.dronecan.datatypes import BATTERY_INFO, RANGE, BatteryInfo, RangeMeasured
from delfim.canproxy.dronecan.transfers import TransferReceiver
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Node, Status
from delfim.canproxy.socket import CanSocket
from delfim.parts.dronecan.rangefinders import Rangefinders
from delfim.parts.dronecan.receiving import messages
from delfim.parts.dronecan.table import Dronecan
from delfim.vehicle.failsafe.nodehealth import NAMES
from delfim.vehicle.links import Links
from delfim.vehicle.sensors import Value
from delfim.vehicle.state import State

VALUES: tuple[Value, ...] = ()  # record.py has the logged fields
SIDES: Final = tuple(NAMES[node] for node in (Node.BATTERIES_STARBOARD, Node.BATTERIES_PORT))
HOT, OVERLOAD, BAD, FAULTY = 8, 32, 64, 256  # flags


class DronecanSensors:
    """The charge of the batteries, and rangefinders. Of several devices that report a battery, the first in
    `dronecan.preferred_sources` counts."""

    name = "dronecan"

    def __init__(self, settings: config.Vehicle, socket: CanSocket, receiver: TransferReceiver) -> None:
        self.input, self._receiver = socket, receiver
        preferred, stale_s = settings.of(Dronecan).preferred_sources, settings.sysstat.stale_s
        self._rangefinders = Rangefinders(settings)
        self._told = tuple(Newest[int, BatteryInfo](preferred, stale_s) for _ in SIDES)

    def read(self, state: State, now_s: float) -> None:
        """Read the reports of batteries and rangefinders. Malformed ones, and those of others, are counted."""
        for node, told in messages(self.input, self._receiver, state, now_s):
            if isinstance(told, BatteryInfo):
                self._hear(state, node, told, now_s)
            elif isinstance(told, RangeMeasured):
                self._rangefinders.hear(state, node, told, now_s)

    def _hear(self, state: State, node: int, told: BatteryInfo, now_s: float) -> None:
        if told.battery >= len(SIDES):
            state.count("dronecan_other_batteries")
            return
        newest = self._told[told.battery]
        newest.put(node, told, now_s)
        if newest.choose(now_s) == node:
            state.sysstat[SIDES[told.battery]] = status_of(told), now_s


def status_of(told: BatteryInfo) -> BatteriesStatus:
    """Convert a report to that of the boat's own nodes."""
    flags = told.flags
    faults = Fault.OVERHEATED if flags & HOT else Fault(0)
    faults |= Fault.OVERCURRENT if flags & OVERLOAD else Fault(0)
    faults |= Fault.HARDWARE if flags & (BAD | FAULTY) else Fault(0)
    status = Status.BAD if Fault.HARDWARE in faults else Status.DEGRADED if faults else Status.GOOD
    celsius = None if told.temperature_c is None else round(told.temperature_c)
    return BatteriesStatus(status, faults, told.voltage_v, told.current_a, told.charge, celsius)


def open_sensor(settings: config.Vehicle, links: Links) -> DronecanSensors:
    receiver = TransferReceiver((BATTERY_INFO, RANGE) if settings.of(Dronecan).rangefinders else (BATTERY_INFO,))
    return DronecanSensors(settings, links.bus(settings.of(Dronecan).interface, receiver.filters), receiver)
