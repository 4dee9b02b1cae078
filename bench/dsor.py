"""Two processes send each other DSOR messages over a bus that loses, repeats, reorders and corrupts frames.

python bench/dsor.py --messages 10000      prints what became of every message; exit code 1 where one arrived twice, came
                                           out different, or was lost without its sender being told

Each end is a process with a bus of its own; this program is the relay between the two buses, and the judge.
"""

import argparse
import asyncio
import json
import select
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

from delfim.base.frames import Frame
from delfim.canproxy.canloop import open_canloop
from delfim.canproxy.dsor.protocol import Message, Outcome
from delfim.canproxy.dsor.sockets import DsorTransport
from delfim.canproxy.socket import ANYTHING, CanSocket

NODES = (1, 2)
REORDERED_S = 0.02  # a frame that is held back goes on after so long, or ...
REORDERED_FRAMES = 8  # ... when so many others have overtaken it


class Rates(NamedTuple):
    """Shares of the frames, 0..1."""

    lost: float = 0.005
    duplicated: float = 0.005
    reordered: float = 0.005
    corrupted: float = 0.0001


class Verdict(NamedTuple):
    messages: int
    delivered: int  # arrived, and the sender knows
    told: int  # the sender was told that nobody knows
    arrived_untold: int  # of these, those that did arrive
    wrong: list[str]  # what must not happen, in words
    reasons: dict[str, int]  # that senders were told, without their figures
    errors: dict[str, int]  # of the receivers
    frames: int
    bytes: int
    seconds: float


class Relay:
    """Carries frames from one socket to another and mistreats them, the same from the same seed."""

    def __init__(self, source: CanSocket, sink: CanSocket, rates: Rates, seed: str) -> None:
        self._source, self._sink, self._rates, self._random = source, sink, rates, Random(seed)
        self._held: list[tuple[float, int, Frame]] = []  # until when, and how many may still overtake
        self.frames = 0

    def carry(self) -> None:
        now_s = time.monotonic()
        while (frame := self._source.receive()) is not None:
            self.frames += 1
            self._one(frame, now_s)
        due = [held for held in self._held if held[0] <= now_s or held[1] <= 0]
        self._held = [held for held in self._held if held not in due]
        for _, _, frame in due:
            self._send(frame)

    def _one(self, frame: Frame, now_s: float) -> None:
        rates, draw = self._rates, self._random.random
        if draw() < rates.lost / 2:  # the other half gets lost in canloop
            return
        if draw() < rates.corrupted:
            frame = self._corrupted(frame)
        if draw() < rates.reordered:
            self._held.append((now_s + REORDERED_S, self._random.randint(1, REORDERED_FRAMES), frame))
            return
        self._send(frame)
        if draw() < rates.duplicated:
            self._send(frame)
        if self._held:
            self._held = [(until_s, frames - 1, frame) for until_s, frames, frame in self._held]

    def _corrupted(self, frame: Frame) -> Frame:
        """One to three bits of the data turned over, or a byte less."""
        if not frame.data or self._random.random() < 0.1:
            return frame._replace(data=frame.data[:-1])
        bits = int.from_bytes(frame.data, "little")
        for _ in range(self._random.randint(1, 3)):
            bits ^= 1 << self._random.randrange(8 * len(frame.data))
        return frame._replace(data=bits.to_bytes(len(frame.data), "little"))

    def _send(self, frame: Frame) -> None:
        self._sink.sendmsg(frame._replace(ifindex=0))


def sizes(messages: int, bytes_max: int, seed: int) -> list[int]:
    """The shortest and the longest, and of the others nine of ten short; up to `bytes_max` / 64, and from there, every order
    of magnitude is as likely as another."""
    random, middle = Random(seed), bytes_max / 64
    rest = (middle ** random.random() if random.random() < 0.9 else middle * 64 ** random.random() for _ in range(messages - 2))
    return [1, bytes_max, *map(round, rest)][:messages]


def payload(seed: int, node: int, index: int, size: int) -> bytes:
    return Random(f"{seed} {node} {index}").randbytes(size)


class End:
    """One of the two processes: sends its messages, `streams` at a time, and checks those of the other."""

    def __init__(self, asked: argparse.Namespace) -> None:
        self._node, self._seed, self._sizes = asked.node, asked.seed, sizes(asked.messages, asked.bytes_max, asked.seed)
        self._peer = sum(NODES) - self._node
        self._next = 0
        self._delivered: list[int] = []
        self._told: dict[int, str] = {}
        self._received: Counter[int] = Counter()
        self._wrong: list[str] = []
        self._can = open_canloop(asked.bus, droprate=asked.lost / 2, seed=asked.seed + self._node)
        loop = asyncio.get_running_loop()
        self._dsor = DsorTransport(loop, self._can, self._node, on_message=self._on_message, on_outcome=self._on_outcome)
        for priority in range(asked.streams):
            self._send(priority)

    def _send(self, priority: int) -> None:
        if self._next < len(self._sizes):
            data = payload(self._seed, self._node, self._next, self._sizes[self._next])
            self._dsor.send(Message(priority, self._node, self._peer, self._next, data))
            self._next += 1

    def _on_outcome(self, outcome: Outcome) -> None:
        message, failure = outcome
        if failure:
            self._told[message.id] = failure
        else:
            self._delivered.append(message.id)
        self._send(message.priority)
        if len(self._told) + len(self._delivered) == len(self._sizes):
            print("done", flush=True)

    def _on_message(self, message: Message) -> None:
        index = message.id
        self._received[index] += 1
        if index >= len(self._sizes) or message.data != payload(self._seed, self._peer, index, self._sizes[index]):
            self._wrong.append(f"message {index} to node {self._node} came out different")

    async def run(self) -> None:
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)  # until the parent says that both are done
        fields = {"delivered": self._delivered, "told": self._told, "received": dict(self._received), "wrong": self._wrong}
        print(json.dumps({**fields, "errors": dict(self._dsor.errors)}), flush=True)
        self._dsor.close()
        self._can.close()


async def _end(asked: argparse.Namespace) -> None:
    await End(asked).run()


def exchange(messages: int, rates: Rates, seed: int, streams: int = 16, bytes_max: int = 65_535, bus: str = "dsor") -> Verdict:
    """`messages` of them, half each way. Raises whatever a child's end makes of json.loads when it died."""
    began_s = time.monotonic()
    options = ["--messages", str(messages // 2), "--seed", str(seed), "--streams", str(streams), "--bytes-max", str(bytes_max)]
    with open_canloop(f"{bus}-1") as first, open_canloop(f"{bus}-2") as second:
        for each in (first, second):
            each.setblocking(False)
            each.bind(ANYTHING)
        relays = (Relay(first, second, rates, f"{seed} there"), Relay(second, first, rates, f"{seed} back"))
        ends = [
            subprocess.Popen(
                [sys.executable, __file__, "--node", str(node), "--bus", f"{bus}-{node}", "--lost", str(rates.lost), *options],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for node in NODES
        ]
        _carry_until_done(relays, (first, second), ends)
        reports = [json.loads(end.communicate("")[0]) for end in ends]
    seconds = time.monotonic() - began_s
    carried = sum(sizes(messages // 2, bytes_max, seed)) * 2
    return _verdict(reports, messages // 2, sum(relay.frames for relay in relays), carried, seconds)


def _carry_until_done(
    relays: tuple[Relay, Relay], sockets: tuple[CanSocket, CanSocket], ends: list["subprocess.Popen[str]"]
) -> None:
    poll = select.poll()
    waiting = {end.stdout.fileno() for end in ends if end.stdout}
    for fd in (*waiting, *(socket.fileno() for socket in sockets)):
        poll.register(fd, select.POLLIN)
    while waiting:
        for fd, _ in poll.poll(REORDERED_S / 2 * 1000):
            if fd in waiting:  # it said "done", or died, which shows in its report
                waiting.remove(fd)
                poll.unregister(fd)
        for relay in relays:
            relay.carry()
    for end in ends:
        assert end.stdout
        end.stdout.readline()


def _verdict(reports: list[dict[str, Any]], each: int, frames: int, carried: int, seconds: float) -> Verdict:
    wrong = [words for report in reports for words in report["wrong"]]
    arrived_untold = 0
    for sender, receiver, node in ((reports[0], reports[1], NODES[0]), (reports[1], reports[0], NODES[1])):
        received = {int(index): count for index, count in receiver["received"].items()}
        delivered, told = set(sender["delivered"]), {int(index) for index in sender["told"]}
        wrong += [f"message {i} of node {node} arrived {count} times" for i, count in received.items() if count > 1]
        wrong += [f"message {i} of node {node} did not arrive and its sender thinks it did" for i in delivered - set(received)]
        wrong += [f"message {i} of node {node} has no end" for i in set(range(each)) - delivered - told]
        arrived_untold += len(told & set(received))
    reasons = Counter("".join(c for c in words if not c.isdigit()) for report in reports for words in report["told"].values())
    errors: Counter[str] = Counter()
    for report in reports:
        errors.update(report["errors"])
    delivered_all, told_all = (sum(len(report[key]) for report in reports) for key in ("delivered", "told"))
    return Verdict(
        2 * each,
        delivered_all,
        told_all,
        arrived_untold,
        wrong,
        dict(reasons),
        dict(errors),
        frames,
        carried,
        round(seconds, 1),
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--bytes-max", type=int, default=65_535, help="of the longest message")
    parser.add_argument("--streams", type=int, default=16, help="messages under way at once, each way; a receiver keeps 16")
    parser.add_argument("--seed", type=int, default=1)
    for name, default in Rates()._asdict().items():
        parser.add_argument(f"--{name}", type=float, default=default, help="share of the frames")
    parser.add_argument("--node", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--bus", default="dsor", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.node:
        asyncio.run(_end(asked))
        return 0
    rates = Rates(asked.lost, asked.duplicated, asked.reordered, asked.corrupted)
    verdict = exchange(asked.messages, rates, asked.seed, asked.streams, asked.bytes_max, asked.bus)
    print(json.dumps(verdict._asdict(), indent=1))
    return 1 if verdict.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
