"""A payload program that has the boat (docs/payloads.md): an operator gives it, and any order of an operator, whatever the
failsafe does, and its own silence take it back.

Its orders are commands of the console under a name of its own, PAYLOAD and the program's. They go through the helm's one door,
below everybody else, into the log, and into a replay.
"""

from collections.abc import Mapping
from typing import Final

import msgspec

from delfim import config
from delfim.base.errors import DelfimError, Refused
from delfim.base.modes import Mode
from delfim.base.ranges import PayloadRight
from delfim.vehicle import console, grex
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.orders import handlers
from delfim.vehicle.plans.underway import SAILS
from delfim.vehicle.state import State

PAYLOAD: Final = "payload:"  # begins the name under which a program orders
SENSOR: Final = "sensor "  # begins that of a sensor which no program reads and the boat hears itself; no program has a space
RIGHTS: Final[dict[type[console.Command], PayloadRight]] = {
    console.Pause: "hold",
    console.Goto: "goto",
    console.SetSpeed: "speed",
    console.Heading: "heading",
    console.Course: "heading",
    console.Upload: "mission",
    console.Play: "mission",
    console.Continue: "mission",
    console.Sight: "obstacles",
    console.Sampled: "samples",
    console.Tell: "values",
}
OWN: Final = console.Sight | console.Sampled | console.Tell | console.OfPayload  # what operators do not say


def payload_of(operator: str) -> str:
    """The program that orders under this name; empty: an operator does."""
    return operator.removeprefix(PAYLOAD) if operator.startswith(PAYLOAD) else ""


def forbidden(settings: config.Vehicle, state: State, name: str, command: console.Commands) -> str:
    """Why a program may not order this now, in words; empty: it may."""
    word, right = str(command.__struct_config__.tag), RIGHTS.get(type(command))
    table = settings.table("payload").get(name)
    if table is None:
        return f"there is no payload {name[:40]}"
    if right is None and not isinstance(command, console.Alive):
        return f"{word} is for operators alone"
    if right not in (None, *table.may) or not table.may:
        return f"{right or word} is not among the rights of {name}, which has {', '.join(table.may) or 'none'}"
    if right in (None, "obstacles", "samples", "values"):
        return ""
    if state.helmsman != name:
        return f"{name} does not have the boat: {state.relieved or 'no operator has given it'}"
    if isinstance(command, console.Goto) and command.end != "hold":
        return 'a payload goes to a point with "end": "hold"'
    if isinstance(command, console.Upload) and command.mission.then != "hold":
        return 'a mission of a payload ends with "then": "hold"'
    return ""


def within(command: console.Plan, zones: config.Zones) -> console.Plan:
    """A program's mission, within the zones that are in force: it can neither change nor lose them. Raises Refused."""
    if not isinstance(command, console.Upload):
        return command
    if command.mission.fence != config.Zones():
        raise Refused("the zones are the operator's: send the mission without a fence")
    if command.mission.opens:
        raise Refused("a band of the chart is the operator's to open: send the mission without opens")
    return console.Upload(msgspec.structs.replace(command.mission, fence=zones))


def order(helm: Helm, name: str, command: console.Commands, now_s: float) -> str | None:
    """Carry out an order of a program; returns why it was refused, or None. An order that is refused is no sign of life."""
    state = helm.state
    if isinstance(command, console.Sight) and name.startswith(SENSOR):
        grex.seen(command.target, name.removeprefix(SENSOR), state, now_s)
        return None
    if why := forbidden(helm.settings, state, name, command):
        return f"refused: {why}"
    if isinstance(command, console.Sight):
        grex.seen(command.target, f"payload {name}", state, now_s)
        return None
    if isinstance(command, console.Tell):
        return _measured(helm, name, command.values, now_s)
    if isinstance(command, console.Sampled):
        try:
            helm.stations.answer(name, command.number, command.ok, command.reason, now_s)
        except DelfimError as refusal:
            return str(refusal)
        return None
    if isinstance(command, console.Continue) and helm.paused is not None and helm.paused.mode not in SAILS:
        return f"continue refused: {helm.paused.mode.name.lower()} was interrupted, which is no mission"
    if not isinstance(command, console.Alive):
        try:
            handlers.obey(helm, command, now_s)
        except DelfimError as refusal:
            return str(refusal)
        helm.steer(now_s)
    state.payloads_s[name] = now_s
    return None


def _measured(helm: Helm, name: str, values: Mapping[str, float], now_s: float) -> str | None:
    """Keep the values of a program that the file names, so that nobody fills the state; returns why not, or None."""
    bounds, shown = helm.settings.failsafe.beyond, helm.settings.table("payload")[name].shown
    for each, value in values.items():
        key = f"{name}.{each}"
        if each not in shown and key not in bounds.above and key not in bounds.below:
            return f"refused: neither failsafe.beyond nor payload.{name}.shown names {each}"
        helm.state.measured[key] = value, now_s
    return None


def obey(helm: Helm, command: console.Commands, now_s: float) -> None:
    """Carry out an order of an operator, which takes the boat back from the program that has it. Raises DelfimError."""
    if not isinstance(command, console.Alive) and (words := helm.state.relieve("operator took it back")):
        helm.note(words)
    if isinstance(command, OWN):
        raise Refused("refused: only a payload program says this")
    if isinstance(command, console.Entrust):
        entrust(helm, command.name, now_s)
    elif isinstance(command, console.PartOrder) and (asked := starts_and_stops(helm.settings).get(command.name)):
        _rest(helm, *asked)
    else:
        handlers.obey(helm, command, now_s)


def entrust(helm: Helm, name: str, now_s: float) -> None:
    """Give the boat to a program: it holds, until the program orders something. Raises Refused."""
    state, settings = helm.state, helm.settings
    if name not in settings.helmsmen:
        raise Refused(f"payload refused: no payload {name[:40]!r} may have the boat; {_choice(settings)}")
    if now_s - state.payloads_s.get(name, -1e9) > settings.failsafe.guest_silent.after_s:
        raise Refused(f"payload refused: no word from {name}")
    helm.request(Mode.HOLD, state.setpoint, now_s)
    state.helmsman, state.relieved = name, ""
    state.reason = f"operator gave the boat to payload {name}"
    helm.note(state.reason)


def starts_and_stops(settings: config.Vehicle) -> dict[str, tuple[str, bool]]:
    """The operator's orders about programs, by name: which one, and whether it shall rest."""
    programs = settings.table("payload")
    return {f"{word}_{name}": (name, word == "stop") for name in programs for word in ("start", "stop")}


def _rest(helm: Helm, name: str, rests: bool) -> None:
    """The service `payload` ends the program, or starts it again. Raises Refused."""
    state = helm.state
    if not rests and state.killed.reason:  # it may turn something that people are near
        raise Refused(f"order refused: kill: {state.killed.reason}")
    state.resting = state.resting | {name} if rests else state.resting - {name}
    helm.note(f"payload {name}: the operator {'stopped' if rests else 'started'} it")


def _choice(settings: config.Vehicle) -> str:
    return f"there are {', '.join(settings.helmsmen)}" if settings.helmsmen else "none in the boat's file has such rights"


assert RIGHTS.keys() < set(console.KINDS.values())
