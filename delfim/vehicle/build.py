"""The boat put together, for the runtime, lock step, replay, warm-up and tests; each hands in its clock, links and log."""

from collections.abc import Callable
from operator import attrgetter
from typing import NamedTuple, Protocol, cast

from delfim import config
from delfim.base.clock import Clock
from delfim.base.parts import OWN, Part, load
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.lines.forms import Form
from delfim.vehicle.aboard import Added, Hand, OpenedWith, PartWatch
from delfim.vehicle.control.control import MODES
from delfim.vehicle.failsafe.troubles import PartTrigger
from delfim.vehicle.grex import Guest
from delfim.vehicle.links import Links, LoopInput, ReadableLine, SecondEnd
from delfim.vehicle.loop import VehicleLoop
from delfim.vehicle.navigation.estimated import between
from delfim.vehicle.navigation.fixes import open_sources
from delfim.vehicle.propulsion.actuators import open_actuator
from delfim.vehicle.propulsion.propulsion import Propulsion
from delfim.vehicle.sensors import open_sensors
from delfim.vehicle.state import State, StateLog


class SharingSource(Protocol):
    """A source whose line carries the motors of the same board, too."""

    device: str

    def share(self) -> SecondEnd: ...
    def hand_on_to(self, inputs: tuple[LoopInput, ...]) -> None: ...  # these read it


class Built(NamedTuple):
    """The vehicle, its inputs beside navigation, and the sockets by which it sends."""

    vehicle: VehicleLoop
    inputs: tuple[LoopInput, ...]  # sensors, reports of actuators, a guest's line, AIS; readable: `vehicle.on_sensor`
    hands: tuple[Hand, ...]  # operators aboard, who are among the inputs: their orders go to `vehicle.on_command`
    outlets: tuple[CanSocket, ...]  # of the actuators


def build(
    settings: config.Vehicle,
    clock: Clock,
    state: State,
    links: Links,
    log: StateLog,
    make_guest: Callable[[State, Clock], Guest] = Guest,
) -> Built:
    """The vehicle of this file. Its sources are `vehicle.sources`. Raises DelfimError where an input cannot be opened."""
    sources = open_sources(settings, links, state)
    if settings.aboard:
        from delfim.vehicle import foreign  # other boats do without

        MODES.update(foreign.programs(settings))
        sources = foreign.sources(settings, sources, state)
    opened = list[object](sources)
    board = next((cast(SharingSource, each) for each in sources if hasattr(each, "share")), None)
    if settings.navigation.estimator:
        sources = between(sources, settings, state)
    readings: tuple[LoopInput, ...] = open_sensors(settings, links)
    if settings.aboard:
        readings = foreign.sensors(settings, readings, state)
    outlets = list[CanSocket]()

    def outlet(interface: str, filters: tuple[CanAddress, ...]) -> CanSocket:
        outlets.append(links.bus(interface, filters))
        return outlets[-1]

    def line(device: str, baud: int, form: Form = "8N1") -> ReadableLine:
        return board.share() if board is not None and board.device == device else links.line(device, baud, form)

    to_actuators = links._replace(bus=outlet, line=line)
    actuators = tuple(open_actuator(name, settings, to_actuators) for name in settings.drivers)
    if settings.aboard:
        actuators = foreign.actuators(settings, actuators, state)
    for each in actuators:
        if hasattr(each, "begin"):  # its motors turn only once they were heard
            each.begin(state, clock.monotonic_s())
    propulsion = Propulsion(actuators, links.bus(settings.can.interface, ()), settings.thrusters, state)
    guest = make_guest(state, clock)
    aboard = tuple(opened_part(part, OpenedWith(settings, clock, state, links, log, guest)) for part in fitted(settings))
    watches = tuple(each.watch for each in aboard if each.watch is not None)
    watches += tuple(cast(PartWatch, each) for each in readings if hasattr(each, "look"))
    MODES.load()
    vehicle = VehicleLoop(settings, clock, state, sources, propulsion, guest, log, watches, triggers(settings))
    if settings.aboard:
        vehicle.helm.orders.update(foreign.orders(settings, state, [*opened, *readings, *actuators]))
    told = [each for actuator in actuators for each in actuator.inputs]
    reports = [each for each in told if not isinstance(each.input, SecondEnd)]
    if board is not None:
        board.hand_on_to(tuple(each for each in told if isinstance(each.input, SecondEnd)))
    hands = tuple(each for part in aboard for each in part.hands)
    reports += [each for part in aboard for each in part.inputs]
    return Built(vehicle, (*readings, *hands, *reports), hands, tuple(outlets))


def fitted(settings: config.Vehicle) -> tuple[Part, ...]:
    """The parts of the boat's own that take part in the loop, where the vehicle's file has them."""
    return tuple(part for part in OWN.values() if part.aboard and any(attrgetter(key)(settings) for key in part.keys))


def opened_part(part: Part, boat: OpenedWith) -> Added:
    """Raises DelfimError."""
    aboard: Added = load(part, part.aboard)(boat)
    return aboard


def triggers(settings: config.Vehicle) -> tuple[PartTrigger, ...]:
    """The troubles of the parts, the boat's own and a laboratory's. Raises PermanentFailure where one cannot be imported."""
    own = [PartTrigger(row, load(part, row.sees)) for part in fitted(settings) for row in part.troubles]
    if settings.aboard:
        from delfim.vehicle import foreign

        own += foreign.triggers(settings)
    return tuple(own)
