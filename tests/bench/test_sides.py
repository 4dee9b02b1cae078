"""What happens beside the critical path: the benchmark of it runs, and its arithmetic is right. Nothing here judges speed."""

import json
import os
import time
from pathlib import Path

import pytest

from bench import onlooker
from bench.__main__ import main
from bench.floods import KINDS, PAYLOAD, payload
from bench.onlooker import Onlooker, paths_us
from bench.sides import RADIO
from delfim.base.errors import DelfimError
from delfim.canproxy.dsor.messages import BATTERIES_COMMAND, NAVIGATION_ID, NAVIGATION_PRIORITY, Node
from delfim.canproxy.dsor.protocol import Message, segments
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress, CanSocket

pytestmark = pytest.mark.long

VEHICLE = str(Path(__file__).parents[2] / "etc" / "delfimx.toml")


@pytest.mark.parametrize(
    ("asked", "answered", "paths"),
    [
        ([0, 10_000, 20_000], [1_000, 12_000, 23_000], [1.0, 2.0, 3.0]),
        ([0, 10_000, 20_000], [15_000, 21_000], [1.0, 15.0]),  # the second was passed over
        ([0, 10_000, 20_000], [15_000, 15_500, 21_000], [1.0, 5.5, 15.0]),  # both were late
        ([0, 10_000], [500, 600, 11_000], [0.5, 1.0]),  # a command that answers nothing
        ([0], [], []),
    ],
)
def test_each_command_answers_one_message(asked: list[int], answered: list[int], paths: list[float]) -> None:
    assert paths_us(asked, answered, 0, 100_000) == paths


def test_only_messages_of_the_time_count() -> None:
    assert paths_us([0, 10_000, 20_000], [1_000, 12_000, 23_000], 10_000, 20_000) == [2.0]


def navigation(bus: CanSocket, number: int) -> None:
    message = Message(NAVIGATION_PRIORITY, Node.NAVIGATION, Node.BROADCAST, NAVIGATION_ID, bytes(32))
    bus.send_many([(frame.arb, frame.data) for frame in segments(message, number)])


def commanded(bus: CanSocket, witness: CanSocket) -> None:
    """A command that is in all queues when this returns, and what was sent before it too."""
    witness.bind(CanAddress(onlooker.COMMANDS[-1]))
    witness.settimeout(200.0)
    bus.send_many([(arb, BATTERIES_COMMAND.pack(1, 0)) for arb in onlooker.COMMANDS])
    witness.recvmsg()


def test_the_onlooker_needs_not_look_while_it_happens() -> None:
    name, begin_ns = f"canloop:onlooker-{os.getpid()}", time.time_ns()
    with open_can(name) as bus, Onlooker(name) as look, open_can(name) as witness:
        navigation(bus, 0)
        commanded(bus, witness)
        end_ns = begin_ns + 60 * 1_000_000_000  # the first frames may be stamped only when they are read
        [path_us] = look.paths_us(begin_ns, end_ns)
        assert 0 <= path_us < 1e6
        assert look.paths_us(begin_ns, end_ns) == [], "nothing is told twice"


def test_the_onlooker_says_when_it_could_not_keep_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onlooker, "BUFFER_BYTES", 1 << 12)
    name, begin_ns = f"canloop:full-{os.getpid()}", time.time_ns()
    with open_can(name) as bus, Onlooker(name) as look, open_can(name) as witness:
        navigation(bus, 0)
        commanded(bus, witness)
        look.paths_us(begin_ns, time.time_ns())
        for number in range(1, 100):
            navigation(bus, number)
        look.paths_us(begin_ns, time.time_ns())
        navigation(bus, 100)  # whose numbers tell what is missing
        commanded(bus, witness)
        with pytest.raises(DelfimError, match="frames were lost to the measurement"):
            look.paths_us(begin_ns, time.time_ns())


def test_watchers_run_has_every_field(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["watchers", "--quick", "--seconds", "1", "--file", VEHICLE, "--output", str(tmp_path)]
    ended = main(words)
    results = json.loads((tmp_path / "watchers.json").read_text())
    assert [row["case"] for row in results["rows"]] == ["no client", "8 clients, one asleep"]
    assert [row["cycles"] + row["lost"] for row in results["rows"]] == [200, 100]
    assert all(0 < row["p50_us"] <= row["worst_us"] for row in results["rows"])
    assert ended == (results["lost_awake"] > 0)
    printed = capsys.readouterr().out
    assert "p99 with 8 clients, one asleep <= 1.2 x that with no client" in printed
    assert "ms for 1,000 frames" in printed


def test_downloads_run_has_every_field(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["downloads", "--quick", "--seconds", "1", "--file", VEHICLE, "--output", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "downloads.json").read_text())["rows"]
    assert sorted(row["case"] for row in rows) == ["download by FTP", "download by SFTP", "no download"]
    assert all((row["megabytes_per_s"] > 0.1) == (row["case"] != "no download") for row in rows)
    assert "p99 with download by FTP <= 1.2 x that with no download" in capsys.readouterr().out


def test_floods_run_has_every_field(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["floods", "--quick", "--seconds", "1", "--file", VEHICLE, "--output", str(tmp_path)]) == 0
    results = json.loads((tmp_path / "floods.json").read_text())
    assert sorted(row["case"] for row in results["rows"]) == sorted([*KINDS, PAYLOAD, RADIO, "no flood"])
    assert all((row["sent"] > 10) == (row["case"] != "no flood") for row in results["rows"])
    assert results["mode"] == "heading"
    assert "p99 with forged frames <= 1.2 x that with no flood" in capsys.readouterr().out


def test_the_flood_of_a_payload_begins_before_the_measurement_each_time(tmp_path: Path) -> None:
    """And not with the start of its program, for which the figures of the turn before once passed."""
    programs = set()
    for _ in range(2):
        with payload([], VEHICLE, tmp_path):
            programs.add(json.loads((tmp_path / "payload" / "service-payload.json").read_text())["pid"])
    assert len(programs) == 2


def test_datagrams_run_has_every_field(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["datagrams", "--quick", "--seconds", "1", "--file", VEHICLE, "--output", str(tmp_path)]
    ended = main(words)
    results = json.loads((tmp_path / "datagrams.json").read_text())
    assert [row["case"] for row in results["rows"]] == ["no datagrams", "fuzzed datagrams"]
    assert [row["cycles"] + row["lost"] for row in results["rows"]] == [200, 100]
    assert results["datagrams"] > 0
    assert results["counts"]["malformed"] > 0
    assert ended == (results["mode"] != "heading")
    assert "p99 with fuzzed datagrams <= 1.2 x that with no datagrams" in capsys.readouterr().out
