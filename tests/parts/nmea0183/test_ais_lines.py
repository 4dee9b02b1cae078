"""AIS on lines of NMEA 0183, through the boat's source and sensor: beside a receiver's sentences, and on a line of its own."""

from functools import partial
from typing import Any

import pytest

from delfim import config
from delfim.base import geodesy
from delfim.base.clock import ManualClock
from delfim.lines.nmea0183.framing import framed
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.parts.traffic.lookout import TrafficLookout
from delfim.simulator.line import LockstepLine
from delfim.vehicle import sensors
from delfim.vehicle.links import Links
from delfim.vehicle.navigation.fixes import open_sources
from delfim.vehicle.state import HEARD_MANY, HEARD_MAX, State

GGA = framed("GPGGA,120000.00,4734.9700,N,12220.7500,W,1,9,1.0,0.0,M,,M,,")
SHIP = b"!AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0*5C\r\n"
LONG = (
    b"!AIVDM,2,1,1,A,55?MbV02;H;s<HtKR20EHE:0@T4@Dn2222222216L961O5Gf0NSQEp6ClRp8,0*1C\r\n",
    b"!AIVDM,2,2,1,A,88888888880,2*25\r\n",
)
OWN = framed("AIVDO,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0").replace(b"$", b"!")


class Aboard:
    """A boat with one line; it navigates by it, or reads it as a sensor."""

    def __init__(self, *, navigates: bool, **traffic: Any) -> None:
        self.clock, self.state = ManualClock(monotonic_s=1000.0), State()
        self.line = LockstepLine(self.clock)
        self.state.origin = geodesy.origin(0.8305, -2.1353)
        settings = config.Vehicle(
            boat=config.BoatTable(name="tried"),
            navigation=config.NavigationTable(sources=("nmea0183",) if navigates else ("dsor",)),
            sensors=config.Sensors(names=() if navigates else ("nmea0183",)),
            nmea0183=Nmea0183(ports={"ais": Nmea0183Port(device="/dev/ais", baud=38_400)}),
            traffic=config.TrafficTable(**traffic),
        )
        links = Links(lambda *_: pytest.fail("no bus"), lambda *_: self.line)
        self.lookout = TrafficLookout(settings.traffic)
        if navigates:
            (source,) = open_sources(settings, links, self.state)
            self._read = source.read
        else:
            (sensor,) = sensors.open_sensors(settings, links)
            self._read = partial(sensor.read, self.state)

    def hear(self, *pieces: bytes) -> object:
        fix = None
        for data in pieces:
            self.line.put(data)
            fix = self._read(self.clock.monotonic_s()) or fix
        self.lookout.hear(self.state)
        self.lookout.look(self.state, self.clock.monotonic_s())
        self.clock.advance(1.0)
        return fix


@pytest.mark.parametrize("navigates", [True, False])
def test_ais_beside_other_sentences_tells_of_a_vessel_and_disturbs_nobody(navigates: bool) -> None:
    boat = Aboard(navigates=navigates)
    fix = boat.hear(SHIP[:20], SHIP[20:] + GGA + LONG[0], LONG[1])
    assert (fix is not None) == navigates
    (target,) = boat.state.traffic.targets
    assert (target.key, target.kind, target.status, target.speed_mps) == ("477553000", "A", 5, 0.0)
    assert boat.state.traffic.refused == ()
    assert (boat.state.counts, len(boat.state.heard)) == ({}, 0)


def test_the_own_transponder_on_the_line_is_no_target() -> None:
    boat = Aboard(navigates=False)
    boat.hear(OWN)
    assert boat.state.traffic.targets == ()
    assert (boat.state.traffic.own_s, dict(boat.state.traffic.refused)) == (1000.0, {"own transponder": 1})


def test_a_part_without_its_beginning_is_counted_and_a_key_leaves_lines_alone() -> None:
    boat = Aboard(navigates=False)
    boat.hear(LONG[1], SHIP)
    assert dict(boat.state.traffic.refused) == {"AIS sentence: a part is missing": 1}
    assert len(boat.state.traffic.targets) == 1
    boat = Aboard(navigates=False, hears=("nmea2000",))
    boat.hear(SHIP)
    assert boat.state.traffic.targets == ()


def test_a_line_that_floods_fills_a_bounded_queue_alone() -> None:
    """With one vessel's reports it does not even do that: the newest of them waits."""
    boat = Aboard(navigates=True)
    for _ in range(20):
        boat.line.put(SHIP * 80)
        boat._read(1000.0)
    assert len(boat.state.heard) == HEARD_MANY + 1 < HEARD_MAX
    assert boat.state.counts == {"traffic_dropped": 20 * 80 - HEARD_MANY - 1}
