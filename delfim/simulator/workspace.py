"""The workspace of a simulated boat: its number, folder, bus, ports and boat's number, none of them shared with another one.

The first simulation of a computer uses the values of the vehicle's file. The next have numbers: a folder `run/sim-2`, a bus
`canloop:can0-2`, ports ten above. A port that another program uses is skipped. A value that the operator gave is taken
as it is.
"""

import contextlib
import errno
import json
import os
import re
import select
import socket
from collections.abc import Collection, Iterator
from itertools import count
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from delfim import config
from delfim.base import tables
from delfim.base.errors import DelfimError
from delfim.base.pulses import CHANNELS
from delfim.base.ranges import address, is_loopback
from delfim.canproxy.tables import Cantcpd, Routing
from delfim.logging.blackbox import device
from delfim.logging.kept.writer import VOYAGE
from delfim.simulator.nodes.talkers import BOARD, on_lines
from delfim.simulator.tables import Simulation

SIMULATED: Final = "run/sim"  # the folder of the first one
NUMBERS: Final = 20  # simulations on one computer at most
PORTS: Final = 10  # distance between the ports of two simulations
PAGE, BOATS = "127.0.0.1:8765", "127.0.0.1:14550"  # of the console, where it is free
RADIOS = ("mavlink.key", "mavlink.serial", "slipd.device")
SIMULATED_PULSES: Final = {"pwm.arm_s": "0.5", "pwm.channel": "{}", "pwm.telemetry": "{}"}  # of ESCs that tell nothing
HANDS: Final = ("handset.device", "kill.chip", "kill.line", "pwm.cut.chip", "pwm.cut.line")  # none of the real boat's


class Workspace:
    """The resources of one simulation."""

    def __init__(self, number: int, folder: Path) -> None:
        self.number, self.folder = number, folder
        self._given = set[tuple[str, int, int]]()

    def address(self, wanted: str, *, udp: bool = False) -> str:
        """An address that is free, at or above the wanted one; port 0 is left to the system."""
        host, _, text = wanted.rpartition(":")
        kind = socket.SOCK_DGRAM if udp else socket.SOCK_STREAM
        first = int(text) + (self.number - 1) * PORTS
        for port in range(first, min(first + PORTS, 1 << 16)) if text != "0" else ():
            if (host, port, kind) not in self._given and _is_free(host.strip("[]"), port, kind):
                self._given.add((host, port, kind))
                return f"{host}:{port}"
        return wanted

    def interface(self, wanted: str) -> str:
        """The bus of this simulation; a kernel interface keeps its name."""
        return f"{wanted}-{self.number}" if self.number > 1 and wanted.startswith("canloop:") else wanted


OWN_PLACES: Final = {f"{name}.{key}" for name in ("ftpd", "sshd") for key in ("root", "listen")} | {
    "httpd.listen",
    "sshd.host_key",
}
HEEDED: Final = {  # of the settings below, those into which what the operator set has gone already
    *("boat.id", "guest.listen", "mavlink.listen", "cantcpd.listen", "cantcpd.slcan", "thrusters", "handset.mandatory"),
    *("simulation.faults", "runtime.fifo_priority"),
}


class WorkspaceSettings(NamedTuple):
    """The overrides of a simulated boat's file, and the part of them that is shown."""

    overrides: list[str]
    boat_id: int
    page: str  # of the boat
    world: list[str]  # what the nodes have instead, where the boat in the water is another one
    moved: list[
        str
    ]  # what the boat tells other instruments, and is told by its pilot, and where it is in place of the real ports


@contextlib.contextmanager
def workspace(folder: str | None) -> Iterator[Workspace]:
    """Hold the next free workspace as long as the context lasts; in this folder, or in one named by its number. Raises
    DelfimError if another simulation has the folder, or if the boat's programs cannot run on this system."""
    if not hasattr(select, "epoll"):
        raise DelfimError("in real time the boat's own programs run, and need Linux (on Windows: WSL 2); --lockstep sails here")
    with contextlib.ExitStack() as held:
        for number in count(1):
            if number > NUMBERS:
                raise DelfimError(f"{NUMBERS} simulations run on this computer already")
            with contextlib.ExitStack() as tried:
                if not tried.enter_context(_numbered(number)):
                    continue
                place = Path(folder or (SIMULATED if number == 1 else f"{SIMULATED}-{number}"))
                if not tried.enter_context(_locked(place)):
                    if folder is not None:
                        raise DelfimError(f"--output {folder}: another simulation runs there; name another folder")
                    continue
                held.enter_context(tried.pop_all())
                break
        for each in (*place.glob(f"{VOYAGE}-*"), *(place / "log").glob(f"{VOYAGE}-*")):
            each.unlink()  # a simulation is a voyage of its own
        yield Workspace(number, place)


def settings_of(
    vehicle: config.Vehicle, its: Workspace, named: Collection[str], truth: config.Vehicle | None = None
) -> WorkspaceSettings:
    """The overrides with which a boat sails in simulation. `named` are the keys that the operator set, `truth` is the boat in
    the water, of which its programs do not know. Raises DelfimError."""
    place, simulation = its.folder.resolve(), vehicle.of(Simulation)

    def free(key: str, wanted: str, *, udp: bool = False) -> str:
        return wanted if key in named else its.address(wanted, udp=udp)

    def several(key: str, wanted: Collection[str]) -> str:
        return f"[{', '.join(_quoted(free(key, each)) for each in wanted)}]"

    bus = simulation.interface if "simulation.interface" in named else its.interface(simulation.interface)
    is_loop = bus.startswith("canloop:")
    loop = bus if is_loop else its.interface(f"canloop:{device(bus)}")  # no motor of a real bus turns
    boat_id = vehicle.boat.id if "boat.id" in named else (vehicle.boat.id + its.number - 2) % 249 + 1
    page = free("simulation.httpd", simulation.httpd)
    texts = {
        "can.interface": bus,
        **({"nmea2000.interface": f"{bus}-nmea2000"} if is_loop else {}),
        **{f"{name}.interface": f"{loop}-{name}" for name in _on_buses(vehicle)},
        **{f"routing.buses.{name}.interface": f"{bus}-{name}" for name in (vehicle.of(Routing).buses if is_loop else ())},
        "console.socket": f"{place}/command",
        "log.directory": f"{place}/log",
        "runtime.run_directory": str(place),
        "supervisor.hardware_watchdog": "",
        **_instruments(vehicle, its),
        **_of_parts(vehicle, place, loop),
        **_beside(vehicle, its),
        **{key: text for key, text in (_cameras(vehicle) | _without(vehicle, named)).items() if key not in named},
        "guest.listen": free("guest.listen", vehicle.table("guest").listen),
        "mavlink.listen": free("mavlink.listen", vehicle.table("mavlink").listen, udp=True),
        "httpd.listen": page,
        "ftpd.listen": free("simulation.ftpd", simulation.ftpd),
        "ftpd.root": f"{place}/log",
        "sshd.listen": free("simulation.sshd", simulation.sshd),
        "sshd.root": f"{place}/log",
        "sshd.host_key": f"{place}/ssh_host_ed25519",
    }
    values = {
        "boat.id": str(boat_id),
        **{f"cantcpd.{key}": several(f"cantcpd.{key}", getattr(vehicle.of(Cantcpd), key)) for key in ("listen", "slcan")},
        "runtime.fifo_priority": "0",
        **({} if "handset.device" in named else {"handset.mandatory": "false"}),
        "simulation.faults": "true",
        **_lookouts(vehicle, place),
        **({} if truth or "adopted.proven" in named else {"adopted.proven": "true"}),  # its motors are those of the file
    }
    given = tuple(f"{key}." for key in named)  # a table is given with all its keys
    texts = {key: text for key, text in texts.items() if not (key.startswith("nmea0183.") and f"{key}.".startswith(given))}
    if vehicle.driven("played", False):
        texts["pwm.chip"] = f"{place}/pwmchip0"
        values |= SIMULATED_PULSES | {"thrusters": tables.inline(_by_pulses(vehicle, truth))}
    texts = {key: text for key, text in texts.items() if not (key in OWN_PLACES and key in named)}
    if own := sorted({*texts, *values}.intersection(named) - HEEDED):
        raise DelfimError(f"--set {own[0]}: each simulation has its own; --output DIRECTORY names its folder")
    overrides = [f"{key}={_quoted(text)}" for key, text in texts.items()] + [f"{key}={value}" for key, value in values.items()]
    moved = [f"{key} is {texts[key]}" for key in _beside(vehicle, its) if key in texts]
    return WorkspaceSettings(overrides, boat_id, page, _world(truth), moved)


def _world(truth: config.Vehicle | None) -> list[str]:
    """What the nodes have instead, where this is the boat in the water."""
    if truth is None or not truth.driven("played", False):
        return []
    return [f"thrusters={tables.inline(_by_pulses(truth))}"]


def _lookouts(vehicle: config.Vehicle, place: Path) -> dict[str, str]:
    """The programs of simulated look-outs: each copies out what its pipe brings."""
    rows = vehicle.of(Simulation).things.lookout
    return {f"payload.{row.payload}.command": f'["/bin/cat", "{place}/lookout-{row.payload}"]' for row in rows}


def _cameras(vehicle: config.Vehicle) -> dict[str, str]:
    """Each camera is played."""
    sources = {"source": "test", "credentials": ""}
    return {f"camera.{name}.{key}": text for name in vehicle.table("camera") for key, text in sources.items()}


def _without(vehicle: config.Vehicle, named: Collection[str]) -> dict[str, str]:
    """What a simulated boat does not have."""
    return dict.fromkeys((*RADIOS, *HANDS, *_corrected(vehicle), *_shared(vehicle, named)), "")


def _on_buses(vehicle: config.Vehicle) -> list[str]:
    """The tables of motors and sensors that have a bus of their own."""
    motors = [name for name in vehicle.drivers if hasattr(vehicle.table(name), "interface")]
    return motors + (["dronecan"] if "dronecan" in (*vehicle.navigation.sources, *vehicle.sensors.names) else [])


def _instruments(vehicle: config.Vehicle, its: Workspace) -> dict[str, str]:
    """Where instruments on lines are played, and a board that tells the position; its motors are told by pulses here."""
    ports = {f"nmea0183.ports.{name}": (name, port) for name, port in vehicle.table("nmea0183").ports.items()}
    boards = {BOARD: ("board", vehicle.table(BOARD))} if BOARD in vehicle.navigation.sources else {}
    return {f"{key}.device": _device(name, table.device, its) for key, (name, table) in (ports | boards).items()}


def _of_parts(vehicle: config.Vehicle, place: Path, loop: str) -> dict[str, str]:
    """The overrides for the devices of parts: none of them is a real one."""
    tables = [(part.name, vehicle.table(part.name)) for part in on_lines(vehicle) if part.table is not None]
    lines = {f"{name}.device": f"{place}/{name}" for name, table in tables if hasattr(table, "device")}
    return lines | {f"{name}.interface": f"{loop}-{name}" for name, table in tables if hasattr(table, "interface")}


def _beside(vehicle: config.Vehicle, its: Workspace) -> dict[str, str]:
    """The overrides for outputs of navigation, and for lines on which a pilot steers the boat. A simulated position on a real
    bridge, or a real plotter that steers a simulated boat, would deceive somebody. On this computer the datagrams' own port
    stays."""
    outs = {f"nmea0183.out.{name}.to": (f"out-{name}", out.to) for name, out in vehicle.table("nmea0183").out.items()}
    pilot = {"nmea0183.guest.device": ("guest", vehicle.table("nmea0183").guest.device)}
    return {key: _device(name, to, its) for key, (name, to) in {**outs, **pilot}.items() if not _is_here(to)}


def _is_here(place: str) -> bool:
    """Whether it is nowhere, or an address of this computer."""
    return not place or (not place.startswith("/") and is_loopback(place.partition(":")[2]))


def _corrected(vehicle: config.Vehicle) -> tuple[str, ...]:
    """The sources of corrections, for a receiver that is none of the boat's simulated ports."""
    to = vehicle.table("corrections").to
    return (
        ()
        if to in vehicle.table("nmea0183").ports or _is_here(to)
        else ("corrections.to", "corrections.caster", "corrections.credentials")
    )


def _shared(vehicle: config.Vehicle, named: Collection[str]) -> Iterator[str]:
    """The overrides for the fleet's broker, the boat's own page and a ROS 2 elsewhere: whoever looks there would take the
    simulated boat for the real one of its name."""
    if "fleet.broker" not in named:
        yield from ("fleet.broker", "fleet.credentials", "fleet.authorities")
    if "tablet.listen" not in named:
        yield "tablet.listen"
    if not _is_here(vehicle.table("ros").router.replace("/", ":", 1)):
        yield "ros.router"


def _device(name: str, device: str, its: Workspace) -> str:
    """The device where a simulated instrument is heard: the real port, or the network, is left alone."""
    if device.startswith("/"):
        return f"{its.folder.resolve()}/nmea0183-{name}"
    kind, _, place = device.replace("gpsd:", "tcp:").partition(":")
    return f"{kind}:{its.address(f'127.0.0.1:{address(place)[1]}', udp=kind == 'udp')}"


def _turned(told: config.Steer, true: config.Steer) -> dict[str, Any]:
    """How a servo is to be told for a simulated one that is straight and not reversed."""
    way, _, _ = true.as_told
    return {"reversed": told.reversed != true.reversed, "middle_deg": way * (told.middle_deg - true.middle_deg)}


def _by_pulses(vehicle: config.Vehicle, truth: config.Vehicle | None = None) -> list[Any]:
    """The rows, with motors whose devices are not simulated driven by pulses, which `parts/pwm/sim.py` reads. Each reaches the
    motor of its driver and address in the truth, which may turn the other way. Raises DelfimError for more of them than there
    are channels, and where the truth has no such motor."""
    channels, told = count(), list[Any]()
    motors = (
        {(row.driver, row.address): (row, one) for row, one in zip(truth.thrusters, _by_pulses(truth), strict=True)}
        if truth
        else {}
    )
    for row in vehicle.thrusters:
        one = msgspec.to_builtins(row)
        if truth is not None and not vehicle.drives(row).played:
            if (row.driver, row.address) not in motors:
                raise DelfimError(f"the boat in the water has no motor of driver {row.driver}, address {row.address}")
            motor, its = motors[row.driver, row.address]
            one |= {key: its[key] for key in ("driver", "address", "steer")} | {"reversed": row.reversed != motor.reversed}
            if row.steer is not None and motor.steer is not None:
                one["steer"] = its["steer"] | _turned(row.steer, motor.steer)
        elif not vehicle.drives(row).played:
            one |= {"driver": "pwm", "address": next(channels), "reversed": False}
            one |= {"steer": one["steer"] | _turned(row.steer, row.steer) | {"address": next(channels)}} if row.steer else {}
        told.append(one)
    if next(channels) > CHANNELS:
        raise DelfimError(f"a simulation has {CHANNELS} channels for motors and what turns them: these thrusters need more")
    return told


def found(folder: str | None) -> Path:
    """The folder of the running simulation. Raises DelfimError if several run and none was named."""
    if folder is not None:
        return Path(folder)
    running = [place for place in folders() if _answers(place / "command")]
    if len(running) > 1:
        raise DelfimError(f"simulations run in {' and '.join(map(str, running))}: choose one: --sim-in {running[-1]}")
    return running[0] if running else Path(SIMULATED)


def folders() -> list[Path]:
    """The folders of all simulations below this one, running or not."""
    there = [place for place in Path(SIMULATED).parent.glob("sim*") if re.fullmatch("sim(-[0-9]+)?", place.name)]
    return sorted(there, key=lambda place: (len(place.name), place.name))


@contextlib.contextmanager
def _numbered(number: int) -> Iterator[bool]:
    """Take a number; returns whether it was free. It is a name in this computer's network namespace, released when the program
    ends."""
    with socket.socket(socket.AF_UNIX) as name:
        try:
            name.bind(f"\0delfim simulation {number}")
        except OSError:
            yield False
            return
        yield True


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Make and lock the folder; returns whether it is free. Raises OSError."""
    import fcntl  # not on Windows, where only lock step sails

    folder.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder / "lock", os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield True
    except BlockingIOError:
        yield False
    finally:
        os.close(handle)


def _is_free(host: str, port: int, kind: int) -> bool:
    """Whether the port is free. Other faults of the address are reported by its user."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, kind) as door:
        if kind == socket.SOCK_STREAM:
            door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # lingering connections do not occupy the port
        try:
            door.bind((host, port))
        except OSError as error:
            return error.errno != errno.EADDRINUSE
        return True


def _answers(path: Path) -> bool:
    if not path.is_socket():
        return False
    with socket.socket(socket.AF_UNIX) as knock:
        return knock.connect_ex(str(path)) == 0


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # as TOML has it
