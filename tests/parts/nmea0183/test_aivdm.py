"""AIS over NMEA 0183, against the independent decoder pyais, on random messages and on whatever else may come."""

import contextlib
import itertools
import math
from typing import Any

import pyais
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.base.vessels import Report, VesselFacts, VesselPosition
from delfim.lines.nmea0183.aissentences import JOIN_S, JOINING, KNOT, AisMessages, AisPart, decode
from delfim.lines.nmea0183.framing import Sentences, framed

MMSI = st.integers(1, 999_999_999)
NAMES = st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 -.", max_size=20)
PLACE = {
    "lon": st.integers(-108_000_000, 108_000_000).map(lambda raw: raw / 600_000.0) | st.just(181.0),
    "lat": st.integers(-54_000_000, 54_000_000).map(lambda raw: raw / 600_000.0) | st.just(91.0),
    "speed": st.integers(0, 1023).map(lambda raw: raw / 10.0),
    "course": st.integers(0, 3600).map(lambda raw: raw / 10.0),
    "heading": st.integers(0, 359) | st.just(511),
    "second": st.integers(0, 63),
}
TURNS = st.integers(-126, 126).map(lambda code: math.copysign((code / 4.733) ** 2, code)) | st.sampled_from([-128, 127, -127])
SIZE = {
    "to_bow": st.integers(0, 511),
    "to_stern": st.integers(0, 511),
    "to_port": st.integers(0, 63),
    "to_starboard": st.integers(0, 63),
}
SHIP = {"ship_type": st.integers(0, 99)}
CALL = {"callsign": st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789", max_size=7)}
NAME = {"shipname": NAMES}


def messages(**fields: Any) -> st.SearchStrategy[dict[str, Any]]:
    drawn = {name: value if isinstance(value, st.SearchStrategy) else st.just(value) for name, value in fields.items()}
    return st.fixed_dictionaries({"mmsi": MMSI} | drawn)


MESSAGES = st.one_of(
    messages(msg_type=st.sampled_from([1, 2, 3]), status=st.integers(0, 15), turn=TURNS, **PLACE),
    messages(msg_type=18, **PLACE),
    messages(msg_type=19, **PLACE, **NAME, **SHIP, **SIZE),
    messages(msg_type=5, **NAME, **CALL, **SHIP, **SIZE),
    messages(msg_type=24, partno=0, **NAME),
    messages(msg_type=24, partno=1, **SHIP, **CALL, **SIZE),
    messages(msg_type=4, lon=1.0, lat=1.0),
    messages(msg_type=21, lon=1.0, lat=1.0, name="BUOY"),
)


def heard(lines: list[str], now_s: float = 0.0) -> list[Report]:
    """Through the framing of a line, as the boat hears it."""
    sentences, joined = Sentences(), AisMessages()
    parts = [each.message for each in sentences.feed("".join(f"{line}\r\n" for line in lines).encode())]
    assert not sentences.refused
    return [told for part in parts if isinstance(part, AisPart) for told in joined.join(part, now_s)]


def expected(lines: list[str]) -> list[Report]:
    """What pyais reads, in the units of ours."""
    told = pyais.decode(*lines).asdict()
    kind, found = told["msg_type"], list[Report]()
    if kind in (1, 2, 3, 18, 19):
        found.append(position(told, is_a=kind < 4))
    if kind in (5, 19, 24):
        found.append(facts(told))
    return found


def position(told: dict[str, Any], *, is_a: bool) -> VesselPosition:
    return VesselPosition(
        told["mmsi"],
        math.radians(told["lat"]) if abs(told["lat"]) <= 90.0 else None,
        math.radians(told["lon"]) if abs(told["lon"]) <= 180.0 else None,
        math.radians(told["course"]) if told["course"] < 360.0 else None,
        told["speed"] * KNOT if told["speed"] < 102.2 else None,
        math.radians(told["heading"]) if told["heading"] < 360 else None,
        None,
        "A" if is_a else "B",
        int(told["status"]) if is_a else 15,
        told["second"] if told["second"] < 60 else None,
    )


def facts(told: dict[str, Any]) -> VesselFacts:
    bow, stern, port, starboard = (told.get(f"to_{side}", 0) or 0 for side in ("bow", "stern", "port", "starboard"))
    if told["msg_type"] == 24 and str(told["mmsi"]).startswith("98") and told["mmsi"] > 10**8:
        bow = stern = port = starboard = 0
    is_placed = bow + port > 0
    words = (told.get("shipname") or "").strip() or None, (told.get("callsign") or "").strip() or None
    sizes = float(bow + stern) or None, float(port + starboard) or None
    antenna = (float(starboard), float(bow)) if is_placed else (None, None)
    return VesselFacts(told["mmsi"], *words, told.get("ship_type"), *sizes, *antenna)


@settings(phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(MESSAGES)
def test_every_field_is_what_the_independent_decoder_says(message: dict[str, Any]) -> None:
    lines = pyais.encode_dict(message, talker_id="AI", sentence_type="VDM", seq_id=3)
    ours, theirs = heard(lines), expected(lines)
    assert [type(each) for each in ours] == [type(each) for each in theirs]
    for mine, other in zip(ours, theirs, strict=True):
        for name, value, wanted in zip(mine._fields, mine, other, strict=True):
            if name == "rate_radps" and "turn" in message:  # theirs is rounded
                wanted = math.radians(message["turn"] / 60.0) if isinstance(message["turn"], float) else None
            assert value == (pytest.approx(wanted, abs=1e-8) if isinstance(wanted, float) else wanted), name


def test_a_known_sentence_of_each_kind() -> None:
    (ship,) = heard(["!AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0*5C"])
    assert isinstance(ship, VesselPosition)
    assert (ship.mmsi, ship.kind, ship.status, ship.speed_mps) == (477_553_000, "A", 5, 0.0)
    assert math.degrees(ship.latitude_rad or 0.0) == pytest.approx(47.582833, abs=2e-6)
    assert math.degrees(ship.longitude_rad or 0.0) == pytest.approx(-122.345832, abs=2e-6)
    (what,) = heard(
        [
            "!AIVDM,2,1,1,A,55?MbV02;H;s<HtKR20EHE:0@T4@Dn2222222216L961O5Gf0NSQEp6ClRp8,0*1C",
            "!AIVDM,2,2,1,A,88888888880,2*25",
        ]
    )
    assert isinstance(what, VesselFacts)
    assert (what.mmsi, what.name, what.length_m, what.beam_m) == (351_759_000, "EVER DIADEM", 295.0, 32.0)


def test_the_own_transponder_says_so() -> None:
    (own,) = heard([framed("AIVDO,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0").decode().strip().replace("$", "!")])
    assert isinstance(own, VesselPosition)
    assert own.is_own


FIRST, REST = b"55?MbV02;H;s<HtKR20EHE:0@T4@Dn2222222216L961O5Gf0NSQEp6ClRp8", b"88888888880"


def part(number: int, sequence: str = "1", parts: int = 2) -> AisPart:
    return AisPart(parts, number, sequence, "A", FIRST if number == 1 else REST, 0, False)


def test_parts_are_joined_in_their_order_and_soon_and_few_at_once() -> None:
    joined = AisMessages()
    for first, second in itertools.permutations("012", 2):  # another message between them
        joined.join(part(1, first), 0.0)
        joined.join(part(1, second), 0.1)
        assert len(joined.join(part(2, first), 0.2)) == 1
        assert len(joined.join(part(2, second), 0.3)) == 1
    for sequence, at_s in (("7", 0.0), ("1", 1.0 + JOIN_S)):
        joined.join(part(1, "1"), 0.5)
        with pytest.raises(FormatError, match="a part is missing"):
            joined.join(part(2, sequence), at_s)
    for i in range(100):
        joined.join(part(1, str(i % 10), parts=2 + i % 4), 3.0)
        assert len(joined._waiting) <= JOINING


@given(st.binary(max_size=90), st.integers(0, 5), st.booleans())
def test_any_payload_is_a_vessel_or_none_or_refused(payload: bytes, fill: int, is_own: bool) -> None:
    try:
        reports = decode(payload, fill, is_own)
    except FormatError:
        return
    for told in reports:
        assert 0 < told.mmsi <= 999_999_999
        assert all(math.isfinite(each) for each in told if isinstance(each, float))
        assert all(each.isprintable() for each in told if isinstance(each, str))


PIECES = st.text("!AIVDMO,0123456789*$AB\r\nabcdw`<>", max_size=60)
SENTENCES = st.sampled_from(["!AIVDM,1,1,,A,", "!AIVDM,2,1,1,A,55?MbV0,0*"])


@given(st.lists(PIECES | SENTENCES))
def test_any_text_is_sentences_or_counted(texts: list[str]) -> None:
    sentences, joined = Sentences(needs_checksum=False), AisMessages()
    for each in sentences.feed("".join(texts).encode()):
        assert isinstance(each.message, AisPart)
        with contextlib.suppress(FormatError):
            joined.join(each.message, 0.0)


@pytest.mark.parametrize(
    ("sentence", "why"),
    [
        ("AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,6", "VDM: parts or fill bits out of range"),
        ("AIVDM,1,2,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0", "VDM: parts or fill bits out of range"),
        ("AIVDM,9,1,1,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0", "VDM: parts or fill bits out of range"),
        ("AIVDM,1,1,,B,,0", "VDM: payload too long or empty, or parts without a number"),
        ("AIVDM,2,1,,B,177KQJ5000,0", "VDM: payload too long or empty, or parts without a number"),
        ("AIVDM,x,1,,B,177KQJ5000,0", "VDM: parts or fill bits are no numbers"),
        ("AIVDM,1,1", "VDM: too few fields"),
    ],
)
def test_a_bad_sentence_is_refused_in_words(sentence: str, why: str) -> None:
    line = Sentences()
    assert line.feed(framed(sentence).replace(b"$", b"!")) == []
    assert line.refused == {why: 1}


def test_a_wrong_checksum_and_a_dollar_are_no_ais() -> None:
    line = Sentences()
    assert line.feed(b"!AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0*5D\r\n") == []
    assert line.feed(framed("AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0")) == []
    assert line.refused == {"wrong checksum": 1}
