"""fleetd: the boat at an MQTT broker (docs/fleets.md): its MAVLink frames up, those of consoles down, its state retained.

A process of its own. To the vehicle it is one more peer of MAVLink, at an address of this computer, and it watches the state
over the command socket: the runtime knows nothing of a broker. It has no key and can sign nothing: what it hands to the vehicle
is judged there as everything else.
"""

import asyncio
import contextlib
import socket
from typing import Any, Final

import msgspec

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import PermanentFailure, in_words
from delfim.base.ranges import address
from delfim.parts.fleet.broker import DOWN, STATE, UP, BrokerLine, BrokerPlace
from delfim.parts.fleet.table import FleetTable
from delfim.parts.mavlink.table import Mavlink
from delfim.services.report_feed import watch
from delfim.services.runtime import Runtime
from delfim.vehicle.report import BoatReport

DATAGRAMS: Final = 16  # in one call
DATAGRAM_BYTES: Final = 2048


class FleetMember:
    """This boat at the broker. `door` is the socket to which the vehicle sends its frames. Raises ConfigError."""

    def __init__(self, settings: config.Vehicle, door: socket.socket, clock: Clock) -> None:
        table, self._name = settings.of(FleetTable), settings.boat.name
        place = BrokerPlace.of(table.broker)
        self._door, self._vehicle = door, address(settings.of(Mavlink).listen)
        self._clock, self._period_s, self._due_s = clock, table.period_s, clock.monotonic_s()
        self._silence = "the vehicle has not answered yet"
        self._up, self._state = place.topic(self._name, UP), place.topic(self._name, STATE)
        self.line = BrokerLine(
            place,
            place.topic(self._name, DOWN),
            self._on_order,
            clock,
            credentials=table.credentials,
            authorities=table.authorities,
            boat=self._name,
        )
        self._unheard = 0

    def on_frames(self) -> None:
        """Forward frames of the vehicle."""
        with contextlib.suppress(BlockingIOError, ConnectionError):
            for _ in range(DATAGRAMS):
                data, address = self._door.recvfrom(DATAGRAM_BYTES)
                if address[1] == self._vehicle[1]:  # another program of this computer is not the boat
                    self.line.put(self._up, data)

    def _on_order(self, topic: str, frame: bytes) -> None:
        try:
            self._door.sendto(frame, self._vehicle)
        except OSError:  # a full queue, no vehicle: the console asks again
            self._unheard += 1

    def heard(self, state: BoatReport) -> None:
        """Take a state that the vehicle just published."""
        self._silence, now_s = "", self._clock.monotonic_s()
        if now_s >= self._due_s:
            self._due_s = max(self._due_s, now_s - self._period_s) + self._period_s
            self.line.keep(self._state, msgspec.json.encode(retained_state(state, self._clock.time_ns())))

    def silent(self, why: str) -> None:
        self._silence = why

    def report(self) -> dict[str, object]:
        """The report, JSON-ready."""
        troubles = {"broker": self.line.reason, "vehicle": self._silence}
        return {
            "troubles": {part: words for part, words in troubles.items() if words},
            "broker": f"{self.line.place.host}:{self.line.place.port}",
            "counts": {**self.line.counts, "unheard": self._unheard},
        }


def retained_state(state: BoatReport, utc_ns: int) -> dict[str, Any]:
    """The retained state. Null is unknown; `utc_s` is when it was published, by the boat's computer."""
    navigation_s = state.age_s.get("navigation")
    return {
        "boat": state.boat,
        "utc_s": round(utc_ns / 1e9, 3),
        "mode": state.mode,
        "reason": state.reason,
        "operator": state.operator,
        "helmsman": state.helmsman,
        "latitude_deg": state.latitude_deg,
        "longitude_deg": state.longitude_deg,
        "heading_deg": state.heading_deg,
        "course_deg": state.course_deg,
        "speed_mps": state.speed_mps,
        "navigation_age_s": navigation_s,
        "mission": state.mission,
        "leg": state.reference.leg,
        "line": state.reference.line,
        "charge": min((each.charge for each in state.sysstat.values() if each.charge is not None), default=None),
        "troubles": [notice.name for notice in state.notices],
    }


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings, status = runtime.config, runtime.status.get("fleetd")
    if status is not None and status.place == "runtime":
        raise PermanentFailure("fleetd: it reckons ciphers, for which the runtime has no time; write place = 'process'")
    loop, listen = asyncio.get_running_loop(), address(settings.of(FleetTable).listen)
    family = socket.AF_INET6 if ":" in listen[0] else socket.AF_INET
    with contextlib.ExitStack() as links:
        door = links.enter_context(socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK))
        try:
            door.bind(listen)
        except OSError as error:
            raise PermanentFailure(f"fleet.listen: {settings.of(FleetTable).listen}: {in_words(error)}") from None
        member = FleetMember(settings, door, runtime.clock)
        loop.add_reader(door, member.on_frames)
        links.callback(loop.remove_reader, door)
        links.enter_context(runtime.publishing("fleetd", member.report))
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(watch(settings.console.socket, member.heard, member.silent))
                group.create_task(member.line.follow())
        except* ModuleNotFoundError as error:
            raise PermanentFailure("aiomqtt is not installed: pip install 'delfim[fleet]'") from error
