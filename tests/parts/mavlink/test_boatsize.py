"""How large a boat is, as it tells a console."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.parts.mavlink.codec.boatsize import SIZE_MAX, heard

LENGTHS, BEAMS, SPEEDS = (st.floats(0.0, most).map(lambda each: float(f"{each:g}")) for most in SIZE_MAX)


@given(st.tuples(LENGTHS, BEAMS, SPEEDS))
def test_a_size_is_heard_as_it_was_told(size):
    assert heard(" ".join(f"{each:g}" for each in size)) == size


@given(st.text(max_size=30))
def test_whatever_else_is_heard_is_no_size_or_one_within_bounds(text):
    size = heard(text)
    assert size is None or all(0.0 <= each <= most for each, most in zip(size, SIZE_MAX, strict=True))


@pytest.mark.parametrize(
    "text", ["", "4.5", "4.5 2.4", "4.5 2.4 2000 1", "nan 2 3", "-1 2 3", "501 2 3", "4.5 2.4 1e6", "a b c"]
)
def test_no_size(text):
    assert heard(text) is None
