"""Surveys for the pages: areas read from files, and lines of an area while its form changes.

A process of its own makes them (`delfim.survey.preview`), and a thread waits for it. It is asked for one survey at a time; of
each page the newest request waits, and one that came before it is answered *replaced*. A survey that takes longer than its
bound, or in whose way a newer one is, is ended with the process.
"""

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from threading import Timer
from typing import Any, Final

import msgspec
from aiohttp import web

from delfim.console.gateway import page_messages
from delfim.console.plans.plan import page_of
from delfim.console.plans.sent_files import FileReader
from delfim.vehicle.plans.mission import Mission

LIMIT_S: Final = 20.0  # of one request; a usual one takes a tenth of a second ...
BEGINS: Final = 3.0  # ... and so many times as long where the process begins, which on a busy machine takes most of it
NEWER_S: Final = 2.0  # a newer request ends one that has taken so long
USUAL: Final = Path(__file__).parents[2] / "etc/delfimx.toml"  # the boat, where no file was given
TOO_LONG: Final = f"no lines after {LIMIT_S:.0f} s: simplify the area, or take a larger spacing"
REPLACED: Final = "replaced by a newer form"

Answer = Callable[[bool, str], None]
Tell = Callable[[dict[str, Any]], None]


class Planner:
    """The process. `ask` blocks: call it in a worker, one at a time."""

    def __init__(self, vehicle: str) -> None:
        self._command = [sys.executable, "-m", "delfim.survey.preview", vehicle]
        self._child: subprocess.Popen[bytes] | None = None

    def ask(self, request: bytes, limit_s: float = LIMIT_S) -> dict[str, Any]:
        """What it answers to a line; `refused` in words where it does not."""
        child = self._child
        if child is None or child.poll() is not None:
            nothing, limit_s = subprocess.DEVNULL, BEGINS * limit_s
            child = self._child = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=nothing)
        assert child.stdin is not None
        assert child.stdout is not None
        limit = Timer(limit_s, child.kill)
        limit.start()
        try:
            child.stdin.write(request + b"\n")
            child.stdin.flush()
            answer = child.stdout.readline()
            told: dict[str, Any] = json.loads(answer)
            return told
        except (OSError, ValueError):
            self.close()
            return {"refused": TOO_LONG}
        finally:
            limit.cancel()

    def end(self) -> None:
        """End the process; the next request starts another one."""
        if self._child is not None:
            self._child.kill()

    def close(self) -> None:
        if self._child is not None:
            self._child.kill()
            self._child.communicate()
            self._child = None


class SurveyDesk:
    """Answers the pages. `vehicle`: the boat's file; without one the lines are those of the usual boat. `heard`: the files of
    the soundings that were heard."""

    def __init__(self, vehicle: Path | None, heard: Callable[[], list[Path]] = list) -> None:
        self._heard = heard
        self._planner = Planner(str(vehicle or USUAL))
        self._waiting: dict[str, tuple[bytes, page_messages.Survey, Tell, Answer]] = {}  # of each page the newest
        self._began_s: float | None = None  # when the request under way was begun
        self._reader = FileReader("delfim.survey.areafile")

    def close(self) -> None:
        """Called after the last request."""
        self._planner.close()

    def ask(self, who: str, asked: page_messages.Survey, tell: Tell, answer: Answer) -> None:
        """Makes the lines that a page asks for, and answers it later."""
        if (older := self._waiting.pop(who, None)) is not None:
            older[3](False, REPLACED)
        self._waiting[who] = request(asked, self._heard() if asked.lines else ()), asked, tell, answer
        if self._began_s is None:
            self._next()
        elif time.monotonic() - self._began_s > NEWER_S:
            self._planner.end()

    def _next(self) -> None:
        self._began_s = None
        if not self._waiting:
            return
        self._began_s = time.monotonic()
        line, asked, tell, answer = self._waiting.pop(next(iter(self._waiting)))

        def ended(future: "asyncio.Future[dict[str, Any]]") -> None:
            if not future.cancelled():
                _tell(future.result(), asked, tell, answer)
                self._next()

        asyncio.get_running_loop().run_in_executor(None, self._planner.ask, line).add_done_callback(ended)

    async def read(self, asked: web.Request) -> web.Response:
        """The `areas` of a file that a page sends, or why it is `refused`; its name says which kind it is."""
        return web.json_response((await self._reader.read(asked))[1])


def request(asked: page_messages.Survey, heard: Iterable[Path] = ()) -> bytes:
    """The line that the process is asked with."""
    words = {key: value for key, value in msgspec.to_builtins(asked).items() if key not in ("t", "seq", "boat")}
    words["obstacles"] = [(each.latitude_deg, each.longitude_deg, each.radius_m) for each in asked.obstacles]
    return msgspec.json.encode(words | {"heard": [str(file) for file in heard]})


def _tell(told: dict[str, Any], asked: page_messages.Survey, tell: Tell, answer: Answer) -> None:
    """Passes the answer of the process on, the mission as the page has it."""
    if "refused" in told:
        return answer(False, str(told["refused"]))
    for its in filter(None, (told, *told["shares"])):
        its["mission"] = page_of(msgspec.convert(its["mission"], Mission))
    tell({"t": "survey", "boat": asked.boat, "seq": asked.seq, **told})
    return answer(True, "")
