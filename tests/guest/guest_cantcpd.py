"""Inside the guest: cangen on the kernel's vcan0, candump beside cantcpd, and python-can's socketcand client on the other side.

Prints what candump, python-can and `delfim can dump` saw, and what a client sent, as one JSON object for the test outside.
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import can

FOLDER = Path(os.environ["FOLDER"])
FRAMES = 2000
PORT = 29536
LAST = 0x7FE  # cangen is not told to send it: after it comes nothing more


def daemon() -> subprocess.Popen[bytes]:
    settings = ["--set", 'can.interface="vcan0"', "--set", f'runtime.run_directory="{FOLDER}"']
    settings += ["--set", 'cantcpd.transmit=["127.0.0.0/8"]']
    return subprocess.Popen([sys.executable, "-m", "delfim", "run", "etc/delfimx.toml", "--service", "cantcpd", *settings])


def client() -> can.BusABC:
    """python-can itself would try without a pause, and leave the server no processor to start on."""
    for _ in range(200):
        with contextlib.suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", PORT)):
            return can.Bus(interface="socketcand", host="127.0.0.1", port=PORT, channel="vcan0")
        time.sleep(0.1)
    raise SystemExit("cantcpd did not come up")


def text(message: can.Message) -> str:
    """As candump -L writes it, without the stamp."""
    width = 8 if message.is_extended_id else 3
    return f"vcan0 {message.arbitration_id:0{width}X}#{bytes(message.data).hex().upper()}"


def main() -> None:
    server = daemon()
    bus = client()
    seen: list[str] = []
    stamps: list[str] = []
    done = threading.Event()

    def listen(message: can.Message) -> None:
        seen.append(text(message))
        stamps.append(f"{message.timestamp:.6f}")
        if message.arbitration_id == LAST and not message.is_extended_id:
            done.set()

    notifier = can.Notifier(bus, [listen], timeout=0.5)
    with (FOLDER / "candump.log").open("wb") as file:
        candump = subprocess.Popen(["candump", "-L", "-r", "4194304", "vcan0"], stdout=file)
        time.sleep(1.0)
        for options in ("-g 1", "-g 0.2 -e"):
            subprocess.run(["cangen", "vcan0", "-n", str(FRAMES // 2), "-p", "10", *options.split()], check=True, timeout=60)
        subprocess.run(["cansend", "vcan0", f"{LAST:03X}#"], check=True)
        heard_all = done.wait(30)
        notifier.stop(5)
        bus.send(can.Message(arbitration_id=0x7FD, is_extended_id=False, data=b"\x01\xff"))
        time.sleep(0.5)
        candump.send_signal(signal.SIGINT)
        candump.wait()
    bus.shutdown()
    server.terminate()
    lines = [line.split(maxsplit=1) for line in (FOLDER / "candump.log").read_text().splitlines()]
    report = {
        "heard_all": heard_all,
        "exit_code": server.wait(10),
        "candump": [line for _, line in lines],
        "candump_stamps": [stamp[1:-1] for stamp, _ in lines],
        "python_can": seen,
        "python_can_stamps": stamps,
    }
    print("REPORT " + json.dumps(report))


main()
