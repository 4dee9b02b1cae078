"""Simulated instruments of NMEA 0183: what they say, read by pynmea2; their ends of the lines; the boat that sails by them."""

import array
import fcntl
import math
import os
import select
import socket
import termios
from collections.abc import Callable
from pathlib import Path

import msgspec
import pynmea2
import pytest

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.errors import ConfigError, FormatError
from delfim.base.modes import Mode
from delfim.lines.networkline import NetworkLine
from delfim.lines.serialline import SerialLine
from delfim.parts.nmea0183.table import Nmea0183, Nmea0183Port
from delfim.simulator.faults import fault
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.nodes import Nodes, nodes_of
from delfim.simulator.realtime.instrument_lines import InstrumentLines
from delfim.simulator.tables import Sea, Simulation
from delfim.simulator.workspace import settings_of, workspace
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
NOON_NS = 1_795_348_800_200_000_000  # 2026-11-22 12:00:00.2 UTC
PORTS = {"gnss": Nmea0183Port(device="/dev/gnss"), "compass": Nmea0183Port(device="/dev/compass")}

WINDY = Simulation(sea=Sea(wind_mps=6.0, wind_from_deg=90.0, gusts=0.0))
APART = msgspec.structs.replace(WINDY, instruments=("gnss:receiver", "compass:compass", "compass:gyro"))


def vehicle(
    simulation: Simulation = WINDY, ports: dict[str, Nmea0183Port] = PORTS, run: Path = Path("/run/delfim")
) -> config.Vehicle:
    """A boat that navigates by its instruments."""
    return config.Vehicle(
        boat=config.BoatTable(name="tried"),
        navigation=config.NavigationTable(sources=("nmea0183",), rate_hz=10.0, estimator=True),
        sensors=config.Sensors(names=("sysstat", "nmea0183")),
        nmea0183=Nmea0183(ports=ports, variation_deg=-1.4),
        runtime=config.RuntimeTable(run_directory=str(run)),
        simulation=simulation,
    )


def said(nodes: Nodes, now_s: float) -> dict[str, list[str]]:
    """The sentences of an instant, by port."""
    assert nodes.instruments is not None
    found = dict[str, list[str]]()
    for port, data in nodes.instruments.step(now_s, NOON_NS):
        found.setdefault(port, []).extend(data.decode().split("\r\n")[:-1])
    return found


def test_each_instrument_says_the_truth_in_sentences_that_pynmea2_reads():
    nodes = nodes_of(vehicle(msgspec.structs.replace(WINDY, noise=False, heading_deg=30.0)), 1)
    model = nodes.model
    model.command("starboard", 600.0, True)
    model.command("port", 900.0, True)
    for drive in model.drives.values():
        drive.connected = True
    for _ in range(50):
        model.advance(0.1)
    read = {each[3:6]: pynmea2.parse(each, check=True) for each in said(nodes, 5.0)["gnss"]}
    assert set(read) == {"GGA", "RMC", "GST", "HDG", "ROT", "DPT", "MWV"}
    for name in ("GGA", "RMC"):
        assert read[name].latitude == pytest.approx(math.degrees(model.latitude_rad), abs=1e-7)
        assert read[name].longitude == pytest.approx(math.degrees(model.longitude_rad), abs=1e-7)
        assert read[name].timestamp.isoformat(timespec="milliseconds") == "12:00:00.200+00:00"
    speed_mps = math.hypot(model.north_mps, model.east_mps)
    assert speed_mps > 0.3
    assert read["RMC"].spd_over_grnd * 1852 / 3600 == pytest.approx(speed_mps, abs=1e-3)
    course_deg = math.degrees(math.atan2(model.east_mps, model.north_mps)) % 360.0
    assert read["RMC"].true_course == pytest.approx(course_deg, abs=0.01)
    heading_deg = math.degrees(model.heading_rad) % 360.0
    assert (float(read["HDG"].heading) - 1.4) % 360.0 == pytest.approx(heading_deg, abs=0.051)
    assert float(read["ROT"].rate_of_turn) == pytest.approx(math.degrees(model.yaw_rate_radps) * 60.0, abs=0.051)
    assert float(read["DPT"].depth) == 12.0
    wind = read["MWV"]
    assert (wind.reference, wind.wind_speed_units, wind.status) == ("R", "M", "A")
    to_deg = heading_deg + float(wind.wind_angle) + 180.0  # the air moves there, seen from the boat
    speed = float(wind.wind_speed)
    assert speed * math.cos(math.radians(to_deg)) + model.north_mps == pytest.approx(0.0, abs=0.1)
    assert speed * math.sin(math.radians(to_deg)) + model.east_mps == pytest.approx(-6.0, abs=0.1)


def test_the_file_says_where_an_instrument_is_and_how_often_it_speaks():
    nodes = nodes_of(vehicle(msgspec.structs.replace(APART, receiver_hz=2.0, compass_hz=5.0, gyro=False)), 1)
    counts = dict[str, int]()
    for instant in range(100):
        for port, sentences in said(nodes, instant / 10.0).items():
            counts[port] = counts.get(port, 0) + len(sentences)
    assert counts == {"gnss": 3 * 20, "compass": 50}
    with pytest.raises(ConfigError, match="there is no port mast in nmea0183"):
        config.load(ROOT / "etc/sensors.toml", ['simulation.instruments=["mast:wind"]'])
    with pytest.raises(ConfigError, match="PORT:INSTRUMENT, one of receiver, compass, gyro, sounder, wind"):
        config.load(ROOT / "etc/sensors.toml", ['simulation.instruments=["gnss:radar"]'])


def test_the_same_seed_says_the_same_and_another_one_does_not():
    def words(seed: int) -> list[object]:
        nodes = nodes_of(vehicle(APART), seed)
        return [said(nodes, instant / 10.0) for instant in range(20)]

    assert words(1) == words(1)
    assert words(1) != words(2)


ENDS = {  # a fault, and why the boat stops
    "silent receiver": (("navigation_silent", "receiver"), "position silent for 1."),
    "silent compass": (("navigation_silent", "compass"), "heading silent for 1."),
    "frozen receiver": (("navigation_frozen", "receiver"), "position frozen for 3."),
    "frozen compass": (("navigation_frozen", "compass"), "heading frozen for 3."),
    "jump": (("navigation_jumping", ""), "position jumped by 40 m"),
}


@pytest.mark.parametrize("name", ENDS)
def test_a_fault_by_command_breaks_the_instrument_and_the_boat_says_which(name):
    broken, reason = ENDS[name]
    run = Lockstep(vehicle(APART), 1, lambda clock: NoLog())
    list(run.cycles(5.0))
    assert run.command(console.Heading(3.0, 1.5)) is None
    list(run.cycles(20.0))
    assert run.state.mode is Mode.HEADING, run.state.reason
    run.breaks(fault(*broken))
    assert run.command(console.Heading(120.0, 1.5)) is None  # straight ahead, a gyro is no witness against the compass
    list(run.cycles(5.0))
    assert run.state.reason.startswith(reason), run.state.reason
    run.faults.end(*broken)
    list(run.cycles(5.0))
    assert run.command(console.Heading(3.0, 1.5)) is None


def test_few_satellites_are_told_and_a_part_that_is_not_there_is_refused():
    run = Lockstep(vehicle(), 1, lambda clock: NoLog())
    run.breaks(fault("gnss_poor", "", 5.0))
    list(run.cycles(3.0))
    assert run.state.navigation is not None
    assert run.state.navigation.satellites == 5
    assert run.state.measured["depth_m"][0] == pytest.approx(12.0, rel=0.1)
    with pytest.raises(FormatError, match="takes receiver, compass or no place: 'mast'"):
        fault("navigation_silent", "mast")
    with pytest.raises(FormatError, match="this boat has no compass"):
        Lockstep(config.load(ROOT / "etc/delfimx.toml"), 1, lambda clock: NoLog()).breaks(fault("navigation_silent", "compass"))


def spoken(settings: config.Vehicle, line: SerialLine | NetworkLine, say: Callable[[InstrumentLines], None]) -> bytes:
    """What the boat reads at its end, said until it does."""
    with InstrumentLines(settings, ("only",)) as lines:
        for _ in range(200):
            line.rebind()
            say(lines)
            select.select([line], [], [], 0.05)
            if data := line.read():
                return data
    raise AssertionError(line.trouble)


def free_port(device: str) -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if device.startswith("udp") else socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        number: int = probe.getsockname()[1]
        return number


@pytest.mark.parametrize("device", ["nmea0183-only", "udp:127.0.0.1:PORT", "tcp:127.0.0.1:PORT", "tcp-listen:127.0.0.1:PORT"])
def test_the_boat_hears_its_instruments_over_any_kind_of_line(device, tmp_path):
    device = device.replace("PORT", str(free_port(device))).replace("nmea0183-only", f"{tmp_path}/nmea0183-only")
    settings = vehicle(WINDY, {"only": Nmea0183Port(device=device)}, tmp_path)
    now_s = iter(range(1000))
    clock = SystemClock()
    line = (
        NetworkLine(device, ("127.0.0.0/8",), clock)
        if device.startswith(("udp:", "tcp-listen:"))
        else SerialLine(device, 4800, clock, may_lack=True)
    )
    try:
        data = spoken(settings, line, lambda lines: lines.say("only", b"$SDDPT,7.5,0.3,*63\r\n", float(next(now_s))))
    finally:
        line.close()
    assert data.startswith(b"$SDDPT,7.5,0.3,*63\r\n")
    assert not (tmp_path / "nmea0183-only").exists()


def unread(port: int) -> int:
    count = array.array("i", [0])
    fcntl.ioctl(port, termios.FIONREAD, count)
    return count[0]


def test_a_pty_that_nobody_reads_keeps_no_old_positions(tmp_path):
    device = f"{tmp_path}/nmea0183-only"
    with InstrumentLines(vehicle(WINDY, {"only": Nmea0183Port(device=device)}, tmp_path), ("only",)) as lines:
        port = os.open(device, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        for number in range(1500):
            before = unread(port)
            lines.say("only", b"%05d\n" % number, 0.0)
            while unread(port) == before:  # the kernel hands the bytes over in its own time
                os.sched_yield()
        heard = os.read(port, 1 << 16)
        os.close(port)
    assert int(heard.split(b"\n")[0]) > 1000
    assert heard.endswith(b"01499\n")


def test_real_ports_and_networks_are_left_alone(tmp_path, monkeypatch):
    """`delfim sim` moves each port to its own folder or to this computer; without it, nothing is played."""
    real = {
        "gnss": Nmea0183Port(device="/dev/gnss"),
        "hub": Nmea0183Port(device="gpsd:192.168.7.20:2947"),
        "mast": Nmea0183Port(device="udp:0.0.0.0:10110"),
    }
    with InstrumentLines(vehicle(WINDY, real, tmp_path), tuple(real)) as lines:
        for name in real:
            lines.say(name, b"nothing", 0.0)
    monkeypatch.chdir(tmp_path)
    with workspace(None) as its:
        told = settings_of(vehicle(WINDY, real), its, ("nmea0183.ports.mast.device",)).overrides
    overrides = dict(each.split("=", 1) for each in told)
    assert overrides["nmea0183.ports.gnss.device"] == f'"{its.folder.resolve()}/nmea0183-gnss"'
    assert overrides["nmea0183.ports.hub.device"].startswith('"tcp:127.0.0.1:29')
    assert "nmea0183.ports.mast.device" not in overrides
