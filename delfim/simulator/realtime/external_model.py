"""A model in another program, in any language, over UDP (thesis 3.6.2, figure 3-16).

The other program sends position and motion of the boat; each state is answered with the actuation that was computed from it.
Motors, batteries and all CAN nodes stay in this program, so the vehicle sees no difference. `ExternalModel` works in real time,
`SteppedModel` in lock step. `docs/external-model.md` has the protocol and examples that tests run.
"""

import contextlib
import math
import select
import socket
import time
from collections.abc import Sequence
from typing import Annotated, Any, Final, Self

import msgspec

from delfim import config
from delfim.base.errors import DelfimError
from delfim.base.geodesy import origin
from delfim.base.input.unreadable import UNREADABLE
from delfim.base.ranges import address
from delfim.simulator.model import Hull, Model, hull_of
from delfim.simulator.tables import Sea, Simulation

DATAGRAMS: Final = 16  # taken at once
ANSWER_S: Final = 0.1  # a state is answered after this time even if the vehicle commanded nothing
START_S: Final = 60.0  # in lock step the other program must be there within this time ...
STEP_S: Final = 10.0  # ... and send each state within this one
SAME_S: Final = 1e-3  # times that differ by less are the same

Finite = Annotated[float, msgspec.Meta(gt=-1e7, lt=1e7)]


class Moved(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A datagram of the model: metres north and east of the simulation's start, rad, m/s over ground. Lock step needs the
    time of the state."""

    north_m: Finite
    east_m: Finite
    heading_rad: Finite
    north_mps: Finite
    east_mps: Finite
    yaw_rate_radps: Finite = 0.0
    time_s: Finite | None = None


_decode = msgspec.json.Decoder(Moved).decode


class ExternalModel(Model):
    """The world modelled by another program. `listen` is HOST:PORT; raises DelfimError if it cannot be bound.

    In real time navigation is made from the first state that comes after it is due. That state is answered as soon as all
    thrusters have been commanded; the states between are answered at once.
    """

    def __init__(
        self,
        hull: Hull,
        listen: str,
        latitude_rad: float,
        longitude_rad: float,
        rows: Sequence[config.ThrusterTable] = config.DELFIMX,
    ) -> None:
        super().__init__(hull, Sea(), 0, latitude_rad, longitude_rad, 0.0, rows)
        self.origin = origin(latitude_rad, longitude_rad)
        self.malformed = 0
        self._fresh = False  # a state came that navigation may be made from
        self._peer: Any = None  # sent the state that is not answered yet
        self._asked_s = 0.0  # when that state came
        self._idle = set[str]()  # thrusters that were not commanded since
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(address(listen))
        except OSError as error:
            self._socket.close()
            raise DelfimError(f"simulation.external: {listen}: {error.strerror}") from None
        self._socket.setblocking(False)

    @classmethod
    def of(cls, settings: config.Vehicle) -> Self | None:
        """The model in another program, if the vehicle's file gives its address. Raises DelfimError."""
        there = settings.of(Simulation)
        if not there.external:
            return None
        start = math.radians(there.latitude_deg), math.radians(there.longitude_deg)
        return cls(hull_of(settings), there.external, *start, settings.thrusters)

    @property
    def alive(self) -> bool:
        return self._fresh

    def taken(self) -> None:
        self._fresh = False

    def fileno(self) -> int:
        """The descriptor, readable when the other program sent: call `listen` then."""
        return self._socket.fileno()

    def command(self, name: str, rpm: float, run: bool) -> None:
        super().command(name, rpm, run)
        self._idle.discard(name)
        if not self._idle:
            self._answer()

    def advance(self, dt_s: float) -> None:
        """Advance motors and batteries, the only parts modelled here."""
        for drive in self.drives.values():
            self._turn(drive, dt_s)
        self.time_s += dt_s
        if self.time_s - self._asked_s > ANSWER_S:
            self._answer()

    def listen(self) -> None:
        """Take the other program's datagrams. Malformed ones are counted."""
        for _ in range(DATAGRAMS):
            try:
                data, peer = self._socket.recvfrom(2048)
            except OSError:  # no more datagrams; or the last answer was not received
                return
            if (moved := self._read(data)) is not None:
                self._answer()  # to the state before
                self._take(moved)
                self._peer, self._asked_s, self._idle = peer, self.time_s, set(self.drives)

    def settle(self) -> None:
        """Answer a state from which no navigation was made; call it when the nodes have stepped."""
        if self._fresh:
            self._fresh = False
            self._answer()

    def _read(self, data: bytes) -> Moved | None:
        try:
            return _decode(data)
        except UNREADABLE:
            self.malformed += 1
            return None

    def _take(self, moved: Moved) -> None:
        self._fresh = True
        c, s = math.cos(moved.heading_rad), math.sin(moved.heading_rad)
        self.north_m, self.east_m, self.heading_rad = moved.north_m, moved.east_m, moved.heading_rad % math.tau
        self.surge_mps = moved.north_mps * c + moved.east_mps * s
        self.sway_mps = moved.east_mps * c - moved.north_mps * s
        self.yaw_rate_radps = moved.yaw_rate_radps

    def _work(self) -> dict[str, object]:
        """The work of the thrusters: revolutions of the propellers of DelfimX; part of full command and angle of any others."""
        if all(drive.curve is None for drive in self.drives.values()):
            present: dict[str, object] = {f"{name}_rpm": drive.rpm for name, drive in self.drives.items()}
            return present | {f"{name}_command_rpm": drive.reference_rpm for name, drive in self.drives.items()}
        return {
            "thrusters": {
                name: {
                    "part": drive.part,
                    "angle_deg": math.degrees(drive.angle_rad),
                    "command": drive.reference_rpm / drive.rpm_max,
                    "command_deg": math.degrees(drive.reference_rad),
                }
                for name, drive in self.drives.items()
            }
        }

    def _answer(self, **more: float) -> None:
        """Answer the last state, once."""
        peer, self._peer = self._peer, None
        if peer is not None:
            answer = {"time_s": self.time_s, **self._work()}
            with contextlib.suppress(OSError):  # it is gone; its silence is noticed
                self._socket.sendto(msgspec.json.encode(answer | more), peer)


class SteppedModel(ExternalModel):
    """A model in another program in lock step: the simulation waits for the state of each navigation period, and answers it
    with the propellers' work until the next one and with that one's time. A state of another time, such as one that was sent
    twice, is left out."""

    @property
    def alive(self) -> bool:
        return True

    def begin(self) -> None:
        """Connect with the other program and take its state of time 0. Raises DelfimError if it does not come."""
        self._wait(START_S, None)
        while self._arrived(0.0):  # it knocked more than once
            self._socket.recv(2048)
        self._answer(next_s=0.0)
        self._wait(STEP_S, 0.0)

    def command(self, name: str, rpm: float, run: bool) -> None:
        Model.command(self, name, rpm, run)

    def advance(self, dt_s: float) -> None:
        """Advance motors and batteries, answer the last state, and take the next one."""
        for drive in self.drives.values():
            self._turn(drive, dt_s)
        self.time_s += dt_s
        self._answer(next_s=self.time_s)
        self._wait(STEP_S, self.time_s)

    def _wait(self, patience_s: float, time_s: float | None) -> None:
        """Wait for the state of this time; None: for any."""
        until_s = time.monotonic() + patience_s
        while self._arrived(until_s - time.monotonic()):
            data, self._peer = self._socket.recvfrom(2048)
            moved = self._read(data)
            if moved is not None and (time_s is None or abs((moved.time_s or 0.0) - time_s) < SAME_S):
                self._take(moved)
                return
        wanted = "state" if time_s is None else f'state with "time_s": {time_s:.3f}'
        raise DelfimError(f"simulation.external: no {wanted} came within {patience_s:.0f} s; does the model run in lock step?")

    def _arrived(self, within_s: float) -> bool:
        return bool(select.select([self._socket], [], [], max(within_s, 0.0))[0])
