"""`delfim completion`: a script with which bash, and zsh by bashcompinit, completes commands, verbs and options.

It is made of what the commands declare, when it is asked for: no other command pays for it.
"""

import argparse
from collections.abc import Iterable, Iterator
from typing import Final

from delfim.commands import SENTENCES, loaded

SCRIPT: Final = """\
# delfim completion: of a word that begins with a dash the options, else what may stand there; of all others the files.
_delfim() {{
    local of=${{COMP_WORDS[1]}} words=
    if [ "$COMP_CWORD" -eq 1 ]; then
        of=
    elif [ "$COMP_CWORD" -gt 2 ]; then
        case $of in {with_verbs}) of="$of ${{COMP_WORDS[2]}}" ;; esac
    fi
    case "$of:$3:$2" in
{cases}
    esac
    COMPREPLY=($(compgen -W "$words" -- "$2"))
}}
complete -o bashdefault -o default -F _delfim delfim"""


def options(parser: argparse.ArgumentParser) -> None:
    pass


def run(_: argparse.Namespace) -> int:
    print(script())
    return 0


def script() -> str:
    """The script for bash."""
    top, with_verbs = parsers()
    cases = [row for of, parser in top.items() for row in _cases(of, parser)]
    first = _row(":*", (*SENTENCES, "--help", "--version"))
    return SCRIPT.format(with_verbs="|".join(with_verbs), cases="\n".join([first, *cases]))


def parsers() -> tuple[dict[str, argparse.ArgumentParser], list[str]]:
    """The parsers by command, and by command and verb; and the commands that have verbs."""
    found, with_verbs = dict[str, argparse.ArgumentParser](), list[str]()
    for name in SENTENCES:
        found[name] = argparse.ArgumentParser(prog=f"delfim {name}")
        loaded(name).options(found[name])
        if verbs := _verbs(found[name]):
            with_verbs.append(name)
            found |= {f"{name} {verb}": parser for verb, parser in verbs.items()}
    return found, with_verbs


def _verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _cases(of: str, parser: argparse.ArgumentParser) -> Iterator[str]:
    """The values of each option that has choices, the options, and the verbs."""
    actions = [each for each in parser._actions if each.help != argparse.SUPPRESS]
    for each in actions:
        if each.choices:
            places = [f'"{of}":{name}:*' for name in each.option_strings] or [f'"{of}":*:[!-]*', f'"{of}":*:']
            yield _row("|".join(places), map(str, each.choices))
    yield _row(f'"{of}":*:-*', (name for each in actions for name in each.option_strings))


def _row(pattern: str, words: Iterable[str]) -> str:
    return f'        {pattern}) words="{" ".join(words)}" ;;'
