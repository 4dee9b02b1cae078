"""Errors as people read them."""

import pytest

from delfim.base.errors import BusError, ConfigError, in_words


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError(13, "Permission denied", "/log"), "/log: Permission denied"),
        (OSError(98, "address already in use"), "address already in use"),
        (OSError("gone"), "OSError: gone"),
        (TimeoutError(), "TimeoutError"),
        (ConfigError("boat.toml", "boat", "missing"), "boat.toml: boat: missing"),
        (BusError("can0: no such interface"), "can0: no such interface"),
        (ZeroDivisionError("division by zero"), "ZeroDivisionError: division by zero"),
    ],
)
def test_ours_as_they_are_the_systems_without_a_number_a_defect_with_its_kind(error: Exception, words: str) -> None:
    assert in_words(error) == words
