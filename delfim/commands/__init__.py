"""The commands of `delfim`, a file each: `options(parser)` declares its options, `run(asked)` does it and gives the exit code.

A file imports its libraries only when it runs: a boat does not load those for plots. To add a command: a file in the folder
of its group, and a row here.
"""

import argparse
import contextlib
import importlib
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Final

GROUPS: Final[dict[str, dict[str, str]]] = {  # commands by task, each with a sentence
    "Sail in simulation": {
        "sim": "Sail a mission in simulation, with the boat's whole program and a model of the boat.",
        "fault": "Inject a fault into a simulated boat while it sails (docs/scenarios.md).",
        "nodes": "Play the boat's other CAN nodes (navigation, GPS, propellers, batteries) on its bus.",
        "campaign": "Sail thousands of runs that differ in what a file says, and report what came of them (docs/campaigns.md).",
        "guest": "Play the guest computer: it asks for a zigzag, which the boat obeys in mode grex.",
    },
    "Operate boats": {
        "console": "Show all boats in the browser, plan missions and command them (docs/console.md).",
        "shore": "Be the shore's end of the radio's line, of one boat or of several on one frequency (docs/shore.md).",
        "drive": "Drive a boat from the command line: one command, or a prompt if none is given.",
        "adopt": "Let a boat find out about itself on the water: its motors first (docs/adopt.md).",
        "sensors": "Show what each sensor says, how often and who is believed; find a new one's baud rate (docs/sensors.md).",
        "can": "Look at a CAN bus, send, make traffic, count, and play a log back onto it.",
        "iridium": "Write an order to a boat as a message by satellite, and read what a boat sends (docs/iridium.md).",
        "completion": "Print a script with which the shell completes commands and options (docs/install.md).",
        "identify": "Fit a boat's log: what she is, beside what her file says, and what has changed (docs/adopt.md).",
        "log": "List, sum up, plot, export, replay, repair and fetch logs (docs/logs.md).",
        "charts": "Make of official charts what a boat must keep out of, and why (docs/charts.md).",
        "survey": "Make the lines of a survey from an area on a map, and a chart of its soundings (docs/survey.md).",
    },
    "Describe a boat": {
        "new": "Write a vehicle's file of your boat from a few answers, with a mission where it lies.",
        "commission": "Make the files of a boat for the sea: its vehicle's file, keys and users (docs/sea.md).",
        "check": "Check a vehicle's file and list all its faults.",
        "inventory": "List a boat's hosts, ports, programs, versions and keys (docs/sea.md).",
        "declare": "Write a boat's declaration under MGN 702 or 705 as a form to print (docs/compliance.md).",
        "parts": "List a laboratory's own parts, write the package of a new one, try one (docs/own-parts.md).",
        "describe": "List every key of a vehicle's file with its default, range and meaning.",
        "password": "Ask for a password and print its hash, for a vehicle's file.",
    },
    "On the boat": {
        "supervise": "Run the boat: start, watch and restart its processes, and stop the propellers when the loop stops.",
        "run": "Run the vehicle and the services of its process, without the supervisor.",
        "actuate": "Turn one thruster on the bench, while a key is held (docs/bench.md).",
        "outlet": "Write the pulses of motors and servos, and stop them when nobody speaks (docs/pwm.md).",
        "shutdown": "Stop the boat and end everything in order, so that the power may be cut (docs/powerd.md).",
        "image": "Look at the boat's image, install a new one and confirm it; the old one is kept (docs/image.md).",
    },
}
SENTENCES: Final = {name: sentence for group in GROUPS.values() for name, sentence in group.items()}
FOLDERS: Final = ("simulation", "operation", "description", "aboard")  # of the groups, in their order
LINUX: Final = frozenset((*GROUPS["On the boat"], "adopt", "campaign", "drive", "fault", "guest", "nodes", "sensors", "shore"))
OWN_FILE: Final = "etc/delfimx.toml"  # the default boat of a simulation
PACKAGE: Final = Path(__file__).parents[1]  # etc/ is a part of it: a folder in a wheel, a link in a checkout


def loaded(name: str) -> ModuleType:
    """Import the module of a command."""
    folder = next(folder for folder, group in zip(FOLDERS, GROUPS.values(), strict=True) if name in group)
    return importlib.import_module(f"{__name__}.{folder}.{name}")


class Formatter(argparse.HelpFormatter):
    """Help that shows the default of each option that has one."""

    def _get_help_string(self, action: argparse.Action) -> str:
        told = action.help or ""
        has_one = not isinstance(action.default, bool) and action.default not in (None, "", argparse.SUPPRESS, [])
        return f"{told} (default: %(default)s)" if has_one and "%(default)" not in told else told


def vehicle_file(parser: argparse.ArgumentParser) -> None:
    """Add the options of every command that reads a vehicle's file on the boat."""
    parser.add_argument("file", metavar="FILE", help=f"The vehicle's file, such as {OWN_FILE}.")
    overrides(parser)


def example_file(parser: argparse.ArgumentParser, *, nargs: str | None = None, default: str | None = None) -> None:
    """The options of a command of the desk, which also takes a vehicle's file that came with Delfim."""
    told = f"The vehicle's file, such as {OWN_FILE}{', which is the default' if default else ''}."
    parser.add_argument("file", metavar="FILE", nargs=nargs, default=default, type=shipped, help=told)
    overrides(parser)


def shipped(path: str) -> str:
    """Resolve a path: one that does not exist and begins with etc/ is that of the file that came with Delfim. Never for a
    command that runs a boat: in the wrong folder it would sail with an example instead of the owner's file."""
    place = PACKAGE / path
    return str(place) if Path(path).parts[:1] == ("etc",) and not os.path.exists(path) and place.exists() else path


def place(most_deg: float) -> Callable[[str], tuple[float, float]]:
    """The type of an option LAT,LON: latitude, up to so many degrees, and longitude."""

    def parsed(text: str) -> tuple[float, float]:
        try:
            latitude_deg, longitude_deg = map(float, text.split(","))
            if abs(latitude_deg) <= most_deg and abs(longitude_deg) <= 180.0:
                return latitude_deg, longitude_deg
        except ValueError:
            pass
        raise argparse.ArgumentTypeError(f"{text} is not a latitude and a longitude, as 38.69,-9.21")

    return parsed


def picture(text: str) -> str:
    """The type of an option for the file of a drawing."""
    if not text.lower().endswith((".png", ".svg")):
        raise argparse.ArgumentTypeError(f"{text} ends neither with .png nor with .svg")
    return text


def overrides(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="Use this value instead of the file's; may be repeated."
    )


def seconds(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0.0 < float(text) < float("inf"):
            return float(text)
    raise argparse.ArgumentTypeError(f"{text} is not a number of seconds above 0")


def simulated(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--sim", action="store_true", help="Use the boat that `delfim sim` sails.")
    parser.add_argument(
        "--sim-in", metavar="DIRECTORY", help="Use the simulated boat of this folder, such as run/sim-2, if several sail."
    )


def there(asked: argparse.Namespace) -> list[str]:
    """The overrides that lead to a running boat: those of `delfim sim`, if its boat is asked for, and the operator's."""
    if not asked.sim and asked.sim_in is None:
        return list(asked.set)
    from delfim.simulator.workspace import found

    place = found(asked.sim_in)
    return [f'console.socket="{place}/command"', f'runtime.run_directory="{place}"', *asked.set]
