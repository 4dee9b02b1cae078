"""sshd with the OpenSSH client that people have, and with those that nobody wants."""

import asyncio
import contextlib
import os
import pwd
import shutil
import signal
import stat
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import asyncssh
import pytest

from delfim.base.errors import PermanentFailure
from delfim.logging import free_space
from delfim.services.access import connection_limits
from delfim.services.files import sshd, sshfiles, sshprograms, uploads
from delfim.services.tables import Sshd, SshUser
from tests.services.boat import served, vehicle_file

pytestmark = pytest.mark.skipif(not shutil.which("ssh") or not shutil.which("sftp"), reason="needs the OpenSSH client")
CONTENT = bytes(range(256)) * 4000


class Boat:
    def __init__(self, port: int, place: Path) -> None:
        self.port, self.place, self.root = port, place, place / "log"
        (place / "known_hosts").write_text("")

    def options(self, key: str = "key") -> tuple[str, ...]:
        settings = {
            "IdentityFile": str(self.place / key), "IdentitiesOnly": "yes", "StrictHostKeyChecking": "accept-new",
            "UserKnownHostsFile": str(self.place / "known_hosts"), "BatchMode": "yes", "LogLevel": "ERROR",
        }  # fmt: skip
        return ("-F", "none", *(word for name, value in settings.items() for word in ("-o", f"{name}={value}")))

    async def start(self, program: str, *words: str, **options: Any) -> asyncio.subprocess.Process:
        pipe = asyncio.subprocess.PIPE
        return await asyncio.create_subprocess_exec(
            program, *words, stdin=pipe, stdout=pipe, stderr=pipe, cwd=self.place, **options
        )

    async def ssh(self, *words: str, stdin: bytes = b"", key: str = "key", user: str = "ana") -> tuple[int, bytes, bytes]:
        child = await self.start("ssh", *self.options(key), "-p", str(self.port), f"{user}@127.0.0.1", *words)
        async with asyncio.timeout(200):
            out, err = await child.communicate(stdin)
        assert child.returncode is not None
        return child.returncode, out, err

    async def batch(self, *commands: str) -> tuple[int, str]:
        """SFTP commands."""
        words = ("-q", *self.options(), "-P", str(self.port), "-b", "-", "ana@127.0.0.1")
        child = await self.start("sftp", *words)
        async with asyncio.timeout(200):
            out, err = await child.communicate("\n".join(commands).encode() + b"\n")
        assert child.returncode is not None
        return child.returncode, (out + err).decode()


@pytest.fixture(scope="module")
def keys() -> dict[str, asyncssh.SSHKey]:
    return {name: asyncssh.generate_private_key("ssh-ed25519") for name in ("key", "stranger")}


@contextlib.asynccontextmanager
async def boat(place: Path, keys: dict[str, asyncssh.SSHKey], **limits: Any) -> AsyncIterator[Boat]:
    for name, key in keys.items():
        key.write_private_key(place / name)
        (place / name).chmod(0o600)
    public = keys["key"].export_public_key().decode()
    table = {"listen": "127.0.0.1:0", "root": str(place / "log"), "host_key": str(place / "log/.keys/host")} | limits
    settings = vehicle_file(place, sshd=Sshd(users={"ana": SshUser(keys=(public,))}, **table))
    async with served(settings, sshd.serve, "sshd") as runtime:
        yield Boat(int(str(runtime.board["sshd"]()["address"]).rpartition(":")[2]), place)


@pytest.fixture
def there(tmp_path: Path, keys: dict[str, asyncssh.SSHKey]) -> contextlib.AbstractAsyncContextManager[Boat]:
    return boat(tmp_path, keys)


async def test_a_program_runs_with_its_input_output_errors_and_exit_status(there):
    assert await there.ssh("cat; echo wrong >&2; exit 7", stdin=CONTENT) == (7, CONTENT, b"wrong\n")
    assert (await there.ssh("kill -9 $$"))[0] == 255
    assert (await there.ssh("no-such-program"))[0] == 127
    assert (await there.ssh("id", "-un"))[1].decode().strip() == pwd.getpwuid(os.getuid()).pw_name
    assert Path((await there.ssh("command -v delfim"))[1].decode().strip()).name == "delfim", "as the documents use it"
    assert (await there.ssh("pwd"))[1].decode().strip() == pwd.getpwuid(os.getuid()).pw_dir


async def test_whatever_is_run_the_log_has_a_line_for_it(tmp_path, keys, caplog):
    async with boat(tmp_path, keys) as there:
        assert (await there.ssh("true\nsshd: eve from 127.0.0.1 logged in"))[0] != 255
        await there.batch('put known_hosts "two\\nlines"')
    assert "runs 'true\\nsshd: eve from" in caplog.text
    assert not [record for record in caplog.records if "\n" in record.getMessage()]


async def test_output_comes_while_the_program_runs(there):
    """And input goes in while it runs: a conversation, in real time."""
    words = "while read x; do echo got $x; done; echo over"
    child = await there.start("ssh", *there.options(), "-p", str(there.port), "ana@127.0.0.1", words)
    assert child.stdin is not None
    assert child.stdout is not None
    async with asyncio.timeout(200):
        for number in range(3):
            child.stdin.write(b"%d\n" % number)
            assert await child.stdout.readline() == b"got %d\n" % number
        child.stdin.close()
        assert await child.stdout.read() == b"over\n"
        assert await child.wait() == 0
    await child.communicate()


async def test_much_output_to_a_slow_reader_is_whole(there):
    code, out, _ = await there.ssh(f"{sys.executable} -c 'import sys; sys.stdout.buffer.write(bytes(20_000_000))'")
    assert (code, len(out)) == (0, 20_000_000)


async def test_a_shell_on_a_terminal(there):
    child = await there.start("ssh", "-tt", *there.options(), "-p", str(there.port), "ana@127.0.0.1", env={"TERM": "vt100"})
    words = b"echo $TERM; tty; stty size; ps -o tty= -p $$; exit 3\n"
    async with asyncio.timeout(200):
        out, _ = await child.communicate(words)
    assert child.returncode == 3
    assert b"vt100" in out
    assert b"/dev/pts/" in out


async def test_a_terminal_can_interrupt_and_changes_its_size(there, keys):
    options: Any = {"known_hosts": None, "client_keys": [keys["key"]], "username": "ana"}
    async with asyncssh.connect("127.0.0.1", there.port, **options) as link:
        shell = await link.create_process(term_type="xterm", term_size=(80, 24), encoding=None)
        async with asyncio.timeout(200):
            shell.stdin.write(b"PS1='say> '; stty -echo; echo rea''dy\n")
            await shell.stdout.readuntil(b"ready\r\nsay> ")
            shell.stdin.write(b"stty size\n")
            await shell.stdout.readuntil(b"24 80\r\nsay> ")
            shell.change_terminal_size(100, 40)
            shell.stdin.write(b"stty size\n")
            await shell.stdout.readuntil(b"40 100\r\nsay> ")
            shell.stdin.write(b"sh -c 'echo begun; exec sleep 60'\n")
            await shell.stdout.readuntil(b"begun\r\n")
            shell.stdin.write(b"\x03")
            await shell.stdout.readuntil(b"say> ")
            shell.stdin.write(b"exit 4\n")
            assert (await shell.wait()).exit_status == 4


async def test_programs_end_when_their_client_goes_away(there, tmp_path):
    mark = tmp_path / "pid"
    words = f"trap '' HUP; echo $$ > {mark}; while true; do sleep 0.1; done"
    child = await there.start("ssh", *there.options(), "-p", str(there.port), "ana@127.0.0.1", words)
    async with asyncio.timeout(200):
        while not mark.exists() or not mark.read_text().strip():
            await asyncio.sleep(0.02)
        child.kill()
        await child.communicate()
        pid = int(mark.read_text())
        with contextlib.suppress(ProcessLookupError):
            while True:
                os.kill(pid, 0)
                await asyncio.sleep(0.05)


async def test_a_flood_of_window_sizes_and_signals_is_heeded_at_once_and_keeps_nothing(there, keys):
    """5,000 sizes, possible and impossible, to a program that reads nothing of the megabyte that was typed before them."""
    options: dict[str, Any] = {"username": "ana", "client_keys": [keys["key"]], "known_hosts": None, "config": None}
    async with asyncssh.connect("127.0.0.1", there.port, **options) as link:
        words = "stty raw -echo; echo ready; until [ \"$(stty size)\" = '77 99' ]; do sleep 0.05; done; echo done"
        async with link.create_process(words, term_type="vt100", encoding=None) as shell:
            assert (await shell.stdout.readline()).strip() == b"ready"
            shell.stdin.write(bytes(1 << 20))
            for number in range(5000):
                size = (0, 1, 80, 0xFFFF, 0x10000, 0x7FFFFFFF, 0xFFFFFFFF)[number % 7]
                shell.change_terminal_size(size, size ^ number, size, number)
                if not number % 10:
                    shell.send_signal(("URG", "CONT", "WINCH")[number % 3])
            shell.change_terminal_size(99, 77)
            async with asyncio.timeout(200):
                assert (await shell.stdout.readline()).strip() == b"done"
    assert (await there.ssh("echo served"))[1] == b"served\n"


def runs(pid: int) -> bool:
    """And is no zombie that waits for the first process of a container."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


SLEEPS = "sleep 1000 >/dev/null 2>&1 </dev/null"


@pytest.mark.parametrize(
    "words", [(f"{SLEEPS} & echo $!",), (f"nohup {SLEEPS} & echo $!",), ("-tt", f"set -m; {SLEEPS} & echo $!")]
)
async def test_what_is_in_the_background_ends_with_its_session(tmp_path, keys, monkeypatch, words):
    monkeypatch.setattr(sshprograms, "HANG_UP_S", 0.2)  # which nohup waits for
    monkeypatch.setattr(sshprograms, "LEAVE_S", 0.2)
    async with boat(tmp_path, keys) as there:
        code, out, _ = await there.ssh(*words)
        assert code == 0
        async with asyncio.timeout(200):
            while runs(int(out.split()[-1])):  # it was killed, and dies when the machine comes to it
                await asyncio.sleep(0.01)


async def test_what_has_a_session_of_its_own_stays(there):
    code, out, _ = await there.ssh(f"setsid {SLEEPS} & echo $!")
    assert code == 0
    os.kill(int(out), signal.SIGKILL)  # it is there


async def test_sftp(there, tmp_path):
    (there.root / "20260101").mkdir()
    (there.root / "20260101/x.log").write_bytes(CONTENT)
    (tmp_path / "new").write_bytes(CONTENT[::-1])
    commands = (
        "ls -la",
        "cd 20260101",
        "get x.log got",
        "cd /upload",
        "put new",
        "rename new named",
        "chmod 600 named",
        "mkdir sub",
        "rmdir sub",
        "ls",
        "df",
    )
    code, told = await there.batch(*commands)
    assert code == 0, told
    assert "x.log" in told
    assert (tmp_path / "got").read_bytes() == CONTENT
    assert (there.root / "upload/named").read_bytes() == CONTENT[::-1]
    assert stat.S_IMODE((there.root / "upload/named").stat().st_mode) == 0o600
    (tmp_path / "got").write_bytes(CONTENT[:1000])
    code, told = await there.batch("reget 20260101/x.log got", "rm upload/named")
    assert code == 0, told
    assert (tmp_path / "got").read_bytes() == CONTENT
    assert not (there.root / "upload/named").exists()


@pytest.mark.parametrize(
    "command", ["put new", "put new 20260101/x.log", "rm 20260101/x.log", "rename 20260101/x.log y.log", "mkdir sub",
                "chmod 600 20260101/x.log", "rmdir 20260101", "rename 20260101/x.log upload/x.log"]
)  # fmt: skip
async def test_the_logs_are_for_reading_only(there, tmp_path, command):
    (there.root / "20260101").mkdir()
    (there.root / "20260101/x.log").write_bytes(CONTENT)
    before = (there.root / "20260101/x.log").stat()
    (tmp_path / "new").write_bytes(CONTENT[::-1])
    assert (await there.batch(command))[0] != 0
    assert (there.root / "20260101/x.log").read_bytes() == CONTENT
    assert (there.root / "20260101/x.log").stat().st_ctime_ns == before.st_ctime_ns
    assert sorted(path.name for path in there.root.iterdir()) == [".keys", "20260101", "upload"]
    assert not list((there.root / "upload").iterdir())


async def test_an_upload_stops_where_the_room_of_uploads_ends(tmp_path, keys, monkeypatch):
    monkeypatch.setattr(uploads, "upload_room", lambda folder, bytes_max: free_space.upload_room(folder, len(CONTENT) // 2))
    async with boat(tmp_path, keys) as there:
        (tmp_path / "new").write_bytes(CONTENT)
        assert (await there.batch("put new upload/new"))[0] != 0
        assert free_space.used(str(there.root / "upload"))[0] <= len(CONTENT) // 2


@pytest.mark.parametrize("legacy", [(), ("-O",)], ids=["over SFTP", "the old protocol"])
async def test_scp(there, tmp_path, legacy):
    (there.root / "x.log").write_bytes(CONTENT)
    words = ("-q", *legacy, *there.options(), "-P", str(there.port))
    for source, target in (("ana@127.0.0.1:/x.log", "got"), ("got", "ana@127.0.0.1:/upload/back.log")):
        child = await there.start("scp", *words, source, target)
        _, told = await child.communicate()
        assert child.returncode == 0, told
    assert (there.root / "upload/back.log").read_bytes() == CONTENT
    child = await there.start("scp", *words, "got", "ana@127.0.0.1:/../../escaped")
    await child.communicate()
    assert not (tmp_path / "escaped").exists()
    assert not (tmp_path.parent / "escaped").exists()


@pytest.mark.parametrize(
    "path", ["../secret", "/../secret", "link", "folder/secret", "20260101/../../secret", "pipe", ".keys/host"]
)
async def test_no_path_leads_out(there, tmp_path, path):
    (tmp_path / "secret").write_text("secret")
    (there.root / "link").symlink_to(tmp_path / "secret")
    (there.root / "folder").symlink_to(tmp_path)
    os.mkfifo(there.root / "pipe")
    code, told = await there.batch(f"-get {path} got", f"-put known_hosts {path}", f"-rm {path}", f"-chmod 777 {path}", "ls -a")
    assert code == 0, told
    assert not (tmp_path / "got").exists() or b"secret" not in (tmp_path / "got").read_bytes()
    assert (tmp_path / "secret").read_text() == "secret"
    assert stat.S_IMODE((tmp_path / "secret").stat().st_mode) != 0o777
    listed = told.splitlines()[-6:]
    assert not {"link", "folder", ".keys"} & {name for line in listed for name in line.split()}
    code, told = await there.batch("ln -s /etc/passwd here")
    assert code != 0


async def test_only_the_keys_of_the_file_open_and_others_are_slowed_and_logged(tmp_path, keys, monkeypatch, caplog):
    monkeypatch.setattr(connection_limits, "PAUSE_S", 0.4)
    async with boat(tmp_path, keys) as there:
        assert (await there.ssh("true"))[0] == 0
        code, _, told = await there.ssh("true", key="stranger")
        assert code == 255
        assert b"publickey" in told
        assert b"password" not in told
        began_s = time.monotonic()
        assert (await there.ssh("true", user="nobody"))[0] == 255
        assert time.monotonic() - began_s > 0.3, "after one wrong key the next visit waits"
        began_s = time.monotonic()
        assert (await there.ssh("echo in"))[1] == b"in\n"
        assert time.monotonic() - began_s > 0.3
    assert f"wrong key {keys['stranger'].get_fingerprint()} for 'ana' from 127.0.0.1" in caplog.text
    assert "wrong key" in caplog.text.partition("'nobody'")[0]
    assert "ana from 127.0.0.1 logged in" in caplog.text
    assert "ana from 127.0.0.1 runs 'echo in'" in caplog.text
    assert "PRIVATE" not in caplog.text


async def test_the_host_key_is_made_once_kept_and_nobody_elses_business(tmp_path, keys):
    async with boat(tmp_path, keys) as there:
        assert (await there.ssh("true"))[0] == 0
    file = tmp_path / "log/.keys/host"
    first = file.read_bytes()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700
    assert asyncssh.read_private_key(file).algorithm == b"ssh-ed25519"
    async with boat(tmp_path, keys) as there:
        assert (await there.ssh("true"))[0] == 0
    assert file.read_bytes() == first
    for text in ("torn", "-----BEGIN OPENSSH( PRIVATE KEY-----\nAAAA\n-----END OPENSSH( PRIVATE KEY-----\n"):
        file.write_text(text)
        with pytest.raises(PermanentFailure, match="host_key"):
            async with boat(tmp_path, keys):
                pass


async def test_nothing_is_forwarded(there, keys):
    options: Any = {"known_hosts": None, "client_keys": [keys["key"]], "username": "ana"}
    async with asyncssh.connect("127.0.0.1", there.port, **options) as link:
        with pytest.raises(asyncssh.ChannelOpenError):
            await link.open_connection("127.0.0.1", there.port)
        with pytest.raises(asyncssh.ChannelListenError):
            await link.forward_remote_port("127.0.0.1", 0, "127.0.0.1", there.port)


async def test_clients_are_told_to_read_files_in_small_blocks(there, keys):
    options: Any = {"known_hosts": None, "client_keys": [keys["key"]], "username": "ana"}
    async with asyncssh.connect("127.0.0.1", there.port, **options) as link, link.start_sftp_client() as files:
        assert files.limits.max_read_len == sshfiles.READ_BYTES


async def test_key_exchanges_that_cost_the_loop_are_not_offered(there):
    for kex, code in (("curve25519-sha256", 0), ("diffie-hellman-group18-sha512", 255)):
        words = ("-o", f"KexAlgorithms={kex}", *there.options(), "-p", str(there.port), "ana@127.0.0.1", "true")
        child = await there.start("ssh", *words)
        await child.communicate()
        assert child.returncode == code, kex


async def test_connections_and_programs_are_limited(tmp_path, keys):
    async with boat(tmp_path, keys, connections=4, connections_per_address=2, sessions=2) as there:
        held = [await asyncio.open_connection("127.0.0.1", there.port, local_addr=("127.0.0.2", 0)) for _ in range(3)]
        async with asyncio.timeout(200):
            hellos = [await reader.readline() for reader, _ in held[:2]]
            assert all(hello.startswith(b"SSH-2.0-Delfim") for hello in hellos)
            with contextlib.suppress(ConnectionError):
                await held[2][0].read()
        options: Any = {"known_hosts": None, "client_keys": [keys["key"]], "username": "ana"}
        async with asyncssh.connect("127.0.0.1", there.port, **options) as link:
            running = [await link.create_process("cat") for _ in range(2)]
            refused = await link.run("true")
            assert refused.exit_status == 1
            assert "too many programs" in str(refused.stderr)
            for each in running:
                each.stdin.write_eof()
                await each.wait()
            assert (await link.run("true")).exit_status == 0
        for _, writer in held:
            writer.transport.abort()
        await asyncio.sleep(0)


async def test_who_does_not_log_in_is_hung_up_while_others_work(tmp_path, keys, monkeypatch):
    """Slow-loris."""
    monkeypatch.setattr(sshd, "LOGIN_S", 0.5)
    async with boat(tmp_path, keys) as there:
        reader, writer = await asyncio.open_connection("127.0.0.1", there.port)
        began_s = time.monotonic()
        writer.write(b"SSH-2.0-slow")
        async with asyncio.timeout(200):
            with contextlib.suppress(ConnectionError):
                while await reader.read(1000):
                    pass
        assert time.monotonic() - began_s > 0.3
        writer.transport.abort()
        await asyncio.sleep(0)


async def test_it_answers_where_the_file_says_and_nowhere_else(there):
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.2", there.port)


async def test_what_cannot_be_done_is_said_and_not_tried_again(tmp_path, keys):
    with pytest.raises(PermanentFailure, match="no such user"):
        async with boat(tmp_path, keys, user="no-such-user"):
            pytest.fail("it must not start")


def test_a_public_key_that_is_none_is_refused():
    with pytest.raises(PermanentFailure, match=r"sshd\.users\.ana\.keys"):
        sshd._public("ana", ("ssh-ed25519 nonsense",))


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_commands_are_those_of_the_configured_user(tmp_path, keys):
    """In a process of its own, for there is no way back."""
    program = f"""
import os, sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from delfim.services.files.sshd import _become
_become("nobody", {str(tmp_path)!r}, can=True)
assert os.getuid() == os.geteuid() != 0 and 0 not in os.getgroups()
try:
    os.setuid(0)
except PermissionError:
    print("confined")
"""

    async def main() -> bytes:
        child = await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdout=asyncio.subprocess.PIPE)
        return (await child.communicate())[0]

    assert asyncio.run(main()) == b"confined\n"
    assert tmp_path.stat().st_uid == pwd.getpwnam("nobody").pw_uid
