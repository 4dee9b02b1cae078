"""Sensors on a bus of a real kernel: i2c-stub keeps the registers of an INA226 and a BMP390, which i2cd reads and tells."""

from pathlib import Path

import pytest

from tests.guest.harness import guest, missing

TIMEOUT_S = 180.0


@pytest.mark.long
@pytest.mark.timeout(TIMEOUT_S + 120.0)
@pytest.mark.skipif(missing() is not None, reason=str(missing()))
def test_sensors_on_a_bus_of_the_kernel_are_told(tmp_path: Path) -> None:
    with guest(tmp_path, modules=("i2c-dev", "i2c-stub chip_addr=0x40,0x76")) as g:
        result = g.run("python -m tests.guest.guest_i2c", timeout_s=TIMEOUT_S)
        assert result.code == 0, result.output
