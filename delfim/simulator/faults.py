"""Faults by command: failures of a boat, put into the modelled nodes, their bus, and, in lock step, everything around.

`Faults` wraps the nodes and has their interface. Without a fault it only passes calls on. Random numbers come
from its own seed, so the same faults at the same times give the same bytes.
"""

import math
from collections import deque
from collections.abc import Collection, Iterable, Sequence
from random import Random
from typing import Final, Literal, NamedTuple, get_args

from delfim.base.clock import Clock
from delfim.base.errors import FormatError
from delfim.base.frames import Frame
from delfim.simulator.model import Bank
from delfim.simulator.nodes import Nodes
from delfim.simulator.nodes.measuring import Compass, GnssReceiver
from delfim.simulator.nodes.navigation import SATELLITES, NavigationNode
from delfim.simulator.nodes.other_vessels import Shipping
from delfim.simulator.propulsor import Drive, DriveFault
from delfim.vehicle.grex import Guest
from delfim.vehicle.state import State, StateLog

Kind = Literal[
    "navigation_silent",
    "navigation_frozen",
    "navigation_repeating",
    "navigation_jumping",
    "frames_dropped",
    "frames_duplicated",
    "frames_late",
    "bus_off",
    "sensor_bad",
    "sensor_silent",
    "thruster_dead",
    "thruster_stuck",
    "thruster_reversed",
    "battery_sag",
    "console_lost",
    "guest_lost",
    "disk_full",
    "disk_slow",
    "clock_stepped",
    "gnss_poor",
    "accuracy_poor",
    "corrections_lost",
    "shallow",
    "heading_jumping",
    "compass_cable",
    "gyro_drift",
    "ais_silent",
    "ais_frozen",
    "ais_late",
    "ais_wrong",
    "outlet_silent",
    "restarted",
    "navigation_forged",
    "weeds",
    "capsized",
    "thruster_fouled",
]
KINDS: Final[tuple[str, ...]] = get_args(Kind)
ABOARD: Final = frozenset(
    {"console_lost", "guest_lost", "disk_full", "disk_slow", "restarted"}
)  # not of the nodes: in the boat's own program
SENSORS: Final = ("gps", "propeller_starboard", "propeller_port", "batteries_starboard", "batteries_port")
WHERE: Final = dict.fromkeys(("sensor_bad", "sensor_silent"), SENSORS)
PARTS: Final = "navigation_silent", "navigation_frozen"  # of one kind of sensor, or of all and the navigation node
OF_THRUSTERS: Final = (  # at a row of the vehicle's file
    *("thruster_dead", "thruster_stuck", "thruster_reversed", "thruster_fouled", "battery_sag"),
)
DRIVE_FAULTS: Final[dict[str, DriveFault]] = {f"thruster_{each}": each for each in get_args(DriveFault)}
OF_COMPASS: Final = ("heading_jumping", "compass_cable", "gyro_drift")  # on a boat that has one
OF_PULSES: Final = ("outlet_silent",)  # in lock step, where motors are told by pulses
OF_AIS: Final = ("ais_silent", "ais_frozen", "ais_late", "ais_wrong")  # where there are other vessels
VALUES: Final = {  # default, and its meaning
    "navigation_jumping": (40.0, "metres to the north"),
    "frames_dropped": (0.3, "fraction of all frames"),
    "frames_duplicated": (0.3, "fraction of all frames"),
    "frames_late": (0.5, "seconds"),
    "battery_sag": (0.15, "charge that is left, 0 to 1"),
    "clock_stepped": (60.0, "seconds"),
    "gnss_poor": (4.0, "satellites that are left"),
    "accuracy_poor": (8.0, "metres that the receivers state"),
    "shallow": (0.5, "metres of water on a bank, 15 m about the boat"),
    "heading_jumping": (50.0, "degrees to starboard"),
    "compass_cable": (6.0, "degrees for each ampere of the first thruster"),
    "gyro_drift": (1.0, "degrees a second more each minute"),
    "navigation_forged": (-60.0, "degrees by which a second sender turns each heading"),
    "weeds": (5.0, "seconds of thrust astern until they give"),
    "capsized": (180.0, "degrees of roll, starboard down"),
    "ais_late": (60.0, "seconds"),
    "ais_wrong": (2000.0, "metres, at most, each time another way"),
    "restarted": (2.0, "seconds, in lock step, that the program is not there"),
}
LATE_MAX: Final = 4096  # frames under way at once
NOTED_MAX: Final = 64  # notes that are kept for who looks on
HANGS_S: Final = 5.0  # a log reports that it was not written for this long


class Breakage(NamedTuple):
    """A failure: its kind, place, amount and duration. A propeller or battery recovers when the time has passed, but lost
    charge does not return."""

    kind: str
    where: str = ""
    value: float = math.nan
    for_s: float = math.inf


def fault(
    kind: str, where: str = "", value: float | None = None, for_s: float | None = None, thrusters: Collection[str] = ()
) -> Breakage:
    """Check a fault and fill in its kind's default value; `thrusters` are those of the boat, if it is known. Raises FormatError
    in words."""
    if kind not in KINDS:
        raise FormatError(f"no fault {kind!r}; choose one of {', '.join(KINDS)}")
    places = ("", "receiver", "compass") if kind in PARTS else WHERE.get(kind, ("",))
    if kind in OF_THRUSTERS:
        if not where or (thrusters and where not in thrusters):
            raise FormatError(f"{kind} needs one of {', '.join(thrusters) or 'the thrusters of the boat'}")
    elif where not in places:
        words = f"needs one of {', '.join(places)}" if kind in WHERE else f"takes no place: {where!r}"
        raise FormatError(f"{kind} takes receiver, compass or no place: {where!r}" if kind in PARTS else f"{kind} {words}")
    default = VALUES.get(kind, (math.nan, ""))[0]
    if value is not None and (kind not in VALUES or not math.isfinite(value)):
        raise FormatError(f"{kind}: {value} is out of range")
    if for_s is not None and not for_s > 0.0:
        raise FormatError(f"{kind}: {for_s} s is not a duration")
    return Breakage(kind, where, default if value is None else value, math.inf if for_s is None else for_s)


class Broken:
    """The present faults, and the time when each ends."""

    def __init__(self) -> None:
        self.thrusters: tuple[str, ...] = ()  # of the boat, by name; empty: not known here
        self.on: dict[str, float] = {}  # present kinds, with their value
        self.faults: dict[tuple[str, str], float] = {}  # kind and place of each present fault, and when it ends

    def begin(self, broken: Breakage, now_s: float) -> None:
        """Begin a fault; the same kind at the same place replaces the one before."""
        self.faults[broken.kind, broken.where] = now_s + broken.for_s
        self.on[broken.kind] = broken.value
        self._set(broken.kind, broken.where, broken.value, True)

    def end(self, kind: str, where: str = "") -> None:
        """End a fault."""
        if self.faults.pop((kind, where), None) is not None:
            self._set(kind, where, 0.0, False)
            if not any(other == kind for other, _ in self.faults):
                del self.on[kind]

    def expire(self, now_s: float) -> None:
        """End the faults whose time is over."""
        for key in [key for key, end_s in self.faults.items() if now_s >= end_s]:
            self.end(*key)

    def _set(self, kind: str, where: str, value: float, on: bool) -> None:
        """Apply the effect of a fault when it begins or ends."""


class Faults(Broken):
    """Nodes that fail by command."""

    def __init__(self, nodes: Nodes, seed: int) -> None:
        super().__init__()
        self.nodes, self.model, self.thrusters = nodes, nodes.model, tuple(nodes.model.drives)
        self.is_outlet = False  # whether somebody plays the outlet, who may fall silent
        self._random = Random(f"faults {seed}")
        self._late: deque[tuple[float, Frame]] = deque(maxlen=LATE_MAX)  # when due: to the bus ...
        self._late_heard: deque[tuple[float, Frame]] = deque(maxlen=LATE_MAX)  # ... and from it

    @property
    def busy(self) -> bool:
        """Whether any fault is present."""
        return bool(self.faults or self._late or self._late_heard)

    @property
    def due_s(self) -> float:
        """The time when `step` is due next."""
        late = [queue[0][0] for queue in (self._late, self._late_heard) if queue]
        return min(self.nodes.due_s, *self.faults.values(), *late, math.inf)

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        """Step the nodes, as `Nodes.step` does."""
        if not self.busy:
            return self.nodes.step(now_s, utc_ns)
        self.expire(now_s)
        while self._late_heard and self._late_heard[0][0] <= now_s:
            self.nodes.feed(self._late_heard.popleft()[1], now_s)
        frames = self._disturbed(self.nodes.step(now_s, utc_ns), self._late, now_s)
        while self._late and self._late[0][0] <= now_s:
            frames.append(self._late.popleft()[1])
        return [] if "bus_off" in self.on else frames

    def feed(self, frame: Frame, now_s: float) -> None:
        """Feed a frame, as `Nodes.feed` does."""
        if not self.on:
            self.nodes.feed(frame, now_s)
        elif "bus_off" not in self.on:
            for heard in self._disturbed([frame], self._late_heard, now_s):
                self.nodes.feed(heard, now_s)

    def _disturbed(self, frames: Iterable[Frame], late: deque[tuple[float, Frame]], now_s: float) -> list[Frame]:
        """The frames that arrive now out of these."""
        drop, double = self.on.get("frames_dropped", 0.0), self.on.get("frames_duplicated", 0.0)
        if drop:
            frames = [frame for frame in frames if self._random.random() >= drop]
        if double:
            frames = [each for frame in frames for each in ([frame] * (2 if self._random.random() < double else 1))]
        if "frames_late" in self.on:
            late.extend((now_s + self.on["frames_late"], frame) for frame in frames)
            return []
        return list(frames)

    def _set(self, kind: str, where: str, value: float, on: bool) -> None:
        """Apply the effect of a fault to the nodes and the model."""
        navigation, receivers = self.nodes.navigation, self.nodes.receivers
        match kind:
            case "navigation_silent":
                for each in self._parts(where):
                    each.silent = on
            case "navigation_frozen":
                for each in self._parts(where):
                    each.frozen = on
            case "navigation_repeating":
                navigation.repeating = on
            case "navigation_jumping":
                navigation.jump_m = value
                for receiver in receivers:
                    receiver.jump_m = value
            case "navigation_forged":
                navigation.forged_rad = math.radians(value)
            case "gnss_poor":
                navigation.satellites = min(max(round(value), 0), SATELLITES) if on else SATELLITES
                for receiver in receivers:
                    receiver.satellites = navigation.satellites
            case "accuracy_poor":
                for receiver in receivers:
                    receiver.stated_m = value if on else receiver.position_m
            case "corrections_lost":
                for receiver in receivers:
                    receiver.uncorrected = on
            case "shallow":
                model = self.model
                model.bank = Bank(model.north_m, model.east_m, value) if on else None
            case "weeds":
                self.model.weeds_s = max(value, 0.0) if on else 0.0
            case "capsized":
                self.model.heel_rad = math.radians(value)
            case "heading_jumping" | "compass_cable" | "gyro_drift":
                for compass in self.nodes.compasses:
                    _disturb(compass, kind, math.radians(value))
            case "ais_silent" | "ais_frozen" | "ais_late" | "ais_wrong" if self.nodes.shipping is not None:
                _disturb_ais(self.nodes.shipping, kind, value, on)
            case "sensor_bad":
                self.nodes.sensors[where].bad = on
            case "sensor_silent":
                self.nodes.sensors[where].silent = on
            case _ if kind in DRIVE_FAULTS:
                self._drive(where).fault = DRIVE_FAULTS[kind] if on else None
            case "battery_sag" if on:
                drive = self._drive(where)
                drive.charge = min(drive.charge, max(value, 0.0))

    def begin(self, broken: Breakage, now_s: float) -> None:
        """Begin a fault. Raises FormatError if this boat has no such node."""
        if broken.kind in WHERE and broken.where not in self.nodes.sensors:
            raise FormatError(f"{broken.kind}: this boat has no {broken.where}")
        if broken.kind in PARTS and not self._parts(broken.where):
            raise FormatError(f"{broken.kind}: this boat has no {broken.where}")
        if broken.kind in OF_COMPASS and not self.nodes.compasses:
            raise FormatError(f"{broken.kind}: this boat has no compass")
        if broken.kind in OF_PULSES and not self.is_outlet:
            raise FormatError(f"{broken.kind}: in lock step alone, on a boat by pulses; in real time, kill -STOP its outlet")
        if broken.kind in OF_AIS and self.nodes.shipping is None:
            raise FormatError(f"{broken.kind}: there are no other vessels")
        super().begin(broken, now_s)

    def _parts(self, where: str) -> Sequence[NavigationNode | GnssReceiver | Compass]:
        """The sensors of navigation, of one kind or all."""
        nodes = self.nodes
        if not where:
            return nodes.navigation, *nodes.receivers, *nodes.compasses
        return nodes.receivers if where == "receiver" else nodes.compasses

    def _drive(self, name: str) -> Drive:
        return self.model.drives[name]


def _disturb(compass: Compass, kind: str, value: float) -> None:
    """Disturb a compass by rad, rad for each ampere, or rad/s a minute; 0 ends it. The bias that a gyro has by then stays."""
    if kind == "heading_jumping":
        compass.jump_rad = value
    elif kind == "compass_cable":
        compass.cable_rad_per_a = value
    else:
        compass.drift_radps2 = value / 60.0


def _disturb_ais(receiver: Shipping, kind: str, value: float, on: bool) -> None:
    """Disturb a receiver of AIS by s or m; 0 ends it."""
    if kind == "ais_silent":
        receiver.silent = on
    elif kind == "ais_frozen":
        receiver.frozen = on
    elif kind == "ais_late":
        receiver.late_s = max(value, 0.0)
    else:
        receiver.wrong_m = max(value, 0.0)


class FaultyGuest(Guest):
    """A link to a guest computer that may be lost (`guest_lost`): its lines do not arrive."""

    def __init__(self, state: State, clock: Clock, faults: Broken) -> None:
        super().__init__(state, clock)
        self._faults = faults

    def hear(self, line: bytes) -> None:
        if "guest_lost" not in self._faults.on:
            super().hear(line)


class FaultyLog:
    """A state log on a disk that can be full (`disk_full`) or so slow that its writer hangs (`disk_slow`)."""

    def __init__(self, log: StateLog, faults: Broken) -> None:
        self._log, self._faults = log, faults
        self._began_s, self._hung_s = math.inf, 0.0
        self.dropped = 0
        self.noted = deque[str](maxlen=NOTED_MAX)  # the newest notes
        self.close = log.close

    def note(self, text: str) -> None:
        self.noted.append(text)
        self._log.note(text)

    def write(self, state: State, now_s: float) -> None:
        on = self._faults.on
        if on and ("disk_full" in on or "disk_slow" in on):
            self._began_s = min(self._began_s, now_s)
            self._hung_s = now_s - self._began_s
            self.dropped += 1
            return
        self._began_s, self._hung_s = math.inf, 0.0
        self._log.write(state, now_s)

    def reason(self) -> str:
        on = self._faults.on
        if not on:
            return self._log.reason()
        if "disk_full" in on:
            return "no space left on device"
        if "disk_slow" in on and self._hung_s > HANGS_S:
            return f"the writer has been hanging for {self._hung_s:.0f} s"
        return self._log.reason()
