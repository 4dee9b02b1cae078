"""`delfim can dump` prints what candump prints, byte by byte, on the kernel's own CAN and by TCP."""

import pytest

from tests.guest.harness import Guest


def test_dump_prints_what_candump_prints(can_guest: Guest, subtests: pytest.Subtests) -> None:
    result = can_guest.run("python tests/guest/guest_can_tools.py", timeout_s=120.0)
    assert result.code == 0, result.output
    for way, fewest in (("long", 730), ("delta", 300), ("log", 200), ("tcp", 650)):
        with subtests.test(way):
            theirs = (can_guest.folder / f"{way}.candump").read_text().splitlines()
            ours = (can_guest.folder / f"{way}.delfim").read_text().splitlines()
            lines = min(len(theirs), len(ours)) - 1  # they did not begin at once, and a first delta is 0
            assert lines >= fewest
            assert ours[-lines:] == theirs[-lines:]
