"""NMEA 2000 codec, fast packets and readings, on frames made here. Recorded traffic: test_recordings.py.
Which device is believed: tests/test_fusion.py.
"""

import math
import struct
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_ERR, Frame, extended, standard
from delfim.canproxy.dsor.messages import Navigation
from delfim.canproxy.nmea2000 import pgns
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.canproxy.nmea2000.pgns import (
    Attitude,
    CourseSpeed,
    GnssPosition,
    NorthReference,
    PositionRapid,
    RateOfTurn,
    SystemTime,
    Variation,
    VesselHeading,
    decode,
    encode,
)
from delfim.canproxy.socket import CanAddress, accepts
from delfim.parts.nmea2000.combining import Nmea2000Source
from delfim.parts.nmea2000.table import Nmea2000
from delfim.vehicle.navigation.fusion import VARIATION_S
from tests.canproxy.pgn_of import pgn_of

STALE_S = 1.0
PGNS = (126992, 127250, 127251, 127257, 127258, 129025, 129026, 129029)
LISBON = PositionRapid(math.radians(38.69), math.radians(-9.21))
PORTO = PositionRapid(math.radians(41.15), math.radians(-8.61))
NOWHERE = PositionRapid(None, None)


def source(*preferred: int, variation_deg: float = 0.0, stale_s: float = STALE_S) -> Nmea2000Source:
    return Nmea2000Source(Nmea2000(preferred_sources=preferred, variation_deg=variation_deg), stale_s)


def say(bus: Nmea2000Source, address: int, message: pgns.Message, now_s: float, t_ns: int = 0) -> Navigation | None:
    """A device speaks: what comes of the last frame."""
    navigation = None
    for frame in encode(message, address):
        navigation = bus.feed(frame._replace(t_ns=t_ns), now_s)
    return navigation


def said(bus: Nmea2000Source, address: int, message: pgns.Message, now_s: float, t_ns: int = 0) -> Navigation:
    navigation = say(bus, address, message, now_s, t_ns)
    assert navigation is not None
    return navigation


def payload(frames: list[Frame]) -> bytes:
    """A message without its packaging, the simple way: frames in order, none missing."""
    if len(frames) == 1:
        return frames[0].data
    return b"".join([frames[0].data[2:], *(f.data[1:] for f in frames[1:])])[: frames[0].data[1]]


def gnss(**changes: object) -> GnssPosition:
    return GnssPosition(1_700_000_000_000_000_000, LISBON.latitude_rad, LISBON.longitude_rad, 1, 9, 0.8)._replace(**changes)  # type: ignore[arg-type]


# Identifiers ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("identifier", "expected"),
    [
        (0x09F8012B, (2, 129025, 0x2B, 255)),
        (0x0DF8051F, (3, 129029, 0x1F, 255)),
        (0x18EA1400, (6, 59904, 0x00, 0x14)),  # a request, addressed
        (0x1DEFFFCC, (7, 126720, 0xCC, 0xFF)),  # addressed to everybody, data page 1
        (0x18EEFF01, (6, 60928, 0x01, 0xFF)),
        (0x1AEA1400, (6, 0x2EA00, 0x00, 0x14)),  # extended data page: not NMEA 2000, and not one of its PGNs
        (0x1FFFFFFF, (7, 0x3FFFF, 0xFF, 255)),
    ],
)
def test_pgn_of_an_identifier(identifier: int, expected: tuple[int, int, int, int]) -> None:
    assert pgn_of(extended(identifier)) == expected


@pytest.mark.parametrize("arb", [standard(0x123), extended(0x09F8012B, remote=True), extended(0x09F8012B) | 1])
def test_pgn_of_what_is_no_extended_data_frame_is_refused(arb: int) -> None:
    with pytest.raises(FormatError, match="extended data frame"):
        pgn_of(arb)


def test_filters_pass_these_pgns_and_no_others() -> None:
    def passes(arb: int) -> bool:
        return any(accepts(CanAddress(*pair), arb) for pair in Nmea2000Source.filters)

    others = {pgn ^ 1 << bit for pgn in PGNS for bit in range(18)} - set(PGNS)
    assert not any(passes(extended(2 << 26 | pgn << 8 | 43)) for pgn in others)
    assert all(passes(extended(p << 26 | pgn << 8 | a)) for pgn in PGNS for p in range(8) for a in (0, 43, 251))
    assert not passes(extended(2 << 26 | 129025 << 8 | 43, remote=True))
    assert not passes(standard(0x7FF))


# Codec ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pgn", "data", "expected"),
    [
        (129025, "0000000000000080", FormatError),  # longitude of -214 degrees
        (129025, "01e9a435 00000000", FormatError),  # 900000001
        (129025, "00e9a435 00d2496b", PositionRapid(math.pi / 2, math.pi)),
        (129025, "ffffff7f feffff7f", NOWHERE),
        (129025, "00000000 fdffff7f", PositionRapid(0.0, None)),
        (129026, "fffc 6ff5 0000 ffff", CourseSpeed(NorthReference.TRUE, 6.2831, 0.0)),
        (129026, "fffc 70f5 0000 ffff", CourseSpeed(NorthReference.TRUE, 0.0, 0.0)),
        (129026, "fffd 71f5 0000 ffff", FormatError),
        (129026, "ffff ffff fdff ffff", CourseSpeed(None, None, None)),
        (129026, "fffe 1027 fcff ffff", CourseSpeed(None, 1.0, 655.32)),
        (127250, "ff 1027 e803 18fc fd", VesselHeading(1.0, 0.1, -0.1, NorthReference.MAGNETIC)),
        (127250, "ff ffff ff7f fe7f fc", VesselHeading(None, None, None, NorthReference.TRUE)),
        (127250, "ff 1027 b97a ff7f fc", FormatError),  # deviation of 3.1417 rad
        (127251, "ff 003b8800 ffffff", RateOfTurn(0.279)),
        (127251, "ff 00000080 ffffff", RateOfTurn(-(2**31) * 1e-6 / 32)),
        (127251, "ff fdffff7f ffffff", RateOfTurn(None)),
        (127257, "ff e803 d007 48f4 ff", Attitude(0.1, 0.2, -0.3)),
        (127257, "ff ff7f 5d3d 0000 ff", FormatError),  # pitch of 1.5709 rad
        (127258, "ff ff ffff 9d01 ffff", Variation(0.0413)),
        (127258, "ff ff ffff b97a ffff", FormatError),
        (126992, "ff f0 0100 10270000", SystemTime(86_401_000_000_000)),
        (126992, "ff f0 ffff 10270000", SystemTime(None)),
        (126992, "ff f0 0100 10dc7f33", FormatError),  # second 86401 of the day
    ],
)
def test_known_bytes(pgn: int, data: str, expected: object) -> None:
    if expected is FormatError:
        with pytest.raises(FormatError, match="impossible"):
            decode(pgn, bytes.fromhex(data))
    else:
        decoded = decode(pgn, bytes.fromhex(data))
        assert type(decoded) is type(expected)
        assert decoded == pytest.approx(expected, nan_ok=False, abs=1e-12)


def test_a_negative_dilution_of_precision_is_impossible() -> None:
    data = bytearray(payload(encode(gnss(hdop=0.0), 1)))
    data[34:36] = b"\xff\xff"
    with pytest.raises(FormatError, match="dilution"):
        decode(129029, bytes(data))


def test_a_heading_just_below_north_is_sent_as_an_angle_below_a_turn() -> None:
    assert encode(VesselHeading(math.tau - 1e-6, None, None, NorthReference.TRUE), 1)[0].data[1:3] == bytes(2)


@pytest.mark.parametrize("pgn", PGNS)
def test_a_wrong_length_is_refused(pgn: int) -> None:
    right = 43 if pgn == 129029 else 8
    for length in {0, 1, right - 1, *([] if pgn == 129029 else [right + 1, 223])}:
        with pytest.raises(FormatError, match="instead of"):
            decode(pgn, b"\xff" * length)


def test_reference_stations_may_follow_a_gnss_position() -> None:
    data = payload(encode(gnss(), 1))
    assert decode(129029, data + bytes(8)) == decode(129029, data)


def test_a_pgn_that_is_not_read_here_is_refused() -> None:
    with pytest.raises(FormatError, match="PGN 60928"):
        decode(60928, bytes(8))


def angles(low: float, high: float) -> st.SearchStrategy[float | None]:
    return st.none() | st.floats(low, high)


references = st.sampled_from((NorthReference.TRUE, NorthReference.MAGNETIC, None))
times = st.none() | st.integers(0, 65532 * 86_400_000_000_000)
latitudes, longitudes = angles(-1.57, 1.57), angles(-3.14, 3.14)
messages: st.SearchStrategy[pgns.Message] = st.one_of(
    st.builds(PositionRapid, latitudes, longitudes),
    st.builds(CourseSpeed, references, angles(0, 6.2831), angles(0, 655)),
    st.builds(
        GnssPosition,
        times,
        latitudes,
        longitudes,
        st.none() | st.integers(0, 13),
        st.none() | st.integers(0, 252),
        angles(0, 327),
    ),
    st.builds(VesselHeading, angles(0, 6.2831), angles(-3.14, 3.14), angles(-3.14, 3.14), references),
    st.builds(RateOfTurn, angles(-67, 67)),
    st.builds(Attitude, angles(-3.14, 3.14), angles(-1.57, 1.57), angles(-3.14, 3.14)),
    st.builds(Variation, angles(-3.14, 3.14)),
    st.builds(SystemTime, times),
)
RESOLUTION = {
    "utc_ns": 100_000,
    "speed_mps": 0.005,
    "hdop": 0.005,
    "rate_radps": 2e-8,
    "latitude_rad": 1e-9,
    "longitude_rad": 1e-9,
}


@given(messages, st.integers(0, 251), st.integers(0, 7))
def test_what_is_sent_is_read(message: pgns.Message, address: int, sequence: int) -> None:
    frames = encode(message, address, sequence)
    pgn = pgn_of(frames[0].arb)[1]
    assert [pgn_of(f.arb)[1:] for f in frames] == [(pgn, address, 255)] * len(frames)
    assert all(len(f.data) == 8 for f in frames)
    again = decode(pgn, payload(frames))
    assert type(again) is type(message)
    for name, sent, read in zip(message._fields, message, again, strict=True):
        assert (read is None) == (sent is None), name
        if sent is not None:
            assert abs(read - sent) <= RESOLUTION.get(name, 0.5e-4) * (1 + 1e-9), name


@given(st.floats() | st.none(), st.integers(-(2**70), 2**70))
def test_what_cannot_be_sent_is_sent_as_not_available_or_fits(value: float | None, number: int) -> None:
    """Anything may come from a simulator under fault injection; nobody on the bus may choke on it."""
    for message in (
        PositionRapid(value, value),
        CourseSpeed(NorthReference.TRUE, value, value),
        GnssPosition(number, value, value, number, number, value),
        VesselHeading(value, value, value, None),
        RateOfTurn(value),
        Attitude(value, value, value),
        Variation(value),
        SystemTime(number),
    ):
        frames = encode(message, 1)
        decode(pgn_of(frames[0].arb)[1], payload(frames))


@pytest.mark.parametrize("address", [-1, 252, 255])
def test_an_address_that_nobody_can_have_does_not_send(address: int) -> None:
    with pytest.raises(FormatError, match="address"):
        encode(LISBON, address)


@given(st.sampled_from(PGNS) | st.integers(0, 0x3FFFF), st.binary(max_size=230))
def test_decoding_raises_format_error_only(pgn: int, data: bytes) -> None:
    try:
        message = decode(pgn, data)
    except FormatError:
        return
    assert all(value is None or math.isfinite(value) for value in message)


# Fast packets ---------------------------------------------------------------------------------------------------------------


def packet(data: bytes, sequence: int = 0) -> list[bytes]:
    """The frames of a fast packet of any length, written apart from the code under test."""
    frames, rest = [bytes([sequence << 5, len(data)]) + data[:6]], data[6:]
    while rest:
        frames.append(bytes([sequence << 5 | len(frames)]) + rest[:7])
        rest = rest[7:]
    return [f.ljust(8, b"\xff") for f in frames]


@given(st.binary(min_size=1, max_size=223), st.randoms(use_true_random=False), st.integers(0, 7))
def test_frames_in_any_order_and_repeated_make_one_message(data: bytes, random: object, sequence: int) -> None:
    frames = packet(data, sequence)
    doubled = frames[:-1] * 2
    random.shuffle(doubled)  # type: ignore[attr-defined]
    fast = FastPacket(Counter())
    assert [fast.feed(5, f, 0.0) for f in doubled] == [None] * len(doubled)
    assert fast.feed(5, frames[-1], 0.1) == data
    assert fast.errors == Counter({"fast packet: duplicated frame": len(frames) - 1} if len(frames) > 1 else {})


def test_sources_and_sequences_are_told_apart() -> None:
    errors: Counter[str] = Counter()
    fast = FastPacket(errors)
    streams = {(7, 0): b"a" * 20, (8, 0): b"b" * 20, (7, 1): b"c" * 20}
    woven = zip(*([(key, f) for f in packet(data, key[1])] for key, data in streams.items()), strict=True)
    whole = {key: fast.feed(key[0], f, 0.0) for step in woven for key, f in step}
    assert whole == streams
    assert not errors


def test_a_message_with_a_frame_missing_is_dropped_and_counted() -> None:
    errors: Counter[str] = Counter()
    fast = FastPacket(errors)
    for sequence in range(4):
        for f in packet(b"x" * 43, sequence)[:-1]:
            assert fast.feed(5, f, 0.0) is None
    assert errors == {"fast packet: incomplete": 4 - FastPacket.IN_FLIGHT}
    assert [fast.feed(5, f, 0.1) for f in packet(b"y" * 43, 4)][-1] == b"y" * 43


def test_halves_of_two_messages_are_not_joined_after_the_time_out() -> None:
    errors: Counter[str] = Counter()
    fast = FastPacket(errors)
    old, new = packet(b"x" * 43, 3), packet(b"y" * 43, 3)
    for f in old[4:]:
        fast.feed(5, f, 0.0)
    assert [fast.feed(5, f, 0.76) for f in new[:4]] == [None] * 4
    assert errors == {"fast packet: timed out": 1}
    assert [fast.feed(5, f, 0.8) for f in new[4:]][-1] == b"y" * 43


def test_a_sequence_number_that_comes_round_begins_anew() -> None:
    errors: Counter[str] = Counter()
    fast = FastPacket(errors)
    for f in packet(b"x" * 43)[:5]:
        fast.feed(5, f, 0.0)
    assert [fast.feed(5, f, 0.5) for f in packet(b"y" * 43)][-1] == b"y" * 43
    assert errors == {"fast packet: incomplete": 1}


@pytest.mark.parametrize("data", [b"", bytes([0, 20, 1, 2]), bytes([0, 0]) + bytes(6), bytes([0, 224]) + bytes(6), bytes(9)])
def test_a_malformed_frame_is_counted(data: bytes) -> None:
    errors: Counter[str] = Counter()
    assert FastPacket(errors).feed(5, data, 0.0) is None
    assert errors == {"fast packet: malformed frame": 1}


def test_a_frame_beyond_the_end_spoils_the_message() -> None:
    errors: Counter[str] = Counter()
    fast = FastPacket(errors)
    first, _, last = packet(b"x" * 20)
    assert [fast.feed(5, f, 0.0) for f in (bytes([9]) + bytes(7), first, last)] == [None] * 3
    assert errors == {"fast packet: frame beyond the end": 1}


@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=9), st.floats(0, 2)), max_size=200))
def test_reassembly_takes_anything_and_stays_bounded(frames: list[tuple[int, bytes, float]]) -> None:
    fast, now_s = FastPacket(Counter()), 0.0
    for address, data, later_s in frames:
        now_s += later_s
        message = fast.feed(address % 3, data, now_s)
        assert message is None or 1 <= len(message) <= FastPacket.LENGTH_MAX
    assert all(len(flights) <= FastPacket.IN_FLIGHT for flights in fast._flights.values())


# The source -----------------------------------------------------------------------------------------------------------------


def test_a_position_brings_the_newest_of_everything() -> None:
    bus = source()
    utc_ns = 1_700_000_000_000_000_000
    say(bus, 3, VesselHeading(1.0, None, None, NorthReference.TRUE), 10.0)
    say(bus, 3, RateOfTurn(-0.1), 10.0)
    say(bus, 3, Attitude(None, 0.02, -0.03), 10.0)
    say(bus, 2, CourseSpeed(NorthReference.TRUE, math.pi / 2, 1.5), 10.0)
    say(bus, 2, gnss(utc_ns=utc_ns), 10.0)
    n = said(bus, 2, PORTO, 10.25)
    assert n == Navigation(
        utc_ns=utc_ns + 250_000_000,
        latitude_rad=pytest.approx(PORTO.latitude_rad, abs=1e-9),
        longitude_rad=pytest.approx(PORTO.longitude_rad, abs=1e-9),
        north_mps=pytest.approx(0.0, abs=1e-4),
        east_mps=pytest.approx(1.5, abs=1e-4),
        heading_rad=pytest.approx(1.0),
        yaw_rate_radps=pytest.approx(-0.1, abs=1e-7),
        roll_rad=pytest.approx(-0.03),
        pitch_rad=pytest.approx(0.02),
        fix=3,
        satellites=9,
        hdop=pytest.approx(0.8),
        counter=2,  # the position of the GNSS message was the first
    )


def test_nothing_but_a_position_makes_a_message() -> None:
    bus = source()
    for message in (
        VesselHeading(1.0, None, None, NorthReference.TRUE),
        RateOfTurn(0.1),
        Attitude(None, 0.0, 0.0),
        CourseSpeed(NorthReference.TRUE, 1.0, 1.0),
        Variation(0.1),
        SystemTime(1),
    ):
        assert say(bus, 1, message, 0.0) is None


@pytest.mark.parametrize(
    ("message", "unknown", "field"),
    [
        (
            VesselHeading(1.0, None, None, NorthReference.TRUE),
            VesselHeading(None, None, None, NorthReference.TRUE),
            "heading_rad",
        ),
        (VesselHeading(1.0, None, None, NorthReference.TRUE), VesselHeading(1.0, None, None, None), "heading_rad"),
        (RateOfTurn(0.1), RateOfTurn(None), "yaw_rate_radps"),
        (CourseSpeed(NorthReference.TRUE, 1.0, 1.0), CourseSpeed(NorthReference.TRUE, 1.0, None), "north_mps"),
        (CourseSpeed(NorthReference.TRUE, 1.0, 1.0), CourseSpeed(NorthReference.TRUE, None, 0.2), "north_mps"),
        (CourseSpeed(NorthReference.TRUE, 1.0, 1.0), CourseSpeed(None, 1.0, 1.0), "north_mps"),
        (Attitude(None, 0.1, 0.1), Attitude(0.5, None, None), "roll_rad"),
    ],
)
def test_not_available_ends_what_was_said_before(message: pgns.Message, unknown: pgns.Message, field: str) -> None:
    bus = source()
    say(bus, 9, message, 0.0)
    say(bus, 9, unknown, 0.1)
    assert getattr(said(bus, 9, LISBON, 0.2), field) is None


def test_an_attitude_of_yaw_alone_leaves_the_word_to_another_sensor() -> None:
    bus = source(9)
    say(bus, 9, Attitude(0.5, None, None), 0.0)
    say(bus, 12, Attitude(None, 0.1, 0.2), 0.0)
    assert said(bus, 9, LISBON, 0.0).roll_rad == pytest.approx(0.2)


def test_the_full_gnss_position_counts_only_where_no_rapid_one_comes() -> None:
    bus = source()
    assert said(bus, 2, gnss(), 0.0).latitude_rad == pytest.approx(LISBON.latitude_rad)
    assert say(bus, 2, PORTO, 0.1) is not None
    assert say(bus, 2, gnss(), 0.2) is None
    assert say(bus, 2, gnss(), 1.1) is None
    assert say(bus, 2, gnss(), 1.2) is not None


@pytest.mark.parametrize(("method", "fix"), [(1, 3), (2, 4), (3, 3), (4, 5), (5, 6), (None, 2)])
def test_methods_that_are_a_fix(method: int | None, fix: int) -> None:
    assert said(source(), 2, gnss(method=method), 0.0).fix == fix


@pytest.mark.parametrize("method", [0, 6, 7, 8, 9, 13])
def test_what_is_reckoned_typed_or_simulated_is_no_position(method: int) -> None:
    bus = source()
    for n in (said(bus, 2, gnss(method=method), 0.0), said(bus, 2, LISBON, 0.1)):
        assert (n.latitude_rad, n.longitude_rad, n.fix) == (None, None, 0)


@pytest.mark.parametrize(
    ("own", "bus_own", "bus_other", "expected_rad"),
    [
        (0.1, 0.2, 0.3, 1.1),  # in the heading message
        (None, 0.2, 0.3, 1.2),  # 127258 of the compass
        (None, None, 0.3, 1.3),  # 127258 of the chosen source
        (None, None, None, 1.4),  # the vehicle's file
        (0.0, 0.2, 0.3, 1.0),  # zero is a variation
        (None, 0.0, 0.3, 1.0),
    ],
)
def test_where_the_variation_comes_from(own, bus_own, bus_other, expected_rad):
    bus = source(variation_deg=math.degrees(0.4))
    say(bus, 1, Variation(bus_other), 0.0)
    say(bus, 9, Variation(bus_own), 0.0)
    say(bus, 9, VesselHeading(1.0, None, own, NorthReference.MAGNETIC), 0.0)
    assert said(bus, 2, LISBON, 0.0).heading_rad == pytest.approx(expected_rad)


def test_deviation_is_added_and_the_sum_is_wrapped() -> None:
    bus = source()
    say(bus, 9, VesselHeading(6.2, 0.1, 0.2, NorthReference.MAGNETIC), 0.0)
    assert said(bus, 2, LISBON, 0.0).heading_rad == pytest.approx(6.5 - math.tau)


def test_a_true_heading_is_taken_as_it_is() -> None:
    bus = source(variation_deg=10.0)
    say(bus, 9, VesselHeading(1.0, 0.1, 0.2, NorthReference.TRUE), 0.0)
    assert said(bus, 2, LISBON, 0.0).heading_rad == pytest.approx(1.0)


def test_a_magnetic_course_becomes_true() -> None:
    bus = source(variation_deg=math.degrees(0.5))
    say(bus, 9, CourseSpeed(NorthReference.MAGNETIC, math.pi / 2 - 0.5, 2.0), 0.0)
    n = said(bus, 2, LISBON, 0.0)
    assert (n.north_mps, n.east_mps) == (pytest.approx(0.0, abs=2e-4), pytest.approx(2.0))


def test_without_time_on_the_bus_there_is_none() -> None:
    """The stamp of the frame is the computer's own time: a clock compared with that would always be right."""
    bus = source()
    assert said(bus, 2, LISBON, 0.0, t_ns=123).utc_ns == 0
    say(bus, 9, SystemTime(86_400_000_000_000), 1.0)
    assert said(bus, 2, LISBON, 1.5, t_ns=123).utc_ns == 86_400_500_000_000
    assert said(bus, 2, LISBON, 4.0, t_ns=123).utc_ns == 0


@pytest.mark.parametrize(("by", "known"), [(0, True), (1, True), (2, True), (5, False), (0xF5, False)])
def test_the_time_of_a_devices_own_crystal_is_no_time(by: int, known: bool) -> None:
    data = bytearray(encode(SystemTime(86_400_000_000_000), 1)[0].data)
    data[1] = by
    assert (decode(pgns.SYSTEM_TIME, bytes(data)) == SystemTime(86_400_000_000_000)) is known
    assert known or decode(pgns.SYSTEM_TIME, bytes(data)) == SystemTime(None)


def test_status_says_who_talks_and_what_was_refused() -> None:
    bus = source()
    say(bus, 40, LISBON, 1.0)
    say(bus, 40, LISBON, 2.0)
    bus.feed(Frame(extended(2 << 26 | 129025 << 8 | 41), struct.pack("<ii", 900_000_001, 0)), 2.0)
    bus.feed(Frame(extended(2 << 26 | 129025 << 8 | 254), bytes(8)), 2.0)
    for arb in (
        standard(0x123),
        extended(2 << 26 | 129025 << 8 | 40, remote=True),
        extended(2 << 26 | 129025 << 8 | 40) | CAN_ERR,
    ):
        bus.feed(Frame(arb, bytes(8)), 2.0)
    bus.feed(Frame(extended(2 << 26 | 130306 << 8 | 42), bytes(8)), 2.0)  # wind: not ours, no error
    status = bus.status(2.5)
    assert status.sources == {40: (0.5, 2, ""), 41: (0.5, 1, "")}
    assert status.errors == {
        "PGN 129025: malformed": 1,
        "source address that nobody can have": 1,
        "not an extended data frame": 3,
    }
    assert status.last_error == "PGN 129025 of source 41: impossible latitude in rad 1.5708"


frames = st.builds(
    lambda priority, pgn, address, data, flags: Frame(extended(priority << 26 | pgn << 8 | address) ^ flags, data),
    st.integers(0, 7),
    st.sampled_from(PGNS) | st.integers(0, 0x3FFFF),
    st.integers(0, 255),
    st.binary(max_size=8) | st.binary(min_size=8, max_size=8),
    st.sampled_from((0, 0, 0, 0, 1, 2, 4)),
)
spoken = st.builds(encode, messages, st.integers(0, 3), st.integers(0, 7))


@given(st.lists(st.tuples(st.floats(0, 1.5), spoken | st.lists(frames, max_size=8)), max_size=60))
def test_a_bus_of_anything_gives_sound_messages_only(heard: list[tuple[float, list[Frame]]]) -> None:
    bus, now_s, counter = source(2, 1, variation_deg=5.0), 0.0, 0
    for later_s, burst in heard:
        now_s += later_s
        for frame in burst:
            n = bus.feed(frame, now_s)
            if n is None:
                continue
            counter = counter + 1 & 0xFF
            assert n.counter == counter
            assert all(value is None or math.isfinite(value) for value in n)
            assert (n.latitude_rad is None) == (n.longitude_rad is None) == (n.fix == 0)
            assert n.latitude_rad is None or abs(n.latitude_rad) <= math.pi / 2
            assert n.heading_rad is None or 0 <= n.heading_rad < math.tau
            assert (n.north_mps is None) == (n.east_mps is None)
    assert all(k.age_s is None or k.age_s <= VARIATION_S for k in bus.status(now_s).kinds.values())


# Sources by NAME ------------------------------------------------------------------------------------------------------------

RECEIVER_NAME, OTHER_NAME = 0xC078_8C00_E7E0_4312, 0xC078_8C00_E7E0_4313


def claim(bus: Nmea2000Source, address: int, name: int) -> None:
    bus.feed(Frame(extended(0x18EEFF00 | address), name.to_bytes(8, "little")), 0.0)


def by_name(*preferred: int | str, own_name: int = -1) -> Nmea2000Source:
    return Nmea2000Source(Nmea2000(preferred_sources=preferred), STALE_S, own_name)


def test_a_device_is_preferred_by_its_name_whatever_its_address() -> None:
    bus = by_name("c0788c00e7e04312")
    said(bus, 10, LISBON, 0.0)
    assert say(bus, 43, PORTO, 0.0) is None, "nobody said yet whose address it is"
    claim(bus, 43, RECEIVER_NAME)
    assert said(bus, 43, PORTO, 0.1).latitude_rad == PORTO.latitude_rad
    assert say(bus, 10, LISBON, 0.1) is None
    claim(bus, 77, RECEIVER_NAME)
    assert said(bus, 10, LISBON, 0.2), "what 43 said is not the receiver's any more"
    assert said(bus, 77, PORTO, 0.2).latitude_rad == PORTO.latitude_rad
    assert bus.status(0.2).sources[77].name == "c0788c00e7e04312"


def test_another_device_at_the_address_is_not_taken_for_the_first_one() -> None:
    bus = by_name("C0788C00E7E04312", 10)
    claim(bus, 43, RECEIVER_NAME)
    said(bus, 43, PORTO, 0.0)
    claim(bus, 43, OTHER_NAME)
    assert said(bus, 10, LISBON, 0.1).latitude_rad == LISBON.latitude_rad
    assert say(bus, 43, PORTO, 0.1) is None


def test_a_device_that_lost_its_address_is_none_until_it_has_another() -> None:
    bus = by_name("c0788c00e7e04312")
    claim(bus, 43, RECEIVER_NAME)
    said(bus, 43, PORTO, 0.0)
    claim(bus, 254, RECEIVER_NAME)
    assert bus.status(0.0).kinds["position"].source is None


def test_a_claim_that_changes_nothing_keeps_the_present_source() -> None:
    bus = by_name()
    said(bus, 43, PORTO, 0.0)
    assert say(bus, 10, LISBON, 0.1) is None
    claim(bus, 10, OTHER_NAME)
    claim(bus, 43, RECEIVER_NAME)
    assert said(bus, 43, PORTO, 0.2)


def test_the_boats_own_device_is_no_source() -> None:
    bus = by_name(own_name=OTHER_NAME)
    claim(bus, 10, OTHER_NAME)
    assert say(bus, 10, LISBON, 0.0) is None
    assert bus.status(0.0).sources == {}
    claim(bus, 10, RECEIVER_NAME)
    assert said(bus, 10, LISBON, 0.1)


def test_a_claim_that_is_none_is_counted() -> None:
    bus = by_name()
    bus.feed(Frame(extended(0x18EEFF2B), bytes(7)), 0.0)
    assert bus.status(0.0).errors == {"claim: malformed": 1}


@pytest.mark.parametrize(("preferred", "joins"), [((), False), ((127,), False), (("c0788c00e7e04312",), True)])
def test_who_chooses_by_name_takes_part_in_the_bus(preferred: tuple[int | str, ...], joins: bool) -> None:
    assert Nmea2000(preferred_sources=preferred).joins == joins
    assert Nmea2000(preferred_sources=preferred, send=("heading",)).joins
