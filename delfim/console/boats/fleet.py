"""All boats, and every message to them: the state of the console. No socket and no clock in here.

The dead-man chain (docs/console.md): the page's input is passed on as it comes and never repeated; when none came for INPUT_S
the boat gets zero once, and then nothing, so that its own time-out counts. A boat or page that comes back moves nothing,
and neither does a console that slept: it refuses older messages of pages, but for stop.
"""

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, Final

from delfim.base.clock import Clock
from delfim.base.errors import FormatError, Refused
from delfim.base.modes import Mode
from delfim.console.boats.affording import EnergyAsks
from delfim.console.boats.boat import SILENT_S, Boat
from delfim.console.boats.depths import DepthGrid
from delfim.console.boats.drivers import INPUT_S, Drivers
from delfim.console.boats.item_transfer import REFUSED
from delfim.console.boats.plan_transfer import SAID, Exchange, planned
from delfim.console.boats.profiles import Profiles
from delfim.console.boats.questions import Questions
from delfim.console.boats.requests import HALTS, LIFE_S, NO_ANSWER, Answer, Requests, entered
from delfim.console.boats.routes import Address, Ways, address_kind, in_words
from delfim.console.boats.wayhome import ToldWay
from delfim.console.link.mavlink import (
    BOAT_NAME,
    BOAT_RUN,
    BOAT_SIZE,
    SYSTEM,
    TROUBLES,
    WAY_HOME,
    BoatQuestion,
    Codec,
    Key,
    mavlink,
    ownorders,
    questions,
)
from delfim.console.watch.alerts import is_trouble

HEARTBEAT_S: Final = 1.0
ASK_S: Final = 5.0  # between two requests for name, modes, profile and orders
ASKS: Final = 12  # for a minute: requests for name, modes, profile and orders
DEAF_S: Final = 1.0  # after a sleep messages of pages are refused for so long: a page must see that it was released
BOATS_MAX: Final = 32
SIGNED_MAX: Final = 199  # with a key nobody can invent boats: as many as there are numbers below those of consoles
PEERS_MAX: Final = 64
COMPLAIN_S: Final = 60.0
AUTOPILOT: Final = mavlink.MAV_COMP_ID_AUTOPILOT1
WARNING: Final = int(mavlink.MAV_SEVERITY_WARNING)
ANSWERS: Final = frozenset(
    ("COMMAND_ACK", "V2_EXTENSION", "PARAM_EXT_VALUE", "HOME_POSITION", "STATUSTEXT", *SAID)
)  # on any link
NOTE_MAX: Final = 100  # characters
REASON_S: Final = 0.5  # the refusal of a plan and its reason come in separate messages
Tell = Callable[[dict[str, Any]], None]


class Fleet:
    """`transmit` sends bytes to an address; `tell` informs the pages."""

    def __init__(
        self, clock: Clock, transmit: Callable[[Address, bytes], None], tell: Tell, key: Key | None = None, me: int = SYSTEM
    ) -> None:
        self.me = me  # the number of this console
        self.boats: dict[int, Boat] = {}
        self.depths = DepthGrid()
        self._exchange = Exchange(self._send, tell)
        self.missions = self._exchange.missions
        self.record: Callable[[bytes], None] = lambda frame: None  # every valid frame received, and every frame sent
        self.heard: Callable[[Boat, Any, float], None] = lambda boat, message, now_s: None  # each message, once it is taken
        self.troubles: Callable[[int, int], None] = lambda number, bits: None  # that a boat tells
        self.attended: Callable[[], bool] = lambda: True  # else no heartbeat: to a boat nobody is at this console
        self.sounded: Callable[[int, float, float, float], None] = lambda *told: None  # each depth: boat, place, degrees, and m
        self._clock, self._transmit, self._tell, self._key = clock, transmit, tell, key
        self._boats_max, self._peers_max = (BOATS_MAX, PEERS_MAX) if key is None else (SIGNED_MAX, 2 * SIGNED_MAX)
        self._peers: dict[Address, Codec] = {}
        self._ways = Ways()
        self._requests = Requests(self._send_on_each, self._send_all, self._rtt_s)
        self.is_busy = self._requests.wait_for  # whether an order to a boat is under way
        self.questions = Questions(self._send, self.is_busy)
        self._drivers = Drivers(self._send_on_each, self._say)
        self._ticked_s, self._deaf_until_s, self._slept_s = clock.monotonic_s(), -math.inf, 0.0
        self._beat_s = self._complained_s = -math.inf
        self._texts: dict[int, tuple[float, str]] = {}
        self._profiles = Profiles(self._send)
        self._homes = set[int]()  # boats that were asked where their way home ends
        self._energies = EnergyAsks(lambda number: self._ask_for(number, mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY))

    # Messages from the boats.

    def receive(self, address: Address, data: bytes) -> None:
        """Takes bytes of a link, as they come."""
        codec = self._peers.pop(address, None)
        if codec is None:
            if len(self._peers) >= self._peers_max:
                kept = set(self._ways.routes.values())
                del self._peers[next((each for each in self._peers if each not in kept), next(iter(self._peers)))]
            codec = Codec(self._key, stream=address_kind(address) == "serial", me=self.me)
        self._peers[address] = codec  # last in order: the first one was silent for longest and gives way
        for message in codec.decode(data):
            self.record(bytes(message.get_msgbuf()))
            self._take(address, message)
        doubt = codec.doubt or (codec.stranger if not self.boats else "")  # strangers alarm nobody who has a boat
        if doubt:
            self._complain(doubt, self._clock.monotonic_s())
        codec.doubt = codec.stranger = ""

    def _take(self, address: Address, message: Any) -> None:
        number, now_s = message.get_srcSystem(), self._clock.monotonic_s()
        if number == self.me:  # a boat may take one for the other
            where = in_words(address)
            words = f"a console on {where} has our number, {number}: start one of the two with another --number"
            self._complain(words, now_s)
        if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1 or number in (0, self.me):
            return
        if number not in self.boats:
            if message.get_type() not in ("HEARTBEAT", "HIGH_LATENCY2") or not self._has_room(now_s):
                return
            self.boats[number] = Boat(number, now_s)
            self._say(number, 6, "found")
        boat = self.boats[number]
        if not self._ways.hear(number, address, message, now_s):
            return
        if message.get_type() == "HEARTBEAT" and self._ways.are_idle(number, address, now_s):
            self._requests.idle(number, address, message.get_seq())
        if message.get_type() == "COMMAND_ACK":
            self._on_ack(boat, address, message)
        if address != self._ways.routes[number] and message.get_type() not in ANSWERS:
            return
        if message.get_type() == "STATUSTEXT" and not boat.words.is_new(message, address, now_s):
            return
        self._use_link(boat, now_s)
        boat.receive(message, now_s, self._utc_s())
        handler = _HANDLERS.get(message.get_type())
        if handler is not None:
            handler(self, boat, message, now_s)
        self.heard(boat, message, now_s)

    def _use_link(self, boat: Boat, now_s: float) -> None:
        """The best of its links from now on. The profile is one of each link."""
        if self._ways.choose(boat.number, now_s):
            self._profiles.ask(boat.number)
        route, way = self._ways.used(boat.number)
        boat.link, boat.reception, boat.rtt_ms = address_kind(route), way.reception, way.rtt_ms

    def _rtt_s(self, number: int) -> float:
        """Of the link that a boat uses; infinite where it is not known."""
        boat = self.boats.get(number)
        return math.inf if boat is None or boat.rtt_ms is None else boat.rtt_ms / 1e3

    def _has_room(self, now_s: float) -> bool:
        """Whether one more boat fits. A silent boat that is unsigned and that the operator never used gives way to it."""
        if len(self.boats) < self._boats_max:
            return True
        silent = [boat for boat in self.boats.values() if not (boat.used or boat.signed) and now_s - boat.heard_s > SILENT_S]
        if not silent:
            return False
        self._drop(min(silent, key=lambda boat: boat.heard_s).number)
        return True

    def forget(self, number: int) -> None:
        """Takes a silent boat out of the list, until it is heard again. Raises Refused."""
        boat = self.boat(number)
        if self._clock.monotonic_s() - boat.heard_s <= SILENT_S or self._requests.wait_for(number):
            raise Refused(f"{boat.name} is heard, or a command to it is under way")
        self._drop(number)

    def _drop(self, number: int) -> None:
        del self.boats[number]
        self._ways.forget(number)
        self.questions.forget(number)
        self._exchange.forget(number)
        self._drivers.end(number)
        self._profiles.forget(number)
        self._homes.discard(number)
        self._texts.pop(number, None)

    def _complain(self, words: str, now_s: float) -> None:
        """Warns of what is wrong on the link, on the pages."""
        if now_s - self._complained_s > COMPLAIN_S:
            self._complained_s = now_s
            self._tell({"t": "text", "boat": None, "severity": 2, "text": words, "at_s": self._utc_s(), "alarm": "console"})

    def _say(self, number: int, severity: int, text: str, alarm: str = "") -> None:
        """Shows a message about a boat on the pages. `alarm`: whose it is, the boat's or the console's, where it may be one."""
        told = {"t": "text", "boat": number, "severity": severity, "text": text, "at_s": self._utc_s()}
        self._tell(told | {"alarm": alarm} if alarm and severity <= WARNING else told)

    def _on_ack(self, boat: Boat, address: Address, message: Any) -> None:
        if message.result != mavlink.MAV_RESULT_IN_PROGRESS:
            accepted = message.result == mavlink.MAV_RESULT_ACCEPTED
            self._requests.acknowledged(boat.number, message.command, accepted, address, message.get_seq())

    def _on_own(self, boat: Boat, message: Any, now_s: float) -> None:
        """The answer to an order in the boat's own words, or an order that it offers."""
        if message.message_type == ownorders.ANSWER and message.target_system == self.me:
            number, refused = ownorders.numbered(message)
            self._requests.answered(boat.number, number, refused.decode("ascii", "replace"))
        elif message.message_type == questions.TOLD and message.target_system == self.me:
            with suppress(FormatError):
                self.questions.hear(boat.number, message)
        elif message.message_type == ownorders.OFFER:
            with suppress(FormatError):
                boat.learn_offer(*ownorders.offered(message))

    def _said(self, number: int) -> str:
        """What the boat said just now; empty: nothing."""
        said_s, text = self._texts.get(number, (-math.inf, ""))
        return text if self._clock.monotonic_s() - said_s < REASON_S else ""

    def _on_text(self, boat: Boat, message: Any, now_s: float) -> None:
        text = boat.words.hear(message)
        if text is None:
            return
        boat.reason, boat.reason_s = text, now_s
        if boat.failsafe.partition(" for ")[0] == text.partition(" for ")[0]:  # the same trouble, as long as it is now
            boat.failsafe = text
        self._texts[boat.number] = now_s, text
        boat.take_station(text)
        if text.partition(": ")[0] in boat.modes.values():
            boat.forced = text if message.severity <= mavlink.MAV_SEVERITY_ALERT else ""
        text = text.replace(f"console {self.me} commands", "this console commands")
        self._say(boat.number, message.severity, text, alarm="boat" if is_trouble(message.severity, text) else "")
        if message.severity <= mavlink.MAV_SEVERITY_WARNING:
            boat.warning = text

    def _on_param(self, boat: Boat, message: Any, now_s: float) -> None:
        self._profiles.hear(boat, message)

    def _on_name(self, boat: Boat, message: Any, now_s: float) -> None:
        if message.param_id == BOAT_NAME and boat.before:
            self.missions.get(boat.number, {}).pop("aboard", None)
            self._say(boat.number, 4, f"number {boat.number} is now {boat.name}: it was {boat.before}", "console")

    def _on_home(self, boat: Boat, message: Any, now_s: float) -> None:
        if boat.number in self._homes:
            self._homes.discard(boat.number)
            end = message.latitude / 1e7, message.longitude / 1e7
            boat.told_way = ToldWay(*end)
            self._tell({"t": "way_home", "boat": boat.number, **boat.heard_track.way_home(*end)})

    def _on_array(self, boat: Boat, message: Any, now_s: float) -> None:
        if message.name.rstrip("\0") != WAY_HOME:
            self._energies.hear(boat.number, boat.energy)
        elif boat.told_way is not None and (way := boat.told_way.hear(message.array_id, message.data)) is not None:
            self._tell({"t": "way_home", "boat": boat.number, **way})

    def _on_depth(self, boat: Boat, message: Any, now_s: float) -> None:
        told = message.lat / 1e7, message.lng / 1e7, message.distance
        if self.depths.add(*told):
            self.sounded(boat.number, *told)

    def _on_mission(self, boat: Boat, message: Any, now_s: float) -> None:
        self._exchange.receive(boat, message, now_s)

    # Timed work.

    def tick(self) -> None:
        """Due ten times a second or more."""
        now_s = self._clock.monotonic_s()
        if now_s - self._ticked_s > INPUT_S:  # messages of pages are old by now, and the pages must know
            self._slept_s, self._deaf_until_s = now_s - self._ticked_s, now_s + DEAF_S
            self.release_all("the console's computer slept")
        self._ticked_s = now_s
        if now_s - self._beat_s >= HEARTBEAT_S and self.attended():
            self._beat_s = now_s
            for number in self.boats:
                words = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
                self._send_on_each(number, mavlink.MAVLink_heartbeat_message(*words, 3))
        for boat in self.boats.values():
            self._use_link(boat, now_s)
            for address in self._ways.to_sync(boat.number, now_s):
                self._put(address, mavlink.MAVLink_timesync_message(0, round(now_s * 1e9)))
            if now_s - boat.synced_s >= ASK_S:
                boat.synced_s = now_s
                self._ask_once(boat)
            self._exchange.read(boat, now_s)
            self._look_for_twins(boat, now_s)
        for number, address in self._ways.to_ask(now_s):
            self._put(address, mavlink.MAVLink_param_ext_request_read_message(number, AUTOPILOT, BOAT_RUN.encode(), -1))
        for number in self._drivers.late(now_s):
            self.release(number, "no input from the page")
        self._requests.tick(now_s)
        self.questions.tick(now_s)
        self._profiles.tick(now_s)
        self._exchange.tick(now_s)
        self._energies.tick(now_s)

    def _look_for_twins(self, boat: Boat, now_s: float) -> None:
        twins = [in_words(each) for each in self._ways.twins(boat.number, now_s)]
        if twins and sorted(twins) != sorted(boat.twins):
            words = f"{len(twins)} boats have the number {boat.number}: {' and '.join(twins)}; STOP goes to all of them"
            self._say(boat.number, 1, words, "console")
        boat.twins = twins

    def _ask_once(self, boat: Boat) -> None:
        """Asks for name, size, profile, modes and orders until they are known, up to ASKS times."""
        boat.asks += 1
        if boat.asks > ASKS:
            return
        if not boat.profile:
            self._profiles.ask(boat.number)
        if not boat.is_named:
            self.ask_text(boat.number, BOAT_NAME)
        if boat.size is None:
            self.ask_text(boat.number, BOAT_SIZE)
        modes = mavlink.MAVLINK_MSG_ID_AVAILABLE_MODES, boat.has_told_modes
        for listed, is_known in (modes, (ownorders.EXTENSION, boat.has_told_orders)):
            if not is_known:
                self._ask_for(boat.number, listed)

    def snapshot(self) -> list[dict[str, Any]]:
        """All boats for the page, in order of their numbers."""
        now_s = self._clock.monotonic_s()
        for number, boat in self.boats.items():
            boat.links = self._ways.shown(number, now_s)
        return [
            boat.snapshot(now_s)
            | {"owner": boat.commander in (0, self.me), "driver": self._drivers.page_of(number)}
            | planned(boat, self.missions.get(number, {}))
            for number, boat in sorted(self.boats.items())
        ]

    # Requests of the operator.

    def note(self, number: int | None, text: str) -> None:
        """Has a boat, or all of them (None), put these words into its log."""
        for each in self.boats if number is None else self.boats.keys() & {number}:
            with suppress(Refused):
                self.questions.ask(each, BoatQuestion("note", text=text[:NOTE_MAX]), lambda row: None)

    def command(self, number: int, word: str, words: dict[str, Any], answer: Answer, page: int = 0) -> None:
        """Sends a command of this page. Raises Refused if it cannot be sent; otherwise calls `answer` once, with the boat's
        answer or at the end of the wait."""
        boat, now_s = self._use(number), self._clock.monotonic_s()
        mode = entered(word, words)
        if mode == "idle" and word not in HALTS:
            word, words = "stop", {}
        if self._asleep_s(now_s) > LIFE_S and word not in HALTS:
            raise Refused("the console's computer slept: give the command again")
        if word == "profile":
            self._profiles.choose(number, words["profile"], answer, now_s)
            return

        def answered(well: bool, why: str) -> None:
            if not well and mode and (boat.asked, boat.asked_s) == (mode, now_s):  # nothing newer was asked for
                boat.asked = None
            if why == NO_ANSWER and word not in HALTS and not boat.has_told_orders:
                why = f"{why}; its program may be older than this console: it takes stop and kill alone"
            answer(well, why)

        self._requests.begin(number, word, words, answered, now_s)
        if mode == Mode.MANUAL.name.lower():
            self._drivers.begin(boat, page)
        else:
            self._drivers.end(number)
        if mode:
            boat.asked, boat.asked_s = mode, now_s
        boat.released = False

    def input(self, number: int, count: int, port_pct: float, starboard_pct: float, page: int = 0) -> None:
        """Sends thrust that this page gives to a boat in manual at once, if no other page drives it."""
        boat, now_s = self._use(number), self._clock.monotonic_s()
        if self._asleep_s(now_s) <= INPUT_S:
            self._drivers.input(boat, page, count, port_pct, starboard_pct, now_s)

    def _asleep_s(self, now_s: float) -> float:
        """How long this computer slept, if it has just woken up: a page's message may be that old."""
        return self._slept_s if now_s < self._deaf_until_s else now_s - self._ticked_s

    def release(self, number: int, why: str, page: int | None = None) -> None:
        """Ends thrust by hand, if it is this page's (None: anyone's): zero once, then silence."""
        if number in self.boats and page in (None, self._drivers.page_of(number)):
            self._drivers.release(self.boats[number], why)

    def release_all(self, why: str, page: int | None = None) -> None:
        for number in self._drivers.driven():
            self.release(number, why, page)

    def put(self, number: int, mission: dict[str, Any]) -> None:
        """Takes the plan on the screen for a boat. Raises FormatError, Refused."""
        boat = self.boat(number)
        self._exchange.put(number, mission)
        boat.used = True

    def upload(self, number: int, answer: Answer) -> None:
        """Sends the plan on the screen to the boat, and reads it back; a boat that refuses it has said why. Raises Refused."""

        def ended(well: bool, why: str) -> None:
            answer(well, (self._said(number) if why.startswith(REFUSED) else "") or why)

        self._exchange.upload(self.boat(number), ended)

    def download(self, number: int, answer: Answer) -> None:
        """Reads the mission aboard. Raises Refused."""
        self._exchange.download(self.boat(number), answer)

    def ask_home(self, number: int) -> None:
        """Asks where the boat's way home ends; the pages are told the way when it answers. Raises Refused."""
        self._homes.add(self.boat(number).number)
        self._ask_for(number, mavlink.MAVLINK_MSG_ID_HOME_POSITION)

    def afford(self, number: int, answer: Answer) -> None:
        """Asks the boat whether the mission aboard fits the energy that is left; where it tells neither, it does. Raises
        Refused."""
        if not self.boat(number).energy:
            return answer(True, "")
        return self._energies.begin(number, answer, self._clock.monotonic_s())

    def _ask_for(self, number: int, message: int) -> None:
        """Asks a boat for a message that it tells when it is asked."""
        its = message, *(0.0,) * 6
        self._send(number, mavlink.MAVLink_command_long_message(number, AUTOPILOT, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, *its))

    def ask_text(self, number: int, name: str) -> None:
        """Asks a boat for one of its texts."""
        self._send(number, mavlink.MAVLink_param_ext_request_read_message(number, AUTOPILOT, name.encode(), -1))

    def often(self, number: int, kinds: Iterable[int], every_us: int) -> None:
        """Asks a boat to tell these messages so often; 0: as its profile has it."""
        for kind in kinds:
            words = number, AUTOPILOT, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, kind, every_us, *(0,) * 5
            self._send(number, mavlink.MAVLink_command_long_message(*words))

    def progress(self) -> list[dict[str, Any]]:
        """The progress of mission transfers."""
        return self._exchange.progress()

    def _use(self, number: int) -> Boat:
        """The boat, marked as used by the operator. Raises Refused."""
        boat = self.boat(number)
        boat.used = True
        return boat

    def boat(self, number: int) -> Boat:
        if number not in self.boats:
            raise Refused(f"no boat {number}")
        return self.boats[number]

    def address(self, number: int) -> Address:
        """Where a boat is heard from, on the link in use."""
        return self._ways.routes[number]

    def _send(self, number: int, message: Any) -> None:
        if number in self._ways.routes:
            self._put(self._ways.routes[number], message)

    def _send_on_each(self, number: int, message: Any) -> None:
        """Sends on every link to the boat: whichever is faster brings it, and the boat knows what comes again. So nothing is
        lost with a link that fails, and nobody has to notice first."""
        for address in self._ways.links(number, self._clock.monotonic_s()):
            self._put(address, message)

    def _send_all(self, number: int, message: Any) -> None:
        """Sends also to other boats that use this number."""
        for address in self._ways.to_stop(number, self._clock.monotonic_s()):
            self._put(address, message)

    def _put(self, address: Address, message: Any) -> None:
        codec = self._peers.get(address)
        if codec is not None:
            data = codec.encode(message)
            self.record(data)
            self._transmit(address, data)

    def _utc_s(self) -> float:
        return round(self._clock.time_ns() / 1e9, 3)


_HANDLERS: Final[dict[str, Callable[[Fleet, Boat, Any, float], None]]] = {
    "V2_EXTENSION": Fleet._on_own,
    "STATUSTEXT": Fleet._on_text,
    "PARAM_VALUE": Fleet._on_param,
    "PARAM_EXT_VALUE": Fleet._on_name,
    "HOME_POSITION": Fleet._on_home,
    "WATER_DEPTH": Fleet._on_depth,
    "DEBUG_FLOAT_ARRAY": Fleet._on_array,
    "NAMED_VALUE_INT": lambda fleet, boat, m, _: fleet.troubles(boat.number, m.value) if m.name == TROUBLES else None,
    **dict.fromkeys(SAID, Fleet._on_mission),
}
