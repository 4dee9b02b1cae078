"""`delfim can nodes`, `param` and `firmware`: the devices of a DroneCAN bus, their parameters, and a new program for
one of them.

Nothing is asked of a node while motors are armed on the bus: its processor is for them then.
"""

import argparse
import contextlib
import math
import select
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from delfim.base.errors import DelfimError, FormatError, Refused, in_words
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
from delfim.canproxy.dronecan.nodeservices import GET_NODE_INFO
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
READ_S: Final = 30.0  # a node that wants nothing of its firmware for so long has given it up
BACK_S: Final = 30.0  # until it runs again
FIRMWARE_BYTES: Final = 16 << 20
PARAMETERS_MAX: Final = 1 << 13  # an index has so many values
HEALTH: Final = ("well", "warning", "error", "critical")
MODES: Final = {0: "operational", 1: "starting", 2: "maintenance", 3: "software update", 7: "offline"}
UPDATING: Final = 3
BEGIN_ERRORS: Final = {1: "it cannot do that now", 2: "an update is under way already"}
ARMED: Final = "motors are armed on this bus: stop the boat first (idle)"


class NodeTool:
    """A node on the bus, for a person: asks one thing at a time, and hears who is there and whether motors are armed."""

    def __init__(self, bus: CanSocket) -> None:
        """Listens before it says a word. Raises Refused."""
        self._bus = bus
        self._heard = TransferReceiver((NODE_STATUS, ARMING_STATUS, RAW_COMMAND, RPM_COMMAND))
        self._answers: ServiceReceiver | None = None
        self._publisher: Publisher | None = None
        self.nodes = dict[int, NodeStatus]()
        self.armed_s = self._said_s = -1e9
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

    def ask(self, to: int, kind: DataType, payload: bytes) -> bytes:
        """The answer of a node. Raises Refused while motors are armed or without an answer."""
        for _ in range(TRIES):
            self.may_ask()
            self._number += 1
            self._send(service_frames(kind, self.node, to, self._number, payload, asks=True))
            for answer in self._transfers(ASK_S):
                wanted = (kind, False, to, self._number & 0x1F)
                if (answer.kind, answer.is_request, answer.source, answer.number) == wanted:
                    return answer.payload
        raise Refused(f"node {to} does not answer {kind.name}")

    def serve(self, to: int, path: str, image: bytes) -> Iterator[int]:
        """Answers the node's requests for a file: how much of it the node has, until it has all. Raises Refused."""
        asked_s = time.monotonic()
        while True:
            self.may_ask()
            for each in self._transfers(STATUS_S, first=True):
                if not (each.is_request and each.kind is requests.READ and each.source == to):
                    continue
                asked_s = time.monotonic()
                offset, wanted = requests.read_request(each.payload)
                data = image[offset : offset + requests.CHUNK_BYTES] if wanted == path else b""
                answer = requests.chunk(data, 0 if wanted == path else 2)  # 2: there is no such file
                self._send(service_frames(requests.READ, self.node, to, each.number, answer, asks=False))
                yield offset + len(data)
                if wanted == path and len(data) < requests.CHUNK_BYTES:
                    return
            if time.monotonic() - asked_s > READ_S:
                raise Refused(f"node {to} has asked for nothing for {READ_S:.0f} s: it may need its old program again")

    def back(self, node: int) -> None:
        """Waits until a node is there and no longer at its update. Raises Refused."""
        self.nodes.pop(node, None)
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < BACK_S:
            for _ in self._transfers(0.2):
                pass
            if (status := self.nodes.get(node)) is not None and status.mode != UPDATING:
                return
        raise Refused(f"node {node} has the whole file, and is not back after {BACK_S:.0f} s")

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
                    yield came
                    end_s = now_s if first else end_s

    def _note(self, kind: int, source: int, payload: bytes, now_s: float) -> None:
        if kind == NODE_STATUS.id:
            with contextlib.suppress(FormatError):
                said = decode(Transfer(kind, source, payload))
                if isinstance(said, NodeStatus):
                    self.nodes[source] = said
        elif any(payload):  # armed, or a thrust that is not zero
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
        print("node  name                            version  state        up, s")
        for number, status in sorted(tool.nodes.items()):
            try:
                name, version = identity(tool.ask(number, GET_NODE_INFO, b""))
            except Refused as error:
                name, version = f"({error})", ""
            state = f"{HEALTH[status.health]}, {MODES.get(status.mode, 'unknown')}"
            print(f"{number:4d}  {name:30s}  {version:7s}  {state}  {status.uptime_s}")
    return 0


def identity(answer: bytes) -> tuple[str, str]:
    """Name and version of the program in GetNodeInfo. Raises FormatError."""
    values, name = unpack(GET_NODE_INFO, answer)
    return bytes(map(int, name)).decode("ascii", "replace"), f"{values[5]:.0f}.{values[6]:.0f}"


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
    told = ", ".join(text for text in bounds if not text.endswith(" None"))
    return f"{each.name} = {each.value}{f'  ({told})' if told else ''}"


def execute(tool: NodeTool, node: int, code: int) -> None:
    """Save or erase. Raises Refused."""
    answer = tool.ask(node, requests.EXECUTE_OPCODE, requests.execute(code))
    if not answer or not answer[-1] & 0x80:
        raise Refused(f"node {node} did not {'erase' if code == requests.ERASE else 'save'} its parameters")


def firmware(asked: argparse.Namespace) -> int:
    """Hand a node its new program."""
    file = Path(asked.file)
    try:
        image = read_file(file, FIRMWARE_BYTES)
    except OSError as error:
        raise DelfimError(f"{file}: {in_words(error)}") from None
    if not image:
        raise DelfimError(f"{file}: empty")
    with on_bus(asked) as can:
        tool = NodeTool(can)
        before = identity(tool.ask(asked.node, GET_NODE_INFO, b""))
        answer = tool.ask(asked.node, requests.BEGIN_FIRMWARE_UPDATE, requests.begin_firmware_update(tool.node, file.name))
        if not answer or answer[0]:
            why = answer[1:].decode("utf-8", "replace") or BEGIN_ERRORS.get(answer[0] if answer else 0, "it does not say why")
            raise Refused(f"node {asked.node} takes no firmware: {why}")
        print(f"node {asked.node}: {before[0]} {before[1]}; it fetches {file.name}, {len(image)} bytes")
        told = 0
        for has in tool.serve(asked.node, file.name, image):
            if has * 10 // len(image) > told:
                told = has * 10 // len(image)
                print(f"{told * 10} %", flush=True)
        tool.back(asked.node)
        after = identity(tool.ask(asked.node, GET_NODE_INFO, b""))
        print(f"node {asked.node} is back: {after[0]} {after[1]}")
    return 0


def add_parsers(tools: "argparse._SubParsersAction[argparse.ArgumentParser]", bus: str) -> None:
    for name, run, words in (
        ("nodes", nodes, "who is on a DroneCAN bus"),
        ("param", param, "parameters of a DroneCAN node: print, set, save, erase"),
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
