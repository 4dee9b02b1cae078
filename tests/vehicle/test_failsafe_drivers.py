"""What is on the wire of each driver at the end, for every mode, armed or not, age and value of navigation, and trouble: its
stop where the table of docs/failsafe.md says stop, otherwise the command of the control.

As in test_failsafe_enumeration.py the vehicle is whole. Its motors are played: they hear the driver's bytes, report by its
wire, and fail as their kind can.
"""

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Final, NamedTuple, Protocol, get_args

import msgspec
import pytest

from delfim import config
from delfim.base.frames import Frame
from delfim.base.modes import Mode
from delfim.base.pulses import unpack_command
from delfim.canproxy.dronecan.datatypes import ARMING_STATUS, ESC_STATUS, RAW_COMMAND
from delfim.canproxy.dronecan.fields import pack, unpack
from delfim.canproxy.dronecan.transfers import Publisher, TransferReceiver
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import unpack_propeller_command
from delfim.canproxy.socket import ANYTHING, CanSocket
from delfim.lines.nmea0183.framing import framed
from delfim.parts.dsor.driver import Propellers
from delfim.parts.frontseats.table import MavlinkFrontSeat
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle.failsafe.troubles import TURNING
from delfim.vehicle.links import Links
from delfim.vehicle.propulsion.actuators import Actuator, open_actuator
from tests.vehicle import test_failsafe_enumeration as enumeration
from tests.vehicle.test_drivers import PwmDevice, Px4Device, RoverDevice, SeatDevice, VescDevice, Wire, greet, settings
from tests.vehicle.test_failsafe_enumeration import AGES_S, MODES, TROUBLES, VALUES, must_be_zero, quick_boats

__all__ = ["quick_boats"]

SLIP_RPM: Final = 1000.0  # missing of a motor that does not turn as commanded
FAILSAFE: Final = msgspec.structs.replace(
    enumeration.SETTINGS.failsafe,
    thruster=config.ThrusterAstray(after_s=0.3),
    navigation_frozen=config.NavigationFrozen(after_s=0.9),  # not before the ages that are allowed
)
UNDER_WAY: Final = 0.75  # of full command, one side ahead and the other astern


class Motors(Protocol):
    """The far end of a driver's wire."""

    def efforts(self, now_s: float) -> tuple[float, float]: ...  # of starboard and port, as mounted
    def report(self, now_s: float) -> None: ...


class DsorMotors:
    """The propellers of DelfimX. What they report comes by the sensor `sysstat`, and is in the state already."""

    def __init__(self, bus: CanSocket, wire: Wire) -> None:
        self._bus, self._told = bus, dict[int, float]()

    def efforts(self, now_s: float) -> tuple[float, float]:
        while (frame := self._bus.receive()) is not None:
            if frame.arb in (messages.PROPELLER_STARBOARD, messages.PROPELLER_PORT):
                self._told[frame.arb] = unpack_propeller_command(frame.data).rpm / 1200.0
        return self._told[messages.PROPELLER_STARBOARD], self._told[messages.PROPELLER_PORT]

    def report(self, now_s: float) -> None:
        pass


class DronecanMotors:
    """Two controllers: they turn while they are armed and hear commands."""

    def __init__(self, bus: CanSocket, wire: Wire) -> None:
        self._bus, self.slip_rpm = bus, 0.0
        self._receiver = TransferReceiver((ARMING_STATUS, RAW_COMMAND))
        self._says = Publisher(ESC_STATUS, 20, 20)
        self._armed, self._heard_s, self._told = False, -1e9, (0.0, 0.0)

    def efforts(self, now_s: float) -> tuple[float, float]:
        while (frame := self._bus.receive()) is not None:
            if (transfer := self._receiver.feed(frame, now_s)) is None:
                continue
            if transfer.type == ARMING_STATUS.id:
                self._armed = unpack(ARMING_STATUS, transfer.payload)[0] == (255,)
            else:
                starboard, port = (each / 8191.0 for each in unpack(RAW_COMMAND, transfer.payload)[1])
                self._told, self._heard_s = (starboard, port), now_s
        return self._told if self._armed and now_s - self._heard_s <= 0.2 else (0.0, 0.0)

    def report(self, now_s: float) -> None:
        starboard, port = self.efforts(now_s)
        for index, rpm in enumerate((1500.0 * starboard - self.slip_rpm, 1500.0 * port)):
            for arb, data in self._says.frames(pack(ESC_STATUS, (0, 24.0, 3.0, 300.0, round(rpm), 50, index))):
                self._bus.sendmsg(Frame(arb, data))


def slip(motors: DronecanMotors) -> None:
    motors.slip_rpm = SLIP_RPM


def slip_vesc(motors: VescDevice) -> None:
    motors.played[0].slip_rpm = SLIP_RPM


def slip_otter(motors: SeatDevice) -> None:
    motors.played.slip_rpm = SLIP_RPM


def disarm(motors: RoverDevice) -> None:
    motors.played.armed = False


def jam(motors: PwmDevice) -> None:
    motors.trouble = "Remote I/O error"


def silence(motors: Motors) -> None:
    motors.report = lambda now_s: None


class Known(NamedTuple):
    """How a driver is tried."""

    motors: Callable[[CanSocket, Wire], Motors]
    stop: Callable[[list[Frame], list[bytes]], bool]  # of all that was on its wire: what says stop at the end, or nothing
    faults: tuple[Callable[..., None] | None, ...]  # of the thrusters, as its motors can fail; None: as the state already says
    speaks_first: bool = True  # before the first command, too


def dsor_stop(frames: list[Frame], said: list[bytes]) -> bool:
    last = [[f.data[:3] for f in frames if f.arb == arb][-1] for arb in (messages.PROPELLER_STARBOARD, messages.PROPELLER_PORT)]
    return last == [b"\0\0\0"] * 2


def dronecan_stop(frames: list[Frame], said: list[bytes]) -> bool:
    """Zero for both, and not armed."""
    receiver, last = TransferReceiver((ARMING_STATUS, RAW_COMMAND)), dict[int, bytes]()
    for frame in frames:
        if (transfer := receiver.feed(frame, 0.0)) is not None:
            last[transfer.type] = transfer.payload
    return unpack(RAW_COMMAND, last[RAW_COMMAND.id])[1] == (0, 0) and last.get(ARMING_STATUS.id, b"\0") == b"\0"


def vesc_stop(frames: list[Frame], said: list[bytes]) -> bool:
    """Duty 0 to each."""
    last = {frame.identifier & 0xFF: (frame.identifier >> 8, frame.data) for frame in frames if frame.identifier >> 8 < 4}
    return last == {0: (0, bytes(4)), 1: (0, bytes(4))}


def says(stop: bytes) -> Callable[[list[Frame], list[bytes]], bool]:
    return lambda frames, said: said[-1] == stop


def px4_stop(frames: list[Frame], said: list[bytes]) -> bool:
    """The same; but the middle of its throttle is 500."""
    last = [each for each in said if each[7] == 69][-1]
    return last[10 : 10 + last[1]] == bytes(4) + b"\xf4\x01" + bytes(4) + b"\1"


def rover_stop(frames: list[Frame], said: list[bytes]) -> bool:
    """MANUAL_CONTROL, version 2 of the protocol, with all sticks in the middle: the zeros at its end are left out, and what
    remains is the target."""
    last = [each for each in said if each[7] == 69][-1]
    return last[10 : 10 + last[1]] == bytes(10) + b"\1"


def pwm_stop(frames: list[Frame], said: list[bytes]) -> bool:
    return not unpack_command(said[-1]).run


KNOWN: Final = {
    "dsor": Known(DsorMotors, dsor_stop, (None,)),
    "dronecan": Known(DronecanMotors, dronecan_stop, (slip, silence)),
    "vesc": Known(VescDevice, vesc_stop, (slip_vesc, silence)),
    "otter": Known(partial(SeatDevice, timeout_s=3.0), says(framed("PMARABT")), (slip_otter, silence), speaks_first=False),
    "heron": Known(partial(SeatDevice, timeout_s=None), says(framed("PYDIR,0.0,0.0")), (silence,), speaks_first=False),
    "mavlink_front_seat": Known(RoverDevice, rover_stop, (disarm, silence), speaks_first=False),
    "px4": Known(Px4Device, px4_stop, (disarm, silence)),
    "pwm": Known(PwmDevice, pwm_stop, (jam, silence)),
}


def boat_of(driver: str) -> config.Vehicle:
    tables = {"handset": enumeration.SETTINGS.handset, "failsafe": FAILSAFE, "sysstat": config.Sysstat(stale_s=1.0)}
    if driver == "px4":
        return settings("mavlink_front_seat", mavlink_front_seat=MavlinkFrontSeat(autopilot="px4"), **tables)
    return settings(driver, **tables)


SETTINGS: Final = {driver: boat_of(driver) for driver in KNOWN}


class Recorder(Wire):
    """A line that remembers all that was written to it."""

    def __init__(self) -> None:
        super().__init__()
        self.said = list[bytes]()

    def write(self, data: bytes) -> bool:
        self.said.append(data)
        return super().write(data)


class Boat(enumeration.Boat):
    """A vehicle with the motors of a driver, which are played."""

    def __init__(self, driver: str, mode: Mode, part: float, *, armed: bool, fault: Callable[..., None] | None = None) -> None:
        self.settings, self._known, self.wire = SETTINGS[driver], KNOWN[driver], Recorder()
        super().__init__(mode, part * enumeration.RPM_MAX, armed=armed)
        greet(self.actuator, self.motors)
        self.wire.said.clear()
        self.actuator.send(self.state.actuation, 0.0)
        if fault is not None:
            fault(self.motors)

    def open(self, outlet: CanSocket) -> Actuator:
        bus = LockstepBus(self.clock)
        self.tap, far = bus.socket("tap"), bus.socket("motors")
        self.tap.bind(ANYTHING)
        far.bind(ANYTHING)
        links = Links(lambda interface, filters: bus.bound(*filters), lambda device, baud: self.wire)
        self.actuator = open_actuator(self.settings.thrusters[0].driver, self.settings, links)
        self.motors = self._known.motors(far, self.wire)
        return self.actuator

    def turn(self, now_s: float, trouble: str) -> tuple[float, float]:
        if isinstance(self.actuator, Propellers):
            return super().turn(now_s, trouble)
        self.motors.report(now_s)
        for each in self.actuator.inputs:
            each.read(self.state, now_s)
        return 0.0, 0.0

    def hear(self, now_s: float) -> None:
        """The outlet's timer, and the motors."""
        if self.actuator.period_s is not None:
            self.vehicle.on_outlet(self.actuator)
        self.motors.efforts(now_s)

    def says_stop(self) -> bool:
        """What was said last is this driver's stop; or nothing was ever said to a front seat, which somebody else may drive."""
        frames = list[Frame]()
        while (frame := self.tap.receive()) is not None:
            frames.append(frame)
        if not frames and not self.wire.said:
            return not self._known.speaks_first
        return self._known.stop(frames, self.wire.said)


def check(boat: Boat, case: str, must_stop: bool) -> None:
    sent, efforts = boat.state.actuation, boat.motors.efforts(boat.clock.monotonic_s())
    assert sent.run is not must_stop, case
    if must_stop:
        assert boat.says_stop(), case
        assert efforts == (0.0, 0.0), case
    elif isinstance(boat.motors, RoverDevice) and not boat.motors.played.armed:
        assert efforts == (0.0, 0.0), case
    else:
        starboard, port = sent.thrust
        assert efforts == pytest.approx((starboard, -port), abs=2.5e-3), f"{case}: the port one is mounted the other way round"
        assert efforts == (0.0, 0.0) or not boat.says_stop(), case


LASTING = (
    "none",
    "thruster",
    "console_silent",
    "manual_silent",
    "guest_silent",
    "handset_silent",
)  # with stale navigation, too
CASES = [
    *product(AGES_S[:3], ("good",), LASTING),
    *((0.0, "good", trouble) for trouble in TROUBLES if trouble not in LASTING),
    *((0.0, name, "none") for name in VALUES if name != "good"),
]


@pytest.mark.parametrize(("mode", "armed"), MODES)
@pytest.mark.parametrize("driver", KNOWN)
def test_the_wire_says_what_the_table_says(driver, mode, armed):
    for age_s, name, trouble in CASES:
        for fault in KNOWN[driver].faults if trouble == "thruster" else (None,):
            boat = Boat(driver, mode, UNDER_WAY, armed=armed, fault=fault)
            boat.source.says = boat.source.says._replace(**VALUES[name].change)
            boat.pass_time(age_s, trouble)
            must_stop = must_be_zero(mode, age_s, VALUES[name], trouble) or (driver == "pwm" and fault is silence)
            if trouble == "navigation_frozen":  # a trouble while motors turn: a boat that rests needs no stop
                must_stop = must_stop or max(map(abs, boat.state.actuation.thrust)) > TURNING or not boat.state.actuation.run
            how = f"{trouble} ({fault.__name__})" if fault else trouble
            check(boat, f"navigation {name}, {age_s} s old, trouble {how}", must_stop)


@pytest.mark.parametrize("driver", KNOWN)
def test_a_boat_at_rest_starts_and_stops_on_the_wire(driver):
    boat = Boat(driver, Mode.HEADING, 0.0, armed=True)
    assert boat.says_stop()
    boat.pass_time(0.0, "none")
    check(boat, "healthy", must_stop=False)
    assert max(map(abs, boat.motors.efforts(boat.clock.monotonic_s()))) > 0.1, "the motors are listened to"
    boat.pass_time(0.0, "kill")
    check(boat, "killed", must_stop=True)


def test_every_driver_is_tried():
    elsewhere = {
        "torqeedo",
        "torqlink",
    }  # a line or bus for each motor, not one for both: their stops are in tests/parts/torqeedo
    assert set(KNOWN) - {"px4"} | elsewhere == set(get_args(config.DriverName)), (
        "and a board with PX4 beside one with ArduRover"
    )
