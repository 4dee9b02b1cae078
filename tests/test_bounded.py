"""A process that reads what came from outside has bounds of memory and of time."""

import subprocess
import sys

import pytest

from delfim.base.input.bounded import NICE, bounded

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there are no such bounds")
BEGIN = "from delfim.base.input.bounded import bounded; "


@pytest.mark.parametrize(
    ("words", "codes"),
    [
        ("bounded(1 << 28); bytes(1 << 20)", (0,)),
        ("bounded(1 << 28); bytes(1 << 29)", (1,)),
        ("bounded(1 << 28, 1)\nwhile True: pass", (-9, -24)),  # killed, or told that its time is over
    ],
)
def test_more_memory_or_time_than_allowed_is_the_end_of_it(words: str, codes: tuple[int, ...]) -> None:
    done = subprocess.run((sys.executable, "-c", BEGIN + words), stderr=subprocess.DEVNULL, check=False)
    assert done.returncode in codes


def test_a_reader_without_a_bound_of_time_waits_for_more(monkeypatch: pytest.MonkeyPatch) -> None:
    import os
    import resource

    told = list[object]()
    monkeypatch.setattr(os, "nice", told.append)
    monkeypatch.setattr(resource, "setrlimit", lambda what, limit: told.append((what, limit)))
    bounded(7)
    assert told == [NICE, (resource.RLIMIT_AS, (7, 7))]
    bounded(7, 3)
    assert told[2:] == [NICE, (resource.RLIMIT_AS, (7, 7)), (resource.RLIMIT_CPU, (3, 3))]
