"""Sentences that others made of recorded traffic (tests/data/nmea0183): every field of them, and of the messages that drive
the boat, is what the independent decoder of NMEA 2000 says of the same frames, within the decimals of a sentence.
"""

import functools
import gzip
import math
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from delfim.lines.nmea0183.framing import Sentences
from delfim.lines.nmea0183.sentences import Bearing, Located, Turning
from delfim.parts.nmea0183.combining import Combined
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from tests.canproxy.test_recordings import BUSY, Newest, recording, utc_ns

FILE = Path(__file__).parents[2] / "data/nmea0183/can0-1.sentences.gz"
RECEIVER, COMPASS = 127, 128
MINUTE_RAD = math.radians(1.0 / 60.0)
PLACE_RAD = 0.51e-4 * MINUTE_RAD  # four decimals of a minute are written
VARIATION_RAD = 0.0318  # of both devices
STALE_S = 1.0


@functools.cache
def spoken() -> tuple[tuple[int, bytes], ...]:
    """Sentences, and the line of the recording that completed each. The recorder's clock was set while it ran: stamps fall."""
    lines, index, found = recording(BUSY), 0, list[tuple[int, bytes]]()
    for row in gzip.decompress(FILE.read_bytes()).decode().splitlines():
        stamp, sentence = row.split(" ", 1)
        t_ns = int(stamp[1:-1].replace(".", "")) * 1000
        while lines[index].frame.t_ns != t_ns:
            index += 1
        found.append((index, sentence.encode() + b"\r\n"))
    return tuple(found)


def heading_rad(f: dict[str, Any]) -> float:
    assert f["reference"] == 1, "magnetic"
    return float(f["heading"])


@functools.cache
def _newest(pgn: int, source: int) -> Newest:
    return Newest(BUSY, pgn, source)


def truth(index: int, pgn: int, source: int = RECEIVER) -> dict[str, Any]:
    """The last word of a device at a line, by the independent decoder."""
    return _newest(pgn, source).at(index)[1]


def near(value: float | None, true: float, by: float) -> None:
    assert value == pytest.approx(true, rel=0, abs=by)


def test_every_field_of_every_sentence_is_what_the_independent_decoder_says():
    line, read = Sentences(), Counter[str]()
    for index, data in spoken():
        (sentence,) = line.feed(data)
        said = sentence.message
        read[sentence.formatter] += 1
        if isinstance(said, Bearing):
            near(said.magnetic_rad, heading_rad(truth(index, 127250, COMPASS)), math.radians(0.0051))
            near(said.variation_rad, VARIATION_RAD, math.radians(0.0051))
        elif isinstance(said, Turning):
            near(said.rate_radps, truth(index, 127251, COMPASS)["rate"], math.radians(0.0051 / 60.0))
        else:
            assert isinstance(said, Located)
            f = truth(index, 129029)
            near(said.latitude_rad, math.radians(f["latitude"]), PLACE_RAD)
            near(said.longitude_rad, math.radians(f["longitude"]), PLACE_RAD)
            if sentence.formatter == "GGA":
                near(said.hdop, f["hdop"], 0.051)
                assert said.satellites == (f["numberOfSvs"] or 0)
                assert said.fix == {1: 3, 2: 4}[f["method"]]
            else:
                assert abs((said.utc_ns or 0) - (utc_ns(f) or 0)) < 10_000_000
                near(said.movement.speed_mps, truth(index, 129026)["sog"], 0.051 * 1852 / 3600)
    assert line.refused == {}
    assert set(read) == {"GGA", "RMC", "HDG", "ROT"}
    assert min(read.values()) > 50, read


def test_they_drive_the_boat_and_every_message_equals_the_independent_decoder():
    settings = Nmea0183(ports={"line": Nmea0183Port(device="/dev/line")})
    line, combined, messages = Sentences(), Combined(settings, STALE_S, {}), 0
    whole = 0
    for index, data in spoken():
        for sentence in line.feed(data):
            n = combined.take("line", sentence, recording(BUSY)[index].now_s)
            if n is None:
                continue
            messages += 1
            f = truth(index, 129029)
            near(n.latitude_rad, math.radians(f["latitude"]), PLACE_RAD)
            near(n.longitude_rad, math.radians(f["longitude"]), PLACE_RAD)
            if n.heading_rad is not None and n.yaw_rate_radps is not None and n.north_mps is not None:
                whole += 1
            if n.heading_rad is not None:
                magnetic_rad = heading_rad(truth(index, 127250, COMPASS))
                near(n.heading_rad, (magnetic_rad + VARIATION_RAD) % math.tau, math.radians(0.0102))
            if n.yaw_rate_radps is not None:
                near(n.yaw_rate_radps, truth(index, 127251, COMPASS)["rate"], math.radians(0.0051 / 60.0))
            if n.north_mps is not None and n.east_mps is not None:
                near(math.hypot(n.north_mps, n.east_mps), truth(index, 129026)["sog"], 0.051 * 1852 / 3600)
            assert n.fix == {1: 3, 2: 4}[f["method"]]
            near(n.hdop, f["hdop"], 0.051)
            assert abs(n.utc_ns - (utc_ns(f) or 0)) < 10_000_000 or messages == 1, "a GGA without a date"
    assert messages >= 50
    assert whole >= 50
