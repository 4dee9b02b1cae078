"""The vehicle's file: one TOML table, one frozen class. A parameter is declared here once: name, unit, default, range.

`load(path)` refuses an unknown key, a wrong type and a value out of range with file, key, reason and what is allowed. There
are no environment variables and no second list of options.
"""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from delfim.errors import ConfigError

Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}\Z")]
Fraction = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Seconds = Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)]
Metres = Annotated[float, msgspec.Meta(gt=0.0, le=10_000.0)]
Speed = Annotated[float, msgspec.Meta(gt=0.0, le=30.0)]  # m/s
Gain = Annotated[float, msgspec.Meta(ge=0.0, le=1e4)]
Nice = Annotated[int, msgspec.Meta(ge=-20, le=19)]
Interface = Annotated[str, msgspec.Meta(pattern=r"^([a-z][a-z0-9_.-]{0,14}|canloop:[A-Za-z0-9_.-]{1,32}|python-can:[^ ]+)\Z")]
NodeName = Literal["gps", "propeller_starboard", "propeller_port", "batteries_starboard", "batteries_port"]
Sources = Annotated[tuple[Literal["dsor", "nmea2000"], ...], msgspec.Meta(min_length=1, max_length=2)]
Endpoint = Annotated[str, msgspec.Meta(pattern=r"^[^ :]+:[0-9]{1,5}\Z")]  # host:port


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the vehicle's file. Unknown keys are refused."""


class Boat(Table, frozen=True):
    """What the boat is."""

    name: Name  # of the boat, in logs and on screens
    id: Annotated[int, msgspec.Meta(ge=1, le=249)] = 1  # on the console's link
    length_m: Metres = 4.5  # over all; the model scales with it
    beam_m: Metres = 2.45  # over all


class Can(Table, frozen=True):
    """The bus of the boat's own nodes: a Linux interface, `canloop:NAME`, or `python-can:INTERFACE:CHANNEL[@BITRATE]`."""

    interface: Interface = "can0"  # the bus
    receive_buffer_bytes: Annotated[int, msgspec.Meta(ge=4096, le=64 << 20)] = 1 << 20  # of each socket


class NavigationTable(Table, frozen=True):
    """Sources in order of preference; the next one is taken when the data of the one before is older than `stale_s`."""

    sources: Sources = ("dsor",)  # best first
    rate_hz: Annotated[float, msgspec.Meta(ge=0.5, le=1000.0)] = 5.0  # messages a second that the navigation node sends
    stale_s: Seconds = 1.0  # a source silent for longer is not used
    jump_mps: Speed = 15.0  # a position that would need more than this speed is refused ...
    jump_m: Metres = 10.0  # ... unless it is this close


class Nmea2000(Table, frozen=True):
    """A bus of off-the-shelf sensors. Empty preference: whoever talks; addresses first named win while they talk."""

    interface: Interface = "can1"  # the bus of the sensors
    preferred_sources: tuple[Annotated[int, msgspec.Meta(ge=0, le=251)], ...] = ()  # addresses, best first
    variation_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] = 0.0  # used while the bus sends none


class Propulsion(Table, frozen=True):
    """The two propellers."""

    rpm_max: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 1200  # of either propeller, ahead and astern
    rpm_per_s_max: Annotated[float, msgspec.Meta(gt=0.0, le=1e5)] = 800.0  # steepest change that is commanded
    speed_per_rpm_mps: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.00196  # straight ahead, calm water


class HeadingTable(Table, frozen=True):
    """Heading autopilot: differential rpm per rad and per rad/s, and the integral that carries wind."""

    p_rpm_per_rad: Gain = 700.0  # differential for a heading error
    p_limit_rpm: Gain = 700.0  # most of it: sets the rate of turn
    d_rpm_per_radps: Gain = 1000.0  # differential against a rate of turn
    turn_rpm_per_radps: Gain = 1000.0  # differential that keeps a turn going, on an arc
    i_rpm_per_rad_s: Gain = 30.0  # differential gathered from an error that stays
    i_limit_rpm: Gain = 150.0  # most of it


class SpeedTable(Table, frozen=True):
    """Speed controller: feed-forward from `speed_per_rpm_mps`, integral for what the sea takes away."""

    p_rpm_per_mps: Gain = 150.0  # common revolutions for a speed error
    i_rpm_per_m: Gain = 30.0  # gathered from an error that stays
    i_limit_rpm: Gain = 400.0  # most of it
    ramp_mps2: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 0.4  # how fast the speed asked for may change
    cruise_mps: Speed = 1.5  # where a command or a waypoint names no speed
    max_mps: Speed = 2.2  # no mode asks for more


class PathTable(Table, frozen=True):
    """Line-of-sight guidance with integral action against current, for missions, paths and the way home."""

    lookahead_m: Metres = 8.0  # the boat steers for a point of the path this far ahead
    integral_gain: Gain = 0.1  # m/s: how fast a cross-track error that stays turns into crab angle
    crab_s: Seconds = 1.0  # smoothing of the measured crab angle
    acceptance_m: Metres = 5.0  # a waypoint is reached within this radius unless it names its own


class HoldTable(Table, frozen=True):
    """Station keeping."""

    radius_m: Metres = 5.0  # inside, the boat rests
    speed_mps: Speed = 1.0  # most that is used to come back


class HomeTable(Table, frozen=True):
    """The way back along the driven track."""

    spacing_m: Metres = 5.0  # between remembered points of the driven track
    points: Annotated[int, msgspec.Meta(ge=2, le=100_000)] = 2000  # remembered; beyond, the spacing doubles
    speed_mps: Speed = 1.5  # on the way home


class ControlTable(Table, frozen=True):
    heading: HeadingTable = HeadingTable()
    speed: SpeedTable = SpeedTable()
    path: PathTable = PathTable()
    hold: HoldTable = HoldTable()
    home: HomeTable = HomeTable()


class Watchdog(Table, frozen=True):
    """The thesis' rule: navigation or console silent for this long stops the boat."""

    navigation_s: Seconds = 1.0  # silence of navigation that stops the boat
    console_s: Seconds = 10.0  # silence of the console that stops the boat
    manual_s: Seconds = 2.0  # manual commands are fresh or zero
    guest_s: Seconds = 5.0  # silence of the guest that stops the boat in GREX mode


class Sysstat(Table, frozen=True):
    """Which nodes must report, and how old a report may be. A bad or silent required node stops the boat."""

    required: tuple[NodeName, ...] = get_args(NodeName)  # nodes that must report
    stale_s: Seconds = 5.0  # a report older than this is silence


class Console(Table, frozen=True):
    """Commands and state on this computer."""

    socket: str = "/run/delfim/command"  # local commands and state, a UNIX socket
    clients: Annotated[int, msgspec.Meta(ge=1, le=100)] = 16  # connections at once


class Guest(Table, frozen=True):
    """The guest computer's TCP server (GREX in the thesis)."""

    enabled: bool = False  # serve a guest
    listen: Endpoint = "127.0.0.1:4747"  # address and port; only loopback is safe without a guard


class Httpd(Table, frozen=True):
    """The statistics page: it shows, and changes nothing. Whoever reaches the address may read it and the logs."""

    listen: Endpoint = "127.0.0.1:8080"  # address and port; 0.0.0.0 is every interface
    connections: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 32  # at once; the next one is closed
    connections_per_address: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 8  # so that one visitor cannot keep the others out
    scan_s: Annotated[float, msgspec.Meta(ge=5.0, le=3600.0)] = 5.0  # between two looks at the computer and its processes


class FtpUser(Table, frozen=True):
    """Who may come in by FTP, by name."""

    password: Annotated[str, msgspec.Meta(pattern=r"^scrypt:[A-Za-z0-9+/=]+:[A-Za-z0-9+/=]+\Z")]  # from `delfim password`
    upload: bool = False  # may write in the staging area; everything else is read-only for everybody


class Ftpd(Table, frozen=True):
    """Files over FTP. Without users it is not started."""

    listen: Endpoint = "127.0.0.1:2121"  # address and port; 0.0.0.0 is every interface
    root: str = "/log"  # what is seen as "/"; no path leads out of it
    staging: Name = "upload"  # the folder in it where some may write
    upload_bytes_max: Annotated[int, msgspec.Meta(ge=0)] = 1 << 30  # of one file
    certificate: str = ""  # PEM with certificate and key: FTPS from the first byte (implicit); "" for FTP
    connections: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 16  # at once; the next one is closed
    connections_per_address: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 8  # so that one visitor cannot keep the others out
    users: dict[Name, FtpUser] = {}


class SshUser(Table, frozen=True):
    """Who may come in by SSH, by name."""

    keys: Annotated[tuple[str, ...], msgspec.Meta(min_length=1, max_length=16)]  # public ones, as ssh-keygen writes them


class Sshd(Table, frozen=True):
    """Commands, a shell, SFTP and SCP over SSH. Without users it is not started."""

    listen: Endpoint = "127.0.0.1:2222"  # address and port; 0.0.0.0 is every interface
    user: str = ""  # of the system, as whom all is done; "": as who started this. Needs a process of its own
    shell: str = "/bin/sh"  # that runs the commands
    root: str = "/log"  # what SFTP and SCP see as "/"; no path leads out of it
    host_key: str = "/log/.keys/ssh_host_ed25519"  # made at the first start, and kept
    sessions: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 16  # programs at once
    connections: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 16  # at once; the next one is closed
    connections_per_address: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 8  # so that one visitor cannot keep the others out
    users: dict[Name, SshUser] = {}


class Log(Table, frozen=True):
    """Where and how logs are written, and what happens when the disk is full."""

    directory: str = "/log"  # where logs go
    file_bytes: Annotated[int, msgspec.Meta(ge=4096, le=1 << 30)] = 1_000_000  # a new file past this size
    file_s: Seconds = 600.0  # a new file past this age
    free_bytes_min: Annotated[int, msgspec.Meta(ge=0)] = 64 << 20  # the guard keeps this much free
    when_full: Literal["delete-oldest", "stop"] = "delete-oldest"  # what the guard does
    state_method: Literal["write", "zwrite", "zpipe"] = "zpipe"  # plain, deflated here, by a niced child
    required: bool = True  # no log, no start


class Runtime(Table, frozen=True):
    """Real-time settings. What the process is not allowed to set costs one warning."""

    nice: Nice = 0  # of the runtime
    service_nice: Nice = 10  # of services in processes of their own
    fifo_priority: Annotated[int, msgspec.Meta(ge=0, le=99)] = 0  # 0: the ordinary scheduler
    cpus: tuple[Annotated[int, msgspec.Meta(ge=0, le=1023)], ...] = ()  # empty: all
    mlockall: bool = False  # keep the runtime in memory
    window: bool = True  # navigation window: spin shortly before navigation is due
    window_share_max: Fraction = 0.1  # of one processor, at most
    window_guard_s: Annotated[float, msgspec.Meta(gt=0.0, le=0.05)] = 0.0006  # it opens so long before navigation
    callback_budget_s: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.0005  # a service whose callback takes longer is shown
    run_directory: str = "/run/delfim"  # for sockets and state files


class Supervisor(Table, frozen=True):
    """The parent: dead-man and restarts."""

    deadman_s: Annotated[float, msgspec.Meta(ge=0.1, le=60.0)] = 1.0  # silence of the runtime that stops it
    backoff_s: Seconds = 0.1  # first pause before a restart; doubles each time
    backoff_max_s: Seconds = 10.0  # longest pause before a restart
    hardware_watchdog: str = "/dev/watchdog"  # stroked where it exists; "" for none


class Service(Table, frozen=True):
    """A service of the suite, by its name."""

    enabled: bool = True  # run it
    place: Literal["default", "runtime", "process"] = "default"  # the runtime's loop, a niced process, or as usual


class Sea(Table, frozen=True):
    """The simulator's weather. Directions are where wind comes from and where current goes to, as sailors say them."""

    current_mps: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)] = 0.0  # speed of the current
    current_to_deg: Annotated[float, msgspec.Meta(ge=0.0, le=360.0)] = 0.0  # direction it sets
    wind_mps: Annotated[float, msgspec.Meta(ge=0.0, le=50.0)] = 0.0  # mean wind
    wind_from_deg: Annotated[float, msgspec.Meta(ge=0.0, le=360.0)] = 0.0  # direction it comes from
    gusts: Fraction = 0.2  # standard deviation of the wind, as a part of its mean


class Simulation(Table, frozen=True):
    """What only `delfim sim` and `delfim nodes` read."""

    interface: Interface = "canloop:can0"  # the bus of a simulated boat
    httpd: Endpoint = "127.0.0.1:8080"  # where its page is
    ftpd: Endpoint = "127.0.0.1:2121"  # where its files are
    sshd: Endpoint = "127.0.0.1:2222"  # where its shell is
    latitude_deg: Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)] = 38.6907  # where it starts
    longitude_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] = -9.2153  # where it starts
    heading_deg: Annotated[float, msgspec.Meta(ge=0.0, le=360.0)] = 0.0  # how it lies at start
    mission: str = ""  # played by `delfim sim`, beside the vehicle's file
    position_noise_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.3  # standard deviation of the position
    heading_noise_deg: Annotated[float, msgspec.Meta(ge=0.0, le=90.0)] = 0.5  # standard deviation of the heading
    speed_noise_mps: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.03  # standard deviation of the speed
    sea: Sea = Sea()


class Vehicle(Table, frozen=True):
    """The whole file."""

    boat: Boat
    can: Can = Can()
    navigation: NavigationTable = NavigationTable()
    nmea2000: Nmea2000 = Nmea2000()
    propulsion: Propulsion = Propulsion()
    control: ControlTable = ControlTable()
    watchdog: Watchdog = Watchdog()
    sysstat: Sysstat = Sysstat()
    console: Console = Console()
    guest: Guest = Guest()
    httpd: Httpd = Httpd()
    ftpd: Ftpd = Ftpd()
    sshd: Sshd = Sshd()
    log: Log = Log()
    runtime: Runtime = Runtime()
    supervisor: Supervisor = Supervisor()
    services: dict[Name, Service] = {}
    simulation: Simulation = Simulation()


T = TypeVar("T", bound=Table)


def load(path: str | Path, overrides: Sequence[str] = ()) -> Vehicle:
    """The vehicle's file, checked, with "key.key=TOML value" overrides laid over it. Raises ConfigError."""
    tree = read_toml(path)
    for override in overrides:
        _override(tree, override)
    return decode(tree, Vehicle, str(path))


def read_toml(path: str | Path) -> dict[str, object]:
    """Raises ConfigError where the file is missing, unreadable or no TOML."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(str(path), "file", error.strerror or str(error)) from None
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), "file", f"not UTF-8: {error.reason} at byte {error.start}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(str(path), "file", f"not TOML: {error}") from None


def _override(tree: dict[str, Any], override: str) -> None:
    key, equals, value = override.partition("=")
    try:
        if not equals:
            raise ValueError("no =")
        *tables, last = key.strip().split(".")
        for table in tables:
            tree = tree.setdefault(table, {})
        tree[last] = tomllib.loads(f"value = {value}")["value"]
    except (ValueError, AttributeError, TypeError) as error:
        raise ConfigError("--set", override, f"not KEY=VALUE with a TOML value: {error}") from None


def decode(tree: dict[str, object], kind: type[T], file: str) -> T:
    """A table from parsed TOML. Raises ConfigError."""
    try:
        return msgspec.convert(tree, kind)
    except msgspec.ValidationError as error:
        raise _explained(error, tree, kind, file) from None


def _explained(error: msgspec.ValidationError, tree: dict[str, object], kind: type[Table], file: str) -> ConfigError:
    """msgspec's "Expected `float` <= 1.0 - at `$.a.b[0]`" as key, reason and allowed range."""
    text, _, where = str(error).partition(" - at ")
    path = where.rpartition("$")[2].strip("`.")
    if where.startswith("`key` in"):
        return ConfigError(file, path, "no name for a table", allowed(Name))
    if "[...]" in path:
        path = _named(tree, kind, path)
    if unknown := re.search(r"unknown field `(.+)`", text):
        keys = ", ".join(field.encode_name for field in msgspec.structs.fields(_hint(kind, path)))
        return ConfigError(file, f"{path}.{unknown[1]}".lstrip("."), "unknown key", keys)
    if missing := re.search(r"missing required field `(.+)`", text):
        return ConfigError(file, f"{path}.{missing[1]}".lstrip("."), "missing")
    reason = text.replace("`", "").replace("object", "table")
    return ConfigError(file, path, reason[:1].lower() + reason[1:], allowed(_hint(kind, path)))


def _named(tree: Any, kind: type[Table], path: str) -> str:
    """msgspec says `services[...]` for every key of a table of tables; the key is the first one whose table is refused."""
    table, _, rest = path.partition("[...]")
    for part in table.split("."):
        tree = tree[part]
    for key, value in tree.items():
        try:
            msgspec.convert(value, _hint(kind, f"{table}.{key}"))
        except msgspec.ValidationError:
            return f"{table}.{key}{rest}"
    return path


def _hint(kind: Any, path: str) -> Any:
    """The annotation found at a path: `services.httpd.place`, `runtime.cpus[0]`."""
    for part in re.findall(r"[\w-]+", path):
        while get_origin(kind) is Annotated:
            kind = get_args(kind)[0]
        if get_origin(kind) is dict:
            kind = get_args(kind)[1]
        elif get_origin(kind) is tuple:
            kind = get_args(kind)[0]
        else:
            kind = get_type_hints(kind, include_extras=True)[part]
    return kind


def allowed(hint: Any) -> str:
    """A type's range in words: "0.0 to 1.0", "dsor, nmea2000"."""
    if get_origin(hint) is Literal:
        return ", ".join(map(str, get_args(hint)))
    if get_origin(hint) is not Annotated:
        if isinstance(hint, type) and issubclass(hint, Table):
            return f"a table of {', '.join(field.encode_name for field in msgspec.structs.fields(hint))}"
        return {bool: "true or false", str: "text"}.get(hint, getattr(hint, "__name__", str(hint)))
    meta = get_args(hint)[1]
    if meta.pattern:
        return f"text matching {meta.pattern}"
    if meta.min_length is not None:
        return f"{meta.min_length} to {meta.max_length} of {allowed(get_args(get_args(hint)[0])[0])}"
    low = f"{meta.ge}" if meta.ge is not None else f"more than {meta.gt}" if meta.gt is not None else ""
    return f"{low} to {meta.le}" if meta.le is not None else f"{low} or more"
