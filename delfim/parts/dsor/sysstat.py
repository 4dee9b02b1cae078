"""System status of the other nodes (sysstat.c in the thesis): extended frames and segmented messages, one function."""

from collections.abc import Sequence

from delfim import config
from delfim.base.errors import BusError, FormatError
from delfim.base.frames import CAN_IDE, CAN_RTR, Frame
from delfim.canproxy.dsor.messages import (
    GPS_SYSSTAT_ID,
    SYSSTAT_MASK,
    SYSSTAT_SUBJECT,
    Node,
    PropellerStatus,
    sysstat_arb,
    unpack_sysstat,
)
from delfim.canproxy.dsor.protocol import message_filter
from delfim.canproxy.dsor.receiver import Receiver
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.vehicle.failsafe.nodehealth import NAMES, PROPELLERS, named
from delfim.vehicle.links import FRAMES_PER_READ, Links
from delfim.vehicle.sensors import Value
from delfim.vehicle.state import State, ThrusterReport

VALUES: tuple[Value, ...] = ()  # record.py has the logged fields


class SystemStatus:
    """The health of the other nodes."""

    name = "sysstat"

    def __init__(self, socket: CanSocket, node: int = Node.VEHICLE, rows: Sequence[config.ThrusterTable] = ()) -> None:
        self.input = socket
        self._rows: dict[int, config.ThrusterTable] = {PROPELLERS[row.address]: row for row in rows}
        self._segmented = Receiver(node, lambda message: message.id == GPS_SYSSTAT_ID)

    def read(self, state: State, now_s: float) -> None:
        """Malformed reports are counted."""
        receive, segmented = self.input.receive, self._segmented
        for _ in range(FRAMES_PER_READ):
            try:
                frame = receive()
                if frame is None:
                    break
                node, data = _report(frame, segmented, now_s)
                if data is not None:
                    status = unpack_sysstat(node, data)
                    state.sysstat[NAMES[node]] = (status, now_s)
                    if isinstance(status, PropellerStatus) and (row := self._rows.get(node)) is not None:
                        state.thrusters[row.name] = _report_of(row, status, now_s)
            except (FormatError, KeyError, ValueError):
                state.count("sysstat_malformed")
            except BusError:
                state.count("sysstat_bus_errors")
                break
        for reply in _drain(segmented) if segmented.replies else ():
            try:
                self.input.sendmsg(reply)
            except OSError:
                state.count("acknowledgements_unsent")


def open_sensor(settings: config.Vehicle, links: Links) -> SystemStatus:
    plain, segmented = CanAddress(sysstat_arb(Node.VEHICLE), SYSSTAT_MASK), CanAddress(*message_filter(source=Node.GPS))
    rows = [row for _, row in settings.driven("nodes")]
    return SystemStatus(links.bus(settings.can.interface, (plain, segmented)), settings.can.node, rows)


def _report_of(row: config.ThrusterTable, status: PropellerStatus, now_s: float) -> ThrusterReport:
    _, faults, rpm, current_a, celsius, _ = status
    turns_rpm = None if rpm is None else float(-rpm if row.reversed else rpm)
    told = (now_s, turns_rpm, current_a, None, celsius, None, tuple(named(faults)) if faults else (), "")
    return tuple.__new__(ThrusterReport, told)  # a third of the time of ThrusterReport(...)


def _report(frame: Frame, segmented: Receiver, now_s: float) -> tuple[int, bytes | None]:
    """(node, data) of a plain status frame or of a segmented message that this frame completed; data None otherwise."""
    identifier = frame.arb >> 3  # of an extended frame
    if frame.arb & (CAN_IDE | CAN_RTR) != CAN_IDE or identifier >> 19 & 3 != 3:
        message = segmented.feed(frame, now_s)
        return (message.source, message.data) if message is not None else (0, None)
    if identifier & 0xFFF != SYSSTAT_SUBJECT:
        raise FormatError(f"plain frame of unknown subject {identifier & 0xFFF:#x}")
    return identifier >> 12 & 0x7F, frame.data


def _drain(segmented: Receiver) -> list[Frame]:
    replies = list(segmented.replies)
    segmented.replies.clear()
    return replies
