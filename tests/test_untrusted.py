"""What comes from outside, before anybody asks what it means."""

import os
import tomllib
from pathlib import Path

import pytest

from delfim.base.errors import FormatError
from delfim.base.input.untrusted import parse_json, parse_toml, read_file, read_text


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_bytes(b"12345678")
    assert read_file(file, 8) == b"12345678"
    with pytest.raises(OSError, match="8 bytes: files of more than 7 are not read") as refused:
        read_file(file, 7)
    assert refused.value.filename == str(file)


def test_a_text_may_begin_with_the_mark_of_its_encoding(tmp_path: Path) -> None:
    """TOML has no such character: at line 1, column 1 a person sees nothing wrong."""
    (tmp_path / "file").write_bytes(b"\xef\xbb\xbfname = 'Del\xc3\xafim'")
    assert parse_toml(read_text(tmp_path / "file")) == {"name": "Delïim"}
    (tmp_path / "file").write_bytes(b"name = '\xef'")
    with pytest.raises(FormatError, match=r"not UTF-8: .* at byte 8"):
        read_text(tmp_path / "file")


def test_a_pipe_does_not_hold_who_opens_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="this is a pipe, not a file"):
        read_file(tmp_path / "pipe")


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 100_000, "9" * 5000, '"\\ud800"', b'"\xff"', b'"\xed\xa0\x80"', "{", ""]
)
def test_json_that_is_none_is_refused_in_words(text: str | bytes) -> None:
    with pytest.raises(FormatError, match="not JSON: "):
        parse_json(text)


def test_a_character_of_two_halves_is_one() -> None:
    assert parse_json(rb'["\ud83d\ude00", "\u00e9"]') == ["\U0001f600", "\u00e9"]


KEYS = {  # of a table within a table and so on: to read one takes the square of its length
    "bare": ".".join("a" * 100_000) + " = 1",
    "quoted": " . ".join(['"a b"', "'c.d'"] * 50_000) + " = 1",
    "table": f"[{'.'.join('a' * 100_000)}]",
    "inline": "a = [1.5, {" + ".".join("b" * 100_000) + " = 1}]",
}


@pytest.mark.parametrize("text", KEYS.values(), ids=KEYS)
def test_keys_of_tables_without_end_are_refused_before_they_are_read(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tomllib, "loads", lambda text: pytest.fail("it is read"))
    with pytest.raises(FormatError, match="not TOML: nested too deep"):
        parse_toml(text)


def test_what_only_looks_like_such_a_key_is_read() -> None:
    corners = [[round(38.0 + n / 1000, 3), -9.2] for n in range(1000)]
    text = f'a.b.c = {corners}\nb = "{"... " * 1000}"\nc = "{"x" * 100_000}"  # {"." * 1000}\n'
    assert parse_toml(text)["a"]["b"]["c"] == corners


@pytest.mark.parametrize("text", ["a = " + "[" * 50_000, "a = " + "9" * 5000, "a = 1\na = 2", "a ="])
def test_toml_that_is_none_is_refused_in_words(text: str) -> None:
    with pytest.raises(FormatError, match="not TOML: "):
        parse_toml(text)
