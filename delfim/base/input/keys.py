"""A shared key in a file of its own, 64 hexadecimal digits, which its owner alone may read."""

import os
import secrets
from pathlib import Path
from typing import Final

from delfim.base.errors import ConfigError
from delfim.base.input.untrusted import read_private

KEY_BYTES: Final = 32


def new_key(path: str | Path) -> None:
    """Write a new key that its owner alone may read. Raises OSError, also FileExistsError: a key that boats know is not
    replaced."""
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
        file.write(secrets.token_hex(KEY_BYTES) + "\n")


def read_key(path: str | Path) -> bytes:
    """Read the key from a file of 64 hexadecimal digits. Raises ConfigError, also for a file that others may read."""
    try:
        key = bytes.fromhex(read_private(path, "key"))
    except ValueError:
        raise ConfigError(str(path), "key", "no key", f"{2 * KEY_BYTES} hexadecimal digits") from None
    if len(key) != KEY_BYTES:
        raise ConfigError(str(path), "key", f"{len(key)} bytes", f"{2 * KEY_BYTES} hexadecimal digits")
    return key
