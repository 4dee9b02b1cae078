"""The other CAN nodes of the boat: GPS, navigation, two propellers, two banks of batteries (thesis figure 3-2), around a model.

Every node is a clocked object without socket or task: `step(now_s, utc_ns)` returns the frames that it puts on the bus now,
`feed(frame, now_s)` is what it hears, `due_s` when it has something to say again. `now_s` is monotonic and never goes back.
"""

import contextlib
import math
from collections.abc import Mapping
from random import Random
from typing import Final, NamedTuple

from delfim import config
from delfim.canproxy.dsor.protocol import Message, segments
from delfim.canproxy.socket import CanAddress
from delfim.errors import FormatError
from delfim.frames import Frame
from delfim.messages import (
    BATTERIES_PORT,
    BATTERIES_STARBOARD,
    GPS_SYSSTAT_ID,
    NAVIGATION_ID,
    NAVIGATION_PRIORITY,
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
    PROPELLER_TIMEOUT_S,
    RESET,
    SYSSTAT_PRIORITY,
    TIME,
    TIME_FRAME,
    BatteriesStatus,
    Fault,
    GpsStatus,
    Navigation,
    Node,
    PropellerStatus,
    Status,
    pack_batteries_status,
    pack_gps_status,
    pack_navigation,
    pack_propeller_status,
    sysstat_arb,
    unpack_batteries_command,
    unpack_propeller_command,
    unpack_reset,
)
from delfim.simulator.model import Model, Side, hull_of

COMMANDS: Final = tuple(map(CanAddress, (PROPELLER_STARBOARD, PROPELLER_PORT, BATTERIES_STARBOARD, BATTERIES_PORT, RESET)))
"""What a socket binds to that serves the nodes."""

PROPELLER_STATUS_S: Final = 0.2
RESTART_S: Final = 1.0  # of a node, during which it says nothing
BATTERIES_STATUS_S: Final = 1.0
POSITION_ERROR_S: Final = 60.0  # correlation time of a satellite receiver's error
YAW_RATE_NOISE_RADPS: Final = math.radians(0.2)
STALL_S: Final = 1.0  # a longer pause of the whole simulator does not exist in the world that it models
LOW_CHARGE: Final = 0.2
EMPTY_CHARGE: Final = 0.05
FIX, SATELLITES, HDOP = 3, 10, 0.9
_GOOD: Final = Status.GOOD, Fault(0)
_BAD: Final = Status.BAD, Fault.HARDWARE
_SECOND_NS: Final = 1_000_000_000
_RESETTABLE: Final = Node.PROPELLER_STARBOARD, Node.PROPELLER_PORT, Node.BATTERIES_STARBOARD, Node.BATTERIES_PORT
_TOLERANCE_S: Final = 1e-6  # sums of tenths are never exact


class Noise(NamedTuple):
    """Standard deviations of the navigation node."""

    position_m: float  # per axis, of an error that wanders
    heading_rad: float  # white
    speed_mps: float  # per axis, white


class _Period:
    """Due at once, then each `period_s`. What was missed is left out and the phase is kept."""

    __slots__ = ("_period_s", "due_s")

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self.due_s = -math.inf

    def pause(self, now_s: float) -> None:
        self.due_s = now_s + RESTART_S

    def passed(self, now_s: float) -> bool:
        late_s = now_s - self.due_s + _TOLERANCE_S
        if late_s < 0.0:
            return False
        if late_s == math.inf:
            self.due_s = now_s + self._period_s
        else:
            self.due_s += (late_s // self._period_s + 1.0) * self._period_s
        return True


class NavigationNode:
    """Position, velocity and attitude with the errors of sensors, as a broadcast segmented message."""

    def __init__(self, model: Model, rate_hz: float, noise: Noise, seed: int) -> None:
        self._model, self._noise = model, noise
        self._random = Random(f"navigation {seed}")
        self._period = _Period(1.0 / rate_hz)
        self._keep = math.exp(-1.0 / (rate_hz * POSITION_ERROR_S))
        self._north_m = self._random.gauss(0.0, noise.position_m)
        self._east_m = self._random.gauss(0.0, noise.position_m)
        self._counter = 0
        self.silent = False
        self.jump_m = 0.0  # error of the position, to the north
        self.frozen = False  # the sensors say what they said
        self.repeating = False  # the node sends its last message again and again
        self._said: Navigation | None = None

    @property
    def due_s(self) -> float:
        return self._period.due_s

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        if not self._period.passed(now_s) or self.silent or not self._model.alive:
            return []
        said = self._said
        if said is None or not (self.frozen or self.repeating):
            said = self.measured(utc_ns)
            if self.jump_m and said.latitude_rad is not None:
                said = said._replace(latitude_rad=said.latitude_rad + self.jump_m / self._model.origin.north_m_per_rad)
        elif not self.repeating:
            said = said._replace(utc_ns=utc_ns, counter=self._counter)
        self._said = said
        data = pack_navigation(said)
        self._counter += 1
        message = Message(NAVIGATION_PRIORITY, Node.NAVIGATION, Node.BROADCAST, NAVIGATION_ID, data)
        return segments(message, self._counter)

    def measured(self, utc_ns: int) -> Navigation:
        """What the sensors say. The position's error is a first-order Gauss-Markov process, as a receiver's is."""
        model, noise, gauss = self._model, self._noise, self._random.gauss
        new_m = noise.position_m * math.sqrt(1.0 - self._keep * self._keep)
        self._north_m = self._keep * self._north_m + gauss(0.0, new_m)
        self._east_m = self._keep * self._east_m + gauss(0.0, new_m)
        origin = model.origin
        return Navigation(
            utc_ns,
            model.latitude_rad + self._north_m / origin.north_m_per_rad,
            model.longitude_rad + self._east_m / origin.east_m_per_rad,
            model.north_mps + gauss(0.0, noise.speed_mps),
            model.east_mps + gauss(0.0, noise.speed_mps),
            model.heading_rad + gauss(0.0, noise.heading_rad),
            model.yaw_rate_radps + gauss(0.0, YAW_RATE_NOISE_RADPS),
            model.roll_rad,
            model.pitch_rad,
            FIX,
            SATELLITES,
            HDOP,
            self._counter,
        )


class GpsNode:
    """The receiver's health and the time frame, both at the start of each UTC second (thesis 3.2)."""

    def __init__(self) -> None:
        self.due_s = -math.inf
        self.silent = self.bad = False
        self._second: int | None = None
        self._number = 0

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        second, rest_ns = divmod(utc_ns, _SECOND_NS)
        self.due_s = now_s + (_SECOND_NS - rest_ns) / 1e9
        if second == self._second or self.silent:
            return []
        self._second = second
        self._number += 1
        status = GpsStatus(*(_BAD if self.bad else _GOOD), FIX, SATELLITES, HDOP, utc_ns)
        message = Message(SYSSTAT_PRIORITY, Node.GPS, Node.BROADCAST, GPS_SYSSTAT_ID, pack_gps_status(status))
        return [Frame(TIME_FRAME, TIME.pack(utc_ns)), *segments(message, self._number)]


class PropellerNode:
    """A motor controller. It obeys its commands and stops by itself when no new one comes for PROPELLER_TIMEOUT_S.

    A command whose counter stands still is obeyed and does not count as new: a frozen sender must not keep a motor running.
    """

    def __init__(self, model: Model, side: Side) -> None:
        self._model, self._side = model, side
        self._drive = model.starboard if side == "starboard" else model.port
        self._arb = sysstat_arb(Node.PROPELLER_STARBOARD if side == "starboard" else Node.PROPELLER_PORT)
        self._status = _Period(PROPELLER_STATUS_S)
        self._commanded_s = -math.inf
        self._heard_counter = -1
        self._counter = 0
        self.malformed = 0
        self.silent = self.bad = False

    @property
    def due_s(self) -> float:
        silent_s = self._commanded_s + PROPELLER_TIMEOUT_S
        return min(self._status.due_s, silent_s) if self._drive.run else self._status.due_s

    def restart(self, now_s: float) -> None:
        self._status.pause(now_s)

    def feed(self, frame: Frame, now_s: float) -> None:
        """A command to this side. Malformed ones are counted and change nothing."""
        try:
            command = unpack_propeller_command(frame.data)
        except FormatError:
            self.malformed += 1
            return
        if command.counter != self._heard_counter:
            self._heard_counter, self._commanded_s = command.counter, now_s
        self._model.command(self._side, command.rpm, command.run and not self._silent(now_s))

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        silent, drive = self._silent(now_s), self._drive
        if silent:
            self._model.command(self._side, 0.0, False)
        if not self._status.passed(now_s) or self.silent:
            return []
        faults = Fault.NO_COMMAND if silent else Fault(0)
        if not drive.powered:
            faults |= Fault.LOW_VOLTAGE
        if self.bad:
            faults |= Fault.HARDWARE
        status = Status.BAD if faults else Status.GOOD
        self._counter += 1
        report = PropellerStatus(status, faults, round(drive.rpm), drive.motor_a, round(drive.temperature_c), self._counter)
        return [Frame(self._arb, pack_propeller_status(report))]

    def _silent(self, now_s: float) -> bool:
        return now_s + _TOLERANCE_S >= self._commanded_s + PROPELLER_TIMEOUT_S


class BatteriesNode:
    """One bank: it obeys its contactor command, starts with an open contactor, and knows what it gave."""

    def __init__(self, model: Model, side: Side) -> None:
        self._drive = model.starboard if side == "starboard" else model.port
        self._drive.connected = False
        self._arb = sysstat_arb(Node.BATTERIES_STARBOARD if side == "starboard" else Node.BATTERIES_PORT)
        self._status = _Period(BATTERIES_STATUS_S)
        self.malformed = 0
        self.silent = self.bad = False

    @property
    def due_s(self) -> float:
        return self._status.due_s

    def restart(self, now_s: float) -> None:
        self._status.pause(now_s)

    def feed(self, frame: Frame, now_s: float) -> None:
        """A command to this side. Malformed ones are counted and change nothing."""
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
        return [Frame(self._arb, pack_batteries_status(report))]


class Nodes:
    """All nodes of a boat around one model, which they advance."""

    def __init__(self, model: Model, rate_hz: float, noise: Noise, seed: int) -> None:
        self.model = model
        self.navigation = NavigationNode(model, rate_hz, noise, seed)
        self.gps = GpsNode()
        self.propellers = PropellerNode(model, "starboard"), PropellerNode(model, "port")
        self.batteries = BatteriesNode(model, "starboard"), BatteriesNode(model, "port")
        self.sensors: dict[str, GpsNode | PropellerNode | BatteriesNode] = {
            "gps": self.gps,
            "propeller_starboard": self.propellers[0],
            "propeller_port": self.propellers[1],
            "batteries_starboard": self.batteries[0],
            "batteries_port": self.batteries[1],
        }
        self._all = self.gps, self.navigation, *self.propellers, *self.batteries
        self._by_arb: Mapping[int, PropellerNode | BatteriesNode] = {
            PROPELLER_STARBOARD: self.propellers[0],
            PROPELLER_PORT: self.propellers[1],
            BATTERIES_STARBOARD: self.batteries[0],
            BATTERIES_PORT: self.batteries[1],
        }
        self._stepped_s: float | None = None

    @property
    def due_s(self) -> float:
        """When `step` has something to do again."""
        return min(node.due_s for node in self._all)

    def feed(self, frame: Frame, now_s: float) -> None:
        """A frame of the bus; what is for no node is passed over."""
        node = self._by_arb.get(frame.arb)
        if node is not None:
            node.feed(frame, now_s)
        elif frame.arb == RESET:
            self._restart(frame.data, now_s)

    def _restart(self, data: bytes, now_s: float) -> None:
        """A propeller or bank of batteries, or all of them, says nothing for as long as it takes to start. What is no reset
        changes nothing."""
        with contextlib.suppress(FormatError):
            number = unpack_reset(data)
            for node, each in zip(_RESETTABLE, self._by_arb.values(), strict=True):
                if number in (node, Node.BROADCAST):
                    each.restart(now_s)

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        """Let the world come to `now_s`; returns the frames that the nodes send then, as they win the bus."""
        if self._stepped_s is not None and now_s > self._stepped_s:
            self.model.advance(min(now_s - self._stepped_s, STALL_S))
        self._stepped_s = now_s
        frames = [frame for node in self._all for frame in node.step(now_s, utc_ns)]
        frames.sort(key=_arbitration)
        return frames


def _arbitration(frame: Frame) -> int:
    return frame.arb


def nodes_of(settings: config.Vehicle, seed: int, model: Model | None = None) -> Nodes:
    """The nodes that a vehicle's file describes, around its model or another one."""
    there = settings.simulation
    if model is None:
        start = math.radians(there.latitude_deg), math.radians(there.longitude_deg)
        model = Model(hull_of(settings.boat), there.sea, seed, *start, math.radians(there.heading_deg))
    noise = Noise(there.position_noise_m, math.radians(there.heading_noise_deg), there.speed_noise_mps)
    return Nodes(model, settings.navigation.rate_hz, noise, seed)
