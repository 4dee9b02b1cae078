"""IP over CAN (thesis 5.3.3): a TUN device, canip0, whose UDP datagrams travel as DSOR messages between nodes of the bus.

The DSOR header has room for destination port and address only. The receiver rebuilds the rest of a datagram's
headers; `docs/canip.md` lists every field. Everything but UDP in IPv4 is dropped and counted. Linux only.
"""

import asyncio
import contextlib
import errno
import fcntl
import os
import socket
import struct
from collections import Counter
from ipaddress import IPv4Address, IPv4Interface
from typing import Final

from delfim.base.errors import DelfimError, FormatError, PermanentFailure, Refused
from delfim.canproxy.dsor.protocol import BROADCAST, Message, Outcome
from delfim.canproxy.dsor.sockets import DsorTransport
from delfim.canproxy.socket import CanSocket
from delfim.canproxy.tables import Canip

UDP_MAX: Final = 65_507  # bytes of data that fit a datagram of IPv4
TTL: Final = 64
PACKETS_PER_READ: Final = 4
WAITING_MAX: Final = 16  # datagrams to one node, the one under way included; a dead node delays no other

_IPV4: Final = struct.Struct("!BBHHHBBHII")
_UDP: Final = struct.Struct("!HHHH")
_HEADERS_BYTES: Final = _IPV4.size + _UDP.size
_DONT_FRAGMENT, _FRAGMENT = 0x4000, 0x3FFF  # flags and offset of the IPv4 header: the bits that a fragment has

# linux/if_tun.h, linux/sockios.h, linux/if.h
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_SIOCGIFFLAGS, _SIOCSIFFLAGS, _SIOCSIFADDR, _SIOCSIFNETMASK, _SIOCSIFMTU = 0x8913, 0x8914, 0x8916, 0x891C, 0x8922
_IFF_UP: Final = 1


def parsed(packet: bytes) -> tuple[int, int, bytes]:
    """Parse the packet of a UDP datagram to (destination address, destination port, data). Raises FormatError with the reason
    for other packets."""
    if len(packet) < _IPV4.size or packet[0] >> 4 != 4:
        raise FormatError("not IPv4")
    head, _, length, _, fragment, _, protocol, _, _, destination = _IPV4.unpack_from(packet)
    start = (head & 15) * 4
    if protocol != socket.IPPROTO_UDP:
        raise FormatError("not UDP")
    if fragment & _FRAGMENT:
        raise FormatError("a fragment")
    if start < _IPV4.size or not start + _UDP.size <= length <= len(packet):
        raise FormatError("malformed")
    _, port, udp_length, _ = _UDP.unpack_from(packet, start)
    if not _UDP.size <= udp_length <= length - start:
        raise FormatError("malformed")
    return destination, port, packet[start + _UDP.size : start + udp_length]


def rebuilt(message: Message, source: int, identification: int) -> bytes:
    """Build the packet of a UDP message (`port` and `address` given), sent from `source`. Source port and UDP checksum are
    zero, "not known" (RFC 768): the CRC of the DSOR message protects the data. Raises FormatError if it is too large for
    UDP."""
    if len(message.data) > UDP_MAX:
        raise FormatError("too large for UDP")
    assert message.address is not None
    assert message.port is not None
    length = _HEADERS_BYTES + len(message.data)
    fields = (0x45, 0, length, identification & 0xFFFF, _DONT_FRAGMENT, TTL, socket.IPPROTO_UDP)
    header = _IPV4.pack(*fields, 0, source, message.address)
    header = _IPV4.pack(*fields, checksum(header), source, message.address)
    return header + _UDP.pack(0, message.port, _UDP.size + len(message.data), 0) + message.data


def checksum(header: bytes) -> int:
    """The internet checksum (RFC 1071) of an even number of bytes."""
    total: int = sum(struct.unpack(f"!{len(header) // 2}H", header))
    total = (total & 0xFFFF) + (total >> 16)
    return ~(total + (total >> 16)) & 0xFFFF


class CanIp:
    """Carries datagrams between the TUN device `tun` (a file descriptor that does not block) and the bus, both ways. Call
    `on_packets` when the device is readable.

    counts  outcome of datagrams -> number: "sent", "delivered", "received", and the reasons for dropping others
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, tun: int, can: CanSocket, settings: Canip, node: int) -> None:
        """`node` is this computer's. The caller closes `tun` and `can`, after `close`. Raises BusError, FormatError."""
        self.counts: Counter[str] = Counter()
        self._tun, self._settings, self._node = tun, settings, node
        self._nodes = {int(IPv4Address(peer.address)): peer.node for peer in settings.peers.values()}
        self._addresses = {node: address for address, node in self._nodes.items()}
        self._everybody = {0xFFFFFFFF}
        if settings.address:
            self._everybody.add(int(IPv4Interface(settings.address).network.broadcast_address))
        self._source = int(IPv4Address(settings.source))
        self._identification = 0
        self._waiting: Counter[int] = Counter()  # by node
        self._dsor = DsorTransport(
            loop,
            can,
            node,
            wanted=lambda message: message.address is not None,
            on_message=self._deliver,
            on_outcome=self._ended,
            sending_max=WAITING_MAX * max(1, len(self._nodes)),
        )
        self.errors = self._dsor.errors

    def close(self) -> None:
        self._dsor.close()

    def on_packets(self) -> None:
        """Send a few packets from the device to the bus. Raises DelfimError if the device is gone."""
        for _ in range(PACKETS_PER_READ):
            try:
                packet = os.read(self._tun, 65_536)
            except BlockingIOError:
                return
            except OSError as error:
                raise DelfimError(f"{self._settings.device}: {error.strerror}") from None
            try:
                self._send(*parsed(packet))
                self.counts["sent"] += 1
            except (FormatError, Refused) as reason:
                self.counts[str(reason)] += 1

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        return {"datagrams": dict(self.counts), "protocol": dict(self.errors), "waiting": sum(self._waiting.values())}

    def _send(self, address: int, port: int, data: bytes) -> None:
        node = self._nodes.get(address)
        if node is None and (address in self._everybody or IPv4Address(address).is_multicast):
            node = BROADCAST
        if node is None:
            raise Refused("no node has the address")
        if self._waiting[node] >= WAITING_MAX:
            raise Refused("too many wait")
        self._dsor.send(Message(self._settings.priority, self._node, node, 0, data, port=port, address=address))
        if node != BROADCAST:
            self._waiting[node] += 1

    def _ended(self, outcome: Outcome) -> None:
        self._waiting[outcome.message.destination] -= 1
        self.counts["not acknowledged" if outcome.failure else "delivered"] += 1

    def _deliver(self, message: Message) -> None:
        """Write a message into the device, as the thesis' driver does. A packet that the kernel refuses is lost, as on any
        network."""
        try:
            self._identification += 1
            os.write(self._tun, rebuilt(message, self._addresses.get(message.source, self._source), self._identification))
            self.counts["received"] += 1
        except FormatError as reason:
            self.counts[str(reason)] += 1
        except OSError as error:
            self.counts[f"device: {error.strerror}"] += 1


def open_tun(name: str, address: str, mtu: int) -> int:
    """Make the TUN device, give it its address ("192.168.1.2/24"; empty: set elsewhere) and MTU, and set it up. It goes
    away when the descriptor is closed. Raises PermanentFailure if this system cannot do it, DelfimError otherwise."""
    try:
        tun = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise PermanentFailure(f"/dev/net/tun: {error.strerror}; the kernel needs TUN (modprobe tun)") from None
    with contextlib.ExitStack() as undo:
        undo.callback(os.close, tun)
        try:
            fcntl.ioctl(tun, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN | _IFF_NO_PI))
            _configure(name, address, mtu)
        except PermissionError as error:
            raise PermanentFailure(f"{name}: {error.strerror}; CAP_NET_ADMIN is needed") from None
        except OSError as error:
            busy = error.errno == errno.EBUSY
            raise DelfimError(f"{name}: {'in use by another program' if busy else error.strerror}") from None
        undo.pop_all()
    return tun


def _configure(name: str, address: str, mtu: int) -> None:
    """Set address and MTU by the requests of netdevice(7)."""
    device = name.encode()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as inet:
        fcntl.ioctl(inet, _SIOCSIFMTU, struct.pack("16si20x", device, mtu))
        if address:
            interface = IPv4Interface(address)
            fcntl.ioctl(inet, _SIOCSIFADDR, _address_request(device, interface.ip))
            fcntl.ioctl(inet, _SIOCSIFNETMASK, _address_request(device, interface.netmask))
        flags = struct.unpack("16xH22x", fcntl.ioctl(inet, _SIOCGIFFLAGS, struct.pack("40s", device)))[0]
        fcntl.ioctl(inet, _SIOCSIFFLAGS, struct.pack("16sH22x", device, flags | _IFF_UP))


def _address_request(device: bytes, address: IPv4Address) -> bytes:
    return struct.pack("16sHH4s16x", device, socket.AF_INET, 0, address.packed)
