"""Two slots for the boat's image, so that a new one can be tried and the old one is still there (thesis 2.3).

The boot partition holds `a/` and `b/`, each with kernel, initramfs and the signed manifest that names their digests, and
`grub/grubenv`, three words that boot loader and boat share: `slot` is started, except that `trial`, when it is set, is started
once in its place: the boot loader clears it first and leaves it in `tried`. So whatever a new image does, even if it never
reaches its first program, the next start is that of the old one. Only `confirm` makes it stay. The caller makes sure that the
boat is not under way. How to use it: docs/image.md.

A Raspberry Pi's boot loader writes nothing: there the words are in autoboot.txt, each slot is a partition of its own, and
`begin_trial` strikes out the trial before the restart that tries it.
"""

import contextlib
import fcntl
import hashlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Literal

import msgspec

from delfim.base.errors import FormatError, Refused
from delfim.base.input.untrusted import read_file
from delfim.base.wholefile import replace_file, sync_directory
from delfim.services.image import raspberry
from delfim.services.image.imagefile import (
    MANIFEST,
    MEMBERS,
    PAPER_BYTES,
    SIGNATURE,
    Manifest,
    SignedImage,
    parse_manifest,
    verify,
)
from delfim.services.tables import Image

SLOTS: Final = ("a", "b")
ENVIRONMENT_BYTES: Final = 1024  # of GRUB's environment block, always
ENVIRONMENT_HEAD: Final = "# GRUB Environment Block\n"
CONFIRMED: Final = "image-confirmed"  # in the run directory, until the next start
FOUND: Final = "/run/autoboot.txt"
KEYS: Final = ("slot", "trial", "tried")
Slot = Literal["a", "b"]


class Environment(msgspec.Struct, frozen=True):
    """The variables that boot loader and boat share: slots, "" for none."""

    slot: str = "a"
    trial: str = ""
    tried: str = ""


# The boot partition.


@contextlib.contextmanager
def boot_partition(table: Image, *, write: bool) -> Iterator["Slots"]:
    """Hold the slots while the partition is mounted and nobody else writes. Raises Refused in words, OSError."""
    directory = Path(table.directory)
    places = {str(directory): table.partition} if table.partition else {}
    places |= {str(directory / slot): device for slot, device in zip(SLOTS, table.slots, strict=False)}
    with contextlib.ExitStack() as mounts:
        for place, device in places.items():
            _mounted("mount", "-o", "rw,noatime" if write else "ro", device, place)
            mounts.callback(_mounted, "umount", place)
        fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(fd, (fcntl.LOCK_EX if write else fcntl.LOCK_SH) | fcntl.LOCK_NB)
            yield Slots(directory)
        except BlockingIOError:
            raise Refused("another image is being installed at this moment") from None
        finally:
            os.close(fd)


def _mounted(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise Refused(f"the boot partition: {' '.join(words)}: {done.stderr.strip()}")


class Slots:
    """The two slots under a directory."""

    def __init__(self, directory: Path) -> None:
        self._directory, self._environment = directory, directory / "grub" / "grubenv"
        self._autoboot = directory / raspberry.AUTOBOOT  # in its place, on a Raspberry Pi

    def environment(self) -> Environment:
        """Read the environment. Raises Refused where there is none, FormatError where it is damaged."""
        if self._autoboot.exists():
            return Environment(*raspberry.parse_autoboot(read_file(self._autoboot, PAPER_BYTES)))
        try:
            return parse_environment(read_file(self._environment, PAPER_BYTES))
        except FileNotFoundError:
            raise Refused(f"{self._environment} is not there: this computer has no slots (docs/image.md)") from None

    def manifest(self, slot: str) -> Manifest | None:
        """The manifest of the image in a slot, None if no whole one is there. Raises FormatError."""
        try:
            return parse_manifest(read_file(self._directory / slot / MANIFEST, PAPER_BYTES))
        except FileNotFoundError:
            return None

    def damage(self, slot: str) -> str:
        """The damage to the files of a slot, read from the disk; "" if there is none."""
        try:
            manifest = self.manifest(slot)
            for name, part in manifest.files.items() if manifest else ():
                if _digest_of_disk(self._directory / slot / name) != part.sha256:
                    return f"{name} is not the installed file"
        except (OSError, FormatError) as error:
            return str(error)
        return "" if manifest else "empty"

    def install(self, bundle: Path, signers: tuple[str, ...]) -> tuple[str, SignedImage]:
        """Install an image into the slot that is not confirmed, to be tried at the next start. Returns that slot. Raises as
        `verify`.

        At no instant is there a word that points to files that are not whole.
        """
        environment = self.environment()
        slot = SLOTS[environment.slot == SLOTS[0]]
        folder = self._directory / slot
        self._write(Environment(environment.slot))  # the slot that is overwritten now is no longer on trial
        folder.mkdir(exist_ok=True)
        for name in MEMBERS:
            (folder / name).unlink(missing_ok=True)
        sync_directory(folder)
        image = verify(bundle, signers, folder)
        for name, text in ((SIGNATURE, image.signature), (MANIFEST, image.paper)):
            replace_file(folder / name, text)
        if damage := self.damage(slot):
            raise Refused(f"slot {slot}: {damage}: the disk does not keep written data; replace it")
        self._write(Environment(environment.slot, trial=slot))
        return slot, image

    def confirm(self, running: str) -> None:
        """Make the slot that runs the one to start from now on; where that is the old one, the other's failure is forgotten.

        Raises Refused where there is nothing to confirm.
        """
        environment = self.environment()
        if running not in SLOTS:
            raise Refused("this computer was not started from a slot")
        if running == environment.slot and not environment.tried:
            raise Refused(f"slot {running} is confirmed already")
        if running not in (environment.slot, environment.tried):
            raise Refused(f"slot {running} was overwritten since it was started: restart the computer, then confirm")
        self._write(Environment(running, environment.trial))

    def begin_trial(self) -> str:
        """Strike out the trial, and return the words for the restart that tries it. Raises Refused where there is nothing to
        try, or where the boot loader strikes it out itself."""
        environment = self.environment()
        if not environment.trial:
            raise Refused("no image waits for its trial: install one")
        if not self._autoboot.exists():
            raise Refused("this computer's boot loader begins the trial by itself: restart it")
        self._write(Environment(environment.slot, "", environment.trial))
        return raspberry.TRY

    def _write(self, environment: Environment) -> None:
        if self._autoboot.exists():
            words = environment.slot, environment.trial, environment.tried
            write_over(self._autoboot, raspberry.autoboot_txt(*words))
        else:
            replace_file(self._environment, write_environment(environment))


def parse_environment(text: bytes) -> Environment:
    """Parse GRUB's environment block. Raises FormatError."""
    lines = text.decode("ascii", "replace").split("\n")
    words = dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))
    environment = Environment(*(words.get(key, "") for key in KEYS))
    if len(text) != ENVIRONMENT_BYTES or lines[0] != ENVIRONMENT_HEAD.strip() or environment.slot not in SLOTS:
        raise FormatError("grubenv is damaged: it names no slot")
    if not {environment.trial, environment.tried} <= {*SLOTS, ""}:
        raise FormatError("grubenv is damaged: it names an unknown slot")
    return environment


def write_environment(environment: Environment) -> bytes:
    text = ENVIRONMENT_HEAD + "".join(f"{key}={getattr(environment, key)}\n" for key in KEYS)
    return text.encode().ljust(ENVIRONMENT_BYTES, b"#")


def write_over(path: Path, sector: bytes) -> None:
    """Write a sector over itself, and wait until the card has it: nothing else on it changes, not even where the file lies."""
    with path.open("r+b", buffering=0) as file:
        file.write(sector)
        os.fsync(file.fileno())


def _digest_of_disk(path: Path) -> str:
    """Digest a file from the disk, not from the kernel's cache, as far as the kernel drops it."""
    with path.open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        return hashlib.file_digest(file, "sha256").hexdigest()


# Known to the running boat without the partition.


def started(command_line: str) -> tuple[str, str]:
    """The slot that runs and the one that was tried last, from the kernel's command line; "" for none."""
    words = dict(word.split("=", 1) for word in command_line.split() if "=" in word)
    slot, tried = (words.get(f"delfim.{key}", "") for key in ("slot", "tried"))
    return (slot if slot in SLOTS else ""), (tried if tried in SLOTS else "")


def notice(slot: str, tried: str) -> str:
    """A notice to the operator about this start, in words; "" for an ordinary one."""
    if not slot or not tried:
        return ""
    if slot == tried:
        return f"the image in slot {slot} is on trial: confirm it, or the next start is of the other slot"
    return f"rolled back: the image in slot {tried} was tried and not confirmed; slot {slot} runs again"


def present_notice(run_directory: str) -> str:
    """`notice` of this computer, until `confirmed` was called."""
    try:
        command_line = Path("/proc/cmdline").read_text()
    except OSError:
        return ""
    slot, tried = started(command_line)
    with contextlib.suppress(OSError, FormatError):  # of a Raspberry Pi, as /init found it
        tried = raspberry.parse_autoboot(read_file(FOUND, PAPER_BYTES))[2]
    said = notice(slot, tried)
    return "" if not said or os.path.exists(os.path.join(run_directory, CONFIRMED)) else said


def confirmed(run_directory: str) -> None:
    """Drop the present notice."""
    Path(run_directory, CONFIRMED).touch()
