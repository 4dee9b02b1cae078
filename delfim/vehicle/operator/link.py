"""The operator's end of the local command socket: ask, get the state back, watch. Blocking, for commands and scripts."""

import contextlib
import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from delfim.base.errors import DelfimError, FormatError, Refused
from delfim.vehicle.console import PART

MISSION_S = 60.0  # that the vehicle may look at a mission


class Link:
    """A connection to the vehicle's command socket. Raises DelfimError where nobody listens or answers within `timeout_s`."""

    def __init__(self, path: str | Path, timeout_s: float = 5.0) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(timeout_s)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise DelfimError(f"no vehicle at {path}: {error.strerror or error}; is it running?") from None
        self._lines = self._socket.makefile("rb")

    def ask(self, command: str, **words: object) -> dict[str, Any]:
        """Send a command; the state that came back. Raises Refused with the vehicle's reason."""
        if command == "mission" and isinstance(text := words.get("text"), str):
            self._socket.settimeout(MISSION_S)
            for at in range(0, len(text) or 1, PART):
                state = self._asked(command, text=text[at : at + PART], at=at, more=at + PART < len(text))
            return state
        return self._asked(command, **words)

    def _asked(self, command: str, **words: object) -> dict[str, Any]:
        with contextlib.suppress(OSError):  # closed at the other end: what it said before closing says why
            self._socket.sendall(json.dumps({"command": command, **words}).encode() + b"\n")
        reply = self._reply()
        if not reply["ok"]:
            raise Refused(reply["reason"])
        state: dict[str, Any] = reply["state"]
        return state

    def watch(self) -> Iterator[dict[str, Any]]:
        """States as the vehicle publishes them, until it goes away."""
        yield self.ask("watch")
        while True:
            yield self._reply()["state"]

    def close(self) -> None:
        self._lines.close()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _reply(self) -> dict[str, Any]:
        try:
            line = self._lines.readline()
        except OSError as error:
            raise DelfimError(f"the vehicle does not answer: {error}") from None
        if not line:
            raise DelfimError("the vehicle closed the connection")
        try:
            reply: dict[str, Any] = json.loads(line)
        except ValueError:
            raise FormatError(f"the vehicle's answer is not JSON: {line[:80]!r}") from None
        return reply
