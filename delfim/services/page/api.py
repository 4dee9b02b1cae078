"""The words of the interface: the vehicle's, the computer's, and their schema. SI units, the unit in the name.

The vehicle's words are those of `delfim.vehicle.snapshot`. A field that is not named here is left out, a missing one
has its default, so that a page and a vehicle of two versions understand each other.
"""

from typing import Annotated, Any

import msgspec


class Facts(msgspec.Struct, frozen=True, kw_only=True):
    """Unknown fields are ignored, missing ones have their default."""


class Reference(Facts, frozen=True):
    """The boat's references: where it is going."""

    heading_deg: float | None = None
    speed_mps: float | None = None
    cross_track_m: float | None = None  # positive: the boat is to starboard of its line
    distance_m: float | None = None
    leg: int = 0  # from 0
    latitude_deg: float | None = None  # of the place that it steers for
    longitude_deg: float | None = None


class Node(Facts, frozen=True):
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


class Latency(Facts, frozen=True):
    """The critical path from the kernel's receive time of navigation to the propellers' command (thesis figures 3-10, 3-11)."""

    n: int = 0
    p50_us: float = 0.0
    p99_us: float = 0.0
    p999_us: float = 0.0
    worst_us: float = 0.0
    within_100_us: float = 0.0  # share of cycles, 0..1
    stages_us: dict[str, float] = {}
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


class LogStatus(Facts, frozen=True):
    writable: bool = True
    reason: str = ""
    file: str = ""
    bytes: int = 0
    records: int = 0
    dropped: int = 0


class Check(Facts, frozen=True):
    """A line of the page that is read on the quay."""

    name: str
    ok: bool
    reason: str


class Notice(Facts, frozen=True):
    """A trouble, and the boat's response."""

    name: str
    reason: str
    age_s: float | None = None
    action: str = "warn"


class KeptClock(Facts, frozen=True):
    """Where the computer's clock has its time from."""

    kept: str = ""  # who keeps it, or why nobody does, in words
    source: str = ""  # whose time it has, or is compared with; empty: none was heard
    off_s: float | None = None  # the clock minus that time; null: it is not heard now
    fault: str = ""  # why a time is not taken, in words
    is_right: bool = False  # it was set in this run, or found as a source tells it


class AnnouncedItem(Facts, frozen=True):
    """An action of the mission that the boat has come to."""

    number: int  # of all that were announced
    command: int  # MAV_CMD
    params: tuple[float | None, ...] = ()


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


class PartFacts(Facts, frozen=True):
    """How the loop's calls to a laboratory's part fare."""

    failed: int = 0
    slow: int = 0  # longer than 2 ms
    worst_s: float = 0.0
    reason: str = ""  # of the last that failed
    off: str = ""  # why what part of it is switched off; empty: it is not


class State(Facts, frozen=True):
    """The vehicle's report of itself."""

    mode: str
    reason: str
    operator: str = ""  # who commands; empty: nobody
    helmsman: str = ""  # the payload program that has the boat; empty: none
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
    reference: Reference = Reference()
    mission: str | None = None
    legs: int = 0
    announced: tuple[AnnouncedItem, ...] = ()  # the newest, oldest first
    guest_connected: bool = False
    age_s: dict[str, float | None] = {}  # of every input; null: never heard
    sysstat: dict[str, Node] = {}
    measured: dict[str, float | None] = {}  # by sensors, by their names with units; null: not finite
    counts: dict[str, int] = {}  # inputs that were refused, dropped or repaired
    parts: dict[str, PartFacts] = {}  # of a laboratory, and how the loop's calls to each fare
    latency: Latency = Latency()
    log: LogStatus = LogStatus()
    services: dict[str, Service] = {}
    checks: tuple[Check, ...] = ()
    notices: tuple[Notice, ...] = ()
    traffic: TrafficSeen | None = None  # null: nobody was ever heard
    deadman: dict[str, Any] = {}
    clock: KeptClock = KeptClock()


class Memory(Facts, frozen=True):
    total_bytes: int = 0
    available_bytes: int = 0


class Disk(Facts, frozen=True):
    """The partition of the logs."""

    path: str
    total_bytes: int = 0
    free_bytes: int = 0
    full_in_s: float | None = None  # until the guard must make room, at the present rate; null: it is not filling


class Network(Facts, frozen=True):
    """A network interface; the rates are means since the last look."""

    up: bool
    addresses: tuple[str, ...] = ()
    received_bytes: int = 0
    sent_bytes: int = 0
    received_bps: float = 0.0
    sent_bps: float = 0.0
    errors: int = 0
    dropped: int = 0


class Bus(Facts, frozen=True):
    """A CAN controller as the kernel sees it; load is null where the bit rate is not known."""

    state: str = ""
    bitrate_bps: int = 0
    frames_per_s: float = 0.0
    load: float | None = None  # 0..1
    frames: int = 0
    dropped: int = 0
    errors: int = 0
    bus_off: int = 0
    transmit_errors: int | None = None  # the controller's counters, 0..255
    receive_errors: int | None = None


class Process(Facts, frozen=True):
    """A process. Its arguments are not shown: they may hold secrets."""

    pid: int
    name: str
    nice: int
    cpu: float  # of one processor, since the last look
    memory_bytes: int
    threads: int = 1


class Time(Facts, frozen=True):
    """The computer's clock."""

    utc_ns: int = 0
    synchronised: bool = False  # some source keeps the kernel's clock right
    error_s: float | None = None  # at most, as that source says


class LogLine(Facts, frozen=True):
    """A line of the system log (docs/log-format.md)."""

    t_ns: Annotated[int, msgspec.Meta(ge=0, lt=1 << 62)]
    monotonic_s: float
    level: str
    pid: int
    service: str
    text: str


class Computer(Facts, frozen=True):
    """A sample of the computer."""

    uptime_s: float = 0.0
    cpu: tuple[float, ...] = ()  # busy share of each processor since the last look, 0..1
    load: tuple[float, ...] = ()  # the kernel's means over 1, 5 and 15 minutes
    memory: Memory = Memory()
    temperature_c: float | None = None  # of the hottest zone
    disk: Disk | None = None
    networks: dict[str, Network] = {}
    buses: dict[str, Bus] = {}
    processes: tuple[Process, ...] = ()  # the busiest
    process_count: int = 0
    time: Time = Time()
    supervisor: dict[str, Service] = {}  # its processes
    deadman: str = ""  # its last event, in words
    log: tuple[LogLine, ...] = ()  # the last lines of the system log, newest first


class Server(Facts, frozen=True):
    """This server itself."""

    connections: int = 0
    requests: int = 0
    refused: int = 0  # connections beyond the limits


class Report(Facts, frozen=True):
    """/api/state: everything. `vehicle` is null while it does not answer, and `reason` says why."""

    utc_ns: int
    vehicle: State | None
    reason: str
    services: dict[str, Service]
    computer: Computer | None
    computer_age_s: float | None
    server: Server = Server()


def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of `Report`."""
    (reference,), components = msgspec.json.schema_components([Report], ref_template="#/$defs/{name}")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **reference, "$defs": components}
