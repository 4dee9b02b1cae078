"""Input from outside is bounded before it is read: a file by its size, JSON and TOML by their depth and numbers."""

import json
import os
import re
import stat
from pathlib import Path
from typing import Any, Final

from delfim.base.errors import ConfigError, FormatError

TEXT_BYTES: Final = 1 << 20  # of a file that people write: settings, a mission, a scenario
_DEEP: Final = re.compile(  # a dotted key, which takes the square of its length to be read as TOML
    r"""(?<![.\w"'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){64}"""
)
_HALVES: Final = re.compile(r"\\u[dD][89a-fA-F]")  # of characters, in JSON
_KINDS: Final = ((stat.S_ISFIFO, "a pipe"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"))


def read_file(path: str | Path, bytes_max: int = TEXT_BYTES) -> bytes:
    """Read a whole file. Raises OSError, in words if it is too large, or is a pipe or device that might never end or never
    begin."""
    status = os.stat(path)
    for is_kind, name in _KINDS:
        if is_kind(status.st_mode):
            raise OSError(0, f"this is {name}, not a file", str(path))
    if status.st_size > bytes_max:
        raise OSError(0, f"{status.st_size} bytes: files of more than {bytes_max} are not read", str(path))
    with open(path, "rb") as file:
        return file.read(status.st_size)  # not what is appended meanwhile


def read_text(path: str | Path) -> str:
    """Read a file that people write; some editors of Windows begin one with a mark of its encoding. Raises OSError,
    FormatError."""
    try:
        return read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"not UTF-8: {error.reason} at byte {error.start}") from None


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML of bounded depth. Raises FormatError."""
    import tomllib  # here: a log's writer reads none, and saves 1 MB

    if _DEEP.search(text):
        raise FormatError("not TOML: nested too deep")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise FormatError("not TOML: nested too deep") from None
    except ValueError as error:  # also a number of thousands of digits
        raise FormatError(f"not TOML: {error}") from None


def parse_json(text: str | bytes) -> Any:
    """Parse JSON of bounded depth. Raises FormatError."""
    try:
        text = text.decode() if isinstance(text, bytes) else text
        told = json.loads(text)
        if _HALVES.search(text):
            json.dumps(told, ensure_ascii=False).encode()  # half a character could not be printed or sent on
        return told
    except RecursionError:
        raise FormatError("not JSON: nested too deep") from None
    except ValueError as error:
        raise FormatError(f"not JSON: {error}") from None


def read_private(path: str | Path, key: str) -> str:
    """Read the text, in ASCII, of a file that nobody else may read. `key` names the file in a refusal. Raises ConfigError,
    UnicodeDecodeError."""
    try:
        if os.name == "posix" and Path(path).stat().st_mode & 0o077:
            raise ConfigError(str(path), key, "others may read it", "mode 0600")
        return read_file(path).decode("ascii").strip()
    except OSError as error:
        raise ConfigError(str(path), key, error.strerror or str(error)) from None


def read_credentials(path: str) -> str:
    """Read USER:PASSWORD, the one line of a file that nobody else may read. Raises ConfigError."""
    try:
        text = read_private(path, "credentials")
    except ValueError:
        raise ConfigError(path, "credentials", "not ASCII", "USER:PASSWORD") from None
    if ":" not in text or not text.isprintable():
        raise ConfigError(path, "credentials", "no user and password", "USER:PASSWORD in one line")
    return text
