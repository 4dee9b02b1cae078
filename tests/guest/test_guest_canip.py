"""IP over CAN between two network namespaces: runs guest_canip.py in the guest and reports each of its tests as a subtest."""

from xml.etree import ElementTree

import pytest

from tests.guest.harness import Guest

TIMEOUT_S = 150.0


@pytest.mark.long
@pytest.mark.timeout(TIMEOUT_S + 60.0)
def test_datagrams_between_namespaces(can_guest: Guest, subtests: pytest.Subtests) -> None:
    report = can_guest.folder / "canip.xml"
    command = f"python -m pytest -p no:cacheprovider -q -s --timeout=90 --junit-xml={report} tests/guest/guest_canip.py"
    result = can_guest.run(f"modprobe vxcan && modprobe tun && {command}", timeout_s=TIMEOUT_S)
    assert report.exists(), result.output
    print(*(line for line in result.output.splitlines() if "measured" in line), sep="\n")
    cases = list(ElementTree.parse(report).iter("testcase"))
    for case in cases:
        with subtests.test(case.get("name")):
            trouble = [child for child in case if child.tag in ("failure", "error", "skipped")]
            assert not trouble, trouble[0].text
    assert cases, f"no test ran in the guest:\n{result.output}"
    assert result.code == 0, result.output
