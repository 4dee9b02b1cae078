"""The vehicle's data: modes, inputs of control, set points, its outputs. SI units, no behaviour."""

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from delfim.base.geodesy import Origin
from delfim.base.modes import Mode
from delfim.base.vessels import Report, ThingSeen
from delfim.canproxy.dsor.messages import Navigation, SystemStatus
from delfim.vehicle.inputhealth import InputHealth
from delfim.vehicle.report import Announced, ClockStatus, EnergyFacts, HandsetReport, PartHealth, SampleAsked
from delfim.vehicle.target import Traffic


class Actuation(NamedTuple):
    """The command of the thrusters, in the order of their rows in the vehicle's file. `run` False is motors off."""

    thrust: tuple[float, ...]  # -1..1 of full command, positive ahead: after the thrust curve, what a driver is told
    angle_rad: tuple[float, ...]  # of those that turn, from the row's own direction, positive clockwise; 0 for the others
    run: bool


class Wanted(NamedTuple):
    """The request of control to all thrusters together. `run` False is motors off."""

    surge_n: float = 0.0  # positive ahead
    sway_n: float = 0.0  # positive to starboard
    yaw_nm: float = 0.0  # positive clockwise, to starboard
    run: bool = True
    hand: tuple[float, float] | None = None  # manual mode, instead of forces: starboard and port, -1..1 of full command
    parts: tuple[float, ...] | None = None  # a trial, instead of forces: as the pieces of TrialPieces


class ThrusterReport(NamedTuple):
    """The report of a thruster about itself. None is unknown."""

    heard_s: float  # monotonic time
    rpm: float | None = None  # positive ahead, whichever way it is mounted
    current_a: float | None = None
    voltage_v: float | None = None
    temperature_c: float | None = None
    angle_rad: float | None = None  # as in `Actuation`
    faults: tuple[str, ...] | None = None  # in words
    refuses: str = ""  # why it does not obey now, in words


class Motion(NamedTuple):
    """Navigation as control sees it: metres in the local plane, rad, m/s over ground. `has` names the known parts; the
    other fields are zero and must not be used."""

    has: frozenset[str]  # of "position", "heading", "velocity"
    north_m: float
    east_m: float
    heading_rad: float
    yaw_rate_radps: float
    north_mps: float
    east_mps: float


class Sighting(NamedTuple):
    """A report of another vessel that came in."""

    told: Report | ThingSeen | str  # or why it could not be read, in words
    by: str  # the way: "nmea2000", a port's name, "console 255"
    at_s: float  # monotonic time
    key: str = ""  # of the vessel, where it is not its number of AIS


class Ping(NamedTuple):
    """A ping of an echo sounder, as it told it. Nothing is corrected."""

    heard_s: float  # monotonic time
    depth_m: float  # below the transducer
    source: str  # the sensor, and the device among several
    offset_m: float | None = None  # as the device tells it: above 0 from the transducer to the water line, below to the keel
    confidence: float | None = None  # 0..1; None: it does not tell
    number: int | None = None  # of the ping, as the device counts them


SOUNDINGS_MAX = 64  # that wait for the log
HEARD_MAX = 512  # reports that wait for the next look
HEARD_MANY = 128  # from so many on a vessel's newest report replaces the one that waits
HANDSET = "hand-set"  # the operator at the radio control, who is above all others
NOWHERE = Motion(frozenset(), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Waypoint(NamedTuple):
    north_m: float
    east_m: float
    speed_mps: float
    acceptance_m: float
    hold_s: float = 0.0  # how long the boat stays there, once it is reached
    line: int = 0  # of a survey, that the leg to it sails; 0: none
    tries: int = 0  # of a sample that is taken there, all within the stay; 0: none is


class Arc(NamedTuple):
    """A piece of a path around a centre; `turn_rad` positive clockwise (to starboard)."""

    north_m: float  # centre
    east_m: float
    radius_m: float
    start_rad: float  # bearing from the centre to where the arc starts
    turn_rad: float
    speed_mps: float
    hold_s: float = 0.0  # how long the boat stays at its end
    line: int = 0  # of a survey, that it sails; 0: none


class Line(NamedTuple):
    north_m: float  # start
    east_m: float
    to_north_m: float
    to_east_m: float
    speed_mps: float
    hold_s: float = 0.0  # as of an arc
    line: int = 0


class Plan(NamedTuple):
    """A mission in the local plane: waypoints to play, a path to follow (empty where the mission has none)."""

    name: str
    waypoints: tuple[Waypoint, ...]
    path: tuple[Line | Arc, ...]
    then_home: bool = False  # at the end; otherwise the boat holds
    number: int = 0  # of the plans aboard, from 1: one that changes while it is sailed keeps it
    lines: int = 0  # the highest number of a line of a survey; 0: it has none


class TrialPieces(NamedTuple):
    """A manoeuvre of a trial: what each thruster does, piece by piece, and what ends it."""

    number: int  # of the order; the same again is a sign of life
    pieces: tuple[tuple[float, tuple[float, ...]], ...]  # s; of each thruster -1..1 of full command, of what turns of its angle
    north_m: float  # middle of the circle in which the boat stays
    east_m: float
    radius_m: float
    turn_radps: float  # a faster turn ends it
    comes_back: bool = False  # it leads the boat back from the edge of the circle


class Setpoint(NamedTuple):
    """The set points of operator, guest and mission; each mode uses its part."""

    speed_mps: float = 0.0
    heading_rad: float = 0.0  # in course mode the course over ground
    starboard: float = 0.0  # manual thrust, -1..1 of full command
    port: float = 0.0
    target: Waypoint | None = None  # goto
    via: tuple[Waypoint, ...] = ()  # goto: by these before it, round zones
    plan: Plan | None = None
    leg: int = 0  # first leg to play
    piece: int = 0  # first piece of the path to follow
    guest_heading_rad: float | None = None
    guest_speed_mps: float = 0.0
    track: tuple[tuple[float, float], ...] = ()  # driven so far, oldest first: the way home
    override_mps: float | None = None  # the operator's speed in place of the plan's, while the mode lasts
    end: str = "hold"  # the mode at the end of goto: hold or idle
    alone: float = 0.0  # thrust of the one thruster that is tried in idle (`alone.py`)
    trial: TrialPieces | None = None
    sampled: int = 0  # the station, by its waypoint from 1, whose sample is taken or given up: play goes on


class Reference(NamedTuple):
    """Where control is going, for console and log. None: the mode has no such value."""

    heading_rad: float | None = None
    speed_mps: float | None = None
    cross_track_m: float | None = None  # positive: boat is to starboard of the line
    distance_m: float | None = None  # to the point steered for
    north_m: float | None = None  # that point
    east_m: float | None = None
    leg: int = 0
    done: bool = False  # the mode has reached its end: the loop goes to hold
    reason: str = ""  # why control stopped the propellers, in words; empty while it drives. With `done`: how a trial ended
    course_rad: float | None = None  # over ground
    line: int = 0  # of a survey, that the boat is on; 0: none


class Notice(NamedTuple):
    """A trouble that the operator should know of."""

    name: str  # of the trouble, as in the vehicle's file
    reason: str  # in words
    since_s: float  # monotonic time it began
    action: str  # in force: "warn", "hold", "home", "stop", "disconnect"


class Profile(NamedTuple):
    """Wall-clock stamps of one critical path, ns (thesis figure 3-9). t0 is the kernel's receive time of the last frame of
    the navigation message; t5 is taken after the log, so a record carries the t5 of the cycle before."""

    t0: int = 0
    t1: int = 0  # navigation readable
    t2: int = 0  # navigation read
    t3: int = 0  # control computed
    t4: int = 0  # propulsion sent: the critical path ends
    t5: int = 0  # guest and log served


class Killed(NamedTuple):
    """A kill: the boat is in idle, and every mode is refused until an operator clears it."""

    reason: str = ""  # in words; empty: the boat is not killed
    by: str = ""  # the switch or operator that killed it
    held: tuple[str, ...] = ()  # switches that say kill now: they must be released first


class StartConditions(NamedTuple):
    """The state of the computer that the checks need."""

    is_starting: bool = False  # no dead-man watches this program yet
    last_shutdown: str = ""  # the fault of the last shutdown, in words; empty: none, or not known
    image: str = ""  # why the started image needs attention, in words; empty: it does not
    clock: ClockStatus = ClockStatus()


@dataclass(slots=True)
class State:
    """Everything the vehicle knows now. One object, changed by the loop alone, read by console and log."""

    started_s: float = -1e9  # monotonic time the program began to listen
    mode: Mode = Mode.IDLE
    reason: str = "started"  # why the boat is in this mode, in words
    mode_s: float = -1e9  # monotonic time it entered the mode
    off_s: float = -1e9  # monotonic time its thrusters were last switched off
    armed: bool = False  # the boat left idle, or may; the propellers turn only when armed
    has_left_idle: bool = False  # in this voyage, restarts included: it is at sea
    restarted: str = ""  # what the boat does after a restart, in words, until somebody commands; empty: it was not restarted
    fence_lost: str = ""  # why zones that were aboard before a restart are not, in words; empty: they are, or there were none
    navigation: Navigation | None = None
    source: str = ""  # the source of navigation
    inputs: dict[str, tuple[InputHealth, ...]] = field(default_factory=dict)  # of the estimator, by source; others have none
    navigation_s: float = -1e9  # monotonic time of the last message
    changed_s: float = -1e9  # monotonic time of the last that differed from the one before
    jumped_s: float = -1e9  # monotonic time of the last position that no boat could have reached
    jumping_s: float = -1e9  # monotonic time of the first of that run
    jumped_m: float = 0.0  # length of the jump
    origin: Origin | None = None  # of the local plane: the first position, unless a mission was loaded before
    motion: Motion = NOWHERE
    before: Motion = NOWHERE  # the last one by the source before this one, and its time
    before_s: float = -1e9
    setpoint: Setpoint = field(default_factory=Setpoint)
    reference: Reference = field(default_factory=Reference)
    actuation: Actuation = field(default_factory=lambda: Actuation((), (), False))  # as sent; before that, empty
    twice: deque[float] = field(default_factory=lambda: deque(maxlen=3))  # when navigation last did not follow on itself
    thrusters: dict[str, ThrusterReport] = field(default_factory=dict)  # by row: its last report
    failed: dict[str, str] = field(default_factory=dict)  # thrusters that dropped out, by row, and why; until the boat is idle
    overdue: tuple[str, ...] = ()  # thrusters that are to lose their batteries: switched off, they turn on for too long
    unsteerable: str = ""  # why the boat cannot be steered without them, in words; empty: it can
    sysstat: dict[str, tuple[SystemStatus, float]] = field(default_factory=dict)  # by node: last report, its time
    measured: dict[str, tuple[float, float]] = field(default_factory=dict)  # by sensors: last value, its time
    soundings: deque[Ping] = field(default_factory=lambda: deque(maxlen=SOUNDINGS_MAX))  # the newest, each ping once
    sounded: int = 0  # all that were heard
    operator: str = ""  # the console, or HANDSET, that commands; its silence is a trouble; empty: none
    console_s: float = -1e9  # monotonic time of the last word of the console
    ordered_s: float = -1e9  # monotonic time of the last order of anybody, obeyed or refused
    helmsman: str = ""  # the payload program that the operator gave the boat to; empty: none has it
    relieved: str = ""  # why the last one that had it no longer does, in words; empty: none had it yet, or one has
    payloads_s: dict[str, float] = field(default_factory=dict)  # monotonic time of the last word of each that may have it
    resting: frozenset[str] = frozenset()  # payload programs that an operator has stopped
    namesakes: str = ""  # the notice that two consoles have one number; empty: they do not
    manual_s: float = -1e9
    guest_s: float = -1e9
    watchdog_s: float = -1e9  # when the watchdog ran last
    guest_connected: bool = False
    heard: dict[object, Sighting] = field(default_factory=dict)  # reports of other vessels that nobody looked at yet, in order
    traffic: Traffic = field(default_factory=Traffic)  # other vessels
    overruled_s: float = -1e9  # monotonic time until which the boat gives way to nobody, as an operator said
    handset: HandsetReport | None = None  # None: never heard, or there is none
    energy: EnergyFacts | None = None  # None: nothing is reckoned
    killed: Killed = field(default_factory=Killed)
    notices: tuple[Notice, ...] = ()  # present troubles, worst first
    announced: tuple[Announced, ...] = ()  # the newest, oldest first
    sample: SampleAsked = field(default_factory=SampleAsked)  # that payload programs are asked for now
    station: str = ""  # the last that is to be told of the stations of the mission, in words
    stations: tuple[tuple[int, bool], ...] = ()  # of the mission, by waypoints from 1: those sampled; False: without a sample
    computer: StartConditions = field(default_factory=StartConditions)  # the computer at the program's start
    cycles: int = 0
    parts: dict[str, PartHealth] = field(default_factory=dict)  # of a laboratory, by name
    counts: dict[str, int] = field(default_factory=dict)  # number of inputs refused, dropped, repaired, by name
    profile: Profile = field(default_factory=Profile)

    def count(self, name: str, by: int = 1) -> None:
        """Count an event that is not worth stopping for. Names are code, so the table is bounded."""
        self.counts[name] = self.counts.get(name, 0) + by

    @property
    def orderer(self) -> str:
        """Who orders, in words: the payload program that has the boat, for the order of an operator takes it back."""
        return f"payload {self.helmsman}" if self.helmsman else "operator"

    def relieve(self, why: str) -> str:
        """Take the boat back from the payload program that has it. Returns that in words; empty: none had it."""
        words, self.helmsman = f"{why}: payload {self.helmsman} no longer has the boat" if self.helmsman else "", ""
        if words:
            self.relieved, self.reason = why, words
        return words

    def count_lost(self, pgn: int, lost: Counter[str]) -> None:
        """Count the fast packets of a PGN that were lost, by reason; `lost` is empty then."""
        for reason, times in lost.items():
            self.count(f"nmea2000_{pgn}_{reason.partition(': ')[2].replace(' ', '_')}", times)
        lost.clear()

    def sound(self, ping: Ping, is_sure: bool = True) -> None:
        """A ping: it is logged, and where it is sure it is the depth."""
        self.soundings.append(ping)
        self.sounded += 1
        if is_sure:
            self.measured["depth_m"] = ping.depth_m, ping.heard_s
            if ping.offset_m is not None:
                self.measured["depth_offset_m"] = ping.offset_m, ping.heard_s

    def hear(self, told: Report | ThingSeen | str, by: str, now_s: float, key: str = "") -> None:
        """A report of another vessel, for the next look. Costs next to nothing, and is bounded: where many wait, of each vessel
        the newest alone, so that nobody who speaks often keeps the others out."""
        waiting: dict[object, Sighting] = self.heard
        name: object = object()
        if len(waiting) >= HEARD_MANY:
            name = told if isinstance(told, str) else (type(told), key or (0 if isinstance(told, ThingSeen) else told.mmsi))
            if name in waiting or len(waiting) >= HEARD_MAX:
                self.count("traffic_dropped")
            if name not in waiting and len(waiting) >= HEARD_MAX:
                return
        waiting[name] = Sighting(told, by, now_s, key)


class StateLog(Protocol):
    """The log that takes a cycle's record."""

    def write(self, state: State, now_s: float) -> None: ...
    def note(self, text: str) -> None: ...  # an event, in words
    def reason(self) -> str: ...  # why nothing is being written, in words; empty while all is well
    def close(self) -> None: ...


class NoLog:
    """A log that keeps nothing; `why` is its reason."""

    why = ""

    def write(self, state: State, now_s: float) -> None:
        pass

    def note(self, text: str) -> None:
        pass

    def reason(self) -> str:
        return self.why

    def close(self) -> None:
        pass
