"""A boat whose receiver babbles: it is read in small pieces, sails on, and its logs repeat the run to the bit."""

import os
import select
import tty
from pathlib import Path
from random import Random

import pytest

from delfim.base.input.ratelimit import PIECE_BYTES, Allowance
from delfim.canproxy.dsor.messages import Navigation
from delfim.canproxy.socket import ANYTHING
from delfim.lines.nmea0183.speaking import gga, hdt, rmc
from delfim.lines.serialline import SerialLine
from delfim.logging import blackbox, linelog
from delfim.logging.blackbox import BlackBox
from delfim.logging.linelog import LineLog, pieces
from delfim.logging.openlog import open_log
from delfim.parts.dsor.driver import Propellers
from delfim.simulator.lockstepbus import LockstepBus
from delfim.simulator.replay.rerun import rerun
from delfim.vehicle import console
from delfim.vehicle.grex import Guest
from delfim.vehicle.links import Links
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.navigation.estimated import between
from delfim.vehicle.navigation.fixes import open_sources
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.state import State
from tests.logging.sailing import Day, logged

ALLOWED = 10_000  # bytes a second, so that a flood takes no second of the test's own
PERIOD_S = 0.2
NAMES = ("gnss", "compass")


class Reading:
    """The clock of a line: a read is later than the call that reads; on a busy machine each seventh of them much later."""

    def __init__(self, clock, held_s: float) -> None:
        self._clock, self._held_s, self._reads = clock, held_s, 0

    def time_ns(self) -> int:
        self._reads += 1
        self._clock.advance(0.00002 if self._reads % 7 else self._held_s)
        return self._clock.time_ns()


class Boat:
    """The loop on two ptys, with its logs."""

    def __init__(self, place: Path, *more: str, held_s: float = 0.00002) -> None:
        self._held_s = held_s
        self._ends, devices = dict[str, int](), dict[str, str]()
        self._handles = list[int]()
        for name in NAMES:
            self._ends[name], near = os.openpty()
            tty.setraw(near)
            devices[name] = os.ttyname(near)
            self._handles += [self._ends[name], near]
        ports = [f'nmea0183.ports.{name}.device="{device}"' for name, device in devices.items()]
        own = ['navigation.sources=["nmea0183"]', "navigation.stale_s=2.5", "sysstat.required=[]"]
        own.append("failsafe.stuck.after_s=3600")  # she is led along a line, whatever her motors do
        self.day = day = Day(place / "log", *own, *ports, *more)
        settings, self.clock, self.state = day.settings, day.clock, State()
        self.lines, self._logs, self.said = dict[str, SerialLine](), list[LineLog](), dict.fromkeys(NAMES, 0)
        self._taken = dict.fromkeys(NAMES, 0)
        with pytest.MonkeyPatch.context() as patch:  # files of the clock of the test need no child
            for module in (blackbox, linelog):
                patch.setattr(module, "open_log", lambda *words, **more: open_log(*words[:3], "zwrite", *words[4:], **more))
            sources = open_sources(settings, Links(lambda *_: pytest.fail("no bus"), self._line), self.state)
            wire = LockstepBus(self.clock, "lockstep")
            self._box_end, motors = wire.socket("box"), wire.socket()
            self._box_end.bind(ANYTHING)
            self._box = BlackBox([self._box_end], settings.log, self.clock)
        (self.source,) = between(sources, settings, self.state) if settings.navigation.estimator else sources
        outlet = Propulsion((Propellers(settings, motors),), motors, settings.thrusters, self.state)
        guest = Guest(self.state, self.clock)
        self.loop = VehicleLoop(settings, self.clock, self.state, (self.source,), outlet, guest, day.log)

    def _line(self, device: str, baud: int, form: str = "8N1") -> SerialLine:
        log, name = LineLog(device, self.day.settings.log, self.clock), NAMES[len(self.lines)]
        self._logs.append(log)

        def heard(t_ns: int, data: bytes) -> None:
            log.heard(t_ns, data)
            self._taken[name] += len(data)

        self.lines[name] = SerialLine(
            device, baud, Reading(self.clock, self._held_s), heard, allowance=Allowance(ALLOWED, self.clock.monotonic_s)
        )
        return self.lines[name]

    def hear(self, name: str, data: bytes) -> None:
        """What a device says, until the loop has read it."""
        self.said[name] += os.write(self._ends[name], data)
        while any(self._unread(each) for each in NAMES):
            assert select.select([self.source.input], [], [], 60.0)[0]
            self.clock.advance(0.00005)
            self.loop.on_navigation(self.source)
            self._box.on_readable(self._box_end)

    def _unread(self, name: str) -> int:
        return self.said[name] - self._taken[name] - self.lines[name].allowance.bytes

    def sail(self, cycle: int, babble: bytes, step: int) -> None:
        """A fifth of a second; what the receiver babbles stands before its sentences and behind them."""
        east = cycle * 1e-7
        n = Navigation(
            1_795_000_000_000_000_000 + cycle * 200_000_000,
            0.675,
            -0.16 + east,
            0.0,
            1.0,
            1.57 + cycle * 0.001,
            None,
            None,
            None,
            3,
            9,
            1.0,
            0,
        )
        self.hear("compass", hdt(n))
        for at in range(0, len(babble), step):
            self.hear("gnss", babble[at : at + step])
        self.hear("gnss", gga(n) + rmc(n))
        self.clock.advance(PERIOD_S)
        if cycle % 5 == 0:
            self.loop.on_command(console.Alive())
            for each in self.lines.values():
                each.rebind()
        for log in self._logs:
            log.write()
        self.loop.on_watchdog()
        self.day.log.watch(self.state)
        self.clock.advance(0.0001)
        self._box.on_readable(self._box_end)

    def command(self, command: console.Commands) -> None:
        refused = self.loop.on_command(command)
        self.day.log.command(command, refused, self.state)
        assert refused is None
        self.clock.advance(0.001)
        self._box.on_readable(self._box_end)

    def end(self) -> None:
        self.loop.helm.stop("shutdown")
        self._box.on_readable(self._box_end)
        for each in (*self._logs, self.day.log, self._box, *self.lines.values()):
            each.close()
        for handle in self._handles:
            os.close(handle)


@pytest.mark.parametrize("estimator", ["false", "true"])
def test_a_boat_whose_receiver_babbles_sails_on_and_is_repeated_to_the_bit(tmp_path, estimator):
    random, dirt = Random(1), (b"$\n", b"$GPHDT\n", b"$GPGSV,1,1,00*79\r\n", b"\xb5\x62\x01\x07\xff\xff")
    boat = Boat(tmp_path, f"navigation.estimator={estimator}")
    for cycle in range(20):
        boat.sail(cycle, b"", 1)
    boat.command(console.Heading(45.0, 1.0))
    for cycle in range(20, 100):
        babble = random.choice(dirt) * 1500
        boat.sail(cycle, babble[: (0, 300, 3000)[cycle % 3]], random.choice((100, 700, 2000)))
    state = boat.state
    dropped = boat.lines["gnss"].allowance.bytes
    assert state.mode.name == "HEADING", state.reason
    assert dropped > 5000
    boat.end()
    told = list(pieces(file for file in logged(tmp_path / "log") if file.suffix.startswith(".jsonl") and "pts" in file.id))
    assert max(len(piece.data) for piece in told) == PIECE_BYTES
    result = rerun([file for file in logged(tmp_path / "log") if file.id in ("state", "lockstep") or "pts" in file.id], None)
    assert result.exact, result.text()
    assert result.cycles > 50


@pytest.mark.parametrize("estimator", ["false", "true"])
def test_a_line_that_a_busy_machine_reads_late_is_repeated_to_the_bit(tmp_path, estimator):
    """The cycle begins before the stamp of the message that makes it, by as long as the program was held up between."""
    boat = Boat(tmp_path, f"navigation.estimator={estimator}", held_s=0.073)
    for cycle in range(20):
        boat.sail(cycle, b"", 1)
    boat.command(console.Heading(45.0, 1.0))
    for cycle in range(20, 60):
        boat.sail(cycle, b"", 1)
    assert boat.state.mode.name == "HEADING", boat.state.reason
    boat.end()
    result = rerun([file for file in logged(tmp_path / "log") if file.id in ("state", "lockstep") or "pts" in file.id], None)
    assert result.exact, result.text()
    assert result.cycles > 30
