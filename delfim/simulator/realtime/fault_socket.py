"""Takes the faults of `delfim fault`: a datagram of JSON over a local socket, answered with a line of words.

Two programs listen in the run directory: that of the nodes, and, where the vehicle's file says `simulation.faults`, the boat's
own, for faults around its loop: the log, the guest, the operator's commands.
"""

import asyncio
import contextlib
import json
import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Self

from delfim import config
from delfim.base.clock import Clock
from delfim.base.errors import DelfimError, FormatError, Refused
from delfim.base.input.untrusted import parse_json
from delfim.simulator.faults import ABOARD, Breakage, Broken, FaultyGuest, FaultyLog, fault
from delfim.vehicle.state import State, StateLog

ANSWER_S: Final = 2.0
WORDS_BYTES: Final = 1024  # of a request for a fault
TICK_S: Final = 0.1
BOAT, NODES = "faults", "nodes"  # the names of the sockets of both programs


def place(settings: config.Vehicle, name: str) -> str:
    """The path of a socket."""
    return str(Path(settings.runtime.run_directory) / name)


def tell(settings: config.Vehicle, kind: str, where: str = "", value: float | None = None, for_s: float | None = None) -> str:
    """Ask a running simulation for a fault; returns its answer. Raises Refused with its reason, DelfimError if none runs."""
    words = json.dumps({"kind": kind, "where": where, "value": value, "for_s": for_s}).encode()
    if kind == "end":
        with contextlib.suppress(DelfimError):  # only the nodes run, with another vehicle on the bus
            _answer(place(settings, BOAT), words)
    return _answer(place(settings, BOAT if kind in ABOARD else NODES), words)


def _answer(path: str, words: bytes) -> str:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        asking.bind("")  # the kernel chooses an address for the answer
        asking.settimeout(ANSWER_S)
        try:
            asking.sendto(words, path)
            answer = json.loads(asking.recv(WORDS_BYTES))
        except OSError as error:
            raise DelfimError(f"no simulation answers at {path}: {error.strerror or error}; is one running?") from None
    if not answer["ok"]:
        raise Refused(answer["text"])
    return str(answer["text"])


@contextlib.contextmanager
def listening(path: str) -> Iterator[socket.socket]:
    """Open the socket for requests."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as requests:
        Path(path).unlink(missing_ok=True)
        requests.bind(path)
        os.chmod(path, 0o660)
        try:
            yield requests
        finally:
            Path(path).unlink(missing_ok=True)


def obey(requests: socket.socket, broken: Broken, name: str, clock: Clock) -> None:
    """Handle all waiting requests. Bad ones do not raise."""
    while True:
        try:
            data, sender = requests.recvfrom(WORDS_BYTES)
        except BlockingIOError:
            return
        try:
            answer = {"ok": True, "text": _break(broken, name, data, clock.monotonic_s())}
        except FormatError as error:
            answer = {"ok": False, "text": str(error)}
        with contextlib.suppress(OSError):  # the sender is gone, or does not read
            requests.sendto(json.dumps(answer).encode(), sender)


def _break(broken: Broken, name: str, data: bytes, now_s: float) -> str:
    try:
        words: dict[str, Any] = parse_json(data)
        kind = words.pop("kind")
        if kind == "end":
            for present in list(broken.faults):
                broken.end(*present)
            return "all faults ended; lost charge is not restored"
        asked = fault(kind, **words, thrusters=broken.thrusters)
    except (TypeError, AttributeError, KeyError, ValueError) as error:
        raise FormatError(str(error)) from None
    if (asked.kind in ABOARD) is not (name == BOAT):
        raise FormatError(f"{asked.kind} does not exist in the {name}")
    broken.begin(asked, now_s)
    if asked.kind == "restarted":
        return "the boat's program is killed, and starts again by itself"
    lasts = "until it is ended" if asked.for_s == float("inf") else f"for {asked.for_s:g} s"
    return f"{asked.kind} {asked.where}".rstrip() + f" {lasts}"


class Aboard(Broken):
    """Faults in the boat's own program. Used ashore, within a running event loop."""

    def __init__(self, settings: config.Vehicle, clock: Clock) -> None:
        super().__init__()
        self._path, self._clock = place(settings, BOAT), clock
        self._links = contextlib.ExitStack()

    def __enter__(self) -> Self:
        loop = self._loop = asyncio.get_running_loop()
        requests = self._links.enter_context(listening(self._path))
        loop.add_reader(requests.fileno(), obey, requests, self, BOAT, self._clock)
        self._links.callback(loop.remove_reader, requests.fileno())
        self._tick()
        return self

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()
        self._links.close()

    def _tick(self) -> None:
        self.expire(self._clock.monotonic_s())
        self._timer = self._loop.call_later(TICK_S, self._tick)

    def log(self, log: StateLog) -> StateLog:
        return FaultyLog(log, self)

    def guest(self, state: State, clock: Clock) -> FaultyGuest:
        return FaultyGuest(state, clock, self)

    def begin(self, broken: Breakage, now_s: float) -> None:
        """Begin a fault. A restart is a death without a word, as soon as the answer is sent."""
        if broken.kind == "restarted":
            self._loop.call_soon(os.kill, os.getpid(), signal.SIGKILL)
        else:
            super().begin(broken, now_s)

    @property
    def deaf(self) -> str | None:
        """The reason why the operator's commands do not arrive; None: they do."""
        return "not heard: console_lost" if "console_lost" in self.on else None
