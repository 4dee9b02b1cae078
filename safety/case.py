"""The records of the safety case: losses, hazards, control actions, and the ways in which each can be unsafe (STPA)."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

RECORDS: Final = Path("safety/case.toml")
Kind = Literal["not given", "given", "too early or late", "too short or long"]
KINDS: Final[tuple[Kind, ...]] = "not given", "given", "too early or late", "too short or long"
Text = Annotated[str, msgspec.Meta(min_length=1)]


class Link(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where a constraint is in the code, which test holds it, and a change of that code with which the test fails."""

    code: Text  # a file
    change: Text  # as `make mutants` names it: function | text of the line | what changes
    test: Text  # file::function

    @property
    def function(self) -> str:
        return self.change.partition(" | ")[0]


class Unsafe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An unsafe control action, the constraint that follows, and what holds it."""

    id: Text
    kind: Kind
    when: Text
    hazards: Annotated[list[str], msgspec.Meta(min_length=1)]
    constraint: Text
    held: list[Link] = []


class ControlAction(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What one controller does to another, or to the boat. `harmless`: the kinds that lead to no hazard, and why."""

    by: Text
    to: Text
    does: Text
    unsafe: list[Unsafe] = []
    harmless: dict[Kind, Text] = {}


class Hazard(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    is_: Text = msgspec.field(name="is")
    losses: Annotated[list[str], msgspec.Meta(min_length=1)]


class Box(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A controller, or what is controlled. `place`: column and row in the picture."""

    is_: Text = msgspec.field(name="is")
    place: tuple[float, float]
    hears: dict[str, Text] = {}  # from whom: feedback


class Case(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    about: Text
    kept: Text  # how
    limits: Text
    losses: dict[str, Text]
    hazards: dict[str, Hazard]
    controllers: dict[str, Box]
    actions: dict[str, ControlAction]

    def unsafe(self) -> Iterator[Unsafe]:
        for action in self.actions.values():
            yield from action.unsafe

    def links(self) -> list[Link]:
        """Each once."""
        return list(dict.fromkeys(link for each in self.unsafe() for link in each.held))


def read(path: Path = RECORDS) -> Case:
    """Raises msgspec.ValidationError or tomllib.TOMLDecodeError with the place."""
    return msgspec.convert(tomllib.loads(path.read_text()), Case)


def holes(case: Case) -> list[str]:
    """What the records leave out, in words: links to nothing, and kinds of an action that nobody thought about."""
    found, ids = list[str](), list[str]()
    for name, hazard in case.hazards.items():
        found += [f"hazard {name}: there is no loss {loss}" for loss in hazard.losses if loss not in case.losses]
        found += [] if any(name in each.hazards for each in case.unsafe()) else [f"hazard {name}: no unsafe action leads to it"]
    caused = {loss for hazard in case.hazards.values() for loss in hazard.losses}
    found += [f"loss {name}: no hazard leads to it" for name in case.losses if name not in caused]
    for name, box in case.controllers.items():
        found += [f"{name}: there is no {other}" for other in box.hears if other not in case.controllers]
    for name, action in case.actions.items():
        found += [f"{name}: there is no {end}" for end in (action.by, action.to) if end not in case.controllers]
        told = {each.kind for each in action.unsafe}
        found += [f"{name}: nothing about '{kind}'" for kind in KINDS if kind not in told and kind not in action.harmless]
        found += [f"{name}: '{kind}' is harmless and is not" for kind in KINDS if kind in told and kind in action.harmless]
        for each in action.unsafe:
            ids.append(each.id)
            found += [] if each.held else [f"{each.id}: no function and no test holds it: {each.constraint}"]
            found += [f"{each.id}: there is no hazard {hazard}" for hazard in each.hazards if hazard not in case.hazards]
    return found + [f"{name} stands twice" for name in sorted({name for name in ids if ids.count(name) > 1})]
