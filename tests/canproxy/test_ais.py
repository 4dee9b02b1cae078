"""AIS on NMEA 2000: recorded traffic of real harbours, against the independent decoder, and whatever else may come."""

import logging
import math
from collections import Counter
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from nmea2000.decoder import NMEA2000Decoder

from delfim import config
from delfim.canproxy.nmea2000 import ais
from delfim.canproxy.nmea2000.ais import VesselFacts, VesselPosition, decode
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.clock import ManualClock
from delfim.errors import FormatError
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle.sensors import nmea2000
from delfim.vehicle.sensors.nmea2000 import SHIPS_MAX, SHIPS_S, Nmea2000Instruments
from delfim.vehicle.state import State
from tests.canproxy.pgn_of import pgn_of
from tests.canproxy.test_recordings import BUSY, RAYMARINE, recording

COUNTS = {129038: 448, 129039: 85, 129794: 15, 129809: 5, 129810: 4}
STALLED = 1  # message that the recorder's pause of 1.2 s cut in two: too old for us to put together


def expected(pgn: int, raw: dict[str, Any], shown: dict[str, Any]) -> tuple[object, ...]:
    """The independent decoder's fields in the order and units of ours."""
    if pgn in (129038, 129039):
        place = [
            None if raw[k] is None or abs(raw[k]) > most else math.radians(raw[k])
            for k, most in (("latitude", 90), ("longitude", 180))
        ]
        return (raw["userId"], *place, raw["cog"], raw["sog"], raw["heading"], raw.get("rateOfTurn") if pgn == 129038 else None)
    sizes = ("length", "beam", "positionReferenceFromStarboard", "positionReferenceFromBow")
    words = (shown.get("name") or None, shown.get("callsign") or None)
    return (raw["userId"], *words, raw.get("typeOfShip"), *(raw.get(size) for size in sizes))


def test_every_field_of_every_vessel_is_what_the_independent_decoder_says() -> None:
    logging.getLogger("nmea2000").setLevel(logging.ERROR)
    count: Counter[int] = Counter()
    missed = 0
    for name in (BUSY, RAYMARINE):
        theirs, fast = NMEA2000Decoder(), {pgn: FastPacket(Counter()) for pgn in ais.PGNS}
        for line in recording(name):
            _, pgn, address, _ = pgn_of(line.frame.arb)
            if pgn not in ais.PGNS:
                continue
            message, data = theirs.decode(line.text), fast[pgn].feed(address, line.frame.data, line.now_s)
            if message is None or data is None:
                missed += (message is None) != (data is None)
                continue
            count[pgn] += 1
            raw, shown = ({field.id: getattr(field, which) for field in message.fields} for which in ("raw_value", "value"))
            for mine, other in zip(decode(pgn, data), expected(pgn, raw, shown), strict=True):
                assert mine == (pytest.approx(other, abs=1e-9) if isinstance(other, float) else other)
    assert (count, missed) == (COUNTS, STALLED)


@given(st.sampled_from(sorted(ais.PGNS)), st.binary(max_size=100))
def test_any_bytes_are_a_vessel_or_refused(pgn: int, data: bytes) -> None:
    try:
        told = decode(pgn, data)
    except FormatError:
        return
    assert isinstance(told, VesselPosition if pgn in (129038, 129039) else VesselFacts)
    assert 0 < told.mmsi <= 999_999_999
    assert all(math.isfinite(each) for each in told if isinstance(each, float))
    assert all(each.isprintable() for each in told if isinstance(each, str))


def test_vessels_are_counted_and_forgotten_and_their_number_is_bounded() -> None:
    bus = LockstepBus(ManualClock())
    sensor, state = (
        Nmea2000Instruments(config.Vehicle(boat=config.BoatTable(name="test")), bus.bound(*nmea2000.FILTERS)),
        State(),
    )
    for mmsi in (1, 2, 1, 3):
        sensor._sight(state, mmsi, 1.0)
    assert state.measured["ais_ships"] == (3.0, 1.0)
    sensor._sight(state, 2, 1.0 + SHIPS_S)
    sensor._sight(state, 2, 1.1 + SHIPS_S)
    assert state.measured["ais_ships"][0] == 1.0
    for mmsi in range(1, 2 * SHIPS_MAX):
        sensor._sight(state, mmsi, 700.0)
    assert state.measured["ais_ships"][0] == SHIPS_MAX


def test_the_recorded_harbour_is_full_of_ships() -> None:
    bus = LockstepBus(ManualClock())
    sensor, state = (
        Nmea2000Instruments(config.Vehicle(boat=config.BoatTable(name="test")), bus.bound(*nmea2000.FILTERS)),
        State(),
    )
    for line in recording(BUSY):
        sensor.hear(state, line.frame, line.now_s)
    assert state.measured["ais_ships"][0] > 50
    assert state.counts == {}
