"""Opens a CAN socket by the name of its interface. A transport is loaded when it is chosen: python-can alone takes a quarter of
a second.
"""

from delfim import config
from delfim.canproxy.socket import BATCH, CanAddress, CanSocket


def open_can(
    interface: str, *, receive_buffer_bytes: int = 1 << 20, error_frames: bool = False, batch: int = BATCH
) -> CanSocket:
    """Open a socket on one of these interfaces; raises BusError.

    "can0"                                      a Linux interface, "any" for all of them
    "canloop:NAME"                              a bus without hardware, inside this computer
    "python-can:INTERFACE:CHANNEL[@BITRATE]"    an adapter that python-can knows
    "socketcand:HOST:PORT:BUS"                  a bus behind cantcpd, or another socketcand server

    `receive_buffer_bytes` bounds the queue of received frames (a frame takes about 800 bytes of it), as far as the system
    permits. `error_frames` lets the frames through by which a controller reports its own state; see `bus_state`.
    `batch` is how many frames `receive_many` takes by one call to the kernel, where it can.
    """
    kind, _, name = interface.partition(":")
    if kind == "canloop":
        from delfim.canproxy.canloop import open_canloop

        return open_canloop(name, receive_buffer_bytes=receive_buffer_bytes, error_frames=error_frames, batch=batch)
    if kind == "python-can":
        from delfim.canproxy.adapter import PythonCan

        return CanSocket(PythonCan(name, receive_buffer_bytes, error_frames))
    if kind == "socketcand":
        from delfim.canproxy.remote import Remote

        return CanSocket(Remote(name, receive_buffer_bytes))
    from delfim.canproxy.socketcan import SocketCan

    return CanSocket(SocketCan(interface, receive_buffer_bytes, error_frames, batch))


def open_bound(settings: config.Can, interface: str, filters: tuple[CanAddress, ...]) -> CanSocket:
    """Open a socket that never blocks and receives what the filters accept; without filters, nothing. Raises BusError."""
    can = open_can(interface, receive_buffer_bytes=settings.receive_buffer_bytes)
    can.setblocking(False)
    if filters:
        can.bind(*filters)
    return can
