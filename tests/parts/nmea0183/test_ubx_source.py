"""The source `nmea0183` with a pair of u-blox receivers, in UBX."""

import math

import msgspec
import pytest

from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.vehicle.navigation.fixes import take
from tests.parts.nmea0183.receiver import pvt, relposned
from tests.parts.nmea0183.test_source import Boat


def test_a_u_blox_pair_gives_position_heading_accuracy_and_the_age_of_corrections():
    """The base on one port and the rover on the other, in UBX; its heading ends with its fixed solution."""
    boat = Boat()
    ports = dict(boat.settings.nmea0183.ports)
    ports["compass"] = Nmea0183Port(device="/dev/compass", baud=115200, baseline_m=1.5, baseline_deg=90.0)
    boat.settings = msgspec.structs.replace(boat.settings, nmea0183=Nmea0183(ports=ports))
    boat.open()

    def hear(second: float, **told: int) -> None:
        boat.lines["/dev/compass"].put(relposned(heading_deg=100.0, **told))
        assert boat.source.read(boat.clock.monotonic_s()) is None
        boat.lines["tcp:127.0.0.1:2947"].put(pvt(second))
        fix = boat.source.read(boat.clock.monotonic_s())
        assert fix is not None
        assert take(boat.source, fix, (boat.source,), boat.state, boat.settings.navigation)

    hear(1.0)
    n = boat.state.navigation
    assert n.heading_rad == pytest.approx(math.radians(10.0))
    assert (n.fix, n.accuracy_m, n.corrections_s) == (5, pytest.approx(0.014), 2.0)
    assert boat.state.measured["position_sigma_m"][0] == pytest.approx(0.014)
    assert boat.state.measured["corrections_age_s"][0] == 2.0
    hear(1.2, carrSoln=1)
    assert boat.state.navigation.heading_rad is None
    told = boat.source.report(1000.0)
    assert told["ports"]["compass"]["refused"] == {"NAV-RELPOSNED: no heading without a fixed solution": 1}
    assert told["kinds"]["position"]["talker"] == "gnss:UB"
