"""The local command socket: a real UNIX socket, the real client beside it."""

import asyncio
import contextlib
import json
import os
import pty
import subprocess
import sys
import threading
from collections.abc import Callable

import pytest

from delfim.base.errors import DelfimError, FormatError, Refused
from delfim.base.modes import Mode
from delfim.console.terminal.drive import command, line
from delfim.vehicle import console
from delfim.vehicle.operator.command import LINE_BYTES, CommandServer
from delfim.vehicle.operator.link import Link
from delfim.vehicle.operator.reviews import Reviews
from delfim.vehicle.snapshot import in_json


def served(boat, tmp_path, talk: Callable[[str], object], clients_max: int = 4) -> object:
    """Serve a boat's commands on a loop while `talk` runs in a thread with the socket's path; what talk returned."""

    async def both() -> object:
        reviews = Reviews(boat.vehicle, boat.vehicle.on_command, asyncio.get_running_loop())
        server = CommandServer(boat.vehicle.on_command, reviews, lambda: in_json(boat.vehicle.report()), clients_max)
        path = str(tmp_path / "command")
        listening = await asyncio.get_running_loop().create_unix_server(server.connection, path)
        boat.server = server
        try:
            return await asyncio.wait_for(asyncio.to_thread(talk, path), 20)
        finally:
            server.close()
            listening.close()

    return asyncio.run(both())


def test_a_command_is_carried_out_and_the_state_comes_back(boat, tmp_path):
    boat.ready()

    def talk(path: str) -> object:
        with Link(path) as link:
            return link.ask("heading", heading_deg=90.0, speed_mps=1.0)

    state = served(boat, tmp_path, talk)
    assert state["mode"] == "heading"
    assert "heading" in line(state)


def test_a_refusal_carries_its_reason(boat, tmp_path):
    def talk(path: str) -> None:
        with Link(path) as link:
            link.ask("mode", mode="hold")

    with pytest.raises(Refused, match="no navigation yet"):
        served(boat, tmp_path, talk)


def test_watchers_get_every_published_state_and_commands_still_work(boat, tmp_path):
    def talk(path: str) -> list[int]:
        with Link(path) as watcher, Link(path) as other:
            states = watcher.watch()
            seen = [next(states)["cycle"]]
            for _ in range(3):
                other.ask("state")
                boat.server.publish()
                seen.append(next(states)["cycle"])
            return seen

    assert served(boat, tmp_path, talk) == [0, 0, 0, 0]


def test_quick_watchers_get_the_states_between_too(boat, tmp_path):
    """The vehicle publishes ten times a second, every second time for everyone."""

    def talk(path: str) -> tuple[list[int], list[int]]:
        with Link(path) as slow, Link(path) as quick:
            slow.ask("watch")
            quick.ask("watch", quick=True)
            for cycle in range(1, 5):
                boat.vehicle.state.cycles = cycle
                boat.server.publish(everyone=cycle % 2 == 0)
            return [slow._reply()["state"]["cycle"] for _ in range(2)], [quick._reply()["state"]["cycle"] for _ in range(4)]

    assert served(boat, tmp_path, talk) == ([2, 4], [1, 2, 3, 4])


def test_one_client_too_many_is_told(boat, tmp_path):
    def talk(path: str) -> None:
        with Link(path) as first, Link(path) as second:
            first.ask("state")
            second.ask("state")

    with pytest.raises(Refused, match="too many connections"):
        served(boat, tmp_path, talk, clients_max=1)


def test_an_endless_line_ends_the_connection(boat, tmp_path):
    def talk(path: str) -> None:
        with Link(path) as link:
            link.ask("x" * (LINE_BYTES + 100))

    with pytest.raises((DelfimError, OSError)):
        served(boat, tmp_path, talk)


def test_nobody_there(tmp_path):
    with pytest.raises(DelfimError, match="is it running"):
        Link(tmp_path / "nowhere")


GOTO = {"command": "goto", "latitude_deg": 38.69, "longitude_deg": -9.21}


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        ("stop", {"command": "stop"}),
        ("heading 90 1.5", {"command": "heading", "heading_deg": 90.0, "speed_mps": 1.5}),
        ("course 90 1.5", {"command": "course", "course_deg": 90.0, "speed_mps": 1.5}),
        ("heading 90", {"command": "heading", "heading_deg": 90.0}),
        ("hold", {"command": "mode", "mode": "hold"}),
        ("mode path", {"command": "mode", "mode": "path"}),
        ("play", {"command": "play"}),
        ("play 1", {"command": "play", "leg": 0}),
        ("goto", {"command": "goto"}),
        ("goto 38.69 -9.21", GOTO),
        ("goto idle", {"command": "goto", "end": "idle"}),
        ("goto 38.69 -9.21 1.5 idle", {**GOTO, "speed_mps": 1.5, "end": "idle"}),
        ("goto 38.69 -9.21 hold", {**GOTO, "end": "hold"}),
        ("pause", {"command": "pause"}),
        ("continue", {"command": "continue"}),
        ("speed", {"command": "speed"}),
        ("manual 0.5 -0.5", {"command": "manual", "starboard": 0.5, "port": -0.5}),
    ],
)
def test_words_of_the_prompt(words, asked):
    assert command(words.split()) == asked
    json.dumps(asked)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("fly high", "no command 'fly'; there are state, "),
        ("heading", "heading_deg is missing: heading heading_deg [speed_mps]"),
        ("heading north", "heading_deg must be a number, not 'north': heading heading_deg [speed_mps]"),
        ("heading nan", "heading_deg must be a number, not 'nan'"),
        ("goto 38.69", "longitude_deg is missing: goto [latitude_deg longitude_deg] [speed_mps] [end]"),
        ("goto 38.69 -9.21 1.5 drift", "end must be hold or idle, not 'drift'"),
        ("manual 1", "port is missing: manual starboard port"),
        ("manual 1 1 1", "'1' is too much: manual starboard port"),
        ("hold here", "'here' is too much: hold"),
        ("play 0", "leg must be a whole number from 1 on, not '0': play [leg]"),
        ("play 1.5", "leg must be a whole number from 1 on, not '1.5'"),
        ("mode", "name is missing: mode name"),
        ("mission /no/such/file", "/no/such/file: No such file"),
    ],
)
def test_words_that_mean_nothing_are_refused_with_what_is_right(words, why):
    with pytest.raises(FormatError) as refusal:
        command(words.split())
    assert str(refusal.value).startswith(why)


def keyboard(path: str, *typed: bytes) -> str:
    """What stands on the terminal after all of this was typed at the prompt, each part once the prompt is there."""
    here, there = pty.openpty()
    program = f"from delfim.console.terminal.drive import run; run({path!r}, [])"
    shown = b""
    with subprocess.Popen([sys.executable, "-c", program], stdin=there, stdout=there, stderr=there) as process:
        os.close(there)
        for keys in (*typed, b"quit\r"):
            before = len(shown)
            while b"delfim> " not in shown[before:]:
                shown += os.read(here, 4096)
            os.write(here, keys)
        with contextlib.suppress(OSError):  # the other end is closed
            while more := os.read(here, 4096):
                shown += more
        assert process.wait(200) == 0
    os.close(here)
    return shown.decode()


def test_the_prompt_has_a_sign_completes_words_and_remembers_them(boat, tmp_path):
    boat.ready()
    shown = served(boat, tmp_path, lambda path: keyboard(path, b"hea\t90 1\r", b"\x1b[A\r", b"help heading\r", b"heading\r"))
    assert shown.count("delfim> heading 90 1") == 2
    assert shown.count("heading 38.692500 -9.215000") == 2, shown
    assert "heading heading_deg [speed_mps]" in shown
    assert "heading_deg is missing" in shown
    assert boat.state.mode is Mode.HEADING


def test_the_prompt_tells_that_somebody_is_there_while_it_waits(boat, tmp_path):
    heard = threading.Event()
    obey = boat.vehicle.on_command

    def obeyed(command, operator="local"):
        if isinstance(command, console.Alive):
            heard.set()
        return obey(command, operator)

    boat.vehicle.on_command = obeyed

    def talk(path: str) -> bool:
        with subprocess.Popen(
            [sys.executable, "-c", f"from delfim.console.terminal.drive import run; run({path!r}, [])"], stdin=subprocess.PIPE
        ) as process:
            told = heard.wait(200)
            process.communicate()
            return told and process.returncode == 0

    assert served(boat, tmp_path, talk)
