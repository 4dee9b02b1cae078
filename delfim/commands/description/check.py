"""`delfim check`: lists the faults of a vehicle's file, and the devices and files it names that this computer lacks."""

import argparse
import contextlib
import importlib.util
import math
import os
import shutil
import sys
from collections.abc import Iterator
from ipaddress import IPv4Interface, ip_network
from pathlib import Path

from delfim import config
from delfim.base.ranges import NETWORKED
from delfim.canproxy.tables import Canip, Cantcpd
from delfim.commands import example_file
from delfim.parts.nmea2000.table import Nmea2000
from delfim.services.tables import GuestTable, Slipd
from delfim.simulator.tables import Simulation

TOLD = 50  # faults listed for one file


def options(parser: argparse.ArgumentParser) -> None:
    example_file(parser)
    parser.add_argument(
        "--sea",
        action="store_true",
        help="List who may do what from where; refuse what lets a stranger move the boat or write.",
    )


def run(asked: argparse.Namespace) -> int:
    """Run the command. Returns 2 if the file has faults, 1 if the boat must not go to sea with it. A warning is neither:
    another computer may have the device that this one lacks."""
    from delfim.base import tables
    from delfim.services.suite import services

    tree = tables.read_toml(asked.file, asked.set)
    wrong = list(tables.complaints(tree, config.kind_of(tree, asked.file), asked.file))
    if len(wrong) > 1:
        print(f"delfim: {asked.file}: {len(wrong)} things are wrong:", file=sys.stderr)
        print(*(f"  {str(each).removeprefix(f'{asked.file}: ')}" for each in wrong[:TOLD]), sep="\n", file=sys.stderr)
        return 2
    vehicle = config.load(asked.file, asked.set)
    running = [row.name for row in services(vehicle)]
    for doubt in _doubts(asked.file, vehicle):
        print(f"delfim: warning: {doubt}", file=sys.stderr)
    if asked.sea and _at_sea(vehicle, running):
        return 1
    if vehicle.of(Nmea2000).joins and "nmea2000d" in running:
        print(_sent_messages(vehicle))
    print(f"{asked.file}: {vehicle.boat.name}: nothing is wrong with this file")
    return 0


def _sent_messages(vehicle: config.Vehicle) -> str:
    """The messages that the boat sends as a device of its NMEA 2000 bus."""
    from delfim.canproxy.nmea2000.device import device_name, facts_of
    from delfim.parts.nmea2000.nmea2000rows import pgns_of

    table = vehicle.of(Nmea2000)
    rows = [f"{name} ({', '.join(map(str, pgns_of((name,))))})" for name in table.send]
    sent = f"sends {', '.join(rows)}" if rows else "sends nothing but who it is"
    return f"{table.interface}: NMEA 2000 device {device_name(facts_of(vehicle).unique):016x} {sent}"


def _at_sea(vehicle: config.Vehicle, running: list[str]) -> bool:
    """Print the boat's listeners; returns whether it must not go to sea with them."""
    from delfim.services.access.exposure import doors, unheard

    found = doors(vehicle, running)
    titles = {"anyone": "Open to anyone:", "known": "Behind a key or a password:", "here": "On this computer alone:"}
    for reach, title in titles.items():
        rows = [f"  {door.service:8} {door.place:24} {door.who}: {door.may}" for door in found if door.reach == reach]
        print(title, *(rows or ["  nothing"]), sep="\n")
    if reason := unheard(vehicle):
        print(f"delfim: warning: no console can reach this boat: {reason}", file=sys.stderr)
    faults = [door.fault for door in found if door.fault]
    if faults:
        print("delfim: the boat must not go to sea like this:", *(f"  {fault}" for fault in faults), sep="\n", file=sys.stderr)
    return bool(faults)


def _doubts(file: str, vehicle: config.Vehicle) -> Iterator[str]:
    """The devices and files that the file names and this computer lacks, in words. Raises ConfigError for a chart that is not
    whole, or for another boat."""
    from delfim.base.cooperative import Sliced
    from delfim.base.errors import ConfigError, Refused
    from delfim.base.geodesy import origin
    from delfim.vehicle.helm.planning import laid
    from delfim.vehicle.plans.clearancefile import load
    from delfim.vehicle.plans.mission import load_mission

    for key, bus in vehicle.outside("interface").items():
        if ":" not in bus and not Path("/sys/class/net", bus).exists():
            without = '; a boat without a bus says "canloop:nodes"' if key == "can.interface" else ""
            yield f"{key}: this computer has no {bus}; the boat needs it, `delfim sim` does not{without}"
    yield from (doubt for doubts in vehicle.facts("doubts") for doubt in doubts)
    if vehicle.of(Canip).enabled and vehicle.of(Canip).address:
        yield from _on_the_bus(vehicle)
    files = {key: path for named in vehicle.facts("files") for key, path in named.items()} | {"kill.chip": vehicle.kill.chip}
    files |= {"slipd.device": vehicle.of(Slipd).device} | vehicle.outside("device")
    for key, path in files.items():
        if path and not path.startswith(NETWORKED) and not Path(path).exists():
            yield f"{key}: there is no file {path} on this computer"
    if not vehicle.adopted.proven:
        yield "adopted.proven: the motors are not proven: manual and trial only, and a failsafe stops; delfim adopt finds them"
    for name, payload in vehicle.table("payload").items():
        if not os.access(payload.command[0], os.X_OK):
            yield f"payload.{name}.command: there is no program {payload.command[0]} on this computer"
    yield from _without_pictures(vehicle)
    if vehicle.of(Simulation).traffic.vessel and not _hears(vehicle):
        yield "simulation.traffic: she hears none of these vessels: AIS comes by NMEA 2000, sensors.names has no nmea2000"
    named, chart = vehicle.fence.chart, None
    if named and not Path(named).exists():
        yield f"fence.chart: there is no file {named} on this computer"
    elif named:
        chart = load(vehicle)
    if vehicle.of(Simulation).mission:
        try:
            mission = load_mission(config.mission_place(file, vehicle))
            first = mission.waypoint[0]
            at = origin(math.radians(first.latitude_deg), math.radians(first.longitude_deg))
            if chart is not None:
                Sliced(laid(mission, at, vehicle.control, vehicle.fence, chart=chart)).finish()
        except ConfigError as error:
            yield str(error)
        except Refused as error:
            yield f"simulation.mission: {error}"


def _hears(vehicle: config.Vehicle) -> bool:
    """Whether what tells of the simulated vessels reaches her."""
    read = {*vehicle.navigation.sources, *vehicle.sensors.names}
    instruments = {each.rpartition(":")[2] for each in vehicle.of(Simulation).instruments} or {"ais"}  # all, on one port
    has_ais = "nmea2000" in read or ("nmea0183" in read and not instruments.isdisjoint(("ais", "radar")))
    return has_ais or bool(vehicle.of(Simulation).things.lookout)


def _without_pictures(vehicle: config.Vehicle) -> Iterator[str]:
    """The cameras that this computer cannot show, or not by WebRTC, with what it lacks."""
    for name, camera in vehicle.table("camera").items():
        if camera.source.startswith("/dev/") and not Path(camera.source).exists():
            yield f"camera.{name}.source: there is no {camera.source} on this computer"
        if camera.source != "test" and shutil.which("ffmpeg") is None:
            yield f"camera.{name}.source: pictures of {camera.source} need the program ffmpeg, which this computer lacks"
        if camera.webrtc and importlib.util.find_spec("aiortc") is None:
            yield f"camera.{name}.webrtc: only stills, for aiortc is not installed: pip install 'delfim[webrtc]'"


def _on_the_bus(vehicle: config.Vehicle) -> Iterator[str]:
    """The addresses of the file that the network of canip takes from all others: what is sent to them goes onto the bus."""
    bus = IPv4Interface(vehicle.of(Canip).address).network
    radio = vehicle.of(Slipd)
    named = {"guest.networks": vehicle.of(GuestTable).networks if vehicle.of(GuestTable).enabled else ()}
    named |= {"cantcpd.watch": vehicle.of(Cantcpd).watch}
    named |= {key: places for told in vehicle.facts("addresses") for key, places in told.items()}
    named |= {"slipd.peer": (radio.peer,) if radio.device else ()}
    for key, places in named.items():
        for place in places:
            with contextlib.suppress(ValueError):  # a name of a host, or IPv6
                if bus.overlaps(ip_network(place)):
                    yield f"canip.address: its network {bus} has {place} of {key}, too: answers to it go onto the bus"
