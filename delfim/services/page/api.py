"""The words of `/api/state`: the boat's report, the computer's, and their schema. SI units, the unit in the name."""

from typing import Annotated, Any

import msgspec

from delfim.vehicle.report import BoatReport, Facts, Service


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
    networks: dict[str, Network] = msgspec.field(default_factory=dict)
    buses: dict[str, Bus] = msgspec.field(default_factory=dict)
    processes: tuple[Process, ...] = ()  # the busiest
    process_count: int = 0
    time: Time = Time()
    supervisor: dict[str, Service] = msgspec.field(default_factory=dict)  # its processes
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
    vehicle: BoatReport | None
    reason: str
    services: dict[str, Service]
    computer: Computer | None
    computer_age_s: float | None
    server: Server = Server()


def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of `Report`."""
    (reference,), components = msgspec.json.schema_components([Report], ref_template="#/$defs/{name}")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **reference, "$defs": components}
