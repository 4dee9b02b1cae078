"""The composition root: the one place that knows all parts and puts the suite together from the vehicle's file.

SERVICES is the suite, one row a service. To add one: write its coroutine in a file of its own, add a row, add a test.
"""

import asyncio
import contextlib
import importlib
import json
import logging
import os
import socket
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from delfim import __version__, config
from delfim.canproxy import dsor
from delfim.canproxy.canip import CanIp, open_tun
from delfim.canproxy.cantcpd import Cantcpd
from delfim.canproxy.nmea2000 import Nmea2000Source
from delfim.canproxy.socket import ANYTHING, CanAddress, CanSocket, bus_state, open_can
from delfim.canproxy.timed import SecondTimer, Timekeeper, TimeService
from delfim.clock import Clock, SystemClock
from delfim.errors import DelfimError, PermanentFailure
from delfim.logging.canzlogd import FRAMES_A_CALL, BlackBox
from delfim.logging.liblog import event_line, open_log
from delfim.logging.logd import LogMessages
from delfim.logging.statelog import Schema, StateWriter
from delfim.messages import (
    LOG_ID,
    PROPELLER_COMMAND,
    PROPELLER_PORT,
    PROPELLER_STARBOARD,
    SYSSTAT_MASK,
    TIME_FRAME,
    Node,
    ShutdownStage,
    sysstat_arb,
)
from delfim.services import cgroup, powerd, shutdown, slots
from delfim.services.runtime import Runtime, Service
from delfim.services.supervisor import Program, Supervisor
from delfim.vehicle import record
from delfim.vehicle.command import CommandServer
from delfim.vehicle.console import Alive, Commands, Report, Shutdown, Watch
from delfim.vehicle.grex import Guest
from delfim.vehicle.loop import LOCAL, Vehicle
from delfim.vehicle.mavlink.link import MavlinkLink
from delfim.vehicle.navcan import DsorNavigation, Nmea2000Navigation, Source
from delfim.vehicle.propulsion import Propulsion
from delfim.vehicle.rehearsal import Rehearsal
from delfim.vehicle.state import Mode, State

if TYPE_CHECKING:
    from delfim.simulator.bycommand import Aboard

WATCHDOG_S = 0.1
PUBLISH_EVERY = 2  # watchdog ticks
MAINTAIN_EVERY = 10
GATHER_S = 0.005  # that frames wait for others on their way into the black box; the kernel has stamped them already
SHUTDOWN_LOOK_S = 0.1


class StateLog:
    """The vehicle's state log: a record a cycle."""

    def __init__(self, settings: config.Vehicle, clock: Clock) -> None:
        schema = Schema(
            [(f.name, f.code, f.unit, f.description) for f in record.FIELDS],
            boat=settings.boat.name,
            started_ns=clock.time_ns(),
        )
        limits, self._clock = settings.log, clock
        self._log = open_log(
            limits.directory,
            "state",
            ".state",
            limits.state_method,
            clock,
            header=schema.header,
            file_bytes=limits.file_bytes,
            file_s=limits.file_s,
            free_bytes_min=limits.free_bytes_min,
            when_full=limits.when_full,
        )
        self._writer = StateWriter(self._log, schema)
        self.status, self.poll = self._log.status, self._log.poll
        self._noted = False
        self.event("start", version=__version__, settings=config.shown(settings))

    def write(self, state: State, now_s: float) -> None:
        self._writer.put(record.values(state, now_s))

    def event(self, event: str, **what: object) -> None:
        """Into the sidecar: what happened that is no record."""
        self._log.note(event_line(self._clock, event, **what))

    def command(self, command: Commands, refused: str | None, state: State) -> None:
        """A word of the console and what became of it. Those that only ask or only say that somebody is there are not kept."""
        if not isinstance(command, Alive | Report | Watch):
            self.event("command", at_s=state.console_s, value=msgspec.to_builtins(command), refused=refused or "")

    def note(self, text: str) -> None:
        """An event of the loop, in words; "hold: fence ahead" is a change of mode with its reason."""
        self._noted = True
        mode, _, reason = text.partition(": ")
        if mode.upper() in Mode.__members__:
            self.event("mode", value=mode, reason=reason)
        else:
            self.event("note", value=text)

    def watch(self, state: State) -> None:
        """Called after each look of the watchdog: when it was, where something was noted since the one before."""
        if self._noted:
            self._noted = False
            self.event("watchdog", at_s=state.watchdog_s)

    def reason(self) -> str:
        status = self._log.status()
        return self._writer.reason if status.writable else status.reason

    def close(self) -> None:
        self.event("end")
        self._log.close()


async def vehicle(runtime: Runtime) -> None:
    """The critical program as a service: opens its links, hands them to the loop, and stops the boat when it ends."""
    settings, clock = runtime.config, runtime.clock
    state = State()
    with contextlib.ExitStack() as links:
        state.last_shutdown = _last_shutdown(Path(settings.log.directory), links)
        state.image = slots.present_notice(settings.runtime.run_directory)
        sources = _sources(settings, state, links)
        status_frames = _opened(links, settings, settings.can.interface, CanAddress(sysstat_arb(Node.VEHICLE), SYSSTAT_MASK))
        status_messages = _opened(links, settings, settings.can.interface, CanAddress(*dsor.message_filter(source=Node.GPS)))
        log = StateLog(settings, clock)
        links.callback(log.close)
        outlet = _opened(links, settings, settings.can.interface)
        propulsion = Propulsion(outlet, settings.propulsion, state)
        broken = _breakable(runtime, links)
        guest, record_to = (broken.guest(state), broken.log(log)) if broken else (Guest(state, clock), log)
        boat = Vehicle(settings, clock, state, sources, propulsion, guest, record_to)
        links.callback(boat.stop, "shutdown")  # first of all that is undone
        for source in sources:
            runtime.navigation(source.socket.fileno(), partial(boat.on_navigation, source))
            links.callback(runtime.remove_navigation, source.socket.fileno())
        runtime.rehearsal(Rehearsal(boat, outlet))
        links.callback(runtime.rehearsal, None)
        for status in (status_frames, status_messages):
            runtime.reader(status.fileno(), partial(boat.on_sysstat, status))
            links.callback(runtime.remove_reader, status.fileno())
        sockets = [source.socket for source in sources] + [status_frames, status_messages]
        await _attend(runtime, boat, log, sockets, links, broken)


async def _attend(
    runtime: Runtime,
    boat: Vehicle,
    log: StateLog,
    sockets: list[CanSocket],
    links: contextlib.ExitStack,
    broken: "Aboard | None",
) -> None:
    """Console and guest served, the watchdog stroked, until the service is cancelled."""
    settings, loop = runtime.config, asyncio.get_running_loop()

    def more() -> dict[str, object]:
        figures = {name: report() for name, report in runtime.board.items()}
        return {"boat": settings.boat.name, "log": log.status()._asdict(), **figures, **runtime.report()}

    def obeyed(command: Commands, operator: str = LOCAL) -> str | None:
        refused = (broken.deaf if broken else None) or boat.on_command(command, operator)
        if isinstance(command, Shutdown) and refused is None:
            powerd.ask(runtime, "reboot" if command.reboot else "off", "command of the console")
        log.command(command, refused, boat.state)
        return refused

    commands = CommandServer(obeyed, lambda: boat.snapshot(more()), settings.console.clients)
    links.callback(commands.close)
    links.callback((await loop.create_unix_server(commands.connection, _socket_path(settings.console.socket))).close)
    os.chmod(settings.console.socket, 0o660)
    if settings.guest.enabled:
        links.callback(boat.guest.close)
        with contextlib.suppress(OSError):  # a boat without its guest sails; the state says that none is connected
            links.callback((await _guest_server(boat, settings.guest.listen)).close)
    if settings.mavlink.enabled:
        with contextlib.suppress(OSError):  # a boat without this link sails; the reason is logged
            links.enter_context(MavlinkLink(boat, obeyed, Path(settings.log.directory) / "mavlink-stamps", runtime.board))
    ticks = 0
    while True:
        await asyncio.sleep(WATCHDOG_S)
        ticks += 1
        boat.on_watchdog()
        log.watch(boat.state)
        if ticks % PUBLISH_EVERY == 0:
            commands.publish()
        if ticks % MAINTAIN_EVERY == 0:
            log.poll()
            if boat.state.image:  # until somebody confirms it
                boat.state.image = slots.present_notice(settings.runtime.run_directory)
            for each in sockets:
                each.rebind()


def _breakable(runtime: Runtime, links: contextlib.ExitStack) -> "Aboard | None":
    """What `delfim fault` can break in this program. None at sea: nothing of it is loaded there."""
    if not runtime.config.simulation.faults:
        return None
    from delfim.simulator.bycommand import Aboard

    return links.enter_context(Aboard(runtime.config, runtime.clock))


def _last_shutdown(directory: Path, links: contextlib.ExitStack) -> str:
    """What was wrong with the end of the run before, in words, told by a mark that lies among the logs while a run goes on."""
    mark = directory / "running"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        unclean = mark.exists()
        mark.touch()
    except OSError:  # no disk: the check of the log says so
        return ""

    def ended() -> None:
        with contextlib.suppress(OSError):
            mark.unlink()

    links.callback(ended)
    return "the run before did not end in order: a crash, or the power was cut" if unclean else ""


async def _guest_server(boat: Vehicle, listen: str) -> asyncio.Server:
    """Raises OSError where the address cannot be had; the reason is logged."""
    host, _, port = listen.rpartition(":")
    try:
        return await asyncio.get_running_loop().create_server(lambda: boat.guest, host, int(port))
    except OSError as error:
        logging.getLogger(__name__).error("guest: nobody can connect on %s: %s", listen, error.strerror)
        raise


async def canzlogd(runtime: Runtime) -> None:
    """The black box: every frame of every bus."""
    settings = runtime.config
    with contextlib.ExitStack() as links:
        room = settings.can.receive_buffer_bytes
        names = _interfaces(settings)
        opened = (open_can(name, receive_buffer_bytes=room, error_frames=True, batch=FRAMES_A_CALL) for name in names)
        sockets = [links.enter_context(each) for each in opened]
        box = BlackBox(sockets, settings.log, runtime.clock, bus_state)
        links.callback(box.close)
        runtime.board["canzlogd"] = box.figures
        links.callback(runtime.board.pop, "canzlogd")
        for each in sockets:
            each.bind(ANYTHING)
            each.setblocking(False)
            runtime.reader(each.fileno(), partial(box.on_readable, each), GATHER_S)
            links.callback(runtime.remove_reader, each.fileno())
        while True:
            await asyncio.sleep(1.0)
            box.poll()


async def logd(runtime: Runtime) -> None:
    """What the nodes of the bus say in words."""
    settings = runtime.config
    names = {node: Node(node).name.lower() if node in list(Node) else f"node-{node}" for node in settings.logd.nodes}
    with contextlib.ExitStack() as links:
        filters = [CanAddress(*dsor.message_filter(source=node)) for node in names]
        can = _opened(links, settings, settings.can.interface, *filters)
        receiver = dsor.Receiver(Node.VEHICLE, lambda message: message.id == LOG_ID and message.port is None)
        log = LogMessages(can, receiver, names, settings.log, runtime.clock)
        links.callback(log.close)
        runtime.reader(can.fileno(), log.on_readable)
        links.callback(runtime.remove_reader, can.fileno())
        runtime.board["logd"] = log.report
        links.callback(runtime.board.pop, "logd")
        while True:
            await asyncio.sleep(1.0)
            log.poll()


async def cantcpd(runtime: Runtime) -> None:
    """CAN over TCP: whoever may watches the buses, and sends."""
    settings, loop = runtime.config, asyncio.get_running_loop()
    interfaces = settings.cantcpd.buses or _interfaces(settings)
    with contextlib.ExitStack() as links:
        server = Cantcpd(settings.cantcpd, interfaces, runtime, runtime.clock, settings.can.receive_buffer_bytes)
        links.callback(server.close)
        asked = [(address, server.slcan_connection) for address in settings.cantcpd.slcan]
        asked += [(address, server.connection) for address in settings.cantcpd.listen]
        for address, connection in asked:
            host, _, number = address.rpartition(":")
            listening = await loop.create_server(connection, host.strip("[]"), int(number))
            links.callback(listening.close)
        port = listening.sockets[0].getsockname()[1]
        runtime.board["cantcpd"] = server.report
        links.callback(runtime.board.pop, "cantcpd")
        while True:
            server.poll(port)
            await asyncio.sleep(1.0)


async def canip(runtime: Runtime) -> None:
    """UDP datagrams over the bus."""
    settings = runtime.config.canip
    tun = open_tun(settings.device, settings.address, settings.mtu)
    with contextlib.ExitStack() as links:
        links.callback(os.close, tun)
        can = links.enter_context(open_can(runtime.config.can.interface))
        carrier = CanIp(asyncio.get_running_loop(), tun, can, settings)
        links.callback(carrier.close)
        runtime.reader(tun, carrier.on_packets)
        links.callback(runtime.remove_reader, tun)
        await _published(runtime, "canip", carrier.report)


async def timed(runtime: Runtime) -> None:
    """The time frame at the start of each second."""
    settings, clock = runtime.config.timed, runtime.clock
    assert settings.mode != "off"
    keeper = Timekeeper(settings.mode, settings.takeover_s, clock.monotonic_s())
    with contextlib.ExitStack() as links:
        can = _opened(links, runtime.config, runtime.config.can.interface, CanAddress(TIME_FRAME))
        timer = SecondTimer(keeper.delay_s, clock.time_ns())
        links.callback(timer.close)
        service = TimeService(keeper, timer, can, clock)
        for fd, handler in ((can.fileno(), service.on_frames), (timer.fileno(), service.on_second)):
            runtime.reader(fd, handler)
            links.callback(runtime.remove_reader, fd)
        await _published(runtime, "timed", service.report)


async def slipd(runtime: Runtime) -> None:
    """The radio's serial line."""
    from delfim.services.slipd import serve

    await serve(runtime)


async def _published(runtime: Runtime, name: str, report: Callable[[], dict[str, object]]) -> None:
    """Until cancelled: the rest happens in callbacks, and the figures are on the runtime's board."""
    runtime.board[name] = report
    try:
        await asyncio.Event().wait()
    finally:
        del runtime.board[name]


async def httpd(runtime: Runtime) -> None:
    """The page. Its library is loaded only where it runs, and before the loop turns: see `run`."""
    try:
        from delfim.services.httpd import serve
    except ModuleNotFoundError as error:
        raise PermanentFailure(f"{error.name} is not installed: pip install 'delfim[services]'") from None
    await serve(runtime)


async def ftpd(runtime: Runtime) -> None:
    """Files over FTP, for the users of the vehicle's file."""
    try:
        from delfim.services.ftpd import serve
    except ModuleNotFoundError as error:
        raise PermanentFailure(f"{error.name} is not installed: pip install 'delfim[services]'") from None
    await serve(runtime)


async def sshd(runtime: Runtime) -> None:
    """Commands and files over SSH, for the users of the vehicle's file."""
    try:
        from delfim.services.sshd import serve
    except ModuleNotFoundError as error:
        raise PermanentFailure(f"{error.name} is not installed: pip install 'delfim[services]'") from None
    await serve(runtime)


# One row a service, in the order of start. They are stopped in reverse, so that propulsion stops first and logs close last.
SERVICES = (
    Service("canzlogd", canzlogd),
    Service("logd", logd),
    Service("cantcpd", cantcpd),
    Service("timed", timed),
    Service("slipd", slipd),
    Service("canip", canip),
    Service("httpd", httpd),
    Service("ftpd", ftpd, place="process"),
    Service("sshd", sshd, place="process"),
    Service("powerd", powerd.serve),
    Service("vehicle", vehicle),
)


def services(settings: config.Vehicle) -> list[Service]:
    """The rows that this vehicle's file enables, each with its place. Raises PermanentFailure for a name that is none."""
    known = {row.name for row in SERVICES}
    for name in settings.services:
        if name not in known:
            raise PermanentFailure(f"services.{name}: there is no such service; there are {', '.join(sorted(known))}")
    asked = {row.name: settings.services.get(row.name, config.Service()) for row in SERVICES}
    off = {"canip"} if not settings.canip.enabled else set()
    off |= {"slipd"} if not settings.slipd.device else set()
    off |= {"timed"} if settings.timed.mode == "off" else set()
    off |= set() if settings.logd.nodes else {"logd"}
    off |= set() if settings.ftpd.users else {"ftpd"}  # nobody could come in
    off |= set() if settings.sshd.users else {"sshd"}
    enabled = [(row, asked[row.name]) for row in SERVICES if asked[row.name].enabled and row.name not in off]
    rows = [row if one.place == "default" else row._replace(place=one.place) for row, one in enabled]
    for row in rows:
        if row.place == "runtime" and (asked[row.name].memory_max_mb or asked[row.name].cpu_max):
            raise PermanentFailure(f'services.{row.name}: memory_max_mb and cpu_max need place = "process"')
    return rows


def run(file: str, overrides: Sequence[str], *, service: str | None, beat_fd: int) -> int:
    """`delfim run`: the vehicle and its cooperative services in this process; or one service alone."""
    settings = config.load(file, overrides)
    rows = services(settings)
    wanted = [row for row in rows if row.name == service] if service else [row for row in rows if row.place == "runtime"]
    if not wanted:
        raise PermanentFailure(f"{file}: no service {service!r} is enabled")
    for row in wanted:  # now, for a cooperative service has no time to load a library
        with contextlib.suppress(ImportError):
            importlib.import_module(f"delfim.services.{row.name}")
    return Runtime(settings, SystemClock(), beat_fd=beat_fd, alone=service is not None).main(wanted)


def supervise(
    file: str, overrides: Sequence[str], program: Sequence[str] = (sys.executable, "-m", "delfim"), *, init: bool = False
) -> int:
    """`delfim supervise`: the runtime and the services in processes of their own, restarted when they die; the dead-man.
    `program` is what is started with `run FILE`. init: as the machine's first process, which ends with the machine."""
    settings = config.load(file, overrides)
    command = (*program, "run", file, *(word for one in overrides for word in ("--set", one)))
    programs = [Program("runtime", command, settings.runtime.nice, critical=True)]
    programs += [
        Program(row.name, (*command, "--service", row.name), settings.runtime.service_nice, limits=_limits(settings, row.name))
        for row in services(settings)
        if row.place == "process"
    ]
    place = Path(settings.runtime.run_directory)
    place.mkdir(parents=True, exist_ok=True)
    limits, stop = settings.supervisor, StopFrames(settings.can.interface)
    supervisor = Supervisor(
        programs,
        stop=stop,
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
        is_safe = _last_act(settings, supervisor.reason, stop)
        code = 0 if is_safe else 1
        if init:
            shutdown.leave(supervisor.word)
    return code


def _limits(settings: config.Vehicle, name: str) -> cgroup.Limits:
    asked = settings.services.get(name, config.Service())
    return cgroup.Limits(asked.memory_max_mb << 20, asked.cpu_max)


def _last_act(settings: config.Vehicle, reason: str, stop: "StopFrames") -> bool:
    """After the programs: the log partition unmounted, the bus told. Returns whether the power may be cut."""
    limits = settings.powerd
    inside = Path(limits.partition) in (Path(settings.log.directory), *Path(settings.log.directory).parents)

    def tell(is_safe: bool, holders: Sequence[str]) -> None:
        with contextlib.suppress(OSError, DelfimError):  # a bus that takes nothing is no reason to go on
            stop()
            stop.acknowledge(ShutdownStage.SAFE if is_safe else ShutdownStage.HELD, len(holders))

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
    """`delfim shutdown`: has the supervisor end everything, and says what comes of it. Returns 0 when the power may be cut.
    Raises DelfimError where no supervisor runs."""
    settings = config.load(file, overrides)
    place, record = settings.runtime.run_directory, shutdown.record_path(settings.runtime.run_directory)
    told, asked_s = "", time.time()
    try:
        shutdown.request(shutdown.socket_path(place), word, "command")
        while shutdown.is_listening(shutdown.socket_path(place)):
            told = _told(record, asked_s, told)
            time.sleep(SHUTDOWN_LOOK_S)
    except OSError as error:
        raise DelfimError(f"no supervisor at {place}: {error.strerror}; is it running?") from None
    return 0 if _told(record, asked_s, told) == "safe" else 1


def _told(record: Path, since: float, last: str) -> str:
    """The outcome so far, printed when it is new; empty while there is none."""
    try:
        found = json.loads(record.read_text())
        outcome = "safe" if found["stage"] == "safe" else "held: " + "; ".join(found["holders"])
    except (OSError, ValueError, KeyError):
        return last
    if found["time"] < since:
        return last
    if outcome != last:
        print(f"delfim: {'the power may be cut' if outcome == 'safe' else f'not yet safe: {outcome}'}", flush=True)
    return outcome


def rescue(error: Exception) -> None:
    """The machine's first process must not end: what is wrong is said, and whoever is at its console may mend it."""
    print(f"delfim: {error}\ndelfim: the boat does not sail; this is a shell", file=sys.stderr)
    os.execv("/bin/sh", ("/bin/sh",))


class StopFrames:
    """What the supervisor sends: both propellers off, and how far a shutdown is."""

    def __init__(self, interface: str) -> None:
        self._interface = interface
        self._socket: CanSocket | None = None

    def __call__(self) -> None:
        """Raises OSError where the bus does not take the frames."""
        if self._socket is None:
            self._socket = open_can(self._interface)
            self._socket.setblocking(False)
        for arb in (PROPELLER_STARBOARD, PROPELLER_PORT):
            self._socket.sendto(PROPELLER_COMMAND.pack(0, 0, 0), CanAddress(arb))

    def acknowledge(self, stage: ShutdownStage, holders: int) -> None:
        """Raises OSError as above."""
        if self._socket is not None:
            powerd.acknowledge(self._socket, stage, holders)


def _socket_path(name: str) -> str:
    """The path for a new UNIX socket; what a run that was killed left there is removed. Raises DelfimError when a vehicle is
    running there: two must not answer to one name."""
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with socket.socket(socket.AF_UNIX) as knock:
        if knock.connect_ex(name) == 0:
            raise DelfimError(f"another vehicle answers on {name}")
    path.unlink(missing_ok=True)
    return name


def _interfaces(settings: config.Vehicle) -> list[str]:
    """All buses of the boat."""
    interfaces = {settings.can.interface}
    if "nmea2000" in settings.navigation.sources:
        interfaces.add(settings.nmea2000.interface)
    return sorted(interfaces)


def _opened(links: contextlib.ExitStack, settings: config.Vehicle, interface: str, *filters: CanAddress) -> CanSocket:
    """A socket that never blocks and receives what the filters accept: none, nothing."""
    can = links.enter_context(open_can(interface, receive_buffer_bytes=settings.can.receive_buffer_bytes))
    can.setblocking(False)
    if filters:
        can.bind(*filters)
    return can


def _sources(settings: config.Vehicle, state: State, links: contextlib.ExitStack) -> tuple[Source, ...]:
    """Navigation inputs in order of preference."""
    sources: list[Source] = []
    for name in settings.navigation.sources:
        if name == "dsor":
            node = CanAddress(*dsor.message_filter(source=Node.NAVIGATION))
            sources.append(DsorNavigation(_opened(links, settings, settings.can.interface, node), state))
        else:
            decoder = Nmea2000Source(settings.nmea2000, settings.navigation.stale_s)
            filters = (CanAddress(arb, mask) for arb, mask in decoder.filters)
            can = _opened(links, settings, settings.nmea2000.interface, *filters)
            sources.append(Nmea2000Navigation(can, decoder, state))
    return tuple(sources)
