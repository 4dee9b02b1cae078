"""Services that are put together from several parts of the system, as the vehicle's file says: their sockets, logs and inputs,
and the loop that carries them. Loaded only by a process that runs one of them; which process that is says delfim/suite.py.
"""

import asyncio
import contextlib
import logging
import os
import socket
from collections.abc import Callable
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
from delfim.clock import Clock
from delfim.errors import DelfimError
from delfim.logging.canzlogd import FRAMES_A_CALL, BlackBox
from delfim.logging.liblog import event_line, open_log
from delfim.logging.logd import LogMessages
from delfim.logging.statelog import Schema, StateWriter
from delfim.messages import LOG_ID, SYSSTAT_MASK, TIME_FRAME, Node, sysstat_arb
from delfim.services import powerd, slots
from delfim.services.runtime import Runtime
from delfim.vehicle import record
from delfim.vehicle.command import CommandServer
from delfim.vehicle.console import Alive, Commands, Report, Shutdown, Watch
from delfim.vehicle.grex import Guest
from delfim.vehicle.loop import LOCAL, Vehicle
from delfim.vehicle.navcan import DsorNavigation, Nmea2000Navigation, Source
from delfim.vehicle.propulsion import Propulsion
from delfim.vehicle.rehearsal import Rehearsal
from delfim.vehicle.state import Mode, State

if TYPE_CHECKING:
    from delfim.simulator.bycommand import Aboard

WATCHDOG_S = 0.1
PUBLISH_EVERY = 2  # watchdog ticks
MEASURE_EVERY = 5
MAINTAIN_EVERY = 10
GATHER_S = 0.005  # that frames wait for others on their way into the black box; the kernel has stamped them already


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
    state = State(is_starting=runtime.is_starting())
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
        if (mirror := outlet.mirror()) is not None:
            runtime.rehearsal(Rehearsal(boat, outlet, mirror))
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

    figures = dict[str, object]()

    def measure() -> None:  # not for each answer, which would be a long callback
        figures.update({name: report() for name, report in runtime.board.items() if name not in runtime.status})
        figures.update(runtime.report())

    def snapshot() -> dict[str, object]:
        return boat.snapshot({"boat": settings.boat.name, "log": log.status()._asdict(), **figures})

    def obeyed(command: Commands, operator: str = LOCAL) -> str | None:
        refused = (broken.deaf if broken else None) or boat.on_command(command, operator)
        if isinstance(command, Shutdown) and refused is None:
            powerd.ask(runtime, "reboot" if command.reboot else "off", "command of the console")
        log.command(command, refused, boat.state)
        return refused

    mavlink = runtime.load("delfim.vehicle.mavlink.link") if settings.mavlink.enabled else None
    commands = CommandServer(obeyed, snapshot, settings.console.clients)
    links.callback(commands.close)
    links.callback((await loop.create_unix_server(commands.connection, _socket_path(settings.console.socket))).close)
    os.chmod(settings.console.socket, 0o660)
    if settings.guest.enabled:
        links.callback(boat.guest.close)
        with contextlib.suppress(OSError):  # a boat without its guest sails; the state says that none is connected
            links.callback((await _guest_server(boat, settings.guest.listen)).close)
    measure()
    ticks = 0
    while True:
        await asyncio.sleep(WATCHDOG_S)
        ticks += 1
        boat.state.is_starting = runtime.is_starting()
        boat.on_watchdog()
        log.watch(boat.state)
        if mavlink and mavlink.done():
            link, mavlink = mavlink.result().MavlinkLink, None
            with contextlib.suppress(OSError):  # a boat without this link sails; the reason is logged
                links.enter_context(link(boat, obeyed, Path(settings.log.directory) / "mavlink-stamps", runtime.board))
        if ticks % PUBLISH_EVERY == 0:
            await asyncio.sleep(0)  # navigation has its turn between two parts of a tick
            commands.publish()
        if ticks % MEASURE_EVERY == 1:
            await asyncio.sleep(0)
            measure()
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


async def _published(runtime: Runtime, name: str, report: Callable[[], dict[str, object]]) -> None:
    """Until cancelled: the rest happens in callbacks, and the figures are on the runtime's board."""
    runtime.board[name] = report
    try:
        await asyncio.Event().wait()
    finally:
        del runtime.board[name]


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
