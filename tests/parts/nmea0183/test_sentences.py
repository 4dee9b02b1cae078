"""Sentences of NMEA 0183 to values: each trap of real receivers, against two independent libraries, and against damage."""

import functools
import math
import operator
import random
import re
import tracemalloc
from datetime import UTC, datetime

import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pynmeagps import NMEAReader

from delfim.canproxy.dsor.messages import Navigation
from delfim.lines.nmea0183.framing import LONGEST, NAMES_MAX, Sentences, checksum, framed
from delfim.lines.nmea0183.sentences import (
    KNOT,
    READERS,
    ActiveSatellites,
    Bearing,
    Breeze,
    DateTime,
    Located,
    Measurement,
    Movement,
    Sounding,
    Spread,
    Turning,
)
from delfim.lines.nmea0183.speaking import SPEAKERS
from delfim.parts.nmea0183.table import SPOKEN_BYTES

DEG = math.radians
LATITUDE, LONGITUDE = DEG(53 + 21.6802 / 60), -DEG(6 + 30.3372 / 60)
HERE = "5321.6802,N,00630.3372,W"
DAY_S = 9 * 3600 + 27 * 60 + 50.0
BODIES = (
    f"GPGGA,092750.000,{HERE},1,8,1.03,61.7,M,55.2,M,,",
    f"GNRMC,092750.000,A,{HERE},1.02,31.66,280511,2.5,W,A",
    "GPVTG,054.7,T,034.4,M,005.5,N,010.2,K,A",
    "GPGLL,4916.45,N,12311.12,W,225444,A,A",
    f"GNGNS,092750.000,{HERE},AN,8,1.03,61.7,55.2,,",
    "HEHDT,274.07,T",
    "HCHDG,98.3,0.5,E,12.6,W",
    "HCHDM,98.3,M",
    "TIROT,-35.6,A",
    "GPTHS,77.52,A",
    "GPZDA,160012.71,11,03,2004,-1,00",
    "GPGST,172814.0,0.006,0.023,0.020,273.6,0.023,0.020,0.031",
    "GNGSA,A,3,23,29,07,08,09,18,26,28,,,,,1.94,1.18,1.54",
    "SDDPT,76.1,0.5,100",
    "SDDBT,249.7,f,76.1,M,41.6,F",
    "WIMWV,320,R,15.0,M,A",
    "YXXDR,A,-2.5,D,PTCH,A,7.1,D,ROLL",
)


def one(body: str):
    """The message of a sentence; None if it is refused."""
    line = Sentences()
    found = line.feed(framed(body))
    assert len(found) + sum(line.refused.values()) == 1
    return found[0].message if found else None


def why(body: str) -> str:
    line = Sentences()
    assert line.feed(framed(body)) == []
    (reason,) = line.refused
    return reason


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (BODIES[0], Located(DAY_S, LATITUDE, LONGITUDE, 3, 8, 1.03, height_m=116.9)),
        (
            BODIES[1],
            Located(
                DAY_S,
                LATITUDE,
                LONGITUDE,
                3,
                None,
                None,
                1306574870_000000000,
                Movement(DEG(31.66), None, 1.02 * KNOT),
                -DEG(2.5),
            ),
        ),
        (BODIES[2], Movement(DEG(54.7), DEG(34.4), 5.5 * KNOT)),
        (BODIES[3], Located(82484.0, DEG(49 + 16.45 / 60), -DEG(123 + 11.12 / 60), 3)),
        (BODIES[4], Located(DAY_S, LATITUDE, LONGITUDE, 3, 8, 1.03)),
        (BODIES[5], Bearing(DEG(274.07))),
        (BODIES[6], Bearing(DEG(98.3 + 0.5 - 12.6), DEG(98.8), -DEG(12.6))),
        (BODIES[7], Bearing(None, DEG(98.3))),
        (BODIES[8], Turning(-DEG(35.6 / 60))),
        (BODIES[9], Bearing(DEG(77.52))),
        (BODIES[10], DateTime(1079020812_710000000)),
        (BODIES[11], Spread(0.023, 0.020)),
        (BODIES[12], ActiveSatellites(3, 1.18)),
        (BODIES[13], Sounding(76.1, 0.5)),
        (BODIES[14], Sounding(76.1)),
        (BODIES[15], Breeze(DEG(320), 15.0, True)),
        (BODIES[16], (Measurement("A", -2.5, "D", "PTCH"), Measurement("A", 7.1, "D", "ROLL"))),
    ],
    ids=lambda value: value[2:5] if isinstance(value, str) else "",
)
def test_a_sentence_is_read(body, said):
    def numbers(value):
        return [each for part in value for each in (numbers(part) if isinstance(part, tuple) else [part])]

    assert numbers(one(body)) == pytest.approx(numbers(said), abs=1e-12)


@pytest.mark.parametrize("quality", "06789X")
def test_reckoned_typed_and_simulated_positions_are_no_fix(quality):
    assert one(f"GPGGA,092750.000,{HERE},{quality},8,1.03,61.7,M,55.2,M,,")[1:4] == (None, None, 0)


def test_the_qualities_of_rtk_have_their_order_turned_round():
    """GGA: 4 is fixed, 5 is float; a navigation message: 5 is fixed, 6 is float."""
    fixes = [one(f"GPGGA,092750.000,{HERE},{quality},8,1.03,61.7,M,55.2,M,,").fix for quality in "12345"]
    assert fixes == [3, 4, 3, 5, 6]


@pytest.mark.parametrize("mode", "NESM")
def test_a_valid_rmc_whose_mode_is_no_fix_has_no_position(mode):
    message = one(f"GNRMC,092750.000,A,{HERE},1.02,31.66,280511,,,{mode}")
    assert message.latitude_rad is None
    assert message.fix == 0
    assert message.utc_ns is None
    assert message.movement == Movement(None, None, None)


def test_status_v_has_no_position_although_one_is_given():
    assert one(f"GNRMC,092750.000,V,{HERE},1.02,31.66,280511,,,A").latitude_rad is None
    assert one(f"GPGLL,{HERE},092750.000,V,A").latitude_rad is None


def test_the_navigational_status_of_version_4_1_is_not_read():
    assert one(f"GNRMC,092750.000,A,{HERE},1.02,31.66,280511,,,D,V").fix == 4


def test_a_variation_of_999_is_unknown():
    message = one(f"GPRMC,092750,A,{HERE},1.02,31.66,280511,999.9000,E,D")
    assert message.variation_rad is None
    assert message.latitude_rad == pytest.approx(LATITUDE)


def test_an_rmc_before_version_2_3_has_no_mode():
    assert one(f"GPRMC,092750,A,{HERE},1.02,31.66,280511,,").fix == 2


def test_a_year_of_two_digits():
    years = [
        datetime.fromtimestamp(one(f"GPRMC,000000,A,{HERE},,,0101{year},,,A").utc_ns / 1e9, UTC).year
        for year in ("80", "99", "00", "79")
    ]
    assert years == [1980, 1999, 2000, 2079]


def test_no_course_at_rest_is_unknown_and_not_north():
    assert one(f"GNRMC,092750.000,A,{HERE},0.02,,280511,,,A").movement == Movement(None, None, pytest.approx(0.02 * KNOT))
    assert one("GPVTG,,T,,M,0.02,N,0.04,K,A") == Movement(None, None, pytest.approx(0.02 * KNOT))


def test_a_vtg_without_letters():
    assert one("GPVTG,054.7,034.4,005.5,010.2") == Movement(DEG(54.7), DEG(34.4), pytest.approx(5.5 * KNOT))
    assert one("GPVTG,054.7,T,034.4,M,,N,036.0,K,A").speed_mps == pytest.approx(10.0)
    assert one("GPVTG,054.7,T,034.4,M,005.5,N,010.2,K,N") == Movement(None, None, None)


def test_a_gll_before_version_2_has_neither_time_nor_status():
    assert one(f"GPGLL,{HERE}") == Located(None, LATITUDE, pytest.approx(LONGITUDE), 2)


def test_gns_has_a_mode_for_each_system():
    fixes = {
        modes: one(f"GNGNS,092750.000,{HERE},{modes},8,1.03,,,,").fix
        for modes in ("NN", "AN", "NAD", "RRN", "FF", "EN", "MS", "")
    }
    assert fixes == {"NN": 0, "AN": 3, "NAD": 4, "RRN": 5, "FF": 6, "EN": 0, "MS": 0, "": 0}


def test_a_compass_without_variation_has_no_true_heading():
    assert one("HCHDG,98.3,,,,") == Bearing(None, DEG(98.3), None)
    assert one("HCHDG,,,,12.6,E") == Bearing(None, None, DEG(12.6))
    assert one("HCHDG,359.8,0.5,E,,").magnetic_rad == pytest.approx(DEG(0.3))


@pytest.mark.parametrize("mode", "EMSV")
def test_only_a_determined_heading_of_ths_counts(mode):
    assert one(f"GPTHS,77.52,{mode}") == Bearing(None)


def test_a_rate_of_turn_that_is_not_valid_is_unknown():
    assert one("TIROT,-35.6,V") == Turning(None)


@pytest.mark.parametrize(("feet", "metres", "fathoms"), [("249.7", "", ""), ("", "76.1", ""), ("", "", "41.6")])
def test_a_depth_in_any_of_its_units(feet, metres, fathoms):
    assert one(f"SDDBT,{feet},f,{metres},M,{fathoms},F").depth_m == pytest.approx(76.1, abs=0.05)


@pytest.mark.parametrize(("unit", "speed_mps"), [("N", 36.0 * KNOT), ("M", 36.0), ("K", 10.0), ("S", 16.09344)])
def test_a_wind_in_any_of_its_units(unit, speed_mps):
    assert one(f"WIMWV,45,T,36.0,{unit},A") == Breeze(DEG(45), pytest.approx(speed_mps), False)
    assert one(f"WIMWV,45,T,36.0,{unit},V") == Breeze(None, None, False)


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("GPGGA,092750.000,5360.0000,N,00630.3372,W,1,8,1.03,,M,,M,,", "GGA: no such position"),
        ("GPGGA,092750.000,9100.0000,N,00630.3372,W,1,8,1.03,,M,,M,,", "GGA: no such position"),
        ("GPGGA,092750.000,5321.0000,N,,,1,8,1.03,,M,,M,,", "GGA: position incomplete"),
        ("GPGGA,092750.000,5321.0000,,00630.3372,W,1,8,1.03,,M,,M,,", "GGA: position incomplete"),
        (f"GPGGA,096050.000,{HERE},1,8,1.03,,M,,M,,", "GGA: not a time"),
        ("GPGGA,092750", "GGA: too few fields"),
        (f"GPRMC,092750,A,{HERE},1.02,31.66,310299,,,A", "RMC: not a date"),
        (f"GPRMC,092750,A,{HERE},1.02,361.0,280511,,,A", "RMC: out of range"),
        (f"GPRMC,092750,A,{HERE},-1.0,31.0,280511,,,A", "RMC: out of range"),
        ("HEHDT,nan,T", "HDT: not a number"),
        ("HEHDT,1e2,T", "HDT: not a number"),
        ("HEHDT,1_0,T", "HDT: not a number"),
        ("HCHDG,98.3,0.5,X,,", "HDG: neither east nor west"),
        ("TIROT,999999,A", "ROT: out of range"),
        ("WIMWV,45,R,36.0,Q,A", "MWV: unit unknown"),
        ("YXXDR,A,-2.5,D", "XDR: too few fields"),
        ("YXXDR,A,-2.5,D,PTCH,A", "XDR: not in groups of four"),
        ("GP\x07,1", "not text"),
        ("G" * (LONGEST + 1), "too long"),
    ],
)
def test_a_malformed_sentence_is_refused_under_its_reason(body, reason):
    assert why(body) == reason


def test_a_sentence_may_come_in_pieces_and_behind_noise():
    line = Sentences()
    assert line.feed(b"\xff\x00half of $GPGG$HEHDT,274.07,") == []
    assert [each.message for each in line.feed(b"T*")] == []
    assert [each.message for each in line.feed(framed("HEHDT,274.07,T")[-4:])] == [Bearing(DEG(274.07))]
    tagged = b"\\s:GP0001,c:1390000000*4F\\" + framed("GPHDT,1.0,T")
    assert line.feed(tagged)[0].talker == "GP"
    assert line.refused == {}


def test_what_was_read_before_changes_nothing():
    """The sentences of an instant share its time and place, which are parsed once."""
    good, wrong = "GPGLL,3841.44,N,00912.92,W,101010.00,A,A", "GPGLL,3861.44,N,00912.92,W,101010.00,A,A"
    line = Sentences()
    found = [each.message for each in line.feed(b"".join(map(framed, (good, wrong, good, wrong))))]
    assert found == [one(good)] * 2
    assert line.refused == {"GLL: no such position": 2}


@given(st.lists(st.text("ab\r\n\v\f\x1c\x85", max_size=9).map(lambda text: text.encode("latin-1")), max_size=9))
def test_lines_end_with_a_return_or_a_line_feed_and_with_nothing_else(pieces: list[bytes]) -> None:
    line = Sentences()
    assert [line.feed(piece) for piece in pieces] == [[]] * len(pieces)
    ended = re.split(rb"[\r\n]", b"".join(pieces))[:-1]
    assert line.refused.get("no sentence", 0) == len([each for each in ended if each])


@given(st.binary(max_size=3 * LONGEST))
def test_the_checksum_is_that_of_all_characters_one_by_one(body: bytes) -> None:
    assert checksum(body) == functools.reduce(operator.xor, body, 0)


def test_a_checksum_may_lack_only_where_the_file_says_so_and_never_be_wrong():
    strict, lax = Sentences(), Sentences(needs_checksum=False)
    for line in (strict, lax):
        line.feed(b"$HEHDT,274.07,T\r\n$HEHDT,274.07,T*00\r\n$HEHDT,274.07,T*\r\n")
    assert strict.refused == {"no checksum": 1, "wrong checksum": 2}
    assert lax.refused == {"wrong checksum": 2}
    assert lax.heard == {"HEHDT": 1}


def test_other_sentences_are_counted_by_name_within_bounds():
    line = Sentences()
    assert line.feed(framed("GPGSV,1,1,00") + framed("PASHR,1.0,T") + framed("PGHDT,1.0,T") + b"!AIVDM,1,1,,A,x,0*6C\r\n") == []
    assert line.refused == {"wrong checksum": 1}
    for i in range(2 * NAMES_MAX):
        line.feed(framed(f"XX{i}" + "long" * 20 + ",1"))
    assert len(line.heard) == NAMES_MAX + 1
    assert max(map(len, line.heard)) == 6


def test_an_endless_line_is_dropped():
    line = Sentences()
    for _ in range(100):
        line.feed(b"$GPGGA" * 20)
    assert line.feed(b"\n" + framed("HEHDT,274.07,T"))[0].formatter == "HDT"
    assert set(line.refused) <= {"line without an end", "no checksum", "too long"}


# The independent libraries.


def of_pynmea2(body: str) -> dict[str, float | None]:
    """What pynmea2 reads from a sentence, by the names of this test."""
    m = pynmea2.parse(framed(body).decode().strip())
    told = (
        {"latitude": getattr(m, "latitude", None), "longitude": getattr(m, "longitude", None)} if getattr(m, "lat", "") else {}
    )
    for name, field in (
        ("heading", "heading"),
        ("rate", "rate_of_turn"),
        ("knots", "spd_over_grnd"),
        ("knots", "spd_over_grnd_kts"),
    ):
        if getattr(m, field, None) not in (None, ""):
            told[name] = float(getattr(m, field))
    for field in ("true_course", "true_track"):
        if getattr(m, field, None) not in (None, ""):
            told["course"] = float(getattr(m, field))
    return told


def of_pynmeagps(body: str) -> dict[str, float | None]:
    m = NMEAReader.parse(framed(body))
    told = {}
    for name, fields in (
        ("latitude", ("lat",)),
        ("longitude", ("lon",)),
        ("heading", ("headingT",)),
        ("rate", ("rot",)),
        ("knots", ("spd", "sogn")),
        ("course", ("cog", "cogt")),
    ):
        for field in fields:
            if getattr(m, field, "") != "":
                told[name] = float(getattr(m, field))
    return told


def ours(body: str) -> dict[str, float | None]:
    message = one(body)
    told = {}
    if isinstance(message, Located):
        told |= {"latitude": message.latitude_rad, "longitude": message.longitude_rad}
    movement = message.movement if isinstance(message, Located) else message if isinstance(message, Movement) else None
    if movement is not None:
        told |= {"course": movement.course_rad, "knots": None if movement.speed_mps is None else DEG(movement.speed_mps / KNOT)}
    if isinstance(message, Bearing):
        told["heading"] = message.true_rad
    if isinstance(message, Turning):
        told["rate"] = None if message.rate_radps is None else message.rate_radps * 60.0
    return {name: math.degrees(value) for name, value in told.items() if value is not None}


def navigation(latitude_rad, longitude_rad, north_mps, east_mps, heading_rad, rate_radps, utc_ns) -> Navigation:
    return Navigation(
        utc_ns, latitude_rad, longitude_rad, north_mps, east_mps, heading_rad, rate_radps, None, None, 3, 9, 0.9, 1
    )


NAVIGATION = st.builds(
    navigation,
    st.floats(-math.pi / 2, math.pi / 2),
    st.floats(-math.pi, math.pi),
    st.floats(-30, 30),
    st.floats(-30, 30),
    st.floats(0, math.tau),
    st.floats(-1, 1),
    st.integers(315_532_800 * 10**9, 3 * 10**18),  # 1980 to 2065: the year has two digits
)


@given(NAVIGATION)
def test_a_round_trip_agrees_with_both_libraries(n):
    for speak in SPEAKERS.values():
        body = speak(n).decode()[1:-5]
        mine = ours(body)
        assert of_pynmea2(body) == pytest.approx(mine, abs=1e-9)
        assert of_pynmeagps(body) == pytest.approx(mine, abs=1e-9)


@given(NAVIGATION)
def test_a_round_trip_keeps_the_values(n):
    said = {name: one(speak(n).decode()[1:-5]) for name, speak in SPEAKERS.items()}
    for name in ("RMC", "GGA"):
        assert (said[name].latitude_rad, said[name].longitude_rad) == pytest.approx(
            (n.latitude_rad, n.longitude_rad), abs=3e-10
        )
    assert said["RMC"].fix == said["GGA"].fix == n.fix
    assert (
        0 <= n.utc_ns - said["RMC"].utc_ns < 10_000_000
        or datetime.fromtimestamp(n.utc_ns / 1e9, UTC).year > 2079
        or n.utc_ns < 315532800 * 10**9
    )
    assert math.remainder(said["HDT"].true_rad - n.heading_rad, math.tau) == pytest.approx(0.0, abs=DEG(0.0051))
    assert said["ROT"].rate_radps == pytest.approx(n.yaw_rate_radps, abs=DEG(0.0051 / 60))
    for movement in (said["VTG"], said["RMC"].movement):
        assert movement.speed_mps == pytest.approx(math.hypot(n.north_mps, n.east_mps), abs=0.0003)


@given(NAVIGATION)
def test_no_sentence_is_longer_than_the_check_of_a_lines_speed_expects(n):
    for name, speak in SPEAKERS.items():
        assert len(speak(n._replace(fix=6, satellites=99, hdop=99.9, corrections_s=1e6))) <= SPOKEN_BYTES[name]


def test_the_age_of_corrections_is_told():
    """To who takes the boat for a receiver; a simulated receiver says it likewise."""
    for age_s, heard_s in ((None, None), (1.0, 1.0), (21.04, 21.0), (1e6, 999.0)):
        n = navigation(0.1, 0.1, 0.0, 0.0, 0.1, 0.1, 1_795_000_000_000_000_000)._replace(corrections_s=age_s)
        assert one(SPEAKERS["GGA"](n).decode()[1:-5]).corrections_s == heard_s
        told = pynmea2.parse(SPEAKERS["GGA"](n).decode().strip()).age_gps_data
        assert (float(told) if told else None) == heard_s


def test_the_unknown_is_not_told():
    nothing = Navigation(0, None, None, None, None, None, None, None, None, 0, 0, None, 1)
    assert [speak(nothing) for speak in SPEAKERS.values()] == [b""] * 5
    timeless = navigation(0.1, 0.1, 0.0, 0.0, 0.1, 0.1, 0)
    assert SPEAKERS["RMC"](timeless) == SPEAKERS["GGA"](timeless) == b""


# Damage.


def damage(count: int, seed: int = 3) -> Sentences:
    """Sentences with wrong characters, half of them with a right checksum so that the readers try them."""
    line, random_ = Sentences(), random.Random(seed)
    for i in range(count):
        raw = bytearray(framed(random_.choice(BODIES)))
        body = raw if i % 2 else raw[1:-5]
        for _ in range(random_.randint(1, 3)):
            body[random_.randrange(len(body))] = random_.getrandbits(8) if i % 2 else random_.randrange(32, 127)
        line.feed(bytes(raw) if i % 2 else framed(body.decode()))
    return line


def test_damage_raises_nothing_and_is_counted():
    line = damage(40_000)
    assert len(line.refused) <= 12 * len(READERS)
    assert sum(line.refused.values()) > 20_000


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_quarter_of_a_million_damaged_sentences_leave_memory_flat():
    damage(10_000)
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for seed in range(5):
        line = damage(50_000, seed)
        assert sum(line.refused.values()) > 25_000
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 1 << 18
