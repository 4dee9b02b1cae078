"""The keys of the daemons of this room in a vehicle's file."""

from ipaddress import IPv4Address, ip_network
from typing import Annotated, Any, Literal

import msgspec

from delfim.base.ranges import (
    PORT,
    BatteryVoltage,
    Baud,
    DeviceName,
    Endpoint,
    Fraction,
    Listen,
    MountPoint,
    Name,
    Network,
    Seconds,
    is_loopback,
)
from delfim.base.tables import Table, text

Password = Annotated[  # hashed; a log shows a hash that no password has
    str,
    text("scrypt:[A-Za-z0-9+/=]+:[A-Za-z0-9+/=]+", "the output of `delfim password`", shown="scrypt:hidden:hidden"),
]
PublicKey = Annotated[str, text(r"ssh-ed25519 [A-Za-z0-9+/]+=*( [^\n]*)?\n?", "ssh-ed25519 KEY, as in a .pub file")]
PushContact = Annotated[str, text(r"((mailto:|https://)[^ ]{3,200})?", "mailto:ADDRESS, https://ADDRESS, or empty")]
PageAddress = Annotated[str, text(rf"(([^ :]+|\[[0-9A-Fa-f:.]+\]):{PORT})?", "ADDRESS:PORT, [IPv6]:PORT, or empty")]
Carrier = Annotated[str, text("(none|dcd|file:/[^ ]+)", "none, dcd, or file:/PATH")]


class Slipd(Table, frozen=True):
    """The radio's serial line as a network interface."""

    device: Annotated[str, text("(/dev/[^ ]+)?", "/dev/NAME, or empty")] = ""  # the radio's serial port; empty: no radio
    baud: Baud = 115_200  # of the port
    radio_bps: Annotated[int, msgspec.Meta(ge=0, le=4_000_000)] = 0  # bit/s, if the radio is slower than its port; else 0
    encapsulation: Literal["slip", "cslip"] = "cslip"  # cslip compresses TCP's headers (RFC 1144); both ends must agree
    mode: Literal["auto", "kernel", "user"] = "auto"  # SLIP of the kernel, of this program; auto: the kernel's if any
    interface: DeviceName = "radio0"  # its name in mode user
    address: str = "10.0.0.1"  # of the boat
    peer: str = "10.0.0.2"  # of the other end
    mtu: Annotated[int, msgspec.Meta(ge=68, le=1500)] = 296  # the shorter, the sooner an urgent packet is sent
    carrier: Carrier = "none"  # source of carrier detection: none, the modem's line (dcd), or a file
    station: Annotated[int, msgspec.Meta(ge=0, le=254)] = 0  # number of the boat if several share a frequency; else 0

    def __post_init__(self) -> None:
        IPv4Address(self.address)
        IPv4Address(self.peer)
        if self.station and self.mode == "kernel":
            raise ValueError("a station speaks when the shore polls it, which the kernel's SLIP does not do: leave mode away")


class Timed(Table, frozen=True):
    """The time frame at the start of each second, from this computer's clock."""

    mode: Literal["off", "master", "redundant"] = "off"  # redundant: only while no other node sends it
    takeover_s: Annotated[float, msgspec.Meta(ge=1.1, le=3600.0)] = 2.5  # silence after which the redundant one sends


class Httpd(Table, frozen=True):
    """The statistics page, read-only. Anyone who can reach the address may read it and the logs."""

    listen: Endpoint = "127.0.0.1:8080"  # address and port; 0.0.0.0 is every interface
    connections: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 32  # at once; the next one is closed
    connections_per_address: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 8  # so that one visitor cannot keep the others out
    scan_s: Annotated[float, msgspec.Meta(ge=5.0, le=3600.0)] = 5.0  # between two samples of the computer and its processes
    console: str = ""  # address of the operator's console, for a link to it, such as "http://127.0.0.1:8765/"; "" for none


class Tablet(Table, frozen=True):
    """The console's page, served by the boat itself: a tablet alone operates it (docs/tablet.md)."""

    listen: PageAddress = ""  # address and port; "": no page
    boats: Listen = "127.0.0.1:14561"  # the boat's frames come here: an address of this computer, one of mavlink.peers too
    directory: str = "/log/.tablet"  # the console's token, operators, missions and charts; no service gives it out
    certificate: str = ""  # PEM file with certificate and key: the page needs TLS (https); "": everything goes in the clear
    contact: PushContact = ""  # whom a push service may write to about this boat's messages; some ask for one
    silent_s: Annotated[float, msgspec.Meta(ge=1.0, le=60.0)] = 3.0  # without a word of a page: to the boat nobody is there

    def __post_init__(self) -> None:
        if not is_loopback(self.boats):
            raise ValueError("boats: an address of this computer, as 127.0.0.1:14561")

    def settled(self, vehicle: Any) -> "Tablet":
        if self.listen and not vehicle.mavlink.enabled:
            raise ValueError("tablet.listen: the page speaks to the boat by mavlink, and mavlink.enabled is false")
        if self.listen and self.boats not in vehicle.mavlink.peers:
            raise ValueError(f'tablet.listen: the boat must tell its frames there: add "{self.boats}" to mavlink.peers')
        return self


class PowerdTable(Table, frozen=True):
    """The orderly shutdown: by frame, button or command, or before the batteries are empty (docs/powerd.md)."""

    partition: MountPoint = "/log"  # unmounted last, if it holds the logs; "": none
    end_s: Seconds = 5.0  # time for other users of the partition to end before they are killed
    held_s: Seconds = 30.0  # a partition still in use after this time is given up: synced, but not unmounted
    told_s: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 2.0  # the acknowledgement is repeated for this long, then it ends
    button: str = ""  # an input device under /dev/input, or a file (a GPIO's value); "" for none
    button_pressed: str = "1"  # the file begins with this while the button is pressed
    button_s: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 2.0  # the button must be held for this long
    battery_charge: Fraction = 0.05  # the charge of a battery is at most this; 0: never ...
    battery_v: BatteryVoltage = 0.0  # ... or the voltage of one is; 0: never ...
    battery_s: Seconds = 60.0  # ... for this long, while no propeller is commanded to run


class FtpUser(Table, frozen=True):
    """A user who may log in by FTP, by name."""

    password: Password  # from `delfim password`
    upload: bool = False  # may write in `log.upload_folder`; everything else is read-only for everybody


class Ftpd(Table, frozen=True):
    """Files over FTP. Without users it is not started."""

    listen: Endpoint = "127.0.0.1:2121"  # address and port; 0.0.0.0 is every interface
    root: str = "/log"  # the folder that clients see as "/"; no path leads out of it
    certificate: str = ""  # PEM file with certificate and key: login needs TLS (RFC 4217); "": everything goes in the clear
    connections: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 16  # at once; the next one is closed
    connections_per_address: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 8  # so that one visitor cannot keep the others out
    users: dict[Name, FtpUser] = msgspec.field(default_factory=dict)


class SshUser(Table, frozen=True):
    """A user who may log in by SSH, by name."""

    keys: Annotated[tuple[str, ...], msgspec.Meta(min_length=1, max_length=16)]  # public ones, as ssh-keygen writes them


class Sshd(Table, frozen=True):
    """Commands, a shell, SFTP and SCP over SSH. Without users it is not started."""

    listen: Endpoint = "127.0.0.1:2222"  # address and port; 0.0.0.0 is every interface
    user: str = ""  # system user that runs everything; "": the user that started sshd. Needs place = "process"
    can: bool = False  # that user may open CAN sockets, and so command the propellers past cantcpd
    shell: str = "/bin/sh"  # that runs the commands
    root: str = "/log"  # the folder that SFTP and SCP see as "/"; no path leads out of it
    host_key: str = "/log/.keys/ssh_host_ed25519"  # made at the first start, and kept
    sessions: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 16  # programs at once
    connections: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 16  # at once; the next one is closed
    connections_per_address: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 8  # so that one visitor cannot keep the others out
    users: dict[Name, SshUser] = msgspec.field(default_factory=dict)


class Logd(Table, frozen=True):
    """Log messages of the nodes of the bus."""

    nodes: tuple[Annotated[int, msgspec.Meta(ge=1, le=126)], ...] = ()  # nodes to log; empty: the service is off


class Image(Table, frozen=True):
    """The two slots of the boot partition, and the signers whose images may be installed there."""

    signers: tuple[PublicKey, ...] = ()  # public ed25519 keys, as ssh-keygen writes them; without any, nothing can be installed
    partition: str = ""  # of the slots, mounted only while it is read or written; "" if the directory is always mounted
    directory: str = "/boot"  # where it is mounted
    slots: tuple[str, ...] = ()  # partitions of slots a and b, where each has its own, as on a Raspberry Pi's card


class GuestTable(Table, frozen=True):
    """The guest computer's TCP server (GREX in the thesis)."""

    enabled: bool = False  # serve a guest
    listen: Endpoint = "127.0.0.1:4747"  # address and port; beyond this computer it needs a key
    networks: tuple[Network, ...] = ("127.0.0.0/8", "::1/128")  # networks that may connect
    key: str = ""  # file of the key, from `delfim console --keygen FILE`: a guest must prove that it has it; "": it need not

    def __post_init__(self) -> None:
        for network in self.networks:
            ip_network(network)
        if self.enabled and not self.key and not is_loopback(self.listen):
            raise ValueError("a guest on another computer needs a key; make one with: delfim console --keygen FILE")
