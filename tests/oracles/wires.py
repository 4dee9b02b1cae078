"""What drivers write to their devices, and what is on the buses and lines of each boat: frame by frame.

A driver on a bench is told to drive, to repeat, to stop, and is stopped by the dead-man; its played device answers. A boat is
driven by hand, so that no gain of control is in it.
"""

from collections.abc import Callable, Iterator
from typing import Final

import msgspec

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.frames import Frame, extended
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket
from delfim.lines.forms import Form
from delfim.parts.dronecan.table import Dronecan
from delfim.parts.torqeedo.table import TorqeedoPort, TorqeedoTable, TorqlinkPort, TorqlinkTable
from delfim.simulator.line import LockstepLine
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.lockstepbus import LockstepBus
from delfim.vehicle import console
from delfim.vehicle.links import Links
from delfim.vehicle.propulsion.actuators import open_actuator
from delfim.vehicle.state import Actuation, NoLog, State
from tests.oracles.keeping import Lines
from tests.oracles.voyages import DELFIMX, ROOT
from tests.vehicle.played_devices import PlayedTorqlink
from tests.vehicle.test_drivers import AHEAD, DRIVERS, OFF, Device, Wire, greet, settings

TURNED: Final = Actuation((0.5, -0.25), (0.3, -0.2), True)
DRIVEN_S: Final = 6.0
RESTS: Final = 200  # commands before the first that is kept: counters have their highest bit


class Silent:
    """No device: what is sent is all there is."""

    def efforts(self, now_s: float) -> tuple[float, float]:
        return 0.0, 0.0

    def report(self, now_s: float) -> None:
        pass


def _turning() -> config.Vehicle:
    """A boat whose thrusters turn."""
    boat = settings("dronecan")
    rows = zip(boat.thrusters, (4, 5), strict=True)
    steered = [msgspec.structs.replace(row, steer=config.Steer(kind="azimuth", address=address)) for row, address in rows]
    return msgspec.structs.replace(boat, thrusters=tuple(steered), dronecan=Dronecan(command="rpm"))


class Ready(Silent):
    """Torqeedo motors on TorqLink, which say all the time that they are ready: both on one bus here, which no boat has. What
    they say is not kept."""

    def __init__(self, bench: "DriverBench", bus: CanSocket) -> None:
        self._bench, self._bus, self._send = bench, bus, bench.driver.send
        bench.driver.send = self._awake  # type: ignore[method-assign]

    def _awake(self, sent: Actuation, now_s: float) -> int:
        word, data = PlayedTorqlink().status()
        for tenths in range(-30, 1):
            self._bus.sendto(data, CanAddress(extended(word)))
            for each in self._bench.driver.inputs:
                each.read(State(), now_s + 0.1 * tenths)
        while self._bench.heard.receive() is not None:
            pass
        return self._send(sent, now_s)


def _torqlink() -> config.Vehicle:
    ports = {name: TorqlinkPort(interface=f"canloop:{name}") for name in ("starboard", "port")}
    return settings("torqlink", torqlink=TorqlinkTable(ports=ports))


def _torqeedo() -> config.Vehicle:
    ports = {name: TorqeedoPort(device=f"/dev/{name}") for name in ("starboard", "port")}
    return settings("torqeedo", torqeedo=TorqeedoTable(ports=ports))


BENCHES: Final = {name: known.settings for name, known in DRIVERS.items()} | {
    "dsor": settings("dsor"),
    "dronecan": settings("dronecan"),
    "dronecan, rpm, steered": _turning(),
    "torqeedo": _torqeedo(),
    "torqlink": _torqlink(),
}


def drivers() -> Lines:
    """By driver."""
    return {name: list(DriverBench(name, boat).lines()) for name, boat in BENCHES.items()}


class DriverBench:
    """A driver, and what listens to it."""

    def __init__(self, name: str, boat: config.Vehicle) -> None:
        self._bus, self._wire = LockstepBus(ManualClock()), Wire()
        self.heard = self._bus.bound(ANYTHING)
        self._turns = any(row.steer for row in boat.thrusters)
        self.driver = open_actuator(boat.thrusters[0].driver, boat, Links(self._open, self._line))
        self._device: Device | Silent = Silent()
        if name == "torqlink":
            self._device = Ready(self, self._bus.bound(computer="device"))
        if name in DRIVERS:
            self._device = DRIVERS[name].device(self._bus.bound(ANYTHING, computer="device"), self._wire)

    def _open(self, name: str, filters: tuple[CanAddress, ...]) -> CanSocket:
        return self._bus.bound(*filters)

    def _line(self, device: str, baud: int, form: Form = "8N1") -> Wire:
        return self._wire

    def lines(self) -> Iterator[str]:
        driver = self.driver
        greet(driver, self._device)
        for _ in range(RESTS):
            driver.send(OFF, 0.5)
            self._sent()
        for what, sent in (("drive", TURNED if self._turns else AHEAD), ("rest", OFF)):
            for more, at_s in (("", 1.0), (", 0.2 s later", 1.2)):
                assert driver.send(sent, at_s) == 0
                yield from (f"{what}{more}: {each}" for each in self._sent())
            assert driver.repeat(1.3) == 0
            yield from (f"{what}, repeated: {each}" for each in self._sent())
            yield from self._report(what)
        driver.send(AHEAD, 2.0)
        driver.send(AHEAD, 2.2)
        self._sent()
        driver.stop()
        yield from (f"stop: {each}" for each in self._sent())
        driver.disconnect(("starboard",))
        driver.send(AHEAD, 3.0)
        yield from (f"starboard disconnected: {each}" for each in self._sent())

    def _sent(self) -> list[str]:
        """What the device hears now."""
        told = [_shown(data) for data in self._wire.written]
        while (frame := self.heard.receive()) is not None:
            told.append(_shown(frame))
        self._device.efforts(1.3)
        self._wire.written.clear()
        return told

    def _report(self, what: str) -> Iterator[str]:
        state = State()
        self._device.report(1.3)
        yield from (f"{what}, device: {_shown(data)}" for data in self._wire.waiting)
        yield from (f"{what}, device: {each}" for each in self._sent())
        for each in self.driver.inputs:
            each.read(state, 1.3)
        for name, report in state.thrusters.items():
            known = (f"{field}={value!r}" for field, value in report._asdict().items() if value)
            yield f"{what}, report of {name}: {' '.join(known)}"


def boats() -> Lines:
    """By boat: one cycle under way by hand, and the stop after it."""
    files = [*sorted(ROOT.glob("etc/boats/*.toml")), DELFIMX]
    return {str(file.relative_to(ROOT)): list(_wires(config.load(file))) for file in files}


def _wires(boat: config.Vehicle) -> Iterator[str]:
    run = Lockstep(boat, 1, lambda clock: NoLog())
    heard_lines = dict[str, list[bytes]]()
    unused = set() if "dsor" in (*boat.drivers, *boat.navigation.sources) else {boat.can.interface}
    heard = {name: bus.bound(ANYTHING) for name, bus in run.buses.items() if name not in unused}
    for device, line in run.lines.items():
        line.put = _noting(line, heard_lines.setdefault(device, []))  # type: ignore[method-assign]
    by_hand = console.Manual(0.5, 0.25)
    for _ in run.cycles(DRIVEN_S):
        run.command(by_hand)
    for what in ("cycle", "stop"):
        for end in heard.values():
            while end.receive() is not None:
                pass
        for device, line in run.lines.items():
            line.written.clear()
            heard_lines[device].clear()
        if what == "stop":
            run.command(console.Stop())
        run.cycle()
        for name, end in heard.items():
            while (frame := end.receive()) is not None:
                yield f"{what}, {name}, {'boat' if frame.sent_here else 'device'}: {_shown(frame)}"
        for device, line in run.lines.items():
            yield from (f"{what}, {device}, device: {_shown(data)}" for data in heard_lines[device])
            yield from (f"{what}, {device}, boat: {_shown(data)}" for data in line.written)
    run.close()


def _noting(line: LockstepLine, noted: list[bytes]) -> Callable[[bytes], None]:
    """What the devices say is noted, too."""
    put = line.put

    def say(data: bytes) -> None:
        noted.append(data)
        put(data)

    return say


def _shown(each: bytes | Frame) -> str:
    """A frame as identifier and data; text as it is, other bytes in hexadecimal."""
    if isinstance(each, Frame):
        return f"{each.arb:08x} {each.data.hex() or '-'}"
    text = each.decode("ascii", "replace")
    return repr(text) if text.replace("\r\n", "").isprintable() and "\ufffd" not in text else each.hex()
