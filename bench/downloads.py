"""Bulk downloads beside the critical path: ftpd and sshd as the supervisor runs them, in processes of their own and idle, and
somebody ashore who fetches a log from them, again and again, at the speed of a good radio."""

import contextlib
import json
import secrets
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from bench.critical_path import free_ports, running, until
from bench.load import ASHORE, IDLE, LOG
from delfim.base.errors import DelfimError
from delfim.services.access.connection_limits import hashed

BYTES_PER_S: Final = 12_500_000  # 100 Mbit/s
BEGUN_BYTES: Final = 1 << 16


class Downloads:
    """Both servers, from `__enter__` to `__exit__`; `logs` is the directory that they give away. Raises DelfimError where a
    client is missing."""

    def __init__(self, asked: Sequence[str], file: str, logs: Path, place: Path) -> None:
        absent = [program for program in ("curl", "sftp", "ssh-keygen") if not shutil.which(program)]
        if absent:
            raise DelfimError(f"bulk downloads need {', '.join(absent)}")
        self._file, self._logs, self._place = file, logs, place
        self._asked, self._password, self._key = asked, secrets.token_hex(8), place / "key"
        self.ports = dict(zip(("ftpd", "sshd"), free_ports(2), strict=True))
        self._all = contextlib.ExitStack()

    def __enter__(self) -> "Downloads":
        subprocess.run(("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", self._key), check=True)
        users = {
            "ftpd": f"ftpd.users.bench.password={json.dumps(hashed(self._password))}",
            "sshd": f"sshd.users.bench.keys={json.dumps([self._key.with_suffix('.pub').read_text().strip()])}",
        }
        for name, port in self.ports.items():
            settings = [*self._asked, users[name], f'{name}.listen="127.0.0.1:{port}"', f'{name}.root="{self._logs}"']
            settings += [f'sshd.host_key="{self._place}/host_key"', f'runtime.run_directory="{self._place}"']
            words = [word for each in settings for word in ("--set", each)]
            command = [*IDLE, sys.executable, "-m", "delfim", "run", self._file, "--service", name]
            self._all.enter_context(running([*command, *words], stderr=subprocess.DEVNULL))
            until(lambda port=port: socket.create_connection(("127.0.0.1", port), timeout=1.0).close(), name)
        return self

    def __exit__(self, *_: object) -> None:
        self._all.close()

    @contextlib.contextmanager
    def fetching(self, how: str) -> Iterator[list[int]]:
        """Somebody fetches by "FTP" or "SFTP" meanwhile; afterwards the list holds how many bytes were fetched."""
        fetched = list[int]()
        words = self._curl() if how == "FTP" else self._sftp()
        with running([*ASHORE, *words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as client:
            until(lambda: _begun(client.pid), f"a download by {how}")
            yield fetched
            if client.poll() is not None:
                raise DelfimError(f"the download by {how} ended with {client.returncode}; what it said stands above")
            fetched.append(_written_bytes(client.pid))

    def _curl(self) -> list[str]:
        url = f"ftp://127.0.0.1:{self.ports['ftpd']}/{LOG}"
        return ["curl", "-sS", "--limit-rate", str(BYTES_PER_S), "-u", f"bench:{self._password}", "-o", "/dev/null", url]

    def _sftp(self) -> list[str]:
        options = ["StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "IdentitiesOnly=yes", "LogLevel=ERROR"]
        words = [word for option in options for word in ("-o", option)]
        words += ["-i", str(self._key), "-l", str(BYTES_PER_S * 8 // 1000)]
        return ["sftp", "-F", "none", "-q", *words, f"sftp://bench@127.0.0.1:{self.ports['sshd']}/{LOG}", "/dev/null"]


def _begun(pid: int) -> None:
    """Raises DelfimError as long as next to nothing came."""
    if _written_bytes(pid) < BEGUN_BYTES:
        raise DelfimError("nothing came yet")


def _written_bytes(pid: int) -> int:
    """What a process has written up to now, be it to /dev/null (proc_pid_io(5))."""
    words = dict(line.split(": ") for line in Path(f"/proc/{pid}/io").read_text().splitlines())
    return int(words["wchar"])
