"""`delfim log fetch` from the boat's own daemons, over a radio that breaks off again and again."""

import asyncio
import os
import random
import sys
from pathlib import Path

import asyncssh

from delfim.services.access.connection_limits import hashed
from delfim.services.files import ftpd, sshd
from delfim.services.runtime import Runtime
from delfim.services.tables import Ftpd, FtpUser, Sshd, SshUser
from tests.logging.test_fetch import T0_NS, arrived, gz
from tests.services.boat import served, vehicle_file
from tests.services.radio import Radio, radio

LOGS = {f"20100101/can0/09{minute}000.log.gz": gz(random.Random(minute).randbytes(1_000_000)) for minute in (3, 4)}
BREAKS_AFTER = 700_000  # bytes


async def fetched(url: str, place: Path, **environment: str) -> str:
    """What the command says."""
    child = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "delfim", "log", "fetch", "--id", "can0", url, str(place / "here"),
        env=os.environ | {"HOME": str(place / "home")} | environment,
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
    )  # fmt: skip
    async with asyncio.timeout(200):
        told = (await child.communicate())[0].decode()
    assert child.returncode == 0, told
    return told


def log_files(place: Path) -> None:
    for path, data in LOGS.items():
        file = place / "log" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
        os.utime(file, ns=(T0_NS, T0_NS))


def port_of(runtime: Runtime, name: str) -> int:
    return int(str(runtime.board[name]()["address"]).strip("/").rpartition(":")[2])


async def fetched_twice(url: str, place: Path, link: Radio) -> None:
    """All is here after links that broke off, and none of it comes again."""
    await fetched(url, place)
    assert link.breaks >= 2
    assert arrived(place / "here") == LOGS
    assert "0 files to fetch" in await fetched(url, place)


async def test_by_ftp(tmp_path: Path) -> None:
    users = {"ana": FtpUser(password=hashed("sesame"))}
    table = Ftpd(listen="127.0.0.1:0", root=str(tmp_path / "log"), users=users)
    log_files(tmp_path)
    async with (
        served(vehicle_file(tmp_path, ftpd=table), ftpd.serve, "ftpd") as runtime,
        radio(port_of(runtime, "ftpd"), BREAKS_AFTER) as (link, port),
    ):
        await fetched_twice(f"ftp://ana:sesame@127.0.0.1:{port}/", tmp_path, link)


async def test_what_is_being_written_on_the_boat_is_not_called_cut(tmp_path: Path) -> None:
    users = {"ana": FtpUser(password=hashed("sesame"))}
    table = Ftpd(listen="127.0.0.1:0", root=str(tmp_path / "log"), users=users)
    old, new = (f"20100101/can0/09{minute}000.log.gz" for minute in (3, 4))
    log_files(tmp_path)
    for path in (old, new):
        (tmp_path / "log" / path).write_bytes(gz(b"frames", cut=True))
    os.utime(tmp_path / "log" / old, ns=(T0_NS, T0_NS))
    async with served(vehicle_file(tmp_path, ftpd=table), ftpd.serve, "ftpd") as runtime:
        told = await fetched(f"ftp://ana:sesame@127.0.0.1:{port_of(runtime, 'ftpd')}/", tmp_path)
    assert f"{old}: incomplete on the boat, too; run delfim log repair on it" in told
    assert f"{new}: still being written on the boat; run the same command again for the rest" in told


async def test_by_ftp_with_tls(tmp_path: Path, certificate: Path) -> None:
    users = {"ana": FtpUser(password=hashed("sesame"))}
    table = Ftpd(listen="127.0.0.1:0", root=str(tmp_path / "log"), users=users, certificate=str(certificate))
    log_files(tmp_path)
    async with served(vehicle_file(tmp_path, ftpd=table), ftpd.serve, "ftpd") as runtime:
        url = f"ftps://ana:sesame@127.0.0.1:{port_of(runtime, 'ftpd')}/"
        await fetched(url, tmp_path, SSL_CERT_FILE=str(certificate))
        assert arrived(tmp_path / "here") == LOGS


async def test_by_sftp(tmp_path: Path) -> None:
    home = tmp_path / "home/.ssh"
    home.mkdir(parents=True)
    key = asyncssh.generate_private_key("ssh-ed25519")
    key.write_private_key(home / "id_ed25519")
    host_key = tmp_path / "log/.keys/host"
    users = {"ana": SshUser(keys=(key.export_public_key().decode(),))}
    table = Sshd(listen="127.0.0.1:0", root=str(tmp_path / "log"), host_key=str(host_key), users=users)
    log_files(tmp_path)
    async with (
        served(vehicle_file(tmp_path, sshd=table), sshd.serve, "sshd") as runtime,
        radio(port_of(runtime, "sshd"), BREAKS_AFTER) as (link, port),
    ):
        theirs = asyncssh.read_private_key(host_key).export_public_key().decode()
        (home / "known_hosts").write_text(f"[127.0.0.1]:{port} {theirs}")
        await fetched_twice(f"sftp://ana@127.0.0.1:{port}/", tmp_path, link)
