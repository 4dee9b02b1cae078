"""News in words to every console: changes of mode, troubles, changes of command, waypoints reached."""

import math
from typing import Final

from delfim.base.modes import Mode
from delfim.parts.mavlink.codec.plans import command_name
from delfim.parts.mavlink.codec.wire import Address, Speaker, dialect
from delfim.parts.mavlink.missions import Missions
from delfim.parts.mavlink.peers import Peers
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.state import HANDSET, Notice, State

TOLD_AGAIN_S: Final = 2.0  # earliest repetition of a lasting trouble
LASTING_S: Final = 10.0  # a younger trouble is told again soon, if it lasts


def _shown(state: State) -> str:
    """The mode and why. That of a payload program has its name, and where there is no other reason says what the boat does."""
    mode, whose = state.mode.name.lower(), f"payload {state.helmsman}" if state.helmsman else ""
    return f"{whose or mode}: {mode if state.reason == whose else state.reason}"


def _severity(state: State) -> int:
    """Of a mode: one that the boat entered by itself is an alert."""
    calm = state.reason.startswith(("operator", "payload")) or state.reason.endswith(" done") or state.reason == "started"
    return int(dialect.MAV_SEVERITY_NOTICE if calm else dialect.MAV_SEVERITY_ALERT)


def _gravity(notice: Notice) -> int:
    return int(dialect.MAV_SEVERITY_WARNING if notice.action == "warn" else dialect.MAV_SEVERITY_CRITICAL)


class News:
    """Remembers the last news, and tells the changes."""

    def __init__(self, boat: VehicleLoop, peers: Peers, missions: Missions) -> None:
        self._boat, self._peers, self._missions = boat, peers, missions
        self._said: tuple[str, str, tuple[tuple[str, str], ...], str, str] | None = None
        self._told: dict[tuple[str, str], tuple[str, float]] = {}  # by trouble and action: the last text, and when it was told
        self._leg_now: tuple[int, int] = 0, 0  # the number of the plan, and its leg
        self._met_s: dict[Address, float] = {}  # when consoles that are present were told why, and all troubles
        self._announced = self._line = 0
        self._station = ""
        self._ordered: tuple[str, float, float] | None = None

    def tell(self, commander: Speaker | None) -> None:
        """Changes of mode and troubles, in words, and a heartbeat at once when the mode changed."""
        self._tell_reached()
        self._tell_actions()
        self._tell_line()
        self._tell_station()
        self._tell_order()
        state, say = self._boat.state, self._peers.say
        troubles = tuple((notice.name, notice.action) for notice in state.notices)
        console = commander.name if commander is not None else "no console"
        said = _shown(state), state.reason, troubles, HANDSET if state.operator == HANDSET else console, state.namesakes
        was, self._said = self._said or said, said
        self._tell_newcomers()
        if was[:2] != said[:2]:
            say(_severity(state), said[0])
        self._tell_troubles()
        if was[3] != said[3]:
            say(dialect.MAV_SEVERITY_NOTICE, f"{said[3]} commands")
        if state.namesakes and was[4] != state.namesakes:
            say(dialect.MAV_SEVERITY_ALERT, state.namesakes)
        if was != said:
            self._peers.hurry(dialect.MAVLINK_MSG_ID_HEARTBEAT, dialect.MAVLINK_MSG_ID_NAMED_VALUE_INT)

    def meet(self, address: Address) -> None:
        """A console that was known there has begun anew."""
        if self._boat.clock.monotonic_s() - self._met_s.get(address, math.inf) > TOLD_AGAIN_S:
            del self._met_s[address]

    def _tell_newcomers(self) -> None:
        """A console that starts later, or was not heard for long, has missed why the boat is in its mode, and its troubles."""
        present, now_s = self._peers.present(), self._boat.clock.monotonic_s()
        newcomers = [peer for peer in present if peer.address not in self._met_s]
        self._met_s = {peer.address: self._met_s.get(peer.address, now_s) for peer in present}
        state, say = self._boat.state, self._peers.say
        if newcomers and _severity(state) == dialect.MAV_SEVERITY_ALERT:
            say(dialect.MAV_SEVERITY_ALERT, _shown(state), newcomers)
        for notice in (each for each in state.notices if newcomers and now_s - each.since_s > LASTING_S):
            say(_gravity(notice), f"{notice.reason}: {notice.action}", newcomers)

    def _tell_order(self) -> None:
        """For whom the boat leaves its way, how, and that it is back."""
        order = self._boat.state.traffic.order
        now = (order.key, round(order.course_rad, 1), order.speed_part) if order is not None else None
        if now != self._ordered:
            self._ordered = now
            words = order.words if order is not None else "clear of traffic: back to the way"
            self._peers.say(dialect.MAV_SEVERITY_NOTICE, words)
            self._peers.hurry(dialect.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT)

    def _tell_troubles(self) -> None:
        """Tell each trouble when it begins or its action changes, and again when it has lasted twice as long: a screen must
        not show "for 1.0 s" after a minute."""
        now_s, told, self._told = self._boat.clock.monotonic_s(), self._told, {}
        for notice in self._boat.state.notices:
            trouble = notice.name, notice.action
            words, at_s = told.get(trouble, ("", -math.inf))
            if notice.reason != words and now_s - at_s >= max(at_s - notice.since_s, TOLD_AGAIN_S):
                self._peers.say(_gravity(notice), f"{notice.reason}: {notice.action}")
                words, at_s = notice.reason, now_s
            self._told[trouble] = words, at_s

    def _tell_actions(self) -> None:
        """Items for payloads that the boat has come to."""
        for action in self._boat.state.announced:
            if action.number > self._announced:
                self._announced = action.number
                words = " ".join("-" if each is None else f"{each:g}" for each in action.params)
                self._peers.say(dialect.MAV_SEVERITY_INFO, f"{command_name(action.command)}: {words}")

    def _tell_line(self) -> None:
        """Tell the line of a survey as soon as it begins or ends."""
        was, self._line = self._line, self._boat.state.reference.line
        if was != self._line:
            self._peers.hurry(dialect.MAVLINK_MSG_ID_NAMED_VALUE_INT)

    def _tell_station(self) -> None:
        """A sample that is asked for, taken, or given up."""
        was, self._station = self._station, self._boat.state.station
        if was != self._station:
            is_none = ": no sample: " in self._station
            self._peers.say(dialect.MAV_SEVERITY_WARNING if is_none else dialect.MAV_SEVERITY_INFO, self._station)

    def _tell_reached(self) -> None:
        """The boat reached a waypoint of the mission: tell its item to everybody."""
        state = self._boat.state
        plan = state.setpoint.plan if state.mode is Mode.PLAY else None
        was, self._leg_now = self._leg_now, (plan.number, state.reference.leg) if plan is not None else (0, 0)
        done = state.reason.startswith("play done") and was[0] > 0
        if done or (was[0] == self._leg_now[0] > 0 and self._leg_now[1] > was[1]):
            self._peers.tell_all([dialect.MAVLink_mission_item_reached_message(self._missions.number(was[1]))])
