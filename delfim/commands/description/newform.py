"""The questions of `delfim new` as a form, and what `delfim check` says of a file: `python -m
delfim.commands.description.newform FILE`, a process of its own for each file that a page sends.

FILE.json has the answers so far, by their options. What is printed is the next question, or the files and what the check says.
FILE.toml is a vehicle's file to check.
"""

import argparse
import contextlib
import io
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec

from delfim.base.errors import DelfimError, FormatError
from delfim.base.input.bounded import printed
from delfim.base.input.untrusted import read_file
from delfim.commands.description import check, new

MEMORY_BYTES: Final = 1 << 30
CPU_S: Final = 15
UNNAMED: Final = "myboat"
Text = Annotated[str, msgspec.Meta(max_length=100)]
Answered = Annotated[dict[Text, Text], msgspec.Meta(max_length=20)]


class Unanswered(Exception):
    """The next question: its option, words, default and kinds; after a `wrong` answer the same one again."""

    def __init__(self, **question: Any) -> None:
        super().__init__(question["words"])
        self.question = question


class FormAnswers:
    """Answers what `delfim new` asks. An empty answer is the default."""

    def __init__(self, answers: dict[str, str]) -> None:
        self._answers = answers

    def __call__(
        self, option: str, words: str, default: str, read: Callable[[str], Any], kinds: dict[str, str] | None = None
    ) -> Any:
        question = {"option": option, "words": words, "default": default, "kinds": kinds or {}}
        given = self._answers.get(option)
        if given is None:
            raise Unanswered(**question)
        try:
            return read(given.strip() or default)
        except FormatError as error:
            raise Unanswered(**question, wrong=f"{given}: {error}") from None


def read_form(path: str) -> dict[str, Any]:
    """What the page is told of its answers, or of its file. Raises DelfimError, OSError."""
    if path.endswith(".toml"):
        return {"checked": checked(Path(path))}
    try:
        answers = msgspec.json.decode(read_file(path), type=Answered)
    except msgspec.MsgspecError as error:
        raise FormatError(f"these are no answers: {error}") from None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        file = Path(folder) / f"{_stem(answers)}.toml"
        try:
            written = new.write(file, argparse.Namespace(**dict.fromkeys(new.OF_OWN)), FormAnswers(answers))
        except Unanswered as unanswered:
            return {"question": unanswered.question}
        return {"files": {each.name: each.read_text(encoding="utf-8") for each in written}, "checked": checked(file)}


def _stem(answers: dict[str, str]) -> str:
    """The file has the name of the boat."""
    try:
        return new.name_of(answers.get("name", "") or UNNAMED)
    except FormatError:
        return UNNAMED


def checked(file: Path) -> str:
    """What `delfim check` prints."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            check.run(argparse.Namespace(file=str(file), set=[], sea=False))
        except DelfimError as error:
            print(f"delfim: {error}")
    return said.getvalue().replace(f"{file.parent}/", "").strip()


if __name__ == "__main__":
    sys.exit(printed(read_form, sys.argv[1], MEMORY_BYTES, CPU_S))
