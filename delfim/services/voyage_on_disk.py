"""Keeps the voyage on disk while the boat sails, and gives it back to the boat after a restart (docs/restart.md).

It lies beside the logs, where a power cut leaves it, and in the run directory, in memory on most boats, where a dead disk does.
A child writes both. The loop only puts the record together: at each change of what the operator sent or the boat does, and each
REFRESH_S under way for the track and the time.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Final

from delfim import config
from delfim.base.clock import Clock
from delfim.base.cooperative import Sliced
from delfim.base.errors import ConfigError, FormatError
from delfim.base.input.keys import read_key
from delfim.logging.kept.record import Keeper, newest
from delfim.logging.kept.writer import VOYAGE
from delfim.vehicle import console
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.operator.reviews import Reviews
from delfim.vehicle.orders import voyage
from delfim.vehicle.orders.returning import RESTART

REFRESH_S: Final = 5.0
BOOT_ID: Final = "/proc/sys/kernel/random/boot_id"

log = logging.getLogger(__name__)


class VoyageKeeping:
    """The kept voyage: `bring_back` once, before navigation is heard; then `look` ten times a second; `end` and `close` at the
    end."""

    def __init__(self, settings: config.Vehicle, clock: Clock, boat: VehicleLoop) -> None:
        self._settings, self._clock, self._boat = settings, clock, boat
        self._digest, self._boot = voyage.digest(settings), _boot()
        directories, key = (settings.runtime.run_directory, settings.log.directory), _key(settings)
        self._wrong, sequence = "", 0
        self._found: bytes | None = None
        try:
            sequence, self._found = newest(directories, VOYAGE, key)
        except FormatError as error:
            self._wrong = f"the record of the voyage before it is damaged, or not this boat's: {error}"
        self._keeper = Keeper(directories, VOYAGE, key, sequence)
        self._before: tuple[object, ...] = ()  # what was kept last
        self._kept_s = -1e9
        self._plan_of: tuple[object, object] = (None, boat.helm.plans.zones)  # mission and zones
        self._plan_line: bytes | None = b""  # of the record; None: it is being written

    def bring_back(self, obey: Callable[[console.Commands, str], str | None], reviews: Reviews) -> None:
        """Give the boat back what it was doing, and what the operator had sent: checked as when it came, in slices."""
        found = self._read()
        if found is None:
            return
        for command in (found.back, *found.sent):
            if isinstance(command, console.Plan):
                reviews.begin(RESTART, command, self._was_sent)
            elif (refused := obey(command, RESTART)) is not None:
                log.error("voyage: %s", refused)
        for words in (self._boat.state.restarted, self._boat.state.fence_lost):
            if words:
                log.warning("voyage: %s", words)

    def _read(self) -> voyage.KeptVoyage | None:
        if self._wrong:
            return voyage.refused(self._wrong)
        return voyage.read(self._found, self._settings, self._now()) if self._found is not None else None

    def _was_sent(self, refused: str | None) -> None:
        if refused is not None:
            log.error("voyage: the mission of before is not aboard: %s", refused)

    def look(self) -> None:
        """Keep what has changed, once the boat goes on with what was kept before."""
        self._keeper.poll()
        if self._boat.returning.is_pending:
            return
        helm, state = self._boat.helm, self._boat.state
        mission, zones = self._plan_of
        if helm.plans.mission is not mission or helm.plans.zones is not zones:
            self._write_plan()
        if self._plan_line is None:  # until then the record is that of the plan before
            return
        setpoint = state.setpoint
        now = (
            *(state.mode, helm.memory.leg, helm.paused, state.operator, state.helmsman, state.killed, state.has_left_idle),
            *(helm.plans.rally, len(helm.changed), tuple(helm.changed.values()), state.origin, self._plan_line),
            *(setpoint.target, setpoint.override_mps, setpoint.heading_rad, setpoint.speed_mps, setpoint.leg),
        )
        is_due = state.armed and self._clock.monotonic_s() - self._kept_s >= REFRESH_S
        if is_due or now != self._before:
            self._keep(now)

    def _write_plan(self) -> None:
        """Write the plan's line, which is long, in slices."""
        plans, self._plan_line = self._boat.helm.plans, None
        self._plan_of = plans.mission, plans.zones
        command = voyage.plan_command(self._boat.helm)
        if command is None:
            self._plan_line = b""
        else:
            self._write_on(self._plan_of, Sliced(console.written(command)))

    def _write_on(self, plan_of: tuple[object, object], work: Sliced[bytes]) -> None:
        if plan_of is not self._plan_of:  # a newer one came
            return
        if work.step():
            self._plan_line = work.result
        else:
            asyncio.get_running_loop().call_soon(self._write_on, plan_of, work)

    def end(self, in_order: bool) -> None:
        """Keep the end of the voyage. `in_order`: the program was asked to end, and the boat was stopped for that."""
        if in_order and self._boat.returning.is_pending and self._found is not None:
            self._keeper.put(voyage.ended(self._found))
        elif in_order and self._plan_line is not None:
            self._keep((), in_order=True)

    async def close(self) -> None:
        """Wait, not for long, until the disk has it."""
        await self._keeper.close()

    def _keep(self, now: tuple[object, ...], in_order: bool = False) -> None:
        kept = self._now(in_order)
        if self._keeper.put(voyage.text(kept, self._boat.helm, self._boat.state, self._plan_line or b"")):
            self._before, self._kept_s = now, kept.monotonic_s

    def _now(self, in_order: bool = False) -> voyage.KeptHead:
        clock = self._clock
        name = self._settings.boat.name
        return voyage.KeptHead(name, self._digest, self._boot, clock.time_ns(), clock.monotonic_s(), in_order)


def _boot() -> str:
    """The id of this run of the computer's kernel; empty: it is not known."""
    with contextlib.suppress(OSError):
        return Path(BOOT_ID).read_text().strip()
    return ""


def _key(settings: config.Vehicle) -> bytes:
    """The consoles' key, which also proves that a record is the boat's own; without it, who writes to the disk can make one."""
    with contextlib.suppress(ConfigError):  # the link to the consoles reports it
        return read_key(settings.table("mavlink").key) if settings.table("mavlink").key else b""
    return b""
