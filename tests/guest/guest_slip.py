"""Inside the guest: boat and shore, a network namespace each, joined by a slow serial line, with a slipd of ours at both ends.

python tests/guest/guest_slip.py ENCAPSULATION BOAT_MODE SECONDS prints one JSON object for the test outside. The line between
the two terminals carries 10,000 bytes a second each way (100 kbit/s, 8N1); it can be cut, and the boat's carrier taken away.
"""

import json
import os
import pty
import socket
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

from tests.guest.guest_wire import Wire

FOLDER = Path(os.environ["FOLDER"])
BYTES_PER_S = 10_000
BOAT, SHORE = "10.0.0.1", "10.0.0.2"
MTU = 296
LOWDELAY = 0x10
ECHO, BULK = 7000, 7001


def sh(command: str) -> str:
    return subprocess.run(command, shell=True, check=True, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT).stdout


def slipd(terminal: str, encapsulation: str, mode: str, address: str, peer: str, namespace: str) -> subprocess.Popen[bytes]:
    carrier = FOLDER / f"carrier{namespace}"
    carrier.write_text("1")
    settings = {
        "device": f'"{terminal}"',
        "encapsulation": f'"{encapsulation}"',
        "mode": f'"{mode}"',
        "address": f'"{address}"',
        "peer": f'"{peer}"',
        "mtu": str(MTU),
        "radio_bps": str(10 * BYTES_PER_S),
        "carrier": f'"file:{carrier}"',
    }
    words = [word for key, value in settings.items() for word in ("--set", f"slipd.{key}={value}")]
    run = f"runtime.run_directory={json.dumps(str(FOLDER / ('run' + namespace)))}"
    command = [sys.executable, "-m", "delfim", "run", "etc/delfimx.toml", "--service", "slipd", *words, "--set", run]
    prefix = ["ip", "netns", "exec", namespace] if namespace else []
    return subprocess.Popen([*prefix, *command])


def echo() -> None:
    """On the boat: what comes goes back, with the type of service that it came with."""
    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.setsockopt(socket.IPPROTO_IP, socket.IP_RECVTOS, 1)
    server.bind((BOAT, ECHO))
    while True:
        data, ancillary, _, address = server.recvmsg(2048, 100)
        server.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, ancillary[0][2][0] if ancillary else 0)
        server.sendto(data, address)


def bulk() -> None:
    """On the boat: a log without an end."""
    with socket.create_server((BOAT, BULK)) as server:
        while True:
            client, _ = server.accept()
            try:
                while True:
                    client.sendall(bytes(range(256)) * 16)
            except OSError:
                client.close()


def rtt(seconds: float, tos: int) -> list[float]:
    """On the shore: round trips in ms of the console's packet of 100 bytes, one a half second; a lost one is 1,000."""
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, tos)
    client.settimeout(1.0)
    trips = []
    for number in range(round(seconds * 2)):
        begun_s = time.monotonic()
        client.sendto(number.to_bytes(4, "big") + bytes(96), (BOAT, ECHO))
        try:
            while int.from_bytes(client.recv(2048)[:4], "big") != number:
                pass
            trips.append((time.monotonic() - begun_s) * 1e3)
        except TimeoutError:
            trips.append(1000.0)
        time.sleep(max(begun_s + 0.5 - time.monotonic(), 0.0))
    return trips


def download(seconds: float) -> float:
    """On the shore: bytes a second, the first second left out."""
    with socket.create_connection((BOAT, BULK), timeout=10.0) as link:
        taken, until_s, from_s = 0, time.monotonic() + seconds + 1.0, time.monotonic() + 1.0
        while (now_s := time.monotonic()) < until_s:
            data = len(link.recv(4096))
            taken += data if now_s >= from_s else 0
        return taken / seconds


def shore(role: str, *words: object) -> subprocess.Popen[str]:
    command = ["ip", "netns", "exec", "shore", sys.executable, __file__, role, *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def answer(child: subprocess.Popen[str]) -> object:
    return json.loads(child.communicate(timeout=120)[0])


def reached(limit_s: float) -> float:
    """How long until the boat answers the shore."""
    begun_s = time.monotonic()
    while time.monotonic() - begun_s < limit_s:
        probe = subprocess.run(
            f"ip netns exec shore busybox ping -c 1 -W 1 {BOAT}",
            shell=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        if probe.returncode == 0:
            return time.monotonic() - begun_s
    raise SystemExit(f"the boat did not answer within {limit_s} s: {sh('ip addr; ip netns exec shore ip addr')}")


def main(encapsulation: str, mode: str, seconds: float) -> None:
    sh("ip netns add shore && ip -n shore link set lo up")
    (boat, boat_tty), (ashore, ashore_tty) = pty.openpty(), pty.openpty()
    wire = Wire(boat, ashore, (BYTES_PER_S, BYTES_PER_S))
    names = os.ttyname(boat_tty), os.ttyname(ashore_tty)
    children = [
        slipd(names[0], encapsulation, mode, BOAT, SHORE, ""),
        slipd(names[1], encapsulation, "user", SHORE, BOAT, "shore"),
    ]
    for each in (boat_tty, ashore_tty):
        os.close(each)
    report: dict[str, object] = {"up_s": reached(60.0)}
    interface = next(name for name in os.listdir("/sys/class/net") if name.startswith(("sl", "radio")))
    report["interface"] = interface
    for role in (echo, bulk):
        threading.Thread(target=role, daemon=True).start()
    report["idle_ms"] = answer(shore("rtt", seconds, 0))
    for name, tos in (("loaded_ms", 0), ("lowdelay_ms", LOWDELAY)):
        loading = shore("download", seconds + 2.0)
        time.sleep(2.0)
        report[name] = answer(shore("rtt", seconds, tos))
        report["bytes_per_s"] = answer(loading)
    wire.is_cut = True
    time.sleep(3.0)
    wire.is_cut = False
    report["after_cut_s"] = reached(60.0)
    (FOLDER / "carrier").write_text("0")
    begun_s = time.monotonic()
    while os.path.exists(f"/sys/class/net/{interface}"):
        time.sleep(0.05)
        if time.monotonic() - begun_s > 20.0:
            raise SystemExit("the interface outlived its carrier")
    (FOLDER / "carrier").write_text("1")
    report["after_carrier_s"] = reached(60.0)
    for child in children:
        child.terminate()
    report["exit_codes"] = [child.wait(20) for child in children]
    report["medians"] = {key: statistics.median(report[key]) for key in ("idle_ms", "loaded_ms", "lowdelay_ms")}  # type: ignore[call-overload]
    print("REPORT " + json.dumps(report))


if sys.argv[1] == "rtt":
    print(json.dumps(rtt(float(sys.argv[2]), int(sys.argv[3]))))
elif sys.argv[1] == "download":
    print(json.dumps(download(float(sys.argv[2]))))
else:
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]))
