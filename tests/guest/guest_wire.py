"""A serial line: bytes between two terminals, at the speed of the line, or damaged, or not at all.

In a guest: python -m tests.guest.guest_wire LINK BYTES_PER_S makes a terminal with the name LINK whose other end is the guest's
own serial port; what leaves is paced here, what comes was paced by who sent it. (The kernel's SLIP straight on that port stalls
under load, for a fault of the emulated port.)
"""

import os
import pty
import random
import select
import sys
import threading
import time
import tty

SLICE_BYTES = 100
LOOK_S = 0.2


class Wire:
    """Carries bytes both ways until it is closed. `bytes_per_s` from one to the other, and back."""

    def __init__(self, one: int, other: int, bytes_per_s: tuple[float, float]) -> None:
        self.is_cut = False
        self.noise = 0.0  # the part of all bytes that is damaged
        self.carried = [0, 0]  # bytes from one to the other, and back
        self._random = random.Random(1)
        self._closed = threading.Event()
        ways = enumerate(((one, other), (other, one)))
        self._threads = [
            threading.Thread(target=self._carry, args=(way, *ends, bytes_per_s[way]), daemon=True) for way, ends in ways
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._closed.set()
        for thread in self._threads:
            thread.join()

    def _carry(self, way: int, source: int, target: int, bytes_per_s: float) -> None:
        free_s = time.monotonic()
        while not self._closed.is_set():
            if not select.select([source], [], [], LOOK_S)[0]:
                continue
            try:
                data = os.read(source, SLICE_BYTES)
            except OSError:  # nobody has the other side open
                time.sleep(0.05)
                continue
            now_s = time.monotonic()  # a late wake-up is made up for, an idle line is not
            free_s = (free_s if now_s - free_s < 0.03 else now_s) + len(data) / bytes_per_s
            time.sleep(max(free_s - time.monotonic(), 0.0))
            self.carried[way] += len(data)
            if not self.is_cut:
                os.write(target, self._damaged(data) if self.noise else data)

    def _damaged(self, data: bytes) -> bytes:
        return bytes(byte ^ 1 << self._random.randrange(8) if self._random.random() < self.noise else byte for byte in data)


def main(name: str, bytes_per_s: float) -> None:
    inner, terminal = pty.openpty()
    port = os.open("/dev/ttyS0", os.O_RDWR | os.O_NOCTTY)
    tty.setraw(port)
    tty.setraw(terminal)
    os.symlink(os.ttyname(terminal), name)
    Wire(inner, port, (bytes_per_s, float("inf")))
    threading.Event().wait()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
