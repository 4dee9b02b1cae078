"""Handlers of the messages that consoles send, one a message, and their answers: docs/mavlink.md, "To the vehicle"."""

import math
from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple

from delfim.base.errors import FormatError, Refused
from delfim.parts.mavlink import telemetry
from delfim.parts.mavlink.codec import ownorders, params, questions
from delfim.parts.mavlink.codec.plans import ALL
from delfim.parts.mavlink.codec.wire import GUEST, Message, Speaker, dialect
from delfim.parts.mavlink.consoles import Consoles
from delfim.parts.mavlink.missions import KINDS
from delfim.parts.mavlink.peers import Peer
from delfim.parts.mavlink.received import commands, manual, othervessels
from delfim.parts.mavlink.received.commands import ACCEPTED, DENIED, LATER, UNSUPPORTED
from delfim.parts.mavlink.received.guided import guided
from delfim.parts.mavlink.received.questions import answer as questions_answer
from delfim.parts.mavlink.received.requests import ANSWERS
from delfim.parts.mavlink.telemetry import NEVER_S
from delfim.vehicle import console

ANSWERS_KEPT: Final = 64  # to orders in the boat's own words, for those that come again
AGAIN_S: Final = 10.0  # a command repeated within this time, because its answer was lost, gets the same answer
INTERVAL_MIN_S: Final = 0.1
NAK, UNKNOWN_COMMAND = 129, 7  # of MAVLink FTP


def _heartbeat(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    consoles.alive(source, peer.address)


def _command(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """COMMAND_LONG, COMMAND_INT: always answered; a repeated one is not carried out again, except a stop."""
    now_s, order = consoles.clock.monotonic_s(), commands.order(message)
    same, before = repr((source, order.command, order.p)), peer.answered
    if order.confirmation and before and before[0] == same and now_s - before[1] < AGAIN_S and not commands.stops(order):
        consoles.peers.tell(peer, [before[2]])
        return
    result, reason = _ordered(consoles, peer, source, order)
    answer = dialect.MAVLink_command_ack_message(order.command, result, 0xFF, 0, *source.party)
    if order.command not in _REQUESTS:
        peer.answered = same, now_s, answer
    if reason:  # before the answer, so that its reader knows why
        consoles.peers.say(dialect.MAV_SEVERITY_WARNING, reason)
    told = [telemetry.heartbeat(consoles.view())] if commands.stops(order) else []  # consoles wait for idle
    consoles.peers.tell(peer, [answer, *told])


def _ordered(consoles: Consoles, peer: Peer, source: Speaker, order: commands.Order) -> tuple[int, str | None]:
    """(MAV_RESULT, why not)"""
    own = _REQUESTS.get(order.command)
    if own is not None:
        return own(consoles, peer, source, order), None
    rows = (each.row for each in consoles.boat.helm.orders.values())
    of_part = {row.number: partial(commands.of_part, row) for row in rows}
    make = commands.COMMANDS.get(order.command) or of_part.get(order.command)
    if make is None:
        return UNSUPPORTED, None
    if order.target_system != consoles.system:
        return DENIED, "a command must address this vehicle"
    boat, guided_waits = consoles.boat, consoles.settings.autopilot == "ardurover"
    try:
        terms = commands.Terms(consoles.missions.leg, boat.state.mode, boat.helm.settings.helmsmen, guided_waits)
        refused = consoles.ask(source, make(order, terms))
    except FormatError as error:
        return DENIED, str(error)
    except Refused as error:
        return LATER, str(error)
    return (ACCEPTED, None) if refused is None else (LATER, refused)


def _own_order(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """V2_EXTENSION: an order in the boat's own words, or a question, always answered."""
    kind, answers = message.message_type, {ownorders.ORDER: _order_answer, questions.ASK: questions_answer}
    if kind not in answers or message.target_system != consoles.system:
        return
    answer = answers[kind](consoles, source, message)
    while len(consoles.answered) >= ANSWERS_KEPT:
        del consoles.answered[next(iter(consoles.answered))]
    consoles.answered[*source.party, ownorders.numbered(message)[0], kind] = answer
    consoles.peers.tell(peer, [answer])


def answer_late(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> bool:
    """Whether this is answered however late it comes: a question for the time, by which a console measures the link; an order
    whose number has come before, on whichever link. It gets the answer that it had, and is not obeyed again."""
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_TIMESYNC:
        _timesync(consoles, peer, source, message)
        return True
    if message.get_msgId() != ownorders.EXTENSION or message.message_type not in (ownorders.ORDER, questions.ASK):
        return False
    answer = consoles.answered.get((*source.party, ownorders.numbered(message)[0], message.message_type))
    if answer is None or message.target_system != consoles.system:
        return False
    consoles.peers.tell(peer, [answer])
    return True


def _order_answer(consoles: Consoles, source: Speaker, message: Message) -> Message:
    number, line = ownorders.numbered(message)
    try:
        reason = consoles.ask(source, console.parse_order(line))
    except FormatError as error:
        reason = str(error)
    if reason:
        consoles.peers.say(dialect.MAV_SEVERITY_WARNING, reason)
    return ownorders.answer(source.party, number, reason or "")


def _set_mode(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """SET_MODE of old programs: the heartbeat is its only answer."""
    if message.target_system == consoles.system:
        order = commands.Order(dialect.MAV_CMD_DO_SET_MODE, (message.base_mode, message.custom_mode, 0.0), consoles.system)
        _, reason = _ordered(consoles, peer, source, order)
        if reason:
            consoles.peers.say(dialect.MAV_SEVERITY_WARNING, reason)


def _set_current(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """MISSION_SET_CURRENT: the answer is MISSION_CURRENT."""
    order = commands.Order(dialect.MAV_CMD_DO_SET_MISSION_CURRENT, (float(message.seq),), message.target_system)
    _, reason = _ordered(consoles, peer, source, order)
    consoles.peers.tell(peer, list(telemetry.current(consoles.view())))
    if reason:
        consoles.peers.say(dialect.MAV_SEVERITY_WARNING, reason)


# Plans.


def _listed(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    consoles.missions.listed(_Line(consoles, peer, source), source, message)


def _requested(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    consoles.missions.requested(_Line(consoles, peer, source), source, message)


def _counted(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    if _may(consoles, peer, source, message):
        consoles.missions.counted(_Line(consoles, peer, source), source, message, consoles.clock.monotonic_s())


def _rewritten(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    if _may(consoles, peer, source, message):
        consoles.missions.rewritten(_Line(consoles, peer, source), source, message, consoles.clock.monotonic_s())


def _item(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    consoles.missions.item(_Line(consoles, peer, source), source, message, consoles.clock.monotonic_s())


def _clear(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    if _may(consoles, peer, source, message):
        consoles.missions.clear(_Line(consoles, peer, source), source, message)


def _old_item(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """MISSION_ITEM, MISSION_REQUEST_PARTIAL_LIST: refused, newer messages do the same."""
    unsupported = dialect.MAV_MISSION_UNSUPPORTED
    consoles.peers.tell(peer, [dialect.MAVLink_mission_ack_message(*source.party, unsupported, message.mission_type)])


def _may(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> bool:
    """Whether this console may change a plan; if not, it is told why."""
    reason = consoles.refusal(source) if message.target_system == consoles.system else "a plan must address this vehicle"
    if reason:
        consoles.peers.say(dialect.MAV_SEVERITY_WARNING, reason)
        denied = dialect.MAV_MISSION_DENIED
        consoles.peers.tell(peer, [dialect.MAVLink_mission_ack_message(*source.party, denied, message.mission_type)])
    return reason is None


# Parameters.


def _param_list(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    peer.params.clear()
    peer.params.extend(params.NAMES)


def _param_read(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    index = message.param_index
    name = params.named(message.param_id) if index < 0 else params.NAMES[index] if index < len(params.NAMES) else ""
    known = name in params.NAMES
    missing = dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST
    consoles.peers.tell(peer, [consoles.param(peer, name) if known else params.error(source.party, name, index, missing)])


def _param_set(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """The answer is the value in force; if that is not the requested one, a text says why."""
    name, number = params.named(message.param_id), message.param_value
    if name not in params.NAMES:
        consoles.peers.tell(peer, [params.error(source.party, name, -1, dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST)])
        return
    reason: str | None = None
    if name == params.PROFILE:
        if number in range(len(telemetry.PROFILES)):
            peer.profile = telemetry.PROFILES[int(number)]
            peer.asked_s.clear()
    elif message.target_system != consoles.system:
        reason = "a parameter must address this vehicle"
    else:
        try:
            reason = consoles.ask(source, params.command(name, number))
        except FormatError as error:
            reason = str(error)
    consoles.peers.tell(peer, [consoles.param(peer, name)])
    if reason:
        consoles.peers.tell(peer, [params.error(source.party, name, -1, dialect.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)])
        consoles.peers.say(dialect.MAV_SEVERITY_WARNING, reason)


def _text_list(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """PARAM_EXT_REQUEST_LIST"""
    texts = consoles.texts()
    consoles.peers.tell(peer, [params.text(texts, name) for name in texts])


def _text_read(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """PARAM_EXT_REQUEST_READ"""
    index = message.param_index
    texts = consoles.texts()
    name = [*texts][index] if 0 <= index < len(texts) else params.named(message.param_id)
    if name in texts:
        consoles.peers.tell(peer, [params.text(texts, name)])
    else:
        missing = dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST
        consoles.peers.tell(peer, [params.error(source.party, name, index, missing)])


# Requests.


def _ftp(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """FILE_TRANSFER_PROTOCOL: refused; `delfim log fetch` fetches files."""
    payload = [*message.payload]
    number = payload[0] + 256 * payload[1] + 1
    nak = [number & 0xFF, number >> 8 & 0xFF, payload[2], NAK, 1, payload[3], 0, 0, 0, 0, 0, 0, UNKNOWN_COMMAND]
    answer = dialect.MAVLink_file_transfer_protocol_message(0, *source.party, nak + [0] * (len(payload) - len(nak)))
    consoles.peers.tell(peer, [answer])


def _logs(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    consoles.peers.tell(peer, [dialect.MAVLink_log_entry_message(0, 0, 0, 0, 0)])


def _log(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """LOG_REQUEST_DATA: refused, because there is no such log."""
    consoles.peers.tell(peer, [dialect.MAVLink_log_data_message(message.id, message.ofs, 0, [0] * 90)])


def _ping(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    if message.target_system == 0:
        consoles.peers.tell(peer, [dialect.MAVLink_ping_message(message.time_usec, message.seq, *source.party)])


def _request(consoles: Consoles, peer: Peer, source: Speaker, order: commands.Order) -> int:
    """REQUEST_MESSAGE: once, after the answer."""
    number, index = (int(value) if math.isfinite(value) else -1 for value in order.p[:2])
    view = consoles.view()
    rows = [row for row in telemetry.ROWS if row.id == number]
    if number == dialect.MAVLINK_MSG_ID_MISSION_CHECKSUM and index in (*KINDS, ALL):
        known = consoles.missions.checksum(index)
        found = [] if known is None else [dialect.MAVLink_mission_checksum_message(index, known)]
    elif number == dialect.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
        found = [_interval_of(consoles, peer, index)]
    elif rows:
        found = list(rows[0].make(view))
    elif number in ANSWERS:
        found = list(ANSWERS[number](view, index))
        if number == dialect.MAVLINK_MSG_ID_AVAILABLE_MODES and index == 0:
            consoles.meet(peer)
    else:
        return UNSUPPORTED
    consoles.peers.tell(peer, found)
    return ACCEPTED if found else LATER


def _interval_of(consoles: Consoles, peer: Peer, number: int) -> Message:
    """MESSAGE_INTERVAL: -1 means not sent, 0 not known."""
    rows = [row for row in telemetry.ROWS if row.id == number]
    interval_us = round(peer.interval_s(rows[0]) * 1e6) or -1 if rows else 0
    return dialect.MAVLink_message_interval_message(number & 0xFFFF, interval_us)


def _corrections(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """GPS_RTCM_DATA: pieces of RTCM frames, which the receiver's end puts together and checks. The guest sends none."""
    if source.component == GUEST or consoles.correct is None:
        consoles.count("corrections_refused")
    else:
        taken = consoles.correct(bytes(message.data[: message.len]))
        consoles.count("corrections" if taken else "corrections_lost")


def _timesync(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    if message.tc1 == 0:
        consoles.peers.tell(peer, [dialect.MAVLink_timesync_message(consoles.clock.time_ns(), message.ts1)])


def _take(consoles: Consoles, peer: Peer, source: Speaker, order: commands.Order) -> int:
    if order.target_system != consoles.system:
        return DENIED
    if order.p[1]:
        refused = consoles.ask(source, console.Take())
        if refused:
            consoles.peers.say(dialect.MAV_SEVERITY_WARNING, refused)
        return ACCEPTED if refused is None else LATER
    consoles.give_up(source)
    return ACCEPTED


def _interval(consoles: Consoles, peer: Peer, source: Speaker, order: commands.Order) -> int:
    """SET_MESSAGE_INTERVAL, for this peer alone. 0: the interval of its profile; negative: not at all."""
    number, interval_us = order.p[:2]
    if number not in [row.id for row in telemetry.ROWS] or not math.isfinite(interval_us):
        return UNSUPPORTED
    if number == dialect.MAVLINK_MSG_ID_HEARTBEAT and not 0.0 <= interval_us <= 1e6:
        return DENIED
    if interval_us == 0.0:
        peer.asked_s.pop(int(number), None)
    else:
        peer.asked_s[int(number)] = NEVER_S if interval_us < 0.0 else max(interval_us / 1e6, INTERVAL_MIN_S)
    peer.due_s.pop(int(number), None)
    return ACCEPTED


def _high_latency(consoles: Consoles, peer: Peer, source: Speaker, order: commands.Order) -> int:
    if order.p[0] not in (0.0, 1.0):
        return DENIED
    peer.profile = "lean" if order.p[0] else "wifi" if consoles.settings.profile == "lean" else consoles.settings.profile
    return ACCEPTED


class _Line(NamedTuple):
    """One console, as seen by the mission protocol."""

    consoles: Consoles
    peer: Peer
    source: Speaker

    def tell(self, message: Message) -> None:
        self.consoles.peers.tell(self.peer, [message])

    def tell_all(self, message: Message) -> None:
        self.consoles.peers.tell_all([message])

    def ask(self, command: console.Commands, answer: Callable[[str | None], None]) -> None:
        self.consoles.propose(self.source, command, answer)

    def complain(self, text: str) -> None:
        self.consoles.peers.say(dialect.MAV_SEVERITY_WARNING, text)


MAV_CMD_REQUEST_OPERATOR_CONTROL: Final = 32100

_Request = Callable[[Consoles, Peer, Speaker, commands.Order], int]
_REQUESTS: Final[dict[int, _Request]] = {
    MAV_CMD_REQUEST_OPERATOR_CONTROL: _take,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: _interval,
    dialect.MAV_CMD_REQUEST_MESSAGE: _request,
    dialect.MAV_CMD_CONTROL_HIGH_LATENCY: _high_latency,
}
HANDLERS: Final[dict[int, Callable[[Consoles, Peer, Speaker, Message], None]]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    dialect.MAVLINK_MSG_ID_COMMAND_LONG: _command,
    dialect.MAVLINK_MSG_ID_COMMAND_INT: _command,
    dialect.MAVLINK_MSG_ID_V2_EXTENSION: _own_order,
    dialect.MAVLINK_MSG_ID_SET_MODE: _set_mode,
    dialect.MAVLINK_MSG_ID_MANUAL_CONTROL: manual.manual,
    dialect.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE: manual.channels,
    dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: guided,
    dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: guided,
    dialect.MAVLINK_MSG_ID_GPS_RTCM_DATA: _corrections,
    dialect.MAVLINK_MSG_ID_AIS_VESSEL: othervessels.vessel,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: othervessels.sister,
    dialect.MAVLINK_MSG_ID_OBSTACLE_DISTANCE: othervessels.obstacles,
    dialect.MAVLINK_MSG_ID_PING: _ping,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: _listed,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT: _requested,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST: _requested,
    dialect.MAVLINK_MSG_ID_MISSION_COUNT: _counted,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT: _item,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM: _old_item,
    dialect.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: _rewritten,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST_PARTIAL_LIST: _old_item,
    dialect.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: _clear,
    dialect.MAVLINK_MSG_ID_MISSION_SET_CURRENT: _set_current,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: _param_list,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: _param_read,
    dialect.MAVLINK_MSG_ID_PARAM_SET: _param_set,
    dialect.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_LIST: _text_list,
    dialect.MAVLINK_MSG_ID_PARAM_EXT_REQUEST_READ: _text_read,
    dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _ftp,
    dialect.MAVLINK_MSG_ID_LOG_REQUEST_LIST: _logs,
    dialect.MAVLINK_MSG_ID_LOG_REQUEST_DATA: _log,
}
ORDERS: Final = frozenset(  # what is obeyed at once, and must not be obeyed after what was said later
    {
        dialect.MAVLINK_MSG_ID_COMMAND_LONG,
        dialect.MAVLINK_MSG_ID_COMMAND_INT,
        dialect.MAVLINK_MSG_ID_V2_EXTENSION,
        dialect.MAVLINK_MSG_ID_SET_MODE,
        dialect.MAVLINK_MSG_ID_MISSION_SET_CURRENT,
        dialect.MAVLINK_MSG_ID_MANUAL_CONTROL,
        dialect.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE,
        dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
        dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    }
)
