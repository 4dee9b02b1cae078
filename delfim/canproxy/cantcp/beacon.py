"""The beacon of a socketcand server: a UDP broadcast by which SavvyCAN, Kayak and python-can find it on a LAN."""

import fcntl
import socket
import struct
from collections.abc import Sequence
from html import escape
from typing import Final

PORT: Final = 42000
DATAGRAM_BYTES: Final = 1024  # python-can reads no more
_SIOCGIFFLAGS, _SIOCGIFADDR, _SIOCGIFBRDADDR = 0x8913, 0x8915, 0x8919  # linux/sockios.h
_IFF_BROADCAST, _IFF_LOOPBACK, _IFF_POINTOPOINT = 0x2, 0x8, 0x10  # linux/if.h


def datagram(host: str, address: str, port: int, buses: Sequence[str]) -> bytes:
    """The datagram that announces a server. `address` is dotted: clients do not resolve names. Buses that do not fit are left
    out."""
    head = f'<CANBeacon name="{escape(host)}" type="SocketCAN" description="Delfim cantcpd">\n<URL>can://{address}:{port}</URL>'
    text, tail = head, "</CANBeacon>"
    for bus in buses:
        longer = f'{text}<Bus name="{escape(bus)}"/>'
        if len((longer + tail).encode()) > DATAGRAM_BYTES:
            break
        text = longer
    return (text + tail).encode()


def announce(interface: str, port: int, buses: Sequence[str]) -> None:
    """Send one broadcast with the interface's own address. Raises OSError for an interface that is not a LAN or has no
    address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        request = struct.pack("16s24x", interface.encode()[:15])
        flags = struct.unpack_from("=H", fcntl.ioctl(sender, _SIOCGIFFLAGS, request), 16)[0]
        if not flags & _IFF_BROADCAST or flags & (_IFF_LOOPBACK | _IFF_POINTOPOINT):
            raise OSError(f"{interface} is not a LAN")
        address = socket.inet_ntoa(fcntl.ioctl(sender, _SIOCGIFADDR, request)[20:24])
        broadcast = socket.inet_ntoa(fcntl.ioctl(sender, _SIOCGIFBRDADDR, request)[20:24])
        sender.setblocking(False)
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sender.bind((address, 0))
        sender.sendto(datagram(socket.gethostname(), address, port, buses), (broadcast, PORT))
