"""A voyage seen from outside: what is judged, and when it is over."""

import argparse
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from delfim import config
from delfim.base.errors import Refused
from delfim.console.terminal import onlooker
from delfim.console.terminal.onlooker import Voyage
from delfim.vehicle.plans.mission import Mission, load_mission

FILE = Path(__file__).parents[2] / "etc/delfimx.toml"


def state(mode: str, reason: str) -> dict[str, Any]:
    return {"mode": mode, "reason": reason, "operator": "local", "notices": []}


class Boat:
    """Both ends of the command socket: what it publishes, and what it answers."""

    def __init__(
        self, published: list[dict[str, Any]], now: dict[str, Any], refuses: str = "", refused: str = "mission"
    ) -> None:
        self.published, self.now, self.refuses, self.asked = published, now, refuses, list[str]()
        self._refused = refused  # the command

    def ask(self, command: str, **words: object) -> dict[str, Any]:
        self.asked.append(command)
        if command == self._refused and self.refuses:
            raise Refused(self.refuses)
        return self.now

    def watch(self) -> Iterator[dict[str, Any]]:
        yield from self.published

    def __enter__(self) -> "Boat":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def poll(self) -> None:
        pass


def sailed(boat: Boat, monkeypatch: pytest.MonkeyPatch, *, console: bool = False, for_s: float | None = None) -> Voyage:
    settings = config.load(FILE)
    asked = argparse.Namespace(console=console, for_s=for_s, json=True, plain=False)
    mission: Mission = load_mission(config.mission_place(str(FILE), settings))
    monkeypatch.setattr(onlooker, "_connected", lambda path, process: boat)
    its = Voyage(asked, settings, mission)
    its._watch(lambda state, words: None, boat)  # type: ignore[arg-type]
    return its


def test_a_state_of_before_play_that_is_read_after_it_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    waiting = [state("idle", "started")] * 5
    boat = Boat([*waiting, state("play", "operator"), state("idle", "play done")], state("play", "operator"))
    assert sailed(boat, monkeypatch).end.startswith("mission done in ")


def test_a_boat_that_stops_before_anybody_saw_it_play_ends_the_voyage(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter(range(100))
    monkeypatch.setattr(onlooker.time, "monotonic", lambda: 2.0 * next(times))
    boat = Boat([state("idle", "started")] * 5, state("idle", "log not written: stop"))
    assert sailed(boat, monkeypatch).end == "stopped: log not written: stop"


def test_with_a_console_a_stop_while_the_mission_is_loaded_leaves_the_boat_to_its_operator(monkeypatch, capsys):
    words = "mission refused: a stop was commanded"
    boat = Boat([state("idle", "operator")] * 3, state("idle", "operator"), words)
    its = sailed(boat, monkeypatch, console=True)
    assert (its.end, "play" in boat.asked) == ("", False)
    assert capsys.readouterr().err == f"delfim: {words}; it is the console's now\n"
    with pytest.raises(Refused):
        sailed(boat, monkeypatch)


def test_with_a_console_a_boat_that_was_started_again_is_left_to_what_it_keeps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same mission, sent again, would be a command: it ends the return to the voyage."""
    boat = Boat([state("play", "operator")] * 3, state("play", "operator"))
    its = sailed(boat, monkeypatch, console=True)
    assert boat.asked.count("mission") == boat.asked.count("play") == 1
    boat.published = [state("hold", "restarted: it was in play on leg 1")] * 3
    its._watch(lambda state, words: None, boat)  # type: ignore[arg-type]
    assert boat.asked.count("mission") == boat.asked.count("play") == 1


def test_a_console_that_was_killed_is_told_once_with_the_words_that_start_it_again(monkeypatch, capsys) -> None:
    with subprocess.Popen([sys.executable, "-c", "", "console", "--token", "my boats/token"]) as gone:
        gone.wait()
    boat = Boat([state("path", "operator")] * 3, state("path", "operator"))
    its = sailed(boat, monkeypatch, console=True)
    its.gateway = gone
    capsys.readouterr()
    for _ in range(2):
        its._watch(lambda state, words: None, boat)  # type: ignore[arg-type]
    told = "delfim: the console has ended, the boat sails on; again, in another terminal: "
    assert capsys.readouterr().err == f"{told}delfim console --token 'my boats/token'\n"


def test_why_a_boat_does_not_play_is_told_when_it_lasts_and_at_the_end(monkeypatch, capsys):
    times = iter(range(1000))
    monkeypatch.setattr(onlooker.time, "monotonic", lambda: 1.0 * next(times))
    words = "play refused: no heading: position and velocity only"
    boat = Boat([state("idle", "started")] * 100, state("idle", "started"), words, "play")
    assert sailed(boat, monkeypatch, for_s=60.0).end == f"time: 60 s sailed, mode idle; {words}"
    assert capsys.readouterr().err == f"delfim: {words}\n"
