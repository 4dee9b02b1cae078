"""Who may use a console: operators by their names, each with a role and a key of their own, in a file.

The file has the keys' hashes alone. While it names nobody, the console's token is for everybody who has it.
"""

import hashlib
import hmac
import os
import secrets
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Final

import msgspec

from delfim.base.errors import ConfigError, DelfimError, in_words
from delfim.base.input.untrusted import read_file
from delfim.base.wholefile import replace_file

KEY_BYTES: Final = 18
OPERATORS_MAX: Final = 100
NAME: Final = r"^\w[\w .-]{0,31}$"


class Role(IntEnum):
    """Each may do what those before it may. All may stop all boats."""

    WATCH = 1  # looks, acknowledges, stops
    COMMAND = 2  # takes the command: then the boats obey
    MAINTAIN = 3  # and tries motors and hull


class ConsoleOperator(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    name: Annotated[str, msgspec.Meta(pattern=NAME)]
    role: Annotated[str, msgspec.Meta(pattern="^(watch|command|maintain)$")]
    key_sha256: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]

    @property
    def rank(self) -> Role:
        return Role[self.role.upper()]


class OperatorsFile:
    """`closed`: the file named somebody when the console started, so that the token of the console opens nothing."""

    def __init__(self, file: Path | None) -> None:
        """Raises ConfigError, OSError."""
        self.file, self.reason = file, ""
        self.known = read_operators(file) if file is not None else ()
        self.closed = bool(self.known)
        self._stamp = self._look()

    def of(self, key: str) -> ConsoleOperator | None:
        """Whose key this is."""
        digest = _hash(key)
        return next((each for each in self.known if hmac.compare_digest(each.key_sha256, digest)), None)

    def changed(self) -> bool:
        """Reads the file again when it is another one. A file that cannot be read names nobody, and `reason` says why."""
        if not self.closed or (stamp := self._look()) == self._stamp:
            return False
        self._stamp = stamp
        try:
            assert self.file is not None
            self.known, self.reason = read_operators(self.file), ""
        except (DelfimError, OSError) as error:
            self.known, self.reason = (), in_words(error)
        return True

    def _look(self) -> tuple[int, int] | None:
        try:
            found = os.stat(self.file) if self.file is not None else None
        except OSError:
            return None
        return found and (found.st_mtime_ns, found.st_ino)


def read_operators(file: Path) -> tuple[ConsoleOperator, ...]:
    """A file that is not there names nobody. Raises ConfigError, OSError."""
    if not file.exists():
        return ()
    try:
        return tuple(
            msgspec.json.decode(read_file(file), type=Annotated[list[ConsoleOperator], msgspec.Meta(max_length=OPERATORS_MAX)])
        )
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise ConfigError(str(file), "its words", f"it is no file of operators: {error}") from None


def add_operator(file: Path, name: str, role: str) -> str:
    """Their key, which is kept nowhere. Raises ConfigError, OSError."""
    known = read_operators(file)
    if any(each.name == name for each in known):
        raise ConfigError("--add-operator", name, "is there already: revoke first")
    key = secrets.token_urlsafe(KEY_BYTES)
    words = {"name": name, "role": role, "key_sha256": _hash(key)}
    try:
        new = msgspec.convert(words, ConsoleOperator)
    except msgspec.ValidationError:
        raise ConfigError(
            "--add-operator", f"{name}:{role}", "not a name and a role", "NAME:watch, command or maintain"
        ) from None
    _write(file, (*known, new))
    return key


def revoke_operator(file: Path, name: str) -> None:
    """Their key opens nothing any more, also where a console runs. Raises ConfigError, OSError."""
    known = read_operators(file)
    left = tuple(each for each in known if each.name != name)
    if len(left) == len(known):
        raise ConfigError("--revoke-operator", name, "nobody of that name", ", ".join(each.name for each in known))
    _write(file, left)


def _hash(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()


def _write(file: Path, operators: tuple[ConsoleOperator, ...]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    replace_file(file, msgspec.json.format(msgspec.json.encode(operators), indent=1) + b"\n")
    file.chmod(0o600)
