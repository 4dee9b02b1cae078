"""Fetches logs of boats at a click, each in a process of its own, which goes on where another one ended.

Commands come first: while an order waits, or the link of that boat is weak, its process is stopped, and goes on afterwards.
"""

import asyncio
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from delfim.base.errors import ConfigError, Refused
from delfim.console.boats.boat import Boat

TICK_S: Final = 0.5
LINE_MAX: Final = 1000
_NAME: Final = re.compile(r"\w[\w .-]{0,31}")
Answer = Callable[[bool, str], None]


@dataclass(slots=True)
class LogFetch:
    child: subprocess.Popen[bytes]
    what: str  # is under way: "logs", "chart"
    total: float = 0.0
    done: float = 0.0
    waits: bool = False
    is_ended: bool = False  # by the operator


def sources_of(words: Sequence[str]) -> dict[str, str]:
    """Where the logs of each boat are, by its name, from NAME=URL. Raises ConfigError."""
    found = dict[str, str]()
    for each in words:
        name, _, url = each.partition("=")
        if not _NAME.fullmatch(name) or not re.match(r"(sftp|ftps?)://[^/]", url):
            raise ConfigError("--logs", each, "not a boat's name and an address", "NAME=sftp://USER@HOST[:PORT]/FOLDER")
        found[name] = url
    return found


class LogFetching:
    """`tell` informs the pages; `is_busy` says that an order to a boat is under way."""

    def __init__(
        self, sources: Mapping[str, str], folder: Path, tell: Callable[[dict[str, Any]], None], is_busy: Callable[[int], bool]
    ) -> None:
        self._sources, self._folder, self._tell, self._is_busy = sources, folder, tell, is_busy
        self._running = dict[int, LogFetch]()
        self._due_s = 0.0

    def ask(self, boat: Boat, do: str, answer: Answer) -> None:
        """`state`: state logs and sidecars; `all`; `end`. The answer comes when it has ended. Raises Refused."""
        running = self._running.get(boat.number)
        if do == "end":
            if running is None:
                raise Refused("no logs are being fetched")
            running.is_ended = True
            running.child.kill()
            answer(True, "")
            return
        folder = str(self._folder / boat.name)

        def said(told: dict[str, Any]) -> str:
            words = f"{told.get('files', 0)} logs, {told.get('bytes', 0) / 1e6:.1f} MB fetched, into {folder}"
            return words + (f"; {told['cut']} of them lack their end on the boat, too" if told.get("cut") else "")

        self._begin(boat, "logs", {"folder": folder, "state": do == "state"}, said, answer)

    def send(self, boat: Boat, what: str, file: Path, path: str, words: str, answer: Answer) -> None:
        """Writes a file of this computer beside its logs; `words` are said when it is there. Raises Refused."""

        def said(told: dict[str, Any]) -> str:
            return f"{told.get('bytes', 0) / 1e3:.0f} kB sent: {words}"

        self._begin(boat, what, {"put": str(file), "path": path}, said, answer)

    def unreached(self, boat: Boat) -> str:
        """Why its files cannot be fetched or sent now; empty: they can."""
        if (running := self._running.get(boat.number)) is not None:
            return "its logs are being fetched" if running.what == "logs" else f"its {running.what} is being sent"
        if boat.name not in self._sources:
            return f"start the console with --logs '{boat.name}=sftp://USER@HOST/log': it must know where they are"
        return ""

    def _begin(
        self, boat: Boat, what: str, asked: dict[str, Any], said: Callable[[dict[str, Any]], str], answer: Answer
    ) -> None:
        if why := self.unreached(boat):
            raise Refused(why)
        command = [sys.executable, "-m", "delfim.console.logs.fetcher"]
        child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        fetch = self._running[boat.number] = LogFetch(child, what)
        asked["url"] = self._sources[boat.name]

        def ended(future: "asyncio.Future[dict[str, Any]]") -> None:
            if not future.cancelled():
                self._end(boat.number, future.result(), said, answer)

        asyncio.get_running_loop().run_in_executor(None, _followed, fetch, json.dumps(asked)).add_done_callback(ended)

    def tick(self, boats: Mapping[int, Boat], now_s: float) -> None:
        """Often: who waits for the link, and how far each one is."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + TICK_S
        for number, fetch in self._running.items():
            boat = boats.get(number)
            waits = boat is not None and (self._is_busy(number) or boat.has_weak_link(now_s))
            if waits != fetch.waits and hasattr(signal, "SIGSTOP") and fetch.child.poll() is None:
                fetch.waits = waits
                fetch.child.send_signal(signal.SIGSTOP if waits else signal.SIGCONT)
            what = f"{fetch.what} wait{'s' * (fetch.what != 'logs')} for the link" if fetch.waits else fetch.what
            part = min(fetch.done / fetch.total, 0.99) if fetch.total else 0.0
            self._tell({"t": "progress", "boat": number, "what": what, "part": part})

    def close(self) -> None:
        for fetch in self._running.values():
            fetch.child.kill()

    def _end(self, number: int, told: dict[str, Any], said: Callable[[dict[str, Any]], str], answer: Answer) -> None:
        fetch = self._running.pop(number)
        self._tell({"t": "progress", "boat": number, "what": fetch.what, "part": 1.0})
        why = str(told.get("refused", ""))
        if fetch.is_ended:
            why = "ended; the next time goes on from here"
        words = f"{fetch.what}: {why or said(told)}"
        self._tell({"t": "text", "boat": number, "severity": 5 if why else 6, "text": words, "at_s": time.time()})
        if not fetch.is_ended:
            answer(not why, why)


def _followed(fetch: LogFetch, asked: str) -> dict[str, Any]:
    """In a thread: the last words of the process."""
    told: dict[str, Any] = {"refused": "the process that does it ended"}
    assert fetch.child.stdin is not None
    assert fetch.child.stdout is not None
    with fetch.child as child:
        fetch.child.stdin.write(asked.encode() + b"\n")
        fetch.child.stdin.close()
        while line := fetch.child.stdout.readline(LINE_MAX):
            try:
                words = json.loads(line)
            except ValueError:
                continue
            fetch.total, fetch.done = words.get("total", fetch.total), words.get("done", fetch.done)
            told = words if {"files", "sent", "refused"} & words.keys() else told
        child.wait()
    return told
