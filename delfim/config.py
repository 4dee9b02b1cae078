"""The vehicle's file: one TOML table, one frozen class. A parameter is declared here once: name, unit, default, range.

`load(path)` reads and checks the file. There are no environment variables and no second list of options. A laboratory's own
part (`parts.py`) that the file names has its keys beside these: `whole` adds them.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, cast, get_args, get_type_hints

import msgspec

from delfim.base import parts
from delfim.base.cooperative import Sliced, Work
from delfim.base.errors import ConfigError
from delfim.base.geodesy import polygon_fault
from delfim.base.modes import Mode
from delfim.base.parts import OWN, OWN_NODES, TABLED, Drives, Part, named, of_kind, table_of
from delfim.base.ranges import (
    BatteryVoltage,
    BitRate,
    Bounds,
    Degrees,
    DsorNode,
    Fraction,
    Interface,
    Megabytes,
    Metres,
    Moment,
    Name,
    Seconds,
    Speed,
)
from delfim.base.tables import T, Table, decode, read_toml, text

PartName = Annotated[str, text("[a-z][a-z0-9_]{0,31}", "a small letter, then up to 31 small letters, digits or _")]
PartVersion = Annotated[str, text("[0-9A-Za-z.+!_-]{1,40}", "the version of its package, as 1.0.2")]
StickPulse = Annotated[float, msgspec.Meta(ge=800.0, le=2200.0)]  # us, of a channel of a hand-set
STICK_US = 100.0  # the least way of a stick to either side
Gain = Annotated[float, msgspec.Meta(ge=0.0, le=1e7)]
Inertia = Annotated[float, msgspec.Meta(gt=0.0, le=1e9)]
Nice = Annotated[int, msgspec.Meta(ge=-20, le=19)]
NodeName = Literal["gps", "propeller_starboard", "propeller_port", "batteries_starboard", "batteries_port"]
SOURCES, HEARD = (tuple(of_kind(OWN.values(), kind)) for kind in ("source", "vessels"))
DRIVERS = tuple(sorted(of_kind(OWN.values(), "driver")))
DEFAULT_SENSOR, *_OTHERS = of_kind(OWN.values(), "sensor")
SENSORS = DEFAULT_SENSOR, *sorted(_OTHERS)

STEERED = tuple(
    mode.name.lower() for mode in Mode if mode not in (Mode.IDLE, Mode.MANUAL, Mode.TRIAL, Mode.UNSTICK)
)  # those that may keep clear


def guarded(modes: tuple[str, ...]) -> Any:
    """Some of these modes."""
    return Annotated[tuple[Literal[modes], ...], msgspec.Meta(max_length=len(modes))]  # type: ignore[valid-type]


if TYPE_CHECKING:
    SourceName = str
    DriverName = str
    SensorName = str
    HeardName = str  # who tells of other vessels
    GuardedModes = tuple[str, ...]
else:
    SourceName, DriverName, SensorName = Literal[SOURCES], Literal[DRIVERS], Literal[SENSORS]
    HeardName = Literal[HEARD]
    GuardedModes = guarded(STEERED)
HELMSMEN_MAX, MODE_NAME_MAX = 16, 26  # payload programs that may have the boat; characters of their names
Place = Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]  # m from the middle of the boat
Newtons = Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
Curve = Annotated[tuple[tuple[Annotated[float, msgspec.Meta(ge=-1.0, le=1.0)], Newtons], ...], msgspec.Meta(max_length=64)]
Revolutions = Annotated[float, msgspec.Meta(ge=0.0, le=100_000.0)]
ThrusterName = Annotated[str, text("[a-z][a-z0-9_]{0,15}", "a small letter, then up to 15 small letters, digits or _")]
DriverAddress = Annotated[int, msgspec.Meta(ge=0, le=255)]
Sources = Annotated[tuple[SourceName, ...], msgspec.Meta(min_length=1, max_length=len(SOURCES))]
OTHER_NODES = (0x01, 0x02, 0x10, 0x11, 0x20, 0x21)  # of `messages.Node`
NODES_PROTOCOL = "DSOR"  # of the boat's own nodes
ASTERN = 0.05  # of the surge ahead: a boat that pushes less astern cannot go there
PUSH_MIN = 0.1  # N and N·m: less is nothing
TAKEN_VEHICLES = (0x40, 0xA0)  # commands to actuators, and reset, have these identifiers
DsorVehicle = Annotated[int, msgspec.Meta(ge=0, le=0xF0, multiple_of=16)]
ActionName = Literal["warn", "hold", "back", "home", "stop"]
StuckAction = Literal["warn", "hold", "back", "unstick", "home", "stop"]
ModeAction = Literal["same", "warn", "hold", "back", "home", "stop"]
ReturnName = Literal["same", "hold", "resume", "home", "idle"]
EndMode = Literal["hold", "idle"]
FixName = Literal["2d", "3d", "differential", "rtk_float", "rtk"]  # from bad to good
Position = tuple[Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)], Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]]
CORNERS, ZONES, AREAS = 100, 100, 20  # of a polygon, to keep out of, and to keep in, at most
Day = Annotated[str, text("([0-9]{4}-[0-9]{2}-[0-9]{2})?", "a day as 2026-11-27, or empty")]
Ring = Annotated[tuple[Position, ...], msgspec.Meta(max_length=CORNERS)]  # corners of a polygon, degrees north and east
ValueName = Annotated[str, text("[a-z][a-z0-9_]{0,31}", "the name of a value, as depth_m")]


class BoatTable(Table, frozen=True):
    """Name and size of the boat. Missing values of the hull are guessed from its length and beam (docs/propulsion.md)."""

    name: Name  # of the boat, in logs and on screens
    id: Annotated[int, msgspec.Meta(ge=1, le=249)] = 1  # on the console's link
    length_m: Metres = 4.5  # over all; the model scales with it
    beam_m: Metres = 2.45  # over all
    draught_m: Annotated[float, msgspec.Meta(ge=0.0, le=20.0)] = 0.0  # the least water that carries her; 0: not known
    air_draught_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.0  # from the water to her top; 0: not known
    mass_kg: Annotated[float, msgspec.Meta(gt=0.0, le=1e6)] | None = None  # as it sails; without it, 20 kg per m2
    full_mps: Speed | None = None  # speed at full thrust, calm water; without it, guessed from the length
    drag_n_per_mps: Gain | None = None  # ahead; with the next one, instead of full_mps
    drag_n_per_mps2: Gain | None = None  # and with the square of the speed
    inertia_kgm2: Inertia | None = None  # of a turn, with the water's; without it, guessed from mass and length
    yaw_nm_per_radps: Gain | None = None  # of the water against a slow turn at cruising speed; without it, from the length
    yaw_nm_per_radps2: Gain | None = None  # and with the square of the rate of turn; counts beside the key above


class Can(Table, frozen=True):
    """The bus of the boat's own nodes: a Linux interface, `canloop:NAME`, or `python-can:INTERFACE:CHANNEL[@BITRATE]`."""

    interface: Interface = "can0"  # the bus
    bitrate_bps: BitRate = 500_000  # of a Linux interface, which the first process sets up (docs/boot.md)
    node: DsorNode = 0  # of this computer in the DSOR protocol; 0 is the gateway of DelfimX
    vehicle: DsorVehicle = 0xC0  # identifier of the time frame, a multiple of 16; 192 (0xC0) is DelfimX
    receive_buffer_bytes: Annotated[int, msgspec.Meta(ge=4096, le=64 << 20)] = 1 << 20  # of each socket

    def __post_init__(self) -> None:
        if self.node in OTHER_NODES:
            raise ValueError(f"node {self.node} is another one of the boat")
        if self.vehicle in TAKEN_VEHICLES:
            raise ValueError(f"frames of vehicle {self.vehicle:#04x} would be commands to propellers or nodes")


ESTIMATED = frozenset(of_kind(OWN.values(), "separate"))


class NavigationTable(Table, frozen=True):
    """Sources in order of preference; the next one is taken when the data of the one before is older than `stale_s`."""

    sources: Sources = SOURCES[:1]  # best first
    rate_hz: Annotated[float, msgspec.Meta(ge=0.5, le=1000.0)] = 5.0  # messages a second that the navigation node sends
    stale_s: Seconds = 1.0  # a source silent for longer is not used
    jump_mps: Speed = 15.0  # a position that would need more than this speed is refused ...
    jump_m: Metres = 10.0  # ... where it is more than this beyond what that speed allows
    estimator: bool = False  # for sources of separate sensors: smooth them and fill their gaps (docs/estimator.md)

    def __post_init__(self) -> None:
        if self.estimator and not ESTIMATED & set(self.sources):
            raise ValueError(
                f"estimator: only for {', '.join(sorted(ESTIMATED))}; these sources make whole messages by themselves"
            )


class EstimatorTable(Table, frozen=True):
    """The estimator's knowledge of the sensors, where `navigation.estimator` is set (docs/estimator.md)."""

    position_m: Annotated[float, msgspec.Meta(ge=0.005, le=100.0)] = 0.5  # standard deviation of a position, per axis
    velocity_mps: Annotated[float, msgspec.Meta(ge=0.005, le=10.0)] = 0.1  # of a velocity, per axis
    heading_deg: Annotated[float, msgspec.Meta(ge=0.05, le=90.0)] = 2.0  # of a heading
    rate_degps: Annotated[float, msgspec.Meta(ge=0.001, le=30.0)] = 0.3  # of the gyro's rate of turn
    acceleration_mps2: Annotated[float, msgspec.Meta(ge=0.01, le=10.0)] = 0.24  # of the boat, unforeseen: deviation per axis
    antenna_forward_m: Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)] = 0.0  # of the point that shall be steered
    antenna_starboard_m: Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)] = 0.0  # of it
    position_latency_s: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.0  # age of position and velocity when they come
    heading_latency_s: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.0  # age of a heading when it comes


Iron = Annotated[float, msgspec.Meta(ge=-0.9, le=0.9)]
HARD_MOST = 0.9  # of the earth's field: with more the heading turns back where the boat turns on


class CompassTable(Table, frozen=True):
    """The boat's iron about a magnetic compass on NMEA 0183 or NMEA 2000, as parts of the earth's horizontal field. It is taken
    out of each magnetic heading before the variation is added (docs/sensors.md)."""

    hard_ahead: Iron = 0.0  # field of its magnets ahead
    hard_aside: Iron = 0.0  # and to starboard
    soft_along: Annotated[float, msgspec.Meta(ge=-0.4, le=0.4)] = 0.0  # its iron gathers the field ahead more than aside
    soft_across: Annotated[float, msgspec.Meta(ge=-0.4, le=0.4)] = 0.0  # and turns it aside
    offset_deg: Degrees = 0.0  # what the compass says too much as it is mounted: it is turned so far to port

    def __post_init__(self) -> None:
        felt = math.hypot(self.hard_ahead, self.hard_aside) / (1.0 - math.hypot(self.soft_along, self.soft_across))
        if felt > HARD_MOST:
            raise ValueError(
                f"the iron is {felt:.2f} of the earth's field, {HARD_MOST:g} at most: give the compass another place"
            )


class TrafficGuard(Table, frozen=True):
    """Keeping clear of other vessels by the rules of the road (docs/traffic.md)."""

    enabled: bool = True  # False: the boat tells of dangers, and keeps its course
    modes: GuardedModes = ("hold", "goto", "play", "path", "home", "course")  # in which course and speed may change
    look_s: Annotated[float, msgspec.Meta(ge=60.0, le=900.0)] = 180.0  # 180: a crowded harbour, 420: open water
    stand_on: Literal["never", "small", "always"] = "small"  # for vessels that must give way: none, those below 20 m, all
    away_m: Annotated[float, msgspec.Meta(ge=10.0, le=100_000.0)] = 1000.0  # so far from leg or place others may move the boat
    away_s: Annotated[float, msgspec.Meta(ge=10.0, le=86_400.0)] = 1800.0  # and for so long; then on_failure, for as long again
    thing_clear_m: Annotated[float, msgspec.Meta(ge=1.0, le=200.0)] = 10.0  # from what stands to the boat's side or end
    person_clear_m: Annotated[float, msgspec.Meta(ge=5.0, le=500.0)] = 30.0  # the same of a swimmer; twice as near, half speed
    person_stop_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 8.0  # nearer to one the propellers stop; 0: never
    on_failure: Literal["warn", "slow", "hold"] = "warn"  # where the guard cannot work: go on, at half speed, or hold
    overruled_s: Annotated[float, msgspec.Meta(ge=10.0, le=3600.0)] = 600.0  # an operator who overrules it does so for so long
    stopped_s: Annotated[float, msgspec.Meta(ge=10.0, le=86_400.0)] = 600.0  # a longer stop is told: it may be for nothing


class TrafficTable(Table, frozen=True):
    """Other vessels: who tells of them, and how long one that falls silent is believed in (docs/traffic.md)."""

    mmsi: Annotated[int, msgspec.Meta(ge=0, le=999_999_999)] = 0  # the boat's own number, which is no other vessel; 0: none
    hears: Annotated[tuple[HeardName, ...], msgspec.Meta(max_length=len(HEARD))] = HEARD  # of these
    lost_a_s: Seconds = 60.0  # silence after which class A is lost, up to 14 kn; faster, 0.6 and from 23 kn on 0.5 of it
    lost_b_s: Seconds = 180.0  # the same of class B, above 2 kn
    lost_rest_s: Seconds = 1080.0  # of class A at anchor, moored or aground, and of class B below 2 kn
    lost_near_s: Seconds = 15.0  # of boats of the fleet and what a payload sees
    kept_thing_s: Annotated[float, msgspec.Meta(ge=1.0, le=86_400.0)] = 600.0  # a thing out of view is kept so long at most
    guard: TrafficGuard = TrafficGuard()


class Steer(Table, frozen=True):
    """The turning of a thruster: the whole of it (azimuth; an outboard turns by little), or a rudder in its stream."""

    kind: Literal["azimuth", "rudder"]  # a rudder gives side force only while its propeller pushes ahead
    address: DriverAddress = 0  # of what turns it, as the driver has it
    angle_max_deg: Annotated[float, msgspec.Meta(ge=5.0, le=180.0)] = 35.0  # to either side; 180: all round
    rate_dps: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 30.0  # how fast it turns, degrees a second
    reversed: bool = False  # mounted so that what its driver calls starboard turns it to port
    middle_deg: Annotated[float, msgspec.Meta(ge=-20.0, le=20.0)] = 0.0  # where its driver sees it when it points straight
    forbidden_deg: Annotated[tuple[tuple[Degrees, Degrees], ...], msgspec.Meta(max_length=8)] = ()  # no thrust from .. to

    def __post_init__(self) -> None:
        for start, end in self.forbidden_deg:
            if start >= end:
                raise ValueError(f"forbidden_deg: from {start:g} to {end:g} is no sector: the smaller angle comes first")
        if self.kind == "rudder" and self.angle_max_deg > 60.0:
            raise ValueError(f"angle_max_deg: a rudder at {self.angle_max_deg:g} degrees brakes; 60 at most")

    @property
    def as_told(self) -> tuple[float, float, float]:
        """Factor and sum that make of an angle, rad, the one that the driver tells, and the greatest of these."""
        return -1.0 if self.reversed else 1.0, math.radians(self.middle_deg), math.radians(self.angle_max_deg)


class ThrusterTable(Table, frozen=True):
    """A thruster: who drives it, where it is, where and how strongly it pushes the boat. Its force follows from the command c
    by a law, end * ((|c| - dead) / (1 - dead)) ^ power, or by a curve."""

    name: ThrusterName  # in the log, on screens, in `delfim fault`
    driver: DriverName  # who commands it
    address: DriverAddress = 0  # as the driver has it: ESC index, controller's number, channel
    x_m: Place = 0.0  # ahead of the middle of the boat
    y_m: Place = 0.0  # to starboard of it
    angle_deg: Degrees = 0.0  # where it pushes the boat: 0 ahead, 90 to starboard
    thrust_n: tuple[Newtons, Newtons] = (0.0, 0.0)  # at full command astern (0 or less) and ahead (more than 0)
    power: Annotated[float, msgspec.Meta(ge=0.2, le=4.0)] = 2.0  # of the law: 2 where the command is revolutions, 1 where force
    dead: Annotated[float, msgspec.Meta(ge=0.0, le=0.9)] = 0.0  # command up to which there is no force
    curve: Curve = ()  # instead of thrust_n, power and dead: [command, N], from the least command to the greatest
    rpm_max: Revolutions = 0.0  # that it reports at full command; 0: not known, or the driver's table has it
    rate_per_s: Annotated[float, msgspec.Meta(gt=0.0, le=100.0)] = 1.0  # steepest change of the command, of full a second
    reversed: bool = False  # mounted so that what its driver calls ahead pushes astern
    delay_s: Annotated[float, msgspec.Meta(ge=0.0, le=2.0)] = 0.0  # measured, from a command until the motor begins to obey
    lag_s: Annotated[float, msgspec.Meta(ge=0.01, le=10.0)] | None = None  # measured time constant of the motor
    steer: Steer | None = None  # what turns it; a fixed thruster has none

    def __post_init__(self) -> None:
        if bool(self.curve) == (self.thrust_n != (0.0, 0.0)):
            raise ValueError("either thrust_n = [astern, ahead] or a curve; not both, and not thrust_n = [0, 0]")
        astern, ahead = self.thrust_n
        if not self.curve and (astern > 0.0 or ahead <= 0.0):
            raise ValueError(f"thrust_n: [{astern:g}, {ahead:g}] has ahead and astern exchanged: astern comes first, 0 or less")
        if self.curve:
            self._check_curve()

    def _check_curve(self) -> None:
        for (c, _), (after, _) in pairwise(self.curve):
            if after < c:
                raise ValueError(f"curve: the command {after:g} comes after {c:g}: they must rise")
        if self.curve[0][0] not in (-1.0, 0.0) or self.curve[-1][0] != 1.0:
            raise ValueError("curve: it must go from the command -1, or 0 where it gives nothing astern, to 1")
        if self.curve[-1][1] < self.curve[0][1]:
            raise ValueError("curve: ahead and astern are exchanged: the greatest command gives the least force")
        for (c, n), (after, more) in pairwise(self.curve):
            if more < n:
                raise ValueError(f"curve: it is not monotonic: {more:g} N at {after:g} after {n:g} N at {c:g}")
        if not self.ends_n[0] <= 0.0 < self.ends_n[1]:
            raise ValueError("curve: force astern, where there is any, has a minus, and there must be some ahead")
        if (0.0, 0.0) not in self.curve or any(n for c, n in self.curve if c == 0.0):
            raise ValueError("curve: it needs the point [0, 0], and no other at the command 0: no command, no force")

    @property
    def ends_n(self) -> tuple[float, float]:
        """Force at full command astern and ahead, N."""
        return (self.curve[0][1], self.curve[-1][1]) if self.curve else self.thrust_n


class PropulsionTable(Table, frozen=True):
    """The propulsion as a whole."""

    MOVED: ClassVar[dict[str, str]] = {
        "actuators": "[[thrusters]] with a driver each",
        "rpm_max": "dsor.rpm_max",
        "rpm_per_s_max": "rate_per_s of [[thrusters]], as a part of full command a second",
        "speed_per_rpm_mps": "boat.full_mps, the speed at full thrust",
    }


# The propellers of DelfimX under the middle of its hulls; their force is that of the simulator's model, at rest.
DELFIMX: Final = tuple(
    ThrusterTable(name=name, driver=OWN_NODES, address=address, x_m=-2.0, y_m=y_m, thrust_n=(-319.0, 532.0), rate_per_s=0.6667)
    for address, (name, y_m) in enumerate((("starboard", 1.029), ("port", -1.029)))
)
Thrusters = Annotated[tuple[ThrusterTable, ...], msgspec.Meta(min_length=1, max_length=16)]


class HeadingTable(Table, frozen=True):
    """Heading autopilot: yaw moment, N m, per rad and per rad/s, and an integral against wind. Gains that are not given follow
    from the hull and its thrusters."""

    MOVED: ClassVar[dict[str, str]] = {
        "p_rpm_per_rad": "p_nm_per_rad",
        "p_limit_rpm": "p_limit_nm",
        "d_rpm_per_radps": "d_nm_per_radps",
        "turn_rpm_per_radps": "turn_nm_per_radps",
        "i_rpm_per_rad_s": "i_nm_per_rad_s",
        "i_limit_rpm": "i_limit_nm",
    }
    p_nm_per_rad: Gain | None = None  # yaw moment for a heading error
    p_limit_nm: Gain | None = None  # limit of that: sets the rate of turn
    d_nm_per_radps: Gain | None = None  # yaw moment against a rate of turn
    turn_nm_per_radps: Gain | None = None  # yaw moment that keeps a turn going, on an arc
    i_nm_per_rad_s: Gain | None = None  # integral gain: yaw moment for a heading error that lasts
    i_limit_nm: Gain | None = None  # limit of the integral
    ahead_per_mps: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0  # p and i grow by this part for each m/s ahead
    turn_dps: Annotated[float, msgspec.Meta(gt=0.0, le=180.0)] | None = None  # of a turn in heading mode; null: no bound ...
    turn_dps2: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] | None = None  # ... and how quickly that rate changes

    def __post_init__(self) -> None:
        if (self.turn_dps is None) != (self.turn_dps2 is None):
            raise ValueError("turn_dps and turn_dps2 bound a turn together: give both, or none")


class SpeedTable(Table, frozen=True):
    """Speed controller: surge force, N, from the hull's drag, and an integral against wind and sea. Gains that are not given
    follow from the hull and its thrusters."""

    MOVED: ClassVar[dict[str, str]] = {
        "p_rpm_per_mps": "p_n_per_mps",
        "i_rpm_per_m": "i_n_per_m",
        "i_limit_rpm": "i_limit_n",
    }
    p_n_per_mps: Gain | None = None  # surge for a speed error
    i_n_per_m: Gain | None = None  # integral gain: surge for a speed error that lasts
    i_limit_n: Gain | None = None  # limit of the integral
    ramp_mps2: Annotated[float, msgspec.Meta(ge=0.01, le=10.0)] = 0.4  # how fast the speed asked for may change
    cruise_mps: Speed = 1.5  # for a command or a waypoint that names no speed
    max_mps: Speed = 2.2  # highest speed that a mode may ask for


class PathTable(Table, frozen=True):
    """Line-of-sight guidance with integral action against current, for missions, paths and the way home."""

    lookahead_m: Metres = 8.0  # the boat steers for a point of the path this far ahead
    integral_gain: Gain = 0.1  # m/s: how fast a lasting cross-track error turns into crab angle
    crab_s: Seconds = 1.0  # smoothing of the measured crab angle
    acceptance_m: Metres = 5.0  # a waypoint is reached within this radius unless it names its own


class GotoTable(Table, frozen=True):
    """The end of "go to": hold, whose propellers start again whenever the boat drifts off, or idle, which is a stop."""

    end: EndMode = "hold"  # unless the command names its own


class HoldTable(Table, frozen=True):
    """Station keeping."""

    radius_m: Metres = 5.0  # inside this radius the boat rests; one that pushes sideways keeps the point itself
    speed_mps: Speed = 1.0  # highest speed for coming back


class HomeTable(Table, frozen=True):
    """The way back along the driven track."""

    spacing_m: Metres = 5.0  # between remembered points of the driven track
    points: Annotated[int, msgspec.Meta(ge=2, le=1500)] = 1500  # remembered points; when they are used up, the spacing doubles
    speed_mps: Speed = 1.5  # on the way home


class UnstickTable(Table, frozen=True):
    """Astern out of weeds or from the ground, by the way it came: until the boat is away from where it began, or time is up."""

    distance_m: Annotated[float, msgspec.Meta(ge=2.0, le=200.0)] = 15.0  # so far away it is free
    time_s: Annotated[float, msgspec.Meta(ge=1.0, le=600.0)] = 45.0  # after that it gives up, and holds
    speed_mps: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 1.0  # astern
    then: Literal["hold", "home"] = "hold"  # when it is free; one that was on its way home goes on home


class ControlTable(Table, frozen=True):
    heading: HeadingTable = HeadingTable()
    speed: SpeedTable = SpeedTable()
    path: PathTable = PathTable()
    goto: GotoTable = GotoTable()
    hold: HoldTable = HoldTable()
    home: HomeTable = HomeTable()
    unstick: UnstickTable = UnstickTable()


if TYPE_CHECKING:

    class _EachMode(Table, frozen=True): ...

    class _AfterRestart(Table, frozen=True): ...
else:  # one key for each mode in which something can be stopped

    def _each_mode(name: str, actions: object) -> type[Table]:
        keys = [(mode.name.lower(), actions, "same") for mode in Mode if mode is not Mode.IDLE]
        return msgspec.defstruct(name, keys, bases=(Table,), frozen=True, forbid_unknown_fields=True, kw_only=True)

    _EachMode, _AfterRestart = _each_mode("_EachMode", ModeAction), _each_mode("_AfterRestart", ReturnName)


class Trouble(_EachMode, frozen=True):
    """The response to a trouble: `action`, unless the key of the present mode names another one."""

    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 0.0  # the trouble must last this long
    action: ActionName = "stop"  # in every mode whose own key is "same"


class Silence(Trouble, frozen=True):
    """A trouble with an age of its own: `after_s` is the age at which it begins."""


class NavigationSilent(Silence, frozen=True):
    """No navigation message (the thesis' rule)."""

    after_s: Seconds = 1.0  # age of the last one


class NavigationJumping(Silence, frozen=True):
    """Positions that only a boat faster than `navigation.jump_mps` could reach."""

    after_s: Seconds = 0.5  # from the first one that was refused to the last


class NavigationTwice(Silence, frozen=True):
    """Messages of the navigation node that do not follow one another: somebody else speaks in its name."""

    after_s: Seconds = 10.0  # three within this time
    manual: ModeAction = "warn"


class NavigationFrozen(Silence, frozen=True):
    """Navigation messages that are identical to the last bit while the propellers turn."""

    after_s: Seconds = 3.0  # since something changed


class SensorBad(Trouble, frozen=True):
    """A node of `sysstat.required` that reports bad or is silent for `sysstat.stale_s` (the thesis' rule)."""


class ConsoleSilent(Silence, frozen=True):
    """No message from the operator's console."""

    after_s: Annotated[float, msgspec.Meta(ge=0.5, le=3600.0)] = 10.0  # age of the last one; consoles say something each second
    action: ActionName = "home"
    manual: ModeAction = "stop"
    home: ModeAction = "warn"
    unstick: ModeAction = "warn"


class ManualSilent(Silence, frozen=True):
    """No manual command, in manual mode: first no thrust, then this."""

    after_s: Moment = 5.0  # age of the last one
    thrust_s: Moment = 1.8  # age of the last one at which thrust goes to zero, at the next look of the watchdog: within 2 s


class GuestSilent(Silence, frozen=True):
    """No reference of the guest computer, in GREX mode."""

    after_s: Seconds = 5.0  # age of the last one
    action: ActionName = "hold"


class BatteryLow(Trouble, frozen=True):
    """The batteries of either side are low."""

    charge: Fraction = 0.25  # this much, or less ...
    voltage_v: BatteryVoltage = 0.0  # ... or so many volts, or less, at a battery or thruster, under load; 0: not looked at
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 5.0  # for this long
    action: ActionName = "home"
    manual: ModeAction = "warn"
    home: ModeAction = "warn"
    unstick: ModeAction = "warn"


class BatteryCritical(Trouble, frozen=True):
    """The batteries of either side are almost empty; the rest is for radio and computer. A mode that this stops is refused."""

    charge: Fraction = 0.1  # this much, or less ...
    voltage_v: BatteryVoltage = 0.0  # ... or so many volts, or less, at a battery or thruster, under load; 0: not looked at
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 5.0  # for this long
    manual: ModeAction = "warn"
    home: ModeAction = "warn"


class EnergyShort(Trouble, frozen=True):
    """The way home takes all that the batteries hold but the reserve, by what was learnt of power and current."""

    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 10.0  # for this long
    action: ActionName = "home"
    manual: ModeAction = "warn"
    home: ModeAction = "warn"
    unstick: ModeAction = "warn"


class FenceNear(Trouble, frozen=True):
    """The boat is about to cross the fence: it can no longer stop at `fence.margin_m` from it."""

    action: ActionName = "hold"


class FenceLeft(Trouble, frozen=True):
    """The boat is farther than `fence.margin_m` outside the fence, and comes no nearer."""

    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 15.0  # for this long: it must turn
    manual: ModeAction = "warn"


class ThrusterAstray(Trouble, frozen=True):
    """A thruster does not do as commanded, by its own report: it is dead, stuck, reversed, overloaded or no longer heard."""

    error_rpm: Annotated[float, msgspec.Meta(gt=0.0, le=10_000.0)] = 300.0  # difference that is tolerated: this ...
    error: Fraction = 0.25  # ... plus this part of the command
    error_deg: Annotated[float, msgspec.Meta(gt=0.0, le=180.0)] = 20.0  # the same of what turns
    idle_rpm: Annotated[float, msgspec.Meta(gt=0.0, le=10_000.0)] = 100.0  # tolerated speed of one that was switched off
    current_a: Annotated[float, msgspec.Meta(ge=0.0, le=10_000.0)] = 0.0  # more than this is an overload; 0: no limit
    temperature_c: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 0.0  # the same of its temperature
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 4.0  # for this long
    manual: ModeAction = "warn"
    disconnect: bool = True  # if a stopped propeller turns: disconnect its batteries until the program restarts


class GnssPoor(Trouble, frozen=True):
    """Satellite navigation is worse than this. Values that the receiver does not tell are not bad, but for accuracy_m and
    corrections_s where they have a limit. A mode whose action is more than "warn" is refused."""

    satellites: Annotated[int, msgspec.Meta(ge=0, le=99)] = 5  # fewer in use than this, or ...
    hdop: Annotated[float, msgspec.Meta(gt=0.0, le=100.0)] = 5.0  # ... a dilution of precision above this, or ...
    fix: FixName = "2d"  # ... a fix worse than this, or ...
    accuracy_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.0  # ... a stated accuracy above this, or ... (0: no limit)
    corrections_s: Annotated[float, msgspec.Meta(ge=0.0, le=600.0)] = 0.0  # ... corrections older than this (0: no limit)
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 5.0  # for this long
    action: ActionName = "warn"
    manual: ModeAction = "warn"


class HandsetSilent(Silence, frozen=True):
    """Nothing new from the hand-set that the file names. In manual mode by hand-set its thrust ends at once."""

    after_s: Seconds = 1.0  # age of the last
    action: ActionName = "warn"


class Shallow(Trouble, frozen=True):
    """The echo sounder finds less water than the boat needs. A depth that is not known is neither shallow nor deep: name it in
    `sensors.required` if the boat must not sail without it."""

    min_depth_m: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 0.0  # less than this below the transducer; 0: not watched
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 2.0  # for this long
    action: ActionName = "back"
    manual: ModeAction = "warn"
    home: ModeAction = "warn"


class Stuck(Trouble, frozen=True):
    """The thrusters push, and the boat goes neither forward nor round: it is aground, in weeds or nets, or the current is as
    fast. Looked at where a mode goes somewhere: not by hand, and not while the boat holds."""

    thrust: Fraction = 0.3  # of full thrust, or more ...
    speed_mps: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)] = 0.2  # ... and slower than this where twice as much is asked ...
    turn_deg: Annotated[float, msgspec.Meta(gt=0.0, le=180.0)] = 45.0  # ... or so far off its heading, and not turning
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 15.0  # for this long
    action: StuckAction = "hold"  # type: ignore[assignment]  # unstick: astern, out by the way it came, once at each place


class Capsized(Trouble, frozen=True):
    """The boat lies on its side, or keel up. A roll that nobody measures is none."""

    roll_deg: Annotated[float, msgspec.Meta(gt=0.0, le=180.0)] = 60.0  # to either side, more than this
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 3.0  # for this long


class Beyond(Trouble, frozen=True):
    """A value of a sensor, or of a payload program (`PAYLOAD.NAME`), is beyond a bound of the file: a leak, smoke. A value that
    is not known, or older than `sensors.stale_s`, is not beyond it."""

    above: Bounds = msgspec.field(default_factory=dict)  # by the names of values, as {"bilge.leak" = 0.5}
    below: Bounds = msgspec.field(default_factory=dict)  # the least of each, as it is told
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 2.0  # for this long
    action: ActionName = "home"
    manual: ModeAction = "warn"
    home: ModeAction = "warn"


class TrafficNear(Trouble, frozen=True):
    """Another vessel will come near: the boat would be in its domain within twice the time that the guard looks ahead. Or it is
    near: within two domains and closing."""

    cpa_m: Annotated[float, msgspec.Meta(ge=0.0, le=20_000.0)] = 0.0  # or it comes nearer than this (0: no limit) ...
    tcpa_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 600.0  # ... sooner than this
    zone_m: Annotated[float, msgspec.Meta(ge=0.0, le=20_000.0)] = 0.0  # or it is nearer than this (0: no limit)
    action: ActionName = "warn"


class TrafficClose(Trouble, frozen=True):
    """The boat is in another vessel's domain, or nothing that it could do keeps it out. To stop before a ship is no safe
    state."""

    action: ActionName = "warn"


class TrafficUnclear(Trouble, frozen=True):
    """The boat cannot heed all vessels: more are in its way than the guard judges, or come near than are known, more is
    reported than it can take, or the reports of one vessel contradict each other. In a crowd, or as somebody forges AIS."""

    action: ActionName = "warn"


class AisSilent(Silence, frozen=True):
    """No report of other vessels, from a receiver that has given some. With a transponder of one's own on the bus: not even its
    own report; where `traffic.mmsi` names it, none since the start counts, too."""

    after_s: Seconds = 180.0  # age of the last one
    own_s: Seconds = 30.0  # age of the own transponder's last one
    action: ActionName = "warn"


class OutletSilent(Silence, frozen=True):
    """The motors may turn: the outlet, which writes their pulses, does not answer, or cannot write a stop (docs/pwm.md). Told
    in idle, too."""

    after_s: Seconds = 1.5  # age of its last answer


class LogNotWritable(Trouble, frozen=True):
    """The state log is not being written."""

    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 5.0  # for this long
    action: ActionName = "warn"


class Restarted(_AfterRestart, frozen=True):
    """After a crash, a dead-man, or a power cut under way: `action`, unless the key of the mode before names another one."""

    within_s: Annotated[float, msgspec.Meta(ge=1.0, le=86_400.0)] = 600.0  # a boat that was off for longer stays idle
    action: Literal["hold", "resume", "home", "idle"] = "hold"  # resume: the mode of before, from where it was
    manual: ReturnName = "idle"
    trial: ReturnName = "idle"
    home: ReturnName = "resume"

    def __post_init__(self) -> None:
        if self.after("manual") == "resume":
            raise ValueError("thrust by hand is not resumed: manual is hold, home or idle")
        if self.after("trial") == "resume":
            raise ValueError("a trial is not resumed: trial is hold, home or idle")

    def after(self, mode: str) -> str:
        """What follows for the mode before, by its name in the vehicle's file."""
        own: str = getattr(self, mode)
        return self.action if own == "same" else own


class Failsafe(Table, frozen=True):
    """The response of the boat to each trouble in each mode (docs/failsafe.md). In idle there is nothing to stop."""

    pause_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 30.0  # time in hold before home, for the operator to overrule
    back_m: Metres = 20.0  # "back" holds this far back along the driven track
    clear_s: Seconds = 3.0  # a trouble is over when it was absent for this long
    navigation_silent: NavigationSilent = NavigationSilent()
    navigation_jumping: NavigationJumping = NavigationJumping()
    navigation_frozen: NavigationFrozen = NavigationFrozen()
    navigation_twice: NavigationTwice = NavigationTwice()
    sensor_bad: SensorBad = SensorBad()
    console_silent: ConsoleSilent = ConsoleSilent()
    manual_silent: ManualSilent = ManualSilent()
    guest_silent: GuestSilent = GuestSilent()
    battery_low: BatteryLow = BatteryLow()
    battery_critical: BatteryCritical = BatteryCritical()
    energy: EnergyShort = EnergyShort()
    fence: FenceNear = FenceNear()
    fence_left: FenceLeft = FenceLeft()
    thruster: ThrusterAstray = ThrusterAstray()
    gnss_poor: GnssPoor = GnssPoor()
    handset_silent: HandsetSilent = HandsetSilent()
    shallow: Shallow = Shallow()
    stuck: Stuck = Stuck()
    capsized: Capsized = Capsized()
    beyond: Beyond = Beyond()
    log: LogNotWritable = LogNotWritable()
    traffic: TrafficNear = TrafficNear()
    traffic_close: TrafficClose = TrafficClose()
    ais_silent: AisSilent = AisSilent()
    traffic_unclear: TrafficUnclear = TrafficUnclear()
    outlet: OutletSilent = OutletSilent()
    restarted: Restarted = Restarted()


class Area(Table, frozen=True):
    """An area that the boat must stay in or out of: a polygon or a circle."""

    name: Annotated[str, text(r"[^\x00-\x1f\x7f]{0,64}", "up to 64 characters")] = ""  # for people
    polygon: Ring = ()  # corners, [latitude_deg, longitude_deg]; or
    centre: Annotated[tuple[Position, ...], msgspec.Meta(max_length=1)] = ()  # [[latitude_deg, longitude_deg]] of a circle ...
    radius_m: Annotated[float, msgspec.Meta(ge=0.0, le=20_000.0)] = 0.0  # ... and its radius

    def __post_init__(self) -> None:
        if bool(self.polygon) == bool(self.centre):
            raise ValueError("either a polygon or a centre with a radius")
        if bool(self.centre) != bool(self.radius_m):
            raise ValueError("a circle needs its centre and its radius")


class Zones(Table, frozen=True):
    """Where the boat may be. A mission's zones come on top of the boat's own: both are obeyed."""

    version: Literal[1] = 1  # of this description
    keep_in: Annotated[tuple[Area, ...], msgspec.Meta(max_length=AREAS)] = ()  # the boat stays in one of these; empty: no limit
    keep_out: Annotated[tuple[Area, ...], msgspec.Meta(max_length=ZONES)] = ()  # zones that the boat does not enter


class FenceTable(Zones, frozen=True):
    """Where the boat may always be, and its stopping distance."""

    chart: Annotated[str, text("[^\\x00]{0,255}", "a file of delfim charts, or empty")] = ""  # what it forbids (docs/charts.md)
    margin_m: Metres = 3.0  # the boat stops at this distance from the fence
    mission_margin_m: Metres = 6.0  # missions keep this distance from it
    reaction_s: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 1.0  # from the command to stop until the boat slows down
    deceleration_mps2: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 0.3  # of the boat with propellers off, as measured


class AdoptedTable(Table, frozen=True):
    """What `delfim adopt` found out about the boat (docs/adopt.md)."""

    proven: bool = True  # its motors do what the file says; false: no failsafe steers, and only manual and trial are allowed
    on: Day = ""  # of the log that was fitted
    log: Annotated[str, text("[0-9a-f]{0,64}", "up to 64 hexadecimal digits")] = ""  # SHA-256 of that log
    chi2: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)] | None = None  # of the fit, per measurement: 2 at most
    turn_s: Annotated[float, msgspec.Meta(ge=-60.0, le=600.0)] | None = None  # of a turn from line to line, beyond its length
    run_in_m: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] | None = None  # of a line, until she is on it


class Checks(Table, frozen=True):
    """Conditions that must hold before the boat leaves idle, besides navigation and sensors."""

    clock_s: Seconds = 5.0  # largest difference between the computer's clock and that of navigation


class ClockTable(Table, frozen=True):
    """The computer's clock: set in idle, kept right under way."""

    set: Literal["auto", "never"] = "auto"  # auto: by this program, unless another one keeps it or the bus is simulated


class Stick(Table, frozen=True):
    """A stick of the hand-set: its channel, and the pulses of its middle and its ends."""

    channel: Annotated[int, msgspec.Meta(ge=1, le=16)]  # of the receiver
    low_us: StickPulse = 988.0  # astern, or to port
    middle_us: StickPulse = 1500.0  # at rest
    high_us: StickPulse = 2012.0  # ahead, or to starboard
    reversed: bool = False  # the two ends exchanged

    def __post_init__(self) -> None:
        if not self.low_us + STICK_US <= self.middle_us <= self.high_us - STICK_US:
            raise ValueError(f"low_us, middle_us, high_us rise by {STICK_US:g} us or more; reversed exchanges the ends")


class Switch(Table, frozen=True):
    """A switch of the hand-set."""

    channel: Annotated[int, msgspec.Meta(ge=0, le=16)] = 0  # of the receiver; 0: there is no such switch
    on: Literal["high", "low"] = "high"  # the position that means yes: above 1700 us, or below 1300 us


class HandsetTable(Table, frozen=True):
    """The hand-set of a radio control: it takes the boat from every console (docs/handset.md)."""

    device: Annotated[str, text("(/dev/[^ ]+)?", "/dev/NAME, or empty")] = ""  # serial port of its receiver; empty: no hand-set
    protocol: Literal["crsf", "sbus"] = "crsf"  # of the receiver; crsf is ExpressLRS and TBS Crossfire
    baud: Annotated[int, msgspec.Meta(ge=0, le=4_000_000)] = 0  # of the port; 0: the protocol's own, 420,000 or 100,000
    throttle: Stick = Stick(channel=3)
    steer: Stick = Stick(channel=1)
    take: Switch = Switch(channel=5)  # on: the hand-set has the boat
    kill: Switch = Switch()  # on: the boat is killed
    neutral: Annotated[float, msgspec.Meta(gt=0.0, le=0.3)] = 0.05  # part of a stick's way around its middle that is no thrust
    silent_s: Annotated[float, msgspec.Meta(ge=0.1, le=5.0)] = 0.5  # a receiver silent for longer is lost
    mandatory: bool = False  # the boat is killed while the hand-set is lost

    def __post_init__(self) -> None:
        if not self.take.channel:
            raise ValueError("take.channel: a hand-set needs a switch that takes the boat")
        used = [each.channel for each in (self.throttle, self.steer, self.take, self.kill) if each.channel]
        if len(set(used)) < len(used):
            raise ValueError("throttle, steer, take and kill are on channels of their own")
        if self.mandatory and not self.device:
            raise ValueError("mandatory: name the device of the hand-set")


class KillTable(Table, frozen=True):
    """A kill switch at a pin of the computer, to ground, normally closed: open is pressed, or broken (docs/handset.md)."""

    chip: Annotated[str, text("(/dev/gpiochip[0-9]+)?", "/dev/gpiochipNUMBER, or empty")] = ""  # of the pin; empty: no switch
    line: Annotated[str, text("[^ ]{0,31}", "a name without blanks, as gpioinfo lists it")] = ""  # name of the pin
    kills_at: Literal["high", "low"] = "high"  # the level that kills
    bias: Literal["pull-up", "pull-down", "none"] = "pull-up"  # the pin's own resistor

    def __post_init__(self) -> None:
        if bool(self.chip) != bool(self.line):
            raise ValueError("a kill switch needs both its chip and its line")


class Sensors(Table, frozen=True):
    """The sensors of the boat beside navigation."""

    names: Annotated[tuple[SensorName, ...], msgspec.Meta(max_length=len(SENSORS))] = (DEFAULT_SENSOR,)  # of the boat
    required: tuple[ValueName, ...] = ()  # values that the boat must have, as depth_m: silence is the trouble sensor_bad
    stale_s: Seconds = 5.0  # a value older than this is not known


class SounderTable(Table, frozen=True):
    """The echo sounder, as the chart of its soundings must know it (docs/survey.md). Aboard `confidence` alone counts: the log
    keeps what the sounder said."""

    ahead_m: Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)] = 0.0  # of the transducer, from the place navigation tells
    starboard_m: Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)] = 0.0  # of it
    draught_m: Annotated[float, msgspec.Meta(ge=0.0, le=20.0)] = 0.0  # of it below the water line; 0: what the sounder tells
    antenna_m: Annotated[float, msgspec.Meta(ge=-5.0, le=50.0)] = 0.0  # of navigation above the water line, for the tide by RTK
    latency_s: Annotated[float, msgspec.Meta(ge=-2.0, le=5.0)] = 0.0  # a depth comes so much later than its position
    sound_mps: Annotated[float, msgspec.Meta(ge=1300.0, le=1700.0)] = 1500.0  # the speed of sound that the sounder takes
    confidence: Fraction = 0.5  # a ping of less is no depth
    beam_deg: Annotated[float, msgspec.Meta(ge=0.0, le=90.0)] = 25.0  # of its beam: the echo is of what is nearest within it


class Sysstat(Table, frozen=True):
    """The nodes that must report, and how old a report may be. A bad or silent required node stops the boat."""

    required: tuple[NodeName, ...] | None = None  # that must report; without: of navigation and thrusters by "dsor"
    stale_s: Seconds = 5.0  # a node is silent when its last report is older


class Console(Table, frozen=True):
    """Commands and state on this computer."""

    socket: str = "/run/delfim/command"  # local commands and state, a UNIX socket
    clients: Annotated[int, msgspec.Meta(ge=1, le=100)] = 16  # connections at once


class LogTable(Table, frozen=True):
    """Where and how logs are written, and the response to a full disk."""

    directory: str = "/log"  # where logs go
    file_bytes: Annotated[int, msgspec.Meta(ge=4096, le=1 << 24)] = 1_000_000  # a new file is begun beyond this size
    file_s: Seconds = 600.0  # a new file is begun beyond this age
    free_bytes_min: Annotated[int, msgspec.Meta(ge=0)] = 64 << 20  # the guard keeps this much free
    when_full: Literal["delete-oldest", "stop"] = "delete-oldest"  # the guard deletes the oldest days, or stops the logs
    upload_folder: Name = "upload"  # the folder, in the root of ftpd and of sshd, where clients may write
    upload_bytes_max: Annotated[int, msgspec.Meta(ge=0)] = 256 << 20  # of all uploads, and at most a quarter of the disk
    upload_names_max: Annotated[int, msgspec.Meta(ge=0, le=10_000)] = 1000  # files and folders of all uploads
    state_method: Literal["write", "zwrite", "zpipe"] = "zpipe"  # plain, deflated in the program, deflated in a niced child
    required: bool = True  # no log, no start


class RuntimeTable(Table, frozen=True):
    """Real-time settings. If permission for one is missing, the log warns once and the runtime goes on without it."""

    nice: Nice = 0  # of the runtime
    fifo_priority: Annotated[int, msgspec.Meta(ge=0, le=98)] = 10  # the supervisor has one more; 0: the ordinary scheduler
    cpus: tuple[Annotated[int, msgspec.Meta(ge=0, le=1023)], ...] = ()  # empty: all
    mlockall: bool = False  # keep the runtime in memory
    window: bool = True  # navigation window: spin shortly before navigation is due
    window_share_max: Fraction = 0.1  # of one processor, at most
    window_guard_s: Annotated[float, msgspec.Meta(gt=0.0, le=0.05)] = 0.0006  # it opens this long before navigation is due
    callback_budget_s: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.0005  # longer callbacks of a service are reported
    run_directory: str = "/run/delfim"  # for sockets and state files


class SupervisorTable(Table, frozen=True):
    """The parent process: dead-man switch and restarts."""

    deadman_s: Annotated[float, msgspec.Meta(ge=0.1, le=60.0)] = 1.0  # after this silence the runtime is stopped and restarted
    backoff_s: Seconds = 0.1  # first pause before a restart; doubles each time
    backoff_max_s: Seconds = 10.0  # longest pause before a restart
    hardware_watchdog: str = "/dev/watchdog"  # fed if it exists; "" for none


class ServiceTable(Table, frozen=True):
    """A service of the suite, by its name."""

    enabled: bool = True  # run it
    place: Literal["default", "runtime", "process"] = "default"  # runtime: its loop; process: a process of idle priority
    memory_max_mb: Megabytes | None = None  # of its process and all it starts, restarted beyond; 0: no limit; null: 256, at sea
    cpu_max: Annotated[float, msgspec.Meta(ge=0.0, le=1024.0)] = 0.0  # processors that its process may use; 0: no limit
    log: Literal["debug", "info", "warning", "error"] = "info"  # the least level of its words that the system log keeps


def thrusters_fault(rows: Sequence[ThrusterTable], aboard: tuple[Part, ...]) -> str | None:
    """Why these thrusters cannot be those of one boat, in words; None: they can."""
    names, taken = set[str](), dict[tuple[str, str, int], str]()
    for row in rows:
        if row.name in names:
            return f"two have the name {row.name}"
        names.add(row.name)
        part = parts.row(aboard, row.driver)
        if (wrong := driver_fault(part, row, rows)) is not None:
            return f"{row.name}: {wrong}"
        turns = "pushes" if part.drives.channels else "turns"
        kinds = [("pushes", row.address)] + ([(turns, row.steer.address)] if row.steer is not None else [])
        if row.steer is not None and kinds[0] == kinds[1]:
            return f"{row.name}: its motor and what turns it have one address, {row.address} of {row.driver}"
        for kind, number in kinds:
            if (other := taken.setdefault((row.driver, kind, number), row.name)) != row.name:
                return f"{other} and {row.name} have one address, {number} of {row.driver}"
    if not any(surge_n > PUSH_MIN for row in rows for surge_n, _, _ in pushes(row)):
        return "none of them pushes the boat ahead"
    for side, sign in (("starboard", 1.0), ("port", -1.0)):
        if _moment(rows, sign) < PUSH_MIN:
            return f"this boat cannot turn to {side}, except astern: it needs a second thruster, a rudder, or their places"
    return None


def driver_fault(part: Part, row: ThrusterTable, rows: Sequence[ThrusterTable]) -> str | None:
    """The reason why the driver cannot drive this row, in words; None: it can."""
    can, its = part.drives, [each for each in rows if each.driver == part.name]
    if can.sides and (row.address > 1 or row.steer is not None):
        return f"{part.name} has address 0, starboard, and 1, port, and turns nothing"
    if can.sides == "mixed" and len(its) != 2:
        return f"{part.name} mixes two sides: it needs two thrusters, address 0 and 1"
    if row.address >= can.motors:
        return f"{part.name} has motors 0 to {can.motors - 1}, and {row.address} is none of them"
    if can.turns and sum(each.steer is not None for each in its) > can.turns:
        return f"{part.name} turns {can.turns} thrusters at most"
    if not can.turns and row.steer is not None:
        return f"a {part.protocol or part.name} turns its motor and nothing else: it cannot steer"
    last = max(row.address, 0 if row.steer is None else row.steer.address)
    if can.channels and last >= can.channels:
        return f"{part.name} has the channels 0 to {can.channels - 1}, not {last}"
    return None


def pushes(row: ThrusterTable) -> Iterator[tuple[float, float, float]]:
    """(surge N, sway N, yaw moment N·m) of a thruster at its full commands, ahead and to either side."""
    steer, (astern_n, ahead_n) = row.steer, row.ends_n
    widest_deg = steer.angle_max_deg if steer is not None else 0.0
    for turned_deg in {0.0, -widest_deg, widest_deg, -min(widest_deg, 90.0), min(widest_deg, 90.0)}:
        turned = math.radians(row.angle_deg + turned_deg)
        straight = steer is not None and steer.kind == "rudder"
        for force_n, angle in ((astern_n, math.radians(row.angle_deg) if straight else turned), (ahead_n, turned)):
            surge_n, sway_n = force_n * math.cos(angle), force_n * math.sin(angle)
            yield surge_n, sway_n, row.x_m * sway_n - row.y_m * surge_n


def _moment(rows: Sequence[ThrusterTable], sign: float) -> float:
    """Greatest moment, N·m, to starboard (sign 1) or port (-1) while the thrusters together do not push astern: the least of
    sum(max(moment + weight * surge)) over all weights, by duality; it lies where two pushes of a thruster weigh the same."""
    each = [[(0.0, 0.0), *((surge_n, sign * yaw_nm) for surge_n, _, yaw_nm in pushes(row))] for row in rows]
    pairs = [pair for points in each for pair in combinations(points, 2) if abs(pair[0][0] - pair[1][0]) > PUSH_MIN]
    weights = [0.0, *(max((m - n) / (q - p), 0.0) for (p, m), (q, n) in pairs)]
    return min(sum(max(m + weight * p for p, m in points) for points in each) for weight in weights)


def _struct(name: str, fields: Sequence[tuple[Any, ...]], bases: tuple[type, ...], namespace: dict[str, Any] | None) -> Any:
    settings: dict[str, Any] = {"frozen": True, "forbid_unknown_fields": True, "kw_only": True, "module": __name__}
    return msgspec.defstruct(name, fields, bases=bases, namespace=namespace, **settings)


def with_tables(kind: type[T]) -> type[T]:
    """The class with a key for each table of the boat's own parts, behind the table that its row names: so documents and log
    have them in one order."""
    hints = get_type_hints(kind, include_extras=True)
    made_anew = {*kind.__struct_fields__, *vars(Table)} - {"__doc__"}
    namespace = {name: value for name, value in vars(kind).items() if name not in made_anew}
    fields = list[tuple[str, Any, Any]]()
    for each in msgspec.structs.fields(kind):
        value = msgspec.NODEFAULT if each.required else each.default
        if each.default_factory is not msgspec.NODEFAULT:
            value = msgspec.field(default_factory=each.default_factory)
        fields.append((each.name, hints[each.name], value))
        fields += _behind(each.name)
    made: type[T] = _struct(kind.__name__, fields, (Table,), namespace)
    return made


def _behind(name: str) -> Iterator[tuple[str, Any, Any]]:
    """The keys of the parts whose tables stand behind this one, and behind theirs."""
    for row in TABLED:
        if row.after == name:
            kind = table_of(row)
            yield row.name, kind, kind() if isinstance(kind, type) else msgspec.field(default_factory=dict)
            yield from _behind(row.name)


@with_tables
class Vehicle(Table, frozen=True):
    """The whole file."""

    aboard: ClassVar[tuple[Part, ...]] = ()  # the rows of `parts`
    boat: BoatTable
    parts: dict[PartName, PartVersion] = msgspec.field(default_factory=dict)  # a laboratory's own, each with its version
    can: Can = Can()
    navigation: NavigationTable = NavigationTable()
    traffic: TrafficTable = TrafficTable()
    compass: CompassTable = CompassTable()
    estimator: EstimatorTable = EstimatorTable()
    propulsion: PropulsionTable = PropulsionTable()
    thrusters: Thrusters = DELFIMX
    control: ControlTable = ControlTable()
    failsafe: Failsafe = Failsafe()
    fence: FenceTable = FenceTable()
    adopted: AdoptedTable = AdoptedTable()
    checks: Checks = Checks()
    clock: ClockTable = ClockTable()
    sensors: Sensors = Sensors()
    sounder: SounderTable = SounderTable()
    sysstat: Sysstat = Sysstat()
    console: Console = Console()
    handset: HandsetTable = HandsetTable()
    kill: KillTable = KillTable()
    log: LogTable = LogTable()
    runtime: RuntimeTable = RuntimeTable()
    supervisor: SupervisorTable = SupervisorTable()
    services: dict[Name, ServiceTable] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, ports in self.ports.items():
            if not ports:
                raise ValueError(f"{name} needs a port: a table [{name}.ports.NAME] with its device")
        for name in self.__struct_fields__:
            if isinstance(table := getattr(self, name), Table) and (its := table.settled(self)) is not table:
                msgspec.structs.force_setattr(self, name, its)
        alike = {part.name for part in self.sensing if part.instruments}
        if len(alike) > 1:
            raise ValueError(f"sensors.names: {' and '.join(sorted(alike))} give the same values; name one of them")
        if (fault := thrusters_fault(self.thrusters, self.aboard)) is not None:
            raise ValueError(f"thrusters: {fault}")
        for row in self.thrusters:
            told = getattr(self.table(row.driver), "command", "")
            if self.drives(row).revolves and told == "rpm" and not row.rpm_max:
                words = f"{row.driver}.command is rpm: rpm_max must say the revolutions at full command"
                raise ValueError(f"thrusters: {row.name}: {words}")
        self._check_helmsmen()
        if self.sysstat.required is None:
            its = msgspec.structs.replace(self.sysstat, required=self._nodes())
            msgspec.structs.force_setattr(self, "sysstat", its)

    def table(self, name: str) -> Any:
        """A part's table by its name, for who knows no more of it than the rows say; None where it has none."""
        return getattr(self, name, None)

    def facts(self, key: str) -> list[Any]:
        """The values of a key, or of what follows from several, in the tables of parts and rooms that have it."""
        found = (getattr(self, row.name) for row in TABLED)
        return [getattr(table, key) for table in found if hasattr(table, key)]

    def drives(self, row: ThrusterTable) -> Drives:
        """The facts of a thruster's driver."""
        return parts.row(self.aboard, row.driver).drives

    def driven(self, fact: Literal["nodes", "outlet", "played"], there: bool = True) -> tuple[tuple[int, ThrusterTable], ...]:
        """The thrusters whose drivers have a fact, or have it not, with their places among all."""
        return tuple((i, row) for i, row in enumerate(self.thrusters) if getattr(self.drives(row), fact) is there)

    def rpm_max(self, row: ThrusterTable) -> float:
        """Revolutions per minute of a thruster at full command; 0 where they are not known."""
        return float(getattr(self.table(row.driver), "rpm_max", row.rpm_max))

    @property
    def sensing(self) -> list[Part]:
        """The parts of the sensors beside navigation."""
        return [parts.row(self.aboard, name) for name in self.sensors.names]

    @property
    def ports(self) -> dict[str, dict[str, Any]]:
        """The lines of the sources and sensors that have several, by their parts and names."""
        read = dict.fromkeys((*self.navigation.sources, *self.sensors.names))
        return {name: getattr(self, name).ports for name in read if parts.row(self.aboard, name).ports}

    @property
    def channels(self) -> tuple[int, ...]:
        """The channels of the outlet that thrusters use."""
        rows = [row for _, row in self.driven("outlet")]
        return tuple(sorted({row.address for row in rows} | {row.steer.address for row in rows if row.steer}))

    @property
    def drivers(self) -> tuple[str, ...]:
        """The drivers of the thrusters, each once, in the order of the rows."""
        return tuple(dict.fromkeys(row.driver for row in self.thrusters))

    @property
    def sails_by(self) -> str:
        """A digest of hull, motors, compass and gains: whether a boat sails by this file. Wiring and name are not in it, for a
        simulated boat has its own; nor is what stays at its default, for another version of the program has other keys."""
        rows = [stated(row, {"driver", "address", "reversed", "steer"}) for row in self.thrusters]
        stop = self.fence.reaction_s, self.fence.deceleration_mps2
        hull, found = stated(self.boat, {"id", "name"}), stated(self.adopted, {"proven"})
        told = msgspec.json.encode([hull, rows, stop, found, stated(self.control), stated(self.compass)])
        return hashlib.sha256(told).hexdigest()[:8]

    @property
    def helmsmen(self) -> tuple[str, ...]:
        """The payload programs that may have the boat, in the order of the file."""
        return tuple(name for name, table in self.table("payload").items() if {*table.may} - {"obstacles", "samples", "values"})

    def figures_of(self, source: str) -> str:
        """The name of a source's figures in the state: motors of the same bus have the name itself."""
        return f"{source}.sensors" if source in self.drivers else source

    @property
    def closed_buses(self) -> tuple[str, ...]:
        """The interfaces where only devices speak: they command motors, or tell the boat where it is."""
        buses, kinds = self.outside("interface").items(), {*self.drivers, *self.navigation.sources}
        return tuple(interface for key, interface in buses if key.partition(".")[0] in kinds)

    def _check_helmsmen(self) -> None:
        names = [name.lower() for name in self.helmsmen]
        if len(names) > HELMSMEN_MAX or len({*names}) < len(names) or any(len(name) > MODE_NAME_MAX for name in names):
            words = f"up to {HELMSMEN_MAX} programs, with names of up to {MODE_NAME_MAX} letters that differ, may have the boat"
            raise ValueError(f"payload: {words}: a console shows each as a mode of its name")

    def _nodes(self) -> tuple[NodeName, ...]:
        """The nodes of DelfimX that this boat has."""
        sides = {0: "starboard", 1: "port"}
        beside = [sides[row.address] for _, row in self.driven("nodes")]
        names = ["gps"] if OWN_NODES in self.navigation.sources else []
        names += [f"{part}_{side}" for part in ("propeller", "batteries") for side in beside]
        return tuple(name for name in get_args(NodeName) if name in names)

    def outside(self, key: Literal["interface", "device"]) -> dict[str, str]:
        """The buses or serial lines of the boat's nodes and of the parts that are chosen by name, by their keys: a part has
        its table by its name."""
        return {f"{name}.{key}": getattr(table, key) for name, table in self._parts().items() if hasattr(table, key)}

    def _parts(self) -> dict[str, Table | None]:
        """The tables of the boat's nodes and parts, by their names in the file."""
        spoken = tuple(name for name in OWN if getattr(self.table(name), "joins", False))
        names = ("can", "handset", *self.navigation.sources, *self.sensors.names, *self.drivers, *spoken)
        routed = {f"routing.buses.{name}": bus for name, bus in self.table("routing").buses.items()}
        lines = {f"{part}.ports.{name}": port for part, ports in self.ports.items() for name, port in ports.items()}
        beside = {key: table for tables in self.facts("lines") for key, table in tables.items()}
        return {name: self.table(name) for name in names} | routed | lines | beside

    @property
    def bit_rates(self) -> dict[str, int]:
        """The Linux interfaces among the buses of the boat, with their bit rates in bit/s."""
        rates = dict[str, int]()
        for table in self._parts().values():
            interface = getattr(table, "interface", ":")
            if ":" not in interface:
                rates.setdefault(interface, getattr(table, "bitrate_bps", self.can.bitrate_bps))
        return rates

    @property
    def buses(self) -> tuple[str, ...]:
        """All interfaces of the boat."""
        return tuple(sorted(set(self.outside("interface").values())))


def stated(table: Table, left_out: AbstractSet[str] = frozenset()) -> dict[str, Any]:
    """The keys of a table, and of those in it, that are not at their defaults."""
    usual = _defaults(type(table))
    told = {name: getattr(table, name) for name in usual if name not in left_out}
    tables = {name: stated(value) for name, value in told.items() if isinstance(value, Table)}
    values = {name: value for name, value in told.items() if name not in tables and value != usual[name]}
    return values | {name: keys for name, keys in tables.items() if keys}


@cache
def _defaults(kind: type[Table]) -> dict[str, Any]:
    """The keys of a table, each with what it is where nobody says anything."""
    return {each.name: each.default for each in msgspec.structs.fields(kind)}


def whole(aboard: tuple[Part, ...]) -> type[Vehicle]:
    """The class of a file that names these parts: a table for each, and their names and troubles where there are some."""
    modes = [mode.name for part in aboard for mode in part.modes]
    troubles = [*tables_of(Failsafe), *((row.name, row.table) for part in aboard for row in part.troubles)]
    answers = [(name, _in_modes(table, modes)) for name, table in troubles if modes or not hasattr(Failsafe, name)]
    failsafe = _with(Failsafe, [(name, table, table()) for name, table in answers])
    navigation = _with(NavigationTable, [_names("sources", SOURCES, aboard, 1)])
    sensors = _with(Sensors, [_names("names", SENSORS, aboard, 0)])
    thruster = _with(ThrusterTable, [("driver", Literal[(*DRIVERS, *of_kind(aboard, "driver"))])])
    rows = ("thrusters", Annotated[tuple[thruster, ...], get_args(Thrusters)[1]], DELFIMX)  # type: ignore[valid-type]
    guard = _with(TrafficGuard, [("modes", guarded((*STEERED, *modes)), TrafficGuard().modes)])
    traffic = _with(TrafficTable, [("guard", guard, guard())])
    made = {"failsafe": failsafe, "navigation": navigation, "sensors": sensors, "traffic": traffic}
    tables = [(name, table, table()) for name, table in made.items()]
    own = [(part.name, its, its()) for part in aboard if part.table and (its := table_of(part))]
    kind: type[Vehicle] = _with(Vehicle, [*tables, rows, *own], {"aboard": aboard})
    return kind


def tables_of(kind: type[Table]) -> list[tuple[str, type[Table]]]:
    """The names and classes of the tables in a table."""
    hints = get_type_hints(kind).items()
    return [(name, hint) for name, hint in hints if isinstance(hint, type) and issubclass(hint, Table)]


def _in_modes(table: type[Table], modes: Sequence[str]) -> Any:
    """The table of a trouble with a key for each mode of a part."""
    action = ReturnName if issubclass(table, Restarted) else ModeAction
    return _with(table, [(mode, action, "same") for mode in modes]) if modes else table


def _with(table: type[Table], fields: Sequence[tuple[Any, ...]], namespace: dict[str, Any] | None = None) -> Any:
    """A table with more keys, or with others of the same name."""
    return _struct(table.__name__, fields, (table,), namespace)


def _names(key: str, own: tuple[str, ...], aboard: tuple[Part, ...], least: int) -> tuple[str, Any, tuple[str, ...]]:
    """The key that names the sources or sensors, with those of the parts."""
    known = (*own, *of_kind(aboard, "source" if key == "sources" else "sensor"))
    return key, Annotated[tuple[Literal[known], ...], msgspec.Meta(min_length=least, max_length=len(known))], known[:1]  # type: ignore[valid-type]


def read(tree: dict[str, Any], file: str) -> Vehicle:
    """A vehicle's file from its parsed text. Raises ConfigError."""
    return decode(tree, kind_of(tree, file), file)


def is_taken(name: str) -> bool:
    """Whether a part of the boat's own, or a table of her file, has this name."""
    return name in Vehicle.__struct_fields__ or name in OWN


def kind_of(tree: dict[str, Any], file: str) -> type[Vehicle]:
    """The class of a vehicle's file, with the keys of the parts that it names. Raises ConfigError."""
    aboard = named(tree.get("parts"), file)
    for part in aboard:
        wrong = [part.name] if is_taken(part.name) else [row.name for row in part.troubles if hasattr(Failsafe, row.name)]
        if wrong:
            raise ConfigError(file, f"parts.{part.name}", f"{wrong[0]} is a name of the boat's own; it needs another one")
    return whole(aboard) if aboard else Vehicle


def load(path: str | Path, overrides: Sequence[str] = ()) -> Vehicle:
    """The vehicle's file, checked, with "key.key=TOML value" overrides laid over it. Raises ConfigError."""
    settings = read(read_toml(path, overrides), str(path))
    _lines_apart(settings, str(path))
    _buses_apart(settings, str(path))
    Sliced(polygons(settings.fence, str(path))).finish()
    _goes_astern(settings, str(path))
    return settings


def _goes_astern(vehicle: Vehicle, file: str) -> None:
    """A boat that is to back out of weeds can go astern. Raises ConfigError."""
    key = "failsafe.stuck.action" if vehicle.failsafe.stuck.action == "unstick" else "control.unstick"
    if key == "control.unstick" and not stated(vehicle.control.unstick):
        return
    surges_n = [[surge_n for surge_n, _, _ in pushes(row)] for row in vehicle.thrusters]
    if -sum(map(min, surges_n)) < ASTERN * sum(map(max, surges_n)):
        raise ConfigError(file, key, "the boat cannot go astern: its thrusters push ahead alone")


def _buses_apart(vehicle: Vehicle, file: str) -> None:
    """A bus carries one protocol, and a routed one is a bus of its own. Raises ConfigError."""
    carried = dict[str, str]()  # by interface: the key that named it first
    for key, interface in vehicle.outside("interface").items():
        other = carried.setdefault(interface, key)
        theirs, ours = (_protocol(vehicle, each.partition(".")[0]) for each in (other, key))
        if theirs != ours:
            words = f"{interface} carries {theirs} ({other}) already, and this is {ours}; a bus carries one protocol, for the "
            raise ConfigError(file, key, words + "identifiers of several overlap")
    for name, bus in vehicle.table("routing").buses.items():
        if bus.interface == vehicle.can.interface:
            raise ConfigError(file, f"routing.buses.{name}.interface", "this is can.interface: its nodes need no table")
        if vehicle.can.node in bus.nodes:
            raise ConfigError(file, f"routing.buses.{name}.nodes", f"node {vehicle.can.node:#04x} is this computer's own")


def _protocol(vehicle: Vehicle, table: str) -> str:
    """Of a bus that a table of the file names."""
    return NODES_PROTOCOL if table in ("can", "routing") else parts.row(vehicle.aboard, table).protocol or table


def _lines_apart(vehicle: Vehicle, file: str) -> None:
    """A serial line has one reader: two would each get a part of what comes. Raises ConfigError."""
    readers: dict[str, str] = {}
    told = [(key, to) for ends in vehicle.facts("ends") for key, to in ends.items() if to.startswith("/")]
    for key, device in [("slipd.device", vehicle.table("slipd").device), *vehicle.outside("device").items(), *told]:
        if device and device in readers:
            raise ConfigError(file, key, f"{device} is read by {readers[device]} already, and a serial line has one reader")
        readers[device] = key


def polygons(zones: Zones, file: str) -> Work[None]:
    """Checks all polygons of a file's fence. Raises ConfigError for the first faulty one."""
    kinds = (("keep_in", zones.keep_in), ("keep_out", zones.keep_out))
    for key, ring in ((f"fence.{name}[{i}]", area.polygon) for name, areas in kinds for i, area in enumerate(areas)):
        if ring and (wrong := (yield from polygon_fault(ring))) is not None:
            raise ConfigError(file, key, wrong)


def mission_place(file: str, vehicle: Vehicle) -> Path:
    """Path of a simulation's mission, beside the vehicle's file. Raises ConfigError if it does not exist."""
    place = Path(file).parent / str(vehicle.table("simulation").mission)
    if not place.is_file():
        raise ConfigError(file, "simulation.mission", f"there is no file {place}; put it beside the vehicle's file")
    return place


CHANGEABLE = ("control.", "failsafe.console_silent.", "failsafe.manual_silent.", "log.required")  # while the program runs


def changed(settings: Vehicle, key: str, value: float | str) -> Vehicle:
    """The settings with a new value at a key that may be changed. Raises ConfigError."""
    if not key.startswith(CHANGEABLE):
        raise ConfigError("the vehicle's file", key, "this cannot be changed while the boat runs", ", ".join(CHANGEABLE))
    *names, last = key.split(".")
    tables: list[Table] = [settings]
    for name in names:
        if not isinstance(inner := getattr(tables[-1], name, None), Table):
            raise ConfigError("the vehicle's file", key, "no such key")
        tables.append(inner)
    before = getattr(tables[-1], last, None)
    if isinstance(before, bool):
        value = {"yes": True, "no": False}.get(value, value) if isinstance(value, str) else value
    elif not isinstance(before, float | str):
        raise ConfigError("the vehicle's file", key, "no such key")
    table = tables.pop()
    try:  # checks this table alone: the whole file may hold a long fence
        table = decode(msgspec.structs.asdict(table) | {last: value}, type(table), "the vehicle's file")
    except ConfigError as error:
        raise ConfigError(error.file, key, error.reason, error.allowed) from None
    outer: Table = table
    for name in reversed(names):
        outer = msgspec.structs.replace(tables.pop(), **{name: outer})
    return cast(Vehicle, outer)
