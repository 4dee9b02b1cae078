"""The soak for half a minute: it runs, everybody is served, nothing is left open. The hour is `python -m bench soak`."""

import asyncio
import contextlib
import ftplib
import json
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from bench.__main__ import main
from bench.critical_path import running
from bench.soak import LOGS_WRITTEN, Sample, busiest, grown, oldest_log
from delfim.services.access.connection_limits import hashed
from delfim.services.files import ftpd
from delfim.services.tables import Ftpd, FtpUser
from tests.services.boat import served, vehicle_file

VEHICLE = str(Path(__file__).parents[2] / "etc" / "delfimx.toml")
MEGABYTE = 1 << 20


def test_what_grows_is_told() -> None:
    flat = [Sample(50 * MEGABYTE, 30, 6)] * 30
    assert grown(flat)["grown"] == []
    assert grown([each._replace(memory_bytes=(50 + n) * MEGABYTE) for n, each in enumerate(flat)])["grown"] == ["memory_bytes"]
    assert grown([each._replace(descriptors=30 + n) for n, each in enumerate(flat)])["grown"] == ["descriptors"]
    assert grown([each._replace(tasks=6 + n) for n, each in enumerate(flat)])["grown"] == ["tasks"]


def test_what_comes_and_goes_does_not_count_nor_what_is_loaded_in_the_first_third() -> None:
    samples = [Sample(50 * MEGABYTE, 30 + 9 * (n % 2), 6 + 9 * (n % 2)) for n in range(30)]
    assert grown([Sample(20 * MEGABYTE, 10, 2)] * 10 + samples[10:])["grown"] == []


def test_who_keeps_the_processor_is_told() -> None:
    with running([sys.executable, "-c", "while True: pass"]) as spins, running(["sleep", "60"]) as sleeps:
        told = busiest({sleeps.pid: "sleeps", spins.pid: "spins"}, seconds=0.2)
    assert re.fullmatch(r"spins \d+%(, sleeps \d+%)?", told)


class Stepped(ftplib.FTP):
    """Whenever the log's own folder was listed, the log gets the name that another time gives it, so many times."""

    def __init__(self, root: Path, times: int) -> None:
        super().__init__(timeout=30.0)
        self._root, self._days = root, [f"202611{day}" for day in range(22, 22 - times, -1)]

    def mlsd(self, path: str = "", facts: Iterable[str] = ()) -> Iterator[tuple[str, dict[str, str]]]:
        listed = list(super().mlsd(path, facts))
        if path.endswith("/state/") and self._days:
            (day,) = self._root.glob("2*")
            day.rename(self._root / self._days.pop())
        return iter(listed)


@pytest.mark.parametrize(("times", "got"), [(0, b"records"), (LOGS_WRITTEN, b"records"), (LOGS_WRITTEN + 1, b"550")])
def test_a_log_that_the_clock_gave_another_name_after_it_was_listed_is_looked_for_again(
    tmp_path: Path, times: int, got: bytes
) -> None:
    users = {"bench": FtpUser(password=hashed("sesame"))}
    table = Ftpd(listen="127.0.0.1:0", root=str(tmp_path / "log"), users=users)
    settings = vehicle_file(tmp_path, ftpd=table)
    (tmp_path / "log/20261123/state").mkdir(parents=True)
    (tmp_path / "log/20261123/state/101500.state.gz").write_bytes(b"records")

    def visit(port: int) -> bytes:
        with contextlib.closing(Stepped(tmp_path / "log", times)) as ftp:
            ftp.connect("127.0.0.1", port)
            ftp.login("bench", "sesame")
            try:
                with oldest_log(ftp) as data:
                    return data.recv(100)
            except ftplib.error_perm as error:
                return str(error)[:3].encode()

    async def visited() -> bytes:
        async with served(settings, ftpd.serve, "ftpd") as runtime:
            port = int(str(runtime.board["ftpd"]()["address"]).strip("/").rpartition(":")[2])
            return await asyncio.to_thread(visit, port)

    assert asyncio.run(visited()) == got


@pytest.mark.long
def test_the_whole_suite_is_flat_and_everybody_is_served(tmp_path: Path) -> None:
    """So soon after the start memory still grows: each thread that hashes a password for the first time takes 16 MB."""
    main(["soak", "--minutes", "0.3", "--file", VEHICLE, "--output", str(tmp_path)])
    results = json.loads((tmp_path / "soak.json").read_text())
    assert {row["process"] for row in results["rows"]} == {"supervisor", "runtime", "log writers", "syslogd", "ftpd", "sshd"}
    for row in results["rows"]:
        assert set(row["grown"]) <= {"memory_bytes"}, row
        assert row["memory_bytes"][1] - row["memory_bytes"][0] < 64 * MEGABYTE, row
        assert row["restarts"] == 0
    assert len(results["visits"]) == 7
    assert [kind for kind, visits in results["visits"].items() if visits <= results["failures"].get(kind, 0)] == []
