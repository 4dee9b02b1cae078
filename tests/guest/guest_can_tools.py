"""Inside the guest: candump and `delfim can dump` beside each other on the same traffic, in several ways of showing it.

Each leaves its output in the shared folder, as NAME.candump and NAME.delfim.
"""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

FOLDER = Path(os.environ["FOLDER"])
WAYS = {  # options of both, and what they listen to
    "long": ("-ta -x -a", "vcan0", "vcan0"),
    "delta": ("-td -e", "vcan0,400~400,#FFFFFFFF", "vcan0,400~400,#FFFFFFFF"),
    "log": ("-L -x", "vcan0,100:700,00000001:80000001", "vcan0,100:700,00000001:80000001"),
    "tcp": ("-L", "vcan0,0:40000000", "socketcand:127.0.0.1:29536:vcan0"),
}


def started(name: str, command: list[str]) -> subprocess.Popen[bytes]:
    with (FOLDER / name).open("wb") as file:
        return subprocess.Popen(command, stdout=file)


def listening() -> bool:
    with socket.socket() as knock:
        return knock.connect_ex(("127.0.0.1", 29536)) == 0


def waited_for(what: str, ready: Callable[[], bool]) -> None:
    for _ in range(300):
        if ready():
            return
        time.sleep(0.1)
    raise SystemExit(f"{what} never came")


def main() -> None:
    python = [sys.executable, "-m", "delfim"]
    settings = ["--set", 'can.interface="vcan0"', "--set", f'runtime.run_directory="{FOLDER}"']
    server = subprocess.Popen([*python, "run", "etc/delfimx.toml", "--service", "cantcpd", *settings])
    waited_for("cantcpd", listening)
    processes = []
    for name, (options, theirs, ours) in WAYS.items():
        processes.append(started(f"{name}.candump", ["candump", *options.split(), theirs]))
        processes.append(started(f"{name}.delfim", [*python, "can", "dump", *options.split(), ours]))
    marks = [FOLDER / f"{name}.delfim" for name in WAYS]
    # Until all of them listen; what the early ones see until then is taken off outside.
    waited_for(
        "delfim can dump", lambda: subprocess.call(["cansend", "vcan0", "101#"]) == 0 and all(m.stat().st_size for m in marks)
    )
    time.sleep(0.5)
    for options in ("-n 300 -g 2", "-n 300 -g 2 -e", "-n 40 -g 2 -R", "-n 40 -g 2 -e -R"):
        subprocess.run(["cangen", "vcan0", "-p", "10", *options.split()], check=True, timeout=60)
    subprocess.run([*python, "can", "send", "vcan0", "101#DE.AD", "00000101#R4"], check=True, timeout=60)
    subprocess.run([*python, "can", "gen", "vcan0", "-n", "50", "-g", "2", "--seed", "1"], check=True, timeout=60)
    time.sleep(1.0)
    for process in [*processes, server]:
        process.send_signal(signal.SIGINT)
    for process in [*processes, server]:
        process.wait(10)


main()
