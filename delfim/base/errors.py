"""The five exceptions of Delfim. Foreign ones become one of these where they enter; loops do not catch, supervisors do."""

from collections.abc import Iterable
from typing import Final

LINE_MAX: Final = 600  # characters; the longest message of ours has half of that
_TAIL: Final = 200  # characters kept of its end: that is where reasons are


class DelfimError(Exception):
    """An error that a person can read and act on; the command line prints it without a traceback. Its text is one line, even
    if it repeats text from outside."""

    def __str__(self) -> str:
        return one_line(super().__str__())


class ConfigError(DelfimError):
    """A vehicle file or mission file that is refused. Names file, key, reason and allowed values."""

    def __init__(self, file: str, key: str, reason: str, allowed: str = "") -> None:
        self.file, self.key, self.reason, self.allowed = file, key, reason, allowed
        place = f"{file}: {key}" if key else file
        super().__init__(f"{place}: {reason}" + (f" (allowed: {allowed})" if allowed else ""))


class FormatError(DelfimError, ValueError):
    """Bytes or text from outside that cannot be understood: a malformed frame, message, command or log."""


class BusError(DelfimError, OSError):
    """A CAN bus that cannot be opened, went bus-off or went away."""


class Refused(DelfimError):
    """A command that was understood and not carried out; the text is the reason, in words for the operator."""


class PermanentFailure(DelfimError):
    """A service that must not be started again: trying harder cannot help (missing device file, wrong settings)."""


def one_line(text: str) -> str:
    """Make text fit for a terminal, a log or a page: unprintable characters are escaped, and of a long text only both ends
    stay."""
    if len(text) > LINE_MAX:
        text = f"{text[: LINE_MAX - _TAIL]} ... {text[-_TAIL:]}"
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else " " if each == "\n" else f"\\x{ord(each):02x}" for each in text)


def in_words(error: BaseException) -> str:
    """Describe an error to people: our own as it is, the system's without its number, a defect with its kind."""
    if isinstance(error, DelfimError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:
        return one_line(error.strerror if error.filename is None else f"{error.filename}: {error.strerror}")
    return one_line(f"{type(error).__name__}: {error}".removesuffix(": "))


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return "; did you mean this?" if a known word resembles this one, otherwise an empty text."""
    from difflib import get_close_matches  # loaded only for a mistake

    near = get_close_matches(word, list(known), 1)
    return f"; did you mean {near[0]}?" if near else ""
