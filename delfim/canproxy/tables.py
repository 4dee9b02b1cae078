"""The keys of the daemons that carry frames beyond a bus, in a vehicle's file."""

from ipaddress import IPv4Address, IPv4Interface, ip_network
from typing import Annotated

import msgspec

from delfim.base.ranges import (
    BitRate,
    DeviceName,
    DsorNode,
    Interface,
    LinuxInterface,
    Listeners,
    Name,
    Network,
    Ports,
    Seconds,
)
from delfim.base.tables import Table, text

Identifiers = Annotated[  # one or a range; three digits are a standard identifier, eight an extended one
    str,
    text(
        "([0-7][0-9A-Fa-f]{2}(-[0-7][0-9A-Fa-f]{2})?|[01][0-9A-Fa-f]{7}(-[01][0-9A-Fa-f]{7})?)",
        "three or eight hexadecimal digits, or two such with - between them",
    ),
]


class Cantcpd(Table, frozen=True):
    """CAN over TCP, the socketcand protocol. It has no passwords: addresses decide who may watch and who may transmit."""

    listen: Listeners = ("127.0.0.1:29536",)  # addresses and ports
    slcan: Ports = ()  # addresses and ports that serve the first bus in slcan
    buses: tuple[Interface, ...] = ()  # that clients can open, by name or its part after the last colon; empty: the boat's
    watch: tuple[Network, ...] = ("127.0.0.0/8", "::1/128")  # networks that may connect
    transmit: tuple[Network, ...] = ()  # the networks, among these, that may also send frames: no password keeps others out
    barred: tuple[Identifiers, ...] = ("040-043", "0A0", "0C0", "0C8")  # nobody sends these: to actuators, reset, time, off
    clients: Annotated[int, msgspec.Meta(ge=1, le=64)] = 16  # connections at once; beyond, the oldest without a bus is closed
    clients_per_address: Annotated[int, msgspec.Meta(ge=1, le=64)] = 8  # likewise, from one address
    queue_bytes: Annotated[int, msgspec.Meta(ge=8192, le=16 << 20)] = 1 << 18  # of one client; if full, the oldest frames go
    stall_s: Seconds = 30.0  # a client that reads and sends nothing, or opens no bus, for this long is closed
    beacon: tuple[LinuxInterface, ...] = ()  # LANs on which the buses are announced (UDP port 42000); never a radio link

    def __post_init__(self) -> None:
        for network in (*self.watch, *self.transmit):
            ip_network(network)


class CanipPeer(Table, frozen=True):
    """A node of the bus that has an address."""

    address: str  # IPv4
    node: DsorNode  # on the bus

    def __post_init__(self) -> None:
        IPv4Address(self.address)


class Canip(Table, frozen=True):
    """IP over CAN: a TUN device that carries UDP datagrams to nodes of the bus and back."""

    enabled: bool = False  # run it; needs CAP_NET_ADMIN
    device: DeviceName = "canip0"  # the device's name
    address: str = "192.168.1.2/24"  # of the device, IPv4 with prefix length; empty: set by another program
    mtu: Annotated[int, msgspec.Meta(ge=576, le=65_535)] = 65_535  # larger datagrams come as fragments, which are dropped
    priority: Annotated[int, msgspec.Meta(ge=0, le=255)] = 192  # of datagrams on the bus; 0 is the most urgent
    source: str = "192.168.1.1"  # IPv4 source address of datagrams from nodes that are not among the peers
    peers: dict[Name, CanipPeer] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        IPv4Address(self.source)
        if self.address:
            IPv4Interface(self.address)
        peers = self.peers.values()
        if len({peer.address for peer in peers}) < len(peers) or len({peer.node for peer in peers}) < len(peers):
            raise ValueError("two peers have the same address or the same node")


class RoutingBus(Table, frozen=True):
    """A further bus with nodes of the DSOR protocol."""

    interface: Interface  # the bus
    nodes: Annotated[tuple[DsorNode, ...], msgspec.Meta(min_length=1, max_length=64)]  # that are on it
    bitrate_bps: BitRate = 500_000  # of a Linux interface, which the first process sets up (docs/boot.md)


class Routing(Table, frozen=True):
    """Messages of the DSOR protocol between buses (docs/dsor.md). Nodes that no bus names are on `can.interface`."""

    everybody: Annotated[tuple[DsorNode, ...], msgspec.Meta(max_length=64)] = ()  # their messages to everybody go to all buses
    frames_per_s: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 2000  # that go from bus to bus at most; more are lost
    buses: dict[Name, RoutingBus] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        nodes = [node for bus in self.buses.values() for node in bus.nodes]
        interfaces = [bus.interface for bus in self.buses.values()]
        for node in nodes:
            if nodes.count(node) > 1:
                raise ValueError(f"node {node:#04x} is named twice: each is on one bus")
        for interface in interfaces:
            if interfaces.count(interface) > 1:
                raise ValueError(f"{interface} is named twice: each bus has one table")
