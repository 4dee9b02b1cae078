"""The page of the safety case and its pictures, made of the records."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from safety.case import KINDS, Case, ControlAction, Unsafe
from safety.drawing import control_structure, hazard_tree, loss_tree

PAGE: Final = Path("docs/safety-case.md")
PICTURES: Final = Path("docs/pictures")


def made(case: Case) -> dict[Path, str]:
    """All files that follow from the records."""
    files = {PICTURES / f"safety-{loss.lower()}.svg": loss_tree(case, loss) for loss in case.losses}
    files |= {PICTURES / f"safety-{hazard.lower()}.svg": hazard_tree(case, hazard) for hazard in case.hazards}
    return {PAGE: "\n".join(_page(case)), PICTURES / "safety-control.svg": control_structure(case), **files}


def stale(case: Case) -> list[str]:
    """The files that are not as the records are."""
    return [str(path) for path, text in made(case).items() if not path.exists() or path.read_text() != text]


def write(case: Case) -> None:
    for path, text in made(case).items():
        path.write_text(text)


def _page(case: Case) -> Iterator[str]:
    yield "# The safety case\n"
    yield f"{case.about.strip()}\n"
    yield f"{len(list(case.unsafe()))} unsafe actions of {len(case.actions)} control actions, {len(case.links())} proofs."
    yield "This page is made of [its records](../safety/case.toml): `make safety` proves what is new or stale, and writes it.\n"
    yield "<!-- not run: it runs tests with changed code -->\n"
    yield "    make safety                 # prove what is new or stale"
    yield "    make safety ARGS=--all      # prove everything again\n"
    yield case.kept.strip() + "\n"
    yield "## What it does not say\n"
    yield f"{case.limits.strip()}\n"
    yield "## Who controls what\n"
    yield f"![{', '.join(case.controllers)}](pictures/safety-control.svg)\n"
    yield "## Losses\n"
    for loss, words in case.losses.items():
        yield f"### {loss}: {words}\n"
        yield f"![{words}: hazards, unsafe control actions, functions](pictures/safety-{loss.lower()}.svg)\n"
        named = ((name, each.is_) for name, each in case.hazards.items() if loss in each.losses)
        yield from (f"* [{name}](#{_anchor(f'{name}: {words}')}): {words}" for name, words in named)
        yield ""
    yield "## Hazards\n"
    for name, hazard in case.hazards.items():
        yield f"### {name}: {hazard.is_}\n"
        yield f"It leads to {', '.join(hazard.losses)}.\n"
        yield f"![{hazard.is_}: when, what follows, and where it is kept](pictures/safety-{name.lower()}.svg)\n"
        leads = [key for key, action in case.actions.items() if any(name in each.hazards for each in action.unsafe)]
        yield f"Tests and changes: {', '.join(f'[{key}](#{key})' for key in leads)}.\n"
    yield "## Control actions\n"
    for key, action in case.actions.items():
        yield from _action(key, action)


def _anchor(heading: str) -> str:
    """Of a heading, as GitHub and the site name it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def _action(key: str, action: ControlAction) -> Iterator[str]:
    yield f"### {key}\n"
    yield f"The {action.by}, to the {action.to}: {action.does[0].lower()}{action.does[1:]}.\n"
    for kind in KINDS:
        for each in action.unsafe:
            if each.kind == kind:
                yield from _unsafe(each)
        if kind in action.harmless:
            yield f"* *{kind}*: harmless. {action.harmless[kind]}."
    yield ""


def _unsafe(each: Unsafe) -> Iterator[str]:
    yield f"* **{each.id}**, *{each.kind}*: {each.when} ({', '.join(each.hazards)}). **{each.constraint}.**"
    for link in each.held:
        file, _, test = link.test.partition("::")
        _, _, change = link.change.partition(" | ")
        line, _, what = change.rpartition(" | ")
        yield f"  * `{link.function}` in [{link.code}](../{link.code}), held by `{test}` in [{file}](../{file}),"
        yield f"    which fails with the line `{line}` changed: `{what}`"
