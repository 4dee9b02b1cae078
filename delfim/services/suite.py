"""The composition root: the services, the ones that a vehicle's file enables, and the process of each.

SERVICES is the suite, one row a service. To add one: its coroutine in the folder of its subject, or of its part in
`delfim/parts`, a row, a test. A row names its coroutine, and only the process that runs it loads it, before its loop turns:
the supervisor needs none of them. A large service that can wait is loaded `late`, while the loop already controls the boat.
"""

import contextlib
import faulthandler
import hashlib
import importlib
import logging
import os
import sys
import time
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from delfim import __version__, config
from delfim.base import parts, pulses
from delfim.base.errors import DelfimError, FormatError, PermanentFailure, in_words
from delfim.base.input.untrusted import parse_json, read_file
from delfim.canproxy.tables import Canip, Routing
from delfim.logging import systemlog
from delfim.services.can.buses import bring_up
from delfim.services.supervision import cgroup, shutdown
from delfim.services.supervision.children import STACKS_SIGNAL, Supervised
from delfim.services.supervision.privileges import real_time
from delfim.services.tables import Ftpd, Logd, PowerdTable, Slipd, Sshd, Tablet, Timed
from delfim.simulator.tables import Simulation

SHUTDOWN_LOOK_S = 0.1
log = logging.getLogger(__name__)
Start = Callable[[Any], Awaitable[None]]  # a service's coroutine: takes the runtime, runs until it is cancelled


class Service(NamedTuple):
    """One row of the table. `loaded` is for the process that runs it."""

    name: str
    entry: str  # module:coroutine
    place: Literal["runtime", "process"] = "runtime"
    budget_s: float | None = None  # of one callback; None: the vehicle's file says it
    late: bool = False  # loaded while the vehicle already sails
    uvloop: bool = True  # in a process of its own, where it is installed
    when: Callable[[config.Vehicle], object] = lambda settings: True  # whether the vehicle's file has work for it
    memory_max_mb: int = 256  # in a process of its own, unless the vehicle's file says otherwise
    is_part: bool = False  # of a laboratory

    def loaded(self) -> Start:
        """Load the coroutine for the runtime. If a package is missing, it is one that reports this: the other services go
        on."""
        module, _, name = self.entry.partition(":")
        try:
            start: Start = getattr(importlib.import_module(module), name)
        except (Exception, SystemExit) as error:
            if not (self.is_part or isinstance(error, ModuleNotFoundError)):
                raise
            missing = f"{module} cannot be imported: {in_words(error)}"
            if isinstance(error, ModuleNotFoundError) and not self.is_part:
                missing = f"{error.name} is not installed: pip install 'delfim[services]'"

            async def start(runtime: object) -> None:
                raise PermanentFailure(missing)

        return start

    def loading(self) -> Start:
        """A coroutine for a loop that must not wait: it loads the service when it starts."""

        async def start(runtime: Any) -> None:
            with contextlib.suppress(ModuleNotFoundError):  # the next line says so
                await runtime.load(self.entry.partition(":")[0])
            await self.loaded()(runtime)

        return start


# In the order of start. They are stopped in reverse, so that propulsion stops first and logs close last. No uvloop: sshd and
# payload, because it hands a program's streams to it as copies that outlive it, and those that serve one line, bus or peer:
# it gains them nothing for its 2 MB of memory (docs/decisions/0004-uvloop.md).
SERVICES = (
    Service("syslogd", "delfim.services.syslogd:serve", place="process", uvloop=False),
    Service("canzlogd", "delfim.services.can.canzlogd:serve"),
    Service("logd", "delfim.services.can.logd:serve", when=lambda settings: settings.of(Logd).nodes),
    Service("cantcpd", "delfim.services.can.cantcpd:serve"),
    Service("timed", "delfim.services.clock.timed:serve", when=lambda settings: settings.of(Timed).mode != "off"),
    Service("slipd", "delfim.services.radio.slipd:serve", when=lambda settings: settings.of(Slipd).device),
    Service("canip", "delfim.services.can.canip:serve", when=lambda settings: settings.of(Canip).enabled),
    Service("router", "delfim.services.can.router:serve", when=lambda settings: settings.of(Routing).buses),
    Service(
        "numbering",
        "delfim.parts.dronecan.numbering:serve",
        place="process",
        uvloop=False,
        when=lambda settings: "dronecan.interface" in settings.outside("interface"),
    ),
    Service(
        "nmea2000d",
        "delfim.parts.nmea2000.nmea2000d:serve",
        place="process",
        uvloop=False,
        when=lambda settings: any(settings.facts("joins")),
    ),
    Service("httpd", "delfim.services.page.httpd:serve", late=True),
    Service(
        "tabletd",
        "delfim.console.tabletd:serve",
        place="process",
        when=lambda settings: settings.of(Tablet).listen,
    ),
    Service("ftpd", "delfim.services.files.ftpd:serve", place="process", when=lambda settings: settings.of(Ftpd).users),
    Service(
        "sshd",
        "delfim.services.files.sshd:serve",
        place="process",
        when=lambda settings: settings.of(Sshd).users,
        uvloop=False,
        memory_max_mb=0,  # programs of its users count, too
    ),
    Service("powerd", "delfim.services.powerd:serve"),
    Service(
        "payload",
        "delfim.parts.payload.payload:serve",
        place="process",
        when=lambda settings: settings.table("payload"),
        uvloop=False,
    ),
    Service(
        "corrections",
        "delfim.parts.gnss.corrections:serve",
        place="process",
        uvloop=False,
        when=lambda settings: settings.table("corrections").to,
    ),
    Service(
        "i2cd",
        "delfim.parts.i2c.i2cd:serve",
        place="process",
        uvloop=False,
        when=lambda settings: settings.table("i2c").sensors and not settings.of(Simulation).faults,  # there others play them
    ),
    Service(
        "fleetd",
        "delfim.parts.fleet.fleetd:serve",
        place="process",
        uvloop=False,
        when=lambda settings: settings.table("fleet").broker,
    ),
    Service(
        "iridiumd",
        "delfim.parts.iridium.iridiumd:serve",
        place="process",
        uvloop=False,
        when=lambda settings: settings.table("iridium").device,
    ),
    Service(
        "rosd", "delfim.parts.ros.rosd:serve", place="process", uvloop=False, when=lambda settings: settings.table("ros").router
    ),
    Service(
        "camerad",
        "delfim.parts.camera.camerad:serve",
        place="process",
        uvloop=False,
        when=lambda settings: settings.table("camera"),
    ),
    Service("vehicle", "delfim.services.vehicle:serve"),
)


def services(settings: config.Vehicle) -> list[Service]:
    """The rows that this vehicle's file enables, each with its place. Raises PermanentFailure for an unknown service name."""
    theirs = [part for part in settings.aboard if part.service]
    of_parts = [Service(each.name, each.service, place="process", uvloop=False, is_part=True) for each in theirs]
    suite = (*SERVICES[:-1], *of_parts, SERVICES[-1])  # the vehicle starts last and stops first
    known = {row.name for row in suite}
    for name in settings.services:
        if name not in known:
            raise PermanentFailure(f"services.{name}: there is no such service; known are {', '.join(sorted(known))}")
    asked = {row.name: settings.services.get(row.name, config.ServiceTable()) for row in suite}
    enabled = [(row, asked[row.name]) for row in suite if asked[row.name].enabled and row.when(settings)]
    rows = [row if one.place == "default" else row._replace(place=one.place) for row, one in enabled]
    for row in rows:
        if row.name == "vehicle" and row.place == "process":
            raise PermanentFailure("services.vehicle: the vehicle runs in the runtime, which the dead-man watches")
        if row.name == "syslogd" and row.place == "runtime":
            raise PermanentFailure("services.syslogd: it waits for the disk, which the runtime must not")
        if row.place == "runtime" and (asked[row.name].memory_max_mb or asked[row.name].cpu_max):
            raise PermanentFailure(f'services.{row.name}: memory_max_mb and cpu_max need place = "process"')
    return rows


def run(file: str, overrides: Sequence[str], *, service: str | None, beat_fd: int) -> int:
    """Run `delfim run`: the vehicle and its cooperative services in this process; or one service alone."""
    if beat_fd >= 0:  # before anything that may take long; chained, so that it dies where it stood and commands nothing more
        faulthandler.register(STACKS_SIGNAL, beat_fd, chain=True)
    import asyncio

    from delfim.base.clock import SystemClock
    from delfim.base.eventloop import new_event_loop
    from delfim.services import runtime
    from delfim.services.priority import navigation_loop

    settings = config.load(file, overrides)
    rows = services(settings)
    wanted = [row for row in rows if row.name == service] if service else [row for row in rows if row.place == "runtime"]
    if not wanted:
        raise PermanentFailure(f"{file}: no service {service!r} is enabled")
    alone = service is not None
    systemlog.begin(settings.runtime.run_directory, service or "runtime", _levels(settings), navigation_loop.speaker)
    starts = [row.loading() if row.late and not alone else row.loaded() for row in wanted]  # the loop has no time to do it
    loaded = [runtime.LoadedService(row.name, start, row.budget_s) for row, start in zip(wanted, starts, strict=True)]
    new_loop = (new_event_loop if wanted[0].uvloop else asyncio.new_event_loop) if alone else None
    return runtime.Runtime(settings, SystemClock(), file, beat_fd=beat_fd, alone=alone, new_loop=new_loop).main(loaded)


def outlet(file: str, overrides: Sequence[str], *, beat_fd: int) -> int:
    """Run `delfim outlet`: the pulses of motors that keep their last command, and nothing else. Raises DelfimError, OSError."""
    if beat_fd >= 0:
        faulthandler.register(STACKS_SIGNAL, beat_fd, chain=True)
    settings = config.load(file, overrides)
    part = next(row for row in parts.OWN.values() if row.outlet)
    serve = parts.load(part, part.outlet)
    systemlog.begin(settings.runtime.run_directory, "outlet", _levels(settings))
    _above(settings.runtime.fifo_priority)
    serve(pulses.socket_path(settings.runtime.run_directory), settings.table(part.name), settings.channels, beat_fd)
    return 0


def supervise(
    file: str, overrides: Sequence[str], program: Sequence[str] = (sys.executable, "-m", "delfim"), *, init: bool = False
) -> int:
    """Run `delfim supervise`: the runtime and the services in processes of their own, restarted when they die; the dead-man.
    `program` is started with `run FILE`. init: as the machine's first process, which ends with the machine."""
    settings = config.load(file, overrides)
    if init:
        bring_up(settings.bit_rates)
    command = (*program, "run", file, *(word for one in overrides for word in ("--set", one)))
    programs = [Supervised("runtime", command, critical=True)]
    if settings.driven("outlet"):
        own = (*program, "outlet", file, *(word for one in overrides for word in ("--set", one)))
        programs.append(Supervised("outlet", own, guard=True))
    programs += [
        Supervised(row.name, (*command, "--service", row.name), limits=_limits(settings, row))
        for row in services(settings)
        if row.place == "process"
    ]
    from delfim.services.clock import kernel

    place = Path(settings.runtime.run_directory)
    place.mkdir(parents=True, exist_ok=True)
    systemlog.begin(str(place), "supervisor", _levels(settings))
    kernel.set_from_battery(settings.clock.set, settings.buses)  # before any log has a name
    log.info("delfim %s starts %s, sha256 %s, with %s", *_started(file, overrides))
    _above(settings.runtime.fifo_priority)
    from delfim.services.supervision.stop import CutOff, PropellerStop
    from delfim.services.supervision.supervisor import Supervisor

    limits = settings.supervisor
    (its,) = settings.facts("cut")
    cut_off = CutOff(its.chip, its.line, its.at == "high")
    with contextlib.closing(PropellerStop(settings)) as stop, contextlib.closing(cut_off) as cut:
        supervisor = Supervisor(
            programs,
            stop=stop,
            calm=stop.close,
            cut=cut,
            deadman_s=limits.deadman_s,
            backoff_s=limits.backoff_s,
            backoff_max_s=limits.backoff_max_s,
            state_file=place / "supervisor.json",
            watchdog=limits.hardware_watchdog,
            requests=shutdown.socket_path(place),
            init=init,
        )
        code = supervisor.run_forever()
        if supervisor.word in ("off", "reboot"):
            kernel.write_battery(settings.clock.set, settings.buses)
            is_safe = _last_act(settings, supervisor.reason, stop.tell)
            code = 0 if is_safe else 1
            if init:
                shutdown.leave(supervisor.word, shutdown.words_path(place))
    return code


def _levels(settings: config.Vehicle) -> dict[str, str]:
    """The least level of each service whose records the system log keeps."""
    return {name: table.log for name, table in settings.services.items()}


def _started(file: str, overrides: Sequence[str]) -> tuple[str, str, str, str]:
    """Version, file, its digest, and the keys that the command line replaced: their values may be secret."""
    keys = ", ".join(each.partition("=")[0] for each in overrides)
    return (
        __version__,
        file,
        hashlib.sha256(read_file(file)).hexdigest(),
        f"other values of {keys}" if keys else "its own values",
    )


def _above(fifo_priority: int) -> None:
    """Put the supervisor above the runtime: one that loops for ever in real time must not keep the processor from it."""
    if fifo_priority:
        with contextlib.suppress(OSError):  # not permitted: the runtime is not either, and logs it
            real_time(fifo_priority + 1)


def _limits(settings: config.Vehicle, row: Service) -> cgroup.Limits:
    """The limits of the vehicle's file; at sea also the memory of a service that nobody limited."""
    asked = settings.services.get(row.name, config.ServiceTable())
    usual_mb = 0 if settings.of(Simulation).faults else row.memory_max_mb
    is_asked = bool(asked.memory_max_mb or asked.cpu_max)
    return cgroup.Limits((usual_mb if asked.memory_max_mb is None else asked.memory_max_mb) << 20, asked.cpu_max, is_asked)


def _last_act(settings: config.Vehicle, reason: str, tell: Callable[[bool, Sequence[str]], None]) -> bool:
    """Unmount the log partition after the programs, and report on the bus. Returns whether the power may be cut."""
    limits = settings.of(PowerdTable)
    inside = Path(limits.partition) in (Path(settings.log.directory), *Path(settings.log.directory).parents)
    return shutdown.last_act(
        reason,
        limits.partition if inside else "",
        end_s=limits.end_s,
        held_s=limits.held_s,
        told_s=limits.told_s,
        tell=tell,
        record=shutdown.record_path(settings.runtime.run_directory),
    )


def shut_down(file: str, overrides: Sequence[str], word: shutdown.Word) -> int:
    """Run `delfim shutdown`: have the supervisor end everything, and print the outcome. Returns 0 when the power may be cut.
    Raises DelfimError where no supervisor runs."""
    settings = config.load(file, overrides)
    place, record = settings.runtime.run_directory, shutdown.record_path(settings.runtime.run_directory)
    told, asked_s = "", time.monotonic()
    try:
        shutdown.request(shutdown.socket_path(place), word, "command")
        while shutdown.is_listening(shutdown.socket_path(place)):
            told = _outcome(record, asked_s, told)
            time.sleep(SHUTDOWN_LOOK_S)
    except OSError as error:
        raise DelfimError(f"no supervisor at {place}: {error.strerror}; is it running?") from None
    return 0 if _outcome(record, asked_s, told) == "safe" else 1


def _outcome(record: Path, since_s: float, last: str) -> str:
    """Print the outcome so far when it is new; returns it, empty while there is none."""
    try:
        found = parse_json(read_file(record))
        outcome = "safe" if found["stage"] == "safe" else "held: " + "; ".join(found["holders"])
        is_old = found["at_s"] < since_s
    except (OSError, FormatError, KeyError, TypeError):
        return last
    if is_old:
        return last
    if outcome != last:
        print(f"delfim: {'the power may be cut' if outcome == 'safe' else f'not yet safe: {outcome}'}", flush=True)
    return outcome


def rescue(error: Exception) -> None:
    """Print the error and give whoever is at its console a shell: the machine's first process must not end."""
    print(f"delfim: {error}\ndelfim: the boat cannot start; this is a shell to repair it", file=sys.stderr)
    os.execv("/bin/sh", ("/bin/sh",))
