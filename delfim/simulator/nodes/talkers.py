"""Off-the-shelf instruments that speak NMEA 0183: receivers, of AIS, too, compass, gyro, sounder, vane and radar, each on its
port.

Where they are says `simulation.instruments` of the vehicle's file; without it all are on its first port, as behind a
multiplexer. Bytes come out: simulator/realtime/instrument_lines.py brings them to a pty or over the network, lock step to
its lines.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any, Final, NamedTuple, Protocol

from delfim import config
from delfim.base.parts import OWN, Part, load
from delfim.canproxy.dsor.messages import Navigation
from delfim.lines.nmea0183.framing import framed
from delfim.lines.nmea0183.speaking import clock, gga, rmc
from delfim.simulator.model import Model
from delfim.simulator.nodes.measuring import (
    CORRECTED_S,
    AntennaMotion,
    ApparentWind,
    Compass,
    GnssReceiver,
    Sounder,
    Turn,
    Vane,
    bent_by,
)
from delfim.simulator.nodes.navigation import FIX, HDOP
from delfim.simulator.nodes.period import Period
from delfim.simulator.nodes.radars import PlayedRadar
from delfim.simulator.tables import INSTRUMENTS, Simulation

AIS_S: Final = 0.2  # between two looks at what was heard
BOARD: Final = "mavlink_front_seat"  # a port of its own


class Measuring(Protocol):
    @property
    def due_s(self) -> float: ...
    def step(self, now_s: float) -> Any | None: ...  # what it measures now, None while it says nothing


class SimulatedBoard(Protocol):
    def moved(self, moved: AntennaMotion, receiver: GnssReceiver, utc_ns: int) -> bytes: ...
    def turned(self, turn: Turn, utc_ns: int) -> bytes: ...


class Instrument(NamedTuple):
    """A sensor with the sentences that it sends of a measurement at a time."""

    port: str
    sensor: Measuring
    say: Callable[[Any, int], bytes]


class AisLine:
    """The messages that a receiver of AIS received since it was asked last; it sends the same on the bus."""

    def __init__(self, heard: deque[bytes]) -> None:
        self._heard, self._period = heard, Period(AIS_S)

    @property
    def due_s(self) -> float:
        return self._period.due_s

    def step(self, now_s: float) -> bytes | None:
        if not self._period.passed(now_s) or not self._heard:
            return None
        said = b"".join(self._heard)
        self._heard.clear()
        return said


class SimulatedInstruments:
    """All instruments. `receivers` and `compasses` are those that faults break. `ais` are the sentences of a receiver of
    AIS."""

    def __init__(
        self, settings: config.Vehicle, model: Model, seed: int, ais: deque[bytes] | None, radars: Sequence[PlayedRadar]
    ) -> None:
        self._here, self._model, self._seed, self._ais = settings.of(Simulation), model, seed, ais
        self._corrected = settings.failsafe.gnss_poor.corrections_s > 0.0  # a boat that asks for corrections gets them
        self._variation_rad = math.radians(settings.table("nmea0183").variation_deg)
        self.receivers, self.compasses = list[GnssReceiver](), list[Compass]()
        self._bent = bent_by(settings.compass, self._variation_rad)
        self._all = [one for each in placed(settings) for one in self._made(*each.split(":"))]
        if BOARD in settings.navigation.sources:
            self._all += self._board(settings)
        of_parts = tuple(_of_parts(settings, model, seed))
        self._all += (*of_parts, *(Instrument(each.port, each, each.say) for each in radars))
        for each in (one.sensor for one in of_parts):  # of an inertial navigation system
            self.receivers += [each.receiver] if hasattr(each, "receiver") else []
            self.compasses += [each.compass] if hasattr(each, "compass") else []

    @property
    def ports(self) -> frozenset[str]:
        """The ports with an instrument."""
        return frozenset(each.port for each in self._all)

    @property
    def sensors(self) -> tuple[Measuring, ...]:
        return tuple(each.sensor for each in self._all)

    @property
    def due_s(self) -> float:
        """The time when `step` is due next."""
        return min((each.sensor.due_s for each in self._all), default=math.inf)

    def step(self, now_s: float, utc_ns: int) -> Iterator[tuple[str, bytes]]:
        """The sentences of this instant, by port; the model was advanced by the nodes."""
        for port, sensor, say in self._all:
            if (measured := sensor.step(now_s)) is not None:
                yield port, say(measured, utc_ns)

    def _made(self, port: str, kind: str) -> Iterator[Instrument]:
        """Make an instrument; None of a kind that the file switches off."""
        here, model, seed = self._here, self._model, self._seed
        if kind == "receiver" and here.receiver_hz:
            receiver = GnssReceiver(model, here, seed, f"receiver {port}")
            receiver.corrections_s = CORRECTED_S if self._corrected else None
            self.receivers.append(receiver)
            yield Instrument(port, receiver, lambda moved, utc_ns: _position(receiver, moved, utc_ns))
        elif kind == "compass" and here.compass_hz:
            self.compasses.append(Compass(model, here, seed, f"compass {port}"))
            self.compasses[-1].bent = self._bent
            yield Instrument(port, self.compasses[-1], self._heading)
        elif kind == "gyro" and here.compass_hz and here.gyro:
            yield Instrument(port, Compass(model, here, seed, f"gyro {port}"), _rate)
        elif kind == "sounder" and here.sounder_hz:
            yield Instrument(port, Sounder(model, here, seed), _depth)
        elif kind == "wind" and here.wind_hz:
            yield Instrument(port, Vane(model, here, seed), _wind)
        elif kind == "ais" and self._ais is not None:
            yield Instrument(port, AisLine(self._ais), lambda said, utc_ns: bytes(said))

    def _board(self, settings: config.Vehicle) -> Iterator[Instrument]:
        """The board: a Pixhawk with a receiver and a compass that know where north is."""
        says: SimulatedBoard = import_module(f"{__package__}.boards").PlayedBoard(settings.table(BOARD).board)
        if self._here.receiver_hz:
            receiver = GnssReceiver(self._model, self._here, self._seed, BOARD)
            self.receivers.append(receiver)
            yield Instrument(BOARD, receiver, lambda moved, utc_ns: says.moved(moved, receiver, utc_ns))
        if self._here.compass_hz:
            self.compasses.append(Compass(self._model, self._here, self._seed, BOARD))
            yield Instrument(BOARD, self.compasses[-1], says.turned)

    def _heading(self, turn: Turn, utc_ns: int) -> bytes:
        """The sentences of a magnetic compass that does not know the variation of the place."""
        return framed(f"HCHDG,{_degrees(turn.heading_rad - self._variation_rad)},,,,")


def _position(receiver: GnssReceiver, moved: AntennaMotion, utc_ns: int) -> bytes:
    """The sentences GGA, RMC and GST, as a receiver of several systems sends them."""
    told = *(None,) * 4, FIX, receiver.satellites, HDOP, 0, None, receiver.corrections_s
    n = tuple.__new__(Navigation, (utc_ns, *moved, *told))  # half the time of Navigation(...)
    sigma = f"{receiver.stated_m:.2f}"
    return gga(n) + rmc(n) + framed(f"GPGST,{clock(n.utc_ns)},{sigma},,,,{sigma},{sigma},")


def _rate(turn: Turn, utc_ns: int) -> bytes:
    return framed(f"TIROT,{math.degrees(turn.rate_radps) * 60.0:.1f},A")


def _depth(depth_m: float, utc_ns: int) -> bytes:
    return framed(f"SDDPT,{depth_m:.2f},0.00,")


def _wind(wind: ApparentWind, utc_ns: int) -> bytes:
    return framed(f"WIMWV,{_degrees(wind.angle_rad)},R,{wind.speed_mps:.1f},M,A")


def _degrees(angle_rad: float) -> str:
    return f"{round(math.degrees(angle_rad) * 10.0) % 3600 / 10.0:.1f}"


def hears(settings: config.Vehicle) -> bool:
    """Whether the boat listens to such ports."""
    return "nmea0183" in (*settings.navigation.sources, *settings.sensors.names)


def placed(settings: config.Vehicle) -> tuple[str, ...]:
    """The PORT:INSTRUMENT pairs of a boat that listens to such ports."""
    if not hears(settings):
        return ()
    here, first = settings.of(Simulation), next(iter(settings.table("nmea0183").ports))
    if first in [each.port for each in here.things.lookout]:  # a radar has its port for itself
        return here.instruments
    return here.instruments or tuple(f"{first}:{kind}" for kind in INSTRUMENTS)


def port_devices(settings: config.Vehicle) -> dict[str, str]:
    """The devices of all ports by their names."""
    ports = {name: port.device.replace("gpsd:", "tcp:") for name, port in settings.table("nmea0183").ports.items()}
    of_parts = {part.name: str(getattr(settings.table(part.name), "device", "")) for part in on_lines(settings)}
    return ports | {BOARD: settings.table(BOARD).device} | of_parts


def on_lines(settings: config.Vehicle) -> tuple[Part, ...]:
    """The parts whose devices may be on lines of their own: of the boat's own sensors and sources, and all of a laboratory."""
    used = dict.fromkeys((*settings.sensors.names, *settings.navigation.sources))
    own = (OWN[name] for name in used if name in OWN)
    return (*(part for part in own if part.played and hasattr(settings.table(part.name), "device")), *settings.aboard)


def _of_parts(settings: config.Vehicle, model: Model, seed: int) -> Iterator[Instrument]:
    """The devices of parts on lines."""
    for part in on_lines(settings):
        if part.played and hasattr(module := load(part, part.played), "instrument_of"):
            device = module.instrument_of(settings, model, seed)
            yield Instrument(part.name, device, device.say)


def instruments_of(
    settings: config.Vehicle, model: Model, seed: int, ais: deque[bytes] | None = None, radars: Sequence[PlayedRadar] = ()
) -> SimulatedInstruments | None:
    """The instruments that the vehicle's file calls for; None: there are none."""
    has_any = (
        radars or placed(settings) or BOARD in settings.navigation.sources or any(part.played for part in on_lines(settings))
    )
    return SimulatedInstruments(settings, model, seed, ais, radars) if has_any else None
