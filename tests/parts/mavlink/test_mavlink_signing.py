"""Who may speak: nothing unsigned, forged, altered, replayed or late from elsewhere changes anything, and it is counted."""

import os
import stat

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import ConfigError
from delfim.base.input.keys import new_key, read_key
from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.signing import Kept, Signing, read_stamps, write_stamps
from delfim.parts.mavlink.codec.wire import dialect
from delfim.parts.mavlink.station import Station
from delfim.parts.mavlink.table import Mavlink
from tests.parts.mavlink.mavlink_console import Console, Radio, newest

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
AFAR = ("192.0.2.7", 14550)
YEAR_S = 365.25 * 86_400.0
SINCE_S = 17 * YEAR_S  # the tests' clock stands in 2010, before time stamps began


def beat(system: int, clock: ManualClock) -> bytes:
    """A signed heartbeat."""
    return wire.Sender(system, 190, KEY, Signing(KEY, clock).stamp).pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))


class Sea:
    """A boat with a key, and a console with one, on another computer."""

    def __init__(self, boat, key: bytes | None = KEY, stamps: Kept | None = None, **options: object) -> None:
        self.boat, self.radio = boat, Radio()
        boat.vehicle.helm.settings = config.Vehicle(boat=config.BoatTable(name="test", id=1), mavlink=Mavlink(**options))
        self.signing = Signing(key, boat.clock, stamps) if key else None
        self.station = Station(boat.vehicle, boat.vehicle.on_command, self.radio, self.signing)
        boat.ready()

    def console(self, key: bytes | None = KEY, system: int = 250, address=AFAR) -> Console:
        signing = Signing(key, self.boat.clock) if key else None
        return Console(self.station, self.radio, system, address, signing)


@pytest.fixture
def sea(boat):
    boat.clock.step(SINCE_S)
    return Sea(boat)


def test_a_boat_whose_clock_is_set_is_heard_from_then_on_and_hears_all_the_time():
    """Before that its stamps are of 1970, and nobody who knows better takes them for new."""
    ashore, aboard = ManualClock(), ManualClock()
    ashore.step(SINCE_S)
    aboard.step(-40 * 365.25 * 86_400.0)
    console, boat = Signing(KEY, ashore), Signing(KEY, aboard)

    def said(by: Signing, system: int) -> bytes:
        return wire.Sender(system, 190, KEY, by.stamp).pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    for number in range(10):
        if number == 5:
            aboard.step((ashore.time_ns() - aboard.time_ns()) / 1e9)
        assert boat.judge(said(console, 250)).fault == ""
        assert console.judge(said(boat, 1)).fault == ("replayed" if number < 5 else "")
        ashore.advance(1.0)
        aboard.advance(1.0)


def untouched(sea) -> bool:
    return sea.boat.state.mode is Mode.IDLE and not sea.station.consoles.owner and AFAR not in sea.station.consoles.peers.known


def test_a_signed_command_is_obeyed_and_its_answer_is_signed(sea):
    console = sea.console()
    before = len(sea.radio.sent)
    assert console.mode(3)[0] == 0
    assert sea.boat.state.mode is Mode.HEADING
    answers = Signing(KEY, sea.boat.clock)
    frames = [frame for data, _ in sea.radio.sent[before:] for frame in wire.frames(data)[0]]
    assert frames
    assert [answers.judge(frame).fault for frame in frames] == [""] * len(frames)


@pytest.mark.parametrize(("key", "fault"), [(None, "unsigned"), (OTHER, "forged")])
def test_without_the_key_nothing_changes(sea, key, fault):
    sea.console(key).say("command_long", 1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)
    assert untouched(sea)
    assert sea.station.consoles.counts == {fault: 1}


def test_a_frame_heard_again_changes_nothing(sea):
    console = sea.console()
    frame = console.frame("command_long", 1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)
    console.deliver(frame)
    console.mode(4)
    console.deliver(frame)
    assert sea.boat.state.mode is Mode.IDLE
    assert sea.station.consoles.counts == {"replayed": 1}


def test_a_frame_heard_again_after_a_restart_changes_nothing(sea, make_boat, tmp_path):
    console = sea.console()
    frame = console.frame("command_long", 1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)
    console.deliver(frame)
    write_stamps(tmp_path / "stamps", sea.signing.kept())
    rebooted = make_boat()
    rebooted.clock.step(SINCE_S)
    again = Sea(rebooted, stamps=read_stamps(tmp_path / "stamps"))
    again.console().deliver(frame)
    assert untouched(again)
    assert again.station.consoles.counts == {"replayed": 1}


@given(st.data())
def test_any_altered_bit_is_noticed(data):
    clock = ManualClock()
    signing = Signing(KEY, clock)
    frame = bytearray(beat(250, clock))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    cut, whole = wire.frames(bytes(frame))
    assert not whole or signing.judge(cut[0]).fault in ("forged", "unsigned")
    assert signing.heard == {}


def test_a_forged_stamp_does_not_silence_the_console(sea):
    """pymavlink's own parser would remember it."""
    console = sea.console()
    frame = bytearray(console.frame("heartbeat", 6, 8, 0, 0, 4, 3))
    frame[-12:-6] = b"\xff" * 6
    console.deliver(bytes(frame))
    assert console.mode(3)[0] == 0
    assert sea.station.consoles.counts == {"forged": 1}


def test_a_new_speaker_is_not_from_long_ago(sea):
    past = ManualClock(time_ns=sea.boat.clock.time_ns() - 61_000_000_000)
    Console(sea.station, sea.radio, 250, AFAR, Signing(KEY, past)).say("heartbeat", 6, 8, 0, 0, 4, 3)
    assert sea.station.consoles.counts == {"replayed": 1}


def test_a_console_that_is_not_obeyed_for_its_clock_is_told_to_those_who_are(sea):
    """Once, however often it says something, and its orders change nothing."""
    known, before = sea.console(), len(sea.radio.sent)
    known.beat()
    ahead = ManualClock(time_ns=sea.boat.clock.time_ns() + round(YEAR_S * 1e9))
    stranger = Console(sea.station, sea.radio, 222, ("192.0.2.8", 14550), Signing(KEY, ahead))
    for _ in range(3):
        stranger.say("command_long", 1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)
    assert sea.boat.state.mode is Mode.IDLE
    assert sea.station.consoles.counts == {"ahead": 3}
    texts = [wire.decode(frame) for data, _ in sea.radio.sent[before:] for frame in wire.frames(data)[0]]
    said = "".join(each.text for each in texts if each.get_type() == "STATUSTEXT")
    assert said == "console 222 signs 365 days ahead of the clock here, and is not believed: one of the two clocks is wrong"


def test_a_boat_whose_clock_was_never_set_hears_its_console(make_boat):
    boat = make_boat()
    now = ManualClock(time_ns=boat.clock.time_ns() + round(SINCE_S * 1e9))
    sea = Sea(boat)
    Console(sea.station, sea.radio, 250, AFAR, Signing(KEY, now)).say("heartbeat", 6, 8, 0, 0, 4, 3)
    assert sea.station.consoles.counts == {}
    assert AFAR in sea.station.consoles.peers.known


def test_a_command_that_was_long_on_the_way_is_not_obeyed(sea):
    """A radio that kept it through an outage; what follows at once is."""
    console = sea.console()
    console.beat()
    kept = console.frame("command_long", 1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)
    sea.boat.clock.advance(4.0)
    sea.boat.ready()
    console.deliver(kept)
    assert sea.boat.state.mode is Mode.IDLE
    assert sea.station.consoles.counts == {"late": 1}
    assert console.mode(3)[0] == 0


def test_clocks_that_differ_do_not_matter(sea):
    """Half a minute ahead, and 100 parts in a million fast, for an hour."""
    theirs = ManualClock(time_ns=sea.boat.clock.time_ns() + 30_000_000_000)
    console = Console(sea.station, sea.radio, 250, AFAR, Signing(KEY, theirs))
    for _ in range(3600):
        console.beat()
        sea.boat.clock.advance(1.0)
        theirs.advance(0.9999)
    sea.boat.ready()
    assert console.mode(3)[0] == 0
    assert sea.station.consoles.counts == {}


def test_without_a_key_only_this_computer_is_heard(make_boat):
    sea = Sea(make_boat(), key=None)
    sea.console(KEY).beat()
    assert sea.station.consoles.counts == {"unsigned": 1}
    here = sea.console(None, address=("127.0.0.1", 14550))
    here.beat()
    assert here.mode(3)[0] == 0


def test_with_a_key_this_computer_signs_too(make_boat):
    """Another user's shell is on it."""
    sea = Sea(make_boat())
    stranger = sea.console(None, address=("127.0.0.1", 14550))
    stranger.say("command_long", 1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)
    assert untouched(sea)
    assert sea.station.consoles.counts == {"unsigned": 1}
    assert newest(sea.console(KEY, address=("127.0.0.1", 14551)).say("timesync", 0, 1), "TIMESYNC").ts1 == 1


# Keys.


def test_a_key_is_written_once_for_its_owner_alone(tmp_path):
    path = tmp_path / "key"
    new_key(path)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert len(read_key(path)) == 32
    with pytest.raises(FileExistsError):
        new_key(path)


@pytest.mark.parametrize("text", ["", "zz" * 32, "00" * 31, "00" * 33, "é" * 64])
def test_what_is_no_key(tmp_path, text):
    path = tmp_path / "key"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match=r"\(allowed: 64 hexadecimal digits\)$"):
        read_key(path)


def test_a_key_that_others_may_read_is_refused(tmp_path):
    path = tmp_path / "key"
    new_key(path)
    os.chmod(path, 0o644)
    with pytest.raises(ConfigError, match="others may read it"):
        read_key(path)
    with pytest.raises(ConfigError, match=r"none: key: No such file or directory$"):
        read_key(tmp_path / "none")


@pytest.mark.parametrize("text", ["", "{}", "[1]", "[[[1,2],3]]", "nonsense", '{"sent":-1}', '{"sent":281474976710656}'])
def test_stamps_that_cannot_be_read_are_none(tmp_path, text):
    path = tmp_path / "stamps"
    path.write_text(text)
    assert read_stamps(path) == Kept()
    kept = Kept(281474976710655, 0, [((0, 250, 190), 7)])
    write_stamps(path, kept)
    assert read_stamps(path) == kept


def test_stamps_of_before_are_read(tmp_path):
    path = tmp_path / "stamps"
    path.write_text("[[[0,250,190],7]]")
    assert read_stamps(path) == Kept(heard=[((0, 250, 190), 7)])
