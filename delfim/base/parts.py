"""Parts: drivers of motors, sources of navigation and sensors, each a row. The rows of the boat's own are OWN.

A laboratory's own part is a Python package outside the project, which a boat has because its file names it. The package's
entry point in the group `delfim.parts` is its row. The vehicle's file names it in `[parts]` with its version; only then it
is imported. No other file pays for the look among the installed packages, which takes some 30 ms.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

from delfim.base import modes
from delfim.base.errors import ConfigError, DelfimError, PermanentFailure, did_you_mean, in_words
from delfim.base.pulses import CHANNELS
from delfim.base.tables import Table

if TYPE_CHECKING:  # its import takes as long as that of all tables, and few files name a part
    from importlib.metadata import EntryPoint

GROUP: Final = "delfim.parts"
API: Final = 1  # of the rows and of `delfim.api`: a part that was made for another one is refused
TROUBLES: Final = range(29, 31)  # numbers for the troubles of parts: bits in the state log, of which the boat's own are lower
OF_FILE: Final = Table  # in a row of the boat's own, whose keys every vehicle's file has


class TroubleRow(NamedTuple):
    """A trouble that a part detects, with a table in `[failsafe]` of the vehicle's file."""

    name: str  # of its table, small letters and _
    number: int  # one of TROUBLES
    table: type[Table]  # a `delfim.api.Trouble`, or a `Silence`, which compares `after_s` itself; OF_FILE: it is among its keys
    sees: str  # module:function; it takes a `delfim.api.Look` and returns the reason in words, or None; ten times a second


class ModeRow(NamedTuple):
    """A mode of a part: it steers, as heading and hold do, and has a key in each trouble of `[failsafe]`."""

    name: str  # small letters and _
    number: int  # one of `modes.OF_PARTS`, on the console's link and in the log
    program: str  # module with `open_mode(settings)`, which returns a `delfim.api.Program`


class Drives(NamedTuple):
    """What is known of a driver before it is loaded: the vehicle's file is checked against it."""

    sides: Literal["", "each", "mixed"] = ""  # its addresses are a starboard and a port side; mixed: it needs both
    motors: int = 256  # their addresses are below this
    turns: int = 256  # thrusters that it can turn, at most
    channels: int = 0  # motors, and what turns them, share addresses below this; 0: each has its own
    revolves: bool = False  # its table's `command` may be rpm: a row must say then how many
    # Facts of the boat's own alone:
    nodes: bool = False  # its motors are nodes of the boat's own bus, whose health they report and whose batteries it can cut
    outlet: bool = False  # its motors are told by pulses, which the outlet writes
    played: bool = False  # its devices are simulated; others are pushed as they are told


class OrderRow(NamedTuple):
    """An order of the operator that a part carries out."""

    name: str  # small letters, digits and _
    table: type[Table]  # its keys
    does: str  # module:function; it takes a `delfim.api.OrderAsked`, and returns None, why not, or a `delfim.api.Goto` ...
    number: int = 0  # for other consoles by MAVLink, MAV_CMD_USER_1 to 5, 31010 to 31014; 0: none


class Part(NamedTuple):
    """The row of a part. A text names a module, or a function as module:function, which is loaded when it is used."""

    name: str  # as the vehicle's file has it, small letters, digits and _
    table: type[Table] | str | None = None  # its keys, in a table of its name; module:class
    driver: str = ""  # module with `open_actuator(settings, links)`
    source: str = ""  # module with `open_source(settings, links, state)`
    sensor: str = ""  # module with `VALUES` and `open_sensor(settings, links)`
    service: str = ""  # module:coroutine, which takes the runtime
    troubles: tuple[TroubleRow, ...] = ()
    modes: tuple[ModeRow, ...] = ()
    orders: tuple[OrderRow, ...] = ()
    played: str = ""  # its device in simulation: module with `devices_of` or `buses_of` (buses), or `instrument_of` (a line)
    api: int = API
    drives: Drives = Drives()  # the facts of its driver
    protocol: str = ""  # that its bus carries, where others have it, too
    instruments: bool = False  # its sensor reads a ship's instruments: a boat has one such
    waits: bool = False  # its source's device may be missing at the start, and is opened when it is there
    # Facts of the boat's own alone:
    vessels: bool = False  # it tells of other vessels
    separate: bool = False  # its source reads separate sensors, which an estimator may take (docs/estimator.md)
    outlet: str = ""  # of drivers whose motors are told by pulses: module:function of the process that writes them
    batteries: bool = False  # its sensor tells of batteries
    output: str = ""  # module:function that yields, by name, who tells others what the boat knows; for the `out` of its table
    exposure: str = ""  # module:function that yields who may do what where it listens, of what runs (`delfim check --sea`)
    ask: str = ""  # module with `MOTORS` and `POSITIONS`, what `delfim new` asks (`delfim.base.questions`)
    ports: bool = False  # its lines are `ports` of its table, by their names, of which it needs one
    after: str = ""  # its table stands behind this one in the file
    keys: tuple[str, ...] = ()  # of the vehicle's file: a boat has this part where one of them is set
    aboard: str = ""  # module:function; it takes a `delfim.vehicle.aboard.OpenedWith` and returns what the loop is `Added`


OWN_NODES: Final = "dsor"  # the part of the boat's own nodes: their source and driver
OWN: Final = {  # in the order in which sources are listed
    row.name: row
    for row in (
        Part("sysstat", sensor="delfim.parts.dsor.sysstat"),
        Part(
            OWN_NODES,
            "delfim.parts.dsor.table:Dsor",
            after="propulsion",
            driver="delfim.parts.dsor.driver",
            source="delfim.parts.dsor.source",
            drives=Drives(sides="each", nodes=True, played=True),
        ),
        Part(
            "nmea2000",
            "delfim.parts.nmea2000.table:Nmea2000",
            after="navigation",
            ask="delfim.parts.nmea2000.ask",
            source="delfim.parts.nmea2000.source",
            sensor="delfim.parts.nmea2000.sensor",
            vessels=True,
            protocol="NMEA 2000",
            separate=True,
            instruments=True,
        ),
        Part(
            "dronecan",
            "delfim.parts.dronecan.table:Dronecan",
            after="dsor",
            ask="delfim.parts.dronecan.ask",
            driver="delfim.parts.dronecan.driver",
            source="delfim.parts.dronecan.source",
            sensor="delfim.parts.dronecan.sensor",
            played="delfim.parts.dronecan.sim",
            batteries=True,
            protocol="DroneCAN",
            separate=True,
            drives=Drives(motors=20, turns=15, revolves=True, played=True),  # of one command
        ),
        Part(
            "nmea0183",
            "delfim.parts.nmea0183.table:Nmea0183",
            after="nmea2000",
            ask="delfim.parts.nmea0183.ask",
            exposure="delfim.parts.nmea0183.exposure:entrances",
            source="delfim.parts.nmea0183.source",
            sensor="delfim.parts.nmea0183.sensor",
            vessels=True,
            separate=True,
            instruments=True,
            output="delfim.parts.nmea0183.output:tellers",
            ports=True,
        ),
        Part(
            "ins",
            "delfim.parts.ins.table:InsTable",
            after="ping",
            ask="delfim.parts.ins.ask",
            source="delfim.parts.ins.source",
            played="delfim.parts.ins.sim",
        ),
        Part(
            "ping",
            "delfim.parts.ping.table:PingTable",
            after="nmea0183",
            sensor="delfim.parts.ping.sensor",
            played="delfim.parts.ping.sim",
        ),
        Part(
            "mavlink",
            "delfim.parts.mavlink.table:Mavlink",
            after="console",
            exposure="delfim.parts.mavlink.exposure:entrances",
            vessels=True,
        ),
        Part(
            "guest",
            "delfim.services.tables:GuestTable",
            after="kill",
            vessels=True,
            keys=("nmea0183.guest.device",),
            aboard="delfim.parts.guest.pilotline:opened",
        ),
        Part(
            "traffic",
            keys=("traffic.hears", "traffic.mmsi", "payload", "dronecan.rangefinders"),
            aboard="delfim.parts.traffic.aboard:opened",
            troubles=(
                TroubleRow("traffic", 17, OF_FILE, "delfim.parts.traffic.troubles:near"),
                TroubleRow("traffic_close", 18, OF_FILE, "delfim.parts.traffic.troubles:close"),
                TroubleRow("ais_silent", 19, OF_FILE, "delfim.parts.traffic.troubles:silent"),
                TroubleRow("traffic_unclear", 21, OF_FILE, "delfim.parts.traffic.troubles:unclear"),
            ),
        ),
        Part(
            "energy",
            "delfim.parts.energy.table:EnergyTable",
            after="failsafe",
            keys=("energy.capacity_wh",),
            aboard="delfim.parts.energy.aboard:opened",
            troubles=(TroubleRow("energy", 25, OF_FILE, "delfim.parts.energy.troubles:energy"),),
        ),
        Part("handset", keys=("handset.device", "kill.chip"), aboard="delfim.parts.handset.aboard:opened"),
        Part("corrections", "delfim.parts.gnss.table:Corrections", after="nmea0183"),
        Part("i2c", "delfim.parts.i2c.table:I2cTable", after="corrections", ask="delfim.parts.i2c.ask"),
        Part(
            "fleet",
            "delfim.parts.fleet.table:FleetTable",
            after="mavlink",
            exposure="delfim.parts.fleet.exposure:entrances",
        ),
        Part(
            "iridium",
            "delfim.parts.iridium.table:IridiumTable",
            after="fleet",
            exposure="delfim.parts.iridium.exposure:entrances",
        ),
        Part(
            "ros",
            "delfim.parts.ros.table:RosTable",
            after="iridium",
            exposure="delfim.parts.ros.exposure:entrances",
        ),
        Part(
            "payload",
            "delfim.parts.payload.table:Payloads",
            after="image",
            exposure="delfim.parts.payload.exposure:entrances",
        ),
        Part(
            "camera",
            "delfim.parts.camera.table:Cameras",
            after="payload",
            exposure="delfim.parts.camera.exposure:entrances",
        ),
        Part(
            "mavlink_front_seat",
            "delfim.parts.frontseats.table:MavlinkFrontSeat",
            after="heron",
            ask="delfim.parts.frontseats.ask",
            driver="delfim.parts.frontseats.mavlink_motors",
            source="delfim.parts.frontseats.mavlink_source",
            drives=Drives(sides="mixed"),
            waits=True,
        ),
        Part(
            "heron",
            "delfim.parts.frontseats.table:HeronTable",
            after="otter",
            driver="delfim.parts.frontseats.heron",
            drives=Drives(sides="mixed"),
        ),
        Part(
            "otter",
            "delfim.parts.frontseats.table:OtterTable",
            after="vesc",
            driver="delfim.parts.frontseats.otter",
            drives=Drives(sides="mixed"),
        ),
        Part(
            "pwm",
            "delfim.parts.pwm.table:Pwm",
            after="thrusters",
            ask="delfim.parts.pwm.ask",
            driver="delfim.parts.pwm.driver",
            outlet="delfim.parts.pwm.outlet:serve",
            played="delfim.parts.pwm.sim",
            drives=Drives(channels=CHANNELS, outlet=True),
        ),
        Part(
            "torqeedo",
            "delfim.parts.torqeedo.table:TorqeedoTable",
            after="vesc",
            ask="delfim.parts.torqeedo.ask",
            driver="delfim.parts.torqeedo.driver",
            drives=Drives(turns=0),
        ),
        Part(
            "torqlink",
            "delfim.parts.torqeedo.table:TorqlinkTable",
            after="torqeedo",
            ask="delfim.parts.torqeedo.ask_torqlink",
            driver="delfim.parts.torqeedo.torqlink",
            played="delfim.parts.torqeedo.sim",
            drives=Drives(turns=0),
        ),
        Part(
            "vesc",
            "delfim.parts.vesc.table:Vesc",
            after="pwm",
            ask="delfim.parts.vesc.ask",
            driver="delfim.parts.vesc.driver",
            played="delfim.parts.vesc.sim",
            protocol="VESC",
            drives=Drives(turns=0, revolves=True, played=True),
        ),
    )
}

ROOMS: Final = (  # the tables of daemons and of the simulator, which lie in their rooms
    Part("cantcpd", "delfim.canproxy.tables:Cantcpd", after="guest"),
    Part("canip", "delfim.canproxy.tables:Canip", after="cantcpd"),
    Part("routing", "delfim.canproxy.tables:Routing", after="canip"),
    Part("timed", "delfim.services.tables:Timed", after="routing"),
    Part("slipd", "delfim.services.tables:Slipd", after="timed"),
    Part("httpd", "delfim.services.tables:Httpd", after="slipd"),
    Part("tablet", "delfim.services.tables:Tablet", after="httpd"),
    Part("ftpd", "delfim.services.tables:Ftpd", after="tablet"),
    Part("sshd", "delfim.services.tables:Sshd", after="ftpd"),
    Part("powerd", "delfim.services.tables:PowerdTable", after="sshd"),
    Part("logd", "delfim.services.tables:Logd", after="log"),
    Part("image", "delfim.services.tables:Image", after="supervisor"),
    Part("simulation", "delfim.simulator.tables:Simulation", after="services"),
)
TABLED: Final = tuple(row for row in (*OWN.values(), *ROOMS) if row.table)  # those with keys in every vehicle's file


@cache
def installed() -> "dict[str, list[EntryPoint]]":
    """The entry points of all packages of this computer that have parts, by the parts' names; nothing is imported."""
    from importlib.metadata import entry_points

    found: dict[str, list[EntryPoint]] = {}
    for each in entry_points(group=GROUP):
        found.setdefault(each.name, []).append(each)
    return found


def version_of(entry: "EntryPoint") -> str:
    return entry.dist.version if entry.dist is not None else "unknown"


def named(wanted: object, file: str) -> tuple[Part, ...]:
    """The parts that `[parts]` of a vehicle's file names, in its order; without it none, and nothing is looked up. Raises
    ConfigError where one is not installed, has another version, or cannot be imported."""
    if not wanted or not isinstance(wanted, Mapping):
        return ()
    rows = tuple(_loaded(str(name), str(version), file) for name, version in wanted.items())
    numbers = dict[int, str]()
    for name, trouble in ((row.name, trouble) for row in rows for trouble in row.troubles):
        key = f"parts.{name}"
        if trouble.number not in TROUBLES:
            raise ConfigError(
                file, key, f"trouble {trouble.name} has number {trouble.number}", f"{TROUBLES[0]} to {TROUBLES[-1]}"
            )
        if (other := numbers.setdefault(trouble.number, trouble.name)) != trouble.name:
            raise ConfigError(file, key, f"its trouble {trouble.name} has number {trouble.number}, as {other} has")
    for row in rows:
        for mode in row.modes:
            try:
                modes.join(mode.name, mode.number)
            except ValueError as error:
                raise ConfigError(file, f"parts.{row.name}", str(error)) from None
    _check_orders(rows, file)
    return rows


def _check_orders(rows: tuple[Part, ...], file: str) -> None:
    """Check the parts' orders. Raises ConfigError where one has no name or number of its own, or numbers cannot give it."""
    from delfim.base.numberedorders import numbered  # few files name a part

    names, numbers = dict[str, str](), dict[int, str]()
    for part, order in ((row.name, order) for row in rows for order in row.orders):
        key, name = f"parts.{part}", order.name
        if not re.fullmatch("[a-z][a-z0-9_]{0,31}", name):
            raise ConfigError(file, key, f"{name!r} is no name for an order: small letters, digits and _")
        if (other := names.setdefault(name, part)) != part:
            raise ConfigError(file, key, f"its order {name} has the name of an order of {other}")
        if order.number and (other := numbers.setdefault(order.number, name)) != name:
            raise ConfigError(file, key, f"its order {name} has number {order.number}, as {other} has")
        try:
            if order.number:
                numbered(order.number, name, order.table)
        except ValueError as error:
            raise ConfigError(file, key, str(error)) from None


def _loaded(name: str, version: str, file: str) -> Part:
    entries, key = installed().get(name, []), f"parts.{name}"
    if not entries:
        raise ConfigError(file, key, f"no installed package has a part of this name{did_you_mean(name, installed())}")
    if len(entries) > 1:
        owners = " and ".join(sorted(each.dist.name if each.dist is not None else each.value for each in entries))
        raise ConfigError(file, key, f"{owners} both have a part of this name; remove one of them")
    if (there := version_of(entries[0])) != version:
        raise ConfigError(file, key, f"version {there} is installed, and the file is made for {version}")
    try:
        row = _row(entries[0])
    except DelfimError as error:
        raise ConfigError(file, key, str(error)) from None
    if not isinstance(row, Part):
        raise ConfigError(file, key, f"{entries[0].value} is no delfim.api.Part")
    if row.api != API:
        raise ConfigError(file, key, f"it was made for interface {row.api} of parts, and this Delfim has {API}")
    if row.name != name:
        raise ConfigError(file, key, f"its row has another name, {row.name}")
    return row


@cache
def _row(entry: "EntryPoint") -> object:
    """Load the row that an entry point names. Raises DelfimError."""
    try:
        return entry.load()
    except (Exception, SystemExit) as error:  # foreign code, of which anything may come
        raise DelfimError(f"it cannot be imported: {in_words(error)}") from error


def load(part: Part, place: str) -> Any:
    """Load the module or function that a row names. Raises PermanentFailure."""
    module, _, function = place.partition(":")
    try:
        found = import_module(module)
        return getattr(found, function) if function else found
    except (Exception, SystemExit) as error:
        raise PermanentFailure(f"part {part.name}: {place} cannot be imported: {in_words(error)}") from error


def table_of(part: Part) -> Any:
    """The class of a part's table. Raises PermanentFailure."""
    return load(part, part.table) if isinstance(part.table, str) else part.table


def find(aboard: Sequence[Part], name: str) -> Part | None:
    """The part of this name among those aboard; None if the name is one of the boat's own."""
    return next((each for each in aboard if each.name == name), None)


def row(aboard: Sequence[Part], name: str) -> Part:
    """The row of this name, of the boat's own or of the parts aboard. Raises KeyError."""
    return OWN.get(name) or {each.name: each for each in aboard}[name]


def module(aboard: Sequence[Part], kind: str, name: str) -> Any:
    """The module of a driver, a source or a sensor. Raises PermanentFailure for a part that cannot be imported."""
    part = row(aboard, name)
    return import_module(getattr(part, kind)) if name in OWN else load(part, getattr(part, kind))


def of_kind(aboard: Iterable[Part], kind: str) -> Iterator[str]:
    """The names of all rows that have a driver, a source, a sensor ..."""
    return (each.name for each in aboard if getattr(each, kind))


def forget() -> None:
    """Forget the packages that were found, to look anew for those installed or removed meanwhile."""
    installed.cache_clear()
    _row.cache_clear()
