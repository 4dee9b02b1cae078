"""Adoption from the page: a trial of the boat's motors and hull, in a process of its own (`delfim.adoption.trial.linked`).

The gateway passes its orders to the boat, and to it what is heard of the boat. **Any order of a page to that boat ends the
trial**, STOP first of all, and so does the last page that closes: no order of the trial goes out after it.
"""

import asyncio
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from threading import Thread
from typing import Any, Final

import msgspec
from aiohttp import web

from delfim import config
from delfim.base.errors import DelfimError, Refused
from delfim.console.boats.boat import Boat
from delfim.console.boats.fleet import Fleet
from delfim.console.gateway import page_messages
from delfim.console.link.mavlink import SAILS_BY, SENSED, SENSED_VALUES, mavlink

STEPS: Final = 14  # manoeuvres of a whole trial, of those that follow each other
LINES_MAX: Final = 300  # sentences that are kept for pages
OFTEN_US: Final = 100_000  # between two words of the boat about its motion, meanwhile
TOLD: Final = ("GLOBAL_POSITION_INT", "ATTITUDE", "SERVO_OUTPUT_RAW")
ARRAY: Final = "DEBUG_FLOAT_ARRAY"  # of what the sensors behind an estimator said
NUMBERS_TOLD: Final = tuple(getattr(mavlink, f"MAVLINK_MSG_ID_{each}") for each in (*TOLD, ARRAY))
OLD_S: Final = 1.0  # an older place or thrust is none
ASK_S: Final = 0.5  # between two questions by which file the boat sails
BUSY: Final = "a trial is under way: end it first"
ENDED: Final = "the page ended it"

Answer = Callable[[bool, str], None]


class Adoption:
    """One trial at a time, of the boat whose file the console has. `tell` is given what pages are shown."""

    def __init__(self, fleet: Fleet, vehicle: Path | None, folder: Path, tell: Callable[[dict[str, Any]], None]) -> None:
        """`folder`: where trials are kept. Where `delfim adopt` has the same, each goes on with what the other one began."""
        self._fleet, self._file, self._folder, self._tell = fleet, vehicle, folder, tell
        self.boat = config.load(vehicle).boat.id if vehicle is not None else None  # whose file it is; None: there is none
        self.shown: dict[str, Any] | None = None  # the trial as pages see it
        self._child: subprocess.Popen[bytes] | None = None
        self._is_sailing = self._is_over = False
        self._last: dict[str, tuple[Any, float]] = {}  # messages of the boat by their kind, and when they were heard
        self._sails_by, self._asked_s = "", -math.inf  # the digest of the boat's file; empty: it has not told it
        fleet.heard = self._hear

    def ask(self, asked: page_messages.Adopt, answer: Answer) -> None:
        """Does what a page asks. Raises Refused."""
        match asked.do:
            case "begin" | "afresh" | "berth":
                self._begin(asked.boat, asked.radius_m, asked.do)
            case "yes" | "no":
                if self.shown is None or not self.shown["question"]:
                    raise Refused("nothing is asked")
                self.shown["question"] = ""
                self._say("QuestionAnswered", yes=asked.do == "yes")
            case "end":
                self._stop_boat()
                self._finish(ENDED)
            case "close":
                if self._child is not None:
                    raise Refused(BUSY)
                self.shown = None
        self._show()
        answer(True, "")

    def acted(self, boat: int | None, why: str) -> None:
        """Somebody gave this boat an order, or every boat (None): its trial is over."""
        if self._is_sailing and self.shown is not None and boat in (None, self.shown["boat"]):
            self._finish(why)

    def _finish(self, why: str) -> None:
        """The trial is over: orders of its process that are on their way are dropped."""
        self._is_sailing, self._is_over = False, True
        if self.shown is not None:
            self.shown["question"] = ""
        self._say("OperatorEnded", why=why)

    def pages_gone(self) -> None:
        """Nobody watches the trial any more."""
        if self._is_sailing:
            self._stop_boat()
            self._finish("no page is open")

    def close(self) -> None:
        if self._child is not None:
            self._child.kill()

    def _stop_boat(self) -> None:
        """Of a trial under way; the boat's answer is seen in its mode."""
        if self._is_sailing and self.shown is not None:
            with suppress(DelfimError):
                self._fleet.command(self.shown["boat"], "stop", {}, lambda well, why: None)

    def _begin(self, number: int, radius_m: float, what: str) -> None:
        if self._child is not None:
            raise Refused(BUSY)
        if self._file is None or number != self.boat:
            raise Refused("a trial needs the boat's own file: start delfim console with --vehicle FILE")
        if number not in self._fleet.boats:
            raise Refused(f"no boat {number}")
        command = [sys.executable, "-m", "delfim.adoption.trial.linked", str(self._file), f"--radius={radius_m:g}"]
        command += [f"--output={self._folder}", *([] if what == "begin" else [f"--{what}"])]
        self._sails_by, self._asked_s = "", -math.inf
        nothing = subprocess.DEVNULL
        self._is_sailing = self._is_over = False
        self._child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=nothing)
        assert self._child.stdin is not None
        with suppress(OSError, AttributeError):
            os.set_blocking(self._child.stdin.fileno(), False)  # a process that does not read must not hold the gateway
        file = str(self._file)
        self.shown = {"t": "adoption", "boat": number, "is_running": True, "circle": None, "steps": [], "part": 0.0}
        self.shown |= {"lines": [], "question": "", "end": "", "file": file, "is_written": False, "report": False}
        self._fleet.often(number, NUMBERS_TOLD, OFTEN_US)
        Thread(target=self._listen, args=(self._child, asyncio.get_running_loop()), daemon=True).start()

    def _listen(self, child: "subprocess.Popen[bytes]", loop: asyncio.AbstractEventLoop) -> None:
        """In a thread of its own, until the process ends."""
        assert child.stdout is not None
        with suppress(RuntimeError):  # the loop has ended
            for line in child.stdout:
                loop.call_soon_threadsafe(self._take, json.loads(line))
            child.wait()
            loop.call_soon_threadsafe(self._over)

    def _over(self) -> None:
        """The process has ended, whatever it said before."""
        self._is_sailing, self._child = False, None
        if self.shown is None:
            return
        self._fleet.often(self.shown["boat"], NUMBERS_TOLD, 0)
        report = self.report
        self.shown |= {"is_running": False, "question": "", "report": report is not None and report.exists()}
        self._show()

    def _take(self, said: dict[str, Any]) -> None:
        """A line of the process."""
        shown = self.shown
        if shown is None:
            return
        match said:
            case {"order": dict(order)}:
                self._order(shown["boat"], "trial", order, is_answered=bool(order["begin"]))
                return
            case {"steer": dict(words)}:  # of the proof sail
                self._order(shown["boat"], str(words.pop("command")), words, is_answered=True)
                return
            case {"end": str(mode)}:
                if self._is_sailing:
                    word = ("stop", {}) if mode == "idle" else ("mode", {"mode": mode})
                    with suppress(DelfimError):
                        self._fleet.command(shown["boat"], *word, lambda well, why: None)
                return
            case {"sailed": True}:
                self._is_sailing = False
            case {"circle": dict(circle)}:
                shown["circle"] = circle
            case {"tell": str(words)}:
                shown["lines"] = [*shown["lines"], words][-LINES_MAX:]
                shown["is_written"] |= "is written" in words
            case {"ask": str(question)}:
                shown["question"] = question
            case {"step": dict(step)}:
                before = [each for each in shown["steps"] if each["state"] != "under way"]
                shown["steps"] = [*before, step]
                done = {each["name"] for each in shown["steps"] if each["state"] == "done"} - {"back"}
                shown["part"] = min(len(done) / STEPS, 1.0)
            case {"done": well, "why": str(why)}:
                shown["part"], shown["end"] = (1.0, "done") if well else (shown["part"], why)
        self._show()

    def _order(self, number: int, command: str, words: dict[str, Any], *, is_answered: bool) -> None:
        def answered(well: bool, why: str) -> None:
            if is_answered:
                self._say("OrderAnswered", refused="" if well else why or "refused")

        if self._is_over:
            return answered(False, "the trial is over")
        self._is_sailing = True
        try:
            self._fleet.command(number, command, words, answered)
        except DelfimError as error:
            answered(False, str(error))
        return None

    def _hear(self, boat: Boat, message: Any, now_s: float) -> None:
        """A message of any boat; with each attitude the process hears of its own."""
        kind = message.get_type()
        if self._child is None or self.shown is None or boat.number != self.shown["boat"]:
            return
        if kind == "PARAM_EXT_VALUE" and message.param_id == SAILS_BY:
            self._sails_by = message.param_value
        elif kind in TOLD or (kind == ARRAY and message.name.rstrip("\0") == SENSED):
            self._last[kind] = message, now_s
        if not self._sails_by and now_s - self._asked_s > ASK_S:
            self._asked_s = now_s
            self._fleet.ask_text(boat.number, SAILS_BY)
        if kind != "ATTITUDE" or any(now_s - self._last.get(each, (None, -math.inf))[1] > OLD_S for each in TOLD):
            return
        place, servos = self._last["GLOBAL_POSITION_INT"][0], self._last["SERVO_OUTPUT_RAW"][0]
        if (place.lat, place.lon) == (0, 0):
            return
        self._say(
            "BoatHeard",
            at_s=message.time_boot_ms / 1e3,
            latitude_deg=place.lat / 1e7,
            longitude_deg=place.lon / 1e7,
            heading_deg=math.degrees(message.yaw),
            turn_dps=math.degrees(message.yawspeed),
            north_mps=place.vx / 100.0,
            east_mps=place.vy / 100.0,
            port=_part(servos.servo1_raw),
            starboard=_part(servos.servo3_raw),
            turned=_part(servos.servo2_raw),
            each=_each(servos),
            mode=boat.mode,
            reason=boat.reason.partition(": ")[2] if boat.reason.startswith(f"{boat.mode}: ") else boat.reason,
            measured=_sensed(*self._last.get(ARRAY, (None, -math.inf)), now_s),
            sails_by=self._sails_by,
        )

    def _say(self, kind: str, **words: Any) -> None:
        """A line for the process, which ends where it does not take it."""
        child = self._child
        if child is None or child.stdin is None:
            return
        try:
            child.stdin.write(msgspec.json.encode({"type": kind} | words) + b"\n")
            child.stdin.flush()
        except OSError:
            child.kill()

    def _show(self) -> None:
        self._tell(self.shown or {"t": "adoption", "boat": None})

    # Files of the last trial.

    @property
    def report(self) -> Path | None:
        return None if self._file is None else self._folder / f"{self._file.stem}.html"

    async def serve_report(self, request: web.Request) -> web.StreamResponse:
        """The report of the last trial, to look at."""
        if self.report is None or not self.report.exists():
            raise web.HTTPNotFound(text="there is no report\n")
        return web.FileResponse(self.report)

    async def serve_file(self, request: web.Request) -> web.StreamResponse:
        """The boat's file as it is now, to be put aboard."""
        if self._file is None:
            raise web.HTTPNotFound(text="the console has no file of a boat: --vehicle FILE\n")
        named = {"Content-Disposition": f'attachment; filename="{self._file.name}"'}
        return web.FileResponse(self._file, headers=named)


def _each(servos: Any) -> list[float]:
    """Parts of full command of each thruster of a boat with more than two; nothing of another, and of an older program."""
    pulses = (servos.servo5_raw, servos.servo6_raw, servos.servo7_raw, servos.servo8_raw)
    return [_part(pulse) for pulse in takewhile(bool, pulses)]


def _part(pulse: int) -> float:
    """Of full command, as SERVO_OUTPUT_RAW has it."""
    return (pulse - 1500) / 500.0


def _sensed(array: Any, heard_s: float, now_s: float) -> dict[str, list[float]] | None:
    """What each sensor behind the estimator said last, its time on the boat's clock first; None: there is no estimator."""
    if array is None or now_s - heard_s > OLD_S:
        return None
    told, numbers = dict[str, list[float]](), iter(array.data)
    for name, count in SENSED_VALUES.items():
        age_s, *value = (next(numbers) for _ in range(1 + count))
        if math.isfinite(age_s) and all(map(math.isfinite, value)):
            told[name] = [array.time_usec / 1e6 - age_s, *value]
    return told
