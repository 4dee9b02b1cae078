"""A bus carries one protocol; descriptions of DroneCAN boats that cannot be are refused in words."""

import subprocess
import sys
from pathlib import Path

import pytest

from delfim import config
from delfim.base.errors import ConfigError

VEHICLE = str(Path(__file__).parents[1] / "etc/delfimx.toml")
ROW = '{name="%s", driver="dronecan", address=%d, y_m=%g, thrust_n=[-10.0, 20.0]%s}'
TWIN = f"thrusters=[{ROW % ('starboard', 0, 1.0, '')}, {ROW % ('port', 1, -1.0, '')}]"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            ('dronecan.interface="can0"',),
            r"dronecan.interface: can0 carries DSOR \(can.interface\) already, and this is DroneCAN",
        ),
        (
            ('navigation.sources=["nmea2000", "dsor"]',),
            r"dronecan.interface: can1 carries NMEA 2000 \(nmea2000.interface\) already, and this is DroneCAN",
        ),
        (
            ('navigation.sources=["nmea2000"]', 'nmea2000.interface="can0"'),
            r"nmea2000.interface: can0 carries DSOR \(can.interface\) already, and this is NMEA 2000",
        ),
        (
            ('navigation.sources=["nmea2000", "dronecan"]',),
            r"dronecan.interface: can1 carries NMEA 2000 \(nmea2000.interface\) already, and this is DroneCAN",
        ),
        (
            ('routing.buses.deck={interface="can1", nodes=[1]}',),
            r"deck.interface: can1 carries DroneCAN \(dronecan.interface\) already, and this is DSOR",
        ),
    ],
)
def test_a_bus_carries_one_protocol(values, words):
    with pytest.raises(ConfigError, match=words):
        config.load(VEHICLE, (TWIN, *values))
    command = [
        sys.executable,
        "-m",
        "delfim",
        "check",
        VEHICLE,
        *(word for each in (TWIN, *values) for word in ("--set", each)),
    ]
    told = subprocess.run(command, capture_output=True, text=True)
    assert told.returncode == 2
    assert "a bus carries one protocol" in told.stderr


def test_motors_and_sensors_of_dronecan_share_a_bus():
    settings = config.load(VEHICLE, (TWIN, 'navigation.sources=["dronecan"]', 'sensors.names=["dronecan"]'))
    assert settings.buses == ("can0", "can1")
    assert settings.bit_rates == {"can0": 500_000, "can1": 1_000_000}


def test_sensors_of_dronecan_are_refused_on_another_bus():
    with pytest.raises(ConfigError, match=r"dronecan.interface: can0 carries DSOR \(can.interface\) already"):
        config.load(VEHICLE, ('sensors.names=["dronecan"]', 'dronecan.interface="can0"'))


def test_buses_of_their_own_are_fine_and_set_up_with_their_own_bit_rates():
    settings = config.load(VEHICLE, (TWIN, 'navigation.sources=["nmea2000", "dsor"]', 'dronecan.interface="can2"'))
    assert settings.bit_rates == {"can0": 500_000, "can1": 250_000, "can2": 1_000_000}
    assert settings.buses == ("can0", "can1", "can2")
    assert settings.closed_buses == ("can1", "can2")


@pytest.mark.parametrize(
    ("row", "values", "words"),
    [
        (ROW % ("bow", 20, 0.0, ""), (), "bow: dronecan has motors 0 to 19, and 20 is none of them"),
        (ROW % ("bow", 1, 0.0, ""), (), "port and bow have one address, 1 of dronecan"),
        (ROW % ("bow", 2, 0.0, ""), ('dronecan.command="rpm"',), "rpm_max must say the revolutions"),
        (ROW % ("bow", 2, 0.0, ""), ("dronecan.rate_hz=5.0",), "dronecan.rate_hz"),
        (ROW % ("bow", 2, 0.0, ""), ("dronecan.node=126",), "dronecan.node"),
    ],
)
def test_what_cannot_be_is_refused_in_words(row, values, words):
    with pytest.raises(ConfigError, match=words):
        config.load(VEHICLE, (f"{TWIN[:-1]}, {row}]", *values))


def test_more_rudders_than_a_command_has_are_refused():
    rows = [ROW % (f"t{i}", i, i - 7.5, f', steer={{kind="rudder", address={i}}}') for i in range(16)]
    with pytest.raises(ConfigError, match="dronecan turns 15 thrusters at most"):
        config.load(VEHICLE, (f"thrusters=[{', '.join(rows)}]",))
