"""The keys of corrections for a receiver in a vehicle's file (docs/rtk.md)."""

from typing import Annotated, Any

import msgspec

from delfim.base.ranges import PORT, Baud
from delfim.base.tables import Table, text

CorrectionsTo = Annotated[
    str,
    text(
        rf"([A-Za-z][A-Za-z0-9_-]{{0,31}}|/[^ ]+|tcp:([0-9.]+|\[[0-9A-Fa-f:.]+\]):{PORT})?",
        "a name of nmea0183.ports, /DEVICE, tcp:ADDRESS:PORT, or empty",
    ),
]
CasterPlace = Annotated[
    str,
    text(
        rf"(ntrips?://([A-Za-z0-9.-]+|\[[0-9A-Fa-f:]+\]):{PORT}/[!-~]{{1,100}})?",
        "ntrip://HOST:PORT/MOUNTPOINT, or ntrips, or empty",
    ),
]


class Corrections(Table, frozen=True):
    """Corrections (RTCM 3) for a receiver with RTK: from an NTRIP caster, and by MAVLink from a console (docs/rtk.md)."""

    to: CorrectionsTo = ""  # the receiver's port: a name of nmea0183.ports, a port of its own, or a connection; "": none
    baud: Baud = 115_200  # of a serial port of its own
    caster: CasterPlace = ""  # where they come from; ntrips is over TLS; "": by MAVLink alone
    credentials: str = ""  # file with USER:PASSWORD in one line, mode 0600; "": the caster asks for none
    gga_s: Annotated[float, msgspec.Meta(ge=0.0, le=600.0)] = 10.0  # the caster is told the boat's place so often; 0: never

    def __post_init__(self) -> None:
        if self.caster and not self.to:
            raise ValueError("a caster needs a receiver: write to = ...")
        if self.credentials and not self.caster:
            raise ValueError("credentials without a caster: write caster = ...")

    def settled(self, vehicle: Any) -> "Corrections":
        if self.to and not self.to.startswith(("/", "tcp:")):
            ports = vehicle.nmea0183.ports
            if self.to not in ports or not ports[self.to].device.startswith(("/", "tcp:")):
                raise ValueError(f"corrections.to: nmea0183.ports has no serial port or connection of the name {self.to}")
        return self

    @property
    def ends(self) -> dict[str, str]:
        """The line that it writes to, by its key."""
        return {"corrections.to": self.to}

    @property
    def files(self) -> dict[str, str]:
        """Files and devices of this computer, by their keys."""
        return {"corrections.credentials": self.credentials, "corrections.to": self.to if self.to.startswith("/") else ""}
