"""A mission's text is read in a process that has bounds: whatever the text, the boat's own process reads no TOML."""

import asyncio
import sys
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import pytest

from delfim.base.cooperative import SLICE, Sliced
from delfim.base.errors import FormatError, Refused
from delfim.vehicle.operator.command import CommandServer
from delfim.vehicle.operator.link import Link
from delfim.vehicle.operator.reviews import Reviews
from delfim.vehicle.plans.mission import canonical, load_mission
from delfim.vehicle.plans.missionreader import ZONE, Reading, gathered, written
from delfim.vehicle.snapshot import in_json
from tests.vehicle.test_reviews import mission, zones

FILES = sorted((Path(__file__).parents[2] / "etc/missions").glob("*.toml"))
LARGE = "".join(f"[k{i}.a.b.c.d.e]\n" for i in range(55_000))  # a megabyte of it is a quarter of a gigabyte of tables


@pytest.mark.parametrize(
    "made",
    [*FILES, mission(2), mission(1000, 1000, zones())],
    ids=lambda made: made.stem if isinstance(made, Path) else f"{len(made.waypoint)} waypoints",
)
def test_a_mission_is_put_together_as_it_was_in_slices(made, monkeypatch):
    made = load_mission(made) if isinstance(made, Path) else made
    work, spent = Sliced(gathered([line.rstrip() for line in written(made)])), 0
    while not work.step():
        assert work.spent - spent < SLICE + ZONE
        spent = work.spent
    assert work.result == made


def test_a_text_comes_back_as_its_mission_or_with_what_is_wrong():
    made = mission(5, 3, zones(2))
    assert Sliced(gathered(Reading(canonical(made)).lines())).finish() == made
    wrong = Reading("version = 2").lines()
    assert isinstance(wrong, FormatError)
    assert str(wrong).startswith("mission: version: ")


def test_ctrl_c_at_the_terminal_is_not_for_it():
    """It printed the traceback of its imports there."""
    reading = Reading("")
    reading._program = (sys.executable, "-c", "import os; print(os.getsid(0) == os.getpid())")
    assert reading.lines() == [b"True"]


@pytest.mark.parametrize(
    ("text", "cpu_s"), [pytest.param(LARGE, 1, id="time"), pytest.param(LARGE, 60, id="memory", marks=pytest.mark.long)]
)
def test_a_text_that_takes_too_much_is_given_up_in_words(text, cpu_s):
    told = Reading(text, cpu_s).lines()
    assert str(told) == "mission: its text takes too much time or memory to read; make it shorter"


async def test_a_stop_ends_the_reading(boat, tmp_path):
    """The process, too: otherwise the worker would not end."""
    boat.ready()

    def talk() -> None:
        def ask() -> str:
            with Link(tmp_path / "command") as link, pytest.raises(Refused) as refusal:
                link.ask("mission", text=LARGE)
            return str(refusal.value)

        with ThreadPoolExecutor() as asking, Link(tmp_path / "command") as link:
            asked = asking.submit(ask)
            while not wait([asked], 0.1).done:
                link.ask("stop")
            assert asked.result() == "refused: a stop was commanded"

    def obey(command, operator="local"):
        reviews.hear(command, operator)
        return boat.vehicle.on_command(command, operator)

    reviews = Reviews(boat.vehicle, obey, asyncio.get_running_loop())
    server = CommandServer(obey, reviews, lambda: in_json(boat.vehicle.report()), 4)
    listening = await asyncio.get_running_loop().create_unix_server(server.connection, str(tmp_path / "command"))
    await asyncio.to_thread(talk)
    server.close()
    listening.close()
