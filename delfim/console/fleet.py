"""All boats, and everything that is said to them: the truth of the console. No socket and no clock in here.

The dead-man chain (docs/console.md): the page's input is passed on as it comes and never repeated; when none came for INPUT_S
the boat is told zero once, and then nothing, so that its own time-out counts. A boat or page that comes back moves nothing,
and neither does a console that slept: what pages said before or meanwhile is refused, but for stop.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

from delfim.clock import Clock
from delfim.console import transfer
from delfim.console.boats import Boat
from delfim.console.mavlink import MODES, Codec, Key, mavlink
from delfim.console.requests import LIFE_S, REPEAT_S, Answer, Requests
from delfim.console.transfer import Download, Item, Upload
from delfim.errors import FormatError, Refused

HEARTBEAT_S: Final = 1.0
TIMESYNC_S: Final = 5.0
INPUT_S: Final = 0.6
DEAF_S: Final = 1.0  # after a sleep, to what pages say: so long a page has to see that it was released
BOATS_MAX: Final = 32
PEERS_MAX: Final = 64
AUTOPILOT: Final = mavlink.MAV_COMP_ID_AUTOPILOT1
UNUSED: Final = 32767  # of an axis in MANUAL_CONTROL
REQUEST_CONTROL: Final = 32100  # MAV_CMD_REQUEST_OPERATOR_CONTROL
PROFILES: Final = ("lean", "radio", "wifi")  # values of the parameter that chooses
PROFILE: Final = b"LINK_PROFILE"
REASON_S: Final = 0.5  # a refusal and its reason come apart
NO_MISSION: Final[dict[str, Any]] = {"name": "", "count": 0, "current": None, "state": "none", "digest": None}
ENTERS: Final = {"stop": "idle", "heading_to": "heading", "goto_point": "goto"}  # words beside the modes' own
Address = Any  # of a link; hashable
Tell = Callable[[dict[str, Any]], None]


class Profile(NamedTuple):
    """A link profile that was asked for and not yet confirmed."""

    name: str
    answer: Answer
    begun_s: float
    due_s: float


def planned(boat: Boat, missions: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What the page shows of the missions of a boat: the one that is "here", and the one that was read from "aboard"."""
    here, aboard = missions.get("here"), missions.get("aboard")
    shown = aboard or here
    if shown is None:
        return {"mission": NO_MISSION | {"state": "unknown"}, "home": None, "fence": [], "obstacles": []}
    same = here is not None and aboard is not None and transfer.digest(here) == transfer.digest(aboard)
    state = "unknown" if aboard is None else "same" if same or here is None else "differs"
    told = {"name": shown["name"], "count": len(shown["waypoints"]), "digest": transfer.digest(shown), "state": state}
    item = boat.reference.get("leg")
    told["current"] = transfer.waypoint_of(shown, item) if item is not None else None
    return {"mission": told, **{key: shown.get(key) for key in ("home", "fence", "obstacles")}}


class Fleet:
    """`transmit` puts bytes on the way to an address; `tell` speaks to the pages."""

    def __init__(self, clock: Clock, transmit: Callable[[Address, bytes], None], tell: Tell, key: Key | None = None) -> None:
        self.boats: dict[int, Boat] = {}
        self.missions: dict[int, dict[str, dict[str, Any]]] = {}  # by boat: "here" and "aboard"
        self.record: Callable[[bytes], None] = lambda frame: None  # every frame that came well or went
        self._clock, self._transmit, self._tell, self._key = clock, transmit, tell, key
        self._peers: dict[Address, Codec] = {}
        self._routes: dict[int, Address] = {}
        self._requests = Requests(self._send)
        self._inputs: dict[int, tuple[int, float]] = {}  # by boat in manual: number and time of the last input
        self._ticked_s, self._deaf_until_s, self._slept_s = clock.monotonic_s(), -math.inf, 0.0
        self._transfers: dict[int, Upload | Download] = {}
        self._beat_s = -math.inf
        self._texts: dict[int, tuple[float, str]] = {}
        self._refused: dict[int, tuple[float, int, int]] = {}  # by boat: until when the reason is waited for, command, result
        self._profiles: dict[int, Profile] = {}

    # What comes from the boats.

    def receive(self, address: Address, data: bytes) -> None:
        """Bytes of a link, as they come."""
        codec = self._peers.get(address)
        if codec is None:
            if len(self._peers) >= PEERS_MAX:
                self._peers.pop(next(iter(self._peers)))
            codec = self._peers[address] = Codec(self._key, stream=address_kind(address) == "serial")
        for message in codec.decode(data):
            self.record(bytes(message.get_msgbuf()))
            self._take(address, message)

    def _take(self, address: Address, message: Any) -> None:
        number, now_s = message.get_srcSystem(), self._clock.monotonic_s()
        if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1 or not number:
            return
        boat = self.boats.get(number)
        if boat is None:
            if message.get_type() not in ("HEARTBEAT", "HIGH_LATENCY2") or len(self.boats) >= BOATS_MAX:
                return
            boat = self.boats[number] = Boat(number, now_s)
            self._tell({"t": "text", "boat": number, "severity": 6, "text": "found", "at_s": self._utc_s()})
        self._routes[number], boat.link = address, address_kind(address)
        boat.receive(message, now_s, self._utc_s())
        handler = _HANDLERS.get(message.get_type())
        if handler is not None:
            handler(self, boat, message, now_s)

    def _on_ack(self, boat: Boat, message: Any, now_s: float) -> None:
        said_s, text = self._texts.get(boat.number, (-math.inf, ""))
        reason = text if now_s - said_s < REASON_S else ""
        fine = message.result in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)
        if fine or reason:
            self._requests.acknowledged(boat.number, message.command, message.result, reason)
        else:
            self._refused[boat.number] = now_s + REASON_S, message.command, message.result

    def _on_text(self, boat: Boat, message: Any, now_s: float) -> None:
        text = boat.words.hear(message)
        if text is None:
            return
        boat.reason = text
        self._texts[boat.number] = now_s, text
        self._tell({"t": "text", "boat": boat.number, "severity": message.severity, "text": text, "at_s": self._utc_s()})
        if message.severity <= mavlink.MAV_SEVERITY_WARNING:
            self._give_reason(boat.number, text)

    def _give_reason(self, number: int, text: str) -> None:
        """Of what the boat refused just now."""
        if number in self._refused:
            _, command, result = self._refused.pop(number)
            self._requests.acknowledged(number, command, result, text)

    def _on_param(self, boat: Boat, message: Any, now_s: float) -> None:
        chosen = self._profiles.get(boat.number)
        if message.param_id != PROFILE.decode() or message.param_value not in range(len(PROFILES)):
            return
        boat.profile = PROFILES[int(message.param_value)]
        if chosen is not None:
            del self._profiles[boat.number]
            chosen.answer(
                boat.profile == chosen.name, "" if boat.profile == chosen.name else f"the boat stays with {boat.profile}"
            )

    def _on_sync(self, boat: Boat, message: Any, now_s: float) -> None:
        if message.tc1:
            boat.rtt_ms = round(now_s * 1e3 - message.ts1 / 1e6, 1)

    def _on_mission(self, boat: Boat, message: Any, now_s: float) -> None:
        under_way = self._transfers.get(boat.number)
        if under_way is not None and message.mission_type == under_way.kind:
            wanted = ("MISSION_COUNT", "MISSION_ITEM_INT") if isinstance(under_way, Download) else _ASKED
            if message.get_type() in (*wanted, "MISSION_ACK"):
                under_way.receive(message, now_s)

    # What time brings.

    def tick(self) -> None:
        """Due ten times a second or more."""
        now_s = self._clock.monotonic_s()
        if now_s - self._ticked_s > INPUT_S:  # what pages said meanwhile is old, and they are to learn of it
            self._slept_s, self._deaf_until_s = now_s - self._ticked_s, now_s + DEAF_S
            self.release_all("the console slept")
        self._ticked_s = now_s
        if now_s - self._beat_s >= HEARTBEAT_S:
            self._beat_s = now_s
            for number in self._routes:
                words = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
                self._send(number, mavlink.MAVLink_heartbeat_message(*words, 3))
        for boat in self.boats.values():
            if now_s - boat.synced_s >= TIMESYNC_S:
                boat.synced_s = now_s
                self._send(boat.number, mavlink.MAVLink_timesync_message(0, round(now_s * 1e9)))
        for number, (_, heard_s) in list(self._inputs.items()):
            if now_s - heard_s > INPUT_S:
                self.release(number, "no input from the page")
        self._requests.tick(now_s)
        for number, (until_s, *_) in list(self._refused.items()):
            if now_s >= until_s:
                self._give_reason(number, "")
        for number in list(self._profiles):
            self._choose(number, now_s)
        for each in list(self._transfers.values()):
            each.tick(now_s)

    def snapshot(self) -> list[dict[str, Any]]:
        """All boats for the page, in order of their numbers."""
        now_s = self._clock.monotonic_s()
        return [
            boat.snapshot(now_s) | planned(boat, self.missions.get(number, {})) for number, boat in sorted(self.boats.items())
        ]

    # What the operator wants.

    def command(self, number: int, word: str, words: dict[str, Any], answer: Answer) -> None:
        """A word of the page. Raises Refused for what cannot be asked; otherwise `answer` is called once, when the boat has
        answered or has not."""
        boat, now_s = self._boat(number), self._clock.monotonic_s()
        if self._asleep_s(now_s) > LIFE_S and ENTERS.get(word, word) != "idle":
            raise Refused("the console slept: say it again")
        if word != "manual":
            self._inputs.pop(number, None)
        if word == "profile":
            self._set_profile(boat, words["profile"], answer, now_s)
            return
        aboard = self.missions.get(number, {}).get("aboard")
        if word == "play" and aboard is not None:
            words = words | {"leg": transfer.item_of(aboard, int(words.get("leg") or 0))}
        command, parameters, place = _command(word, words)
        if word in MODES or word in ENTERS:
            boat.asked, boat.asked_s = ENTERS.get(word, word), now_s
        boat.released = False
        self._requests.begin(number, command, parameters, answer, now_s, place=place, stop=word == "stop")

    def input(self, number: int, count: int, port_pct: float, starboard_pct: float) -> None:
        """Thrust of a boat in manual, now. An input that was overtaken is ignored."""
        boat = self._boat(number)
        last, _ = self._inputs.get(number, (-1, 0.0))
        now_s = self._clock.monotonic_s()
        if self._asleep_s(now_s) > INPUT_S:
            return
        if count <= last or not (math.isfinite(port_pct) and math.isfinite(starboard_pct)):
            return
        self._inputs[number] = count, now_s
        boat.released = False
        self._thrust(number, port_pct, starboard_pct)

    def _asleep_s(self, now_s: float) -> float:
        """How long this computer slept, if it does or did just now: so old may be what is heard from a page."""
        return self._slept_s if now_s < self._deaf_until_s else now_s - self._ticked_s

    def release(self, number: int, why: str) -> None:
        """Nobody steers this boat any more: zero once, then silence."""
        if self._inputs.pop(number, None) is None:
            return
        self._thrust(number, 0.0, 0.0)
        if number in self.boats:
            self.boats[number].released = True
            self._tell({"t": "text", "boat": number, "severity": 4, "text": f"manual released: {why}", "at_s": self._utc_s()})

    def release_all(self, why: str) -> None:
        for number in list(self._inputs):
            self.release(number, why)

    def put(self, number: int, mission: dict[str, Any]) -> None:
        """The plan on the screen for a boat. Raises FormatError, Refused."""
        transfer.items_of(mission)
        self._boat(number)
        self.missions.setdefault(number, {})["here"] = mission

    def upload(self, number: int, answer: Answer) -> None:
        """The plan on the screen to the boat, and back again to compare. Raises Refused."""
        mission = self.missions.get(number, {}).get("here")
        if mission is None:
            raise Refused("there is no mission to send")
        self._begin_transfer(number)
        groups = transfer.items_of(mission)

        def next_kind(place: int) -> None:
            kind = transfer.ORDER[place]

            def ended(reason: str) -> None:
                self._transfers.pop(number, None)
                if reason:
                    self._over(number, "upload")
                    answer(False, reason)
                elif place + 1 < len(transfer.ORDER):
                    next_kind(place + 1)
                else:
                    self.download(number, lambda well, why: answer(*self._compared(number, well, why)))

            self._transfers[number] = Upload(number, kind, groups[kind], lambda m: self._send(number, m), ended)

        next_kind(0)

    def download(self, number: int, answer: Answer) -> None:
        """The mission that is on board. Raises Refused."""
        self._begin_transfer(number)
        groups: list[Sequence[Item]] = []

        def next_kind(kind: int) -> None:
            def ended(reason: str) -> None:
                done = self._transfers.pop(number)
                assert isinstance(done, Download)
                if reason:
                    self._over(number, "download")
                    answer(False, reason)
                    return
                groups.append(done.items)
                if kind + 1 < 3:
                    next_kind(kind + 1)
                else:
                    self._over(number, "download")
                    self._aboard(number, transfer.mission_of("aboard", groups))
                    answer(True, "")

            self._transfers[number] = Download(number, kind, lambda m: self._send(number, m), ended)

        next_kind(transfer.WAYPOINTS)

    def progress(self) -> list[dict[str, Any]]:
        """Of the transfers that are under way."""
        return [
            {"t": "progress", "boat": n, "what": type(each).__name__.lower(), "part": round((_done(each) + each.part) / 3, 3)}
            for n, each in self._transfers.items()
        ]

    def _begin_transfer(self, number: int) -> None:
        self._boat(number)
        if number in self._transfers:
            raise Refused("a mission is on its way already")

    def _over(self, number: int, what: str) -> None:
        """Nothing is under way any more, well or not."""
        self._tell({"t": "progress", "boat": number, "what": what, "part": 1.0})

    def _aboard(self, number: int, mission: dict[str, Any]) -> None:
        known = self.missions.setdefault(number, {})
        here = known.get("here")
        if here is not None and transfer.digest(here) == transfer.digest(mission):
            mission["name"] = here["name"]
        known["aboard"] = mission
        self._tell({"t": "mission", "boat": number, "where": "aboard", "mission": mission})

    def _compared(self, number: int, well: bool, why: str) -> tuple[bool, str]:
        if not well:
            return False, f"sent, but not read back: {why}"
        known = self.missions[number]
        same = transfer.digest(known["here"]) == transfer.digest(known["aboard"])
        return same, "" if same else "what the boat has differs from what was sent"

    def _boat(self, number: int) -> Boat:
        if number not in self.boats:
            raise Refused(f"no boat {number}")
        return self.boats[number]

    def _set_profile(self, boat: Boat, profile: str, answer: Answer, now_s: float) -> None:
        if profile not in PROFILES:
            raise FormatError(f"no profile {profile!r}: there are {', '.join(PROFILES)}")
        before = self._profiles.pop(boat.number, None)
        if before is not None:
            before.answer(False, "replaced by a newer choice")
        self._profiles[boat.number] = Profile(profile, answer, now_s, now_s)
        self._choose(boat.number, now_s)

    def _choose(self, number: int, now_s: float) -> None:
        """Say it, say it again, give it up."""
        chosen = self._profiles[number]
        if now_s - chosen.begun_s > LIFE_S:
            del self._profiles[number]
            chosen.answer(False, "no answer from the boat")
        elif now_s >= chosen.due_s:
            self._profiles[number] = chosen._replace(due_s=now_s + REPEAT_S)
            value, kind = float(PROFILES.index(chosen.name)), mavlink.MAV_PARAM_TYPE_REAL32
            self._send(number, mavlink.MAVLink_param_set_message(number, AUTOPILOT, PROFILE, value, kind))

    def _thrust(self, number: int, port_pct: float, starboard_pct: float) -> None:
        port, starboard = (max(-100.0, min(100.0, each)) for each in (port_pct, starboard_pct))
        x, r = round(5.0 * (port + starboard)), round(5.0 * (port - starboard))
        self._send(number, mavlink.MAVLink_manual_control_message(number, x, UNUSED, UNUSED, r, 0))

    def _send(self, number: int, message: Any) -> None:
        address = self._routes.get(number)
        codec = self._peers.get(address)
        if codec is not None:
            data = codec.encode(message)
            self.record(data)
            self._transmit(address, data)

    def _utc_s(self) -> float:
        return round(self._clock.time_ns() / 1e9, 3)


def _done(each: Upload | Download) -> int:
    """How many types of items are over before this one."""
    return transfer.ORDER.index(each.kind) if isinstance(each, Upload) else each.kind


def address_kind(address: Address) -> str:
    """Of which kind a link is: what its addresses begin with."""
    return address[0] if isinstance(address, tuple) else "udp"


def _command(word: str, words: dict[str, Any]) -> tuple[int, tuple[float, ...], tuple[int, int] | None]:
    """(MAV_CMD, parameters, place) of a word of the page. Raises FormatError."""
    try:
        match word:
            case "stop":
                return mavlink.MAV_CMD_DO_SET_MODE, (1.0, float(MODES["idle"])), None
            case "play":
                return mavlink.MAV_CMD_MISSION_START, (float(words.get("leg") or 0), 0.0), None
            case "heading_to":
                return mavlink.MAV_CMD_GUIDED_CHANGE_HEADING, (1.0, float(words["heading_deg"]) % 360.0, 0.0), None
            case "goto_point":
                place = round(float(words["latitude_deg"]) * 1e7), round(float(words["longitude_deg"]) * 1e7)
                return mavlink.MAV_CMD_DO_REPOSITION, (float(words.get("speed_mps", -1.0)), 1.0), place
            case "speed" if "speed_mps" in words:
                return mavlink.MAV_CMD_DO_CHANGE_SPEED, (1.0, float(words["speed_mps"]), -1.0), None
            case "speed":
                return mavlink.MAV_CMD_DO_CHANGE_SPEED, (1.0, -1.0, float(words["speed_pct"])), None
            case "arm" | "disarm":
                return mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (float(word == "arm"),), None
            case "reset":
                return mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (0.0, 0.0, 1.0, float(words.get("component", 0))), None
            case "take":
                return REQUEST_CONTROL, (float(words.get("console", 0)), 1.0, 1.0), None
            case _ if word in MODES:
                return mavlink.MAV_CMD_DO_SET_MODE, (1.0, float(MODES[word])), None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"{word}: {error}") from None
    raise FormatError(f"no command {word!r}")


_ASKED: Final = ("MISSION_REQUEST", "MISSION_REQUEST_INT")
_HANDLERS: Final[dict[str, Callable[[Fleet, Boat, Any, float], None]]] = {
    "COMMAND_ACK": Fleet._on_ack,
    "STATUSTEXT": Fleet._on_text,
    "PARAM_VALUE": Fleet._on_param,
    "TIMESYNC": Fleet._on_sync,
    **dict.fromkeys((*_ASKED, "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"), Fleet._on_mission),
}
