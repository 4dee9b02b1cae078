"""Delfim as a device of an NMEA 2000 bus: addresses and their conflicts, questions and their answers. Its peers are devices of
its own kind and those of an independent library (package `nmea2000`).
"""

import logging
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nmea2000 import _canboat as canboat
from nmea2000.decoder import NMEA2000Decoder

from delfim import config
from delfim.base.frames import Frame, extended, identifier, standard
from delfim.canproxy.nmea2000.device import AGAIN_S, ANSWERS, FIRST, ROLL_CALL_S, Device, DeviceFacts, device_name, facts_of
from delfim.canproxy.nmea2000.parcels import (
    CLAIM,
    CONFIGURATION,
    GROUP_FUNCTION,
    HEARTBEAT,
    NOBODY,
    PGN_LIST,
    PRODUCT,
    REQUEST,
    Parcel,
    frames,
)
from delfim.canproxy.socket import CanAddress, accepts
from delfim.parts.nmea2000.table import Nmea2000

STEP_S = 0.01
SENT = (127250, 129025)
logging.getLogger("nmea2000").setLevel(logging.ERROR)


def device(unique=5, chance=1, address=FIRST):
    return Device(DeviceFacts("Otter", "1.2", unique), SENT, Random(chance), address)


class Bus:
    """Devices that hear each other, in lock step. `log` has all that was said: its time and the parcel."""

    def __init__(self, *devices):
        self.now_s, self.log, self.devices, self._number = 0.0, [], [], 0
        for each in devices:
            self.join(each)

    def join(self, each):
        self.devices.append(each)
        for parcel in each.begin(self.now_s):
            self.say(parcel, each)

    def say(self, parcel, sender=None):
        self.log.append((self.now_s, parcel))
        self._number += 1
        for arb, data in frames(parcel, self._number):
            for each in self.devices:
                if each is not sender:
                    each.feed(Frame(arb, data), self.now_s)

    def run(self, seconds):
        said = len(self.log)
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            for each in self.devices:
                for parcel in each.step(self.now_s):
                    self.say(parcel, each)
        return [parcel for _, parcel in self.log[said:]]


def ask(pgn, source=7, destination=255):
    return Parcel(REQUEST, pgn.to_bytes(3, "little"), source, 6, destination)


def claim(unique, address):
    return Parcel(CLAIM, device_name(unique).to_bytes(8, "little"), address)


def told(parcel):
    """The fields of a message as the independent decoder has it."""
    decoder, message = NMEA2000Decoder(), None
    for arb, data in frames(parcel, 3):
        message = decoder.decode(f"(1700000000.000000) can0 {identifier(arb):08X}#{data.hex().upper()}")
    assert message is not None, parcel
    return message, {
        field.id: field.value if isinstance(field.raw_value, bytes) or field.raw_value is None else field.raw_value
        for field in message.fields
    }


# Addresses ------------------------------------------------------------------------------------------------------------------


def test_it_asks_who_is_there_then_claims_and_says_nothing_else_before_a_quarter_of_a_second():
    bus = Bus(own := device())
    bus.run(1.0)
    assert [parcel.pgn for _, parcel in bus.log] == [REQUEST, CLAIM, HEARTBEAT]
    (asked_s, asked), (claimed_s, claimed), (spoke_s, _) = bus.log
    assert (asked.source, claimed.source, own.address, own.source) == (NOBODY, FIRST, FIRST, FIRST)
    assert claimed_s - asked_s >= 0.25
    assert spoke_s - claimed_s >= 0.25


def test_its_name_is_the_one_that_an_independent_library_makes_and_reads():
    facts = facts_of(config.Vehicle(boat=config.BoatTable(name="Otter"), nmea2000=Nmea2000(unique_number=77)))
    name = device_name(facts.unique)
    assert name == canboat.iso_name(
        2046,
        77,
        device_function=175,
        device_class=60,
        device_instance=0,
        system_instance=0,
        industry_group=4,
        arbitrary_address_capable=True,
    )
    _, fields = told(claim(77, 100))
    assert fields["uniqueNumber"] == 77
    assert fields["deviceClass"] == 60
    assert fields["arbitraryAddressCapable"] == 1


def test_boats_of_other_names_have_other_numbers():
    boats = [config.Vehicle(boat=config.BoatTable(name=name)) for name in ("a", "b")]
    one, two = (facts_of(each).unique for each in boats)
    assert one != two
    assert 0 <= one < 1 << 21


def test_an_address_that_somebody_has_is_left_to_him_even_by_a_lower_name():
    bus = Bus(high := device(9))
    bus.run(1.0)
    bus.join(low := device(2))
    bus.run(1.0)
    assert (high.address, low.address) == (FIRST, FIRST + 1)
    assert low.names == {FIRST: high.name}


def test_the_lower_name_takes_the_address_and_the_other_one_moves():
    bus = Bus(own := device(9))
    bus.run(1.0)
    bus.say(claim(2, FIRST))
    said = bus.run(0.2)
    assert not own.is_claimed
    assert {parcel.pgn for parcel in said} == {CLAIM}, "an address that may be contested says nothing else"
    bus.run(0.2)
    assert own.is_claimed
    assert own.address == FIRST + 1
    assert own.counts["address lost to another device"] == 1


def test_against_a_higher_name_it_says_again_that_the_address_is_its_own():
    bus = Bus(own := device(2))
    bus.run(1.0)
    bus.say(claim(9, FIRST))
    assert bus.run(0.02) == [claim(2, FIRST)]
    assert own.is_claimed
    assert own.names == {}


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 0x1FFFFF), st.integers(0, 200)), min_size=1, max_size=6, unique_by=lambda each: each[0]),
    st.integers(0, 1 << 30),
)
def test_devices_that_want_one_address_all_get_one(arrivals, seed):
    """unique numbers, and after how many steps each is switched on."""
    bus, chance = Bus(), Random(seed)
    for step in range(201):
        for unique, at in arrivals:
            if at == step:
                bus.join(device(unique, chance.random()))
        bus.run(STEP_S)
    bus.run(4.0)
    addresses = [each.address for each in bus.devices]
    assert all(each.is_claimed for each in bus.devices)
    assert len(set(addresses)) == len(arrivals)
    owner = {}
    for _, parcel in bus.log:
        if parcel.pgn == CLAIM:
            owner[parcel.source] = min(owner.get(parcel.source, parcel.data[::-1]), parcel.data[::-1])
    for each in bus.devices:
        assert owner[each.address] == each.name.to_bytes(8, "big"), "the lowest NAME that ever claimed it has it"


@pytest.mark.parametrize("unique", [1, 500])
@pytest.mark.parametrize("starts_first", [True, False])
def test_with_an_independent_device_that_wants_the_same_address(unique, starts_first):
    peer, own = canboat.AddressClaimer(device_name(100), FIRST, True), device(unique)
    bus = Bus()

    def to_peer(parcels):
        for parcel in parcels:
            said = []
            if parcel.pgn == CLAIM and parcel.source != NOBODY:
                said = peer.on_address_claim(ms(), parcel.source, int.from_bytes(parcel.data, "little"))
            elif parcel.pgn == REQUEST:
                answer = peer.respond_to_claim_request()
                said = [answer] if answer else []
            from_peer(said)

    def from_peer(said):
        for priority, pgn, source, destination, data in said:
            bus.say(Parcel(pgn, data, source, priority, destination))

    def ms():
        return round(bus.now_s * 1e3)

    def run(seconds):
        for _ in range(round(seconds / STEP_S)):
            to_peer(bus.run(STEP_S))
            from_peer(peer.tick(ms()))

    if starts_first:
        bus.join(own)
        run(2.0)
        from_peer(peer.start(ms()))
    else:
        from_peer(peer.start(ms()))
        run(2.0)
        bus.join(own)
        to_peer([bus.log[-1][1]])
    run(5.0)
    assert peer.state == "claimed"
    assert own.is_claimed
    assert own.address != peer.address
    assert own.names == {peer.address: peer.name}


def test_on_a_full_bus_it_has_no_address_says_so_and_tries_again():
    bus = Bus(own := device(700))
    for address in range(252):
        bus.say(claim(address + 1, address))
    said = bus.run(1.0)
    assert said == [claim(700, NOBODY)]
    assert own.trouble == "all 252 addresses of the bus are taken"
    bus.say(ask(CLAIM))
    assert bus.run(0.1) == [claim(700, NOBODY)]
    bus.run(2 * AGAIN_S + 1.0)
    assert own.is_claimed, "nobody answered the second time"
    assert own.trouble == ""


def test_two_with_one_name_never_speak_together_and_it_is_said():
    bus = Bus(first := device(5, 1))
    bus.run(1.0)
    bus.join(second := device(5, 2))
    bus.run(3 * AGAIN_S)
    assert first.is_claimed
    assert not second.is_claimed
    assert second.trouble == "another device has our NAME: give this boat a nmea2000.unique_number other than 5"
    assert first.counts["another device has our NAME"] == 0, "the second one never claimed"


@pytest.mark.parametrize("seed", range(8))
def test_two_with_one_name_that_start_together_come_to_one_that_speaks(seed):
    bus = Bus(first := device(5, seed), second := device(5, seed + 100))
    bus.run(8 * AGAIN_S)
    assert first.is_claimed != second.is_claimed


def test_when_it_joins_again_it_takes_the_address_that_it_had():
    bus = Bus(own := device(5, address=33))
    bus.run(1.0)
    bus.join(other := device(6, address=33))
    bus.run(1.0)
    assert (own.address, other.address) == (33, 34)
    for parcel in own.begin(bus.now_s):
        bus.say(parcel, own)
    assert own.source == NOBODY
    bus.run(1.0)
    assert own.is_claimed
    assert own.address == 33


# Questions ------------------------------------------------------------------------------------------------------------------


@pytest.fixture
def bus():
    bus = Bus(device())
    bus.run(1.0)
    return bus


def test_it_says_who_it_is_to_an_independent_decoder(bus):
    for pgn in (PRODUCT, CONFIGURATION, PGN_LIST, HEARTBEAT):
        bus.say(ask(pgn))
    said = {}
    for parcel in bus.run(0.6):
        said.setdefault(parcel.pgn, []).append(told(parcel))
    ((message, product),) = said[PRODUCT]
    assert message.source == FIRST
    assert (product["modelId"], product["modelVersion"], product["softwareVersionCode"]) == ("Delfim", "Otter", "1.2")
    assert product["nmea2000Version"] == pytest.approx(2.1)
    assert product["modelSerialCode"] == "5"
    ((_, configuration),) = said[CONFIGURATION]
    assert configuration["installationDescription1"] == "Otter"
    assert configuration["manufacturerInformation"] == "Delfim"
    assert [fields["functionCode"] for _, fields in said[PGN_LIST]] == [0, 1]
    listed = {each["pgn"].value for each in said[PGN_LIST][0][1]["##list##"]}
    assert {*SENT, CLAIM, PRODUCT, HEARTBEAT, GROUP_FUNCTION} <= listed
    ((_, heartbeat),) = said[HEARTBEAT]
    assert heartbeat["dataTransmitOffset"] == 60.0
    assert heartbeat["equipmentStatus"] == 0


def test_heartbeats_are_numbered_and_come_once_a_minute(bus):
    beats = [told(parcel)[1]["sequenceCounter"] for parcel in bus.run(180.0) if parcel.pgn == HEARTBEAT]
    assert beats == [1, 2, 3]


def test_it_asks_all_others_for_their_names_once_a_minute(bus):
    assert [parcel for parcel in bus.run(ROLL_CALL_S + 1.0) if parcel.pgn == REQUEST] == [ask(CLAIM, FIRST)]


def test_a_claim_is_repeated_for_who_asks_and_many_questions_have_one_answer(bus):
    for _ in range(100):
        bus.say(ask(CLAIM))
        bus.say(ask(PRODUCT, destination=FIRST))
    assert bus.run(0.1) == [claim(5, FIRST), Parcel(PRODUCT, bus.log[-1][1].data, FIRST)]
    bus.say(ask(PRODUCT))
    assert bus.run(0.1) == [], "not before half a second"
    assert len(bus.run(0.5)) == 1


def test_a_question_for_what_the_boat_tells_is_the_owners_and_one_for_anything_else_is_refused(bus):
    own = bus.devices[0]
    bus.say(ask(129025, destination=FIRST))
    bus.say(ask(130306))
    assert bus.run(0.05) == []
    assert own.wanted == {129025}
    bus.say(ask(130306, destination=FIRST))
    (refusal,) = bus.run(0.05)
    message, fields = told(refusal)
    assert (refusal.destination, message.destination) == (7, 7)
    assert (fields["control"], fields["pgn"]) == (1, 130306)


def group(kind, pgn, rest, parameters=0, destination=FIRST):
    """A group function. `rest`: what stands between the PGN and the number of parameters."""
    data = bytes((kind,)) + pgn.to_bytes(3, "little") + rest + bytes((parameters,)) + bytes(2 * parameters)
    return Parcel(GROUP_FUNCTION, data, 7, 3, destination)


KEEP, FASTER = b"\xff\xff\xff\xff\xff\xff", b"\x64\x00\x00\x00\xff\xff"


@pytest.mark.parametrize(
    ("asked", "errors"),
    [
        (group(0, 129025, FASTER), (0, 1, [])),
        (group(0, 130306, KEEP), (1, 0, [])),
        (group(0, 129025, KEEP, 2), (0, 0, [5, 5])),
        (group(1, CLAIM, b"\xf8", 1), (3, 0, [4])),
        (group(1, 129025, b"\xf8"), (3, 0, [])),
        (group(1, 127237, b"\xf8", 3), (1, 0, [5, 5, 5])),
        (group(3, PRODUCT, b"\xff\xff", 2), (6, 0, [6, 6])),
        (group(5, CONFIGURATION, b"\xff\xff"), (6, 0, [])),
    ],
    ids=["another interval", "an unknown PGN", "a selection", "a new instance", "a priority", "a heading", "read", "write"],
)
def test_group_functions_are_refused_in_words_that_an_independent_decoder_reads(bus, asked, errors):
    own = bus.devices[0]
    before = own.state, own.address, own.name
    bus.say(asked)
    (answer,) = bus.run(0.05)
    _, fields = told(answer)
    assert fields["functionCode"] == 2
    assert fields["pgn"] == int.from_bytes(asked.data[1:4], "little")
    parameters = [each["parameter"].raw_value for each in fields["##list##"]] if "##list##" in fields else []
    assert (fields["pgnErrorCode"], fields["transmissionIntervalPriorityErrorCode"], parameters) == errors
    assert answer.destination == 7
    assert (own.state, own.address, own.name) == before
    assert own.wanted == set()


def test_a_group_request_without_conditions_is_answered_as_any_request(bus):
    bus.say(group(0, PRODUCT, KEEP))
    bus.say(group(0, CLAIM, KEEP))
    bus.say(group(0, 129025, KEEP))
    assert [parcel.pgn for parcel in bus.run(0.05)] == [CLAIM, PRODUCT]
    assert bus.devices[0].wanted == {129025}
    bus.say(group(0, PRODUCT, KEEP, destination=255))
    assert bus.run(1.0) == [], "a group function has one receiver"


def test_a_flood_of_questions_has_a_few_answers_and_is_counted(bus):
    for _ in range(1000):
        bus.say(ask(130306, destination=FIRST))
    assert len(bus.run(STEP_S)) == ANSWERS
    assert bus.devices[0].counts["too many questions at once"] == 1000 - ANSWERS


def test_what_cannot_be_is_refused_and_counted(bus):
    own = bus.devices[0]
    for frame in (
        Frame(standard(0x123), bytes(8)),
        Frame(extended(0x18EEFFFD), bytes(8)),
        Frame(extended(0x18EEFF07), bytes(7)),
        Frame(extended(0x18EA6407), bytes(2)),
        Frame(extended(0x0DED6407), bytes(8)),
        Frame(extended(0x0DED6507), bytes(8)),
    ):
        own.feed(frame, bus.now_s)
    own.feed(Frame(extended(0x0DED6407), b"\x20\x03\x00\x01\xf8\x01\xff\xff"), bus.now_s)
    own.feed(Frame(extended(0x0DED6407), b"\x40\x06\x02\x01\xf8\x01\x00\x00"), bus.now_s)
    assert own.counts == {
        "not an extended data frame": 1,
        "source address that nobody can have": 1,
        "claim: malformed": 1,
        "request: malformed": 1,
        "fast packet: malformed frame": 1,
        "for another device": 1,
        "group function: malformed": 1,
        "group function: not a question": 1,
    }
    assert own.is_claimed


def test_the_filters_pass_what_the_device_reads():
    def passes(arb):
        return any(accepts(CanAddress(*pair), arb) for pair in Device.FILTERS)

    for parcel in (ask(CLAIM), ask(PRODUCT, destination=FIRST), claim(1, NOBODY), group(1, CLAIM, b"\xf8")):
        assert all(passes(arb) for arb, _ in frames(parcel, 0))
    assert not passes(extended(0x09F8012B))
    assert not passes(extended(0x18ECFF07))


@pytest.mark.parametrize("seed", range(3))
def test_whatever_the_bus_says_it_stays_a_device_and_takes_no_more_memory(seed):
    rnd, own, now_s = Random(seed), device(), 0.0
    own.begin(now_s)
    for _ in range(2000):
        now_s += rnd.choice((0.0, 0.001, 0.05, 1.0))
        pgn = rnd.choice((CLAIM, CLAIM, REQUEST, GROUP_FUNCTION, GROUP_FUNCTION, rnd.getrandbits(18) & 0x3FF00))
        destination = rnd.choice((255, own.address, rnd.getrandbits(8)))
        arb = extended(rnd.getrandbits(3) << 26 | (pgn | destination) << 8 | rnd.choice((FIRST, NOBODY, rnd.getrandbits(8))))
        data = rnd.randbytes(rnd.choice((8, 8, 8, rnd.randrange(9))))
        if rnd.random() < 0.05:
            data = own.name.to_bytes(8, "little")
        own.feed(Frame(rnd.choice((arb, arb, arb, rnd.getrandbits(32))), data), now_s)
        for parcel in own.step(now_s):
            assert 0 < len(parcel.data) <= 223
            assert parcel.pgn in (CLAIM, REQUEST) or own.is_claimed
            assert all(len(part) == 8 or parcel.pgn == REQUEST for _, part in frames(parcel, 0))
    assert len(own.names) <= 252
    assert len(own.counts) < 20
    assert sum(len(flights) for flights in own._fast._flights.values()) <= 2 * 252
