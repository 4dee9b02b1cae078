"""Fetches logs from a boat over a slow radio: ftp://, ftps:// (RFC 959, 3659, 4217) or sftp:// (needs asyncssh), state logs
first.

A file that is here in full is not fetched again; one that is here in part goes on where it stopped (NAME.part), also after a
lost link. On arrival its size is compared and a gzip file's checksums are verified; a damaged one is fetched once more from
its beginning, and accepted if both copies agree. One that lacks its end was cut by a power failure or is still being written.

The boat is not believed: only names that logs have are taken; its listing, its sizes, what its files inflate to are bounded.
"""

import asyncio
import contextlib
import ftplib
import getpass
import hashlib
import io
import os
import posixpath
import re
import shutil
import ssl
import sys
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol
from urllib.parse import SplitResult, unquote, urlsplit

from delfim.base.errors import DelfimError
from delfim.logging import chain
from delfim.logging.ashore import tree
from delfim.logging.ashore.progress import progress
from delfim.logging.ashore.repair import condition
from delfim.logging.ashore.tree import Span
from delfim.logging.reading import LOG_BYTES, raw

ATTEMPTS: Final = 5  # in a row without a byte
TIMEOUT_S: Final = 20.0
BLOCK: Final = 1 << 16
ENTRIES: Final = 200_000  # of all listings of a boat: a year's logs are fewer
FREE_BYTES: Final = 1 << 26  # that stay free on this disk
TIMES_NS: Final = range(1 << 62)  # that a file can have here
_KINDS: Final = re.compile(r"[0-9-]+(-repaired)?\.(state|log|jsonl|meta\.jsonl|chain)(\.gz)?")


class RemoteFile(NamedTuple):
    """A file on the boat."""

    path: str  # below the tree: 20100101/state/093000.state.gz
    size: int
    changed_ns: int


class LogSource(Protocol):
    """A source of files. Every method raises OSError or EOFError when the link is lost."""

    def entries(self) -> list[RemoteFile]: ...
    def read(self, path: str, offset: int, sink: Callable[[bytes], object]) -> None: ...
    def write(self, path: str, data: bytes, sent: Callable[[int], object]) -> None: ...
    def close(self) -> None: ...


class Fetched(NamedTuple):
    fetched: list[str]  # paths
    bytes: int
    cut: list[str]  # of these, the ones that are cut on the boat too: delfim log repair


def fetch(url: str, directory: Path, ids: Sequence[str], span: Span, *, summary: bool) -> tuple[Fetched, float]:
    """Fetch the files that are not here yet, state logs first. `summary`: only them and the sidecars. Returns the outcome, and
    how long it took, s. Raises DelfimError."""
    began_s = time.monotonic()
    connect = opener(url)
    try:
        with contextlib.closing(connect()) as boat:
            entries = wanted(boat.entries(), ids, span, summary=summary)
    except (OSError, EOFError, ftplib.Error, UnicodeError) as error:
        raise DelfimError(f"{urlsplit(url).hostname}: {error or type(error).__name__}") from None
    outcome = transfer(connect, entries, directory, _tell)
    return outcome, time.monotonic() - began_s


def _tell(words: str) -> None:
    print(words, file=sys.stderr)


def wanted(entries: Sequence[RemoteFile], ids: Sequence[str], span: Span, *, summary: bool) -> list[RemoteFile]:
    """The log files among these, in the order in which they matter: sidecars, state logs, the rest; the newest first. A name
    that cannot be a log's is reported."""
    margin_ns = tree.LATE_S * 1_000_000_000
    result = []
    for entry in entries:
        parts = entry.path.split("/")
        if len(parts) != 3 or not (tree.is_log(parts[0], parts[2]) and tree.is_id(parts[1]) and _KINDS.fullmatch(parts[2])):
            continue
        if ids and parts[1] not in ids:
            continue
        if not 0 <= entry.size <= LOG_BYTES or entry.changed_ns not in TIMES_NS:
            _tell(f"{entry.path}: left out: no log has its size or time as the boat tells them")
            continue
        if summary and not (parts[1] == "state" or parts[2].endswith(".jsonl")):
            continue
        begin_ns = tree.begins(parts[0], parts[2])
        if begin_ns - margin_ns <= span.to_ns and max(entry.changed_ns, begin_ns) + margin_ns >= span.from_ns:
            result.append(entry)
    result.sort(key=lambda entry: entry.path, reverse=True)
    return sorted(result, key=_rank)


def _bar(total: float) -> Callable[[float], None]:
    return progress("fetch", total, bytes=True)


def transfer(
    connect: Callable[[], LogSource],
    entries: Sequence[RemoteFile],
    directory: Path,
    tell: Callable[[str], object],
    show: Callable[[float], Callable[[float], None]] = _bar,
) -> Fetched:
    """Fetch these files where they are not here in full. A lost link is restored. `show` is told how many bytes are to come,
    and then how many have. Raises DelfimError if a link is not restored; the data received so far stays for the next time."""
    due = [entry for entry in entries if _size(directory / entry.path) != entry.size]
    total = sum(entry.size - _here(directory / entry.path, entry.size) for entry in due)
    tell(f"{len(due)} files to fetch, {total / 1e6:.1f} MB; {len(entries) - len(due)} are here")
    directory.mkdir(parents=True, exist_ok=True)
    if total > (free := shutil.disk_usage(directory).free - FREE_BYTES):
        raise DelfimError(f"{directory} has room for {max(free, 0) / 1e6:.1f} MB: fetch a part, by --id, --from and --to")
    told, fetched, cut, arrived = show(total), [], [], [0]

    def count(data: bytes) -> None:
        arrived[0] += len(data)
        told(min(arrived[0], total - 1))

    with _Link(connect) as link:
        for entry in due:
            if not _fetched(link, entry, directory / entry.path, count):
                cut.append(entry.path)
            fetched.append(entry.path)
    told(total)
    return Fetched(fetched, arrived[0], cut)


class _Link:
    """A connection that is made again when it is lost, as long as something comes."""

    def __init__(self, connect: Callable[[], LogSource]) -> None:
        self._connect = connect
        self._boat: LogSource | None = None

    def __enter__(self) -> "_Link":
        return self

    def __exit__(self, *_: object) -> None:
        self._drop()

    def read(self, path: str, part: Path, size: int, count: Callable[[bytes], None]) -> None:
        """Read the rest of a file, and append it to the part that is here."""
        attempts = 0
        with part.open("ab") as file:
            while file.tell() < size:
                before = file.tell()

                def sink(data: bytes) -> None:
                    if file.tell() >= size:
                        raise EOFError("it grew meanwhile")
                    count(data[: size - file.tell()])
                    file.write(data[: size - file.tell()])

                try:
                    self._boat = self._boat or self._connect()
                    self._boat.read(path, before, sink)
                    lost = "the transfer ended early" if file.tell() < size else ""
                except (OSError, EOFError, ftplib.Error, UnicodeError) as error:
                    lost = str(error) or type(error).__name__
                    self._drop()
                attempts = 0 if file.tell() > before else attempts + 1
                if lost and attempts >= ATTEMPTS:
                    raise DelfimError(f"{path}: {lost}; run the same command again to go on from here")
            file.flush()
            os.fsync(file.fileno())

    def _drop(self) -> None:
        if self._boat:
            with contextlib.suppress(OSError, EOFError, ftplib.Error):
                self._boat.close()
        self._boat = None


def _fetched(link: _Link, entry: RemoteFile, target: Path, count: Callable[[bytes], None]) -> bool:
    """Fetch one file and verify it; False where the boat's own is cut."""
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(target.name + ".part")
    here = _here(target, entry.size)
    if _size(part) > entry.size:
        part.unlink()
    if target.exists() and here > _size(part):  # it has grown since
        os.replace(target, part)
    link.read(entry.path, part, entry.size, count)
    how = _condition(part)
    if how == "damaged":
        first = _digest(part)
        part.unlink()
        link.read(entry.path, part, entry.size, count)
        how = _condition(part)
        if how == "damaged" and _digest(part) != first:
            part.unlink()
            raise DelfimError(f"{entry.path}: arrives damaged, differently each time; try again on a better link")
    os.utime(part, ns=(entry.changed_ns, entry.changed_ns))
    os.replace(part, target)
    return not how


def _is_id(name: str) -> bool:
    """Whether a folder has the name of an id; another name is reported."""
    if not tree.is_id(name):
        _tell(f"{tree.readable(name)}: left out: no log has such a name")
    return tree.is_id(name)


def _number(text: str) -> int:
    """Parse a number; -1: there is none."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 19 else -1


def _changed_ns(text: str) -> int:
    """Parse the time of a listing, which may have fractions of a second, to ns; -1: there is none."""
    try:
        return int(datetime.strptime(text[:14], "%Y%m%d%H%M%S").replace(tzinfo=UTC).timestamp()) * 1_000_000_000
    except ValueError:
        return -1


def _condition(file: Path) -> str:
    """The condition of a gzip file; others carry no checksum."""
    return condition(raw(file)) if file.name.removesuffix(".part").endswith(".gz") else ""


def _digest(file: Path) -> bytes:
    with file.open("rb") as data:
        return hashlib.file_digest(data, "sha256").digest()


def _size(file: Path) -> int:
    return file.stat().st_size if file.exists() else -1


def _here(target: Path, size: int) -> int:
    """The number of bytes that need not be fetched."""
    its = max(_size(target), _size(target.with_name(target.name + ".part")), 0)
    return its if its <= size else 0


def _rank(entry: RemoteFile) -> int:
    """Chains come first: what they tell of is then as long, or has grown."""
    ends = (chain.SUFFIX, ".jsonl")
    return next((rank for rank, end in enumerate(ends) if entry.path.endswith(end)), 2 if "/state/" in entry.path else 3)


def opener(url: str) -> Callable[[], LogSource]:
    """Make a function that connects to the URL. Raises DelfimError for another kind of URL."""
    parts = urlsplit(url)
    if parts.scheme not in ("ftp", "ftps", "sftp") or not parts.hostname:
        raise DelfimError(f"{url}: write ftp://, ftps:// or sftp://[USER[:PASSWORD]@]HOST[:PORT]/DIRECTORY")
    password = unquote(parts.password or "")
    if parts.username and not password and parts.scheme != "sftp" and sys.stdin.isatty():
        password = getpass.getpass(f"password of {parts.username}: ")
    return lambda: Sftp(parts, password) if parts.scheme == "sftp" else Ftp(parts, password)


class Ftp:
    """FTP, with TLS where the URL says ftps; listings by MLSD."""

    def __init__(self, url: SplitResult, password: str) -> None:
        secure = url.scheme == "ftps"
        self._ftp = (
            ftplib.FTP_TLS(context=ssl.create_default_context(), timeout=TIMEOUT_S) if secure else ftplib.FTP(timeout=TIMEOUT_S)
        )
        self._ftp.connect(url.hostname or "", url.port or 21)
        self._ftp.login(unquote(url.username or "anonymous"), password)
        if isinstance(self._ftp, ftplib.FTP_TLS):
            self._ftp.prot_p()
        self._root = unquote(url.path) or "/"

    def entries(self) -> list[RemoteFile]:
        self._left = ENTRIES
        return [
            RemoteFile(f"{day}/{id_}/{name}", _number(facts.get("size", "")), _changed_ns(facts.get("modify", "")))
            for day in filter(tree.is_day, self._folders(""))
            for id_ in filter(_is_id, self._folders(day))
            for name, facts in self._listed(f"{day}/{id_}")
            if facts.get("type") == "file"
        ]

    def _folders(self, below: str) -> list[str]:
        return [name for name, facts in self._listed(below) if facts.get("type") == "dir"]

    def _listed(self, below: str) -> list[tuple[str, dict[str, str]]]:
        """List a folder by MLSD (RFC 3659). ftplib's own function keeps a listing that never ends."""
        found = list[tuple[str, dict[str, str]]]()

        def entry(line: str) -> None:
            self._left -= 1
            facts, _, name = line.partition(" ")
            pairs = (fact.lower().partition("=") for fact in facts.split(";")[:-1])
            found.append((name, {key: value for key, _, value in pairs}))
            if self._left < 0:
                raise DelfimError(f"the boat lists more than {ENTRIES} files: these are no logs")

        self._ftp.retrlines(f"MLSD {posixpath.join(self._root, below)}", entry)
        return found

    def read(self, path: str, offset: int, sink: Callable[[bytes], object]) -> None:
        self._ftp.retrbinary(f"RETR {posixpath.join(self._root, path)}", sink, BLOCK, offset or None)

    def write(self, path: str, data: bytes, sent: Callable[[int], object]) -> None:
        """The boat gives it its name when it is whole."""
        whole = io.BytesIO(data)
        self._ftp.storbinary(f"STOR {posixpath.join(self._root, path)}", whole, BLOCK, lambda _: sent(whole.tell()))

    def close(self) -> None:
        self._ftp.close()


class Sftp:
    """SFTP with the keys, agent and known hosts of this user, or the URL's password."""

    def __init__(self, url: SplitResult, password: str) -> None:
        import asyncssh

        self._ssh, self._root = asyncssh, unquote(url.path) or "/"
        self._runner = asyncio.Runner()
        try:
            self._client = self._runner.run(self._connected(url, password))
        except (OSError, asyncssh.Error) as error:
            self._runner.close()
            raise DelfimError(f"{url.hostname}: {error}") from None

    async def _connected(self, url: SplitResult, password: str) -> Any:
        names = {"username": unquote(url.username)} if url.username else {}
        secrets = {"password": password} if password else {}
        address = (url.hostname or "", url.port or 22)
        self._connection = await self._ssh.connect(
            *address, connect_timeout=TIMEOUT_S, keepalive_interval=5, **names, **secrets
        )
        return await self._connection.start_sftp_client()

    def entries(self) -> list[RemoteFile]:
        self._left = ENTRIES
        found: list[RemoteFile] = self._run(self._walk("", 3))
        return found

    async def _walk(self, below: str, depth: int) -> list[RemoteFile]:
        found: list[RemoteFile] = []
        async for each in self._client.scandir(posixpath.join(self._root, below)):
            self._left -= 1
            if self._left < 0:
                raise DelfimError(f"the boat lists more than {ENTRIES} files: these are no logs")
            name, its = str(each.filename), each.attrs
            path = posixpath.join(below, name)
            if its.type == self._ssh.FILEXFER_TYPE_DIRECTORY and depth > 1 and (tree.is_day if depth == 3 else _is_id)(name):
                found += await self._walk(path, depth - 1)
            elif its.type == self._ssh.FILEXFER_TYPE_REGULAR and depth == 1:
                found.append(RemoteFile(path, its.size or 0, int(its.mtime or 0) * 1_000_000_000))
        return found

    def read(self, path: str, offset: int, sink: Callable[[bytes], object]) -> None:
        self._run(self._read(posixpath.join(self._root, path), offset, sink))

    async def _read(self, path: str, offset: int, sink: Callable[[bytes], object]) -> None:
        async with self._client.open(path, "rb") as file:
            while data := await file.read(BLOCK * 4, offset):
                sink(data)
                offset += len(data)

    def write(self, path: str, data: bytes, sent: Callable[[int], object]) -> None:
        """Beside the file, which it replaces when it is whole."""
        self._run(self._write(posixpath.join(self._root, path), data, sent))

    async def _write(self, path: str, data: bytes, sent: Callable[[int], object]) -> None:
        async with self._client.open(f"{path}.part", "wb") as file:
            for at in range(0, len(data), BLOCK):
                await file.write(data[at : at + BLOCK])
                sent(at)
        await self._client.posix_rename(f"{path}.part", path)

    def _run(self, work: Any) -> Any:
        try:
            return self._runner.run(work)
        except self._ssh.Error as error:
            raise OSError(str(error)) from None

    def close(self) -> None:
        self._connection.close()
        self._runner.close()
