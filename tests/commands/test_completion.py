"""The shell completes what the commands declare: the script is read by bash itself."""

import argparse
import shutil
import subprocess

import pytest

from delfim.commands import SENTENCES
from delfim.commands.operation import completion

BASH = shutil.which("bash")


@pytest.fixture(scope="module")
def script() -> str:
    return completion.script()


def completed(script: str, *words: str) -> list[str]:
    """What bash offers for the last of these words."""
    listed = " ".join(f"'{word}'" for word in words)
    tried = f"COMP_WORDS=({listed}); COMP_CWORD={len(words) - 1}; _delfim delfim '{words[-1]}' '{words[-2]}'"
    said = f'{script}\n{tried}\nprintf "%s\\n" "${{COMPREPLY[@]}}"'
    assert BASH is not None
    done = subprocess.run([BASH, "--norc", "-u"], input=said, capture_output=True, text=True, check=True, timeout=200)
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("delfim", "com"), ["completion", "commission"]),
        (("delfim", "ch"), ["charts", "check"]),
        (("delfim", "charts", "--air"), ["--air-draught"]),
        (("delfim", "--v"), ["--version"]),
        (("delfim", "sim", "--lock"), ["--lockstep"]),
        (("delfim", "sim", "etc/delfimx.toml", "--no"), ["--no-browser"]),
        (
            ("delfim", "log", ""),
            ["ls", "cat", "info", "plot", "export", "replay", "repair", "audit", "check", "evidence", "fetch"],
        ),
        (("delfim", "log", "re"), ["replay", "repair"]),
        (("delfim", "survey", ""), ["lines", "rest", "chart", "report"]),
        (("delfim", "can", "dump", "-t", ""), ["a", "d", "z", "A"]),
        (("delfim", "shore", "--encapsulation", "c"), ["cslip"]),
        (("delfim", "sim", ""), []),  # files, by bash itself
        (("delfim", "sim", "--mission", "etc/"), []),
        (("delfim", "nothing", "--"), []),
    ],
)
def test_bash_offers_what_may_stand_there(script: str, words: tuple[str, ...], offered: list[str]) -> None:
    assert sorted(completed(script, *words)) == sorted(offered)


def test_each_option_of_each_command_is_in_it(script: str) -> None:
    found, with_verbs = completion.parsers()
    assert set(SENTENCES) <= set(found)
    assert with_verbs == ["can", "iridium", "log", "survey", "parts"]
    for of, parser in found.items():
        line = next(line for line in script.splitlines() if line.strip().startswith(f'"{of}":*:-*)'))
        options = {name for each in parser._actions if each.help != argparse.SUPPRESS for name in each.option_strings}
        assert options <= set(line.replace('"', " ").split()), of
