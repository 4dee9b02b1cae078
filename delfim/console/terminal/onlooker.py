"""A mission sailed in real time by a boat of this computer, seen from outside: loaded, played, shown while it lasts."""

import argparse
import contextlib
import json
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any, Final, cast

from delfim import config
from delfim.base.errors import DelfimError, Refused
from delfim.console.terminal.drive import line
from delfim.vehicle.operator.link import Link
from delfim.vehicle.plans.mission import Mission, canonical

START_S: Final = 60.0  # the suite must answer within this time: a busy machine loads it slowly
PATIENCE_S: Final = 5.0  # a boat that has all it needs is fit to play by then
CTRL_C, GONE = "ended by Ctrl-C", "the vehicle's program has ended"

Show = Callable[[dict[str, Any], str], None]  # a state, and words beside it


class Voyage:
    """A mission sailed in real time, seen from outside: shown while it lasts, summed up afterwards. One without waypoints is
    not loaded: the boat lies in idle until its console commands."""

    def __init__(self, asked: argparse.Namespace, settings: config.Vehicle, mission: Mission) -> None:
        self._asked, self._settings, self._mission = asked, settings, mission
        self._began_s, self.began_utc_s = time.monotonic(), time.time()
        self._played_s: float | None = (
            None if mission.waypoint else self._began_s
        )  # nothing to play: the boat keeps what is aboard
        self._last: dict[str, Any] | None = None  # state
        self.address, self.end = "", ""
        self.gateway: subprocess.Popen[bytes] | None = None  # the console's program
        self._waits, self._told = "", ""  # why it is not played yet, and what of it was told
        self.troubles = dict[str, str]()  # troubles of the boat: the last words about each

    def sail(self, boat: "subprocess.Popen[bytes]") -> None:
        """Load the mission, play it as soon as the boat is fit, and watch until it ends; with a console until Ctrl-C. Raises
        DelfimError where the boat never answers, and Refused where it refuses the mission: with a console its operator may have
        stopped it meanwhile, and goes on."""
        with shown(self._asked, self._mission) as show:
            while not self.end:
                try:
                    self._watch(show, boat)
                except Refused:
                    raise
                except DelfimError:  # its program ended; with a console it is watched again when it was started again
                    if self._last is None:
                        raise
                    show(self._last, f"{self._words()}  THE BOAT DOES NOT ANSWER")
                    if boat.poll() is not None or not self._asked.console:
                        self.end = GONE

    def _watch(self, show: Show, boat: "subprocess.Popen[bytes]") -> None:
        socket = self._settings.console.socket
        with _connected(socket, boat) as operator, _connected(socket, boat) as onlooker:
            if self._played_s is None:  # a boat that was started again goes on with its own, and a command would end that
                self._load(operator)
            self._began_s = time.monotonic() if self._last is None else self._began_s
            for state in self._watched(operator, onlooker):
                self._last = state
                show(state, self._words())

    def _load(self, operator: Link) -> None:
        try:
            operator.ask("mission", text=canonical(self._mission))
            if not self._settings.adopted.proven:
                print(
                    "delfim: her motors are not proven, so nothing is played: *Adopt…* on the page, or delfim adopt", flush=True
                )
                self._played_s = time.monotonic()
        except Refused as refused:
            if not self._asked.console:
                raise
            print(f"delfim: {refused}; it is the console's now", file=sys.stderr, flush=True)
            self._played_s = time.monotonic()

    def _watched(self, operator: Link, onlooker: Link) -> Iterator[dict[str, Any]]:
        alive_s, is_under_way = 0.0, False
        for state in onlooker.watch():
            yield state
            now_s, newest = time.monotonic(), state
            if now_s - alive_s > 1.0:
                alive_s = now_s
                with contextlib.suppress(Refused):  # not heard: a fault by command
                    newest = operator.ask("alive")
                self._missed()
            if self._played_s is None:
                self._play(operator, now_s)
            elif (is_under_way := is_under_way or state["mode"] != "idle") or newest is not state:
                # what the onlooker was told before "play" may still wait to be read
                self.end, sailed_s = self._ended(newest), now_s - self._played_s
                news = (notice for notice in newest["notices"] if notice["age_s"] < sailed_s)  # not those of the start
                self.troubles |= {notice["name"]: notice["reason"] for notice in news}
            if self._asked.for_s is not None and now_s - self._began_s > self._asked.for_s:
                self.end = f"time: {self._asked.for_s:.0f} s sailed, mode {state['mode']}{self._waits and f'; {self._waits}'}"
            if self.end:
                return

    def _missed(self) -> None:
        """Say once that the console's program has ended, and how to have it again: the boat sails on."""
        if self.gateway is None or self.gateway.poll() is None:
            return
        again = shlex.join(["delfim", *cast(list[str], self.gateway.args)[3:]])
        print(f"delfim: the console has ended, the boat sails on; again, in another terminal: {again}", file=sys.stderr)
        self.gateway, self.address = None, ""

    def _play(self, operator: Link, now_s: float) -> None:
        """Play the mission, if the boat is fit. Says why not where that lasts: a boat without a compass never is."""
        try:
            operator.ask("play")
            self._played_s, self._waits = now_s, ""
        except Refused as refused:
            self._waits = str(refused)
            if now_s - self._began_s > PATIENCE_S and self._waits != self._told:
                self._told = self._waits
                print(f"delfim: {self._waits}", file=sys.stderr, flush=True)

    def _ended(self, state: dict[str, Any]) -> str:
        """How the mission ended, in words. Where there is a console, its operator goes on."""
        if self._asked.console or state["operator"] != "local" or not self._settings.adopted.proven:
            return ""
        if state["reason"].startswith("play done"):
            return f"mission done in {time.monotonic() - self._began_s:.0f} s"
        return f"stopped: {state['reason']}" if state["mode"] == "idle" else ""

    def _words(self) -> str:
        """The words beside a state: the time, the console's address, and how to end the simulation."""
        return f"{self.time()}  {f'console {self.address}  ' if self.address else ''}Ctrl-C ends"

    def time(self) -> str:
        """Since the mission was loaded: h:mm:ss."""
        seconds = int(time.monotonic() - self._began_s)
        return f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}"


def _connected(path: str, boat: "subprocess.Popen[bytes]") -> Link:
    """A link to the vehicle as soon as it listens. Raises DelfimError when it does not within START_S."""
    until = time.monotonic() + START_S
    while True:
        try:
            return Link(path)
        except DelfimError:
            if boat.poll() is not None:
                raise DelfimError("the boat's program has ended; its error stands above") from None
            if time.monotonic() > until:
                raise
            time.sleep(0.02)


@contextlib.contextmanager
def shown(asked: argparse.Namespace, mission: Mission) -> Iterator[Show]:
    """How states are shown, with a few words beside each: a live view, one line a second, or JSON."""
    if asked.json:
        yield lambda state, words: print(json.dumps(state), flush=True)
    elif asked.plain or not sys.stdout.isatty() or find_spec("rich") is None:
        last = [0.0]

        def plain(state: dict[str, Any], words: str) -> None:
            if time.monotonic() - last[0] >= 1.0:
                last[0] = time.monotonic()
                path = "/".join(f"{state['latency'][name]:.0f}" for name in ("p50_us", "p99_us", "worst_us"))
                print(f"{words.split()[0]}  {line(state)}  path {path} us", flush=True)

        lacks = "" if asked.plain or not sys.stdout.isatty() else "; the live view needs delfim[ground]"
        print(f"delfim: Ctrl-C ends{lacks}", flush=True)
        yield plain
    else:
        from rich.live import Live

        from delfim.console.terminal.view import View

        view = View([(w.latitude_deg, w.longitude_deg) for w in mission.waypoint], mission.name)
        with Live(view.render(), refresh_per_second=5, screen=True) as live:

            def lively(state: dict[str, Any], words: str) -> None:
                view.feed(state, words)
                live.update(view.render(*live.console.size))

            yield lively
            live.stop()
