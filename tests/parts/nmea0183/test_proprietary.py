"""Sentences with their checksums, and what comes in pieces or damaged."""

from random import Random

import pytest

from delfim.lines.nmea0183.framing import LONGEST, framed
from delfim.lines.nmea0183.proprietary import FieldReader, fields, number
from tests.mutations import cut, flipped, spliced


def test_sentences_of_the_boats_manuals() -> None:
    assert framed("PMARMAN,0.50,0.00,-0.25") == b"$PMARMAN,0.50,0.00,-0.25*51\r\n"
    assert framed("PMARABT") == b"$PMARABT*59\r\n"
    assert framed("PYDIR,30,40") == b"$PYDIR,30,40*51\r\n"
    assert fields(b"$PYDIR,45,55*57\r\n") == ["PYDIR", "45", "55"]
    assert fields(b"$CPRBS,134213.686,1,15.2,15.1,15.3,0*5B") == ["CPRBS", "134213.686", "1", "15.2", "15.1", "15.3", "0"]
    assert fields(b"$CPRBS,091945.064,1,15.2,15.1,15.3,0*57") is not None


@pytest.mark.parametrize(
    "line", [b"", b"$", b"*", b"$*", b"$PYDIR,45,55", b"$PYDIR,45,55*58", b"$PYDIR,45,55*5", b"PYDIR,45,55*57", b"$\xff*FF"]
)
def test_what_is_no_sentence(line: bytes) -> None:
    assert fields(line) is None


def test_sentences_come_in_pieces() -> None:
    reader = FieldReader()
    stream = framed("A,1") + b"\r\n" + framed("B,,2") + b"noise\n" + framed("C")
    found = [each for at in range(len(stream)) for each in reader.feed(stream[at : at + 1])]
    assert (found, reader.malformed) == ([["A", "1"], ["B", "", "2"], ["C"]], 1)
    assert reader.feed(b"x" * (LONGEST + 1)) == []
    assert reader.malformed == 2
    assert reader.feed(framed("D")) == [["D"]]


def test_damage_is_never_taken_for_another_sentence_and_never_raises() -> None:
    random, reader, whole = Random(16), FieldReader(), framed("PMAROTR,100,200,20,21,50,60,110,2")
    for _ in range(5000):
        damaged = random.choice((flipped, cut, spliced))(whole, random)
        found = fields(damaged)
        if found is not None and found != fields(whole):
            assert bin(int.from_bytes(damaged[: len(whole)], "big") ^ int.from_bytes(whole, "big")).count("1") > 1
        reader.feed(damaged)


def test_numbers_are_finite_or_nothing() -> None:
    assert (number(""), number("-1.5")) == (None, -1.5)
    for text in ("nan", "inf", "1e400", "x", "1e10"):
        with pytest.raises(ValueError, match=r"could not|out of range"):
            number(text)
