"""Values of sensors beside navigation, as consoles are told them."""

import math

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega

from delfim import config
from delfim.parts.mavlink.codec import ardupilot
from delfim.parts.mavlink.codec.wire import Sender, decode, frames
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.vehicle import sensors
from tests.parts.mavlink.mavlink_console import newest
from tests.parts.mavlink.test_mavlink_station import afloat, sail

SENSORS = config.Sensors(names=("sysstat", "nmea0183"))
PORTS = Nmea0183(ports={"sounder": Nmea0183Port(device="/dev/sounder")})


@pytest.fixture
def sea(make_boat):
    sea = afloat(make_boat(sensors=SENSORS, nmea0183=PORTS))
    helm = sea.vehicle.helm
    helm.settings = msgspec.structs.replace(helm.settings, sensors=SENSORS, nmea0183=PORTS)
    return sea


@pytest.mark.parametrize("mine", ardupilot.MESSAGES)
def test_the_messages_of_ardupilot_are_those_of_its_definition(mine) -> None:
    theirs = ardupilotmega.mavlink_map[mine.id]
    values = [float(number) if kind == "float" else number for number, kind in enumerate(theirs.fieldtypes, 1)]
    frame = Sender(1, 1, None, lambda: 0).pack(mine(*values))
    assert frame == theirs(*values).pack(ardupilotmega.MAVLink(None, 1, 1))
    back = decode(frames(frame)[0][0])
    assert back is not None
    assert [getattr(back, name) for name in theirs.fieldnames] == values
    assert theirs.msgname == back.get_type()


def measure(sea, age_s: float = 0.0, **values: float) -> None:
    at_s = sea.boat.clock.monotonic_s() - age_s
    sea.state.measured.update({name: (value, at_s) for name, value in values.items()})


def floats(heard: list) -> dict[str, float]:
    return {m.name: m.value for m in heard if m.get_type() == "NAMED_VALUE_FLOAT" and m.name != "OVERRIDE"}


def test_every_value_of_a_sensor_is_told_under_a_name_of_its_own(sea) -> None:
    rows = sensors.values(sea.vehicle.helm.settings)
    assert len({row.told for row in rows}) == len(rows)
    measure(sea, **{row.name: 0.5 * number for number, row in enumerate(rows)})
    assert floats(sail(sea, 1.1)) == {row.told.decode(): 0.5 * number for number, row in enumerate(rows)}


def test_depth_and_wind_are_told_as_ardupilot_tells_them(sea) -> None:
    sea.boat.navigate(heading_rad=math.radians(100.0))
    measure(sea, depth_m=4.2, wind_true_rad=math.radians(-90.0), wind_true_mps=5.5)
    sea.station.tick()
    heard = sea.console.listen()
    depth, wind = newest(heard, "WATER_DEPTH"), newest(heard, "WIND")
    assert depth.distance == pytest.approx(4.2)
    assert (depth.lat, depth.lng, depth.healthy) == (386_925_000, -92_150_000, 1)
    assert depth.yaw == pytest.approx(math.radians(100.0), abs=1e-3)
    assert math.isnan(depth.temperature)
    assert (wind.direction, wind.speed) == (pytest.approx(10.0, abs=0.1), pytest.approx(5.5))


def test_an_old_value_is_not_told_nor_one_twice_by_a_message_of_its_own(sea) -> None:
    measure(sea, age_s=sea.vehicle.helm.settings.sensors.stale_s + 0.1, depth_m=4.2)
    heard = sail(sea, 2.0)
    assert not floats(heard)
    assert not [m for m in heard if m.get_type() == "WATER_DEPTH"]
    measure(sea, depth_m=4.2)
    heard = sail(sea, 2.5)
    assert sum(m.get_type() == "WATER_DEPTH" for m in heard) == 1, "one sounding"
    assert len({m.time_boot_ms for m in heard if getattr(m, "name", "") == "depth_m"}) == 1, "the stamp is the sounding's"


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300, -1e39])
def test_a_value_that_no_message_can_carry_is_not_told(sea, value: float) -> None:
    measure(sea, depth_m=value, position_sigma_m=1.5)
    assert floats(sail(sea, 1.1)) == {"sigma_m": 1.5}
