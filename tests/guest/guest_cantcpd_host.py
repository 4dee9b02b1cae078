"""On the host, in a network namespace of its own: a guest on a cable (tap), cantcpd in it, and python-can's client out here.

unshare --map-root-user --net python tests/guest/guest_cantcpd_host.py FOLDER     prints what both sides saw as a JSON object
"""

import contextlib
import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import can

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.guest.harness import Guest, guest

HERE, THERE, PORT = "10.77.0.1", "10.77.0.2", 29536
FRAMES = 2000
LAST = 0x7FE  # cangen is not told to send it: after it comes nothing more
SERVICE = f"""
ip addr add {THERE}/24 dev vec0 && ip link set vec0 up
setsid python -m delfim run etc/delfimx.toml --service cantcpd --set 'can.interface="vcan0"' \\
    --set "runtime.run_directory='$FOLDER'" --set 'cantcpd.listen=["{THERE}:{PORT}"]' \\
    --set 'cantcpd.watch=["10.77.0.0/24"]' --set 'cantcpd.transmit=["10.77.0.0/24"]' >"$FOLDER/service" 2>&1 &
setsid candump -L -r 4194304 vcan0 >"$FOLDER/candump.log" 2>&1 &
"""
SOURCE = f"""
for way in "-g 1" "-g 0.2 -e"; do cangen vcan0 -p 10 -n {FRAMES // 2} $way || exit; done
cansend vcan0 {LAST:03X}#
"""


def run(command: str) -> None:
    subprocess.run(command.split(), check=True, timeout=20)


def client() -> can.BusABC:
    """python-can itself would try without a pause."""
    for _ in range(300):
        with contextlib.suppress(OSError), socket.create_connection((THERE, PORT), 1.0):
            return can.Bus(interface="socketcand", host=THERE, port=PORT, channel="vcan0")
        time.sleep(0.1)
    raise SystemExit("cantcpd did not come up")


def text(message: can.Message) -> str:
    """As candump -L writes it."""
    width = 8 if message.is_extended_id else 3
    data = bytes(message.data).hex().upper()
    return f"({message.timestamp:.6f}) vcan0 {message.arbitration_id:0{width}X}#{data}"


def exchange(boat: Guest) -> dict[str, object]:
    result = boat.run(SERVICE)
    assert result.code == 0, result.output
    bus = client()
    seen: list[str] = []
    done = threading.Event()

    def listen(message: can.Message) -> None:
        seen.append(text(message))
        if message.arbitration_id == LAST and not message.is_extended_id:
            done.set()

    notifier = can.Notifier(bus, [listen], timeout=0.5)
    result = boat.run(SOURCE, timeout_s=90.0)
    assert result.code == 0, result.output
    heard_all = done.wait(60.0)
    notifier.stop(5)
    bus.send(can.Message(arbitration_id=0x7FD, is_extended_id=False, data=b"\x01\xff"))
    result = boat.run("for i in $(seq 100); do grep -q '7FD#01FF' $FOLDER/candump.log && break; sleep 0.1; done")
    bus.shutdown()
    candump = [line.strip() for line in (boat.folder / "candump.log").read_text().splitlines()]
    return {"heard_all": heard_all, "candump": candump, "python_can": seen}


def main() -> None:
    for command in ("ip link set lo up", "ip tuntap add dev tap0 mode tap", f"ip addr add {HERE}/24 dev tap0"):
        run(command)
    run("ip link set tap0 up")
    cable = "vec0:transport=tap,ifname=tap0,depth=128,gro=1"
    with guest(Path(sys.argv[1]), kernel_args=[cable]) as boat:
        print("REPORT " + json.dumps(exchange(boat)))


main()
