"""Inside an emulated computer, beside the boat and by the image's own Python: the other nodes' traffic, played on a CAN card of
their own, and an operator who asks for a heading until a propeller is told to turn. Imports nothing of delfim: it has to be
small beside what is measured.

    python3 guest_actuation.py FRAMES      lines of candump, as they came in a minute

Prints, in seconds since /init began: the first frame to a propeller, the first that lets it run.
"""

import errno
import json
import select
import socket
import struct
import sys
import time
from pathlib import Path

FRAME = struct.Struct("=IB3x8s")  # struct can_frame
EXTENDED, IFF_UP = 0x8000_0000, 1
PROPELLERS, FLAGS, RUN = (0x040, 0x041), 2, 1  # messages.PropellerCommand: rpm in two bytes, flags, counter
BUS = "can1"  # at the other end of the boat's can0


def uptime_s() -> float:
    return float(Path("/proc/uptime").read_text().split()[0])


def frames() -> list[tuple[float, bytes]]:
    """Seconds from the first, and the frame for the socket."""
    found = []
    for line in Path(sys.argv[1]).read_text().splitlines():
        if len(words := line.split()) >= 3:
            name, _, text = words[2].partition("#")
            data = bytes.fromhex(text)
            identifier = int(name, 16) | (EXTENDED if len(name) == 8 else 0)
            found.append((float(words[0][1:-1]), FRAME.pack(identifier, len(data), data.ljust(8, b"\0"))))
    return [(at_s - found[0][0], frame) for at_s, frame in found]


def bus() -> socket.socket:
    """As soon as it is up: /init loads the card's driver first, and sets its bit rate later."""
    flags = Path(f"/sys/class/net/{BUS}/flags")
    while not (flags.exists() and int(flags.read_text(), 16) & IFF_UP):
        time.sleep(0.1)
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    sock.bind((BUS,))
    return sock


def send(sock: socket.socket, frame: bytes) -> None:
    """The card's queue may be full for a moment."""
    while True:
        try:
            sock.send(frame)
            return
        except OSError as error:
            if error.errno != errno.ENOBUFS:
                raise
            time.sleep(0.001)


def ask_for_a_heading() -> str:
    """The boat's answer, or why there is none."""
    try:
        with socket.socket(socket.AF_UNIX) as sock:
            sock.settimeout(2.0)
            sock.connect("/run/delfim/command")
            sock.sendall(json.dumps({"command": "heading", "heading_deg": 150.0, "speed_mps": 1.2}).encode() + b"\n")
            return sock.recv(65536).decode()[:200]
    except OSError as error:
        return str(error)


def main() -> None:
    traffic, sock = frames(), bus()
    init_s, began_s, asked_s, said = float(Path("/run/init").read_text()), uptime_s(), 0.0, ""
    first = False
    while True:
        while traffic and uptime_s() - began_s >= traffic[0][0]:
            send(sock, traffic.pop(0)[1])
        if select.select([sock], [], [], 0.02)[0]:
            identifier, _, data = FRAME.unpack(sock.recv(FRAME.size))
            if identifier in PROPELLERS:
                if not first:
                    print(f"FIRST {uptime_s() - init_s:.1f}", flush=True)
                first = True
                if data[FLAGS] & RUN:
                    print(f"TURNS {uptime_s() - init_s:.1f} END", flush=True)
                    return
        if first and uptime_s() - asked_s > 2.0:
            asked_s = uptime_s()
            if (answer := ask_for_a_heading()) != said:
                print(f"SAID {(said := answer)}", flush=True)


main()
