"""A boat for tests of the console: it speaks MAVLink as docs/mavlink.md says, obeys modes, thrust and missions, and remembers.

It stands in for a vehicle where the link between the two is what is tested; the whole vehicle is met in test_operating.py.
"""

import json
import math
import time
from collections.abc import Callable
from random import Random
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

from delfim.base.clock import ManualClock
from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import ownorders
from delfim.vehicle import console


def order(word: str, words: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """An order in the boat's own words; the name of a mode that is no order is the order to enter it."""
    kind = console.KINDS.get(word)
    is_order = word in ("profile", "kill") or (kind is not None and issubclass(kind, console.OperatorOrder))
    return (word, words) if is_order else ("mode", {"mode": word})


PORTS = mavlink.MAV_COMP_ID_AUTOPILOT1


class FakeBoat:
    """`say` takes the bytes for the console."""

    def __init__(self, number: int, clock: ManualClock, say: Callable[[bytes], None], secret: bytes | None = None) -> None:
        self.number, self.clock, self._say = number, clock, say
        self.mode, self.thrust, self.obeyed = 4, [], []
        self.refuse: str | None = None
        self.profile: int | None = 2  # None: it knows no such parameter
        self.position = [386_900_000 + number * 1000, -92_150_000]
        self.aboard: dict[int, list[Any]] = {0: [], 1: [], 2: []}
        self._incoming: tuple[int, int, list[Any]] | None = None
        self._mav = mavlink.MAVLink(None, number, PORTS)
        self._mav.robust_parsing = True
        if secret is not None:
            signing = self._mav.signing
            signing.secret_key, signing.sign_outgoing = secret, True
            signing.timestamp = round((time.time() - 1_420_070_400) * 1e5)
        self.refused = 0
        self.heartbeats = 0
        self.name, self.run, self.asked_name = "", "", 0
        self.size = ""
        self.modes: list[tuple[int, bytes]] = []  # numbers and names that it tells; none: it knows no such question
        self.asked_modes = 0
        self.offers = ownorders.own_offers()
        self.is_older = False  # than the boat's own words on this link
        self._answers: dict[int, str] = {}
        self.tells = True  # its revolutions and its battery; otherwise, that both are unknown
        self._said_s = -1.0

    def say(self, *messages: Any) -> None:
        data = b""
        for message in messages:
            data += message.pack(self._mav)
            self._mav.seq = (self._mav.seq + 1) & 0xFF
        self._say(data)

    def tick(self) -> None:
        """Once a second: alive, position, rpm, power."""
        now_s = self.clock.monotonic_s()
        if now_s - self._said_s < 1.0:
            return
        self._said_s = now_s
        self.say(
            self._heartbeat(),
            mavlink.MAVLink_global_position_int_message(round(now_s * 1e3), *self.position, 0, 0, 100, 50, 0, 9000),
            mavlink.MAVLink_raw_rpm_message(0, 300.0 if self.tells else math.nan),
            mavlink.MAVLink_raw_rpm_message(1, 310.0 if self.tells else math.nan),
            mavlink.MAVLink_sys_status_message(0, 0, 0, 100, *((48_000, -1, 80) if self.tells else (65535, -1, -1)), *[0] * 6),
        )

    def hear(self, data: bytes) -> None:
        for message in self._mav.parse_buffer(data) or []:
            if message.get_type() == "BAD_DATA":
                self.refused += 1
            else:
                self._take(message)

    def _take(self, m: Any) -> None:
        kind = m.get_type()
        if kind == "HEARTBEAT":
            self.heartbeats += 1
        elif getattr(m, "target_system", getattr(m, "target", self.number)) != self.number:
            raise AssertionError(f"a message for another boat: {m}")
        elif kind == "MANUAL_CONTROL":
            self.thrust.append((m.x, m.r))
        elif kind == "COMMAND_LONG":
            self._command(m)
        elif kind == "V2_EXTENSION":
            self._own_order(m)
        elif kind == "PARAM_SET":
            self.profile = int(m.param_value)
            self.say(mavlink.MAVLink_param_value_message(m.param_id.encode(), m.param_value, m.param_type, 1, 0))
        elif kind == "PARAM_REQUEST_READ" and self.profile is not None:
            self.say(mavlink.MAVLink_param_value_message(m.param_id.encode(), self.profile, 9, 1, 0))
        elif kind == "PARAM_EXT_REQUEST_READ":
            self.asked_name += m.param_id == "BOAT_NAME"
            value = {"BOAT_NAME": self.name, "BOAT_RUN": self.run, "BOAT_SIZE": self.size}[m.param_id]
            if value:
                self.say(mavlink.MAVLink_param_ext_value_message(m.param_id.encode(), value.encode(), 11, 2, 0))
        elif kind == "TIMESYNC":
            self.say(mavlink.MAVLink_timesync_message(round(self.clock.monotonic_s() * 1e9) + 1, m.ts1))
        elif kind.startswith("MISSION_"):
            self._mission(kind, m)

    def _tell_modes(self) -> None:
        self.asked_modes += 1
        if not self.modes:
            unsupported = mavlink.MAV_RESULT_UNSUPPORTED
            self.say(mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_REQUEST_MESSAGE, unsupported))
        for place, (number, name) in enumerate(self.modes, 1):
            self.say(mavlink.MAVLink_available_modes_message(len(self.modes), place, 0, number, 0, name))

    def _command(self, m: Any) -> None:
        if m.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            if m.param1 == mavlink.MAVLINK_MSG_ID_HOME_POSITION:
                place = *self.position, 0, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0]
                self.say(mavlink.MAVLink_home_position_message(*place, 0.0, 0.0, 0.0))
                return
            if m.param1 == mavlink.MAVLINK_MSG_ID_AVAILABLE_MODES:
                self._tell_modes()
                return
            assert m.param1 == ownorders.EXTENSION
            self.say(*(ownorders.told(place, each, len(self.offers)) for place, each in enumerate(self.offers, 1)))
            return
        self.obeyed.append((m.command, m.param1, m.param2))
        if m.command == mavlink.MAV_CMD_DO_SET_MODE:
            self.mode = int(m.param2)
        self.say(mavlink.MAVLink_command_ack_message(m.command, mavlink.MAV_RESULT_ACCEPTED), self._heartbeat())

    def _own_order(self, m: Any) -> None:
        """In the boat's own words, as a boat does: obeyed once, answered each time."""
        if m.message_type != ownorders.ORDER or self.is_older:
            return
        number, line = ownorders.numbered(m)
        if number not in self._answers:
            words = json.loads(line)
            self._answers[number] = self.refuse or ""
            if self.refuse is None:
                self.obeyed.append(words)
                mode = words.get("mode") or console.KINDS[words["command"]].ENTERS
                self.mode = next((number for number, name in self._numbers() if name == mode), self.mode)
        self.say(ownorders.answer((m.get_srcSystem(), m.get_srcComponent()), number, self._answers[number]), self._heartbeat())

    def _numbers(self) -> list[tuple[int, str]]:
        """Of its modes."""
        return [
            *((mode.value, mode.name.lower()) for mode in Mode),
            *((n, name.decode().strip("\x07").lower()) for n, name in self.modes),
        ]

    def _heartbeat(self) -> Any:
        return mavlink.MAVLink_heartbeat_message(11, 0, 1 | (128 if self.mode != 4 else 0), self.mode, 4, 3)

    def _mission(self, kind: str, m: Any) -> None:
        gcs = 250, 190
        if kind == "MISSION_COUNT":
            self._incoming = m.mission_type, m.count, []
            self._ask(gcs)
        elif kind == "MISSION_ITEM_INT" and self._incoming is not None and m.mission_type == self._incoming[0]:
            if m.seq == len(self._incoming[2]):
                self._incoming[2].append(m)
            self._ask(gcs)  # once more, where what it said before was lost
        elif kind == "MISSION_REQUEST_LIST":
            self.say(mavlink.MAVLink_mission_count_message(*gcs, len(self.aboard[m.mission_type]), m.mission_type))
        elif kind == "MISSION_REQUEST_INT" and m.seq < len(self.aboard[m.mission_type]):
            item = self.aboard[m.mission_type][m.seq]
            words = item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z
            say = mavlink.MAVLink_mission_item_int_message(*gcs, m.seq, item.frame, item.command, 0, 1, *words, m.mission_type)
            self.say(say)

    def _ask(self, gcs: tuple[int, int]) -> None:
        assert self._incoming is not None
        kind, count, items = self._incoming
        if len(items) < count:
            self.say(mavlink.MAVLink_mission_request_int_message(*gcs, len(items), kind))
            return
        self.aboard[kind] = items
        self.say(mavlink.MAVLink_mission_ack_message(*gcs, mavlink.MAV_MISSION_ACCEPTED, kind))


class Radio:
    """A bad link, both ways, on a clock that is handed in: bytes a second, loss, duplicates, overtaking, outages, by seed."""

    def __init__(
        self,
        clock: ManualClock,
        seed: int = 1,
        *,
        bytes_per_s: float = 1e9,
        loss: float = 0.0,
        duplicates: float = 0.0,
        jitter_s: float = 0.0,
        outages: Callable[[float], bool] = lambda now_s: False,
    ) -> None:
        self.clock, self._random, self._bytes_per_s = clock, Random(seed), bytes_per_s
        self._loss, self._duplicates, self._jitter_s, self._outages = loss, duplicates, jitter_s, outages
        self._free_s = {0: 0.0, 1: 0.0}
        self._waiting: list[tuple[float, int, Callable[[bytes], None], bytes]] = []
        self._number = 0

    def carry(self, way: int, data: bytes, to: Callable[[bytes], None]) -> None:
        now_s = self.clock.monotonic_s()
        begin_s = max(now_s, self._free_s[way])
        if begin_s - now_s > 3.0:
            return  # the modem's buffer is full
        self._free_s[way] = begin_s + len(data) / self._bytes_per_s
        for _ in range(2 if self._random.random() < self._duplicates else 1):
            if self._random.random() >= self._loss and not self._outages(now_s):
                self._number += 1
                due_s = self._free_s[way] + 0.02 + self._random.random() * self._jitter_s
                self._waiting.append((due_s, self._number, to, data))

    def tick(self) -> None:
        now_s = self.clock.monotonic_s()
        due = sorted(each for each in self._waiting if each[0] <= now_s)
        self._waiting = [each for each in self._waiting if each[0] > now_s]
        for _, _, to, data in due:
            to(data)
