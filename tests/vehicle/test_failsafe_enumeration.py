"""What reaches the propellers, for every mode, armed or not, thrust before, age and value of navigation, and trouble: always
finite, within value and rate, and zero when it must be.

The vehicle is whole; navigation is handed to it as no bus could carry it (NaN, infinities), and every frame that it sends is
taken apart again.
"""

import math
from collections.abc import Callable
from importlib import import_module
from itertools import pairwise, product
from pkgutil import resolve_name
from typing import Any, Literal, NamedTuple

import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.cooperative import Sliced
from delfim.base.modes import Mode
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, GpsStatus, Navigation, PropellerStatus, Status
from delfim.canproxy.socket import ANYTHING, CanSocket
from delfim.parts.dsor.driver import Propellers
from delfim.parts.dsor.table import Dsor
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle import console
from delfim.vehicle.build import triggers
from delfim.vehicle.failsafe.troubles import TURNING, Trigger
from delfim.vehicle.grex import Guest
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.navigation.fixes import Fix
from delfim.vehicle.plans import fence
from delfim.vehicle.propulsion.actuators import Actuator
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.report import HandsetReport
from delfim.vehicle.state import Actuation, Line, NoLog, Plan, State, ThrusterReport, TrialPieces, Waypoint
from delfim.vehicle.target import Danger, Traffic

SECONDS, NAVIGATION_S = 1.6, 0.2
HERE = Navigation(0, 0.675, -0.16, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 3, 9, 0.9, 0)
PLAN = Plan("", (Waypoint(50.0, 0.0, 1.5, 5.0), Waypoint(50.0, 50.0, 1.5, 5.0)), (Line(0.0, 0.0, 50.0, 0.0, 1.5),))
RPM_MAX = Dsor().rpm_max
SETTINGS = config.Vehicle(
    boat=config.BoatTable(name="test"),
    handset=config.HandsetTable(device="/dev/receiver"),
    failsafe=config.Failsafe(
        pause_s=0.3,
        navigation_frozen=config.NavigationFrozen(after_s=0.5),
        console_silent=config.ConsoleSilent(after_s=0.5),
        manual_silent=config.ManualSilent(after_s=0.5),
        guest_silent=config.GuestSilent(after_s=0.5),
        battery_low=config.BatteryLow(after_s=0.2),
        battery_critical=config.BatteryCritical(after_s=0.2),
        thruster=config.ThrusterAstray(after_s=0.5),
        log=config.LogNotWritable(after_s=0.2),
        gnss_poor=config.GnssPoor(after_s=0.2),
        shallow=config.Shallow(min_depth_m=1.0, after_s=0.2),
        capsized=config.Capsized(after_s=0.2),
        beyond=config.Beyond(above={"bilge.leak": 0.5}, after_s=0.2, action="hold"),
        handset_silent=config.HandsetSilent(after_s=0.5),
        fence_left=config.FenceLeft(after_s=0.2),
    ),
)


class Value(NamedTuple):
    """A change of the navigation message, and what is missing then; `wild` makes no sense in any mode."""

    change: dict[str, float | None]
    missing: str = ""
    wild: bool = False


VALUES = {
    "good": Value({}),
    "latitude nan": Value({"latitude_rad": math.nan}, wild=True),
    "longitude inf": Value({"longitude_rad": math.inf}, wild=True),
    "latitude huge": Value({"latitude_rad": 1e300}, wild=True),
    "heading nan": Value({"heading_rad": math.nan}, wild=True),
    "heading huge": Value({"heading_rad": 1e30}, wild=True),
    "yaw rate inf": Value({"yaw_rate_radps": -math.inf}, wild=True),
    "speed nan": Value({"north_mps": math.nan}, wild=True),
    "speed huge": Value({"east_mps": 1e9}, wild=True),
    "no position": Value({"latitude_rad": None, "longitude_rad": None}, "position"),
    "no heading": Value({"heading_rad": None}, "heading"),
    "no velocity": Value({"north_mps": None, "east_mps": None}, "velocity"),
}
AGES_S = (0.0, 0.8, 1.2, 1.6)  # of the last navigation message at the end
UNTOLD = {  # by values and ages; a battery is critical here; pulses have no outlet here
    *(Trigger.CONTROL, Trigger.NAVIGATION_SILENT, Trigger.BATTERY_LOW, Trigger.OUTLET, Trigger.STUCK),
}
OF_PARTS = triggers(SETTINGS)
TROUBLES = ("none", *(trigger.name.lower() for trigger in (*Trigger, *OF_PARTS) if trigger not in UNTOLD))
AHEAD = config.Zones(keep_out=(config.Area(centre=((math.degrees(0.675) + 1e-4, math.degrees(-0.16)),), radius_m=10.0),))
BEHIND = config.Zones(keep_in=(config.Area(centre=((math.degrees(0.675) - 5e-4, math.degrees(-0.16)),), radius_m=10.0),))
NEEDS = {mode: import_module(f"delfim.vehicle.control.modes.{mode.name.lower()}").NEEDS for mode in Mode}


def once(make: Callable[..., Any]) -> Callable[..., Any]:
    """The same, made once for each vehicle's file."""
    made = dict[int, tuple[config.Vehicle, Any]]()

    def found(settings: config.Vehicle, *more: object) -> Any:
        if id(settings) not in made:
            made[id(settings)] = settings, make(settings, *more)
        return made[id(settings)][1]

    return found


@pytest.fixture(autouse=True)
def quick_boats(monkeypatch: pytest.MonkeyPatch) -> None:
    """What follows from the file alone is half of the work of a boat, and a boat is made for each case."""
    monkeypatch.setitem(globals(), "triggers", once(triggers))
    for name in ("delfim.vehicle.helm.helm.filled", "delfim.vehicle.failsafe.failsafe.Rules"):
        monkeypatch.setattr(name, once(resolve_name(name)))  # by name: with an import this is a test about them (bench.mutants)


class Sensors:
    """A navigation input that says anything."""

    name, heard_s = "test", 0.0

    def __init__(self, socket: CanSocket) -> None:
        self.socket, self.says, self.frozen, self.jump_rad, self.heel_rad = socket, HERE, False, 0.0, 0.0

    def read(self, now_s: float) -> Fix:
        said = self.says
        self.says = said._replace(
            counter=said.counter + 1,
            roll_rad=said.roll_rad if self.frozen else self.heel_rad + 0.01 * (said.counter % 2),
        )
        if self.jump_rad and said.latitude_rad is not None:
            return Fix(self.says._replace(latitude_rad=said.latitude_rad + self.jump_rad), 0, now_s)
        return Fix(self.says, 0, now_s)

    def rehearse(self, last: Navigation) -> None: ...


TRIAL = TrialPieces(1, ((900.0, (0.7, 0.7)),), 0.0, 0.0, 1e5, 99.0)


class Boat:
    """A vehicle in a mode, its propellers at some thrust already, and the list of all it sends."""

    settings = SETTINGS

    def __init__(self, mode: Mode, rpm: float, *, armed: bool = True) -> None:
        self.clock = ManualClock()
        bus = LockstepBus(self.clock)
        self.world = bus.socket("world")
        self.world.bind(ANYTHING)
        self.state, self.source, self.log = State(), Sensors(bus.socket()), NoLog()
        outlet, guest = bus.socket(), Guest(self.state, self.clock)
        propulsion = Propulsion((self.open(outlet),), outlet, self.settings.thrusters, self.state)
        source, settings = self.source, self.settings
        self.vehicle = VehicleLoop(
            settings, self.clock, self.state, (source,), propulsion, guest, self.log, troubles=triggers(settings)
        )
        self.report("none")
        self.vehicle.on_navigation(self.source)
        state = self.state
        state.setpoint = state.setpoint._replace(
            plan=PLAN,
            guest_heading_rad=0.5,
            guest_speed_mps=1.0,
            speed_mps=1.5,
            track=((-20.0, 0.0),),
            starboard=0.7,
            port=0.7,
            trial=TRIAL,
        )
        state.console_s = state.manual_s = state.guest_s = 0.0
        self.vehicle.helm.enter(mode, "test")
        state.armed = armed
        propulsion._sent = state.actuation = Actuation((rpm / RPM_MAX, -rpm / RPM_MAX), (0.0, 0.0), rpm != 0.0)
        self.told: set[str] = set()
        self.sent: list[tuple[float, float, float]] = []
        self.hear(0.0)
        self.sent = [(0.0, rpm, -rpm)]

    def open(self, outlet: CanSocket) -> Actuator:
        return Propellers(self.settings, outlet)

    def report(self, trouble: str) -> None:
        """All nodes, as if they had spoken just now."""
        now_s, well = self.clock.monotonic_s(), (Status.GOOD, Fault(0))
        gps = (Status.BAD, Fault.HARDWARE) if trouble == "sensor_bad" else well
        charge = 0.05 if trouble == "battery_critical" else 0.9
        starboard, port = self.turn(now_s, trouble)
        self.state.sysstat = {
            "gps": (GpsStatus(*gps, 3, 9, 0.9, 0), now_s),
            "propeller_starboard": (PropellerStatus(*well, round(starboard), 1.0, 20, 0), now_s),
            "propeller_port": (PropellerStatus(*well, round(port), 1.0, 20, 0), now_s),
            "batteries_starboard": (BatteriesStatus(*well, 48.0, 1.0, 0.9, 20), now_s),
            "batteries_port": (BatteriesStatus(*well, 48.0, 1.0, charge, 20), now_s),
        }

    def turn(self, now_s: float, trouble: str) -> tuple[float, float]:
        """The thrusters report their revolutions, which are these."""
        starboard, port = (RPM_MAX * part for part in self.state.actuation.thrust)
        starboard -= 1000.0 if trouble == "thruster" else 0.0
        self.state.thrusters = {"starboard": ThrusterReport(now_s, starboard), "port": ThrusterReport(now_s, port)}
        return starboard, port

    def pass_time(self, age_s: float, trouble: str) -> None:
        """SECONDS of cycles, watchdogs and words, without navigation for the last `age_s`."""
        ticks = round(SECONDS * 10)
        self.log.why = "disk full" if trouble == "log" else ""
        self.source.frozen, self.source.jump_rad = (
            trouble == "navigation_frozen",
            1e-3 if trouble == "navigation_jumping" else 0.0,
        )
        if trouble == "gnss_poor":
            self.source.says = self.source.says._replace(satellites=3)
        if trouble == "navigation_twice":
            self.state.twice.extend([self.clock.monotonic_s()] * 3)
        if trouble == "shallow":
            self.state.measured["depth_m"] = 0.5, self.clock.monotonic_s()
        if trouble == "capsized":
            self.source.heel_rad = 3.0
        if trouble == "beyond":
            self.state.measured["bilge.leak"] = 1.0, self.clock.monotonic_s()
        if trouble in ("traffic", "traffic_close"):
            level: Literal["near", "danger"] = "near" if trouble == "traffic" else "danger"
            self.state.traffic = Traffic(dangers=(Danger("1", 40.0, 90.0, 0.5, level, f"MARIA: {level}"),))
        if trouble == "ais_silent":
            self.state.traffic = Traffic(heard_s=self.clock.monotonic_s() - 200.0)
        if trouble == "traffic_unclear":
            self.state.traffic = Traffic(unjudged="13 vessels in the way")
        if trouble == "restarted":
            self.state.restarted = "it was in play; hold now"
        if trouble in ("fence", "fence_left"):
            zones = AHEAD if trouble == "fence" else BEHIND
            self.vehicle.helm.plans.fence = Sliced(fence.survey(self.settings.fence, zones, self.state.origin)).finish()
        for tick in range(1, ticks + 1):
            self.clock.advance(0.1)
            now_s = self.clock.monotonic_s()
            self.report(trouble)
            if trouble != "console_silent":
                self.vehicle.on_command(console.Alive())
            self.state.handset = HandsetReport(
                0.0 if trouble == "handset_silent" else now_s, 0.0, 0.0, takes=False, kills=False
            )
            if trouble == "kill" and tick == 2:
                self.vehicle.on_command(console.Kill())
            self.state.manual_s = 0.0 if trouble == "manual_silent" else now_s
            self.state.guest_s = 0.0 if trouble == "guest_silent" else now_s
            if tick % 2 == 0 and tick <= ticks - round(age_s * 10):
                self.vehicle.on_navigation(self.source)
            self.vehicle.on_watchdog()
            self.told |= {notice.name for notice in self.state.notices}
            self.hear(now_s)

    def hear(self, now_s: float) -> None:
        newest: dict[int, float] = {}
        while (frame := self.world.receive()) is not None:
            if frame.arb in (messages.PROPELLER_STARBOARD, messages.PROPELLER_PORT):
                command = messages.unpack_propeller_command(frame.data)
                assert command.run or command.rpm == 0, "motor off says zero, too"
                newest[frame.arb] = command.rpm
        if newest:
            self.sent.append((now_s, newest[messages.PROPELLER_STARBOARD], newest[messages.PROPELLER_PORT]))


def must_be_zero(mode: Mode, age_s: float, value: Value, trouble: str) -> bool:
    """By the rules of docs/failsafe.md, in the words of this test."""
    lacks = value.missing in NEEDS[mode]
    held = {
        "console_silent": mode not in (Mode.MANUAL, Mode.HOME),
        "guest_silent": mode is Mode.GREX,
        "shallow": mode not in (Mode.MANUAL, Mode.HOME),
        "beyond": mode not in (Mode.MANUAL, Mode.HOME),
        "fence": mode is not Mode.MANUAL or value.missing != "position",
    }.get(trouble, False)
    stops = {
        "navigation_jumping": value.missing != "position",
        "sensor_bad": True,
        "kill": True,
        "capsized": True,
        "manual_silent": mode is Mode.MANUAL,
        "fence_left": mode is not Mode.MANUAL or value.missing != "position",  # by hand outwards: it holds, and is stopped
        "console_silent": mode is Mode.MANUAL,
        "battery_critical": mode not in (Mode.MANUAL, Mode.HOME),
        "thruster": mode is not Mode.MANUAL,
        "navigation_twice": mode is not Mode.MANUAL,
    }.get(trouble, False)
    return mode is Mode.IDLE or age_s > 1.0 or value.wild or lacks or stops or (held and value.missing != "")


CASES = [(age_s, name) for age_s, name in product(AGES_S, VALUES) if age_s == 0.0 or name == "good"]


MODES = [pytest.param(Mode.IDLE, False, id="IDLE, disarmed"), *(pytest.param(mode, True, id=mode.name) for mode in Mode)]


@pytest.mark.parametrize(("mode", "armed"), MODES)
@pytest.mark.parametrize("rpm", [0.0, 900.0], ids=["at rest", "under way"])
def test_the_propellers_get_what_they_may_get(mode, armed, rpm):
    for (age_s, name), trouble in product(CASES, TROUBLES):
        case = f"navigation {name}, {age_s} s old, trouble {trouble}"
        boat = Boat(mode, rpm, armed=armed)
        boat.source.says = boat.source.says._replace(**VALUES[name].change)
        boat.pass_time(age_s, trouble)
        for (before_s, *before), (after_s, *after) in pairwise(boat.sent):
            for old, new in zip(before, after, strict=True):
                assert abs(new) <= RPM_MAX, case
                change = RPM_MAX * SETTINGS.thrusters[0].rate_per_s * (after_s - before_s) + 1.0  # rounded twice
                assert abs(new - old) <= change or new == 0, f"{case}: {old} to {new} rpm in {after_s - before_s:.1f} s"
        if must_be_zero(mode, age_s, VALUES[name], trouble):
            assert boat.sent[-1][1:] == (0, 0), case
            if mode is not Mode.IDLE and age_s > 1.0:
                assert boat.state.mode is Mode.IDLE, case
        if trouble == "navigation_frozen":
            assert max(map(abs, boat.sent[-1][1:])) <= TURNING * RPM_MAX, f"{case}: propellers turn"
        assert boat.state.armed or boat.state.mode is Mode.IDLE, case
        if boat.state.mode is not mode:
            assert boat.state.reason != "test", f"{case}: a reason is stated"


@pytest.mark.parametrize("trouble", TROUBLES[1:])
def test_each_trouble_is_the_one_that_is_meant(trouble):
    boat = Boat({"manual_silent": Mode.MANUAL, "guest_silent": Mode.GREX}.get(trouble, Mode.HEADING), 900.0)
    boat.pass_time(0.0, trouble)
    assert trouble in boat.told


def test_the_test_can_fail():
    """A healthy boat under way is not at zero: the propellers are listened to."""
    boat = Boat(Mode.HEADING, 900.0)
    boat.pass_time(0.0, "none")
    assert max(map(abs, boat.sent[-1][1:])) > 100
    assert not must_be_zero(Mode.HEADING, 0.0, VALUES["good"], "none")
