"""A guest: a Linux kernel that runs as an ordinary process (User-Mode Linux), with CAN, in two seconds, on any machine.

    with guest(tmp_path, modules=("vcan", "can-raw")) as g:
        result = g.run("candump -n 1 vcan0 & cansend vcan0 123#00; wait", timeout_s=10)
        assert result.code == 0, result.output

The guest sees the host's files at the same paths and keeps its changes in memory; it works in the root of the project, as
root, with this Python first on the path. Only `g.folder` is shared for real: what is written there is on the host at once.
One guest serves any number of commands, one after the other. See docs/testbed.md.
"""

import os
import runpy
import selectors
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
uml = SimpleNamespace(**runpy.run_path(str(ROOT / "docker/uml.py")))
MODULES = ("vcan", "can-raw")
PATH = f"{os.environ['PATH']}:/usr/sbin:/sbin"
BOOT_TIMEOUT_S = 60.0
MEMORY_MIB = 512  # the whole suite and its visitors take 320
REREAD_PAGES = 10_000  # 40 MB: of programs that run, thrown out for want of memory and read again


class GuestError(Exception):
    """The guest did not come up, died, or has too little memory; the message ends with its last words."""


class Result(NamedTuple):
    """What a command left behind: its exit code (124: it took too long) and what it printed on both streams."""

    code: int
    output: str


def missing() -> str | None:
    """Why no guest can be started on this machine, or None."""
    programs = ["linux.uml", "modprobe", "ip", "busybox"] + (["cc"] if uml.has_more_registers() else [])
    absent = [program for program in programs if not shutil.which(program, path=PATH)]
    return f"no guest without {', '.join(absent)} (make system installs them on Debian)" if absent else None


class Guest:
    """A running guest, made by `guest()`; `folder` is the one place where both see the same files."""

    def __init__(self, folder: Path, process: subprocess.Popen[bytes]) -> None:
        self.folder = folder
        self._process = process
        self._console = b""
        self._commands = self._reread_pages = 0

    def run(self, command: str, timeout_s: float = 60.0) -> Result:
        """Run shell command lines and wait for their end; while they run, what they print grows in `folder`/N.out.

        A command that takes longer than timeout_s is ended with exit code 124, and the guest goes on.
        Raises GuestError when the guest itself died, does not answer, or had too little memory for the command: its programs
        then wait for their own pages most of the time, and nothing that they do in that time is worth a look.
        """
        self._commands += 1
        name = str(self._commands)
        (self.folder / f"{name}.sh").write_text(command + "\n")
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(f"{name} {timeout_s}\n".encode())
            self._process.stdin.flush()
        except BrokenPipeError:
            raise self._died("is gone") from None
        self.wait_for(f"GUEST done {name}\r\n", timeout_s + 10.0)
        output = (self.folder / f"{name}.out").read_text(errors="replace")
        self._check_memory(name, output)
        return Result(int((self.folder / f"{name}.code").read_text()), output)

    def _check_memory(self, name: str, output: str) -> None:
        """Of a command that has ended."""
        before, self._reread_pages = self._reread_pages, int((self.folder / f"{name}.memory").read_text().split()[1])
        if (pages := self._reread_pages - before) > REREAD_PAGES:
            raise GuestError(
                f"the guest has too little memory: {pages} pages of files were thrown out and read again meanwhile; "
                f"give it more memory_mib, or the programs less to hold; output:\n{output[-4000:]}"
            )

    def wait_for(self, words: str, timeout_s: float) -> None:
        """Read the console until it says these words. Raises GuestError at its end or after timeout_s."""
        assert self._process.stdout is not None
        deadline_s = time.monotonic() + timeout_s
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            while words.encode() not in self._console:
                if not selector.select(max(0.0, deadline_s - time.monotonic())):
                    raise self._died(f"did not say {words.strip()!r} within {timeout_s} s")
                piece = os.read(self._process.stdout.fileno(), 65536)
                if not piece:
                    raise self._died("ended")
                self._console += piece
        self._console = self._console.partition(words.encode())[2]

    def _died(self, how: str) -> GuestError:
        outputs = sorted(self.folder.glob("*.out"), key=lambda path: int(path.stem))
        output = outputs[-1].read_text(errors="replace") if outputs else ""
        return GuestError(
            f"the guest {how}; output:\n{output[-4000:]}\nconsole:\n{self._console.decode(errors='replace')[-4000:]}"
        )


@contextmanager
def guest(
    tmp_path: Path, modules: Sequence[str] = MODULES, memory_mib: int = MEMORY_MIB, kernel_args: Sequence[str] = ()
) -> Iterator[Guest]:
    """Boot a guest whose files lie in tmp_path; with the module vcan it has vcan0 and vcan1, up. It is killed at the end.

    kernel_args are words for the kernel, such as "ubd0=FILE" (a disk) or "vec0:transport=tap,ifname=tap0" (a network).
    """
    folder = _prepare(tmp_path)
    process = subprocess.Popen(
        _command_line(folder, memory_mib, kernel_args),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,  # a guest is several host processes: they are killed as a group
        env=_environment(folder, memory_mib),
    )
    try:
        booted = Guest(folder, process)
        booted.wait_for("GUEST ready", BOOT_TIMEOUT_S)
        result = booted.run(_setup(modules))
        if result.code:
            raise GuestError(f"setting up the guest failed: {result.output}")
        yield booted
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def _prepare(tmp_path: Path) -> Path:
    """Lay out the shared folder: the guest's first program and the profile of its shells."""
    folder = Path(tempfile.mkdtemp(prefix="guest", dir=tmp_path)).resolve()
    shutil.copy(Path(__file__).with_name("init.sh"), folder)
    (folder / "init.sh").chmod(0o755)
    path = f"{Path(sys.executable).parent}:$PATH"
    settings = {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONSAFEPATH": "1", "PYTHONPATH": str(ROOT), "FOLDER": str(folder)}
    settings |= {"CI": os.environ["CI"]} if "CI" in os.environ else {}
    exports = "".join(f"export {name}={shlex.quote(value)}\n" for name, value in settings.items())
    (folder / "profile").write_text(f'{exports}export PATH="{path}"\ncd {shlex.quote(str(ROOT))}\n')
    return folder


def _command_line(folder: Path, memory_mib: int, more: Sequence[str]) -> list[str]:
    root = ["root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", f"init={folder}/init.sh"]
    console = ["con=null", "con0=fd:0,fd:1", "quiet"]
    return [
        str(shutil.which("linux.uml", path=PATH)),
        f"mem={memory_mib}M",
        *root,
        *console,
        "selinux=0",
        "apparmor=0",
        f"uml_dir={folder}",
        *more,
    ]


def _environment(folder: Path, memory_mib: int) -> dict[str, str]:
    """The guest's memory is a file in TMPDIR: in shared memory where it fits and may be executed (in many containers not)."""
    shared = os.statvfs("/dev/shm")
    fits = shared.f_bavail * shared.f_frsize > memory_mib << 20 and not shared.f_flag & os.ST_NOEXEC
    return {"PATH": PATH, "HOME": str(folder), "TMPDIR": "/dev/shm" if fits else str(folder)} | uml.preload(folder)


def _setup(modules: Sequence[str]) -> str:
    buses = [f"ip link add {bus} type vcan && ip link set {bus} up" for bus in ("vcan0", "vcan1") if "vcan" in modules]
    return " && ".join([*(f"modprobe {module}" for module in modules), *buses, "true"])


def shell() -> int:
    """An interactive shell in a guest, on this terminal; Ctrl-D ends both."""
    with tempfile.TemporaryDirectory() as name:
        folder = _prepare(Path(name))
        with (folder / "profile").open("a") as profile:
            profile.write(_setup(MODULES) + "\n")
        command = _command_line(folder, MEMORY_MIB, ["MODE=shell", f"TERM={os.environ.get('TERM', 'dumb')}"])
        code = subprocess.call(command, env=_environment(folder, MEMORY_MIB))
    subprocess.call(["stty", "sane"])
    return code


if __name__ == "__main__":
    sys.exit(missing() or shell())
