"""Receivers, compasses and gyros on a DroneCAN bus (docs/dronecan.md). Each kind of data has its node and its age."""

import math
from collections import Counter
from typing import Final

from delfim import config
from delfim.base.errors import BusError, FormatError
from delfim.canproxy.dronecan import datatypes
from delfim.canproxy.dronecan.datatypes import (
    Dilution,
    GnssFix,
    ImuSample,
    MagneticField,
    Message,
    NodeStatus,
    RelativeHeading,
    decode,
)
from delfim.canproxy.dronecan.transfers import TransferReceiver
from delfim.canproxy.dsor.messages import Navigation
from delfim.canproxy.socket import CanSocket
from delfim.parts.dronecan.table import Dronecan
from delfim.vehicle.links import FRAMES_PER_READ, Links
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.navigation.fusion import MOVING, SLOW_S, SQRT2, Fusion, Hearer
from delfim.vehicle.navigation.magnetic import FLAT, Calibration, FieldCircle, Tilt, Vector, attitude, magnetic_heading
from delfim.vehicle.state import State

HEARD: Final = (
    datatypes.FIX2,
    datatypes.AUXILIARY,
    datatypes.RELATIVE_HEADING,
    datatypes.MAGNETIC_FIELD_FIRST,
    datatypes.MAGNETIC_FIELD,
    datatypes.MAGNETIC_FIELD_FINE,
    datatypes.RAW_IMU,
    datatypes.NODE_STATUS,
)
_NAMES: Final = {kind.id: kind.name for kind in HEARD}
MESSAGES_PER_READ: Final = 16  # bounds one call on a flooded bus, as FRAMES_PER_READ does
FLAT_S: Final = 1.0  # after a beginning: who has not told its gravity by then lies flat
_KINDS: Final = {**MOVING, "attitude": 0.0, "dilution": SLOW_S}  # an attitude comes with each rate of a gyro
_DIFFERENTIAL, _RTK = 1, 2  # modes of a fix


class DronecanNavigation:
    """All sensors of the bus."""

    name = "dronecan"

    def __init__(self, settings: config.Vehicle, socket: CanSocket, receiver: TransferReceiver, state: State) -> None:
        table, stale_s = settings.of(Dronecan), settings.navigation.stale_s
        self.input, self._receiver, self._state = socket, receiver, state
        self.heard_s, self.t_ns = -1e9, 0
        self._stale_s, self._calibration = stale_s, Calibration(table.hard_iron_ut, table.soft_iron)
        self._variation_rad, self._arrow_rad = math.radians(table.variation_deg), math.radians(table.compass_deg)
        self._antennas_rad = math.radians(table.antennas_deg)
        self._fusion: Fusion[int] = Fusion(_KINDS, stale_s, table.preferred_sources)
        self._began_s = -1e9
        self._tilts = dict[int, Tilt]()  # of the nodes with a gyro and an accelerometer
        self._sensors = dict[int, int]()  # by node: its magnetometer, of several
        self._said = dict[int, tuple[Vector, float | None]]()  # by node: its last field, and the heading of it
        self._antennas_s = -1e9  # when two antennas told a heading last
        self._circles = dict[int, FieldCircle]()  # by node, for the calibration
        self._nodes = dict[int, tuple[int, float]]()  # health, and when it was heard
        self._refused: Counter[str] = Counter()

    def tell(self, hearer: Hearer) -> None:
        self._fusion.hearer = hearer

    def read(self, now_s: float) -> Fix | None:
        """Read as `DsorNavigation.read` does: a fix for each message of the chosen receiver."""
        fix, left = None, MESSAGES_PER_READ
        for _ in range(FRAMES_PER_READ):
            if not left:
                break
            try:
                frame = self.input.receive()
            except BusError:
                self._state.count("dronecan_bus_errors")
                break
            if frame is None:
                break
            transfer = self._receiver.feed(frame, now_s)
            if transfer is None:
                continue
            self.t_ns = frame.t_ns
            left -= 1
            try:
                message = decode(transfer)
            except FormatError:
                self._state.count("dronecan_malformed")
                self._refused[f"{_NAMES[transfer.type]}: impossible values"] += 1
                continue
            navigation = self._take(transfer.source, message, now_s)
            if navigation is not None:
                fix = Fix(navigation, frame.t_ns, now_s)
                self.heard_s = now_s
        return fix

    def _take(self, node: int, message: Message, now_s: float) -> Navigation | None:
        """File a message under its kind; positions go on to the vehicle."""
        match message:
            case GnssFix():
                return self._located(node, message, now_s)
            case Dilution():
                self._fusion.put("dilution", node, message, now_s)
            case RelativeHeading(heading_rad, accuracy_rad):
                if heading_rad is not None:
                    self._antennas_s = now_s
                    heading_rad = (heading_rad - self._antennas_rad) % math.tau
                self._headed(node, heading_rad, now_s, accuracy_rad)
            case MagneticField():
                self._magnetic(node, message, now_s)
            case ImuSample(rate_radps, force_mps2):
                tilt = self._tilts.setdefault(node, Tilt())
                turning_radps = tilt.feed(rate_radps, force_mps2, self.t_ns / 1e9)
                self._fusion.take("rate", node, None if turning_radps is None else (turning_radps,), now_s)
                known = None if tilt.down is None else attitude(tilt.down, self._arrow_rad)
                self._fusion.put("attitude", node, known, now_s)
            case NodeStatus():
                self._nodes[node] = message.health, now_s
        return None

    def _headed(self, node: int, heading_rad: float | None, now_s: float, accuracy_rad: float | None = None) -> None:
        heading = None if heading_rad is None else (heading_rad,)
        self._fusion.take("heading", node, heading, now_s, accuracy_rad or 0.0)

    def _magnetic(self, node: int, m: MagneticField, now_s: float) -> None:
        """File the heading of a compass: corrected for the tilt that gyro and accelerometer of the same node give, flat where
        it has none. Two antennas are better."""
        if self._sensors.setdefault(node, m.sensor) != m.sensor or now_s - self._antennas_s <= self._stale_s:
            return
        circle = self._circles.get(node)
        if circle is None:
            circle = self._circles[node] = FieldCircle(m.field_t)
        circle.add(m.field_t)
        down = self._down(node, now_s)
        if down is None:
            self._refused["compass without its tilt"] += 1
            self._headed(node, None, now_s)
            return
        before, heading_rad = self._said.get(node, (None, None))
        if m.field_t != before:  # a frozen field is a frozen heading, however the boat heels
            heading_rad = magnetic_heading(self._calibration.undone(m.field_t), down, self._arrow_rad)
            if heading_rad is None:
                self._refused["magnetic field without a direction"] += 1
            else:
                heading_rad = (heading_rad + self._variation_rad) % math.tau
            self._said[node] = m.field_t, heading_rad
        self._headed(node, heading_rad, now_s)

    def _down(self, node: int, now_s: float) -> Vector | None:
        tilt = self._tilts.get(node)
        if tilt is None:
            return FLAT if now_s - self._began_s > FLAT_S else None
        return tilt.down if abs(self.t_ns / 1e9 - tilt.at_s) <= self._stale_s else None

    def _located(self, node: int, g: GnssFix, now_s: float) -> Navigation | None:
        """File a fix, or a receiver's report that it has none; returns the message if the node is the chosen one."""
        fusion, fix = self._fusion, fix_of(g)
        if not now_s - self.heard_s <= self._stale_s:  # a beginning: a replay has perhaps not heard what came before it
            self._began_s, self._tilts, self._sensors, self._said = now_s, {}, {}, {}
        position = (g.latitude_rad, g.longitude_rad) if fix else None
        velocity = None
        if fix and g.north_mps is not None and g.east_mps is not None:
            velocity = g.north_mps, g.east_mps
        fusion.put("velocity", node, velocity, now_s)
        fusion.talking.put(node, True, now_s)
        if not fusion.place(node, position, now_s):
            return None
        fusion.tell("velocity", node, velocity, now_s, g.utc_ns, (g.accuracy_mps or 0.0) / SQRT2)
        fusion.tell("position", node, position, now_s, g.utc_ns, (g.accuracy_m or 0.0) / SQRT2)
        dilution: Dilution | None = fusion.kinds["dilution"].of(node, now_s)
        hdop = None if dilution is None else dilution.hdop
        return fusion.message(position, g.utc_ns or 0, now_s, fix, g.satellites, hdop, g.accuracy_m)

    def report(self, now_s: float) -> dict[str, object]:
        """The report: the node used for each kind of data, the devices heard, and what was refused."""
        kinds = {kind: {"node": node, "age_s": age_s} for kind, (node, age_s) in self._fusion.used(now_s).items()}
        devices = {str(node): {"health": health, "age_s": now_s - at_s} for node, (health, at_s) in sorted(self._nodes.items())}
        compasses = {
            str(node): {
                "flat": node not in self._tilts,
                "calibration": circle.calibration() or "turn the boat through two circles",
            }
            for node, circle in sorted(self._circles.items())
        }
        return {
            "kinds": kinds,
            "devices": devices,
            "compasses": compasses,
            "refused": dict(self._receiver.errors + self._refused),
        }


def fix_of(g: GnssFix) -> int:
    """The kind of fix, as in delfim.canproxy.dsor.messages.Navigation."""
    if g.status < 2:
        return 0
    if g.status == 2:
        return 2
    return {_DIFFERENTIAL: 4, _RTK: 5 if g.sub_mode else 6}.get(g.mode, 3)


def open_source(settings: config.Vehicle, links: Links, state: State) -> DronecanNavigation:
    receiver = TransferReceiver(HEARD)
    return DronecanNavigation(settings, links.bus(settings.of(Dronecan).interface, receiver.filters), receiver, state)
