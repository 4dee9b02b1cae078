"""The keys of lines of NMEA 0183 and UBX in a vehicle's file (docs/nmea0183.md)."""

from ipaddress import ip_network
from typing import Annotated, Any, Literal

import msgspec

from delfim.base.ranges import (
    PLACE,
    PORT,
    Degrees,
    Metres,
    Name,
    Network,
    Speed,
    is_loopback,
)
from delfim.base.tables import Table, text

LINES = 8  # of NMEA 0183, at most
LineDevice = Annotated[
    str,
    text(
        rf"({PLACE}|(udp|tcp|tcp-listen|gpsd):([0-9.]+|\[[0-9A-Fa-f:.]+\]):{PORT})",
        "/DEVICE, or udp:, tcp:, tcp-listen: or gpsd: before ADDRESS:PORT, the address in numbers",
    ),
]
PilotDevice = Annotated[
    str,
    text(
        rf"(({PLACE}|(udp|tcp|tcp-listen):([0-9.]+|\[[0-9A-Fa-f:.]+\]):{PORT})?)",
        "/DEVICE, or udp:, tcp: or tcp-listen: before ADDRESS:PORT of this computer, or empty",
    ),
]
OutDevice = Annotated[
    str,
    text(rf"({PLACE}|udp:([0-9.]+|\[[0-9A-Fa-f:.]+\]):{PORT})", "/DEVICE, or udp:ADDRESS:PORT, the address in numbers"),
]
SPOKEN_BYTES = {"RMC": 80, "HDT": 20, "GGA": 77, "VTG": 48, "ROT": 24}  # at most, of each sentence that is told
SpokenName = Literal["RMC", "HDT", "GGA", "VTG", "ROT"]
TalkerName = Annotated[
    str, text("[A-Za-z][A-Za-z0-9_-]{0,31}(:[A-Z0-9]{2})?", "a port's name, or PORT:TALKER with the talker's two letters")
]
TransducerName = Annotated[
    str, text(r"-?[^ ,*$\x00-\x1f-]{0,32}", "the name that the device sends, or - and the name, or empty")
]

XdrBatteries = Annotated[
    tuple[Annotated[str, text("[^ ,*$]{1,32}", "the name that the device sends")], ...], msgspec.Meta(max_length=2)
]


class Nmea0183Port(Table, frozen=True):
    """A line of NMEA 0183, of UBX, or of both."""

    device: LineDevice  # a serial port, or where its sentences come from over the network
    baud: Annotated[int, msgspec.Meta(ge=1200, le=4_000_000)] = 4800  # of a serial port
    checksum: bool = True  # a sentence without a checksum is refused; one with a wrong checksum always is
    baseline_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.0  # between two antennas of a u-blox pair; 0: no heading
    baseline_deg: Degrees = 0.0  # their line, from the moving base's to the rover's, clockwise from the bow


class Nmea0183Out(Table, frozen=True):
    """Navigation told to another instrument, as a receiver tells it. Unknown values are not told."""

    to: OutDevice  # a serial port of its own, or where datagrams go
    baud: Annotated[int, msgspec.Meta(ge=1200, le=4_000_000)] = 4800  # of a serial port
    sentences: Annotated[tuple[SpokenName, ...], msgspec.Meta(min_length=1, max_length=5)] = ("RMC", "HDT")  # in this order
    rate_hz: Annotated[float, msgspec.Meta(ge=0.1, le=20.0)] = 1.0  # of each

    def __post_init__(self) -> None:
        baud = 10.0 * self.rate_hz * sum(SPOKEN_BYTES[name] for name in self.sentences)
        if not self.to.startswith("udp:") and baud > self.baud:
            raise ValueError(
                f"{', '.join(self.sentences)} {self.rate_hz:g} times a second need {baud:.0f} baud: all would be late"
            )


class Nmea0183Guest(Table, frozen=True):
    """A line on which survey software or a plotter steers the boat as its guest, by APB, RMB and XTE (docs/guest.md)."""

    device: PilotDevice = ""  # a port of its own; empty: nobody steers so
    baud: Annotated[int, msgspec.Meta(ge=1200, le=4_000_000)] = 4800  # of a serial port
    speed_mps: Speed = 1.0  # these sentences tell none; the operator's speed counts before it
    lookahead_m: Metres = 20.0  # the boat steers for a point of the line this far ahead
    variation_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] | None = None  # without it magnetic bearings are refused

    def __post_init__(self) -> None:
        if self.device and not self.device.startswith("/") and not is_loopback(self.device.partition(":")[2]):
            raise ValueError("these sentences prove no key: name a serial port or this computer; elsewhere guests use [guest]")


class Nmea0183(Table, frozen=True):
    """Receivers, compasses and sounders on lines of text. Of several that send the same value, the first in `preferred` is
    used, then the one whose port stands first."""

    preferred: Annotated[tuple[TalkerName, ...], msgspec.Meta(max_length=32)] = ()  # ports, or talkers of one, best first
    senders: tuple[Network, ...] = ("127.0.0.0/8", "::1/128")  # networks from which udp and tcp-listen take sentences
    variation_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] = 0.0  # used while nobody sends one; east positive
    pitch: TransducerName = ""  # name of the XDR transducer that measures it, with - before it if bow up is negative there
    roll: TransducerName = ""  # likewise; starboard down is positive here
    barometer: TransducerName = ""  # name of the XDR transducer that measures the pressure of the air
    batteries: XdrBatteries = ()  # names of XDR's of the starboard or only battery, and of the port one; empty: not read
    ports: dict[Name, Nmea0183Port] = msgspec.field(default_factory=dict)
    out: dict[Name, Nmea0183Out] = msgspec.field(default_factory=dict)
    guest: Nmea0183Guest = Nmea0183Guest()

    def __post_init__(self) -> None:
        for network in self.senders:
            ip_network(network)
        if max(len(self.ports), len(self.out)) > LINES:
            raise ValueError(f"ports and out: {LINES} at most of each")
        for each in self.preferred:
            if each.partition(":")[0] not in self.ports:
                raise ValueError(f"preferred: there is no port {each.partition(':')[0]}")

    def settled(self, vehicle: Any) -> "Nmea0183":
        if vehicle.guest.enabled and self.guest.device:
            raise ValueError("guest.enabled and nmea0183.guest.device: two guests would steer by turns; choose one")
        for each in vehicle.simulation.instruments:
            if (port := each.partition(":")[0]) not in self.ports:
                raise ValueError(f"simulation.instruments: there is no port {port} in nmea0183")
        return self

    @property
    def lines(self) -> dict[str, Table]:
        """Lines beside its `ports`, by their keys."""
        return {"nmea0183.guest": self.guest} if self.guest.device else {}

    @property
    def ends(self) -> dict[str, str]:
        """The lines that it writes to, by their keys."""
        return {f"nmea0183.out.{name}.to": out.to for name, out in self.out.items()}

    @property
    def spare(self) -> tuple[str, ...]:
        """Devices that may be missing when the boat starts, and are looked for until they are there."""
        return (*(port.device for port in self.ports.values()), *self.ends.values(), self.guest.device)
