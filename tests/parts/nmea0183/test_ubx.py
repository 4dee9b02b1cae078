"""UBX of a u-blox receiver, as pyubx2 makes it, to sentences: values, validity, mixed lines, and whatever is damaged."""

import math
import random
import tracemalloc
from datetime import UTC, datetime
from io import BytesIO
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyubx2 import UBX_PROTOCOL, UBXReader

from delfim.lines.nmea0183.framing import Sentences, framed
from delfim.lines.nmea0183.sentences import Bearing, Located
from delfim.lines.ubx import ubxframes, ubxmessages
from delfim.parts.nmea0183.combining import Combined
from delfim.parts.nmea0183.mixedline import Antennas, MixedLine
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from tests.mutations import cut, dropped, flipped, spliced
from tests.parts.nmea0183.receiver import dop, message, pvt, relposned

GGA = framed("GNGGA,120005.00,3841.4000,N,00912.0000,W,4,20,0.9,10.0,M,50.0,M,1.5,0000")
AT_NS = int(datetime(2026, 11, 22, 12, 0, 5, tzinfo=UTC).timestamp()) * 1_000_000_000
PAIR = Antennas(1.5, 0.0)


def solution(**values: Any) -> ubxmessages.Solution:
    (frame,) = ubxframes.UbxFrames().feed(pvt(**values))
    assert isinstance(frame, ubxframes.UbxFrame)
    _, reader = ubxmessages.READERS[frame.kind]
    told = reader(frame.payload)
    assert isinstance(told, ubxmessages.Solution)
    return told


def heading(line: MixedLine, data: bytes) -> Bearing | None:
    """None: nothing is said about a heading."""
    said = line.feed(data)
    assert len(said) < 2
    return said[0].message if said and isinstance(said[0].message, Bearing) else None


@given(
    st.integers(-899_999_999, 899_999_999),
    st.integers(-1_799_999_999, 1_799_999_999),
    st.integers(-100_000, 100_000),
    st.integers(-100_000, 100_000),
    st.integers(1, 9_999_999),
    st.integers(0, 60),
)
def test_a_solution_has_the_values_that_pyubx2_sees(latitude, longitude, north, east, accuracy, satellites):
    more = {"lat": latitude / 1e7, "lon": longitude / 1e7, "velN": north, "velE": east, "hAcc": accuracy, "numSV": satellites}
    raw = pvt(**more)
    _, theirs = UBXReader(BytesIO(raw), protfilter=UBX_PROTOCOL).read()
    ours = solution(**more)
    assert math.degrees(ours.latitude_rad or 0.0) == pytest.approx(theirs.lat, abs=1e-9)
    assert math.degrees(ours.longitude_rad or 0.0) == pytest.approx(theirs.lon, abs=1e-9)
    assert (ours.north_mps, ours.east_mps) == (theirs.velN / 1000, theirs.velE / 1000)
    assert ours.accuracy_m == theirs.hAcc / 1000
    assert ours.satellites == theirs.numSV
    assert ours.utc_ns == AT_NS


@pytest.mark.parametrize(
    ("told", "fix"),
    [
        ({"carrSoln": 0}, 3),
        ({"carrSoln": 0, "fixType": 4}, 3),
        ({"carrSoln": 0, "fixType": 2}, 2),
        ({"carrSoln": 0, "diffSoln": 1}, 4),
        ({"carrSoln": 1, "diffSoln": 1}, 6),
        ({"carrSoln": 2, "diffSoln": 1}, 5),
        ({"fixType": 0}, 0),
        ({"fixType": 1}, 0),  # reckoned
        ({"fixType": 5}, 0),  # time alone
        ({"gnssFixOk": 0}, 0),
        ({"invalidLlh": 1}, 0),
    ],
)
def test_the_kind_of_fix(told, fix):
    found = solution(**told)
    assert found.fix == fix
    assert (found.latitude_rad is None) is (fix == 0)
    assert (found.accuracy_m is None) is (fix == 0)


@pytest.mark.parametrize(
    ("code", "age_s"), [(0, None), (1, 1.0), (2, 2.0), (3, 5.0), (7, 30.0), (11, 120.0), (12, 121.0), (15, 121.0)]
)
def test_the_age_of_corrections_is_the_most_that_it_can_be(code, age_s):
    assert solution(lastCorrectionAge=code).corrections_s == age_s


@pytest.mark.parametrize("flag", ["validDate", "validTime", "fullyResolved"])
def test_a_time_that_is_not_sure_is_unknown(flag):
    assert solution(**{flag: 0}).utc_ns is None
    assert solution(**{flag: 0}).latitude_rad is not None


def test_a_fraction_of_a_second_may_be_negative():
    assert solution(nano=-250_000_000).utc_ns == AT_NS - 250_000_000


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (pvt(lat=100.0), "NAV-PVT: impossible position"),
        (pvt(velN=300_000), "NAV-PVT: impossible speed"),
        (pvt(month=13), "NAV-PVT: no such time"),
        (pvt(iTOW=700_000_000), "NAV-PVT: no time of week"),
        (ubxframes.framed(ubxmessages.NAV_PVT, bytes(91)), "NAV-PVT: of another length"),
        (pvt()[:-1] + b"\x00", "UBX: wrong checksum"),
        (b"\xb5\x62\x01\x07\xff\xff", "UBX: too long"),
        (relposned(version=0), "NAV-RELPOSNED: of another length"),  # of an older receiver
        (relposned(version=2), "NAV-RELPOSNED: of another version"),
    ],
)
def test_what_no_receiver_can_mean_is_refused_under_its_reason(data, reason):
    line = MixedLine(antennas=PAIR)
    assert line.feed(data) == []
    assert line.refused == {reason: 1}
    assert [each.formatter for each in line.feed(GGA)] == ["GGA"], "the line goes on"


def test_the_checksum_is_fletchers():
    raw = message("NAV-DOP", hDOP=0.88)
    assert ubxframes.framed(ubxmessages.NAV_DOP, raw[6:-2]) == raw


@given(st.lists(st.integers(1, 200), max_size=30))
def test_frames_and_sentences_come_mixed_and_in_pieces(cuts):
    whole = GGA + pvt() + GGA + dop() + relposned() + b"\xd3\x00\x04noise" + GGA
    line, found, at = MixedLine(antennas=PAIR), [], 0
    for length in (*cuts, len(whole)):
        found += line.feed(whole[at : at + length])
        at += length
    assert [each.formatter for each in found] == ["GGA", "ACC", "PVT", "GGA", "DOP", "REL", "GGA"]
    assert line.heard == {"GNGGA": 3, "NAV-PVT": 1, "NAV-DOP": 1, "NAV-RELPOSNED": 1}
    assert line.refused == {}


def test_a_line_of_sentences_is_read_as_before():
    ours, plain, data = MixedLine(), Sentences(), GGA + framed("GNVTG,90.0,T,,M,2.0,N,3.7,K,A") + b"$GNGGA,*00\r\n"
    assert ours.feed(data) == plain.feed(data)
    assert (ours.heard, ours.refused) == (plain.heard, plain.refused)


@pytest.mark.parametrize(
    ("told", "reason"),
    [
        ({"carrSoln": 1}, "no heading without a fixed solution"),
        ({"relPosHeadingValid": 0}, "no heading without a fixed solution"),
        ({"relPosValid": 0}, "no heading without a fixed solution"),
        ({"gnssFixOK": 0}, "no heading without a fixed solution"),
        ({"length_cm": 110}, "the antennas are not that far apart"),
        ({"length_cm": 181}, "the antennas are not that far apart"),
    ],
)
def test_a_heading_that_is_not_to_be_believed_ends_the_heading(told, reason):
    line = MixedLine(antennas=PAIR)
    assert heading(line, relposned(**told)) == Bearing(None)
    assert line.refused == {f"NAV-RELPOSNED: {reason}": 1}


def test_two_antennas_are_a_compass_with_an_accuracy():
    line = MixedLine(antennas=Antennas(1.5, math.radians(90.0)))  # from the port one to the starboard one
    told = heading(line, relposned(heading_deg=30.0))
    assert told is not None
    assert told.true_rad == pytest.approx(math.radians(300.0))
    assert told.deviation_rad == pytest.approx(math.radians(0.4))


@pytest.mark.parametrize("line", [MixedLine(), MixedLine(antennas=PAIR)])
def test_the_way_to_a_base_ashore_is_no_heading(line):
    """A rover tells it in the same message."""
    data = relposned(isMoving=0) if line._antennas is PAIR else relposned()
    assert heading(line, data) is None
    assert line.refused == {}


def test_a_receiver_that_sends_both_is_believed_in_ubx_and_in_sentences_when_that_ends():
    table = {"gnss": Nmea0183Port(device="/dev/gnss")}
    combined, line = Combined(Nmea0183(ports=table), 2.5, {}), MixedLine()

    def hear(data: bytes, now_s: float) -> list[Any]:
        return [n for each in line.feed(data) if (n := combined.take("gnss", each, now_s))]

    hear(GGA, 100.0)
    hear(dop(0.7), 100.0)
    (n,) = hear(pvt(6.0), 100.2)
    assert (n.fix, n.satellites, n.hdop, n.accuracy_m, n.corrections_s) == (5, 20, 0.7, pytest.approx(0.014), 2.0)
    assert (n.north_mps, n.east_mps) == (pytest.approx(1.0), pytest.approx(0.0))
    assert hear(GGA.replace(b"120005", b"120006"), 100.3) == [], "what it says in sentences is not another position"
    later = framed("GNGGA,120012.00,3841.4000,N,00912.0000,W,4,20,0.9,10.0,M,50.0,M,1.5,0000")
    (n,) = hear(later, 106.3)
    assert (n.fix, n.hdop, n.accuracy_m, n.corrections_s) == (5, 0.9, None, 1.5)


def test_a_frozen_receiver_is_silent():
    combined = Combined(Nmea0183(ports={"gnss": Nmea0183Port(device="/dev/gnss")}), 2.5, {})
    line = MixedLine()
    said = [combined.take("gnss", each, 100.0) for _ in range(3) for each in line.feed(pvt())]
    assert sum(each is not None for each in said) == 1
    assert combined.repeated == 2


def test_a_receiver_without_a_fix_says_so():
    line = MixedLine()
    located = line.feed(pvt(fixType=0, gnssFixOk=0))[-1].message
    assert isinstance(located, Located)
    assert (located.fix, located.latitude_rad, located.movement and located.movement.speed_mps) == (0, None, None)


def damage(count: int, seed: int = 1) -> MixedLine:
    """Frames with wrong bits, missing or repeated pieces; half of them with a right checksum, for their readers to try."""
    line, among = MixedLine(antennas=PAIR), random.Random(seed)
    bodies = pvt(), relposned(), dop(), GGA
    for i in range(count):
        raw = among.choice(bodies)
        if i % 2 or raw is GGA:
            line.feed(among.choice((flipped, cut, dropped, spliced))(raw, among))
        else:
            line.feed(ubxframes.framed(raw[2] << 8 | raw[3], flipped(raw[6:-2], among)))
    return line


def test_damage_raises_nothing_and_is_counted():
    line = damage(20_000)
    assert sum(line.refused.values()) > 5_000
    assert len(line.heard) <= 66
    assert len(line.refused) < 60
    line.feed(bytes(2000))  # the end of what the last damaged frame still waits for
    assert [each.formatter for each in line.feed(b"\r\n" + GGA)] == ["GGA"]


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_quarter_of_a_million_damaged_frames_leave_memory_flat():
    damage(10_000)
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for seed in range(5):
        damage(50_000, seed)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 1 << 18
