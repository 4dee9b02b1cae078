"""A recorded run through the real loop once more: the same frames, bit by bit, or told where not."""

import json
import re
from pathlib import Path

import pytest

from delfim.errors import DelfimError
from delfim.logging.candump import format_line
from delfim.logging.liblog import read_log
from delfim.logging.table import frames
from delfim.simulator.rerun import rerun
from delfim.vehicle import console
from tests.logging.sailing import Day, logged, sailed


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("day")
    sailed(place).end()
    return place


def copied(day: Path, place: Path) -> Path:
    """The same logs, unpacked, to be tampered with; the folder of the day."""
    for file in logged(day):
        name = Path(file.path)
        target = place / name.parts[-3] / name.parts[-2] / name.name.removesuffix(".gz")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(read_log(file.path)[0])
        if file.sidecar:
            target.with_name(Path(file.sidecar).name).write_bytes(Path(file.sidecar).read_bytes())
    return next(place.iterdir())


def silent(day: Day, seconds: float) -> None:
    """The watchdog alone is called, at times of its own."""
    for _ in range(round(seconds / 0.1)):
        day.clock.advance(0.1003)
        day.sailing.vehicle.on_watchdog()
        day.log.watch(day.sailing.state)
        day.box.on_readable(day.socket)
    day.clock.advance(0.05)


def test_the_same_frames_bit_by_bit(day):
    result = rerun(logged(day), None)
    assert result.exact, result.text()
    assert result.cycles >= 320
    assert result.frames == sum(
        frame.arb >> 21 in range(0x40, 0x44) for _, frame in frames(each for each in logged(day) if each.id != "state")
    )
    assert "all the same, bit by bit" in result.text()


def test_other_gains_give_other_frames(day, tmp_path):
    folder = copied(day, tmp_path)
    sidecar = folder / "state/000000.meta.jsonl"
    sidecar.write_text(
        sidecar.read_text()
        .replace('"p_rpm_per_rad": 600.0', '"p_rpm_per_rad": 601.0')
        .replace('"p_rpm_per_rad": 700.0', '"p_rpm_per_rad": 701.0')
    )
    result = rerun(logged(tmp_path), None)
    assert not result.exact
    assert len(result.differences) > 10
    assert re.search(r"recorded [0-9a-f ]+  repeated [0-9a-f ]+", result.text())


def test_one_frame_changed_on_disk_is_one_difference(day, tmp_path):
    folder = copied(day, tmp_path)
    box = folder / "lockstep/000000.log"
    lines = box.read_text().splitlines(keepends=True)
    at = max(i for i, line in enumerate(lines) if " 040#" in line)
    lines[at] = re.sub("#..", "#FF", lines[at])
    box.write_text("".join(lines))
    assert [each.recorded[0][1][0] for each in rerun(logged(tmp_path), None).differences] == [0xFF]


def test_a_command_missing_in_the_black_box_is_told_and_the_rest_compared(day, tmp_path):
    folder = copied(day, tmp_path)
    box = folder / "lockstep/000000.log"
    lines = box.read_text().splitlines(keepends=True)
    sent = [i for i, line in enumerate(lines) if re.search(" 04[0-3]#", line)]
    box.write_text("".join(line for i, line in enumerate(lines) if i not in sent[400:404]))
    result = rerun(logged(tmp_path), None)
    assert [each.recorded for each in result.differences] == [()]


def test_silence_of_navigation_and_what_the_watchdog_did_are_repeated(tmp_path):
    day = sailed(tmp_path)
    assert day.command(console.Heading(10.0, 1.0)) is None
    silent(day, 3.0)
    day.sail(5.0)
    day.end()
    assert "navigation silent" in json.dumps(
        [line for file in logged(tmp_path) for line in Path(file.sidecar).read_text().splitlines()]
    )
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()


def test_a_run_without_its_start_is_refused(day, tmp_path):
    folder = copied(day, tmp_path)
    (folder / "state/000000.meta.jsonl").write_text("")
    with pytest.raises(DelfimError, match="0 starts"):
        rerun(logged(tmp_path), None)


def test_lines_come_back_as_they_were_written(day):
    box = [file for file in logged(day) if file.id != "state"]
    again = "".join(format_line(frame, name) for name, frame in frames(box))
    assert again == "".join(read_log(file.path)[0].decode() for file in box)
