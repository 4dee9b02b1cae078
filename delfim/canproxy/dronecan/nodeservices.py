"""Answers the requests of other nodes (specification, chapter 4.1): node information and restart, no others.

An identifier has 29 bits: priority 5, type 8, whether it is a request 1, destination 7, a one, source 7. An answer has the
number of its request. Both requests are of one frame.
"""

from typing import Final, NamedTuple

from delfim.base.frames import CAN_IDE, Frame, extended
from delfim.canproxy.dronecan.datatypes import NodeStatus
from delfim.canproxy.dronecan.fields import DataType, pack, unsigned
from delfim.canproxy.dronecan.transfers import END, NUMBER, SERVICE, START, TOGGLE, framed
from delfim.canproxy.socket import CanAddress

# The answers. GetNodeInfo: status; versions of program and computer; unique id; length of a certificate, which is none; name.
_STATUS: Final = tuple(map(unsigned, (32, 2, 3, 3, 16)))
_VERSIONS: Final = tuple(map(unsigned, (8, 8, 8, 32, 64, 8, 8)))
GET_NODE_INFO: Final = DataType("GetNodeInfo", 1, 0xD9A7, (*_STATUS, *_VERSIONS, *(unsigned(8),) * 17), (unsigned(8),), 80)
RESTART_NODE: Final = DataType("RestartNode", 5, 0x1F7F, (unsigned(1),))
ANSWERS_PER_S: Final = 10  # further requests are not answered: their tool asks again
STATUS_S: Final = 3.0  # a status that was heard longer ago is not the present one, by the specification
_REQUEST: Final = 0x8000  # in the identifier
_UNHEARD: Final = NodeStatus(0, 2, 1, 0)  # in error, starting


class Identity(NamedTuple):
    name: str  # up to 80 characters of ASCII
    version: tuple[int, int]
    unique_id: bytes  # 16


class NodeServices:
    """The answers of this node. `hear` takes its own status, which another program sends."""

    def __init__(self, node: int, identity: Identity) -> None:
        self.number, self._identity = node, identity
        self._status, self._heard_s = _UNHEARD, -1e9
        self._since_s, self._answers = -1e9, 0
        self.refused = 0  # requests beyond ANSWERS_PER_S
        self.restarts: list[int] = []  # nodes that asked for a restart since somebody looked, few
        wanted = (kind.id << 16 | _REQUEST | node << 8 | SERVICE for kind in (GET_NODE_INFO, RESTART_NODE))
        self.filters = tuple(CanAddress(extended(each), 0x1F00007F << 3) for each in wanted)

    def hear(self, status: NodeStatus, now_s: float) -> None:
        self._status, self._heard_s = status, now_s

    def answer(self, frame: Frame, now_s: float) -> list[tuple[int, bytes]]:
        """The frames of the answer; none where this is no request to this node."""
        word, data = frame.identifier, frame.data
        source, kind = word & 0x7F, word >> 16 & 0xFF
        is_request = frame.arb & 7 == CAN_IDE and word & _REQUEST and word & SERVICE and word >> 8 & 0x7F == self.number
        if not is_request or not source or not data or data[-1] & (START | END | TOGGLE) != START | END:
            return []
        asked = {each.id: each for each in (GET_NODE_INFO, RESTART_NODE)}.get(kind)
        if asked is None or not self._may_answer(now_s):
            return []
        if asked is RESTART_NODE:
            self.restarts = [*self.restarts, source][:ANSWERS_PER_S]
        payload = pack(RESTART_NODE, (0,)) if asked is RESTART_NODE else self._info(now_s)
        arb = extended(word & 0x1F000000 | kind << 16 | source << 8 | SERVICE | self.number)
        return framed(arb, asked.seed, data[-1] & NUMBER, payload)

    def _may_answer(self, now_s: float) -> bool:
        if now_s - self._since_s >= 1.0:
            self._since_s, self._answers = now_s, 0
        self._answers += 1
        self.refused += self._answers > ANSWERS_PER_S
        return self._answers <= ANSWERS_PER_S

    def _info(self, now_s: float) -> bytes:
        (name, version, unique_id), status = self._identity, self._status
        if now_s - self._heard_s > STATUS_S:
            status = _UNHEARD
        said = (status.uptime_s, status.health, status.mode, 0, status.vendor_code)
        return pack(GET_NODE_INFO, (*said, *version, 0, 0, 0, 0, 0, *unique_id, 0), tuple(name.encode("ascii", "replace")[:80]))
