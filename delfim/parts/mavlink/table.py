"""The keys of the console's link in a vehicle's file (docs/mavlink.md)."""

from typing import Annotated, Any, Literal

import msgspec

from delfim.base.ranges import Baud, Listen, Seconds, address, is_loopback
from delfim.base.tables import Table, text


class Mavlink(Table, frozen=True):
    """The console's link: MAVLink 2 over UDP, and over a serial radio if there is one (docs/mavlink.md)."""

    enabled: bool = True  # serve it
    listen: Listen = "127.0.0.1:14555"  # address and port; port 0: any
    peers: Annotated[tuple[Listen, ...], msgspec.Meta(max_length=8)] = ("127.0.0.1:14550",)  # the boat announces itself here
    profile: Literal["lean", "radio", "wifi"] = "wifi"  # amount of telemetry, until a console asks for another profile
    key: str = ""  # file of the key, from `delfim console --keygen FILE`: only its holders are heard; "": only this computer
    autopilot: Literal["generic", "ardurover"] = "generic"  # the autopilot that the boat claims to be to other programs
    command_age_s: Seconds = 3.0  # a signed command that is older on arrival is refused
    serial: Annotated[str, text("(/[^ ]+)?", "/DEVICE, or empty")] = ""  # the port of a radio as SiK's; it needs a key
    baud: Baud = 57_600  # of that port

    def __post_init__(self) -> None:
        if self.serial and not self.key:
            raise ValueError("anybody may be heard on a radio: it needs a key; make one with: delfim console --keygen FILE")

    def settled(self, vehicle: Any) -> "Mavlink":
        if self.serial and self.serial == vehicle.slipd.device:
            raise ValueError("mavlink.serial and slipd.device are one port: a radio carries MAVLink or IP")
        return self

    @property
    def files(self) -> dict[str, str]:
        """Files and devices of this computer, by their keys."""
        return {"mavlink.key": self.key, "mavlink.serial": self.serial}

    @property
    def addresses(self) -> dict[str, tuple[str, ...]]:
        """Whom it sends to, by its keys."""
        return {"mavlink.peers": tuple(address(peer)[0] for peer in self.peers)}

    @property
    def unheard(self) -> str:
        """Why no console on another computer can reach the boat; "": one can."""
        if not self.enabled:
            return "mavlink.enabled is false"
        if not self.key:
            return "mavlink.key is empty, and without a key only this computer is heard"
        is_alone = is_loopback(self.listen) and not self.serial
        return f"mavlink.listen is {self.listen}, which only this computer reaches" if is_alone else ""

    @property
    def unreachable(self) -> tuple[str, ...]:
        """The peers beyond this computer, if it is the only one that `listen` reaches."""
        return tuple(peer for peer in self.peers if is_loopback(self.listen) and not is_loopback(peer))

    @property
    def doubts(self) -> list[str]:
        """What is allowed, and hardly meant, in words."""
        words = f"cannot be reached, for mavlink.listen is {self.listen}; write 0.0.0.0 there"
        return [f"mavlink.peers: {peer} {words}" for peer in self.unreachable]
