"""Anything may come by radio: it is understood, or counted, and the loop goes on as if nothing had been."""

import asyncio
import contextlib
import socket
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.fuzz import framed
from delfim import config
from delfim.base.errors import FormatError
from delfim.base.modes import Mode
from delfim.parts.mavlink.codec import wire
from delfim.parts.mavlink.codec.params import NAMES
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.codec.wire import dialect
from delfim.parts.mavlink.peers import PEERS
from delfim.parts.mavlink.received.commands import COMMANDS
from delfim.parts.mavlink.station import FRAMES, PENDING, Station
from delfim.parts.mavlink.stationsocket import MavlinkLink
from delfim.parts.mavlink.table import Mavlink
from delfim.vehicle.console import Kill, Stop, Take
from tests.parts.mavlink.mavlink_console import HOME, Console, Radio
from tests.parts.mavlink.test_mavlink_station import afloat, sail

ONCE = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@given(st.binary(max_size=300))
def test_any_datagram_is_cut_or_refused(datagram):
    found, whole = wire.frames(datagram)
    assert b"".join(found) == datagram if whole else datagram.startswith(b"".join(found))


@given(st.binary(min_size=10, max_size=290).map(lambda data: b"\xfd" + bytes([len(data) - 10]) + b"\0" + data[1:]))
def test_any_frame_is_decoded_or_a_format_error(frame):
    with contextlib.suppress(FormatError):
        wire.decode(frame)


@ONCE
@given(st.lists(st.tuples(st.sampled_from(sorted(dialect.mavlink_map)), st.binary(min_size=1, max_size=255)), max_size=20))
def test_any_message_with_anything_in_it_leaves_the_loop_unharmed(boat, contents):
    radio = Radio()
    station = Station(boat.vehicle, boat.vehicle.on_command, radio, None)
    for sequence, (number, payload) in enumerate(contents):
        station.receive(framed(number, payload, sequence, 250, 190), HOME)
        while station.turn():
            pass
    station.tick()
    assert boat.navigate() in (True, False)


STRANGERS = st.tuples(st.integers(2, 249) | st.integers(251, 255), st.integers(1, 255))  # who does not command
ANYTHING = st.tuples(st.sampled_from(sorted(dialect.mavlink_map)), st.binary(min_size=1, max_size=255))
NUMBERS = st.floats(width=32) | st.sampled_from([0.0, 1.0, *map(float, Mode)])
ORDERS = st.builds(
    lambda command, p: dialect.MAVLink_command_long_message(1, 1, command, 0, *p),
    st.sampled_from([*COMMANDS, *range(3)]),
    st.tuples(*[NUMBERS] * 7),
)
AXES = st.integers(-1000, 1000)
THRUSTS = st.builds(lambda axes: dialect.MAVLink_manual_control_message(1, *axes, 0), st.tuples(*[AXES] * 4))
VALUES = st.builds(
    lambda name, value: dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9), st.sampled_from(NAMES), NUMBERS
)


@ONCE
@pytest.mark.parametrize(
    "mode", [Mode.MANUAL, *(pytest.param(mode, marks=pytest.mark.long) for mode in (Mode.HEADING, Mode.IDLE))]
)
@given(st.lists(st.tuples(STRANGERS, ANYTHING | ORDERS | THRUSTS | VALUES), min_size=1, max_size=20))
def test_whatever_anybody_else_says_moves_nothing(make_boat, mode, said):
    """Beside a boat that hears its own console alone: what the propellers are told is the same in each cycle. Anybody may stop
    or kill the boat or take over, and it does not go on from there."""
    disturbed, alone = (afloat(make_boat()) for _ in range(2))
    for sea in (disturbed, alone):
        sea.console.mode(mode)
        sea.console.command(32100, 0, 1)
    senders = {party: wire.Sender(*party, None, lambda: 0) for party, _ in said}
    for sequence, (party, message) in enumerate(said):
        frame = framed(*message, sequence, *party) if isinstance(message, tuple) else senders[party].pack(message)
        before = len(disturbed.log)
        disturbed.station.receive(frame, ("127.0.0.1", 20_000 + party[0]))
        while disturbed.station.turn():
            pass
        obeyed = disturbed.log[before:]
        assert all(isinstance(command, Stop | Kill | Take) for command in obeyed)
        if obeyed:
            return
        for sea in (disturbed, alone):
            sea.console.say("manual_control", 1, 500, 0, 0, 100, 0)
            sail(sea, 0.1)
        assert disturbed.state.actuation == alone.state.actuation
        assert (disturbed.state.mode, disturbed.station.consoles.owner) == (alone.state.mode, alone.station.consoles.owner)
        assert disturbed.vehicle.helm.settings == alone.vehicle.helm.settings
        assert disturbed.vehicle.helm.plans.mission is None
    assert alone.state.actuation.run is (mode is not Mode.IDLE)


@pytest.mark.parametrize("count", [10_000, pytest.param(100_000, marks=pytest.mark.long)])
def test_many_datagrams_of_anything(boat, count):
    """Messages of every kind with anything in them, from many addresses, most of them commands and plans; one in ten is cut
    short or altered on its way."""
    sea = afloat(boat)
    random, console = Random(1), sea.console
    kinds = sorted(dialect.mavlink_map)
    for n in range(count):
        payload = random.randbytes(random.randrange(1, 60))
        if n % 2:
            number = random.choice((76, 75, 69, 44, 73, 23, 11, 41, 45, 47, 51))
            payload = bytes([random.randrange(256) if random.random() < 0.9 else 1 for _ in payload])
        else:
            number = random.choice(kinds)
        data = framed(number, payload, n & 0xFF, random.randrange(256), random.randrange(256))
        if n % 10 == 0:
            at = random.randrange(len(data))
            data = data[:at] + random.choice((b"", random.randbytes(1) + data[at + 1 :]))
        sea.station.receive(data, ("127.0.0.1", 20_000 + n % 40))
        while sea.station.turn():
            pass
    assert len(sea.station.consoles.peers.known) <= PEERS
    assert sea.station.consoles.counts["peers_replaced"] > 0
    sea.vehicle.helm.stop("test")
    sail(sea, 1.0)
    assert sea.state.mode is Mode.IDLE
    assert console.listen()


def test_a_flood_is_worked_off_a_little_at_a_time_and_what_is_too_much_is_dropped(boat):
    sea = afloat(boat)
    frame = sea.console.frame("timesync", 0, 1)
    for _ in range(20):
        sea.station.receive(frame * 50, HOME)
    assert sea.station.consoles.counts["dropped"] == 20 - PENDING // 50 - 1 + 1
    turns = 1
    while sea.station.turn():
        turns += 1
    assert turns == PENDING // FRAMES


def test_the_socket_asks_for_low_delay_and_survives_what_comes(boat, tmp_path):
    """Over a real socket on a real loop: rubbish, then a command that is obeyed."""
    boat.vehicle.helm.settings = config.Vehicle(
        boat=config.BoatTable(name="test", id=1), mavlink=Mavlink(listen="127.0.0.1:0", peers=())
    )
    boat.ready()
    board: dict = {}

    async def serve() -> dict:
        loop = asyncio.get_running_loop()
        with MavlinkLink(boat.vehicle, boat.vehicle.on_command, None, tmp_path / "stamps", board) as link:
            tos = link._socket.getsockopt(socket.IPPROTO_IP, socket.IP_TOS)
            host, port = str(board["mavlink"]()["listen"]).split(":")
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as console:
                console.setblocking(False)
                await loop.sock_connect(console, (host, int(port)))
                random = Random(2)
                for _ in range(300):
                    await loop.sock_sendall(console, random.randbytes(random.randrange(1, 1400)))
                    await asyncio.sleep(0)
                sender = wire.Sender(250, 190, None, lambda: 0)
                heading = dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, 3, 0, 0, 0, 0, 0)
                while boat.state.mode is not Mode.HEADING:
                    await loop.sock_sendall(console, sender.pack(heading))
                    await asyncio.sleep(0)
                answer = await loop.sock_recv(console, 2048)
            return {"tos": tos, "answer": answer, **board["mavlink"]()}

    report = asyncio.run(asyncio.wait_for(serve(), 60))
    assert report["tos"] == 0x10
    assert wire.frames(report["answer"])[1]
    assert report["counts"]["malformed"] > 200
    assert report["owner"] == 250
    assert board == {}


def test_an_address_that_is_taken_is_told_and_the_boat_sails(boat, tmp_path, caplog):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        boat.vehicle.helm.settings = config.Vehicle(boat=config.BoatTable(name="test"), mavlink=Mavlink(listen=listen))

        async def serve() -> None:
            try:
                MavlinkLink(boat.vehicle, boat.vehicle.on_command, None, tmp_path / "stamps", {})
            except OSError:
                return
            raise AssertionError("somebody else is there")

        asyncio.run(serve())
    assert "no console can connect" in caplog.text


def test_a_peer_that_came_by_itself_is_forgotten_and_others_are_greeted(boat):
    sea = afloat(boat)
    stranger = Console(sea.station, sea.radio, 251, ("127.0.0.1", 14999))
    stranger.beat()
    assert len(sea.station.consoles.peers.known) == 2
    sail(sea, 16.0)
    before = len(sea.radio.sent)
    heard = sail(sea, 3.0)
    assert list(sea.station.consoles.peers.known) == [HOME]
    assert {m.get_type() for m in heard} == {"HEARTBEAT"}, "only that the boat exists"
    assert all(to == HOME for _, to in sea.radio.sent[before:])


def test_own_stamps_only_grow(boat):
    boat.clock.step(-1e6)
    signing = Signing(bytes(32), boat.clock)
    stamps = [signing.stamp() for _ in range(3)]
    boat.clock.step(-1e5)
    stamps += [signing.stamp() for _ in range(3)]
    assert stamps == sorted(set(stamps))
