"""A PCA9685 on a bus of a real kernel: i2c-stub keeps the registers that the outlet writes, as the chip would."""

from pathlib import Path

import pytest

from tests.guest.harness import guest, missing

TIMEOUT_S = 120.0


@pytest.mark.long
@pytest.mark.timeout(TIMEOUT_S + 120.0)
@pytest.mark.skipif(missing() is not None, reason=str(missing()))
def test_the_outlet_writes_the_registers_of_a_pca9685(tmp_path: Path) -> None:
    with guest(tmp_path, modules=("i2c-dev", "i2c-stub chip_addr=0x40")) as g:
        result = g.run("python -m tests.guest.guest_pwm", timeout_s=TIMEOUT_S)
        assert result.code == 0, result.output
