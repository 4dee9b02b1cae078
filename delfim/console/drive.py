"""`delfim drive`: the boat from the command line, one command at a time or as a prompt.

A prompt tells the vehicle each second that somebody is there; a single command does not, so that a boat driven by single
commands stops when the console's time-out ends. That is the dead-man and it is meant.
"""

import select
import shlex
import sys
from typing import Any, TextIO

from delfim.console.link import Link
from delfim.errors import DelfimError, FormatError

ALIVE_S = 1.0
WORDS: dict[str, tuple[str, tuple[str, ...]]] = {  # verb: (what it does, names of its numbers in order)
    "state": ("show the state", ()),
    "checks": ("what is in order for the start, and what is not", ()),
    "stop": ("idle, propellers off", ()),
    "manual": ("thrust of each propeller, -1..1", ("starboard", "port")),
    "heading": ("hold a true heading", ("heading_deg", "speed_mps")),
    "speed": ("change speed", ("speed_mps",)),
    "goto": ("go to a position, or to the first waypoint", ("latitude_deg", "longitude_deg", "speed_mps")),
    "play": ("play the mission, from a leg on", ("leg",)),
    "mission": ("load a mission file", ()),
    "mode": ("enter a mode by name", ()),
    "shutdown": ("stop and end everything, so that the power may be cut", ()),
    "reboot": ("stop, and start the computer again", ()),
}


def usage() -> str:
    rows = (f"  {verb:8} {' '.join(f'[{name}]' for name in names):40} {what}" for verb, (what, names) in WORDS.items())
    return "\n".join(rows) + "\n  hold, home, path, grex, idle             enter that mode"


def command(words: list[str]) -> dict[str, Any]:
    """The command for a line of words: "heading 90 1.5". Raises FormatError in words."""
    verb, *rest = words
    if verb in ("hold", "home", "path", "grex", "idle"):
        return {"command": "mode", "mode": verb}
    if verb == "reboot":
        return {"command": "shutdown", "reboot": True}
    if verb not in WORDS:
        raise FormatError(f"no command {verb!r}; there are:\n{usage()}")
    if verb in ("mode", "mission"):
        if len(rest) != 1:
            raise FormatError(f"{verb} needs one word")
        return {"command": verb, **({"mode": rest[0]} if verb == "mode" else {"text": _file(rest[0])})}
    names = WORDS[verb][1]
    if len(rest) > len(names):
        raise FormatError(f"{verb} takes at most {len(names)} numbers: {' '.join(names)}")
    try:
        numbers = [int(word) if name == "leg" else float(word) for name, word in zip(names, rest, strict=False)]
    except ValueError:
        raise FormatError(f"{verb} takes numbers: {' '.join(names)}") from None
    return {"command": verb, **dict(zip(names, numbers, strict=False))}


def line(state: dict[str, Any]) -> str:
    """A state on one line, for people."""
    reference = state["reference"]

    def show(value: float | None, form: str) -> str:
        return "-" if value is None else format(value, form)

    return (
        f"{state['mode']:7} {show(state['latitude_deg'], '.6f')} {show(state['longitude_deg'], '.6f')} "
        f"heading {show(state['heading_deg'], '5.1f')} speed {show(state['speed_mps'], '.2f')} m/s "
        f"rpm {state['port_rpm']}/{state['starboard_rpm']} leg {reference['leg']} "
        f"to go {show(reference['distance_m'], '.0f')} m  {state['reason']}"
    )


def checks(state: dict[str, Any]) -> list[str]:
    """The checks before the start and the present troubles, a line each, for people."""
    lines = [f"{'ok ' if check['ok'] else 'NOT'}  {check['name']:13}  {check['reason']}" for check in state["checks"]]
    return lines + [f"     {n['name']}: {n['reason']} (for {n['age_s']:.0f} s): {n['action']}" for n in state["notices"]]


def once(link: Link, words: list[str], out: TextIO) -> None:
    """One command, its state printed. Raises Refused."""
    asked = command(words)
    if words[0] == "checks":
        print(*checks(link.ask("state")), sep="\n", file=out)
        return
    print(line(link.ask(asked.pop("command"), **asked)), file=out)


def prompt(link: Link, source: TextIO, out: TextIO) -> None:
    """Commands from `source` until it ends; the vehicle hears from us each second meanwhile."""
    print(usage(), file=out)
    while True:
        if not select.select([source], [], [], ALIVE_S)[0]:
            link.ask("alive")
            continue
        text = source.readline()
        if not text or text.strip() in ("quit", "exit"):
            return
        try:
            if words := shlex.split(text):
                once(link, words, out)
        except DelfimError as error:
            print(error, file=out)


def _file(path: str) -> str:
    try:
        with open(path, encoding="utf-8") as file:
            return file.read()
    except OSError as error:
        raise FormatError(f"{path}: {error.strerror}") from None


def run(socket: str, words: list[str]) -> None:
    """The command line's entry: words given, one command; none, a prompt on standard input."""
    with Link(socket) as link:
        if words:
            once(link, words, sys.stdout)
        else:
            prompt(link, sys.stdin, sys.stdout)
