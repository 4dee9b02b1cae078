"""uvloop beside asyncio's own loop in the processes that have no navigation window, in turns (docs/decisions/0004-uvloop.md).

    python bench/loops.py [--rounds N] [--only CASE ...]

Each case is the real program with a real client; what is compared is the processor time of the program, so that a busy machine
disturbs little. The figures are medians over the rounds; "noise" is the spread of the asyncio turns.
"""

import argparse
import contextlib
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import aiohttp
from pymavlink.dialects.v20 import common as mavlink

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from bench import cantcpd  # noqa: E402
from delfim.services.access.connection_limits import hashed  # noqa: E402

VEHICLE = str(ROOT / "etc/delfimx.toml")
LOG_BYTES = 64 << 20
DOWNLOADS = 4
PAGE_S = 8.0
WATCHERS = 8
# What chooses the loop: with uvloop hidden the program falls back on asyncio's.
PROGRAM = "import sys; sys.argv[0] = 'delfim'; {hide}; from delfim.__main__ import main; sys.exit(main())"
LOOPS = {"asyncio": "sys.modules['uvloop'] = None", "uvloop": "import uvloop"}


@contextlib.contextmanager
def program(loop: str, *words: str) -> Iterator[int]:
    """`delfim WORDS` on this loop; its process id."""
    command = [sys.executable, "-c", PROGRAM.format(hide=LOOPS[loop]), *words]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process.pid
    finally:
        process.terminate()
        process.wait()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def answering(port: int) -> None:
    for _ in range(600):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        time.sleep(0.05)
    raise SystemExit("the program does not answer")


def download(loop: str, service: str) -> float:
    """Processor time in ms of the server for each MB that a client fetches."""
    with tempfile.TemporaryDirectory() as folder:
        place, port = Path(folder), free_port()
        (place / "log").write_bytes(os.urandom(1 << 20) * (LOG_BYTES >> 20))
        subprocess.run(("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", place / "key"), check=True)
        public = (place / "key.pub").read_text().strip()
        users = f'ftpd.users.bench.password="{hashed("bench")}"' if service == "ftpd" else f'sshd.users.bench.keys=["{public}"]'
        settings = [
            users,
            f'{service}.listen="127.0.0.1:{port}"',
            f'{service}.root="{place}"',
            f'runtime.run_directory="{place}"',
        ]
        settings += [f'sshd.host_key="{place}/host_key"']
        words = [word for each in settings for word in ("--set", each)]
        with program(loop, "run", VEHICLE, "--service", service, *words) as pid:
            answering(port)
            options = ["StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "IdentitiesOnly=yes", "LogLevel=ERROR"]
            sftp = ["sftp", "-F", "none", "-q", *(word for each in options for word in ("-o", each)), "-i", str(place / "key")]
            fetch = {
                "ftpd": ["curl", "-sS", "-u", "bench:bench", "-o", "/dev/null", f"ftp://127.0.0.1:{port}/log"],
                "sshd": [*sftp, f"sftp://bench@127.0.0.1:{port}/log", "/dev/null"],
            }[service]
            subprocess.run(fetch, check=True, stdin=subprocess.DEVNULL)  # the first one pays for the login
            before_s = cantcpd.cpu_s(pid)
            for _ in range(DOWNLOADS):
                subprocess.run(fetch, check=True, stdin=subprocess.DEVNULL)
            return (cantcpd.cpu_s(pid) - before_s) * 1e3 / (DOWNLOADS * LOG_BYTES / 1e6)


def watchers(loop: str) -> float:
    """Processor time in us of a cantcpd apart for each frame that eight clients get, at 7,700 frames/s."""
    hidden = cantcpd.COMMAND
    cantcpd.COMMAND = [sys.executable, "-c", PROGRAM.format(hide=LOOPS[loop])]
    try:
        sent, share, _ = cantcpd.measure(WATCHERS, 7_700, 5.0)
    finally:
        cantcpd.COMMAND = hidden
    return share * 5.0 * 1e6 / sent


def page(loop: str, boats: int) -> float:
    """Share of a processor in % of the console's gateway: so many boats ten times a second, and one page that looks on."""
    with tempfile.TemporaryDirectory() as folder:
        heard, shown = free_port(), free_port()
        folders = [word for name in ("missions", "charts", "sessions", "token") for word in (f"--{name}", f"{folder}/{name}")]
        words = ["--boats", f"127.0.0.1:{heard}", "--page", f"127.0.0.1:{shown}", "--no-browser", *folders]
        with program(loop, "console", *words) as pid:
            answering(shown)
            ended = threading.Event()
            sailing = threading.Thread(target=speak, args=(heard, boats, ended))
            sailing.start()
            try:
                return looked_on(pid, f"http://127.0.0.1:{shown}/ws?token={Path(folder, 'token').read_text().strip()}")
            finally:
                ended.set()
                sailing.join()


def speak(port: int, boats: int, ended: threading.Event) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        codecs = [mavlink.MAVLink(None, number, 1) for number in range(1, boats + 1)]
        turn = 0
        while not ended.wait(0.1):
            turn += 1
            for codec in codecs:
                said = [mavlink.MAVLink_global_position_int_message(0, 386_900_000 + turn, -92_150_000, 0, 0, 100, 50, 0, 9000)]
                said += [mavlink.MAVLink_raw_rpm_message(side, 300.0 + turn % 7) for side in (0, 1)]
                if turn % 10 == 1:
                    said.append(mavlink.MAVLink_heartbeat_message(11, 0, 1, 4, 4, 3))
                data = b"".join(message.pack(codec) for message in said)
                link.sendto(data, ("127.0.0.1", port))


def looked_on(pid: int, address: str) -> float:
    import asyncio

    async def look() -> float:
        async with aiohttp.ClientSession() as session, session.ws_connect(address) as socket_:
            until_s = time.monotonic() + 2.0
            while time.monotonic() < until_s:
                await socket_.receive()
            began_s, before_s = time.monotonic(), cantcpd.cpu_s(pid)
            while time.monotonic() - began_s < PAGE_S:
                await socket_.receive()
            return 100.0 * (cantcpd.cpu_s(pid) - before_s) / (time.monotonic() - began_s)

    return asyncio.run(look())


CASES: dict[str, tuple[str, Callable[[str], float]]] = {
    "page10": ("console, ten boats, one page: % of a processor", lambda loop: page(loop, 10)),
    "page32": ("console, 32 boats, one page: % of a processor", lambda loop: page(loop, 32)),
    "ftp": ("ftpd, download: ms for a MB", lambda loop: download(loop, "ftpd")),
    "sftp": ("sshd, SFTP download: ms for a MB", lambda loop: download(loop, "sshd")),
    "watchers": ("cantcpd apart, eight watchers: us for a frame", watchers),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="CASE")
    asked = parser.parse_args()
    if missing := [name for name in ("curl", "sftp", "ssh-keygen") if not shutil.which(name)]:
        raise SystemExit(f"this needs {', '.join(missing)}")
    print(f"{'':52} {'asyncio':>8} {'uvloop':>8} {'ratio':>6} {'noise':>6}")
    for name in asked.only:
        words, measure = CASES[name]
        figures: dict[str, list[float]] = {loop: [] for loop in LOOPS}
        for turn in range(asked.rounds):
            for loop in LOOPS if turn % 2 else reversed(LOOPS):
                figures[loop].append(measure(loop))
        plain, fast = (statistics.median(figures[loop]) for loop in ("asyncio", "uvloop"))
        noise = max(figures["asyncio"]) / min(figures["asyncio"])
        print(f"{words:52} {plain:8.2f} {fast:8.2f} {fast / plain:6.2f} {noise:6.2f}", flush=True)


if __name__ == "__main__":
    main()
