"""The soak for half a minute: it runs, everybody is served, nothing is left open. The hour is `python -m bench soak`."""

import json
from pathlib import Path

import pytest

from bench.__main__ import main
from bench.soak import Sample, grown

pytestmark = pytest.mark.long

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


@pytest.mark.timeout(180)
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
