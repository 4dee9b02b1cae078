"""Logs from a real SSH server: what the protocol's own client makes of it."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from delfim.base.errors import DelfimError
from delfim.logging.ashore.fetch import fetch
from delfim.logging.ashore.tree import ALWAYS
from tests.logging.test_fetch import FILES, T0_NS, arrived

SERVER = """
import asyncio, sys, asyncssh

class Boat(asyncssh.SSHServer):
    def password_auth_supported(self): return True
    def validate_password(self, name, password): return (name, password) == ("boat", "secret")

async def main(root):
    key = asyncssh.generate_private_key("ssh-ed25519")
    server = await asyncssh.create_server(Boat, "127.0.0.1", 0, server_host_keys=[key],
                                          sftp_factory=lambda channel: asyncssh.SFTPServer(channel, chroot=root.encode()))
    port = server.sockets[0].getsockname()[1]
    print(port, f"[127.0.0.1]:{port} " + key.export_public_key().decode(), end="", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)

asyncio.run(main(sys.argv[1]))
"""


@pytest.fixture
def boat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of a server on this machine, whose key this user knows."""
    for path, data in FILES.items():
        file = tmp_path / "boat/log" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
        os.utime(file, ns=(T0_NS, T0_NS))
    command = [sys.executable, "-c", SERVER, str(tmp_path / "boat")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        port, _, known = server.stdout.readline().partition(" ")
        home = tmp_path / "home"
        (home / ".ssh").mkdir(parents=True)
        (home / ".ssh/known_hosts").write_text(known + "\n")
        monkeypatch.setenv("HOME", str(home))
        yield f"boat:secret@127.0.0.1:{port}"
        server.communicate(timeout=200)


def test_the_tree_arrives_by_sftp(boat, tmp_path):
    outcome, _ = fetch(f"sftp://{boat}/log", tmp_path / "here", [], ALWAYS, summary=False)
    assert arrived(tmp_path / "here") == FILES
    assert outcome.bytes == sum(map(len, FILES.values()))
    assert (tmp_path / "here/20100101/state/093000.state.gz").stat().st_mtime_ns == T0_NS
    again, _ = fetch(f"sftp://{boat}/log", tmp_path / "here", [], ALWAYS, summary=False)
    assert again.fetched == []


def test_a_wrong_password_and_a_wrong_folder_are_one_line(boat, tmp_path):
    with pytest.raises(DelfimError, match=r"127\.0\.0\.1: Permission denied"):
        fetch(f"sftp://{boat.replace('secret', 'wrong')}/log", tmp_path / "here", [], ALWAYS, summary=False)
    with pytest.raises(DelfimError, match=r"127\.0\.0\.1: .*No such file"):
        fetch(f"sftp://{boat}/elsewhere", tmp_path / "here", [], ALWAYS, summary=False)
