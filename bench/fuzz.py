"""Who sends the boat's MAVLink port datagrams without end: `python -m bench.fuzz`.

A third is rubbish of any length, a third are frames of all kinds with a right checksum and anything in them, and a third are
questions, which have to be answered. The same seed sends the same.
"""

import contextlib
import json
import select
import socket
import sys
import time
from random import Random
from typing import Final

from bench.load import Ports
from delfim.parts.mavlink.codec.wire import dialect

RATE_HZ: Final = 3500.0  # 100,000 in half a minute
BURST_S: Final = 0.002
BYTES_MAX: Final = 1400
SYSTEM, COMPONENT = 251, 190  # of a console that does not command
KINDS: Final = sorted(dialect.mavlink_map)


def datagram(random: Random, number: int) -> bytes:
    """The datagram of this number."""
    if number % 3 == 0:
        return random.randbytes(random.randrange(BYTES_MAX))
    sequence = number & 0xFF
    if number % 3 == 1:
        return framed(random.choice(KINDS), random.randbytes(random.randrange(1, 256)), sequence)
    asked = random.choice(KINDS), 0, 0, 0, 0, 0, 0
    request = dialect.MAVLink_command_long_message(0, 0, dialect.MAV_CMD_REQUEST_MESSAGE, 0, *asked)
    codec = dialect.MAVLink(None, SYSTEM, COMPONENT)
    codec.seq = sequence
    packed: bytes = request.pack(codec)
    return packed


def framed(kind: int, payload: bytes, sequence: int, system: int = SYSTEM, component: int = COMPONENT) -> bytes:
    """A frame with the right checksum, whatever is in it."""
    header = bytes([len(payload), 0, 0, sequence, system, component]) + kind.to_bytes(3, "little")
    crc: int = dialect.x25crc(header + payload + bytes([dialect.mavlink_map[kind].crc_extra])).crc
    return b"\xfd" + header + payload + crc.to_bytes(2, "little")


def main() -> int:
    """A line of ports (bench.load) starts and is answered with "on", an empty line stops and is answered with the number
    of datagrams as JSON; the end of the input ends."""
    random, number = Random(1), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        while line := sys.stdin.readline():
            link.connect(("127.0.0.1", Ports(*map(int, line.split()[: len(Ports._fields)])).mavlink))
            print("on", flush=True)
            began_s, before = time.monotonic(), number
            while not select.select([sys.stdin], [], [], BURST_S)[0]:
                while number - before < (time.monotonic() - began_s) * RATE_HZ:
                    with contextlib.suppress(ConnectionError):
                        link.send(datagram(random, number))
                    number += 1
            sys.stdin.readline()
            print(json.dumps({"datagrams": number - before}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
