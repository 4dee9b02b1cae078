"""Recorded NMEA 2000 traffic of real boats, against an independent decoder (package `nmea2000`, built on canboat's tables).

The recordings lie in tests/data/nmea2000; their README names source and licence.
"""

import bisect
import functools
import gzip
import logging
import math
from collections import Counter, defaultdict
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import pytest
from nmea2000.decoder import NMEA2000Decoder

from delfim.base.frames import Frame, extended
from delfim.canproxy.dsor.messages import Navigation
from delfim.canproxy.nmea2000 import pgns
from delfim.canproxy.nmea2000.device import Device, DeviceFacts
from delfim.canproxy.nmea2000.fastpacket import FastPacket
from delfim.canproxy.nmea2000.pgns import decode
from delfim.canproxy.socket import CanAddress, accepts
from delfim.parts.nmea2000.combining import Nmea2000Source
from delfim.parts.nmea2000.table import Nmea2000
from delfim.vehicle.navigation.fusion import SLOW_S
from tests.canproxy.pgn_of import pgn_of

RECORDINGS = Path(__file__).parents[1] / "data/nmea2000"
BUSY, RAYMARINE, GATEWAY = "can0-1.candump.log.gz", "raymarine-p70.candump.log.gz", "actisense-522.candump.log"
PGNS = frozenset((126992, 127250, 127251, 127257, 127258, 129025, 129026, 129029))
STALE_S = 1.0
DAY_NS = 86_400_000_000_000


class Line(NamedTuple):
    frame: Frame
    now_s: float  # since the first frame; the recorder's clock was set while it ran, a step counts as no time
    text: str


@functools.cache
def recording(name: str) -> tuple[Line, ...]:
    data = (RECORDINGS / name).read_bytes()
    text = (gzip.decompress(data) if name.endswith(".gz") else data).decode()
    lines: list[Line] = []
    now_s = 0.0
    for row in text.splitlines():
        if not row.startswith("("):
            assert not row or row.startswith("#"), row
            continue
        stamp, _, body = row.split()
        identifier, _, payload = body.partition("#")
        seconds, _, micros = stamp[1:-1].partition(".")
        t_ns = int(seconds) * 1_000_000_000 + int(micros) * 1000
        if lines:
            passed_s = (t_ns - lines[-1].frame.t_ns) / 1e9
            now_s += passed_s if 0 <= passed_s < 10 else 0.0
        lines.append(Line(Frame(extended(int(identifier, 16)), bytes.fromhex(payload), t_ns), now_s, row))
    return tuple(lines)


class Told(NamedTuple):
    """A message as the independent decoder has it."""

    index: int  # of the line that completed it
    now_s: float
    pgn: int
    source: int
    fields: dict[str, Any]  # raw_value by canboat's field name: degrees, rad, m/s, days, seconds


@functools.cache
def independent(name: str) -> tuple[Told, ...]:
    logging.getLogger("nmea2000").setLevel(logging.ERROR)
    decoder = NMEA2000Decoder()
    told = []
    for index, line in enumerate(recording(name)):
        if pgn_of(line.frame.arb)[1] not in PGNS:
            continue
        message = decoder.decode(line.text)
        if message is not None:
            fields = {field.id: field.raw_value for field in message.fields}
            told.append(Told(index, line.now_s, message.PGN, message.source, fields))
    return tuple(told)


@functools.cache
def ours(name: str) -> tuple[tuple[int, int, int, pgns.Message], ...]:
    """(index, pgn, source, message) by the code under test."""
    errors: Counter[str] = Counter()
    fast, messages = FastPacket(errors), []
    for index, line in enumerate(recording(name)):
        _, pgn, address, _ = pgn_of(line.frame.arb)
        if pgn not in PGNS:
            continue
        data = fast.feed(address, line.frame.data, line.now_s) if pgn == pgns.GNSS_POSITION else line.frame.data
        if data is not None:
            messages.append((index, pgn, address, decode(pgn, data)))
    assert not errors
    return tuple(messages)


def radians(degrees: float | None) -> float | None:
    return None if degrees is None else math.radians(degrees)


def utc_ns(fields: dict[str, Any]) -> int | None:
    if fields["date"] is None or fields["time"] is None:
        return None
    return int(fields["date"]) * DAY_NS + round(fields["time"] * 1e4) * 100_000


def reference(code: int) -> int | None:
    return code if code < 2 else None


def expected(pgn: int, f: dict[str, Any]) -> tuple[object, ...]:
    """The independent decoder's fields in the order and units of ours."""
    match pgn:
        case 126992:
            return (utc_ns(f),)
        case 127250:
            return f["heading"], f["deviation"], f["variation"], reference(f["reference"])
        case 127251:
            return (f["rate"],)
        case 127257:
            return f["yaw"], f["pitch"], f["roll"]
        case 127258:
            return (f["variation"],)
        case 129025:
            return radians(f["latitude"]), radians(f["longitude"])
        case 129026:
            return reference(f["cogReference"]), f["cog"], f["sog"]
    latitude_rad, longitude_rad = radians(f["latitude"]), radians(f["longitude"])
    return utc_ns(f), latitude_rad, longitude_rad, f["method"], f["numberOfSvs"], f["hdop"]


@pytest.mark.parametrize("name", [BUSY, RAYMARINE, GATEWAY])
def test_every_field_of_every_message_is_what_the_independent_decoder_says(name: str) -> None:
    theirs, mine = independent(name), ours(name)
    assert [(t.index, t.pgn, t.source) for t in theirs] == [m[:3] for m in mine]
    for told, (_, pgn, _, message) in zip(theirs, mine, strict=True):
        for field, value, other in zip(message._fields, message, expected(pgn, told.fields), strict=True):
            assert (value is None) == (other is None), (told, field)
            assert value is None or value == pytest.approx(other, rel=0, abs=1e-12), (told, field)


def test_counts_of_messages_by_pgn_and_source() -> None:
    def counts(name: str) -> dict[int, dict[int, int]]:
        by_pgn: defaultdict[int, dict[int, int]] = defaultdict(dict)
        for (pgn, address), count in sorted(Counter((pgn, address) for _, pgn, address, _ in ours(name)).items()):
            by_pgn[pgn][address] = count
        return dict(by_pgn)

    assert counts(BUSY) == {
        126992: {20: 59, 21: 59, 127: 59},
        127250: {23: 1192, 128: 596},
        127251: {23: 1193, 24: 593, 128: 596},
        127257: {23: 596, 24: 1174, 36: 60, 128: 59},
        127258: {20: 59, 21: 59, 22: 59, 25: 59, 27: 59, 42: 6, 45: 6, 46: 6, 47: 6, 48: 6, 127: 59},
        129025: {20: 503, 21: 478, 31: 55, 127: 596},
        129026: {0: 240, 20: 226, 21: 216, 28: 60, 31: 55, 127: 596},
        129029: {0: 60, 20: 59, 21: 58, 28: 60, 31: 55, 127: 59},
    }
    assert counts(RAYMARINE) == {
        127250: {204: 175},
        127251: {204: 175},
        127257: {204: 175},
        129025: {43: 165},
        129026: {43: 66},
    }
    assert counts(GATEWAY) == {}


def play(name: str, *preferred: int, variation_deg: float = 0.0) -> tuple[Nmea2000Source, list[tuple[int, Navigation]]]:
    """The whole recording through one source: the messages for the vehicle, by line."""
    bus = Nmea2000Source(Nmea2000(preferred_sources=preferred, variation_deg=variation_deg), STALE_S)
    fed = ((index, bus.feed(line.frame, line.now_s)) for index, line in enumerate(recording(name)))
    return bus, [(index, n) for index, n in fed if n is not None]


def address_at(name: str, index: int) -> int:
    return pgn_of(recording(name)[index].frame.arb)[2]


class Newest:
    """The latest word of one source on one PGN by the independent decoder, and its age."""

    def __init__(self, name: str, pgn: int, source: int) -> None:
        self.lines = recording(name)
        self.told = [t for t in independent(name) if (t.pgn, t.source) == (pgn, source)]
        self.indices = [t.index for t in self.told]

    def at(self, index: int) -> tuple[float, dict[str, Any]]:
        """(age_s, fields) when this line had come."""
        told = self.told[bisect.bisect_right(self.indices, index) - 1]
        return self.lines[index].now_s - told.now_s, told.fields


def test_preferred_sources_drive_the_busy_bus() -> None:
    """Receiver 127 and compass 128, magnetic both: every field recomputed from the independent decoder."""
    bus, fixes = play(BUSY, 127, 128)
    assert Counter(address_at(BUSY, index) for index, _ in fixes) == {127: 596, 0: 1}  # 0: see the stall below
    position, course = Newest(BUSY, 129025, 127), Newest(BUSY, 129026, 127)
    heading, rate, attitude = (Newest(BUSY, pgn, 128) for pgn in (127250, 127251, 127257))
    variation_rad = 0.0318  # 1.82 degrees east by 127 and 128; the rest of the bus says 2.37

    def agrees(value: float | None, age_s: float, limit_s: float, other: float) -> None:
        assert (value is None) == (age_s > limit_s)
        assert value is None or value == pytest.approx(other, rel=0, abs=1e-12)

    for index, n in fixes:
        if index < 1000 or address_at(BUSY, index) == 0:  # the variation of 127 comes with line 721
            continue
        age_s, f = position.at(index)
        assert age_s == 0.0
        agrees(n.latitude_rad, age_s, STALE_S, math.radians(f["latitude"]))
        agrees(n.longitude_rad, age_s, STALE_S, math.radians(f["longitude"]))
        age_s, f = course.at(index)
        agrees(n.north_mps, age_s, STALE_S, f["sog"] * math.cos(f["cog"] + variation_rad))
        agrees(n.east_mps, age_s, STALE_S, f["sog"] * math.sin(f["cog"] + variation_rad))
        age_s, f = attitude.at(index)
        agrees(n.roll_rad, age_s, SLOW_S, f["roll"])
        agrees(n.pitch_rad, age_s, SLOW_S, f["pitch"])
        if heading.at(index)[0] <= STALE_S:  # else compass 23 stands in
            assert n.heading_rad == pytest.approx(
                (heading.at(index)[1]["heading"] + variation_rad) % math.tau, rel=0, abs=1e-12
            )
        if rate.at(index)[0] <= STALE_S:
            assert n.yaw_rate_radps == pytest.approx(rate.at(index)[1]["rate"], rel=0, abs=1e-12)
    assert bus.status(0.0).errors == {}


def test_sources_that_talk_are_listed_with_their_frames() -> None:
    bus, _ = play(BUSY)
    frames: Counter[int] = Counter()
    for line in recording(BUSY):
        _, pgn, address, _ = pgn_of(line.frame.arb)
        frames[address] += pgn in PGNS
    status = bus.status(recording(BUSY)[-1].now_s)
    assert {address: heard.frames for address, heard in status.sources.items()} == {a: n for a, n in frames.items() if n}


def test_a_boat_with_one_receiver_and_one_magnetic_compass() -> None:
    bus, fixes = play(RAYMARINE, variation_deg=-14.0)
    assert len(fixes) == 165
    compass = Newest(RAYMARINE, 127250, 204)
    for index, n in fixes[1:]:
        _, fields = compass.at(index)
        assert n.heading_rad == pytest.approx((fields["heading"] - math.radians(14.0)) % math.tau, rel=0, abs=1e-12)
        assert n.fix == 2  # nothing is said of its quality
        assert n.utc_ns == 0  # nor of the time
    assert bus.status(0.0).errors == {}


def test_a_bus_without_navigation_gives_none() -> None:
    bus, fixes = play(GATEWAY)
    assert fixes == []
    assert bus.status(1.0).sources == {}


def test_on_a_recorded_bus_the_boats_own_device_learns_who_has_which_address_and_takes_a_free_one() -> None:
    decoder, claims = NMEA2000Decoder(), {}
    own = Device(DeviceFacts("Otter", "1", 5), (), Random(1), address=127)
    filters = [CanAddress(*pair) for pair in Device.FILTERS]
    own.begin(0.0)
    for line in recording(BUSY):
        if any(accepts(each, line.frame.arb) for each in filters):
            own.feed(line.frame, line.now_s)
            own.step(line.now_s)
            message = decoder.decode(line.text)
            if message is not None and message.PGN == 60928:
                claims[message.source] = message.source_iso_name.unique_number
    assert len(claims) == 40
    assert {address: name & 0x1FFFFF for address, name in own.names.items()} == claims
    assert own.is_claimed
    assert own.address == 129
    assert set(own.counts) <= {"for another device", "address lost to another device"}


def test_sources_chosen_by_name_are_those_of_their_addresses() -> None:
    """The receiver and the compass of the recording, whose claims are in it."""
    by_address, by_name = ((127, 128), ("c07891002fb34d62", "c050a0002fb30d62"))
    chosen = []
    for preferred in (by_address, by_name):
        bus = Nmea2000Source(Nmea2000(preferred_sources=preferred), 2.5)
        for line in recording(BUSY):
            bus.feed(line.frame, line.now_s)
        status = bus.status(recording(BUSY)[-1].now_s)
        chosen.append({name: kind.source for name, kind in status.kinds.items()})
        assert status.sources[128].name == "c050a0002fb30d62"
    assert chosen[0] == chosen[1]
    assert chosen[1]["position"] == 127
    assert chosen[1]["heading"] == 128
