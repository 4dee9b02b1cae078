"""`delfim can nodes`, `param`, `restart` and `firmware`: the devices of a DroneCAN bus, their parameters, and a new program
for one of them.

Nothing is asked of a node while motors are armed on the bus: its processor is for them then. A new program is not begun while
a boat's program commands the motors of the bus at all, at rest, too: somebody might drive off while one of them has none.
"""

import argparse
import contextlib
import math
import select
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from delfim.base.errors import DelfimError, FormatError, Refused, in_words, one_line
from delfim.base.input.untrusted import read_file
from delfim.canproxy.dronecan import requests
from delfim.canproxy.dronecan.datatypes import (
    ARMING_STATUS,
    NODE_STATUS,
    RAW_COMMAND,
    RPM_COMMAND,
    NodeStatus,
    decode,
    node_status,
)
from delfim.canproxy.dronecan.fields import DataType, unpack
from delfim.canproxy.dronecan.nodeservices import GET_NODE_INFO, RESTART_NODE
from delfim.canproxy.dronecan.requests import Parameter, ServiceReceiver, ServiceTransfer, service_frames
from delfim.canproxy.dronecan.transfers import NODE_MAX, STATUS, Publisher, Transfer, TransferReceiver
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket

NUMBERS: Final = (127, 126)  # of tools, as the specification has it
LISTEN_S: Final = 1.5  # arming is told twice a second, a status each second
ASK_S, TRIES = 0.7, 3
STATUS_S: Final = 1.0
SEND_S: Final = 2.0  # that a full queue is waited for
ARMED_S: Final = 3.0  # after the last word of it motors are no longer taken for armed
READ_S: Final = 30.0  # a node that gets no further in its firmware for so long has given it up
BACK_S: Final = 30.0  # until it runs again
FIRMWARE_BYTES: Final = 16 << 20
PARAMETERS_MAX: Final = 1 << 13  # an index has so many values
HEALTH: Final = ("well", "warning", "error", "critical")
MODES: Final = {0: "operational", 1: "starting", 2: "maintenance", 3: "software update", 7: "offline"}
OPERATIONAL, BROKEN = 0, 2  # of a mode; from this health on
NO_SUCH_FILE: Final = 2  # of a node that reads one
KINDS: Final = {bool: "boolean", int: "integer", float: "real", str: "text"}
BEGIN_ERRORS: Final = {1: "it cannot do that now", 2: "an update is under way already"}
ARMED: Final = "motors are armed on this bus: stop the boat first (idle)"
COMMANDED: Final = (
    "a program commands the motors of this bus, at rest now: end it first (systemctl stop delfim), or say --idle where nobody "
    "can drive off before the node is back"
)


class NoAnswer(Refused):
    """A node did not answer."""


class HandedFile:
    """A file for one node, which reads it from its beginning: what it was handed counts, `is_whole` once that was the end."""

    def __init__(self, to: int, path: str, image: bytes) -> None:
        self.to, self._path, self._image = to, path, image
        self.handed, self.is_whole, self._is_begun = 0, False, False

    def answer(self, request: bytes) -> bytes | None:
        """The answer to a request; None: it is none, or of an update that somebody else began. Raises FormatError."""
        offset, wanted = requests.read_request(request)
        if wanted != self._path:
            return requests.chunk(b"", NO_SUCH_FILE)
        self._is_begun |= offset == 0
        if not self._is_begun:  # it has the beginning of another file, which is not to be mixed with this one
            return None
        data = self._image[offset : offset + requests.CHUNK_BYTES]
        if offset <= len(self._image):  # nothing lies beyond its end, and who asks for that has not read it
            self.handed = max(self.handed, offset + len(data))
            self.is_whole |= len(data) < requests.CHUNK_BYTES
        return requests.chunk(data)


class NodeTool:
    """A node on the bus, for a person: asks one thing at a time, and hears who is there and whether motors are armed."""

    def __init__(self, bus: CanSocket) -> None:
        """Listens before it says a word. Raises Refused."""
        self._bus = bus
        self._heard = TransferReceiver((NODE_STATUS, ARMING_STATUS, RAW_COMMAND, RPM_COMMAND))
        self._answers: ServiceReceiver | None = None
        self._publisher: Publisher | None = None
        self.nodes = dict[int, NodeStatus]()
        self.armed_s = self.commanded_s = self._said_s = -1e9
        self.file: HandedFile | None = None
        self._number, self._started_s = 0, time.monotonic()
        for _ in self._transfers(LISTEN_S):
            pass
        free = [number for number in NUMBERS if number not in self.nodes]
        if not free:
            raise Refused("two other tools are on this bus already, as nodes 126 and 127: close one of them")
        self.node = free[0]
        self._answers = ServiceReceiver(self.node)
        self._publisher = Publisher(NODE_STATUS, self.node, STATUS)

    def may_ask(self) -> None:
        """Raises Refused while motors are armed."""
        if time.monotonic() - self.armed_s < ARMED_S:
            raise Refused(ARMED)

    def may_update(self) -> None:
        """Raises Refused while a program commands motors, be it to rest."""
        self.may_ask()
        if time.monotonic() - self.commanded_s < ARMED_S:
            raise Refused(COMMANDED)

    def ask(self, to: int, kind: DataType, payload: bytes) -> bytes:
        """The answer of a node. Raises Refused while motors are armed, NoAnswer."""
        for _ in range(TRIES):
            self.may_ask()
            self._number += 1
            self._send(service_frames(kind, self.node, to, self._number, payload, asks=True))
            for answer in self._transfers(ASK_S):
                wanted = (kind, False, to, self._number & 0x1F)
                if (answer.kind, answer.is_request, answer.source, answer.number) == wanted:
                    return answer.payload
        raise NoAnswer(f"node {to} does not answer {kind.name}")

    def serve(self, file: HandedFile) -> Iterator[int]:
        """Answers the node's requests for a file, until it has all: how much it was handed. Raises Refused."""
        self.file, handed, further_s = file, 0, time.monotonic()
        while True:
            if file.handed > handed:
                handed, further_s = file.handed, time.monotonic()
                yield handed
            if file.is_whole:
                return
            if time.monotonic() - further_s > READ_S:
                raise Refused(f"node {file.to} got no further for {READ_S:.0f} s")
            self.may_ask()
            for _ in self._transfers(STATUS_S, first=True):
                pass

    def back(self, node: int, what: str) -> NodeStatus:
        """Waits until a node runs its program; its file is there for it meanwhile, as its last piece may get lost. Raises
        Refused."""
        self.nodes.pop(node, None)
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < BACK_S:
            for _ in self._transfers(0.2):
                pass
            status = self.nodes.get(node)
            if status is not None and status.mode == OPERATIONAL and status.health < BROKEN:
                return status
        if node in self.nodes:
            raise Refused(f"node {node} {what}, and does not run its program: {state_of(self.nodes[node])}")
        words = "a node without a number of its own gets one from the boat's program"
        raise Refused(f"node {node} {what}, and is silent since {BACK_S:.0f} s; {words}")

    def _transfers(self, seconds: float, first: bool = False) -> Iterator[ServiceTransfer]:
        """What comes to this node for so long; with `first` until something came. Its own status goes out meanwhile."""
        end_s = time.monotonic() + seconds
        while (now_s := time.monotonic()) < end_s:
            if self._publisher is not None and now_s - self._said_s >= STATUS_S:
                self._said_s = now_s
                self._send(self._publisher.frames(node_status(now_s - self._started_s)))
            select.select([self._bus.fileno()], [], [], min(end_s - now_s, 0.1))
            while (frame := self._bus.receive()) is not None:
                if (heard := self._heard.feed(frame, now_s)) is not None:
                    self._note(heard.type, heard.source, heard.payload, now_s)
                elif self._answers is not None and (came := self._answers.feed(frame)) is not None:
                    self._hand(came)
                    yield came
                    end_s = now_s if first else end_s

    def _hand(self, came: ServiceTransfer) -> None:
        """Answers a request for the file. What makes no sense is not answered: the node asks again."""
        file = self.file
        if file is None or not (came.is_request and came.kind is requests.READ and came.source == file.to):
            return
        with contextlib.suppress(FormatError):
            if (answer := file.answer(came.payload)) is not None:
                self._send(service_frames(requests.READ, self.node, file.to, came.number, answer, asks=False))

    def _note(self, kind: int, source: int, payload: bytes, now_s: float) -> None:
        if kind == NODE_STATUS.id:
            with contextlib.suppress(FormatError):
                said = decode(Transfer(kind, source, payload))
                if isinstance(said, NodeStatus):
                    self.nodes[source] = said
        else:
            self.commanded_s = now_s
            if any(payload):  # armed, or a thrust that is not zero
                self.armed_s = now_s

    def _send(self, frames: list[tuple[int, bytes]]) -> None:
        """Raises BusError, TimeoutError: a queue that is full is waited for."""
        for arb, data in frames:
            self._bus.sendto(data, CanAddress(arb))


def on_bus(asked: argparse.Namespace) -> contextlib.AbstractContextManager[CanSocket]:
    can = open_can(asked.bus)
    can.bind(ANYTHING)
    can.settimeout(SEND_S)
    return can


def nodes(asked: argparse.Namespace) -> int:
    """Print who is on the bus."""
    with on_bus(asked) as can:
        tool = NodeTool(can)
        tool.may_ask()
        print("node  name                            version  state                            up, s  hardware  unique id")
        for number, status in sorted(tool.nodes.items()):
            try:
                told = identity(tool.ask(number, GET_NODE_INFO, b""))
            except NoAnswer as error:
                told = NodeIdentity(f"({error})", "", "", "")
            row = f"{number:4d}  {told.name:30s}  {told.version:7s}  {state_of(status):31s}  {status.uptime_s:5d}"
            print(f"{row}  {told.hardware:8s}  {told.unique_id}".rstrip())
    return 0


class NodeIdentity(NamedTuple):
    """Who a node says that it is."""

    name: str
    version: str  # of its program
    hardware: str  # its version
    unique_id: str


def identity(answer: bytes) -> NodeIdentity:
    """What GetNodeInfo tells. Raises FormatError."""
    values, letters = unpack(GET_NODE_INFO, answer)
    name, unique_id = (bytes(map(int, each)) for each in (letters, values[12:28]))
    version, hardware = (f"{values[at]:.0f}.{values[at + 1]:.0f}" for at in (5, 10))  # behind the status; behind a checksum
    return NodeIdentity(one_line(name.decode("ascii", "replace")), version, hardware, unique_id.hex())


def state_of(status: NodeStatus) -> str:
    """What a node says of itself, in words."""
    return f"{HEALTH[status.health]}, {MODES.get(status.mode, 'unknown')}"


def param(asked: argparse.Namespace) -> int:
    """Print parameters, set them, keep or erase them."""
    with on_bus(asked) as can:
        tool = NodeTool(can)
        if asked.erase:
            execute(tool, asked.node, requests.ERASE)
            print(f"node {asked.node}: its parameters are erased; after its next start they are the maker's")
        for word in asked.words:
            name, equals, value = word.partition("=")
            print(shown(changed(tool, asked.node, name, value) if equals else known(tool, asked.node, name)))
        if not asked.words and not asked.erase and not asked.save:
            for each in listed(tool, asked.node):
                print(shown(each))
        if asked.save:
            execute(tool, asked.node, requests.SAVE)
            print(f"node {asked.node}: saved")
    return 0


def known(tool: NodeTool, node: int, name: str) -> Parameter:
    """A parameter by its name. Raises Refused where there is none, FormatError."""
    found = requests.read_parameter(tool.ask(node, requests.GET_SET, requests.get_set(name=name)))
    if found is None or found.value is None:
        raise Refused(f"node {node} has no parameter {name}")
    return found


def changed(tool: NodeTool, node: int, name: str, words: str) -> Parameter:
    """Set a parameter. Raises Refused where the node has another value afterwards, FormatError."""
    value = requests.meant(words, known(tool, node, name))
    found = requests.read_parameter(tool.ask(node, requests.GET_SET, requests.get_set(name=name, value=value)))
    if found is None or (found.value != value and not is_close(found.value, value)):
        raise Refused(f"node {node} keeps {name} at {found.value if found else 'nothing'}")
    return found


def is_close(a: requests.Value, b: requests.Value) -> bool:
    """Whether they are the same in 32 bits."""
    return isinstance(a, float) and isinstance(b, float) and math.isclose(a, b, rel_tol=1e-6)


def listed(tool: NodeTool, node: int) -> Iterator[Parameter]:
    for index in range(PARAMETERS_MAX):
        found = requests.read_parameter(tool.ask(node, requests.GET_SET, requests.get_set(index)))
        if found is None:
            return
        yield found


def shown(each: Parameter) -> str:
    bounds = [
        f"{word} {value}" for word, value in (("default", each.default), ("least", each.least), ("greatest", each.greatest))
    ]
    told = [KINDS.get(type(each.value), "not told"), *(text for text in bounds if not text.endswith(" None"))]
    return f"{one_line(f'{each.name} = {each.value}')}  ({', '.join(told)})"


def execute(tool: NodeTool, node: int, code: int) -> None:
    """Save or erase. Raises Refused."""
    answer = tool.ask(node, requests.EXECUTE_OPCODE, requests.execute(code))
    if not answer or not answer[-1] & 0x80:
        raise Refused(f"node {node} did not {'erase' if code == requests.ERASE else 'save'} its parameters")


def restart(asked: argparse.Namespace) -> int:
    """Let a node start again. Some do that before they would answer: their time since the start tells."""
    with on_bus(asked) as can:
        tool = NodeTool(can)
        asked_s = time.monotonic()
        with contextlib.suppress(NoAnswer):
            if not (answer := tool.ask(asked.node, RESTART_NODE, requests.RESTART)) or not answer[0] & 0x80:
                raise Refused(f"node {asked.node} does not start again now")
        status = tool.back(asked.node, "was asked to start again")
        if status.uptime_s > time.monotonic() - asked_s + STATUS_S:
            raise Refused(f"node {asked.node} did not start again: it runs for {status.uptime_s} s")
        print(f"node {asked.node} started again, and runs for {status.uptime_s} s")
    return 0


def firmware(asked: argparse.Namespace) -> int:
    """Hand a node its new program."""
    path = Path(asked.file)
    try:
        image = read_file(path, FIRMWARE_BYTES)
    except OSError as error:
        raise DelfimError(f"{path}: {in_words(error)}") from None
    if not image:
        raise DelfimError(f"{path}: empty")
    with on_bus(asked) as can:
        tool = NodeTool(can)
        (tool.may_ask if asked.idle else tool.may_update)()
        before = identity(tool.ask(asked.node, GET_NODE_INFO, b""))
        file = HandedFile(asked.node, path.name, image)
        begin(tool, file, requests.begin_firmware_update(tool.node, path.name))
        print(f"node {asked.node}: {before.name} {before.version}; it fetches {path.name}, {len(image)} bytes", flush=True)
        hand_over(tool, file, len(image))
        tool.back(asked.node, "has the whole file")
        after = identity(tool.ask(asked.node, GET_NODE_INFO, b""))
        print(f"node {asked.node} is back: {after.name} {after.version}")
    return 0


def begin(tool: NodeTool, file: HandedFile, request: bytes) -> None:
    """Tell a node to fetch its new program. Raises Refused."""
    tool.file = file
    try:
        answer = tool.ask(file.to, requests.BEGIN_FIRMWARE_UPDATE, request)
    except NoAnswer:
        if file.handed:  # it began without a word, or that got lost
            return
        raise
    if (not answer or answer[0]) and not file.handed:
        why = answer[1:].decode("utf-8", "replace") or BEGIN_ERRORS.get(answer[0] if answer else 0, "it does not say why")
        raise Refused(f"node {file.to} takes no firmware: {why}")


def hand_over(tool: NodeTool, file: HandedFile, length: int) -> None:
    """Hand over the file, and print how far it is. Raises Refused."""
    tenths = 0
    try:
        for handed in tool.serve(file):
            if handed * 10 // length > tenths:
                tenths = handed * 10 // length
                print(f"{tenths * 10} %", flush=True)
    except (DelfimError, OSError, KeyboardInterrupt) as error:
        why = in_words(error) if isinstance(error, DelfimError | OSError) else "broken off"
        words = f"node {file.to} was handed {file.handed} of {length} bytes: it needs a whole program before it can be used"
        raise Refused(f"{why}; {words}") from None


def add_parsers(tools: "argparse._SubParsersAction[argparse.ArgumentParser]", bus: str) -> None:
    for name, run, words in (
        ("nodes", nodes, "who is on a DroneCAN bus"),
        ("param", param, "parameters of a DroneCAN node: print, set, save, erase"),
        ("restart", restart, "let a DroneCAN node start again"),
        ("firmware", firmware, "a new program for a DroneCAN node"),
    ):
        one = tools.add_parser(name, help=words, description=f"{words[0].upper()}{words[1:]}. Refused while motors are armed.")
        one.set_defaults(run=run)
        one.add_argument("bus", metavar="BUS", help=bus)
        if name != "nodes":
            one.add_argument("node", metavar="NODE", type=int, choices=range(1, NODE_MAX + 1), help="its number, 1 to 125")
        if name == "param":
            one.add_argument(
                "words", nargs="*", metavar="NAME[=VALUE]", help="one to print, or to set; without one all are printed"
            )
            one.add_argument("--save", action="store_true", help="then keep all of them over its next start")
            one.add_argument("--erase", action="store_true", help="first forget all that were kept")
        if name == "firmware":
            one.add_argument("file", metavar="FILE", help="the program, as its maker gives it for DroneCAN")
            one.add_argument("--idle", action="store_true", help="also beside a boat's program that is in idle")
