"""`delfim commission`: the files of a boat for the sea, from a vehicle's file: its own file, keys and users.

It asks for all that it cannot know; every question has an option, so that it also runs unattended. Nothing is written before
the file with all answers was found good and no door lets a stranger move the boat.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from ipaddress import IPv4Interface
from pathlib import Path
from typing import Any, Final, NamedTuple

from delfim import config
from delfim.commands import overrides, shipped
from delfim.errors import DelfimError, Refused

FILE: Final = "etc/delfimx-sea.toml"
BOAT: Final = "/log/.boat"  # aboard; names with a dot in front are given out by no service
USER: Final = "[A-Za-z][A-Za-z0-9_-]{0,31}"


class Question(NamedTuple):
    """`key` of the vehicle's file has the answer if nobody gives another; "" for one that is in no file."""

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
    Question("network", "Address of the boat on the payload's network, with its length", default="192.168.1.10/24"),
    Question("interface", "Interface of that network", default="eth0"),
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
    from delfim import tables
    from delfim.services import vehiclefile

    settings = config.load(asked.file, asked.set)
    answers = {each.option: _answer(each, asked, settings) for each in QUESTIONS}
    crew = _users(answers["users"])
    network, secrets = _network(answers["network"]), _secrets(answers, crew, _consoles_key(asked.fleet))
    changes = {"boat.name": answers["name"], "boat.id": _number(answers["id"])} | _addresses(answers, network)
    changes |= {key: value for one in asked.set for key, value in _flat(tables.read_override(one))}
    changes |= secrets.settings
    text = vehiclefile.changed(asked.file, changes)
    _is_fit(text, asked.file)
    output = Path(asked.output)
    _write(output, text, secrets.files)
    print(_next_steps(output, answers, list(crew), network))
    return 0


def _answer(question: Question, asked: argparse.Namespace, settings: config.Vehicle) -> str:
    """An option, else what is typed, else the default."""
    given: str | None = getattr(asked, question.option.replace("-", "_"))
    if given is not None:
        return given.strip()
    default = question.default
    if question.key:
        table, _, key = question.key.partition(".")
        default = str(getattr(getattr(settings, table), key))
    if not asked.yes:
        if not sys.stdin.isatty():
            raise DelfimError(f"nobody is here to ask: give --{question.option}, or --yes for what the file has")
        typed = input(f"{question.words}{f' [{default}]' if default else ''}: ")
        default = typed.strip() if typed else default
    if not default and not question.key:
        raise DelfimError(f"--{question.option} is missing: {question.words}")
    return default


def _number(text: str) -> int:
    if not text.isdecimal():
        raise DelfimError(f"--id {text}: not a number")
    return int(text)


def _users(text: str) -> dict[str, str]:
    """The users, with the public ssh key of those who have one. Raises DelfimError."""
    import re

    from delfim.outside import read_file
    from delfim.services.credentials import public_ssh_key

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


def _consoles_key(fleet: str | None) -> str:
    """That of the boat that was commissioned into a folder, or a new one. Raises ConfigError."""
    from secrets import token_hex

    from delfim.vehicle.mavlink.signing import read_key

    return f"{read_key(Path(fleet) / 'shore/mavlink.key').hex() if fleet else token_hex(32)}\n"


def _network(text: str) -> IPv4Interface:
    try:
        if "/" in text:
            return IPv4Interface(text)
    except ValueError:
        pass
    raise DelfimError(f"--network {text}: not ADDRESS/LENGTH, such as 192.168.1.10/24")


def _addresses(answers: Mapping[str, str], network: IPv4Interface) -> dict[str, Any]:
    """The networks of the others: the console may watch the bus, and so may the payload's network, where the guest is."""
    payload = str(network.network)
    return {
        "slipd.device": answers["radio"],
        "slipd.address": answers["radio-address"],
        "slipd.peer": answers["console"],
        "mavlink.peers": [f"{answers['console']}:14550"],
        "cantcpd.watch": ["127.0.0.0/8", answers["console"], payload],
        "guest.networks": [payload],
    }


class Secrets(NamedTuple):
    """New ones: files below the output folder with their content, and what the vehicle's file says of them."""

    files: dict[str, str]
    settings: dict[str, Any]


def _secrets(answers: Mapping[str, str], crew: Mapping[str, str], console_key: str) -> Secrets:
    import datetime
    from secrets import token_hex

    from delfim.services import credentials
    from delfim.services.door import hashed

    boat = answers["name"]
    places = [
        each for each in (answers["radio-address"] if answers["radio"] else "", answers["network"].partition("/")[0]) if each
    ]
    guest_key = f"{token_hex(32)}\n"
    host, tls = credentials.ssh_key(boat), credentials.certificate(boat, places, datetime.datetime.now(datetime.UTC))
    known = " ".join(host.public.split()[:2])
    files = {
        "boat/mavlink.key": console_key,
        "boat/guest.key": guest_key,
        "boat/ftpd.pem": tls.certificate + tls.key,
        "boat/ssh_host_ed25519": host.private,
        "shore/mavlink.key": console_key,
        "shore/boat.crt": tls.certificate,
        "shore/known_hosts": "".join(f"{place} {known}\n" for place in places),
        "guest/guest.key": guest_key,
    }
    settings: dict[str, Any] = {
        "mavlink.key": f"{BOAT}/mavlink.key",
        "guest.key": f"{BOAT}/guest.key",
        "ftpd.certificate": f"{BOAT}/ftpd.pem",
        "sshd.host_key": f"{BOAT}/ssh_host_ed25519",
    }
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
    """Raises ConfigError for a wrong answer, Refused for a boat that strangers could move or write to."""
    from delfim import tables
    from delfim.outside import parse_toml
    from delfim.services.doors import doors
    from delfim.suite import services

    settings = tables.decode(parse_toml(text), config.Vehicle, file)
    faults = [door.fault for door in doors(settings, [row.name for row in services(settings)]) if door.fault]
    if faults:
        raise Refused("the boat must not go to sea like this: " + "; ".join(faults))


def _write(output: Path, text: str, files: Mapping[str, str]) -> None:
    """All of it, for its owner alone. Raises FileExistsError: keys that a boat knows are not replaced."""
    import os

    output.mkdir(mode=0o700, parents=True)
    for name, content in (dict(files) | {"boat/boat.toml": text, "shore/boat.toml": text}).items():
        place = output / name
        place.parent.mkdir(mode=0o700, exist_ok=True)
        with open(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            file.write(content)


def _next_steps(output: Path, answers: Mapping[str, str], crew: Sequence[str], network: IPv4Interface) -> str:
    boat, user = answers["radio-address"] if answers["radio"] else str(network.ip), crew[0]
    shore, name = output / "shore", answers["name"]
    key = f"-i {shore}/{user}.key " if (shore / f"{user}.key").exists() else ""
    words = f"VEHICLE={BOAT}/boat.toml NET={answers['interface']} ADDRESS={network}"
    radio = _shore(config.load(shore / "boat.toml").slipd)
    return f"""{name} is commissioned. All files in {output} are secret; nobody but you can read them.

To the boat, by hand and never over the radio:
    cp -r {output}/boat /MOUNTED-LOG-PARTITION/.boat      then there: chown -R root: .boat; chmod 700 .boat
    words for its kernel (boot/grub/boat.cfg or cmdline.txt): {words}
To the guest computer: {output}/guest/guest.key (docs/guest.md)
To the operator's computer: {shore}, where you type
{radio}    delfim console --boats 0.0.0.0:14550 --key {shore}/mavlink.key --vehicle {shore}/boat.toml
    ssh {key}-o UserKnownHostsFile={shore}/known_hosts {user}@{boat}
    lftp -u {user} -e 'set ftp:ssl-force true; set ssl:ca-file {shore}/boat.crt' {boat}
    delfim can dump socketcand:{boat}:29536:can0
    browser: http://{boat}/
Each user has a key (unless they had one) and a password of their own there: {", ".join(crew)}. Give each their files, boat.crt
and known_hosts.

Before it goes into the water: delfim check --sea {output}/boat/boat.toml, and docs/sea.md."""


def _shore(line: config.Slipd) -> str:
    """The command for the radio's other end; empty without a radio."""
    if not line.device:
        return ""
    boat, ashore = (f"{line.address}={line.station}", f"{line.peer}/24") if line.station else (line.address, line.peer)
    return (
        f"    sudo delfim shore /dev/ttyUSB0 --boats {boat} --address {ashore} \\\n"
        f"        --baud {line.baud} --radio-bps {line.radio_bps} --encapsulation {line.encapsulation} --mtu {line.mtu}\n"
    )
