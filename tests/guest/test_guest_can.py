"""Real SocketCAN: runs guest_can.py inside the guest and reports each of its tests here as a subtest."""

from xml.etree import ElementTree

import pytest

from tests.guest.harness import Guest

TIMEOUT_S = 240.0


@pytest.mark.timeout(TIMEOUT_S + 60.0)
def test_sockets_on_a_real_can_stack(can_guest: Guest, subtests: pytest.Subtests) -> None:
    report = can_guest.folder / "can.xml"
    command = f"python -m pytest -p no:cacheprovider -q --timeout=200 --junit-xml={report} tests/guest/guest_can.py"
    result = can_guest.run(command, timeout_s=TIMEOUT_S)
    assert report.exists(), result.output
    cases = list(ElementTree.parse(report).iter("testcase"))
    for case in cases:
        with subtests.test(case.get("name")):
            trouble = [child for child in case if child.tag in ("failure", "error", "skipped")]
            assert not trouble, trouble[0].text
    assert cases, f"no test ran in the guest:\n{result.output}"
    assert result.code == 0, result.output
