"""The record of a boat, read from a state log of the real loop."""

import math
from pathlib import Path

import numpy as np
import pytest

from delfim.adoption.record import BoatRecord, Series, digest_of, one_clock, read_log
from delfim.base.errors import DelfimError
from delfim.logging.ashore.tree import files
from delfim.logging.reading import LOG_BYTES
from tests.logging.sailing import sailed


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> BoatRecord:
    place = tmp_path_factory.mktemp("log")
    sailed(place).end()
    return read_log(files([place]))


def test_a_day_of_state_log_tells_commands_and_motion(record: BoatRecord) -> None:
    assert record.thrusters == ("starboard", "port")
    assert record.told.values.shape == (len(record.told.at_s), 2)
    assert record.velocity.values.shape == (len(record.velocity.at_s), 2)
    assert record.heading.values.shape == (len(record.heading.at_s), 1)
    assert record.seconds == pytest.approx(65.0, abs=1.0)
    assert not record.is_raw
    assert len(record.digest) == 64


def test_the_commands_are_those_that_were_sent_and_nothing_after_the_stop(record: BoatRecord) -> None:
    manual = record.told.values[(record.told.at_s > 35.2) & (record.told.at_s < 36.6)]  # silence after it ends the thrust
    assert manual[-1] == pytest.approx((0.5, 0.25), abs=0.02)
    assert not record.told.values[record.told.at_s > 52.0].any()
    moving = np.hypot(*record.velocity.values.T)
    assert moving.max() > 1.0


def test_what_was_not_measured_is_left_out() -> None:
    measured = Series.of([(0.0, 1.0, 2.0), (1.0, math.nan, 2.0), (2.0, 3.0, 4.0)], 2)
    assert measured.at_s.tolist() == [0.0, 2.0]
    assert measured.values.tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_a_boat_that_starts_again_begins_no_earlier_than_it_ended() -> None:
    assert one_clock(np.array([5.0, 6.0, 1.0, 2.0])).tolist() == [5.0, 6.0, 66.0, 67.0]


def test_a_log_without_state_is_refused_in_words() -> None:
    with pytest.raises(DelfimError, match="no state was logged"):
        read_log([])


def test_a_file_too_large_to_be_a_log_is_not_read(tmp_path: Path) -> None:
    sailed(tmp_path).end()
    (file,) = [each for each in files([tmp_path]) if each.suffix.startswith(".state")]
    with open(file.path, "r+b") as log:
        log.truncate(LOG_BYTES + 1)
    with pytest.raises(OSError, match="files of more than 134217728 are not read"):
        digest_of([file])
