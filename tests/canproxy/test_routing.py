"""Messages between nodes of several buses: delivered once, acknowledged end to end, and never in a circle."""

import contextlib
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import BusError, ConfigError
from delfim.base.frames import CAN_RTR, Frame, extended, standard
from delfim.canproxy.dsor.endpoint import CanPort, CanSegm
from delfim.canproxy.dsor.protocol import BROADCAST, Kind, dsor_arb
from delfim.canproxy.dsor.routing import FRAMES_A_CALL, Router
from delfim.canproxy.dsor.sockets import DsorSocket, open_dsor
from delfim.canproxy.socket import ANYTHING
from delfim.canproxy.tables import Routing, RoutingBus
from delfim.simulator.lockstepbus import LockstepBus

ROOT = Path(__file__).parents[2]
HOME, SONARS, WINCH = (f"canloop:{name}-{os.getpid()}" for name in ("home", "sonars", "winch"))
TABLE = Routing(
    everybody=(2,),
    buses={
        "sonars": RoutingBus(interface=SONARS, nodes=(0x30, 0x31)),
        "winch": RoutingBus(interface=WINCH, nodes=(0x40,)),
    },
)


@pytest.fixture(scope="module")
def routed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The service in a process of its own, between three buses."""
    place = tmp_path_factory.mktemp("router")
    values = [f'can.interface="{HOME}"', "routing.everybody=[2]", f'runtime.run_directory="{place}"']
    values += [
        f'routing.buses.{name}={{interface="{bus.interface}", nodes={list(bus.nodes)}}}' for name, bus in TABLE.buses.items()
    ]
    words = [word for value in values for word in ("--set", value)]
    beat, told = os.pipe()
    command = [sys.executable, "-m", "delfim", "run", str(ROOT / "etc/delfimx.toml"), "--service", "router", *words]
    with subprocess.Popen([*command, "--beat-fd", str(told)], pass_fds=(told,)) as process:
        os.close(told)
        assert os.read(beat, 1), "it has opened its buses"
        yield
        process.terminate()
        assert process.wait(200) == 0
    os.close(beat)


@contextlib.contextmanager
def node(bus: str, number: int) -> Iterator[DsorSocket]:
    with open_dsor(bus, number) as opened:
        opened.settimeout(200.0)
        yield opened


@pytest.mark.parametrize("to", ["segmented", "port"])
@pytest.mark.parametrize(("there", "number"), [(HOME, 2), (WINCH, 0x40)], ids=["home", "winch"])
def test_a_message_reaches_a_node_of_another_bus_and_is_answered(routed: None, there: str, number: int, to: str) -> None:
    sent, got = os.urandom(3000), list[object]()
    here, away = (
        (CanSegm(0x80, 0x30, 7), CanSegm(0x80, number, 7))
        if to == "segmented"
        else (CanPort(512 * 0x30 + 300), CanPort(512 * number + 5))
    )

    def answers() -> None:
        data, source = far.recvfrom(65535)
        got.append((data, source.node))
        far.sendto(b"understood", here)

    with node(SONARS, 0x30) as near, node(there, number) as far:
        near.bind(here)
        far.bind(away)
        thread = threading.Thread(target=answers)
        thread.start()
        near.sendto(sent, away)
        assert near.recvfrom(100)[0] == b"understood"
        while thread.is_alive():  # on a busy machine the last segment comes again, and wants its acknowledgement
            near.step()
            thread.join(0.01)
    assert got == [(sent, 0x30)]


def test_a_node_that_is_not_there_is_told_as_on_one_bus(routed: None) -> None:
    with node(SONARS, 0x30) as near, pytest.raises(BusError, match="node 0x40 did not acknowledge the header"):
        near.sendto(b"anybody?", CanSegm(0x80, 0x40, 7))


def test_to_everybody_goes_what_the_table_lets_go(routed: None) -> None:
    with node(HOME, 2) as named, node(HOME, 3) as other, node(WINCH, 0x40) as far:
        far.bind(CanSegm(0, 0x40, 7))
        far._end.listen(lambda message: True)
        other.sendto(b"for this bus", CanSegm(0x80, BROADCAST, 7))
        named.sendto(b"for all", CanSegm(0x80, BROADCAST, 7))
        data, source = far.recvfrom(100)
        assert (data, source.node) == (b"for all", 2)


class Wires:
    """Three buses in this process with a router between them."""

    def __init__(self, table: Routing) -> None:
        self.clock = ManualClock()
        self.buses = {name: LockstepBus(self.clock, name) for name in (HOME, SONARS, WINCH)}
        self.router = Router(table, HOME, {name: bus.socket("router") for name, bus in self.buses.items()}, self.clock)
        self.ends = {name: bus.socket("node") for name, bus in self.buses.items()}
        for end in self.ends.values():
            end.bind(ANYTHING)

    def route(self) -> None:
        for _ in range(4):
            for name in self.buses:
                self.router.on_readable(name)

    def heard(self) -> dict[str, list[Frame]]:
        return {name: list(iter(end.receive, None)) for name, end in self.ends.items()}


@given(
    st.sampled_from((HOME, SONARS, WINCH)),
    st.integers(0, 3),
    st.sampled_from((0, 2, 3, 0x30, 0x31, 0x40, 0x7E)),
    st.sampled_from((0, 2, 3, 0x30, 0x31, 0x40, 0x7E, BROADCAST)),
)
def test_what_is_heard_goes_to_each_other_bus_once_at_most_and_never_back(bus: str, kind: int, source: int, to: int) -> None:
    wires = Wires(TABLE)
    frame = Frame(dsor_arb(0x80, kind, source, to, 5), b"12345678")
    wires.ends[bus].sendmsg(frame)
    wires.route()
    heard = wires.heard()
    homes = {0x30: SONARS, 0x31: SONARS, 0x40: WINCH}
    expected = set[str]()
    if kind != Kind.PLAIN and homes.get(source, HOME) == bus:
        expected = {homes.get(to, HOME)} if to != BROADCAST else {HOME, SONARS, WINCH} if source == 2 else set()
    assert {name for name, frames in heard.items() if frames} == expected - {bus}
    assert all([(each.arb, each.data) for each in frames] in ([], [(frame.arb, frame.data)]) for frames in heard.values())


@pytest.mark.parametrize("arb", [standard(0x30), extended(0x30 << 12) | 3 << 22, dsor_arb(0x80, 0, 0x30, 2, 0) | CAN_RTR])
def test_frames_of_other_kinds_stay_where_they_are(arb: int) -> None:
    wires = Wires(TABLE)
    wires.ends[SONARS].sendmsg(Frame(arb))
    wires.route()
    assert not any(wires.heard().values())


def test_a_source_on_the_wrong_bus_is_counted_and_goes_no_further() -> None:
    """As with a second router whose table says otherwise."""
    wires = Wires(TABLE)
    wires.ends[HOME].sendmsg(Frame(dsor_arb(0x80, 0, 0x30, 0x40, 0)))
    wires.route()
    assert not any(wires.heard().values())
    assert wires.router.counts[HOME] == {"from": 0, "to": 0, "lost": 0, "astray": 1}


def test_no_more_frames_go_on_than_the_table_allows() -> None:
    wires = Wires(Routing(frames_per_s=10, buses=TABLE.buses))
    waiting = deque(Frame(dsor_arb(0x80, 1, 0x30, 2, n & 31)) for n in range(30))
    while waiting:
        wires.ends[SONARS].sendmsg(waiting.popleft())
    for _ in range(30 // FRAMES_A_CALL + 1):
        wires.route()
    assert len(wires.heard()[HOME]) == 10
    assert wires.router.counts[HOME]["lost"] == 20
    wires.clock.advance(0.5)
    wires.ends[SONARS].sendmsg(Frame(dsor_arb(0x80, 1, 0x30, 2, 0)))
    wires.route()
    assert len(wires.heard()[HOME]) == 1


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (['routing.buses.a={interface="can0", nodes=[1]}'], "this is can.interface"),
        (['routing.buses.a={interface="can2", nodes=[0]}'], "this computer's own"),
        (['routing.buses.a={interface="can2", nodes=[]}'], r"routing\.buses\.a\.nodes"),
        (['routing.buses={a={interface="can2", nodes=[1]}, b={interface="can3", nodes=[1]}}'], "node 0x01 is named twice"),
        (['routing.buses={a={interface="can2", nodes=[1]}, b={interface="can2", nodes=[2]}}'], "can2 is named twice"),
        (['navigation.sources=["nmea2000"]', 'routing.buses.a={interface="can1", nodes=[1]}'], "can1 carries NMEA 2000"),
    ],
)
def test_tables_that_mean_nothing_are_refused(words: list[str], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        config.load(ROOT / "etc/delfimx.toml", words)


def test_a_routed_bus_is_one_of_the_boat_with_a_rate_of_its_own() -> None:
    words = ['routing.buses.a={interface="can2", nodes=[1], bitrate_bps=250000}']
    vehicle = config.load(ROOT / "etc/delfimx.toml", words)
    assert vehicle.buses == ("can0", "can2")
    assert vehicle.bit_rates == {"can0": 500_000, "can2": 250_000}
