"""The local command socket: a real UNIX socket, the real client beside it."""

import asyncio
import json
from collections.abc import Callable

import pytest

from delfim.console.drive import command, line
from delfim.console.link import Link
from delfim.errors import DelfimError, FormatError, Refused
from delfim.vehicle.command import LINE_BYTES, CommandServer


def served(boat, tmp_path, talk: Callable[[str], object], clients_max: int = 4) -> object:
    """Serve a boat's commands on a loop while `talk` runs in a thread with the socket's path; what talk returned."""

    async def both() -> object:
        server = CommandServer(boat.vehicle.on_command, lambda: boat.vehicle.snapshot({}), clients_max)
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


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        ("stop", {"command": "stop"}),
        ("heading 90 1.5", {"command": "heading", "heading_deg": 90.0, "speed_mps": 1.5}),
        ("heading 90", {"command": "heading", "heading_deg": 90.0}),
        ("hold", {"command": "mode", "mode": "hold"}),
        ("mode path", {"command": "mode", "mode": "path"}),
        ("play 3", {"command": "play", "leg": 3}),
        ("manual 0.5 -0.5", {"command": "manual", "starboard": 0.5, "port": -0.5}),
    ],
)
def test_words_of_the_prompt(words, asked):
    assert command(words.split()) == asked
    json.dumps(asked)


@pytest.mark.parametrize("words", ["fly", "heading north", "manual 1 1 1", "mode", "mission /no/such/file"])
def test_words_that_mean_nothing(words):
    with pytest.raises(FormatError):
        command(words.split())
