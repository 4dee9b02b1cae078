"""Motor controllers of others on the kernel's own CAN: the whole boat, stopped by the dead-man when its runtime hangs."""

import re

import pytest

from tests.guest.harness import Guest


@pytest.mark.long
def test_an_esc_pair_on_vcan_is_commanded_and_stopped(can_guest: Guest) -> None:
    result = can_guest.run("mkdir -p /run/delfim && python -m tests.esc_voyage /run/delfim vcan0", timeout_s=240.0)
    assert result.code == 0, result.output
    assert re.search(r"stopped \d\.\d\d s after the runtime was hung", result.output), result.output
    print(result.output)
