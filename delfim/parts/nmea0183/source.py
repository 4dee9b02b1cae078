"""Receivers, compasses and sounders that speak NMEA 0183 or UBX, on one line or several (docs/nmea0183.md, docs/rtk.md)."""

import math
import select
from collections.abc import Callable, Iterator
from functools import partial
from typing import Final, NamedTuple

from delfim import config
from delfim.base.errors import FormatError
from delfim.base.vessels import Report
from delfim.canproxy.dsor.messages import SystemStatus
from delfim.lines.nmea0183.aissentences import AisMessages, AisPart
from delfim.lines.nmea0183.sentences import RadarTarget
from delfim.parts.nmea0183 import radar
from delfim.parts.nmea0183.combining import Combined
from delfim.parts.nmea0183.mixedline import Antennas, MixedLine
from delfim.parts.nmea0183.table import Nmea0183
from delfim.vehicle.links import Links, ReadableLine
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.navigation.fusion import Hearer
from delfim.vehicle.navigation.iron import iron_of
from delfim.vehicle.state import Ping, State

GREETING: Final = b'{"class":"VERSION"'  # of gpsd, whoever connects
WATCH: Final = b'?WATCH={"enable":true,"nmea":true};\r\n'  # it answers with sentences
NAME: Final = "nmea0183"
GARBLED_S: Final = 3.0  # of nonsense alone that is told


HearAis = Callable[[Report | RadarTarget | str, str, float], object]  # a report, or why there is none; the port, the time


class Port(NamedTuple):
    """A line with its name in the vehicle's file."""

    name: str
    line: ReadableLine
    sentences: MixedLine
    vessels: AisMessages


class LineData(NamedTuple):
    """The data of one read."""

    t_ns: int
    port: Port
    data: bytes


_new = tuple.__new__  # in half the time of LineData(...)


def _when(piece: LineData) -> int:
    return piece.t_ns


class AnyPort:
    """A descriptor that is readable when one of the lines is."""

    def __init__(self, ports: tuple[Port, ...]) -> None:
        self._ready = select.epoll()
        for port in ports:
            if (descriptor := port.line.fileno()) >= 0:  # in lock step nothing waits for a line
                self._ready.register(descriptor, select.EPOLLIN)

    def fileno(self) -> int:
        return self._ready.fileno()

    def rebind(self) -> bool:
        return True  # each line is rebound by itself


class Nmea0183Navigation:
    """All ports of the vehicle's file."""

    name = NAME

    def __init__(self, ports: tuple[Port, ...], combined: Combined, hear: HearAis | None) -> None:
        self.input, self._ports, self._combined, self._hear = AnyPort(ports), ports, combined, hear
        self._next = 0  # the port that is read first
        self.heard_s, self.t_ns = -1e9, 0
        self._sound: dict[str, tuple[float, int, int]] = {}  # by port: when a sentence was sound last, and the counts then

    def tell(self, hearer: Hearer) -> None:
        self._combined.fusion.hearer = hearer

    def read(self, now_s: float) -> Fix | None:
        """Read the newest complete position, None while there is none. Unreadable sentences are counted."""
        fix = None
        for t_ns, port, data in sorted(self._waiting(), key=_when):
            self.t_ns = t_ns
            for sentence in port.sentences.feed(data):
                if isinstance(sentence.message, AisPart):
                    self._tell_of_vessels(sentence.message, port, now_s)
                    continue
                if isinstance(sentence.message, RadarTarget):
                    if self._hear is not None:
                        self._hear(sentence.message, port.name, now_s)
                    continue
                navigation = self._combined.take(port.name, sentence, now_s)
                if navigation is not None:
                    fix = Fix(navigation, t_ns, now_s)
                    self.heard_s = now_s
        return fix

    def _tell_of_vessels(self, part: AisPart, port: Port, now_s: float) -> None:
        if self._hear is None:
            return
        try:
            for report in port.vessels.join(part, now_s):
                self._hear(report, port.name, now_s)
        except FormatError as error:
            self._hear(f"AIS sentence: {error}", port.name, now_s)

    def _waiting(self) -> Iterator[LineData]:
        """Read the next piece of one line, each in its turn: others stay readable, and navigation, which may come by another
        input, comes first. In lock step and in a replay, where nothing waits for a line, all pieces of all lines."""
        ports, self._next = (*self._ports[self._next :], *self._ports[: self._next]), (self._next + 1) % len(self._ports)
        for port in ports:
            while data := port.line.read():
                if GREETING in data:
                    port.line.write(WATCH)
                yield _new(LineData, (port.line.t_ns, port, data))
                if port.line.fileno() >= 0:
                    return

    def report(self, now_s: float) -> dict[str, object]:
        """The report: the device used for each kind of data, all that talk, and the sentences of each port, taken and
        refused."""
        ports = {
            port.name: {"heard": port.sentences.heard, "refused": port.sentences.refused, "garbled": self._garbled(port, now_s)}
            for port in self._ports
        }
        return {**self._combined.status(now_s), "ports": ports}

    def _garbled(self, port: Port, now_s: float) -> str:
        """Report in words that only nonsense came for a while; empty: not so. A device that was reset sends at another rate."""
        sound, refused = sum(port.sentences.heard.values()), sum(port.sentences.refused.values())
        since_s, was_sound, was_refused = self._sound.setdefault(port.name, (now_s, sound, refused))
        if sound != was_sound or refused == was_refused:
            self._sound[port.name] = now_s, sound, refused
            return ""
        if now_s - since_s < GARBLED_S:
            return ""
        return f"bytes but no sentence for {now_s - since_s:.0f} s: is the baud rate still that of the file?"


def open_source(settings: config.Vehicle, links: Links, state: State) -> Nmea0183Navigation:
    if NAME in settings.sensors.names:
        return opened(settings, links, state.measured, partial(radar.hear, state), state.sound, state.sysstat)
    return opened(settings, links, {}, partial(radar.hear, state), health=state.sysstat)


def opened(
    settings: config.Vehicle,
    links: Links,
    measured: dict[str, tuple[float, float]],
    hear: HearAis,
    sound: Callable[[Ping], object] = lambda ping: None,
    health: dict[str, tuple[SystemStatus, float]] | None = None,
) -> Nmea0183Navigation:
    """Open the source. `measured` gets the values beside navigation, `hear` the reports of other vessels, `sound` the depths,
    `health` the batteries. Raises DelfimError."""
    table = settings.of(Nmea0183)
    ports = tuple(
        Port(
            name,
            links.line(port.device.replace("gpsd:", "tcp:"), port.baud),
            MixedLine(port.checksum, Antennas(port.baseline_m, math.radians(port.baseline_deg))),
            AisMessages(),
        )
        for name, port in table.ports.items()
    )
    combined = Combined(table, settings.navigation.stale_s, measured, iron_of(settings.compass), sound, health)
    return Nmea0183Navigation(ports, combined, hear if NAME in settings.traffic.hears else None)
