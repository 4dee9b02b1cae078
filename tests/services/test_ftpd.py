"""ftpd with the clients that people use, and with those that nobody wants."""

import asyncio
import contextlib
import ftplib
import io
import os
import shutil
import socket
import ssl
import textwrap
import time
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from delfim.base.errors import PermanentFailure
from delfim.logging import free_space
from delfim.services.access import connection_limits
from delfim.services.access.connection_limits import hashed
from delfim.services.files import ftpd, ftpdata, uploads
from delfim.services.tables import Ftpd, FtpUser
from tests.services.boat import served, vehicle_file

CONTENT = bytes(range(256)) * 2000
USERS = {
    "reader": FtpUser(password=hashed("sesame", b"salt")),
    "writer": FtpUser(password=hashed("open", b"salt"), upload=True),
}


class Files:
    def __init__(self, port: int, root: Path) -> None:
        self.port, self.root, self.staging = port, root, root / "upload"
        self.writers: list[asyncio.StreamWriter] = []

    async def tool(self, *words: str, code: int | None = 0, said: str = "") -> str:
        """What a client prints, and what it is told."""
        child = await asyncio.create_subprocess_exec(
            *words,
            cwd=self.root.parent,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        async with asyncio.timeout(200):
            out = (await child.communicate(said.encode()))[0].decode()
        assert code is None or child.returncode == code, (words, child.returncode, out)
        return out

    async def curl(self, path: str, *words: str, user: str = "reader:sesame", code: int = 0) -> str:
        return await self.tool("curl", "-sS", "-u", user, *words, f"ftp://127.0.0.1:{self.port}{path}", code=code)

    async def raw(self, address: str = "127.0.0.1") -> "Raw":
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port, local_addr=(address, 0))
        self.writers.append(writer)
        return Raw(reader, writer)

    async def ftplib(self, do: Callable[[ftplib.FTP], Any], user: str = "reader", password: str = "sesame") -> Any:
        def session() -> Any:
            with ftplib.FTP() as ftp:
                ftp.connect("127.0.0.1", self.port, timeout=200)
                ftp.login(user, password)
                return do(ftp)

        return await asyncio.to_thread(session)


class Raw:
    """A client that says what it likes."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def answer(self) -> str:
        """A whole reply, lines joined; empty when the server hung up."""
        lines = []
        async with asyncio.timeout(200):
            while True:
                line = (await self.reader.readline()).decode()
                lines.append(line)
                if not line or (line[:3].isdigit() and line[3] == " "):
                    return "".join(lines)

    async def say(self, line: str) -> str:
        self.writer.write(line.encode() + b"\r\n")
        return await self.answer()

    async def login(self, user: str = "reader", password: str = "sesame") -> "Raw":
        await self.answer()
        await self.say(f"USER {user}")
        assert (await self.say(f"PASS {password}")).startswith("230")
        return self

    async def passive(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        port = int((await self.say("EPSV")).split("|")[3])
        return await asyncio.open_connection("127.0.0.1", port)


@contextlib.asynccontextmanager
async def files(tmp_path: Path, **limits: Any) -> AsyncIterator[Files]:
    root = tmp_path / "log"
    table = Ftpd(listen="127.0.0.1:0", root=str(root), users=USERS, **limits)
    settings = vehicle_file(tmp_path, ftpd=table)
    (root / "20260101").mkdir(exist_ok=True)
    (root / "20260101/a b.log").write_bytes(CONTENT)
    os.utime(root / "20260101/a b.log", (1_767_225_600, 1_767_225_600))
    async with served(settings, ftpd.serve, "ftpd") as runtime:
        there = Files(int(str(runtime.board["ftpd"]()["address"]).strip("/").rpartition(":")[2]), root)
        yield there
        for writer in there.writers:
            writer.transport.abort()
        await asyncio.sleep(0.05)


@pytest.fixture
def there(tmp_path: Path) -> contextlib.AbstractAsyncContextManager[Files]:
    return files(tmp_path)


needs = pytest.mark.skipif(not shutil.which("curl") or not shutil.which("lftp"), reason="needs curl and lftp")


@needs
async def test_curl_lists_reads_resumes_and_asks(there):
    assert "20260101" in await there.curl("/")
    assert (await there.curl("/", "-l")).split() == ["20260101", "upload"]
    assert "a b.log" in await there.curl("/20260101/", "-X", "MLSD")
    out = there.root.parent / "out"
    out.write_bytes(CONTENT[:1000])
    await there.curl("/20260101/a%20b.log", "-C", "-", "-o", str(out))
    assert out.read_bytes() == CONTENT
    await there.curl("/20260101/a%20b.log", "-r", "500-599", "-o", str(out))
    assert out.read_bytes() == CONTENT[500:600]
    told = await there.curl("/20260101/a%20b.log", "-I")
    assert f"Content-Length: {len(CONTENT)}" in told
    assert "Last-Modified: Thu, 01 Jan 2026 00:00:00 GMT" in told
    await there.curl("/", "-Q", "NOOP", "--disable-epsv")
    await there.curl("/gone", code=78)
    await there.curl("/", user="reader:wrong", code=67)


@needs
async def test_curl_uploads_and_resumes_an_upload(there):
    source = there.root.parent / "source"
    source.write_bytes(CONTENT)
    await there.curl("/upload/image.bin", "-T", str(source), user="writer:open")
    assert (there.staging / "image.bin").read_bytes() == CONTENT
    assert [path.name for path in there.staging.iterdir()] == ["image.bin"]
    (there.staging / "half.bin.part").write_bytes(CONTENT[:1234])
    await there.curl("/upload/half.bin", "-C", "-", "-T", str(source), user="writer:open")
    assert (there.staging / "half.bin").read_bytes() == CONTENT
    assert not (there.staging / "half.bin.part").exists()
    for path in ("/new", "/20260101/new", "/upload/../new"):
        await there.curl(path, "-T", str(source), user="writer:open", code=25)
    await there.curl("/upload/reader.bin", "-T", str(source), code=25)


@needs
async def test_lftp_lists_mirrors_and_puts(there):
    here = there.root.parent
    (here / "new.bin").write_bytes(CONTENT)
    script = (
        f"open -u writer,open ftp://127.0.0.1:{there.port}; set net:max-retries 1; set net:timeout 10; "
        "ls -la; cls -1 20260101; mirror 20260101 copy; pget -n 3 '20260101/a b.log' -o parts; "
        "cd upload; mkdir sub; put new.bin; put -c new.bin; mv new.bin sub/named.bin; rm sub/named.bin; rmdir sub; bye"
    )
    told = await there.tool("lftp", "-c", script)
    assert "drwx" in told
    assert "a b.log" in told
    assert (here / "copy/a b.log").read_bytes() == CONTENT
    assert (here / "parts").read_bytes() == CONTENT
    assert list(there.staging.iterdir()) == []


@pytest.mark.skipif(not shutil.which("wget") or not shutil.which("tnftp"), reason="needs wget and tnftp")
async def test_wget_and_tnftp(there, tmp_path):
    url = f"ftp://writer:open@127.0.0.1:{there.port}/"
    for program, option in (("wget", "-qO"), ("tnftp", "-Vo")):
        await there.tool(program, option, "got", f"{url}20260101/a%20b.log")
        assert (there.root.parent / "got").read_bytes() == CONTENT
        (there.root.parent / "got").unlink()
    await there.tool("wget", "-qr", "-nH", f"{url}20260101")
    assert (there.root.parent / "20260101/a b.log").read_bytes() == CONTENT
    await there.tool("tnftp", "-u", f"{url}upload/new", str(there.root / "20260101/a b.log"))
    assert (there.staging / "new").read_bytes() == CONTENT

    (tmp_path / "begun").write_bytes(CONTENT[:1000])
    said = f"""
            open 127.0.0.1 {there.port}
            user writer open
            binary
            cd 20260101
            ls -la
            nlist
            size "a b.log"
            modtime "a b.log"
            mget *.log
            reget "a b.log" begun
            pwd
            features
            cd ../upload
            mkdir sub
            rename new sub/newer
            delete sub/newer
            rmdir sub
            bye
        """
    told = await there.tool("tnftp", "-ni", said=textwrap.dedent(said))
    for words in (f"{len(CONTENT)}", "01 Jan 2026", "/20260101", "MLST"):
        assert words in told, words
    assert (tmp_path / "a b.log").read_bytes() == (tmp_path / "begun").read_bytes() == CONTENT
    assert list(there.staging.iterdir()) == []


async def test_pythons_ftplib(tmp_path):
    def use(ftp: ftplib.FTP) -> None:
        assert ftp.nlst() == ["20260101", "upload"]
        assert ftp.nlst("2026*") == ["20260101"]
        assert ftp.nlst("20260101/*.log") == ["20260101/a b.log"]
        assert ftp.nlst("*.none") == []
        assert ftp.size("20260101/a b.log") == len(CONTENT)
        assert ftp.sendcmd("NOOP").startswith("200")
        assert "MLST" in ftp.sendcmd("FEAT")
        lines: list[str] = []
        ftp.retrlines("LIST -a 20260101", lines.append)
        assert lines[0].startswith("-rw")
        assert lines[0].endswith(" a b.log")
        facts = dict(ftp.mlsd("20260101"))["a b.log"]
        assert (facts["type"], facts["size"], facts["modify"]) == ("file", str(len(CONTENT)), "20260101000000")
        ftp.cwd("20260101")
        assert ftp.pwd() == "/20260101"
        ftp.cwd("..")
        got = io.BytesIO()
        ftp.retrbinary("RETR 20260101/a b.log", got.write, rest=1000)
        assert got.getvalue() == CONTENT[1000:]

    async with files(tmp_path) as there:
        await there.ftplib(use)


async def test_the_words_of_a_graphical_client(there):
    """As FileZilla says them."""
    ftp = await there.raw()
    assert (await ftp.answer()).startswith("220")
    assert (await ftp.say("AUTH TLS")).startswith("502")
    assert (await ftp.say("USER reader")).startswith("331")
    assert (await ftp.say("PASS sesame")).startswith("230")
    assert "UNIX" in await ftp.say("SYST")
    features = await ftp.say("FEAT")
    assert all(f"\n {each}" in features for each in ("MLST", "SIZE", "MDTM", "REST STREAM", "UTF8"))
    for word, code in (
        ("CLNT FileZilla", "200"), ("OPTS UTF8 ON", "200"), ("PWD", "257"), ("TYPE I", "200"), ("OPTS nonsense", "501"),
        ("SIZE 20260101/a b.log", "213"), ("SIZE 20260101", "550"), ("MDTM 20260101/a b.log", "213 20260101000000"),
        ("MLST 20260101/a b.log", "250"), ("STAT", "211"), ("STAT -la 20260101", "213"), ("HELP", "214"),
        ("EPSV ALL", "200"), ("EPSV 9", "522"), ("PORT 127,0,0,1,1,1", "502"), ("EPRT |1|127.0.0.1|99|", "502"),
        ("SITE CHMOD 7 x", "502"), ("CWD /gone", "550"), ("CDUP", "250"), ("", "502"), ("MODE S", "200"), ("STRU F", "200"),
        ("RNTO x", "503"), ("QUIT", "221"),
    ):  # fmt: skip
        assert (await ftp.say(word)).startswith(code), word
    assert await ftp.answer() == ""


async def test_a_list_shows_the_time_of_day_for_half_a_year_and_then_the_year(there):
    (there.root / "new").write_text("")
    lines: list[str] = []
    await there.ftplib(lambda ftp: ftp.retrlines("LIST", lines.append))
    assert f"{datetime.fromtimestamp((there.root / 'new').stat().st_mtime, UTC):%H:%M} new" in "\n".join(lines)
    os.utime(there.root / "new", (0, 0))
    lines.clear()
    await there.ftplib(lambda ftp: ftp.retrlines("LIST", lines.append))
    assert "Jan  1  1970 new" in "\n".join(lines)


@pytest.mark.parametrize(
    "path", ["../secret", "/../secret", "link", "folder/secret", "//../secret", "20260101/../../secret", "pipe"]
)
async def test_no_path_leads_out(there, tmp_path, path):
    (tmp_path / "secret").write_text("secret")
    (there.root / "link").symlink_to(tmp_path / "secret")
    (there.root / "folder").symlink_to(tmp_path)
    os.mkfifo(there.root / "pipe")
    ftp = await (await there.raw()).login("writer", "open")
    for word in ("RETR", "SIZE", "CWD", "STOR", "DELE", "RNFR", "MKD", "APPE", "RMD"):
        if word != "SIZE" or path != "pipe":
            assert (await ftp.say(f"{word} {path}")).startswith(("550", "425")), word
    assert (tmp_path / "secret").read_text() == "secret"
    names = await there.ftplib(lambda ftp: ftp.nlst())
    assert "link" not in names
    assert "folder" not in names


async def test_a_link_in_the_staging_area_leads_nowhere(there, tmp_path):
    (there.staging / "logs").symlink_to(there.root / "20260101")
    (there.staging / "x.part").symlink_to(tmp_path / "victim")
    ftp = await (await there.raw()).login("writer", "open")
    assert (await ftp.say("STOR upload/logs/new")).startswith("550")
    assert (await ftp.say("DELE upload/logs/a b.log")).startswith("550")
    assert (await ftp.say("STOR upload/x")).startswith("550")
    assert not (tmp_path / "victim").exists()


async def test_an_upload_that_breaks_off_is_not_there_but_can_be_resumed(there):
    (there.staging / "x").write_text("old")
    ftp = await (await there.raw()).login("writer", "open")
    _, data = await ftp.passive()
    assert (await ftp.say("STOR upload/x")).startswith("150")
    data.write(CONTENT[:5000])
    await data.drain()
    async with asyncio.timeout(200):
        while not (there.staging / "x.part").exists() or (there.staging / "x.part").stat().st_size < 5000:
            await asyncio.sleep(0.01)
    second = await (await there.raw()).login("writer", "open")
    assert "another client" in await second.say("STOR upload/x")
    assert (await ftp.say("ABOR")).startswith("426")
    assert (await ftp.answer()).startswith("226")
    data.transport.abort()
    assert (there.staging / "x").read_text() == "old"
    assert (await ftp.say("REST 5001")).startswith("350")
    assert "only 5000" in await ftp.say("STOR upload/x")
    await there.ftplib(lambda ftp: ftp.storbinary("STOR upload/x", io.BytesIO(CONTENT[5000:]), rest=5000), "writer", "open")
    assert (there.staging / "x").read_bytes() == CONTENT


async def test_an_upload_stops_where_the_room_of_uploads_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(uploads, "upload_room", lambda folder, bytes_max: free_space.upload_room(folder, 2 << 20))
    async with files(tmp_path) as there:

        def put(ftp: ftplib.FTP) -> None:
            ftp.storbinary("STOR upload/x", io.BytesIO(bytes(3 << 20)))

        with pytest.raises((ftplib.error_temp, OSError)):
            await there.ftplib(put, "writer", "open")
        assert not (there.staging / "x").exists()
        monkeypatch.setattr(uploads, "free_bytes", lambda directory: 0)
        writer = await (await there.raw()).login("writer", "open")
        for word in ("STOR upload/x", "APPE upload/x", "STOR upload/new", "MKD upload/new"):
            assert await writer.say(word) == "452 the disk is full\r\n"
        assert [path.name for path in there.staging.iterdir()] == ["x.part"]


async def test_an_upload_has_a_name_that_can_be_shown(there):
    writer = await (await there.raw()).login("writer", "open")
    for word in (b"STOR", b"MKD", b"APPE"):
        for name in (b"\xff\xfe", b"bell\x07", b"\x1b[2J"):
            writer.writer.write(word + b" upload/" + name + b"\r\n")
            assert "printable" in await writer.answer()
    (there.staging / "x").write_bytes(CONTENT)
    assert (await writer.say("RNFR upload/x")).startswith("350")
    writer.writer.write(b"RNTO upload/\xff\r\n")
    assert "printable" in await writer.answer()
    assert [path.name for path in there.staging.iterdir()] == ["x"]


async def test_wrong_passwords_are_slowed_and_logged_without_the_password(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(connection_limits, "PAUSE_S", 0.2)
    async with files(tmp_path) as there:
        began_s = time.monotonic()
        ftp = await there.raw()
        await ftp.answer()
        for name in ("reader", "nobody", "writer"):
            await ftp.say(f"USER {name}")
            assert (await ftp.say("PASS mistake")).startswith("530 wrong name or password")
        assert await ftp.answer() == "", "three are enough"
        assert time.monotonic() - began_s > 0.2 + 0.4
        monkeypatch.setattr(connection_limits, "PAUSE_S", 1000.0)
        monkeypatch.setattr(connection_limits, "PAUSE_MAX_S", 1000.0)
        await (await there.raw("127.0.0.2")).login()  # who did nothing wrong does not wait
    assert "wrong password for 'nobody' from 127.0.0.1" in caplog.text
    assert "mistake" not in caplog.text
    assert "sesame" not in caplog.text


async def test_nothing_is_done_before_the_login(there):
    ftp = await there.raw()
    await ftp.answer()
    for word in ("LIST", "RETR x", "PASV", "EPSV", "STOR upload/x", "CWD /", "SIZE x", "STAT", "DELE x", "MLST", "REST 1"):
        assert (await ftp.say(word)).startswith("530"), word
    assert (await ftp.say("PASS sesame")).startswith("503")


async def test_a_data_connection_is_only_for_who_asked(there):
    ftp = await (await there.raw()).login()
    port = int((await ftp.say("EPSV")).split("|")[3])
    thief, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.2", 0))
    ftp.writer.write(b"NLST\r\n")
    assert (await ftp.answer()).startswith("150")
    with contextlib.suppress(ConnectionResetError):
        assert await thief.read() == b""
    writer.transport.abort()
    reader, owner = await asyncio.open_connection("127.0.0.1", port)
    assert await reader.read() == b"20260101\r\nupload\r\n"
    assert (await ftp.answer()).startswith("226")
    owner.transport.abort()


async def test_no_data_connection_is_told_and_commands_go_on(tmp_path, monkeypatch):
    monkeypatch.setattr(ftpdata, "DATA_S", 0.1)
    async with files(tmp_path) as there:
        ftp = await (await there.raw()).login()
        assert (await ftp.say("LIST")).startswith("425")
        await ftp.say("EPSV")
        assert (await ftp.say("LIST")).startswith("150")
        assert (await ftp.answer()).startswith("425")
        assert (await ftp.say("NOOP")).startswith("200")


async def test_a_data_connection_that_sent_its_last_bytes_after_it_was_closed_has_ended_in_order():
    """Its transport is not to be aborted any more; an exception there hung up on a client that had all of its file."""
    near, far = socket.socketpair()
    with far:
        _, writer = await asyncio.open_connection(sock=near)
        writer.write(bytes(1 << 20))
        writer.close()
        far.setblocking(False)
        while await asyncio.get_running_loop().sock_recv(far, 1 << 16):
            pass
        await writer.wait_closed()
        ftpdata.cut(writer.transport)


async def test_commands_sent_all_at_once_are_carried_out_one_after_the_other(there):
    ftp = await (await there.raw()).login()
    reader, data = await ftp.passive()
    ftp.writer.write(b"CWD 20260101\r\nREST 7\r\nRETR a b.log\r\nNOOP\r\nPWD\r\n")
    assert await reader.read() == CONTENT[7:]
    answers = [(await ftp.answer())[:3] for _ in range(6)]
    assert answers == ["250", "350", "150", "226", "200", "257"]
    data.transport.abort()


@pytest.mark.parametrize("line", [b"A" * 100_000, b"\xff\xfe\x00\r\n" * 3, b"\r\n\r\n", b"USER " + b"x" * 3000 + b"\r\n"])
async def test_nonsense_costs_only_its_own_connection(there, line):
    ftp = await there.raw()
    ftp.writer.write(line)
    await (await there.raw()).login()


async def test_who_says_nothing_or_reads_nothing_is_hung_up(tmp_path, monkeypatch):
    """Slow-loris: half a line, again and again, does not hold a connection; nor do answers that nobody reads."""
    monkeypatch.setattr(ftpd, "LOGIN_S", 0.3)
    monkeypatch.setattr(ftpdata, "STALL_S", 0.3)
    async with files(tmp_path) as there:
        slow = await there.raw()
        await slow.answer()
        async with asyncio.timeout(200):
            with contextlib.suppress(ConnectionError):
                while True:
                    slow.writer.write(b"x")
                    await slow.writer.drain()
                    if b"421" in await slow.reader.read(1000):
                        break


async def test_connections_are_limited(tmp_path):
    async with files(tmp_path, connections=4, connections_per_address=2) as there:
        held = [await there.raw("127.0.0.2") for _ in range(3)]
        assert [(await each.answer())[:3] for each in held] == ["220", "220", "421"]
        await (await there.raw()).login()
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection("127.0.0.2", there.port)


async def test_it_goes_on_when_a_download_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(ftpdata, "STALL_S", 0.3)
    async with files(tmp_path) as there:
        (there.root / "big").write_bytes(bytes(30 << 20))
        ftp = await (await there.raw()).login()
        _, data = await ftp.passive()
        data.transport.pause_reading()
        assert (await ftp.say("RETR big")).startswith("150")
        assert (await ftp.answer()).startswith("426")
        assert (await ftp.say("NOOP")).startswith("200")
        data.transport.abort()


async def test_ftps_with_curl_lftp_and_pythons_ftplib(tmp_path, certificate):
    def use(port: int) -> None:
        with ftplib.FTP_TLS(context=ssl.create_default_context(cafile=certificate), timeout=200) as ftp:
            ftp.connect("127.0.0.1", port)
            with pytest.raises(ftplib.error_perm, match="no password in the clear"):
                ftplib.FTP.login(ftp, "writer", "open")
            ftp.login("writer", "open")
            with pytest.raises(ftplib.error_perm, match="send PROT P first"):
                ftp.nlst()
            ftp.prot_p()
            assert ftp.nlst() == ["20260101", "upload"]
            ftp.storbinary("STOR upload/new", io.BytesIO(CONTENT))
            got = io.BytesIO()
            ftp.retrbinary("RETR upload/new", got.write)
            assert got.getvalue() == CONTENT

    async with files(tmp_path, certificate=str(certificate)) as there:
        await there.curl("/20260101/a%20b.log", "--ssl-reqd", "--cacert", str(certificate), "-o", "got")
        assert (tmp_path / "got").read_bytes() == CONTENT
        script = (
            f"set ssl:ca-file {certificate}; set net:max-retries 1; set ftp:ssl-force true; set ftp:ssl-protect-data true; "
        )
        await there.tool("lftp", "-c", f"{script} open -u reader,sesame 127.0.0.1:{there.port}; mirror 20260101 copy")
        assert (tmp_path / "copy/a b.log").read_bytes() == CONTENT
        (tmp_path / "plan").write_bytes(b"north")  # sent and closed before lftp has read anything of this connection
        await there.tool("lftp", "-c", f"{script} open -u writer,open 127.0.0.1:{there.port}; put -O upload plan")
        assert (there.staging / "plan").read_bytes() == b"north"
        await asyncio.to_thread(use, there.port)
        assert (there.staging / "new").read_bytes() == CONTENT


async def test_what_is_said_before_the_handshake_does_not_count(tmp_path, certificate):
    async with files(tmp_path, certificate=str(certificate)) as there:
        ftp = await there.raw()
        await ftp.answer()
        assert "AUTH TLS" in await ftp.say("FEAT")
        ftp.writer.write(b"AUTH TLS\r\nUSER reader\r\n")
        assert await ftp.answer() == ""


async def test_who_does_not_shake_hands_is_hung_up(tmp_path, certificate, monkeypatch):
    monkeypatch.setattr(ftpd, "HANDSHAKE_S", 0.2)
    async with files(tmp_path, certificate=str(certificate)) as there:
        ftp = await there.raw()
        await ftp.answer()
        assert (await ftp.say("AUTH TLS")).startswith("234")
        assert await ftp.answer() == ""


async def test_a_certificate_that_is_none_is_said_and_not_tried_again(tmp_path, certificate):
    for file, reason in ((certificate.parent / "key", "certificate"), (tmp_path / "gone", "No such file")):
        with pytest.raises(PermanentFailure, match=reason):
            async with files(tmp_path, certificate=str(file)):
                pass


async def test_no_way_leads_back_from_tls(tmp_path, certificate, monkeypatch):
    """Whoever sits in between strips AUTH, asks for data in the clear, or takes the cipher off again: 60 tries."""

    monkeypatch.setattr(ftpdata, "DATA_S", 0.5)
    in_the_clear = (
        "USER reader", "PASS sesame", "LIST", "RETR 20260101/a b.log", "PASV", "EPSV", "CWD 20260101", "STOR upload/x",
        "SIZE 20260101/a b.log", "MKD upload/x", "CCC", "REIN", "user reader", "\xffUSER reader",
    )  # fmt: skip
    async with files(tmp_path, certificate=str(certificate)) as there:
        clear = await there.raw()
        await clear.answer()
        for word in ("AUTH NONE", "AUTH", "AUTH KERBEROS_V4", "PBSZ 0", "PROT P"):
            assert not (await clear.say(word)).startswith("234")
        for word in in_the_clear:
            assert (await clear.say(word))[0] == "5", word
        trusted = ssl.create_default_context(cafile=str(certificate))
        secret = await there.raw()
        await secret.answer()
        assert (await secret.say("AUTH TLS")).startswith("234")
        await secret.writer.start_tls(trusted, server_hostname="127.0.0.1")
        await secret.say("USER writer")
        assert (await secret.say("PASS open")).startswith("230")
        for ask in ("CCC", "PROT C", "PROT S", "PROT E", "PROT", "AUTH TLS", "AUTH NONE", "REIN", "PBSZ 1"):
            for word in ("LIST", "NLST", "RETR 20260101/a b.log", "STOR upload/x"):
                await secret.say(ask)
                assert (await secret.say(word)).startswith("521"), (ask, word)
        assert (await secret.say("PROT P")).startswith("200")
        assert (await secret.say("PROT C")).startswith("536")
        reader, writer = await secret.passive()  # in the clear
        there.writers.append(writer)
        writer.write(CONTENT[:100])
        assert (await secret.say("STOR upload/x")).startswith("150")
        assert (await secret.answer())[0] == "4"
        assert b"a b.log" not in await reader.read(1000)
        assert [path.name for path in there.staging.iterdir()] == ["x.part"]
        assert (there.staging / "x.part").stat().st_size == 0
