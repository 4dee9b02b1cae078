"""The missions that a boat was given, by the commands in the sidecars of its log, as the page has them."""

import math
from collections.abc import Iterable, Iterator
from typing import Any, Final

import msgspec

from delfim.base.cooperative import Sliced
from delfim.base.errors import DelfimError
from delfim.console.plans.plan import page_of, with_digest
from delfim.vehicle import console
from delfim.vehicle.plans.mission import Mission
from delfim.vehicle.plans.missionreader import Reading, gathered

EMPTY: Final = Mission(version=1, name="", waypoint=())


def logged_missions(events: Iterable[dict[str, Any]]) -> list[tuple[float, dict[str, Any]]]:
    """When, and what was aboard from then on. What cannot be read is left out: a log may come from anywhere."""
    found: list[tuple[float, Mission]] = []
    for at_s, mission in _missions(events):
        if not found or found[-1][1] != mission:
            found.append((at_s, mission))
    return [(at_s, with_digest(page_of(mission) | {"home": None})) for at_s, mission in found]


def sailed(events: Iterable[dict[str, Any]]) -> Mission | None:
    """The mission that was aboard when a mission was begun last, or else the one that was sent last; None: there was none."""
    told = sorted(events, key=lambda each: each["t_ns"])
    begun_s = max(
        (each["t_ns"] / 1e9 for each in told if each["event"] == "mode" and each.get("value") == "play"), default=math.inf
    )
    found = [(at_s, mission) for at_s, mission in _missions(told) if mission.waypoint]
    return next((mission for at_s, mission in reversed(found) if at_s <= begun_s), found[-1][1] if found else None)


def _missions(events: Iterable[dict[str, Any]]) -> Iterator[tuple[float, Mission]]:
    text, aboard = "", EMPTY
    for event in events:
        if event.get("event") != "command" or event.get("refused"):
            continue
        try:
            command = msgspec.convert(event["value"], console.EVERY)
            if isinstance(command, console.LoadMission):
                text = text + command.text if command.at else command.text
                if command.more:
                    continue
                lines = Reading(text).lines()
                if isinstance(lines, DelfimError):
                    continue
                aboard = Sliced(gathered(lines)).finish()
            elif isinstance(command, console.Upload):
                aboard = command.mission
            elif isinstance(command, console.Unload):
                aboard = msgspec.structs.replace(EMPTY, fence=aboard.fence)
            elif isinstance(command, console.SetFence):
                aboard = msgspec.structs.replace(aboard, fence=command.zones)
            else:
                continue
            yield event["t_ns"] / 1e9, aboard
        except (DelfimError, msgspec.ValidationError, KeyError, TypeError):
            continue
