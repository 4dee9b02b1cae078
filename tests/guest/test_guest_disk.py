"""The benchmark of failing log partitions, in a guest: it mounts, and this needs root."""

import json

import pytest

from tests.guest.harness import guest, missing

pytestmark = pytest.mark.long

COMMAND = "python -m bench disk --quick --seconds 4 --rates 50 --bus vcan0 --frames 300 --output $FOLDER"


def test_every_way_in_which_a_log_partition_fails_is_counted_told_and_got_over(tmp_path):
    if reason := missing():
        pytest.skip(reason)
    with guest(tmp_path, modules=("vcan", "can-raw", "loop")) as boat:
        result = boat.run(COMMAND, timeout_s=200.0)
        assert result.code == 0, result.output
        healthy, *troubled = json.loads((boat.folder / "disk.json").read_text())["rows"]
    print(result.output)
    assert healthy["dropped"] == 0
    told = {row["case"]: row["reason"] for row in troubled}
    assert "No space left on device" in told["disk full (ENOSPC)"]
    assert "Read-only file system" in told["mounted read-only (EROFS)"]
    assert "Input/output error" in told["disk torn out (EIO)"]
    assert all(row["dropped"] > 0 for row in troubled if row["case"] != "disk hangs"), (
        "the pipe holds seconds of a hanging disk"
    )
    assert all(row["cycles"] > 0 for row in troubled)
