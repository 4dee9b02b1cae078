"""The critical program as a service: it opens the boat's links, hands them to the loop, serves console and guest, and stops the
boat when it ends.
"""

import asyncio
import contextlib
import logging
import os
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Protocol

from delfim import config
from delfim.base import parts
from delfim.base.clock import Clock
from delfim.base.errors import ConfigError, DelfimError
from delfim.base.ranges import address
from delfim.canproxy.dsor.messages import time_frame
from delfim.canproxy.socket import CanAddress
from delfim.lines.forms import Form
from delfim.lines.opening import AnyLine, OpenedLinks
from delfim.logging.linelog import LineLog
from delfim.services import powerd
from delfim.services.access.guest_listener import GuestListener
from delfim.services.clock import kernel
from delfim.services.clock.kernel import KernelClock
from delfim.services.clock.sources import ClockKeeping
from delfim.services.image import slots
from delfim.services.runtime import Runtime
from delfim.services.tables import GuestTable
from delfim.services.voyage_on_disk import VoyageKeeping
from delfim.simulator.tables import Simulation
from delfim.vehicle import snapshot
from delfim.vehicle.aboard import Hand
from delfim.vehicle.build import build
from delfim.vehicle.console import Commands, ShutDown
from delfim.vehicle.grex import Guest
from delfim.vehicle.links import Links
from delfim.vehicle.log.logbook import Logbook
from delfim.vehicle.loop import LOCAL, VehicleLoop
from delfim.vehicle.navigation.fixes import Source
from delfim.vehicle.operator.command import CommandServer
from delfim.vehicle.operator.reviews import Reviews
from delfim.vehicle.orders.entrusting import payload_of
from delfim.vehicle.rehearsal import Rehearsal
from delfim.vehicle.report import LogFacts
from delfim.vehicle.state import StartConditions, State, StateLog

WATCHDOG_S = 0.1
HAND_S = 0.02  # a hand-set is read at most this often: two or three of its frames at once
PUBLISH_EVERY = 2  # watchdog ticks, to those who are not quick
MEASURE_EVERY = 5
MAINTAIN_EVERY = 10

words = logging.getLogger(__name__)  # `log` is the state log here


class Breakable(Protocol):
    """The faults that `delfim fault` can inject into this program; `delfim.simulator.realtime.fault_socket` has them."""

    @property
    def deaf(self) -> str | None: ...  # why the operator is not heard; None: he is
    def log(self, log: StateLog) -> StateLog: ...
    def guest(self, state: State, clock: Clock) -> Guest: ...


class BoatLinks(OpenedLinks):
    """The boat's links for as long as the service runs: what its lines receive is logged. A CAN bus has its black box
    elsewhere."""

    def __init__(self, runtime: Runtime, links: contextlib.ExitStack) -> None:
        super().__init__(runtime.config, runtime.clock, links)
        self._runtime, self._logs = runtime, list[LineLog]()
        self._lines = dict[AnyLine, bool]()  # whether its flood was told

    def line(self, device: str, baud: int, form: Form = "8N1") -> AnyLine:
        """A line of NMEA 0183 that cannot be opened now is tried again every second."""
        settings = self.settings
        log = LineLog(device, settings.log, self.clock)
        self.links.callback(log.close)
        waits = [name for name in settings.navigation.sources if parts.row(settings.aboard, name).waits]
        boards = (settings.table(name).device for name in waits)
        may_lack = device in {*(each for spare in settings.facts("spare") for each in spare), *boards}
        line = self.opened(device, baud, form, may_lack, log.heard)
        if not line.rebind():
            words.warning("%s: %s", device, line.trouble)
        self.links.enter_context(self._runtime.publishing(log.id, lambda: {"trouble": line.trouble} | log.report()))
        self._lines[line] = False
        self._logs.append(log)
        return line

    def write(self) -> None:
        for log in self._logs:
            log.write()

    def maintain(self) -> None:
        """Call about once a second."""
        for log in self._logs:
            log.poll()
        self.rebind()
        for line, was in self._lines.items():
            said = line.allowance.words
            if bool(said) != was:
                self._lines[line] = not was
                words.warning("%s: %s", line.device, said or "no more than it may say")


async def serve(runtime: Runtime) -> None:
    """The critical program as a service: opens its links, hands them to the loop, and stops the boat when it ends."""
    async with contextlib.AsyncExitStack() as last:
        await _sail(runtime, last)


async def _sail(runtime: Runtime, last: contextlib.AsyncExitStack) -> None:
    """Sail until the service ends. `last`: what takes its time at the end, when the boat has stopped and all links are
    closed."""
    settings, clock = runtime.config, runtime.clock
    with contextlib.ExitStack() as links:
        last_shutdown = _last_shutdown(Path(settings.log.directory), links)
        image = slots.present_notice(settings.runtime.run_directory)
        state = State(computer=StartConditions(runtime.is_starting(), last_shutdown, image))
        log = Logbook(settings, clock, words.log)
        links.callback(log.close)
        broken = _breakable(runtime, links)
        record_to, make_guest = (broken.log(log), broken.guest) if broken else (log, Guest)

        if settings.aboard:
            from delfim.vehicle.foreign import in_real_time  # other boats do without

            in_real_time()
        opened = BoatLinks(runtime, links)
        boat, inputs, hands, outlets = build(
            settings, clock, state, Links(opened.bus, opened.line, opened.gpio), record_to, make_guest
        )
        keeping = VoyageKeeping(settings, clock, boat)
        last.push_async_callback(keeping.close)
        links.callback(lambda: keeping.end(runtime.ends_in_order()))
        links.callback(runtime.leaves)
        links.callback(boat.helm.stop, "shutdown")  # undone first of all
        for source in boat.sources:
            links.enter_context(runtime.navigating(source.input.fileno(), partial(boat.on_navigation, source)))
            links.enter_context(runtime.publishing(settings.figures_of(source.name), partial(_figures, source, clock)))
        for part in parts.OWN.values():
            if part.output and settings.table(part.name).out:
                for name, teller in parts.load(part, part.output)(settings, opened.line, links, state, clock):
                    links.enter_context(runtime.ticking(teller.period_s, teller.tell))
                    links.enter_context(runtime.publishing(f"{part.name}.out.{name}", teller.report))
        for actuator in boat.propulsion.actuators:
            if actuator.period_s:
                links.enter_context(runtime.ticking(actuator.period_s, partial(boat.on_outlet, actuator)))
            if actuator.report():
                links.enter_context(runtime.publishing(actuator.name, actuator.report))
        if mirror := next(filter(None, (outlet.mirror() for outlet in outlets)), None):
            runtime.rehearsal(Rehearsal(boat, outlets, mirror))
            links.callback(runtime.rehearsal, None)
        for each in set(inputs).difference(hands):
            links.enter_context(runtime.reading(each.input.fileno(), partial(boat.on_sensor, each)))
        await _attend(runtime, boat, hands, log, keeping, opened, links, broken)


class BoatReporting:
    """The boat's report with the figures of the runtime and its services."""

    def __init__(self, runtime: Runtime, boat: VehicleLoop, log: Logbook) -> None:
        self._runtime, self._boat, self._log = runtime, boat, log
        self._board = dict[str, object]()
        self._figures: snapshot.Figures | None = None

    def measure(self) -> None:
        """Gather the figures. Not for each report, which would be a long callback."""
        runtime = self._runtime
        self._board |= {name: told() for name, told in runtime.board.items() if name not in runtime.status} | runtime.report()
        self._figures = None

    def report(self) -> bytes:
        """The report now, in JSON."""
        self._figures = figures = self._figures or snapshot.figures(self._board)  # for the first who asks, and those after
        log = LogFacts(**self._log.status()._asdict())
        told = self._boat.report(boat=self._runtime.config.boat.name, log=log, **figures.fields)
        return snapshot.in_json(told, figures.others)


async def _attend(
    runtime: Runtime,
    boat: VehicleLoop,
    hands: tuple[Hand, ...],
    log: Logbook,
    voyage: VoyageKeeping,
    opened: BoatLinks,
    links: contextlib.ExitStack,
    broken: Breakable | None,
) -> None:
    """Serve console and guest and the watchdog, until the service is cancelled."""
    settings, reporting = runtime.config, BoatReporting(runtime, boat, log)

    def obeyed(command: Commands, operator: str = LOCAL) -> str | None:
        deaf = broken.deaf if broken and operator not in aboard and not payload_of(operator) else None
        refused = deaf or boat.on_command(command, operator)
        reviews.hear(command, operator)
        if isinstance(command, ShutDown) and refused is None:
            powerd.ask(runtime, "reboot" if command.reboot else "off", "command of the console")
        log.command(command, refused, boat.state, operator, reviews.written(command))
        return refused

    mavlink = runtime.load("delfim.parts.mavlink.stationsocket") if settings.table("mavlink").enabled else None
    reviews, aboard = Reviews(boat, obeyed, asyncio.get_running_loop()), {hand.name for hand in hands}
    voyage.bring_back(obeyed, reviews)
    commands = CommandServer(obeyed, reviews, reporting.report, settings.console.clients)
    await _serve_console(commands, settings.console.socket, links)
    await _serve_guest(boat, settings.of(GuestTable), links)
    attend = _attended(runtime, boat, hands, obeyed, links)
    reporting.measure()
    ticks, computer, keeping = 0, boat.state.computer, _clock_keeping(runtime, opened, log)
    while True:
        await asyncio.sleep(WATCHDOG_S)
        ticks += 1
        computer = computer._replace(is_starting=runtime.is_starting())
        attend()
        boat.on_watchdog(computer)
        log.watch(boat.state)
        voyage.look()
        opened.write()
        if mavlink and mavlink.done():
            link, mavlink = mavlink.result().MavlinkLink, None
            with contextlib.suppress(OSError):  # a boat without this link sails; the reason is logged
                links.enter_context(link(boat, obeyed, reviews.begin, _stamps(settings), runtime.board))
        await asyncio.sleep(0)  # navigation has its turn between two parts of a tick
        commands.publish(everyone=ticks % PUBLISH_EVERY == 0)
        if ticks % MEASURE_EVERY == 1:
            await asyncio.sleep(0)
            reporting.measure()
        if ticks % MAINTAIN_EVERY == 0:
            log.poll()
            image = slots.present_notice(settings.runtime.run_directory) if computer.image else ""  # until somebody confirms it
            computer = computer._replace(image=image, clock=keeping.look(boat.state))
            opened.maintain()


def _attended(
    runtime: Runtime,
    boat: VehicleLoop,
    hands: tuple[Hand, ...],
    obey: Callable[[Commands, str], object],
    links: contextlib.ExitStack,
) -> Callable[[], None]:
    """Listen to operators aboard; call this ten times a second, for their silence is an order, too."""

    def attend(hand: Hand) -> None:
        boat.on_sensor(hand)
        for order in hand.orders(boat.state, runtime.clock.monotonic_s()):
            obey(order, hand.name)

    def attend_all() -> None:
        for hand in hands:
            attend(hand)

    for hand in hands:
        links.enter_context(runtime.reading(hand.input.fileno(), partial(attend, hand), HAND_S))
    return attend_all


def _clock_keeping(runtime: Runtime, opened: BoatLinks, log: Logbook) -> ClockKeeping:
    """Make the clock's keeper. The look at other programs takes milliseconds, which the service has while it starts."""
    settings = runtime.config
    why_not = kernel.left_alone(settings.clock.set, settings.buses)
    arb = time_frame(settings.can.vehicle)
    frames = opened.bus(settings.can.interface, (CanAddress(arb),))
    battery_ns = kernel.battery_ns()

    def stepped(by_s: float, source: str) -> None:
        log.event("clock step", value=by_s, source=source)

    return ClockKeeping(KernelClock(), runtime.clock, why_not, frames, stepped, battery_ns, arb)


def _stamps(settings: config.Vehicle) -> Path:
    """The path of the file with the time stamps of signed messages."""
    return Path(settings.log.directory) / "mavlink-stamps"


def _breakable(runtime: Runtime, links: contextlib.ExitStack) -> Breakable | None:
    """The faults that `delfim fault` can inject into this program. None at sea: nothing of it is loaded there."""
    if not runtime.config.of(Simulation).faults:
        return None
    from delfim.simulator.realtime.fault_socket import Aboard

    return links.enter_context(Aboard(runtime.config, runtime.clock))


def _last_shutdown(directory: Path, links: contextlib.ExitStack) -> str:
    """The fault at the end of the last run, in words: a mark stays among the logs if a run did not end in order."""
    mark = directory / "running"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        unclean = mark.exists()
        mark.touch()
    except OSError:  # no disk: the check of the log reports it
        return ""

    def ended() -> None:
        with contextlib.suppress(OSError):
            mark.unlink()

    links.callback(ended)
    return "the last run did not end in order: it crashed, or the power was cut" if unclean else ""


async def _serve_console(commands: CommandServer, path: str, links: contextlib.ExitStack) -> None:
    links.callback(commands.close)
    links.callback((await asyncio.get_running_loop().create_unix_server(commands.connection, _socket_path(path))).close)
    os.chmod(path, 0o660)


async def _serve_guest(boat: VehicleLoop, table: GuestTable, links: contextlib.ExitStack) -> None:
    """Listen for the guest. A boat without its guest sails: if it cannot listen or has no key, the log says so."""
    if not table.enabled:
        return
    try:
        door = GuestListener(table, boat.guest, boat.state, boat.clock)
        links.callback(door.close)
        links.callback((await asyncio.get_running_loop().create_server(door.visitor, *address(table.listen))).close)
    except ConfigError as error:
        words.error("guest: no guest can connect: %s", error)
    except OSError as error:
        words.error("guest: cannot listen on %s: %s", table.listen, error.strerror)


def _figures(source: Source, clock: Clock) -> dict[str, object]:
    return source.report(clock.monotonic_s())


def _socket_path(name: str) -> str:
    """The path for a new UNIX socket; the socket of a killed run is removed. Raises DelfimError when a vehicle is
    running there: two must not answer to one name."""
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with socket.socket(socket.AF_UNIX) as knock:
        if knock.connect_ex(name) == 0:
            raise DelfimError(f"another vehicle already answers on {name}: end it first")
    path.unlink(missing_ok=True)
    return name
