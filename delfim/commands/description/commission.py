"""`delfim commission`: makes the files of a boat for the sea from a vehicle's file: its own file, keys and users.

It asks for all that it cannot know; every question has an option, so that it also runs unattended. Nothing is written before
the file with all answers was found good and no door lets a stranger move the boat.
"""

import argparse
import sys
from collections.abc import Mapping
from ipaddress import IPv4Interface
from pathlib import Path
from typing import Any, Final, NamedTuple

from delfim import config
from delfim.base.errors import DelfimError, Refused
from delfim.base.ranges import address, is_loopback
from delfim.canproxy.tables import Cantcpd
from delfim.commands import overrides, shipped
from delfim.parts.fleet.table import FleetTable
from delfim.parts.ros.table import RosTable
from delfim.services.access import commissioned
from delfim.services.access.commissioned import BOAT
from delfim.services.tables import GuestTable, Slipd, Sshd, Tablet
from delfim.simulator.tables import Simulation

FILE: Final = "etc/delfimx-sea.toml"
USER: Final = "[A-Za-z][A-Za-z0-9_-]{0,31}"


class Question(NamedTuple):
    """A question. `key` of the vehicle's file has the answer if nobody gives another; "" for one that is in no file."""

    option: str
    words: str
    key: str = ""
    default: str = ""


QUESTIONS: Final = (
    Question("name", "Name of the boat", "boat.name"),
    Question("id", "Its number, 1 to 249, of which no other boat has the same", "boat.id"),
    Question("radio", "Serial port of the radio, such as /dev/ttyS1; a space for none", "slipd.device"),
    Question("radio-address", "Address of the boat on the radio", "slipd.address"),
    Question("console", "Address of the operator's computer, the other end of the radio where there is one", "slipd.peer"),
    Question("for", "What its computer runs: the image, or debian with the package", default="image"),
    Question("network", "Address of the boat on its own network, with its length", default="192.168.2.10/24"),
    Question("interface", "Interface of that network, which the image sets up", default="eth0"),
    Question("users", "Users, who may log in by SSH and fetch and upload files, with commas; NAME=FILE.pub: has an ssh key"),
)


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", nargs="?", default=FILE, type=shipped, help="The vehicle's file to begin with.")
    parser.add_argument(
        "--output", metavar="DIRECTORY", default="commissioned", help="Write the files here; it must not exist."
    )
    told = "A boat that was commissioned before: its consoles' key is this one's, too, for one console commands both."
    parser.add_argument("--fleet", metavar="DIRECTORY", help=told)
    parser.add_argument("--yes", action="store_true", help="Ask nothing: what has no option stays as the file has it.")
    for question in QUESTIONS:
        default = question.default or (f"{question.key} of FILE" if question.key else "")
        told = f"{question.words}{f' (default: {default})' if default else ''}."
        parser.add_argument(f"--{question.option}", metavar="TEXT", help=told)
    overrides(parser)


def run(asked: argparse.Namespace) -> int:
    from delfim.base import tables
    from delfim.services import vehiclefile
    from delfim.services.suite import services

    settings = config.load(asked.file, asked.set)
    answers = dict[str, str]()
    for each in QUESTIONS:
        answers[each.option] = _answer(each, asked, settings, answers)
    crew, network = _users(answers["users"]), _network(answers["network"])
    if answers["for"] not in ("image", "debian"):
        raise DelfimError(f"--for {answers['for']}: there are image and debian")
    console_key = _consoles_key(asked.fleet, answers["id"])
    secrets = _secrets(answers, crew, console_key, settings)
    changes = {"boat.name": answers["name"], "boat.id": _number(answers["id"])}
    changes |= _addresses(answers, network, settings) | _opened(settings)
    changes |= {key: value for one in asked.set for key, value in _flat(tables.read_override(one))}
    changes |= secrets.settings
    mission = _mission(asked.file, settings)
    changes |= dict.fromkeys(("simulation.mission",) if mission else (), "".join(mission))
    text = vehiclefile.changed(asked.file, changes)
    _is_fit(text, asked.file)
    output = Path(asked.output)
    copies = {f"{place}/{name}": content for name, content in mission.items() for place in ("boat", "shore")}
    _write(output, text, secrets.files | copies)
    made = config.load(output / "shore/boat.toml")
    print(f"{answers['name']} is commissioned. All files in {output} are secret; nobody but you can read them.\n")
    print(commissioned.carried(output, made, answers["for"], network, answers["interface"]))
    print(commissioned.ashore(output, made, str(network.ip), list(crew), [row.name for row in services(made)]))
    return 0


def _answer(question: Question, asked: argparse.Namespace, settings: config.Vehicle, before: Mapping[str, str]) -> str:
    """Take the answer from an option, else from the keyboard, else the default. What only a radio has is not asked for without
    one."""
    given: str | None = getattr(asked, question.option.replace("-", "_"))
    if given is not None:
        return given.strip()
    default, is_known = question.default, bool(question.key)
    if question.key:
        table, _, key = question.key.partition(".")
        default = str(getattr(getattr(settings, table), key))
    if question.key.startswith("slipd.") and before.get("radio") == "":
        if question.option == "radio-address":
            return default
        default, is_known = "", False  # the file's console is at the radio's other end
    if question.option == "interface" and before["for"] == "debian":
        return default
    if not asked.yes:
        if not sys.stdin.isatty():
            raise DelfimError(f"nobody is here to ask: give --{question.option}, or --yes for what the file has")
        typed = input(f"{question.words}{f' [{default}]' if default else ''}: ")
        default = typed.strip() if typed else default
    if not default and not is_known:
        raise DelfimError(f"--{question.option} is missing: {question.words}")
    return default


def _number(text: str) -> int:
    if not text.isdecimal():
        raise DelfimError(f"--id {text}: not a number")
    return int(text)


def _users(text: str) -> dict[str, str]:
    """Parse the users, with the public ssh key of those who have one. Raises DelfimError."""
    import re

    from delfim.base.input.untrusted import read_file
    from delfim.services.access.credentials import public_ssh_key

    users = dict[str, str]()
    for each in text.split(","):
        name, _, file = (part.strip() for part in each.partition("="))
        if not re.fullmatch(USER, name):
            raise DelfimError(f"--users {name!r}: not a name (a letter, then letters, digits, _ or -)")
        try:
            users[name] = public_ssh_key(read_file(Path(file).expanduser())) if file else ""
        except (OSError, ValueError) as error:
            raise DelfimError(f"--users {name}: {file} is no public ssh key: {error}") from None
    return users


def _consoles_key(fleet: str | None, number: str) -> str:
    """The key of the boat that was commissioned into a folder, or a new one. Raises ConfigError, and DelfimError where that
    boat has the same number: both would obey an order to one of them."""
    from secrets import token_hex

    from delfim.base.input.keys import read_key

    if fleet is None:
        return f"{token_hex(32)}\n"
    key = read_key(Path(fleet) / "shore/mavlink.key")
    other = config.load(Path(fleet) / "shore/boat.toml").boat
    if other.id == _number(number):
        raise DelfimError(f"--id {number}: {other.name} in {fleet} has this number, and would obey orders to this boat, too")
    return f"{key.hex()}\n"


def _network(text: str) -> IPv4Interface:
    try:
        if "/" in text:
            return IPv4Interface(text)
    except ValueError:
        pass
    raise DelfimError(f"--network {text}: not ADDRESS/LENGTH, such as 192.168.2.10/24")


def _addresses(answers: Mapping[str, str], network: IPv4Interface, settings: config.Vehicle) -> dict[str, Any]:
    """The networks of the others: the console may watch the bus, and so may the boat's own network, where the guest is."""
    own, console = str(network.network), answers["console"]
    radio = {"slipd.device": answers["radio"], "slipd.address": answers["radio-address"], "slipd.peer": console}
    found: dict[str, Any] = radio if answers["radio"] else {"slipd.device": ""} if settings.of(Slipd).device else {}
    fleet, tablet = settings.of(FleetTable), settings.of(Tablet)
    here = [fleet.listen] * bool(fleet.broker) + [tablet.boats] * bool(tablet.listen)
    if is_loopback(f"{console}:14550") and not here:
        raise DelfimError(f"--console {console}: that is the boat's own computer, and the boat calls her consoles")
    found |= {"mavlink.peers": [f"{console}:14550", *here]}
    if settings.of(GuestTable).enabled:
        found |= {"guest.networks": [*(["127.0.0.0/8"] if settings.of(RosTable).commands else []), own]}
    if commissioned.bus(settings):
        found |= {"cantcpd.watch": ["127.0.0.0/8", console, own]}
    return found


def _opened(settings: config.Vehicle) -> dict[str, Any]:
    """The listeners for which commands are printed, on every address of the boat where the file has its own computer's alone.
    The ports stay the file's: Debian has an sshd of its own on port 22."""
    names = ["mavlink", "httpd", "ftpd", "sshd", *(["guest"] if settings.of(GuestTable).enabled else [])]
    names += ["tablet"] if settings.of(Tablet).listen else []
    places = {f"{name}.listen": getattr(settings, name).listen for name in names}
    found: dict[str, Any] = {key: _everywhere(place) for key, place in places.items()}
    if commissioned.bus(settings):
        found |= {"cantcpd.listen": [_everywhere(place) for place in settings.of(Cantcpd).listen]}
    return found


def _everywhere(listen: str) -> str:
    return f"0.0.0.0:{address(listen)[1]}" if is_loopback(listen) else listen


def _mission(file: str, settings: config.Vehicle) -> dict[str, str]:
    """The file's mission, by its name beside the copies of the file. Raises ConfigError, OSError."""
    from delfim.base.input.untrusted import read_text

    place = config.mission_place(file, settings) if settings.of(Simulation).mission else None
    return {place.name: read_text(place)} if place else {}


class Secrets(NamedTuple):
    """New secrets: files below the output folder with their content, and the keys of the vehicle's file for them."""

    files: dict[str, str]
    settings: dict[str, Any]


def _secrets(answers: Mapping[str, str], crew: Mapping[str, str], console_key: str, file: config.Vehicle) -> Secrets:
    """Make the secrets; `file` shows which ports and guest the boat has."""
    import datetime
    from secrets import token_hex, token_urlsafe

    from delfim.services.access import credentials
    from delfim.services.access.connection_limits import hashed

    boat = answers["name"]
    places = [
        each for each in (answers["radio-address"] if answers["radio"] else "", answers["network"].partition("/")[0]) if each
    ]
    host, tls = credentials.ssh_key(boat), credentials.certificate(boat, places, datetime.datetime.now(datetime.UTC))
    known, port = " ".join(host.public.split()[:2]), address(file.of(Sshd).listen)[1]
    files = {
        "boat/mavlink.key": console_key,
        "boat/ftpd.pem": tls.certificate + tls.key,
        "boat/ssh_host_ed25519": host.private,
        "shore/mavlink.key": console_key,
        "shore/boat.crt": tls.certificate,
        "shore/known_hosts": "".join(f"{place if port == 22 else f'[{place}]:{port}'} {known}\n" for place in places),
    }
    settings: dict[str, Any] = {
        "mavlink.key": f"{BOAT}/mavlink.key",
        "ftpd.certificate": f"{BOAT}/ftpd.pem",
        "sshd.host_key": f"{BOAT}/ssh_host_ed25519",
    }
    if file.of(GuestTable).enabled:
        files["boat/guest.key"] = files["guest/guest.key"] = f"{token_hex(32)}\n"
        settings["guest.key"] = f"{BOAT}/guest.key"
    if file.of(Tablet).listen:
        files["boat/tablet/token"] = files["shore/tablet.token"] = f"{token_urlsafe(12)}\n"
        settings |= {"tablet.directory": f"{BOAT}/tablet", "tablet.certificate": f"{BOAT}/ftpd.pem"}
    for user, public in crew.items():
        password = credentials.password()
        files[f"shore/{user}.password"] = f"{password}\n"
        if not public:
            files[f"shore/{user}.key"], public = credentials.ssh_key(f"{user}@{boat}")
        settings |= {f"ftpd.users.{user}.password": hashed(password), f"ftpd.users.{user}.upload": True}
        settings |= {f"sshd.users.{user}.keys": [public]}
    return Secrets(files, settings)


def _flat(tree: Mapping[str, Any], above: str = "") -> list[tuple[str, Any]]:
    found = []
    for key, value in tree.items():
        found += _flat(value, f"{above}{key}.") if isinstance(value, dict) else [(f"{above}{key}", value)]
    return found


def _is_fit(text: str, file: str) -> None:
    """Check the answers. Raises ConfigError for a wrong one, Refused for a boat that strangers could move or write to."""
    from delfim.base.input.untrusted import parse_toml
    from delfim.services.access.exposure import doors
    from delfim.services.suite import services

    settings = config.read(parse_toml(text), file)
    faults = [door.fault for door in doors(settings, [row.name for row in services(settings)]) if door.fault]
    if faults:
        raise Refused("the boat must not go to sea like this: " + "; ".join(faults))


def _write(output: Path, text: str, files: Mapping[str, str]) -> None:
    """Write all of it, for its owner alone. Raises FileExistsError: keys that a boat knows are not replaced."""
    import os

    output.mkdir(mode=0o700, parents=True)
    for name, content in (dict(files) | {"boat/boat.toml": text, "shore/boat.toml": text}).items():
        place = output / name
        place.parent.mkdir(mode=0o700, exist_ok=True)
        with open(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            file.write(content)
