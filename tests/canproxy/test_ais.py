"""AIS on NMEA 2000: recorded traffic of real harbours, against the independent decoder, and whatever else may come."""

import logging
import math
from collections import Counter
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from nmea2000.decoder import NMEA2000Decoder

from delfim.base.errors import FormatError
from delfim.base.vessels import VesselFacts, VesselPosition
from delfim.canproxy.nmea2000 import ais
from delfim.canproxy.nmea2000.ais import decode
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.simulator.nodes.other_vessels import frames
from tests.canproxy.pgn_of import pgn_of
from tests.canproxy.test_recordings import BUSY, RAYMARINE, recording

COUNTS = {129038: 448, 129039: 85, 129794: 15, 129809: 5, 129810: 4}
STALLED = 1  # message that the recorder's pause of 1.2 s cut in two: too old for us to put together


def expected(pgn: int, raw: dict[str, Any], shown: dict[str, Any]) -> tuple[object, ...]:
    """The independent decoder's fields in the order and units of ours."""
    own = raw["aisTransceiverInformation"] in (2, 3, 4)
    if pgn in (129038, 129039):
        place = [
            None if raw[k] is None or abs(raw[k]) > most else math.radians(raw[k])
            for k, most in (("latitude", 90), ("longitude", 180))
        ]
        is_a, second = pgn == 129038, raw["timeStamp"]
        moves = raw["cog"], raw["sog"], raw["heading"], raw["rateOfTurn"] if is_a else None
        status = raw["navStatus"] if is_a else 15
        return (raw["userId"], *place, *moves, "AB"[not is_a], status, second if second < 60 else None, own)
    sizes = ("length", "beam", "positionReferenceFromStarboard", "positionReferenceFromBow")
    words = (shown.get("name") or None, shown.get("callsign") or None)
    return (raw["userId"], *words, raw.get("typeOfShip"), *(raw.get(size) for size in sizes), own)


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


@pytest.mark.parametrize("is_class_a", [True, False])
@pytest.mark.parametrize(("transceiver", "is_own"), [(0, False), (1, False), (2, True), (3, True), (4, True)])
def test_names_that_a_transponder_tells_of_its_own_boat_are_marked(is_class_a: bool, transceiver: int, is_own: bool) -> None:
    """Sent on channel A or B, or not broadcast; the recordings have received ones alone."""
    told = VesselFacts(263_000_009, "DELFIM", "CS1234", 36, 12.0, 4.0, 2.0, 6.0)
    for pgn, data in frames.facts(told, is_class_a):
        marked = data[:-2] + bytes((data[-2] | transceiver, data[-1]))
        assert decode(pgn, marked).is_own == is_own
        assert decode(pgn, marked[:-2]).is_own is False, "receivers of old leave it away"


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
