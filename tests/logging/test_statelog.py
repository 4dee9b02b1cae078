"""The state log: what is put is read, by us and by the readers that the document prints, whole or cut."""

import logging
import math
import re
import struct
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.logging import statelog
from delfim.logging.statelog import Schema, StateWriter, columns, read_state
from delfim.vehicle.log import record
from tests.logging.conftest import files

DOCUMENT = Path(__file__).parents[2] / "docs" / "log-format.md"
READERS = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)

ROWS = (
    ("t", "q", "ns", "wall clock"),
    ("heading", "d", "rad", "true"),
    ("mode", "B", "", "number"),
    ("run", "?", "", "enabled"),
)
VALUES = [(1_262_304_000_000_000_000 + cycle, 0.25 * cycle, cycle % 7, cycle % 2 == 0) for cycle in range(50)]


def written(file_log, clock, rows=ROWS, values=VALUES, **how) -> None:
    schema = Schema(rows, boat="DelfimX", started_ns=7)
    log = file_log(id="state", suffix=".state", header=schema.header, **how)
    writer = StateWriter(log.put, schema)
    for each in values:
        assert writer.put(each)
        clock.advance(0.2)
    log.close()


@pytest.mark.parametrize("deflate", [False, True])
def test_what_was_put_is_read(tmp_path, file_log, clock, deflate):
    written(file_log, clock, deflate=deflate)
    schema, records, complaint = read_state(files(tmp_path / "log")[0])
    assert (schema.rows, schema.boat, schema.started_ns) == (ROWS, "DelfimX", 7)
    assert list(records) == VALUES
    assert complaint == ""


@pytest.mark.parametrize("source", READERS)
@pytest.mark.parametrize("deflate", [False, True])
def test_the_readers_in_the_document_read_it(tmp_path, file_log, clock, source, deflate):
    written(file_log, clock, deflate=deflate)
    names: dict[str, object] = {}
    exec(source, names)  # what the document tells people to write
    read = names["read"](str(files(tmp_path / "log")[0]))
    assert [tuple(one[name] for name, *_ in ROWS) for one in read] == VALUES


def test_the_last_reader_in_the_document_reads_what_a_power_cut_left(tmp_path, file_log, clock):
    written(file_log, clock, deflate=True)
    path = files(tmp_path / "log")[0]
    path.write_bytes(path.read_bytes()[:-30])
    names: dict[str, object] = {}
    exec(READERS[-1], names)
    read = [tuple(one.values()) for one in names["read"](str(path))]
    sure = list(read_state(path).records)  # without what came after the last flush
    assert read[: len(sure)] == sure
    assert len(sure) >= 40
    assert 40 < len(read) < 50


def test_the_vehicle_s_own_record_has_a_schema():
    schema = Schema(
        [(field.name, field.code, field.unit, field.description) for group in record.GROUPS for field in group.fields],
        boat="DelfimX",
    )
    assert len(schema.header) % statelog.ALIGNMENT == 0
    assert schema.header.count(b"\n") == 2
    assert Schema.parse(schema.header)[0].rows == schema.rows


CODED = st.sampled_from(
    [
        ("d", st.floats(allow_nan=False)),
        ("q", st.integers(-(2**63), 2**63 - 1)),
        ("?", st.booleans()),
        ("H", st.integers(0, 65535)),
    ]
)
TEXT = st.text(st.characters(codec="utf-8"), max_size=10)


@given(st.data(), st.lists(st.tuples(TEXT, CODED, TEXT, TEXT), min_size=1, max_size=6, unique_by=lambda field: field[0]), TEXT)
def test_any_schema_explains_itself(data, fields, boat):
    schema = Schema([(name, code, unit, text) for name, (code, _), unit, text in fields], boat=boat)
    values = data.draw(st.lists(st.tuples(*(strategy for _, (_, strategy), _, _ in fields)), max_size=3))
    content = schema.header + b"".join(schema.struct.pack(*each) for each in values)
    again, start = Schema.parse(content)
    assert start % 64 == 0
    assert (again.rows, again.boat) == (schema.rows, boat)
    assert list(again.struct.iter_unpack(content[start:])) == values


@given(st.binary(max_size=200))
@example(b"{}")
@example(b"[]")
@example(b'{"fields": 3, "boat": "", "started_ns": 0, "record_bytes": 1, "byte_order": "little"}')
@example(b'{"fields": [], "boat": "", "started_ns": 1e999, "record_bytes": 0, "byte_order": "little"}')
@example(
    b'{"fields": [{"name": "a", "code": "B", "unit": "", "description": ""}], "boat": "", "started_ns": 0, "record_bytes": 2}'
)
@example(b"[" * 190)
@example(
    b'{"record_bytes": 1, "byte_order": "little", "boat": "\xed\xa0\x80", "started_ns": 0, "fields": '
    b'[{"name": "a", "code": "B", "unit": "", "description": ""}]}'
)  # half a character: it could be read, and never be printed
def test_a_malformed_header_is_refused(text):
    with pytest.raises(FormatError):
        Schema.parse(statelog.MAGIC + text.replace(b"\n", b"") + b"\n")
    with pytest.raises(FormatError):
        Schema.parse(text)


@pytest.mark.parametrize("rows", [(), (("a", "l", "", ""),), (("a", "dd", "", ""),), (("a", "", "", ""),), (ROWS[0], ROWS[0])])
def test_a_schema_that_others_could_not_read_is_refused(rows):
    with pytest.raises(FormatError):
        Schema(rows)


def test_an_incomplete_last_record_is_left_out_and_told(tmp_path, file_log, clock):
    written(file_log, clock)
    path = files(tmp_path / "log")[0]
    path.write_bytes(path.read_bytes()[:-5])
    _, records, complaint = read_state(path)
    assert list(records) == VALUES[:-1]
    assert complaint == f"{path}: the last record is incomplete"


def test_a_deflated_file_cut_anywhere_is_read_as_far_as_it_goes(tmp_path, file_log, clock):
    written(file_log, clock, deflate=True)
    path = files(tmp_path / "log")[0]
    data, most, refused = path.read_bytes(), 0, []
    for size in range(len(data)):
        path.write_bytes(data[:size])
        try:
            _, records, complaint = read_state(path)
        except FormatError:
            refused.append(size)
            continue
        read = list(records)
        assert read == VALUES[: len(read)]
        assert most <= len(read)
        assert complaint
        most = len(read)
    assert most > 45
    assert refused == list(range(len(refused)))  # those cut within the header


def test_values_that_do_not_fit_are_refused_and_told(file_log):
    schema = Schema(ROWS)
    writer = StateWriter(file_log().put, schema)
    for values in [(1, None, 1, True), (1, 2.0, 256, True), (1, 2.0, 3), (2**63, 2.0, 3, True)]:
        assert not writer.put(values)
    assert writer.rejected == 4
    assert writer.reason.startswith("a record does not fit the schema: ")
    assert not StateWriter(file_log().put, Schema([("a", "f", "", "")])).put((1e300,))


def test_columns_of_several_files_are_in_order_of_time(tmp_path, file_log, clock):
    written(file_log, clock, file_bytes=300, deflate=True)
    paths = files(tmp_path / "log")
    assert len(paths) > 3
    read = columns(sorted(paths, reverse=True))
    assert list(zip(*read.values(), strict=True)) == VALUES
    assert list(read) == [name for name, *_ in ROWS]


def test_columns_of_files_with_other_fields(tmp_path, file_log, clock):
    written(file_log, clock, rows=[("t", "B", "", ""), ("old", "B", "", "")], values=[(1, 10), (2, 20)])
    written(file_log, clock, rows=[("t", "B", "", ""), ("new", "B", "", "")], values=[])
    written(file_log, clock, rows=[("t", "B", "", ""), ("new", "B", "", "")], values=[(3, 30)])
    read = columns(files(tmp_path / "log"))
    assert read["t"] == [1, 2, 3]
    assert read["old"][:2] == [10, 20]
    assert math.isnan(read["old"][2])
    assert [math.isnan(value) for value in read["new"]] == [True, True, False]


def test_columns_say_what_was_wrong(tmp_path, file_log, clock, caplog):
    written(file_log, clock, deflate=True)
    written(file_log, clock)
    cut, empty = files(tmp_path / "log")
    cut.write_bytes(cut.read_bytes()[:-20])
    empty.write_bytes(b"")
    with caplog.at_level(logging.WARNING):
        read = columns([cut, empty])
    assert read["t"] == [values[0] for values in VALUES[: len(read["t"])]]
    assert [str(cut) in caplog.messages[0], str(empty) in caplog.messages[1]] == [True, True]


def test_columns_of_nothing():
    assert columns([]) == {}


def test_records_are_packed_as_the_document_says():
    header = Schema(ROWS).header
    assert header.startswith(b'DELFIM STATE 1\n{"record_bytes": 18, "byte_order": "little", ')
    assert Schema(ROWS).struct.pack(*VALUES[1]) == struct.pack("<qdB?", *VALUES[1])
