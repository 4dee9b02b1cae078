"""Logs of a boat at a click: from its own daemon, over a link that breaks off, behind every command, and from the real page."""

import asyncio
import json
import os
import random
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from delfim.base.errors import ConfigError, Refused
from delfim.console.boats.boat import Boat
from delfim.console.logs.fetching import LogFetching, sources_of
from delfim.services.access.connection_limits import hashed
from delfim.services.files import ftpd
from delfim.services.tables import Ftpd, FtpUser
from tests.console.chain import PATIENCE_S, operating, select
from tests.console.scenes import choose
from tests.logging.test_fetch import T0_NS, arrived, gz
from tests.services.boat import served, vehicle_file
from tests.services.radio import radio
from tests.services.test_fetch_aboard import port_of

LOGS = {f"20100101/can0/09{minute}000.log.gz": gz(random.Random(minute).randbytes(1_000_000)) for minute in (3, 4)}


class Click:
    """An operator who fetches the logs of a boat, and what the pages hear."""

    def __init__(self, url: str, place: Path) -> None:
        self.told: list[dict[str, Any]] = []
        self.busy, self.now_s = False, 0.0
        self.boat = Boat(1, 0.0)
        self.boat.rename("Alfa")
        self.fetching = LogFetching({"Alfa": url}, place, self.told.append, lambda number: self.busy)

    def begin(self) -> list[tuple[bool, str]]:
        answers: list[tuple[bool, str]] = []
        self.fetching.ask(self.boat, "all", lambda well, why: answers.append((well, why)))
        return answers

    async def until(self, is_so: Callable[[], object]) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not is_so():
                self.now_s += 1.0
                self.fetching.tick({1: self.boat}, self.now_s)
                await asyncio.sleep(0.01)

    def said(self) -> list[str]:
        return [each["text"] for each in self.told if each["t"] == "text"]


@asynccontextmanager
async def clicks(place: Path, breaks_after: int) -> AsyncIterator[Click]:
    users = {"ana": FtpUser(password=hashed("sesame"))}
    table = Ftpd(listen="127.0.0.1:0", root=str(place / "log"), users=users)
    for path, data in LOGS.items():
        file = place / "log" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
        os.utime(file, ns=(T0_NS, T0_NS))
    async with (
        served(vehicle_file(place, ftpd=table), ftpd.serve, "ftpd") as runtime,
        radio(port_of(runtime, "ftpd"), breaks_after) as (_, port),
    ):
        yield Click(f"ftp://ana:sesame@127.0.0.1:{port}/", place / "here")


async def test_they_arrive_over_a_link_that_breaks_off_and_nothing_comes_twice(tmp_path: Path) -> None:
    async with clicks(tmp_path, 700_000) as click:
        answers = click.begin()
        with pytest.raises(Refused, match="being fetched"):
            click.begin()
        await click.until(lambda: answers)
        assert answers == [(True, "")]
        assert arrived(tmp_path / "here/Alfa") == LOGS
        parts = [each["part"] for each in click.told if each["t"] == "progress"]
        assert parts[-1] == 1.0
        assert parts == sorted(parts)
        again = click.begin()
        await click.until(lambda: again)
        assert click.said()[-1].startswith("logs: 0 logs, 0.0 MB")


async def test_an_order_under_way_goes_first_and_what_was_ended_goes_on(tmp_path: Path) -> None:
    async with clicks(tmp_path, 400_000) as click:
        click.busy = True
        answers = click.begin()
        [fetch] = click.fetching._running.values()
        stat = Path(f"/proc/{fetch.child.pid}/stat")
        await click.until(lambda: stat.read_text().rpartition(")")[2].split()[0] == "T")
        assert click.told[-1]["what"] == "logs wait for the link"
        click.busy = False
        await click.until(lambda: fetch.done > 0 or answers)
        ended: list[tuple[bool, str]] = []
        click.fetching.ask(click.boat, "end", lambda well, why: ended.append((well, why)))
        await click.until(lambda: not click.fetching._running)
        assert ended == [(True, "")]
        assert "goes on from here" in click.said()[-1]
        answers = click.begin()
        await click.until(lambda: answers)
        assert arrived(tmp_path / "here/Alfa") == LOGS


def test_a_boat_whose_logs_are_nowhere_and_a_wrong_address_are_refused_in_words(tmp_path: Path) -> None:
    click = Click("sftp://nobody", tmp_path)
    click.boat.rename("Bravo")
    with pytest.raises(Refused, match="--logs 'Bravo=sftp"):
        click.begin()
    with pytest.raises(Refused, match="no logs are being fetched"):
        click.fetching.ask(click.boat, "end", lambda well, why: None)
    for wrong in ("Alfa", "Alfa=http://boat/logs", "../up=sftp://boat/log", "=sftp://boat/log"):
        with pytest.raises(ConfigError):
            sources_of([wrong])
    assert sources_of(["Alfa 2=sftp://ana@boat/log"]) == {"Alfa 2": "sftp://ana@boat/log"}


@pytest.mark.long
async def test_from_the_page(tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    user = f"{{password={json.dumps(hashed('sesame'))}}}"
    more = f'ftpd.listen="127.0.0.1:{port}"', f'ftpd.root="{tmp_path}/1/log"', f"ftpd.users={{ana={user}}}"
    console = f"--logs=boat1=ftp://ana:sesame@127.0.0.1:{port}/", f"--logs-into={tmp_path}/logs"
    async with operating(tmp_path, *more, count=1, console=console) as sea:
        page = sea.page
        await select(page, 1)
        await page.press("Enter")
        await choose(page, "More", "Fetch its logs", "Of its state")
        await page.until("document.getElementById('said').textContent.includes('MB fetched, into')", 60)
        assert list((tmp_path / "logs/boat1").glob("*/state/*.state*"))
        await sea.nothing_amiss()
