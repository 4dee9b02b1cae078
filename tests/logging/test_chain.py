"""The chain of a log: each change shows, a power cut is none, and a boat without one is told."""

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from delfim.__main__ import main
from delfim.base.clock import ManualClock
from delfim.logging import chain
from delfim.logging.ashore import chaincheck
from delfim.logging.ashore.tree import RUNNING_S
from delfim.logging.filelog import FileLog
from delfim.logging.liblog import LogSettings, event_line
from delfim.logging.reading import read_log

LATER_NS = 1 << 62  # long after a log was written
LINE = b"%06d " + b"a measured value " * 3 + b"\n"


def opened(place: Path, clock: ManualClock, id_: str = "state", **more: object) -> FileLog:
    told = {"file_bytes": 4000, "file_s": 600.0, "free_bytes_min": 0, "when_full": "delete-oldest", "header": b"head\n"}
    told |= {"directory": str(place), "id": id_, "suffix": ".log"} | more
    return FileLog(LogSettings(**told), clock, deflate=True, durable=True)  # type: ignore[arg-type]


def sail(log: FileLog, clock: ManualClock, seconds: float) -> None:
    """Five records a second, and an event each three seconds."""
    for count in range(round(seconds * 5)):
        log.put(LINE % count + os.urandom(20))
        if count % 15 == 0:
            log.note(event_line(clock, "command", value={"command": "hold"}, operator="ana", refused=""))
        clock.advance(0.2)
        log.poll()


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    """Nothing is put onto the disk: a power cut is made of copies here, and hundreds of syncs take a minute."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda fd: None)
        yield


@pytest.fixture(scope="module")
def voyage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs, of several files each, that ended in order."""
    place, clock = tmp_path_factory.mktemp("voyage") / "log", ManualClock(100.0)
    for _ in range(2):
        log = opened(place, clock)
        sail(log, clock, 60.0)
        log.close()
        clock.advance(120.0)
    assert len(list(place.rglob("*.chain"))) > 3
    return place


def found(place: Path, now_ns: int = LATER_NS) -> list[str]:
    return [each.found for each in chaincheck.check([str(place)], now_ns)]


def test_what_nobody_touched_is_whole_and_the_files_are_as_they_were_without_a_chain(voyage: Path) -> None:
    assert set(found(voyage)) == {"whole"}
    for file in voyage.rglob("*.log.gz"):
        content, trouble = read_log(file)
        assert (content[:5], trouble) == (b"head\n", "")


def test_a_folder_and_a_file_may_be_named_from_where_one_is(voyage: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the documents print it: `delfim log check logs`."""
    monkeypatch.chdir(voyage.parent)
    assert found(Path(voyage.name)) == found(voyage)
    one = next(voyage.rglob("*.log.gz")).relative_to(voyage.parent)
    assert found(one) == ["whole"]


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_each_byte_that_is_changed_added_or_taken_away_shows(voyage: Path, tmp_path: Path, data: st.DataObject) -> None:
    place = tmp_path / "copy"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(voyage, place)
    file = data.draw(st.sampled_from(sorted(path for path in place.rglob("*") if path.is_file())))
    content = bytearray(file.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    how = data.draw(st.sampled_from(("change", "insert", "cut", "append")))
    if how == "change":
        content[at] ^= data.draw(st.integers(1, 255))
    elif how == "insert":
        content[at:at] = b"0"
    elif how == "cut":
        del content[at:]
    else:
        content += data.draw(st.binary(min_size=1, max_size=200))
    is_same = (
        [json.loads(line) for line in voyage.joinpath(file.relative_to(place)).read_bytes().splitlines()]
        if (file.suffix == ".chain")
        else None
    )
    file.write_bytes(content)
    if is_same is not None and chaincheck._read(file)[1] == [each for each in is_same if "link" in each]:
        return  # of a chain only what it says counts: a blank more is no change
    is_last = file.suffix == ".chain" and file == sorted(place.rglob("*.chain"))[-1]
    told = chaincheck.check([str(place)], LATER_NS)
    bad = [each for each in told if each.found in chaincheck.BAD]
    assert bad or (is_last and told[-1].found == "cut"), "the end of the newest chain is held by nothing but a head"


def test_a_changed_event_is_told_with_its_time(voyage: Path, tmp_path: Path) -> None:
    place = shutil.copytree(voyage, tmp_path / "copy")
    sidecar = sorted(place.rglob("*.meta.jsonl"))[0]
    sidecar.write_bytes(sidecar.read_bytes().replace(b'"ana"', b'"rui"', 1))
    first = chaincheck.check([str(place)], LATER_NS)[0]
    assert first.found == "changed"
    assert first.words.startswith("changed between its beginning and 2010-01-01 00:00:00")


def test_a_file_that_was_removed_shows_and_one_that_made_room_does_not(voyage: Path, tmp_path: Path) -> None:
    place = shutil.copytree(voyage, tmp_path / "copy")
    stems = [path.name.partition(".")[0] for path in sorted(place.rglob("*.chain"))]
    for file in list(place.rglob(f"{stems[1]}.*")):
        file.unlink()
    assert found(place).count("gone") == 1
    for file in list(place.rglob(f"{stems[0]}.*")):
        file.unlink()
    assert set(found(place)) == {"whole"}, "the oldest are deleted for room"


def test_a_log_that_was_removed_and_its_chain_not(voyage: Path, tmp_path: Path) -> None:
    place = shutil.copytree(voyage, tmp_path / "copy")
    sorted(place.rglob("*.log.gz"))[1].unlink()
    assert found(place).count("changed") == 1


def test_a_chain_that_was_made_anew_does_not_know_the_head_that_was_noted(
    voyage: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noted = chaincheck.heads(chaincheck.check([str(voyage)], LATER_NS))["state"]
    assert main(["log", "check", str(voyage), "--head", noted[:16]]) == 0
    forged, clock = tmp_path / "forged", ManualClock(100.0)
    log = opened(forged, clock)
    sail(log, clock, 60.0)
    log.close()
    assert set(found(forged)) == {"whole"}
    assert main(["log", "check", str(forged), "--head", noted[:16]]) == 1
    assert "the chain is not the one that was noted" in capsys.readouterr().err


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seconds=st.integers(1, 250), torn=st.integers(0, 400), lost=st.integers(0, 3000))
def test_a_power_cut_is_told_from_a_change(tmp_path: Path, seconds: int, torn: int, lost: int) -> None:
    """The power fails at some moment: what was synced is there, the rest of log, sidecar and chain up to any byte."""
    place, clock = tmp_path / "log", ManualClock(100.0)
    shutil.rmtree(place, ignore_errors=True)
    log = opened(place, clock, file_bytes=1_000_000)
    synced = 0
    for count in range(seconds):
        sail(log, clock, 0.2 + count % 2)
        (links,) = [*place.rglob("*.chain")] or [None]
        lines = links.read_bytes().splitlines(keepends=True) if links else []
        ended = [at for at, line in enumerate(lines) if json.loads(line).get("log", 0)]
        synced = max(synced, sum(map(len, lines[: ended[-1] + 1])) if ended else 0)
    (links,) = place.rglob("*.chain")
    content = links.read_bytes()
    links.write_bytes(content[: max(len(content) - torn, synced)])
    (file,) = place.rglob("*.log.gz")
    reached = max([told["log"] for told in chaincheck._read(links)[1]], default=0)
    data = file.read_bytes()
    file.write_bytes(data[: max(len(data) - lost, reached)])
    assert found(place) == ["cut"]
    again = opened(place, clock)
    sail(again, clock, 20.0)
    again.close()
    assert found(place) == ["cut", "whole"], "the next run goes on with the chain"
    log.close()


def test_more_than_a_boat_leaves_behind_the_last_link_was_added(tmp_path: Path) -> None:
    clock = ManualClock(100.0)
    log = opened(tmp_path, clock, file_bytes=1_000_000)
    sail(log, clock, 35.0)
    (file,) = tmp_path.rglob("*.log.gz")
    other = opened(tmp_path / "other", clock, file_bytes=1_000_000)
    sail(other, clock, 45.0)
    (more,) = (tmp_path / "other").rglob("*.log.gz")
    assert found(file.parent) == ["cut"]
    file.write_bytes(file.read_bytes() + more.read_bytes())
    assert found(file.parent) == ["changed"]
    log.close()
    other.close()


def test_while_it_is_written_it_is_running(tmp_path: Path) -> None:
    clock = ManualClock(100.0)
    log = opened(tmp_path, clock)
    sail(log, clock, 15.0)
    (file,) = tmp_path.rglob("*.log.gz")
    now_ns = file.stat().st_mtime_ns
    assert found(tmp_path, now_ns) == ["running"]
    assert found(tmp_path, now_ns + (RUNNING_S + 60) * 10**9) == ["cut"]
    log.close()


def test_a_file_that_ends_with_a_header_and_an_event_alone_is_whole(tmp_path: Path) -> None:
    clock = ManualClock(100.0)
    log = opened(tmp_path, clock)
    log.note(event_line(clock, "end"))
    log.close()
    assert found(tmp_path) == ["whole"]


def test_links_are_few(tmp_path: Path) -> None:
    """An hour without an event: a link each ten seconds and at each file's end."""
    clock = ManualClock(100.0)
    log = opened(tmp_path, clock, file_bytes=1_000_000)
    for count in range(3600):
        log.put(LINE % count)
        clock.advance(1.0)
        log.poll()
    log.close()
    size = sum(file.stat().st_size for file in tmp_path.rglob("*.chain"))
    assert size < 3600 / 10 * 180


def test_logs_without_a_chain_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clock = ManualClock(100.0)
    settings_of = LogSettings(str(tmp_path), "gps", ".log", b"", 1000, 600.0, 0, "delete-oldest")
    log = FileLog(settings_of, clock, deflate=True)
    log.put(b"one\n")
    log.close()
    assert main(["log", "check", str(tmp_path)]) == 1
    assert "NO CHAIN" in capsys.readouterr().out


@pytest.mark.parametrize(
    "wrong", [b"", b"\n", b"null\n", b'{"t_ns": 1}\n', b'{"t_ns": 1, "before": 3}\n', b"\xff\xfe", b"[" * 999]
)
def test_what_is_no_chain_is_no_link(tmp_path: Path, wrong: bytes) -> None:
    (folder := tmp_path / "20100101/state").mkdir(parents=True)
    (folder / "000000.chain").write_bytes(wrong)
    assert chain.newest(str(tmp_path), "state") == ""
    assert found(tmp_path) == ["cut"]


def test_the_newest_link_is_found_behind_a_torn_line(tmp_path: Path) -> None:
    (folder := tmp_path / "20100101/state").mkdir(parents=True)
    (folder / "000000.chain").write_text(
        '{"t_ns": 1, "before": ""}\n{"t_ns": 1, "log": 0, "meta": 1, "link": "ab"}\n{"t_ns": 2, "lo'
    )
    (folder / "000000-10.chain").write_text('{"t_ns": 1, "log": 0, "meta": 1, "link": "cd"}\n')
    assert chain.newest(str(tmp_path), "state") == "cd"
    (folder / "000000-10.chain").unlink()
    assert chain.newest(str(tmp_path), "state") == "ab"


def test_a_file_alone_is_checked_by_itself(voyage: Path) -> None:
    file = sorted(voyage.rglob("*.log.gz"))[1]
    (told,) = chaincheck.check([str(file)], LATER_NS)
    assert (told.found, told.path) == ("whole", str(file))
