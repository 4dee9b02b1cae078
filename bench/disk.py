"""A log partition that fails on command, with the kernel's own means: an ext4 file system in a file, in a mount namespace of
its own, filled, shut down, aborted or frozen. Needs root and loop devices."""

import contextlib
import ctypes
import fcntl
import os
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Final, Self

from delfim.base.errors import DelfimError

SIZE: Final = 64 << 20
PATH: Final = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
_NEW_MOUNTS: Final = 0x20000  # linux/sched.h: CLONE_NEWNS
_FREEZE: Final = 0xC0045877  # linux/fs.h: FIFREEZE
_THAW: Final = 0xC0045878  # FITHAW
_SHUTDOWN: Final = 0x8004587D  # fs/ext4/ext4.h: EXT4_IOC_SHUTDOWN
_NO_FLUSH: Final = 2


class Disk:
    """Mounted at `place` while it is open. Its images lie beside it, and go with it."""

    def __init__(self, place: Path) -> None:
        self._place, self._images, self._is_frozen = place, 0, False
        place.mkdir(parents=True)

    def __enter__(self) -> Self:
        self.mount()
        return self

    def __exit__(self, *_: object) -> None:
        self.mend()
        for _image in range(self._images):
            _run("umount", "-l", str(self._place))

    def mount(self) -> None:
        """A new one, in the place of the one before, which nobody sees any more."""
        image = self._place.with_name(f"{self._place.name}-{self._images}.ext4")
        image.touch()
        os.truncate(image, SIZE)
        _run("mke2fs", "-q", "-F", "-m", "0", "-t", "ext4", str(image))
        _run("mount", "-o", "loop,errors=remount-ro", str(image), str(self._place))
        image.unlink()
        self._images += 1

    def fill(self) -> None:
        """ENOSPC for whoever writes. At once: the room is taken, and nothing written."""
        with (self._place / "ballast").open("wb") as file:
            size = 0
            for block in (1 << 20, 1 << 12):
                with contextlib.suppress(OSError):
                    while True:
                        os.posix_fallocate(file.fileno(), size, block)
                        size += block

    def fail(self) -> None:
        """EIO for whoever reads or writes, as from a disk that was torn out."""
        self._ask(_SHUTDOWN, _NO_FLUSH)

    def abort(self) -> None:
        """EROFS for whoever writes: the file system found itself damaged."""
        _run("mount", "-o", "remount,abort", str(self._place))

    def freeze(self) -> None:
        """Whoever writes hangs."""
        self._ask(_FREEZE, 0)
        self._is_frozen = True

    def mend(self) -> None:
        """As it was, or a new one."""
        if self._is_frozen:
            self._ask(_THAW, 0)
            self._is_frozen = False
        with contextlib.suppress(OSError):
            (self._place / "ballast").unlink(missing_ok=True)

    def _ask(self, request: int, word: int) -> None:
        folder = os.open(self._place, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.ioctl(folder, request, struct.pack("=I", word))
        finally:
            os.close(folder)


def leave_mounts() -> None:
    """What this process and its children mount from now on is seen by nobody else, and ends with them. Raises DelfimError
    where that is not permitted, or a program is missing."""
    missing = [name for name in ("mke2fs", "mount", "umount") if not shutil.which(name, path=PATH)]
    if missing:
        raise DelfimError(f"a log partition that fails needs {', '.join(missing)}")
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_NEW_MOUNTS):
        raise DelfimError(f"a log partition that fails needs root: {os.strerror(ctypes.get_errno())}")
    _run("mount", "--make-rprivate", "/")


def _run(*command: str) -> None:
    try:
        subprocess.run(command, env={"PATH": PATH}, check=True, capture_output=True, text=True, timeout=60)
    except subprocess.CalledProcessError as error:
        raise DelfimError(f"{' '.join(command)}: {error.stderr.strip()}") from None
