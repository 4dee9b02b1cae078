"""`delfim check`: lists the faults of a vehicle's file, and the devices and files it names that this computer lacks."""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from delfim import config
from delfim.commands import vehicle_file

TOLD = 50  # faults listed for one file


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)


def run(asked: argparse.Namespace) -> int:
    """Returns 2 if the file has faults. A warning is not one: another computer may have the device that this one lacks."""
    from delfim import tables
    from delfim.suite import services

    tree = tables.read_toml(asked.file, asked.set)
    wrong = list(tables.complaints(tree, config.Vehicle, asked.file))
    if len(wrong) > 1:
        print(f"delfim: {asked.file}: {len(wrong)} things are wrong:", file=sys.stderr)
        print(*(f"  {str(each).removeprefix(f'{asked.file}: ')}" for each in wrong[:TOLD]), sep="\n", file=sys.stderr)
        return 2
    vehicle = config.load(asked.file, asked.set)
    services(vehicle)
    for doubt in _doubts(asked.file, vehicle):
        print(f"delfim: warning: {doubt}", file=sys.stderr)
    print(f"{asked.file}: {vehicle.boat.name}: nothing is wrong with this file")
    return 0


def _doubts(file: str, vehicle: config.Vehicle) -> Iterator[str]:
    """Devices and files that the file names and this computer lacks, in words."""
    from delfim.errors import ConfigError
    from delfim.vehicle.mission import load_mission

    for key, bus in vehicle.outside("interface").items():
        if ":" not in bus and not Path("/sys/class/net", bus).exists():
            yield f"{key}: this computer has no {bus}; the boat needs it, `delfim sim` does not"
    files = {"mavlink.key": vehicle.mavlink.key, "mavlink.serial": vehicle.mavlink.serial}
    files |= {"slipd.device": vehicle.slipd.device} | vehicle.outside("device")
    for key, path in files.items():
        if path and not Path(path).exists():
            yield f"{key}: there is no file {path} on this computer"
    if vehicle.simulation.mission:
        try:
            load_mission(config.mission_place(file, vehicle))
        except ConfigError as error:
            yield str(error)
