"""The other nodes of the boat (thesis figure 3-2) around a model, one file for each kind, named in NODES; beside them those of
OTHER_BUSES, and the devices of parts, named by their rows.

Every node is a clocked object without socket or task: `step(now_s, utc_ns)` returns the frames that it puts on the bus now,
`feed(frame, now_s)` hands it a frame, `due_s` is when it sends next. `now_s` is monotonic and never goes back.
"""

from importlib import import_module
from operator import itemgetter
from typing import Final, Protocol, runtime_checkable

from delfim import config
from delfim.base import parts
from delfim.base.frames import Frame
from delfim.canproxy.socket import CanAddress
from delfim.simulator.measured import model_of
from delfim.simulator.model import Model
from delfim.simulator.nodes.cansensors import CanSensors
from delfim.simulator.nodes.devices import Devices
from delfim.simulator.nodes.lookouts import Surroundings, surroundings_of
from delfim.simulator.nodes.navigation import NavigationNode
from delfim.simulator.nodes.other_vessels import Shipping
from delfim.simulator.nodes.talkers import SimulatedInstruments, instruments_of
from delfim.simulator.seabed import bed_of
from delfim.simulator.tables import Simulation

NODES: Final = ("gps", "navigation", "propeller", "batteries")  # files of this folder, with `nodes` in each
OTHER_BUSES: Final = ("devices", "cansensors", "sounders", "other_vessels")  # files for other buses, with `devices_of` in each
_ARBITRATION: Final = itemgetter(0)
STALL_S: Final = 1.0  # longer pauses of the whole simulator are left out of the modelled world


class SimulatedNode(Protocol):
    @property
    def hears(self) -> tuple[int, ...]: ...  # arbitration fields of the frames that it is fed
    @property
    def due_s(self) -> float: ...
    def feed(self, frame: Frame, now_s: float) -> None: ...
    def step(self, now_s: float, utc_ns: int) -> list[Frame]: ...


class BusDevices(Protocol):
    """The devices of a bus beside that of the nodes."""

    interface: str  # as the vehicle's file names it
    hears: tuple[CanAddress, ...]  # empty: they do not listen

    @property
    def due_s(self) -> float: ...
    def feed(self, frame: Frame, now_s: float) -> None: ...
    def step(self, now_s: float, utc_ns: int) -> list[Frame]: ...  # the model was advanced by the nodes


@runtime_checkable
class Reporting(Protocol):
    """A node that reports its health, which a fault may change."""

    bad: bool
    silent: bool


class Nodes:
    """All nodes of a boat around one model, which they advance; the devices of other buses, the instruments on lines and what
    stands in the water are stepped by the caller."""

    def __init__(
        self,
        model: Model,
        named: dict[str, SimulatedNode],
        beside: tuple[BusDevices, ...] = (),
        instruments: SimulatedInstruments | None = None,
        surroundings: Surroundings | None = None,
    ) -> None:
        self.model, self.named, self.beside, self.instruments = model, named, beside, instruments
        self.surroundings, self.things = surroundings, surroundings.things if surroundings else []
        self.shipping = next((each for each in beside if isinstance(each, Shipping)), None)
        self.vessels = self.shipping.vessels if self.shipping else []  # other vessels
        devices = [each for each in beside if isinstance(each, Devices | CanSensors)]
        self.receivers = [each.receiver for each in devices] + (instruments.receivers if instruments else [])
        self.compasses = [each.compass for each in devices] + (instruments.compasses if instruments else [])
        navigation = named["navigation"]
        assert isinstance(navigation, NavigationNode)
        self.navigation = navigation
        self.sensors: dict[str, Reporting] = {name: node for name, node in named.items() if isinstance(node, Reporting)}
        self._hearing = dict[int, list[SimulatedNode]]()
        for node in named.values():
            for arb in node.hears:
                self._hearing.setdefault(arb, []).append(node)
        self._stepped_s: float | None = None

    @property
    def hears(self) -> tuple[CanAddress, ...]:
        """The filters of a socket that serves the nodes."""
        return tuple(map(CanAddress, self._hearing))

    @property
    def due_s(self) -> float:
        """The time when `step` is due next."""
        return min(node.due_s for node in self.named.values())

    def feed(self, frame: Frame, now_s: float) -> None:
        """Feed a frame of the bus to its nodes."""
        for node in self._hearing.get(frame.arb, ()):
            node.feed(frame, now_s)

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        """Advance the world to `now_s`; returns the frames that the nodes send then, in order of arbitration."""
        if self._stepped_s is not None and now_s > self._stepped_s:
            self.model.advance(min(now_s - self._stepped_s, STALL_S))
        self._stepped_s = now_s
        frames = [frame for node in self.named.values() for frame in node.step(now_s, utc_ns)]
        frames.sort(key=_ARBITRATION)
        return frames


def nodes_of(settings: config.Vehicle, seed: int, model: Model | None = None) -> Nodes:
    """The nodes that a vehicle's file describes, around its model or another one."""
    model = model_of(settings, seed) if model is None else model
    model.bed = bed_of(settings.of(Simulation))
    own = (part for part in parts.OWN.values() if part.name in settings.drivers)
    of_parts = [parts.load(part, part.played) for part in (*own, *settings.aboard) if part.played]
    *first, last = (import_module(f"{__name__}.{kind}") for kind in NODES)
    named = dict[str, SimulatedNode]()
    for each in (*first, *(each for each in of_parts if hasattr(each, "nodes")), last):  # batteries: all others draw from them
        named |= each.nodes(settings, model, seed)
    others = (import_module(f"{__name__}.{kind}").devices_of(settings, model, seed) for kind in OTHER_BUSES)
    on_buses = (each.devices_of(settings, model, seed) for each in of_parts if hasattr(each, "devices_of"))
    on_several = (one for each in of_parts if hasattr(each, "buses_of") for one in each.buses_of(settings, model, seed))
    beside = tuple(each for each in (*others, *on_buses, *on_several) if each is not None)
    shipping = next((each for each in beside if isinstance(each, Shipping)), None)
    around = surroundings_of(settings, model, seed, shipping.vessels if shipping else ())
    ais = shipping.sentences if shipping else None
    instruments = instruments_of(settings, model, seed, ais, around.radars if around else ())
    return Nodes(model, named, beside, instruments, around)
