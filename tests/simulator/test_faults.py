"""Faults: what each does to the nodes and their bus, that it ends, and that nothing else changes."""

import json
import math
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.errors import DelfimError, FormatError, Refused
from delfim.base.frames import Frame
from delfim.base.modes import Mode
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import Navigation, Node, Status
from delfim.canproxy.dsor.receiver import Receiver
from delfim.simulator.faults import (
    ABOARD,
    KINDS,
    OF_AIS,
    OF_COMPASS,
    OF_PULSES,
    OF_THRUSTERS,
    VALUES,
    WHERE,
    Faults,
    FaultyGuest,
    FaultyLog,
    fault,
)
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.nodes import nodes_of
from delfim.simulator.realtime import fault_socket
from delfim.vehicle import console
from delfim.vehicle.state import NoLog, State

SETTINGS = config.Vehicle(boat=config.BoatTable(name="test"))
STEP_S = 0.2


class World:
    """Nodes with faults, stepped five times a second, their propellers commanded like by a boat under way."""

    def __init__(self, seed: int = 1) -> None:
        self.faults, self.now_s, self.counter = Faults(nodes_of(SETTINGS, seed), seed), 0.0, 0
        self.receiver = Receiver(Node.VEHICLE, lambda message: message.id == messages.NAVIGATION_ID)

    def step(self, rpm: int = 800) -> list[Frame]:
        frames = self.faults.step(self.now_s, round(self.now_s * 1e9))
        self.counter += 1
        for arb in (messages.PROPELLER_STARBOARD, messages.PROPELLER_PORT):
            self.faults.feed(Frame(arb, messages.PROPELLER_COMMAND.pack(rpm, rpm != 0, self.counter & 255)), self.now_s)
        for arb in (messages.BATTERIES_STARBOARD, messages.BATTERIES_PORT):
            self.faults.feed(Frame(arb, messages.BATTERIES_COMMAND.pack(1, self.counter & 255)), self.now_s)
        self.now_s += STEP_S
        return frames

    def navigation(self, seconds: float) -> list[Navigation]:
        heard = []
        for _ in range(round(seconds / STEP_S)):
            for frame in self.step():
                message = self.receiver.feed(frame, self.now_s)
                if message is not None:
                    heard.append(messages.unpack_navigation(message.data))
        return heard

    def begin(self, *words: object) -> None:
        self.faults.begin(fault(*words), self.now_s)  # type: ignore[arg-type]


@pytest.fixture
def world() -> World:
    return World()


def status(frames: list[Frame], node: Node) -> messages.SystemStatus | None:
    found = [frame.data for frame in frames if frame.arb == messages.sysstat_arb(node)]
    return messages.unpack_sysstat(node, found[-1]) if found else None


def test_without_a_fault_nothing_is_changed():
    broken, whole = World(), nodes_of(SETTINGS, 1)
    for tick in range(200):
        assert broken.faults.step(tick * STEP_S, tick) == whole.step(tick * STEP_S, tick)


def test_navigation_falls_silent_and_comes_back(world):
    assert len(world.navigation(2.0)) == 10
    world.begin("navigation_silent", "", None, 3.0)
    assert world.navigation(3.0) == []
    assert len(world.navigation(2.0)) == 10
    assert world.faults.on == {}


def test_navigation_freezes_but_for_clock_and_counter(world):
    before = world.navigation(4.0)[-1]
    world.begin("navigation_frozen")
    frozen = world.navigation(2.0)
    assert {n[1:9] for n in frozen} == {before[1:9]}
    assert len({n.counter for n in frozen}) == len(frozen)


def test_navigation_repeats_itself(world):
    before = world.navigation(4.0)[-1]
    world.begin("navigation_repeating")
    assert set(world.navigation(2.0)) == {before}


def test_navigation_jumps_and_comes_back(world):
    before = world.navigation(1.0)[-1]
    world.begin("navigation_jumping", "", 100.0, 1.0)
    away = world.navigation(1.0)[-1]
    assert (away.latitude_rad - before.latitude_rad) * 6.37e6 == pytest.approx(100.0, abs=5.0)
    after = world.navigation(1.0)[-1]
    assert (after.latitude_rad - before.latitude_rad) * 6.37e6 == pytest.approx(0.0, abs=5.0)


def test_frames_are_lost_doubled_and_late(world):
    plain = sum(len(world.step()) for _ in range(100))
    world.begin("frames_dropped", "", 0.5)
    assert sum(len(world.step()) for _ in range(100)) == pytest.approx(plain / 2, rel=0.15)
    world.faults.end("frames_dropped")
    world.begin("frames_duplicated", "", 0.5)
    assert sum(len(world.step()) for _ in range(100)) == pytest.approx(plain * 1.5, rel=0.1)
    world.faults.end("frames_duplicated")
    world.begin("frames_late", "", 0.55)
    seen = [len(world.step()) for _ in range(100)]
    assert seen[:3] == [0, 0, 0], "the first comes 0.6 s later"
    assert sum(seen) == pytest.approx(plain, rel=0.1)
    world.faults.end("frames_late")
    assert len(world.step()) > 6, "what was under way arrives"


def test_commands_are_late_too(world):
    for _ in range(10):
        world.step()
    world.begin("frames_late", "", 0.6)
    for _ in range(3):
        world.step(rpm=0)
        assert world.faults.model.starboard.run
    for _ in range(2):
        world.step(rpm=0)
    assert not world.faults.model.starboard.run


def test_bus_off_is_silence_both_ways(world):
    world.step()
    world.begin("bus_off", "", None, 3.0)
    for _ in range(14):
        assert world.step() == []
    assert not world.faults.model.starboard.run, "the propeller stopped itself: nobody told it anything"
    for _ in range(3):
        frames = world.step()
    assert frames


@pytest.mark.parametrize(("where", "node"), [(name, Node[name.upper()]) for name in WHERE["sensor_bad"] if name != "gps"])
def test_a_node_reports_bad_or_nothing(world, where, node):
    for _ in range(10):
        world.step()
    world.begin("sensor_bad", where)
    bad = [report for _ in range(10) if (report := status(world.step(), node))]
    assert {report.status for report in bad} == {Status.BAD}
    world.faults.end("sensor_bad", where)
    world.begin("sensor_silent", where)
    assert not any(status(world.step(), node) for _ in range(10))


def test_a_propeller_is_dead_stuck_or_reversed(world):
    for _ in range(30):
        world.step()
    drive = world.faults.model.port
    before_rpm = drive.rpm
    world.begin("thruster_stuck", "port")
    for _ in range(30):
        world.step(rpm=0)
    assert drive.rpm == before_rpm
    world.faults.end("thruster_stuck", "port")
    world.begin("thruster_dead", "port")
    for _ in range(30):
        world.step()
    assert abs(drive.rpm) < 10
    assert world.faults.model.starboard.rpm == pytest.approx(800, abs=5)
    world.faults.end("thruster_dead", "port")
    world.begin("thruster_reversed", "port")
    for _ in range(30):
        world.step()
    assert drive.rpm == pytest.approx(-800, abs=5)


def test_a_stuck_propeller_stops_without_its_batteries(world):
    for _ in range(30):
        world.step()
    world.begin("thruster_stuck", "starboard")
    world.faults.model.starboard.connected = False
    world.faults.model.advance(5.0)
    assert world.faults.model.starboard.rpm < 10


def test_charge_goes_and_does_not_come_back(world):
    world.begin("battery_sag", "port", 0.15, 1.0)
    for _ in range(20):
        world.step()
    assert 0.1 < world.faults.model.port.charge < 0.15
    assert world.faults.model.starboard.charge > 0.9


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("sunk",), "no fault 'sunk'; choose one of navigation_silent, "),
        (("thruster_dead",), "thruster_dead needs one of starboard, port"),
        (("thruster_dead", "gps"), "needs one of starboard, port"),
        (("bus_off", "port"), "bus_off takes no place: 'port'"),
        (("bus_off", "", 3.0), "bus_off: 3.0 is out of range"),
        (("frames_late", "", math.nan), "is out of range"),
        (("bus_off", "", None, 0.0), "not a duration"),
        (("bus_off", "", None, math.nan), "not a duration"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_in_words(words, reason):
    with pytest.raises(FormatError) as refused:
        fault(*words, thrusters=("starboard", "port"))
    assert reason in str(refused.value)


@settings(deadline=None, max_examples=30)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([kind for kind in KINDS if kind not in (*OF_COMPASS, *OF_AIS, *OF_PULSES)]),
            st.integers(0, 4),
            st.floats(0.1, 5.0),
            st.booleans(),
        ),
        max_size=30,
    )
)
def test_any_faults_at_any_time_end_without_a_trace(orders):
    world = World()
    for kind, place, for_s, end in orders:
        places = ("starboard", "port") if kind in OF_THRUSTERS else WHERE.get(kind, ("",))
        where = places[place % len(places)]
        world.begin(kind, where, None, for_s)
        world.step()
        if end:
            world.faults.end(kind, where)
    for _ in range(60):
        world.step()
    faults = world.faults
    assert (faults.on, faults.faults) == ({}, {})
    assert len(world.navigation(2.0)) == 10
    assert faults.model.port.fault is None
    assert not any(node.bad or node.silent for node in faults.nodes.sensors.values())


@pytest.mark.parametrize("kind", OF_COMPASS)
def test_a_boat_without_a_compass_has_no_fault_of_one(world, kind):
    with pytest.raises(FormatError, match=f"{kind}: this boat has no compass"):
        world.begin(kind)
    assert world.faults.on == {}


def test_a_compass_is_disturbed_and_left_alone_again():
    boat = msgspec.structs.replace(SETTINGS, navigation=config.NavigationTable(sources=("nmea2000",)))
    faults = Faults(nodes_of(boat, 1), 1)
    (compass,) = faults.nodes.compasses
    for kind, name, value in (
        ("heading_jumping", "jump_rad", math.radians(50.0)),
        ("compass_cable", "cable_rad_per_a", math.radians(6.0)),
        ("gyro_drift", "drift_radps2", math.radians(1.0) / 60.0),
    ):
        faults.begin(fault(kind), 0.0)
        assert getattr(compass, name) == pytest.approx(value)
        faults.end(kind)
        assert getattr(compass, name) == 0.0


def test_a_full_disk_says_so_at_once_and_a_hanging_one_after_a_while(world):
    kept = []
    log = NoLog()
    log.write = lambda state, now_s: kept.append(now_s)  # type: ignore[method-assign]
    faulty = FaultyLog(log, world.faults)
    state = State()
    faulty.write(state, 0.0)
    world.begin("disk_full")
    faulty.write(state, 1.0)
    assert faulty.reason() == "no space left on device"
    world.faults.end("disk_full")
    world.begin("disk_slow")
    for now_s in range(2, 10):
        faulty.write(state, float(now_s))
        assert bool(faulty.reason()) is (now_s - 1 > 5.0)
    world.faults.end("disk_slow")
    assert faulty.reason() == ""
    faulty.write(state, 10.0)
    assert kept == [0.0, 10.0]
    assert faulty.dropped == 9


def test_a_lost_guest_is_not_heard_and_comes_back(world):
    guest, heard = FaultyGuest(State(), ManualClock(5.0), world.faults), list[bytes]()
    guest.on_line = heard.append
    world.begin("guest_lost")
    guest.data_received(b'{"heading_deg": 1}\n')
    assert heard == []
    world.faults.end("guest_lost")
    guest.data_received(b'{"heading_deg": 2}\n')
    assert heard == [b'{"heading_deg": 2}']


def test_in_lock_step_everything_around_breaks_too():
    run = Lockstep(SETTINGS, 1, lambda clock: NoLog())
    list(run.cycles(5.0))
    assert run.command(console.Heading(0.0, 1.0)) is None
    for kind in sorted({*ABOARD, "clock_stepped"} - {"restarted"}):
        run.breaks(fault(kind))
    run.guest_says(b'{"heading_deg": 1}')
    list(run.cycles(8.0))
    assert run.state.guest_s < 0, "the guest is not there"
    assert run.elapsed_s - run.state.console_s > 7.0, "nor is the operator"
    assert run.clock.time_ns() == 1_262_304_000_000_000_000 + 73_000_000_000, "13 s passed, and 60 were skipped"
    assert "log" in {notice.name for notice in run.state.notices}
    assert run.state.mode is Mode.HEADING


def test_what_came_late_is_not_kept_for_later():
    """The loop takes one message at a time; when a delay ends, all that waited are taken, and the newest is the present."""
    run = Lockstep(SETTINGS, 1, lambda clock: NoLog())
    list(run.cycles(4.0))
    run.breaks(fault("frames_late", "", 0.7, 3.0))
    list(run.cycles(8.0))
    assert run.state.navigation is not None
    assert run.clock.time_ns() - run.state.navigation.utc_ns == pytest.approx(0.2e9, abs=1e6), "of the last cycle"


def test_running_nodes_break_by_command(tmp_path: Path):
    vehicle = Path(__file__).parents[2] / "etc/delfimx.toml"
    overrides = [f'can.interface="canloop:{tmp_path.name[-20:]}"', f'runtime.run_directory="{tmp_path}"']
    words = [word for override in overrides for word in ("--set", override)]
    boat = config.load(vehicle, overrides)
    place = fault_socket.place(boat, fault_socket.NODES)
    with pytest.raises(DelfimError, match="is one running"):
        fault_socket.tell(boat, "bus_off")
    nodes = subprocess.Popen([sys.executable, "-m", "delfim", "nodes", str(vehicle), *words])
    try:
        until(lambda: Path(place).exists())
        assert fault_socket.tell(boat, "thruster_dead", "port", None, 4.0) == "thruster_dead port for 4 s"
        assert fault_socket.tell(boat, "frames_late", "", 0.1) == "frames_late until it is ended"
        assert fault_socket.tell(boat, "clock_stepped") == "clock_stepped until it is ended"
        with pytest.raises(Refused, match="needs one of"):
            fault_socket.tell(boat, "thruster_dead")
        with pytest.raises(DelfimError, match="is one running"):
            fault_socket.tell(boat, "disk_full")
        for nonsense in (
            b"",
            b"\xff",
            b"[]",
            b"{}",
            b'{"kind": 3}',
            b'{"kind": "bus_off", "colour": 1}',
            b'{"kind": "disk_full"}',
            json.dumps("x").encode(),
        ):
            assert not answered(place, nonsense)["ok"]
        assert fault_socket.tell(boat, "end").startswith("all faults ended")
        asked = subprocess.run(
            [sys.executable, "-m", "delfim", "fault", "--for", "2", *words, str(vehicle), "sensor_bad", "gps"],
            capture_output=True,
            text=True,
            timeout=200,
            check=True,
        )
        assert asked.stdout == "delfim: sensor_bad gps for 2 s\n"
    finally:
        nodes.terminate()
        assert nodes.wait(200) == 0
    assert not Path(place).exists()


def until(happened) -> None:
    import time

    limit = time.monotonic() + 200
    while not happened():
        assert time.monotonic() < limit


def answered(place: str, data: bytes) -> dict[str, object]:
    import socket

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        asking.bind("")
        asking.settimeout(200.0)
        asking.sendto(data, place)
        answer: dict[str, object] = json.loads(asking.recv(4096))
        return answer


def test_every_kind_has_its_documentation():
    page = (Path(__file__).parents[2] / "docs/scenarios.md").read_text()
    assert [kind for kind in KINDS if f"`{kind}`" not in page] == []
    assert set(VALUES) | set(WHERE) | set(OF_THRUSTERS) | ABOARD <= set(KINDS)
