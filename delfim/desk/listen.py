"""The reports of a boat's sensors, for `delfim sensors`: requested from the running boat, else heard on its ports and buses.

These are opened to listen: nothing is sent. A boat that runs loses no byte by it.
"""

import contextlib
import copy
import errno
import math
import select
import socket
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple, Protocol, cast

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import DelfimError
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.lines.forms import Form
from delfim.lines.opening import AnyLine, OpenedLinks
from delfim.logging.linelog import line_id
from delfim.parts.nmea0183.table import Nmea0183
from delfim.vehicle import sensors
from delfim.vehicle.links import Links, Readable
from delfim.vehicle.navigation.fixes import Source, open_source
from delfim.vehicle.operator.link import Link
from delfim.vehicle.state import State

GONE: Final = errno.ENOENT, errno.ECONNREFUSED  # nobody listens: no boat runs
READS: Final = 64  # of one input at once
REOPEN_S: Final = 1.0


class SensorsTold(NamedTuple):
    """The reports at one time: the figures of each source, why ports are not open, and values by source and kind."""

    at_s: float  # monotonic
    figures: dict[str, dict[str, Any]]
    troubles: dict[str, str]  # by port, or by source
    values: dict[tuple[str, str], tuple[float, ...]]  # rad, m/s; latitude and longitude, north and east
    measured: dict[str, float]
    source: str = ""  # of the boat's navigation, where it runs


class Hearing(Protocol):
    where: str

    def reports(self, wait_s: float) -> SensorsTold: ...  # after this time
    def close(self) -> None: ...


def listener(settings: config.Vehicle, clock: Clock) -> Hearing:
    """The running boat, else its ports and buses. Raises DelfimError, also where a running boat does not answer us."""
    with socket.socket(socket.AF_UNIX) as knock:
        if knock.connect_ex(settings.console.socket) in GONE:
            return Opened(settings, clock)
    return Running(settings, Link(settings.console.socket))


class Running:
    """A boat that runs, read over its command socket."""

    where = "the boat runs: these are its own figures"

    def __init__(self, settings: config.Vehicle, link: Link) -> None:
        self._settings, self._link = settings, link
        self._devices = {name: line_id(_opened(port.device)) for name, port in settings.of(Nmea0183).ports.items()}

    def reports(self, wait_s: float) -> SensorsTold:
        """Request the reports. Raises DelfimError."""
        select.select([], [], [], wait_s)
        state = self._link.ask("state")
        names: tuple[str, ...] = (*self._settings.navigation.sources, *self._settings.sensors.names)
        told = {name: state.get(self._settings.figures_of(name)) for name in names}
        figures = {name: each for name, each in told.items() if isinstance(each, dict)}
        troubles = {name: state.get(device, {}).get("trouble", "") for name, device in self._devices.items()}
        values = {(state["source"], kind): value for kind, value in _navigated(state)}
        measured = {name: _number(value) for name, value in state["measured"].items()}
        return SensorsTold(state["figures_s"], figures, troubles, values, measured, state["source"])

    def close(self) -> None:
        self._link.close()


class Opened:
    """The ports and buses of a boat that does not run."""

    where = "no boat runs: its ports and buses are opened to listen"

    def __init__(self, settings: config.Vehicle, clock: Clock) -> None:
        self._settings, self._clock, self._state = settings, clock, State()
        self._links = OpenedLinks(settings, clock, contextlib.ExitStack())
        self._lines, self._troubles = dict[str, AnyLine](), dict[str, str]()
        self._values = dict[tuple[str, str], tuple[float, ...]]()
        self._messages = dict[str, int]()
        self._reads = list[tuple[Readable, Callable[[float], object]]]()
        self._sources = list[Source]()
        links = Links(self._bus, self._line)
        for name in settings.navigation.sources:
            with self._told_why(name):
                self._listen_to(open_source(name, settings, links, self._state))
        for sensor in settings.sensors.names:
            with self._told_why(sensor):
                self._read(sensors.module(sensor, settings).open_sensor(settings, links))
        self._rebound_s = clock.monotonic_s()

    def reports(self, wait_s: float) -> SensorsTold:
        until_s = self._clock.monotonic_s() + wait_s
        while (now_s := self._clock.monotonic_s()) < until_s:
            if now_s - self._rebound_s >= REOPEN_S:
                self._rebound_s = now_s
                self._links.rebind()
            ready, _, _ = select.select([each for each, _ in self._reads], [], [], min(until_s - now_s, REOPEN_S))
            for each, read in self._reads:
                if each in ready:
                    read(self._clock.monotonic_s())
        now_s = self._clock.monotonic_s()
        figures = {source.name: {**source.report(now_s), "messages": self._messages[source.name]} for source in self._sources}
        ports = {name: self._lines.get(_opened(port.device)) for name, port in self._settings.of(Nmea0183).ports.items()}
        troubles = self._troubles | {name: line.trouble for name, line in ports.items() if line is not None}
        measured = {name: value for name, (value, _) in self._state.measured.items()}
        return SensorsTold(now_s, copy.deepcopy(figures), troubles, dict(self._values), measured)

    def close(self) -> None:
        self._links.links.close()

    @contextlib.contextmanager
    def _told_why(self, name: str) -> Iterator[None]:
        try:
            yield
        except DelfimError as error:
            self._troubles[name] = str(error)

    def _listen_to(self, source: Any) -> None:
        self._sources.append(source)
        self._messages[source.name] = 0
        if hasattr(source, "tell"):
            source.tell(lambda kind, value, *more: self._values.__setitem__((source.name, kind), value))

        def read(now_s: float) -> None:
            for _ in range(READS):
                fix = source.read(now_s)
                if fix is None:
                    return
                self._messages[source.name] += 1
                for kind, value in _of(fix.navigation):
                    self._values[source.name, kind] = value

        self._reads.append((source.input, read))

    def _read(self, sensor: Any) -> None:
        self._reads.append((sensor.input, lambda now_s: sensor.read(self._state, now_s)))

    def _bus(self, interface: str, filters: tuple[CanAddress, ...]) -> CanSocket:
        return cast(CanSocket, MuteBus(self._links.bus(interface, filters)))

    def _line(self, device: str, baud: int, form: Form = "8N1") -> AnyLine:
        """One line for all who listen to it."""
        if device not in self._lines:
            self._lines[device] = self._links.opened(device, baud, form, may_lack=True)
            self._lines[device].rebind()
        return self._lines[device]


class MuteBus:
    """A socket on which nothing is sent."""

    def __init__(self, can: CanSocket) -> None:
        self.receive, self.rebind, self.fileno = can.receive, can.rebind, can.fileno

    def sendto(self, data: bytes, address: CanAddress) -> None:
        raise OSError(errno.EPERM, "this program only listens")


def _opened(device: str) -> str:
    return device.replace("gpsd:", "tcp:")


def _of(n: Any) -> Iterator[tuple[str, tuple[float, ...]]]:
    """The values of a navigation message that are known."""
    kinds = {
        "position": (n.latitude_rad, n.longitude_rad),
        "velocity": (n.north_mps, n.east_mps),
        "heading": (n.heading_rad,),
        "rate": (n.yaw_rate_radps,),
        "quality": (n.fix, n.satellites),
    }
    for kind, value in kinds.items():
        if None not in value:
            yield kind, value


def _navigated(state: dict[str, Any]) -> Iterator[tuple[str, tuple[float, ...]]]:
    """The known values of a boat's state, which is in degrees."""
    if state["latitude_deg"] is not None:
        yield "position", (math.radians(state["latitude_deg"]), math.radians(state["longitude_deg"]))
    if state["speed_mps"] is not None:
        course_rad = math.radians(state["course_deg"] or 0.0)
        yield "velocity", (state["speed_mps"] * math.cos(course_rad), state["speed_mps"] * math.sin(course_rad))
    if state["heading_deg"] is not None:
        yield "heading", (math.radians(state["heading_deg"]),)
    if state["turn_dps"] is not None:
        yield "rate", (math.radians(state["turn_dps"]),)
    if state["fix"] is not None:
        yield "quality", (state["fix"], state["satellites"])


def _number(value: Any) -> float:
    return float(value["value"]) if isinstance(value, dict) else float(value)
