"""A short day at sea for tests: the real loop in lock step, with its state log, its commands and its black box on disk."""

from pathlib import Path

import pytest

from delfim import config
from delfim.base.clock import ManualClock
from delfim.canproxy.socket import ANYTHING
from delfim.logging import blackbox, linelog
from delfim.logging.ashore.tree import LogFile, files
from delfim.logging.blackbox import BlackBox
from delfim.logging.linelog import LineLog
from delfim.logging.openlog import open_log
from delfim.simulator.line import LockstepLine
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.log.logbook import Logbook

ROOT = Path(__file__).parents[2]
MISSION = (ROOT / "etc/missions/doca.toml").read_text()


class Day:
    """A boat that logs. `cut` ends it as a power cut does: no last words."""

    def __init__(self, place: Path, *overrides: str) -> None:
        more = ['log.state_method="zwrite"', f'log.directory="{place}"', "log.free_bytes_min=0"]
        more += ['can.interface="canloop:lockstep"', *overrides]
        self.settings = config.load(ROOT / "etc/delfimx.toml", more)
        self.sailing = Lockstep(self.settings, 1, self._opened)
        self.clock = self.sailing.clock
        self.sockets = [bus.socket("logger") for bus in self.sailing.buses.values()]
        for each in self.sockets:
            each.bind(ANYTHING)
        with pytest.MonkeyPatch.context() as patch:  # files of the clock of the simulation need no child
            patch.setattr(blackbox, "open_log", lambda *words, **more: open_log(*words[:3], "zwrite", *words[4:], **more))
            self.box = BlackBox(self.sockets, self.settings.log, self.clock)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(linelog, "open_log", lambda *words: open_log(*words[:3], "zwrite", words[4]))
            self.lines = [self._heard(name, line) for name, line in self.sailing.lines.items()]

    def _heard(self, name: str, line: LockstepLine) -> LineLog:
        """The black box of a line, as the service of the vehicle has it."""
        log, put = LineLog(name, self.settings.log, self.clock), line.put

        def heard(data: bytes) -> None:
            log.heard(self.clock.time_ns(), data)
            put(data)

        line.put = heard
        return log

    def _opened(self, clock: ManualClock) -> Logbook:
        self.log = Logbook(self.settings, clock)
        return self.log

    def command(self, command: console.Commands) -> str | None:
        self.clock.advance(0.01)
        refused = self.sailing.command(command)
        self.clock.advance(0.01)  # at sea no two things happen in the same nanosecond
        self.log.command(command, refused, self.sailing.state)
        self.boxed()
        return refused

    def boxed(self) -> None:
        for each in self.sockets:
            while self.box.on_readable(each):
                pass
        for line in self.lines:
            line.write()

    def sail(self, seconds: float) -> None:
        for state in self.sailing.cycles(seconds):
            self.log.watch(state)
            self.boxed()
            self.box.poll()
            self.log.poll()

    def end(self) -> None:
        self.clock.advance(0.01)
        self.sailing.vehicle.helm.stop("shutdown")
        self.boxed()
        for line in self.lines:
            line.close()
        self.log.close()
        self.box.close()


def sailed(place: Path, *overrides: str) -> Day:
    """A refused start, a mission, a heading, manual thrust, a stop; half a minute of each."""
    day = Day(place, *overrides)
    assert day.command(console.Play()) is not None
    day.sail(5.0)
    for commands in (
        [console.LoadMission(MISSION), console.Play()],
        [console.Heading(200.0, 1.2)],
        [console.Manual(0.5, 0.25)],
        [console.Stop()],
    ):
        for command in commands:
            assert day.command(command) is None
        day.sail(15.0)
    return day


def logged(place: Path) -> list[LogFile]:
    return files([place])
