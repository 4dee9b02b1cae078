"""`delfim drive`: drives the boat from the command line, by single commands or at a prompt.

A prompt tells the vehicle each second that somebody is there; a single command does not, so that a boat driven by single
commands stops when the console's time-out ends. This dead-man is intended.
"""

import contextlib
import math
import shlex
import sys
import threading
from collections.abc import Iterator
from typing import Any, NamedTuple, TextIO, get_args

from delfim.base.errors import DelfimError, FormatError, Refused, in_words
from delfim.base.input.untrusted import parse_toml, read_text
from delfim.base.modes import Mode
from delfim.config import EndMode
from delfim.vehicle.operator.link import Link

ALIVE_S = 1.0
PROMPT = "delfim> "


class Word(NamedTuple):
    """A command: its effect, the arguments that it needs, and optional ones (two words in one: both or neither)."""

    does: str
    needs: tuple[str, ...] = ()
    may: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.needs, *" ".join(self.may).split())

    def shape(self, verb: str) -> str:
        return " ".join([verb, *self.needs, *(f"[{name}]" for name in self.may)])


WORDS: dict[str, Word] = {
    "state": Word("show the state"),
    "checks": Word("show the checks before the start"),
    "stop": Word("idle, propellers off"),
    "kill": Word("idle, propellers off, and every mode refused until the kill is cleared"),
    "clear": Word("end a kill; every switch that says kill must be released before"),
    "manual": Word("thrust of each propeller, -1 to 1", ("starboard", "port")),
    "heading": Word("hold a true heading", ("heading_deg",), ("speed_mps",)),
    "course": Word("steer a true course over ground, in a current too", ("course_deg",), ("speed_mps",)),
    "speed": Word("change the speed; without a number, back to the plan's own", (), ("speed_mps",)),
    "goto": Word(
        "go to a position, or else to the first waypoint; there hold, whose propellers start again, or idle, which is a stop",
        (),
        ("latitude_deg longitude_deg", "speed_mps", "end"),
    ),
    "play": Word("play the mission, from a leg; the first is 1", (), ("leg",)),
    "path": Word("follow the mission's path, from a piece; the first is 1", (), ("piece",)),
    "line": Word("follow the mission's path from the run-in of a line of the survey; the first is 1", ("line",)),
    "pause": Word("hold here; continue goes on from here"),
    "continue": Word("go on with what a hold interrupted, from where it was"),
    "overrule": Word("give way to nobody for a while, whatever is told of others; again: give way again"),
    "mission": Word("load a mission file", ("file",)),
    "mode": Word("enter a mode by name, also one that a part of this boat has", ("name",)),
    "payload": Word("give the boat to a payload program; any other order takes it back", ("name",)),
    "order": Word("give an order of a part of this boat", ("name",), ("KEY=VALUE ...",)),
    "shutdown": Word("stop and shut the computer down, so that the power may be cut"),
    "reboot": Word("stop, and start the computer again"),
    "help": Word("show all commands, or one", (), ("command",)),
}
COUNTED = "leg", "piece", "line"
ENTERED = tuple(mode.name.lower() for mode in Mode if mode.name.lower() not in WORDS)  # commands by the mode's name alone


def usage(verb: str = "") -> str:
    """All commands, or one."""
    rows = (f"  {word.shape(each):50} {word.does}" for each, word in WORDS.items() if not verb or each == verb)
    modes = f"  {', '.join(ENTERED):50} enter that mode"
    return "\n".join([*rows, modes] if not verb or verb in ENTERED else rows)


def command(words: list[str]) -> dict[str, Any]:
    """The command for a line of words: "heading 90 1.5". Raises FormatError in words."""
    verb, *rest = words
    if verb == "order" and rest:
        return {"command": verb, "name": rest[0], "values": dict(map(_key, rest[1:]))}
    if verb not in WORDS and not rest:  # it may be a mode that only the boat knows
        return {"command": "mode", "mode": verb}
    end = {"end": rest.pop()} if verb == "goto" and rest and rest[-1] in get_args(EndMode) else {}
    word = Word("enter that mode") if verb in ENTERED else WORDS.get(verb)
    if word is None:
        raise FormatError(f"no command {verb!r}; there are {', '.join([*WORDS, *ENTERED])}")
    missing = word.names[len(rest)] if len(rest) < len(word.needs) or (verb == "goto" and len(rest) == 1) else ""
    if missing or len(rest) > len(word.names):
        wrong = f"{missing} is missing" if missing else f"{rest[len(word.names)]!r} is too much"
        raise FormatError(f"{wrong}: {word.shape(verb)}")
    said, shape = dict(zip(word.names, rest, strict=False)), word.shape(verb)
    match verb:
        case "reboot":
            return {"command": "shutdown", "reboot": True}
        case "mission":
            return {"command": verb, "text": _file(said["file"])}
        case "mode":
            return {"command": verb, "mode": said["name"]}
        case "payload":
            return {"command": verb, "name": said["name"]}
        case "path":
            verb, end = "mode", {"mode": "path"}
        case "line":
            return {"command": "mode", "mode": "path", "line": _number(verb, said[verb], shape) + 1}
    return {"command": verb} | {name: _number(name, text, shape) for name, text in said.items()} | end


def _key(word: str) -> tuple[str, Any]:
    """Of KEY=VALUE. Raises FormatError."""
    key, equals, value = word.partition("=")
    if not equals:
        raise FormatError(f"{word!r} is not KEY=VALUE: {WORDS['order'].shape('order')}")
    try:
        return key, parse_toml(f"value = {value}")["value"]
    except FormatError:
        return key, value  # a word


def _number(name: str, text: str, where: str) -> float | int:
    """Raises FormatError. Legs and pieces are counted from 1, as on the page; the vehicle counts them from 0."""
    with contextlib.suppress(ValueError):
        if name in COUNTED and int(text) >= 1:
            return int(text) - 1
        if name not in (*COUNTED, "end") and math.isfinite(float(text)):
            return float(text)
    kind = {**dict.fromkeys(COUNTED, "a whole number from 1 on"), "end": "hold or idle"}.get(name, "a number")
    raise FormatError(f"{name} must be {kind}, not {text!r}: {where}")


def line(state: dict[str, Any]) -> str:
    """The state on one line."""
    reference = state["reference"]

    leg = f"{reference['leg'] + 1}/{state['legs']}" if state["legs"] else "-"
    whose = f"payload {state['helmsman']}: " if state["helmsman"] else ""

    def show(value: float | None, form: str) -> str:
        return "-" if value is None else format(value, form)

    thrust = " ".join(f"{name} {each['thrust']:.0%}" for name, each in state["thrusters"].items())
    return (
        f"{whose}{state['mode']:7} {show(state['latitude_deg'], '.6f')} {show(state['longitude_deg'], '.6f')} "
        f"heading {show(state['heading_deg'], '5.1f')} speed {show(state['speed_mps'], '.2f')} m/s "
        f"{thrust} leg {leg} "
        f"to go {show(reference['distance_m'], '.0f')} m  {state['reason']}"
        + (f" ({state['operator']} commands)" if state["operator"] else "")
    )


def checks(state: dict[str, Any]) -> list[str]:
    """The checks before the start and the present troubles, a line each."""
    lines = [f"{'ok ' if check['ok'] else 'NOT'}  {check['name']:13}  {check['reason']}" for check in state["checks"]]
    return lines + [f"     {n['name']}: {n['reason']} (for {n['age_s']:.0f} s): {n['action']}" for n in state["notices"]]


def once(link: Link, words: list[str], out: TextIO) -> None:
    """Sends one command and prints the state. Raises Refused."""
    asked = command(words[:1] if words[0] == "help" else words)
    if words[0] == "help":
        print(usage(*words[1:2]), file=out)
    elif words[0] == "checks":
        print(*checks(link.ask("state")), sep="\n", file=out)
    else:
        try:
            print(line(link.ask(asked.pop("command"), **asked)), file=out)
        except Refused as refusal:
            if words[0] in WORDS or words[0] in ENTERED:
                raise
            raise Refused(f"no command {words[0]!r}; {refusal}") from None


def prompt(link: Link, texts: Iterator[str], out: TextIO) -> None:
    """Reads and sends commands until the input ends."""
    print(usage(), file=out)
    for text in texts:
        if text.strip() in ("quit", "exit"):
            return
        try:
            if words := shlex.split(text):
                once(link, words, out)
        except (DelfimError, ValueError) as error:  # ValueError: an unclosed quotation mark
            print(error, file=out)


def _typed() -> Iterator[str]:
    """Lines of a terminal, with history (arrow keys) and completion (Tab)."""
    import readline  # not every Python has it, and only this needs it

    every = sorted((*WORDS, *ENTERED, "quit"))

    def ending(text: str, state: int) -> str | None:
        found = [f"{word} " for word in every if word.startswith(text)] if readline.get_begidx() == 0 else []
        return found[state] if state < len(found) else None

    readline.set_completer(ending)
    readline.parse_and_bind("tab: complete")
    with contextlib.suppress(EOFError):
        while True:
            yield input(PROMPT)
    print()


def _alive(socket: str, ended: threading.Event) -> None:
    """Tells the vehicle that somebody is there, in a thread of its own, because the prompt waits for the keyboard."""
    with contextlib.suppress(DelfimError), Link(socket) as link:
        while not ended.wait(ALIVE_S):
            with contextlib.suppress(Refused):
                link.ask("alive")


def _file(path: str) -> str:
    try:
        return read_text(path)
    except OSError as error:
        raise FormatError(in_words(error)) from None


def run(socket: str, words: list[str]) -> None:
    """The command line's entry: one command if words are given, or else a prompt on standard input."""
    with Link(socket) as link:
        if words:
            once(link, words, sys.stdout)
            return
        ended = threading.Event()
        there = threading.Thread(target=_alive, args=(socket, ended))
        there.start()
        try:
            prompt(link, _typed() if sys.stdin.isatty() else sys.stdin, sys.stdout)
        finally:
            ended.set()
            there.join()
