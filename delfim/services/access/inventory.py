"""The inventory of a boat by its vehicle's file: hosts, ports, lines, programs, versions, keys. No secret is in it.

Of a file that is not on this computer, or that others may not read, it says so: the boat's own computer knows more than a desk.
"""

import base64
import binascii
import hashlib
import os
import platform
import re
import sys
from collections.abc import Iterator, Sequence
from importlib import metadata
from importlib.util import find_spec
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from delfim import __version__, config
from delfim.base.errors import ConfigError
from delfim.base.input.keys import read_key
from delfim.base.input.untrusted import read_file
from delfim.services.access.exposure import doors
from delfim.services.suite import services

HOST: Final = re.compile(r"(?:([a-z-]+):(?://)?)?(?:[^@/]*@)?(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9.-]+):([0-9]{1,5})(?:/.*)?")
SECRETS: Final = ("key", "certificate", "credentials", "authorities", "host_key")  # keys of the file that name a file with one
PUBLIC: Final = ("keys", "signers")  # that hold public keys themselves
PROGRAM_BYTES: Final = 1 << 28  # of a payload's program that is hashed
Kind = Literal["host", "port", "line", "program", "version", "key"]


class InventoryItem(NamedTuple):
    """One row. `what`: in words, and a fingerprint where there is one."""

    kind: Kind
    name: str
    place: str
    what: str


def inventory(settings: config.Vehicle, written: dict[str, Any]) -> list[InventoryItem]:
    """List all of a boat. `written`: the tree of the vehicle's file, without its defaults."""
    rows = services(settings)
    running = [row.name for row in rows]
    told = [(key, text) for key, text in _values(written, "") if not key.startswith("simulation.")]
    told += settings.outside("device").items()
    found = [*_hosts(told)]
    found += [InventoryItem("port", door.service, door.place, f"{door.who}: {door.may}") for door in doors(settings, running)]
    lines = settings.outside("interface") | {key: text for key, text in told if text.startswith("/dev/")}
    found += [InventoryItem("line", key, text, "bus" if key.endswith("interface") else "device") for key, text in lines.items()]
    found += [InventoryItem("program", "supervisor", "process", "delfim.services.suite:supervise")]
    found += (
        [InventoryItem("program", "outlet", "process", "delfim.services.suite:outlet")] if settings.driven("outlet") else []
    )
    found += [InventoryItem("program", row.name, row.place, row.entry) for row in rows]
    found += _payloads(settings)
    found += _versions()
    if "sshd" in running and all(key != "sshd.host_key" for key, _ in told):
        told.append(("sshd.host_key", settings.table("sshd").host_key))
    return found + list(_keys(told))


def _values(tree: Any, key: str) -> Iterator[tuple[str, str]]:
    """All texts of the file with their keys, in its order."""
    if isinstance(tree, dict):
        for name, each in tree.items():
            yield from _values(each, f"{key}.{name}" if key else name)
    elif isinstance(tree, list):
        for each in tree:
            yield from _values(each, key)
    elif isinstance(tree, str):
        yield key, tree


def _hosts(told: Sequence[tuple[str, str]]) -> Iterator[InventoryItem]:
    """Hosts and networks beyond this computer, each once, with the keys that name it."""
    named = dict[str, list[str]]()
    for key, text in told:
        if host := _host(text):
            named.setdefault(host, []).append(key)
    for host, keys in named.items():
        yield InventoryItem("host", host, "network" if "/" in host else "host", ", ".join(dict.fromkeys(keys)))


def _host(text: str) -> str:
    """The host or network that a value names; "" for none, or for this computer."""
    found = HOST.fullmatch(text)
    host = found[2].strip("[]") if found else text
    try:
        network = ip_network(host, strict=False)
    except ValueError:  # a name, where something like a port stands behind it
        return host if found and found[1] and "." in host else ""
    alone = ip_address(network.network_address)
    return "" if alone.is_loopback or alone.is_unspecified or (not found and host.isdecimal()) else host


def _payloads(settings: config.Vehicle) -> Iterator[InventoryItem]:
    """The programs of others that the boat starts, each with the digest of its file."""
    for name, its in (settings.table("payload") or {}).items():
        may = f"may {', '.join(its.may)}" if its.may else "may order nothing"
        reach = "network" if its.network else "no network"
        yield InventoryItem(
            "program", f"payload:{name}", its.command[0], f"user {its.user}, {reach}, {may}; {_digest(its.command[0])}"
        )


def _digest(path: str) -> str:
    try:
        return f"sha256 {hashlib.sha256(read_file(path, PROGRAM_BYTES)).hexdigest()}"
    except OSError as error:
        return f"its file: {error.strerror or error}"


def _versions() -> Iterator[InventoryItem]:
    """Of Delfim, Python, the system, and of each package that the boat's programs need, with those that it needs itself."""
    yield InventoryItem("version", "delfim", str(Path(__file__).parents[2]), __version__)
    yield InventoryItem("version", "python", sys.executable, platform.python_version())
    yield InventoryItem("version", "kernel", platform.machine(), f"{platform.system()} {platform.release()}")
    for name in sorted(_closure("delfim")):
        try:
            yield InventoryItem("version", name, "package", metadata.version(name))
        except metadata.PackageNotFoundError:
            yield InventoryItem("version", name, "package", "not on this computer")


def _closure(root: str) -> set[str]:
    """The packages that a package needs, and those that they need."""
    ahead, found = [*_required(root, ("services",))], set[str]()
    while ahead:
        if (name := ahead.pop()) not in found:
            found.add(name)
            ahead += _required(name, ())
    return found


def _required(name: str, extras: Sequence[str]) -> list[str]:
    """The packages that one asks for on this system, those of these extras among them."""
    from packaging.requirements import Requirement

    try:
        asked = [Requirement(each) for each in metadata.requires(name) or []]
    except metadata.PackageNotFoundError:
        return []
    wanted = [each for each in asked if not each.marker or any(each.marker.evaluate({"extra": one}) for one in ("", *extras))]
    return [each.name.lower().replace("_", "-") for each in wanted]


def _keys(told: Sequence[tuple[str, str]]) -> Iterator[InventoryItem]:
    for key, text in told:
        last = key.rpartition(".")[2]
        if last == "password":
            yield InventoryItem("key", key, "in the file", "a password, hashed")
        elif last in PUBLIC and text.startswith(("ssh-", "ecdsa-", "sk-")):
            yield InventoryItem("key", key, "in the file", f"public, {_of_line(text)}")
        elif last in SECRETS and text:
            yield InventoryItem("key", key, text, _of_file(text, last))


def _of_file(path: str, kind: str) -> str:
    """What lies in a key's file: who may read it, and a fingerprint that gives nothing away."""
    try:
        mode, content = os.stat(path).st_mode & 0o777, read_file(path)
    except OSError as error:
        return f"{(error.strerror or str(error)).lower()} on this computer"
    others = ", others may read it" if mode & 0o077 and kind not in ("certificate", "authorities") else ""
    return f"mode {mode:04o}{others}; {_fingerprint(path, content, kind)}"


def _fingerprint(path: str, content: bytes, kind: str) -> str:
    if kind == "credentials":
        return "a user and a password, of which no fingerprint is told"
    if kind == "key":
        try:
            return f"shared by all who hold it, {_of_bytes(b'delfim inventory' + read_key(path))}"
        except ConfigError as error:
            return str(error).removeprefix(f"{path}: ")
    if find_spec("cryptography") is None:
        return "not read: the package cryptography is not on this computer"
    from cryptography.exceptions import UnsupportedAlgorithm

    try:
        return _of_certificate(content) if b"BEGIN CERTIFICATE" in content else _of_private(content)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        return f"not read: {error}"


def _of_certificate(content: bytes) -> str:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    its = x509.load_pem_x509_certificate(content)
    told = f"certificate of {its.subject.rfc4514_string()}, valid until {its.not_valid_after_utc.date().isoformat()}"
    return f"{told}, SHA256 {its.fingerprint(hashes.SHA256()).hex()}"


def _of_private(content: bytes) -> str:
    from cryptography.hazmat.primitives import serialization

    private: Any = serialization.load_ssh_private_key(content, None)
    line = private.public_key().public_bytes(serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH)
    return f"private, {_of_line(line.decode())}"


def _of_line(line: str) -> str:
    """The fingerprint of a public key as ssh-keygen tells it."""
    words = line.split()
    try:
        digest = hashlib.sha256(base64.b64decode(words[1], validate=True)).digest()
    except (IndexError, binascii.Error):
        return "not a public key"
    told = " ".join(words[2:])
    return f"{words[0]} SHA256:{base64.b64encode(digest).decode().rstrip('=')}{f', {told}' if told else ''}"


def _of_bytes(secret: bytes) -> str:
    return f"SHA256 {hashlib.sha256(secret).hexdigest()[:32]}"
