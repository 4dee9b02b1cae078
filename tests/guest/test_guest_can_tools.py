"""`delfim can dump` prints what candump prints, byte by byte, on the kernel's own CAN and by TCP; a DroneCAN node there is set
and gets a new program."""

import pytest

from tests.guest.harness import Guest


@pytest.mark.long
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


@pytest.mark.long
def test_a_node_on_vcan_is_set_and_gets_its_program_though_frames_are_lost(can_guest: Guest) -> None:
    result = can_guest.run("python tests/guest/guest_nodetool.py vcan0", timeout_s=300.0)
    assert result.code == 0, result.output
    for words in (
        "42  org.example.esc                 1.0      well, operational",
        "BI_DIRECTIONAL = True  (boolean)\nnode 42: saved",
        "it fetches esc-2.0.bin, 102400 bytes",
        "100 %\nnode 42 is back: org.example.esc 2.0",
        "node 42 started again",
    ):
        assert words in result.output, result.output
    print(result.output)
