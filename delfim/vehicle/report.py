"""The boat's report of itself: its words, once, for the command socket, the page, its interfaces, and every other program.

`delfim.vehicle.snapshot` fills it. SI units, the unit in the name; null is unknown. A field that is not named here is ignored,
a missing one has its default, so that two programs of two versions understand each other.
"""

from typing import Any, Final

import msgspec


class Facts(msgspec.Struct, frozen=True, kw_only=True):
    """Unknown fields are ignored, missing ones have their default."""


class ReferenceFacts(Facts, frozen=True):
    """The boat's references: where it is going."""

    heading_deg: float | None = None
    speed_mps: float | None = None
    cross_track_m: float | None = None  # positive: the boat is to starboard of its line
    distance_m: float | None = None
    leg: int = 0  # from 0
    line: int = 0  # of a survey, that the boat is on; 0: none
    latitude_deg: float | None = None  # of the place that it steers for
    longitude_deg: float | None = None


class NodeFacts(Facts, frozen=True):
    """The last report of one CAN node. Each kind of node fills its own fields."""

    status: str
    faults: tuple[str, ...] = ()
    rpm: float | None = None
    voltage_v: float | None = None
    current_a: float | None = None
    charge: float | None = None  # 0..1
    temperature_c: float | None = None


class ThrusterFacts(Facts, frozen=True):
    """Command and report of a thruster. Null: unknown, or it has no such value."""

    thrust: float = 0.0  # commanded, -1..1 of full command
    angle_deg: float | None = None  # commanded, from its own direction, clockwise
    rpm: float | None = None
    current_a: float | None = None
    voltage_v: float | None = None
    temperature_c: float | None = None
    turned_deg: float | None = None  # as reported
    faults: tuple[str, ...] = ()
    age_s: float | None = None  # of the report; null: it never reported


class LatencyFacts(Facts, frozen=True):
    """The critical path from the kernel's receive time of navigation to the propellers' command (thesis figures 3-10, 3-11)."""

    n: int = 0
    p50_us: float = 0.0
    p99_us: float = 0.0
    p999_us: float = 0.0
    worst_us: float = 0.0
    within_100_us: float = 0.0  # share of cycles, 0..1
    stages_us: dict[str, float] = {}  # mean of each
    histogram: tuple[tuple[float, int], ...] = ()  # (upper edge in us, cycles) of each bar that is not empty


class Service(Facts, frozen=True):
    """A service, or a process of the supervisor."""

    state: str
    place: str = "process"
    for_s: float = 0.0  # in this state
    restarts: int = 0
    reason: str = ""  # of its last end or silence
    pid: int = 0
    busy_s: float = 0.0
    longest_callback_s: float = 0.0
    over_budget: int = 0  # callbacks
    memory_bytes: int = 0  # resident, of a process of its own
    figures: dict[str, Any] = {}  # its own


class LogFacts(Facts, frozen=True):
    """The state log."""

    writable: bool = True
    reason: str = ""
    file: str = ""
    bytes: int = 0
    records: int = 0
    dropped: int = 0


class Check(msgspec.Struct, frozen=True):
    """A line of the page that is read on the quay."""

    name: str
    ok: bool
    reason: str  # in words, for either answer


class NoticeFacts(Facts, frozen=True):
    """A trouble, and the boat's response."""

    name: str
    reason: str
    age_s: float | None = None
    action: str = "warn"


class ClockStatus(msgspec.Struct, frozen=True):
    """Where the computer's clock has its time from."""

    kept: str = ""  # who keeps it, or why nobody does, in words; empty: nobody has looked yet
    source: str = ""  # whose time it has, or is compared with; empty: none was heard
    off_s: float | None = None  # the clock minus that time; None: it is not heard now
    fault: str = ""  # why a time is not taken, in words
    is_right: bool = False  # it was set in this run, or found as a source tells it


class Announced(msgspec.Struct, frozen=True):
    """An action of the mission that the boat has come to (docs/missions.md)."""

    number: int  # of all that were announced, from 1
    command: int  # MAV_CMD
    params: tuple[float | None, ...] = ()  # seven; None: not given


class SampleAsked(msgspec.Struct, frozen=True):
    """A sample that payload programs are asked for at a station of the mission (docs/missions.md)."""

    number: int = 0  # of all that were asked for, from 1; 0: none is
    leg: int = 0  # of its waypoint, from 0
    attempt: int = 0  # from 1
    tries: int = 0  # at most


class EnergyFacts(Facts, frozen=True):
    """What the batteries hold, and what the way home takes (docs/energy.md). Null: not known."""

    left_wh: float | None = None
    home_wh: float | None = None  # back along the driven track
    doubt_wh: float = 0.0  # that it may take more, kept beside the reserve
    plan_wh: float | None = None  # what is left of the plan, and the straight way home from its end
    reserve_wh: float = 0.0  # to be left at home
    power_w: float | None = None  # now
    range_m: tuple[float, ...] = ()  # how far the boat gets over ground, reserve kept: by direction, from north clockwise
    current_mps: float = 0.0  # what carries the boat: water and wind
    current_deg: float = 0.0  # towards
    no_way_home: bool = False  # the boat makes no way against it
    why: str = ""  # why nothing is known, or little, in words


class KillFacts(Facts, frozen=True):
    """The kill: the boat stays in idle until an operator clears it."""

    reason: str = ""  # empty: the boat is not killed
    by: str = ""  # the switch or operator that killed it
    held: tuple[str, ...] = ()  # switches that say kill now


class HandsetReport(msgspec.Struct, frozen=True):
    """The state of the hand-set. Sticks are -1 to 1, ahead and to starboard positive."""

    heard_s: float  # monotonic time of the last positions that came from it
    throttle: float
    steer: float
    takes: bool  # the switches
    kills: bool
    lost: str = ""  # why its radio is lost, in words; empty: it is not
    quality_pct: int | None = None  # of its radio; None: the receiver does not tell


class VesselSeen(Facts, frozen=True):
    """Another vessel (docs/traffic.md), reckoned on from its last report."""

    key: str
    name: str
    latitude_deg: float
    longitude_deg: float
    course_deg: float | None = None  # over ground; null: it lies, or is not known
    speed_mps: float = 0.0
    heading_deg: float | None = None
    length_m: float = 0.0
    beam_m: float = 0.0
    size_known: bool = False  # otherwise the size is guessed from its kind
    margin_m: float = 0.0  # how far it may be from there
    kind: str = ""
    status: int = 15  # navigational status of ITU-R M.1371; 15: not known
    age_s: float = 0.0  # of its last report
    lost: bool = False
    cpa_m: float | None = None  # if both keep course and speed
    tcpa_s: float | None = None  # negative: they draw apart
    nearness: float | None = None  # least to come, in domains; 1: the edge
    danger: str = "none"  # "near", "danger"


class OrderInForce(Facts, frozen=True):
    """What the boat does to keep clear."""

    course_deg: float
    speed_mps: float
    words: str
    key: str = ""  # of the vessel
    age_s: float = 0.0


class TrafficSeen(Facts, frozen=True):
    """Other vessels. The boat sees only who transmits."""

    heard_s: float | None = None  # age of the last report; null: never
    own_s: float | None = None  # the same of the boat's own transponder
    refused: dict[str, int] = {}  # reports that were not taken, by reason
    targets: tuple[VesselSeen, ...] = ()  # the nearest first
    order: OrderInForce | None = None
    guard: str = "off"  # "on", "off", "cannot avoid: " and why


class PartHealth(msgspec.Struct):
    """How the loop's calls to a laboratory's part fare (`foreign.py`)."""

    failed: int = 0  # calls that raised, took too long, or returned nonsense
    slow: int = 0  # calls longer than the contract allows
    worst_s: float = 0.0  # the longest
    reason: str = ""  # of the last that failed, in words
    off: str = ""  # why what part of it is switched off, in words; empty: it is not


class BoatReport(Facts, frozen=True):
    """The vehicle's report of itself, as `/api/state` has it."""

    mode: str
    reason: str
    operator: str = ""  # who commands; empty: nobody
    helmsman: str = ""  # the payload program that has the boat; empty: none
    resting: tuple[str, ...] = ()  # payload programs that an operator has stopped
    boat: str = "boat"
    cycle: int = 0
    utc_ns: int = 0  # navigation's clock, 0 if it sends none
    source: str = ""  # of navigation
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    heading_deg: float | None = None
    course_deg: float | None = None
    speed_mps: float | None = None
    turn_dps: float | None = None  # to starboard
    roll_deg: float | None = None  # starboard down
    pitch_deg: float | None = None  # bow up
    fix: int = 0
    satellites: int = 0
    hdop: float | None = None
    accuracy_m: float | None = None  # of the position, as the receiver states it
    corrections_s: float | None = None  # age of the receiver's last correction
    thrusters: dict[str, ThrusterFacts] = {}  # in the order of the vehicle's file
    run: bool = False
    reference: ReferenceFacts = ReferenceFacts()
    mission: str | None = None
    legs: int = 0
    announced: tuple[Announced, ...] = ()  # the newest, oldest first
    sample: SampleAsked = SampleAsked()
    guest_connected: bool = False
    age_s: dict[str, float | None] = {}  # of every input; null: never heard
    sysstat: dict[str, NodeFacts] = {}
    measured: dict[str, float | None] = {}  # by sensors, by their names with units; null: not finite
    counts: dict[str, int] = {}  # inputs that were refused, dropped or repaired
    parts: dict[str, PartHealth] = {}  # of a laboratory, by name
    latency: LatencyFacts = LatencyFacts()
    log: LogFacts = LogFacts()
    services: dict[str, Service] = {}
    checks: tuple[Check, ...] = ()
    notices: tuple[NoticeFacts, ...] = ()
    traffic: TrafficSeen | None = None  # null: nobody was ever heard
    energy: EnergyFacts | None = None  # null: the vehicle's file gives no capacity
    deadman: dict[str, Any] = {}
    sails_by: str = ""  # a digest of hull, motors, compass and gains of the vehicle's file with which it was started
    clock: ClockStatus = ClockStatus()


class LocalReference(ReferenceFacts, frozen=True):
    """The references with those that the command socket alone tells."""

    course_deg: float | None = None  # over ground
    speed_override_mps: float | None = None  # the operator's speed in place of the plan's


class LocalReport(BoatReport, frozen=True):
    """The same on the command socket, which tells some more of the operator's hold on the boat."""

    reference: LocalReference = LocalReference()
    armed: bool = False
    paused: str | None = None  # the mode that a pause keeps; null: nothing is paused
    killed: KillFacts = KillFacts()
    handset: HandsetReport | None = None  # null: never heard, or there is none
    heard: dict[str, tuple[float, ...]] = {}  # in a trial: each input of the estimator, its age in s first, rad and m/s


class _Answer(msgspec.Struct):
    state: BoatReport


_answer: Final = msgspec.json.Decoder(_Answer).decode


def reported(answer: bytes) -> BoatReport:
    """The report in an answer of the command socket. Raises msgspec.DecodeError."""
    return _answer(answer).state
