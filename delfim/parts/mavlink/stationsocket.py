"""The station's UDP socket and serial line on the vehicle's loop: one datagram a callback, a few frames a callback, low delay
asked for.

A defect here must not stop the boat: the callbacks are the loop's own, which logs an exception and goes on. The vehicle then
hears no console, and their silence is a trouble of the failsafe.
"""

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Final, Self

from delfim.base.input.keys import read_key
from delfim.base.ranges import address
from delfim.lines.rtcm import doorstep
from delfim.parts.mavlink.codec.signing import Kept, Signing, read_stamps, write_stamps
from delfim.parts.mavlink.codec.wire import DATAGRAM_BYTES, Address
from delfim.parts.mavlink.consoles import Obey, Review
from delfim.parts.mavlink.station import Station
from delfim.parts.mavlink.stationserial import StationSerial
from delfim.parts.mavlink.table import Mavlink
from delfim.vehicle.loop import VehicleLoop

TICK_S: Final = 0.05
STAMPS_S: Final = 10.0  # between two writes of the time stamps: after a crash, frames of this time could be replayed
LOWDELAY: Final = 0x10  # IPTOS_LOWDELAY (thesis 2.11)
BUFFER_BYTES: Final = 1 << 17

log = logging.getLogger(__name__)


class MavlinkLink:
    """The consoles' link as a context. Raises OSError if the address cannot be bound, ConfigError for a bad key."""

    def __init__(
        self,
        boat: VehicleLoop,
        obey: Obey,
        review: Review | None,
        stamps: Path,
        board: dict[str, Callable[[], dict[str, object]]],
    ) -> None:
        settings = boat.helm.settings.of(Mavlink)
        self._loop, self._board, self._stamps = asyncio.get_running_loop(), board, stamps
        self._signing = self._signed(boat, stamps) if settings.key else None
        self._socket = _bound(settings.listen)
        for peer in settings.unreachable:
            log.warning("mavlink: no datagram reaches %s from %s: mavlink.listen is this computer's own", peer, settings.listen)
        self._serial = StationSerial(settings, boat.clock, self._came) if settings.serial else None
        self._opening: asyncio.Future[None] | None = None
        whole = boat.helm.settings
        self._doorstep = str(doorstep(whole.runtime.run_directory))
        self._handing = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        correct = self._correct if whole.table("corrections").to else None
        self.station = Station(boat, obey, self._send, self._signing, review, self._is_ready, correct)
        self._unsent = 0
        self._timer: asyncio.TimerHandle | None = None
        self._written_s = self._loop.time()

    def __enter__(self) -> Self:
        self._loop.add_reader(self._socket.fileno(), self._readable)
        if self._serial is not None:
            self._loop.add_reader(self._serial.fileno(), self._serial.readable)
        self._board["mavlink"] = self.report
        self._tick()
        return self

    def __exit__(self, *_: object) -> None:
        if self._timer is not None:
            self._timer.cancel()
        del self._board["mavlink"]
        self._loop.remove_reader(self._socket.fileno())
        self._socket.close()
        self._handing.close()
        if self._serial is not None:
            self._loop.remove_reader(self._serial.fileno())
            self._serial.close()
        if self._signing is not None:
            self._write(self._stamps, self._signing.kept())

    def report(self) -> dict[str, object]:
        """JSON-ready."""
        host, port = self._socket.getsockname()[:2]
        consoles = self.station.consoles
        serial = {} if self._serial is None else {"serial": self._serial.report()}
        peers = [f"{host}:{port}" for host, port in consoles.peers.known]
        return {
            "listen": f"{host}:{port}",
            "owner": consoles.owner,
            "namesakes": consoles.boat.state.namesakes,
            "peers": peers,
            "unsent": self._unsent,
            "counts": dict(consoles.counts),
        } | serial

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            datagram, address = self._socket.recvfrom(DATAGRAM_BYTES)
            self.station.receive(datagram, address[:2])
            self._turn()

    def _came(self, frame: bytes, address: Address) -> None:
        self.station.receive(frame, address)
        self._loop.call_soon(self._turn)

    def _turn(self) -> None:
        if self.station.turn():
            self._loop.call_soon(self._turn)

    def _serve(self) -> None:
        if self.station.serve():
            self._loop.call_soon(self._serve)

    def _tick(self) -> None:
        self._timer = self._loop.call_later(TICK_S, self._tick)
        self.station.begin()
        self._loop.call_soon(self._turn)
        self._loop.call_soon(self._serve)
        if self._serial is not None and self._serial.is_due() and (self._opening is None or self._opening.done()):
            self._opening = self._loop.run_in_executor(None, self._serial.open)
        if self._signing is not None and self._loop.time() - self._written_s > STAMPS_S:
            self._written_s = self._loop.time()
            self._loop.run_in_executor(None, self._write, self._stamps, self._signing.kept())

    def _is_ready(self, address: Address) -> bool:
        return self._serial is None or address != self._serial.address or self._serial.is_ready()

    def _send(self, datagram: bytes, address: Address) -> None:
        if self._serial is not None and address == self._serial.address:
            self._serial.send(datagram)
            return
        try:
            self._socket.sendto(datagram, address)
        except OSError:  # no route, a full queue: the console asks again
            self._unsent += 1

    def _correct(self, data: bytes) -> bool:
        """To the process that writes to the receiver."""
        try:
            return self._handing.sendto(data, self._doorstep) == len(data)
        except OSError:  # it does not run, or has not read what came before
            return False

    @staticmethod
    def _signed(boat: VehicleLoop, stamps: Path) -> Signing:
        key = read_key(boat.helm.settings.of(Mavlink).key)
        return Signing(key, boat.clock, read_stamps(stamps), is_right=lambda: boat.state.computer.clock.is_right)

    @staticmethod
    def _write(path: Path, kept: Kept) -> None:
        with contextlib.suppress(OSError):  # no disk: the check of the log reports it
            write_stamps(path, kept)


def _bound(listen: str) -> socket.socket:
    place = address(listen)
    bound = socket.socket(socket.AF_INET6 if ":" in place[0] else socket.AF_INET, socket.SOCK_DGRAM)
    try:
        bound.setblocking(False)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        if bound.family == socket.AF_INET:
            bound.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, LOWDELAY)
        else:
            bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_TCLASS, LOWDELAY)
        bound.bind(place)
    except OSError as error:
        bound.close()
        log.error("mavlink: no console can connect on %s: %s", listen, error.strerror)
        raise
    return bound
