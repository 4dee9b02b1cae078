"""The part keeps its contract: `delfim parts check example_order` tries the same."""

import pytest

from delfim.simulator.contract import Tried, tried


@pytest.mark.parametrize("each", tried("example_order", "1.0"), ids=lambda each: each.what)
def test_the_contract(each: Tried) -> None:
    assert not each.fault
