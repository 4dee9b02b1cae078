"""The last act: ends the programs that use the log partition and unmounts it; then the power may be cut (thesis 3.3).

The supervisor runs it, after all its programs have ended. Standard library only; Linux only. Why here: docs/powerd.md.
"""

import ctypes
import json
import logging
import os
import re
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, Literal, NamedTuple

LOOK_S: Final = 0.05  # between two looks at the users
KILL_S: Final = 2.0  # for the kernel to end killed processes
ATTEMPT_S: Final = 20.0  # for an attempt, beyond the users' time: a disk that hangs must not hang the rest
AGAIN_S: Final = 1.0  # between two attempts
TELL_S: Final = 0.2  # between two frames that say it is safe
_MS_RDONLY, _MS_REMOUNT = 1, 32  # sys/mount.h
_POWER_OFF, _RESTART, _RESTART_WITH_WORDS = 0x4321FEDC, 0x01234567, 0xA1B2C3D4  # linux/reboot.h
_MAGIC = 0xFEE1DEAD, 672274793
_REBOOT_CALL: Final = {"aarch64": 142, "x86_64": 169}  # its number; the C library knows no words

Word = Literal["end", "off", "reboot"]  # the programs alone; the computer, for the power to be cut; the same and start again

log = logging.getLogger(__name__)


class User(NamedTuple):
    """A process that uses a file system."""

    pid: int
    name: str
    path: str  # one of the files that it uses

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid}) uses {self.path}"


# Asking for it.


def request(place: str | Path, word: Word, reason: str) -> None:
    """Ask the supervisor that listens at `place` to end. Returns at once. Raises OSError where there is none."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as asking:
        asking.connect(str(place))
        asking.send(f"{word} {reason}".encode())


def listening(path: Path) -> socket.socket | None:
    """Open the supervisor's socket for requests; None if it cannot be opened: signals remain."""
    path.unlink(missing_ok=True)
    requests = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        requests.bind(str(path))
        os.chmod(path, 0o660)
    except OSError as error:
        log.error("%s: %s; going on without it", path, error.strerror)
        requests.close()
        return None
    return requests


def is_listening(place: str | Path) -> bool:
    """Whether a supervisor would receive a request."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        return asking.connect_ex(str(place)) == 0


def socket_path(run_directory: str | Path) -> Path:
    """The path of the supervisor's socket."""
    return Path(run_directory) / "supervisor"


def record_path(run_directory: str | Path) -> Path:
    """The path of the record of the last shutdown, JSON: reason, at_s (since boot), stage "safe" or "held", holders. A restart
    of the computer takes it away."""
    return Path(run_directory) / "shutdown.json"


# Users of the partition.


def users(mount: str, proc: Path = Path("/proc")) -> list[User]:
    """Every process but this one that has a file of this file system open, mapped, or as its place."""
    try:
        device = os.stat(mount).st_dev
    except OSError:
        return []
    pids = sorted(int(name) for name in os.listdir(proc) if name.isdecimal() and int(name) != os.getpid())
    paths = ((pid, _used(proc / str(pid), device)) for pid in pids)
    return [User(pid, _read(proc / str(pid) / "comm").strip(), path) for pid, path in paths if path]


def _used(process: Path, device: int) -> str:
    """The path of this device that the process uses; empty: it uses none, or is gone."""
    for link in _links(process):
        try:
            if os.stat(link).st_dev == device:
                return os.readlink(link)
        except OSError:
            continue
    number = f"{os.major(device):02x}:{os.minor(device):02x}"
    for line in _read(process / "maps").splitlines():
        field = line.split(maxsplit=5)
        if len(field) == 6 and field[3] == number:
            return field[5]
    return ""


def _links(process: Path) -> Iterator[str]:
    yield from (f"{process}/{name}" for name in ("cwd", "root", "exe"))
    try:
        yield from (f"{process}/fd/{name}" for name in os.listdir(process / "fd"))
    except OSError:
        return


def mounts(mount: str, proc: Path = Path("/proc")) -> list[str]:
    """The places where the file system of this mount point is mounted, and what is mounted below it; the last mounted first.
    Empty where nothing is mounted, or only a part of the root file system: that is not ours to unmount."""
    rows = [line.split()[2:5] for line in _read(proc / "self/mountinfo").splitlines()]
    points = [(device, _unescaped(place)) for device, _, place in rows]
    own = next((device for device, place in reversed(points) if place == mount), None)
    if own is None or (own, "/") in points:
        return []
    return [place for device, place in reversed(points) if device == own or place.startswith(mount + "/")]


def _unescaped(place: str) -> str:
    """Undo the kernel's escapes: it writes spaces and the like as three octal digits."""
    return re.sub(r"\\([0-7]{3})", lambda match: chr(int(match[1], 8)), place)


def devices(mount: str, root: Path = Path("/")) -> list[str]:
    """The users of files below this place in the kernel itself: loop devices and swap files."""
    files = [(path.parts[-3], _read(path).strip()) for path in (root / "sys/block").glob("loop*/loop/backing_file")]
    files += [("swap", line.split()[0]) for line in _read(root / "proc/swaps").splitlines()[1:] if line]
    return [f"{name} uses {path}" for name, path in files if path.startswith(mount + "/")]


def _read(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


# Ending it.


def release(mount: str, end_s: float) -> list[str]:
    """End the users of a mounted file system, sync it and unmount it, or at least make it read-only. Returns the
    obstacles; empty: none, or nothing was mounted there."""
    if not mounts(mount):
        os.sync()
        return []
    os.chdir("/")
    for number, patience_s in ((signal.SIGTERM, end_s), (signal.SIGKILL, KILL_S)):
        if not _ended(mount, number, patience_s):
            break
    os.sync()
    try:
        for place in mounts(mount):
            _libc("umount2", place.encode(), 0)
        return []
    except OSError as error:
        left = [str(user) for user in users(mount)] + devices(mount)
        why = left or [f"{mount}: {error.strerror}"]
    try:
        _libc("mount", None, mount.encode(), None, _MS_REMOUNT | _MS_RDONLY, None)
    except OSError:
        return why
    log.warning("%s is in use and was made read-only instead: %s", mount, "; ".join(why))
    return []


def _ended(mount: str, number: signal.Signals, patience_s: float) -> list[User]:
    """Send a signal to each user once, also to those that come. Returns the users left after this time."""
    told: set[int] = set()
    until_s = time.monotonic() + patience_s
    while (found := users(mount)) and time.monotonic() < until_s:
        for user in found:
            if user.pid not in told and user.pid != 1:  # another init is named, and not ended
                log.warning("%s: ended with %s", user, number.name)
                told.add(user.pid)
                try:
                    os.kill(user.pid, number)
                except OSError as error:
                    log.warning("%s: %s", user, error.strerror)
        time.sleep(LOOK_S)
    return found


def _libc(name: str, *arguments: object) -> None:
    """Call a function of the C library. Raises OSError."""
    if getattr(ctypes.CDLL(None, use_errno=True), name)(*arguments):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _bounded(mount: str, end_s: float) -> list[str]:
    """Call `release`, and give up where the disk does not answer. Its thread is left behind then; the computer ends anyway."""
    found = [f"{mount} does not answer"]

    def attempt() -> None:
        try:
            found[:] = release(mount, end_s)
        except Exception as error:  # after any failure the rest goes on
            found[:] = [f"{mount}: {error}"]

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    thread.join(end_s + KILL_S + ATTEMPT_S)
    return list(found)


def last_act(
    reason: str,
    mount: str,
    *,
    end_s: float,
    held_s: float,
    told_s: float,
    tell: Callable[[bool, Sequence[str]], None],
    record: Path,
) -> bool:
    """Make it safe to cut the power, and report it. Returns whether it is.

    mount: the log partition's, "" for none. end_s: that its users have after SIGTERM. held_s: after that long in vain it is
    given up. told_s: the outcome is told for so long. tell: gets the outcome so far and the obstacles; never raises.
    record: a file for the outcome.
    """
    until_s = time.monotonic() + held_s
    while True:
        holders = _bounded(mount, end_s) if mount else []
        stage = "held" if holders else "safe"
        try:
            record.write_text(json.dumps({"reason": reason, "at_s": time.monotonic(), "stage": stage, "holders": holders}))
        except OSError as error:
            log.error("%s: %s", record, error.strerror)
        tell(not holders, holders)
        if not holders or time.monotonic() > until_s:
            break
        log.error("%s cannot be unmounted: %s", mount, "; ".join(holders))
        time.sleep(AGAIN_S)
    log.warning("shutdown: %s: %s", reason, f"not safe: {'; '.join(holders)}" if holders else "the power may be cut")
    until_s = time.monotonic() + told_s
    while time.monotonic() < until_s:
        tell(not holders, holders)
        time.sleep(TELL_S)
    os.sync()
    return not holders


def words_path(run_directory: str | Path) -> Path:
    """The path of the words for the boot loader, where the next restart has some (docs/image.md)."""
    return Path(run_directory) / "restart-words"


def leave(word: Word, words: Path) -> None:
    """Switch the computer off, or start it again, with the words of that file if it is there. Raises OSError where that is not
    permitted."""
    log.warning("shutdown: %s", word)
    if word == "reboot" and (said := _read(words).strip()) and (call := _REBOOT_CALL.get(os.uname().machine)):
        numbers = (*_MAGIC, _RESTART_WITH_WORDS)
        _libc("syscall", ctypes.c_long(call), *map(ctypes.c_uint, numbers), said.encode())
    _libc("reboot", ctypes.c_uint(_RESTART if word == "reboot" else _POWER_OFF))
