"""What one fixed state becomes: MAVLink, /api/state, Prometheus, NMEA 0183 and NMEA 2000. No control and no sea is in it."""

import math
from collections.abc import Iterator
from random import Random
from typing import Any, Final, get_args

import msgspec

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.frames import Frame, identifier
from delfim.base.geodesy import origin
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, GpsStatus, Navigation, Node, PropellerStatus, Status
from delfim.canproxy.nmea2000.device import FIRST
from delfim.lines.forms import Form
from delfim.lines.nmea0183.speaking import SPEAKERS
from delfim.parts.mavlink.codec.wire import Address
from delfim.parts.mavlink.station import Station
from delfim.parts.mavlink.telemetry import PROFILES
from delfim.parts.nmea2000.nmea2000d import BoatDevice
from delfim.parts.nmea2000.table import ToldName
from delfim.services.page import api
from delfim.services.page.metrics import metrics
from delfim.simulator.line import LockstepLine
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle import console
from delfim.vehicle.build import build
from delfim.vehicle.failsafe.nodehealth import NAMES
from delfim.vehicle.links import Links
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.report import Announced, BoatReport, ClockStatus, HandsetReport, LogFacts, Service
from delfim.vehicle.snapshot import in_json
from delfim.vehicle.state import Actuation, Motion, NoLog, Notice, Profile, Reference, StartConditions, State, ThrusterReport
from delfim.vehicle.target import CourseOrder, Danger, Target, Traffic
from tests.canproxy.pgn_of import pgn_of
from tests.oracles.keeping import Lines
from tests.oracles.voyages import DELFIMX, ROOT
from tests.parts.mavlink.mavlink_console import Console, Radio, messages

UTC_NS: Final = 1_795_348_800_500_000_000
NOW_S: Final = 1000.0
WELL: Final = Status.GOOD, Fault(0)
PLACE: Final = 0.675123456, -0.160876543  # rad
OVERRIDES: Final = (
    'sensors.names=["sysstat","nmea2000"]',
    'nmea2000.interface="can1"',
    f"nmea2000.send={list(get_args(ToldName))}".replace("'", '"'),
    "nmea2000.unique_number=77",
)
MEASURED: Final = {
    "depth_m": 12.34,
    "depth_offset_m": 0.3,
    "water_c": 16.5,
    "wind_true_rad": 0.5,
    "wind_true_mps": 6.25,
    "wind_apparent_rad": -0.75,
    "wind_apparent_mps": 7.5,
    "speed_water_mps": 1.125,
}
FERRY: Final = Target(
    "244660123", "MARIA", 400.0, -250.0, 1.25, 4.5, 1.2, 110.0, 15.0, True, 12.0, 4.0, False, "A", 0
)  # fmt: skip
YACHT: Final = Target(
    "boat 3", "boat 3", -80.0, 60.0, 3.0, 0.0, math.nan, 12.0, 4.0, False, 3.0, 1.0, True, "fleet", 15
)  # fmt: skip
SEEN: Final = (
    msgspec.Raw(b'{"key": "244660123", "name": "MARIA", "latitude_deg": 38.685, "longitude_deg": -9.22, "speed_mps": 4.5}'),
)


class FixedBoat:
    """The vehicle's loop around a state that nothing changes."""

    def __init__(self, *overrides: str) -> None:
        self.settings = config.load(DELFIMX, [*OVERRIDES, *overrides])
        self.clock = ManualClock(NOW_S, UTC_NS)
        self._buses = dict[str, LockstepBus]()
        self.state = State()
        self.vehicle: VehicleLoop = build(self.settings, self.clock, self.state, Links(self._bus, self._line), NoLog()).vehicle
        mission = (ROOT / "etc/missions/doca.toml").read_text()
        self.state.origin = origin(*PLACE)
        assert self.vehicle.on_command(console.LoadMission(mission)) is None
        _fill(self.state)
        for i in range(40):
            stamps_us = 0, 9, 14, 21, 30 + i, 80 + i
            self.vehicle.latency.add(Profile(*(UTC_NS + 1000 * each for each in stamps_us)))

    def _bus(self, name: str, filters: tuple[Any, ...]) -> Any:
        return self._buses.setdefault(name, LockstepBus(self.clock, name)).bound(*filters)

    def _line(self, device: str, baud: int, form: Form = "8N1") -> LockstepLine:
        return LockstepLine(self.clock)

    @property
    def snapshot(self) -> bytes:
        """As the local command socket tells it."""
        log = LogFacts(file="a log", bytes=3061, records=18, dropped=2)
        service = {"vehicle": {"state": "running", "place": "runtime", "for_s": 5.5, "busy_s": 0.25, "over_budget": 3}}
        more = msgspec.convert(service, dict[str, Service])
        return in_json(self.vehicle.report(boat=self.settings.boat.name, log=log, services=more))

    @property
    def told(self) -> BoatReport:
        """The same, as other programs read it."""
        return msgspec.json.decode(self.snapshot, type=BoatReport)


def _fill(state: State) -> None:
    north_mps, east_mps = 1.125, -0.625
    state.mode, state.reason, state.mode_s, state.armed = Mode.PLAY, "operator", 900.0, True
    state.has_left_idle, state.operator, state.source = True, "console 255", "dsor"
    state.navigation = Navigation(
        UTC_NS, *PLACE, north_mps, east_mps, 5.6789, -0.1234, 0.0712, -0.0345, 6, 11, 0.9, 17, 0.014, 1.5
    )  # fmt: skip
    state.navigation_s = state.changed_s = NOW_S - 0.125
    state.motion = Motion(frozenset({"position", "heading", "velocity"}), 12.5, -7.25, 5.6789, -0.1234, north_mps, east_mps)
    state.reference = Reference(5.5, 1.5, -0.75, 28.5, 31.0, 14.0, 3, False, "", 5.4)
    state.setpoint = state.setpoint._replace(speed_mps=1.5, override_mps=1.25, leg=3)
    state.actuation = Actuation((0.625, -0.375), (0.0, 0.0), True)
    state.thrusters = {
        "starboard": ThrusterReport(NOW_S - 0.1, 750.0, 5.5, 49.5, 31.0),
        "port": ThrusterReport(NOW_S - 0.2, -450.0, 3.25, 48.75, 29.0, None, ("overheated",), "it waits for its contactor"),
    }
    state.sysstat = {
        NAMES[Node.GPS]: (GpsStatus(*WELL, 6, 11, 0.9, UTC_NS), NOW_S - 0.3),
        NAMES[Node.PROPELLER_STARBOARD]: (PropellerStatus(*WELL, 750, 5.5, 31, 1), NOW_S - 0.4),
        NAMES[Node.PROPELLER_PORT]: (PropellerStatus(Status.BAD, Fault(1), -450, 3.25, 29, 1), NOW_S - 0.4),
        NAMES[Node.BATTERIES_STARBOARD]: (BatteriesStatus(*WELL, 49.5, 5.5, 0.875, 21), NOW_S - 0.5),
        NAMES[Node.BATTERIES_PORT]: (BatteriesStatus(*WELL, 48.75, 3.25, 0.25, 22), NOW_S - 0.6),
    }
    state.measured = {name: (value, NOW_S - 0.5) for name, value in MEASURED.items()}
    state.console_s, state.guest_s, state.watchdog_s, state.guest_connected = NOW_S - 0.7, NOW_S - 0.8, NOW_S - 0.05, True
    state.handset = HandsetReport(NOW_S - 0.9, 0.5, -0.25, False, False, "", 97)
    state.notices = (
        Notice("battery_low", "batteries port at 25 %", NOW_S - 30.0, "home"),
        Notice("fence", "4 m ahead", NOW_S - 2.0, "warn"),
    )
    state.announced = (Announced(1, 183, (1.0, 1500.0, None, None, None, None, None)),)
    state.computer = StartConditions(False, "", "", ClockStatus("this program keeps it", "dsor", 0.0125, "", True))
    state.cycles, state.counts = 4321, {"navigation_jumps": 3, "guest_malformed": 1}
    order = CourseOrder(0.25, 0.5, 0.75, "keeping clear of MARIA", FERRY.key, 1.375, NOW_S - 3.0)
    dangers = Danger(FERRY.key, 35.0, 120.0, 0.625, "danger", "crossing"), Danger(YACHT.key, 55.0, -4.0, 2.5, "none")
    state.traffic = Traffic(
        (YACHT, FERRY), NOW_S - 0.1, NOW_S - 4.0, NOW_S - 6.0, (("too far", 2),), "", order, dangers, "on", 0.625, "", told=SEEN
    )  # fmt: skip


def telemetry() -> Lines:
    """One round of every message, by profile of the link: its fields, and the frames. Those by radio come by WiFi, too."""
    found = {profile: list(_round(profile)) for profile in PROFILES}
    found["radio"] = [line.split()[0] for line in found["radio"] if line not in found["wifi"] and not line.startswith("frames")]
    return found


def _round(profile: str) -> Iterator[str]:
    boat, radio = FixedBoat(f'mavlink.profile="{profile}"'), Radio()
    vehicle = boat.vehicle

    def obey(command: console.Commands, operator: str) -> str | None:
        return None

    station = Station(vehicle, obey, radio, None)
    Console(station, radio).beat()
    radio.sent.clear()
    station.tick()
    station.tick()  # vessels come in turn
    sent: list[tuple[bytes, Address]] = radio.sent
    for data, _ in sent:
        for message in messages([data]):
            fields = " ".join(f"{name}={_shown(getattr(message, name))}" for name in message.fieldnames)
            yield f"{message.get_type()} {fields}"
        yield f"frames: {data.hex()}"


def _shown(value: object) -> str:
    return repr(value).replace(" ", "")


def web() -> Lines:
    """/api/state and /metrics; of the local command socket what the page has not."""
    boat = FixedBoat()
    told = boat.told
    report = api.Report(UTC_NS, told, "", {}, _COMPUTER, 0.5, api.Server(2, 1000, 3))
    tree = msgspec.json.decode(msgspec.json.encode(report))
    page = list(_leaves("", tree))
    socket = [line for line in _leaves("vehicle", msgspec.json.decode(boat.snapshot)) if line not in page]
    return {"/api/state": page, "command socket": socket, "/metrics": metrics(report).splitlines()}


_COMPUTER: Final = api.Computer(
    uptime_s=5000.0,
    cpu=(0.25, 0.5),
    load=(0.5, 0.25, 0.125),
    memory=api.Memory(2_000_000, 500_000),
    temperature_c=51.5,
    disk=api.Disk("a disk", 8_000_000, 6_000_000, 86_400.0),
    networks={"eth0": api.Network(True, ("10.0.0.2",), 1000, 2000, 10.5, 20.5, 1, 2)},
    buses={"can0": api.Bus("ERROR-ACTIVE", 1_000_000, 120.5, 0.0625, 5000, 1, 2, 3, 4, 5)},
    supervisor={"runtime": Service("running", "process", 5.5, 1, "dead-man", 17)},
)


def _leaves(path: str, tree: object) -> Iterator[str]:
    """Each value under its path."""
    if isinstance(tree, dict | list) and tree:
        for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
            yield from _leaves(f"{path}.{key}" if path else str(key), value)
    else:
        yield f"{path} = {tree!r}"


class _Taking:
    """A bus that takes everything."""

    def __init__(self) -> None:
        self.sent = list[tuple[int, bytes]]()

    def sendto(self, data: bytes, address: Any) -> None:
        self.sent.append((address.arb, data))

    def receive(self) -> Frame | None:
        return None


def instruments() -> Lines:
    """NMEA 0183 by sentence; NMEA 2000, each message as it comes first, after the claim of an address."""
    boat, bus = FixedBoat(), _Taking()
    navigation = boat.state.navigation
    assert navigation is not None
    sentences = {name: [repr(speak(navigation).decode())] for name, speak in SPEAKERS.items()}
    speaker = BoatDevice(bus, boat.settings, boat.clock, FIRST, Random(1))
    told = boat.told
    for _ in range(20):
        boat.clock.advance(0.05)
        speaker.tick()
    claims = list(_messages(bus))
    speaker.heard(told)
    speaker.tick()
    return sentences | {"claim of an address": claims, "NMEA 2000": list(_messages(bus))}


def _messages(bus: _Taking) -> Iterator[str]:
    for arb, data in bus.sent:
        yield f"PGN {pgn_of(arb)[1]}: {identifier(arb):08x} {data.hex()}"
    bus.sent.clear()
