"""Inside a guest: writes the time down among the blocks that a disk was given, twenty times a second, for so many seconds.

python tests/guest/guest_mark.py DISK SECONDS        DISK is the name of a dm-log-writes device, set up with dmsetup
"""

import fcntl
import os
import struct
import sys
import time

HEAD = struct.Struct("=6Ii3IQ128s129s7x")  # linux/dm-ioctl.h: struct dm_ioctl
MESSAGE = 0xC138FD0E  # DM_TARGET_MSG; dmsetup takes a tenth of a second to say the same


def main(disk: str, seconds: float) -> None:
    control = os.open("/dev/mapper/control", os.O_RDWR)
    os.setpriority(os.PRIO_PROCESS, 0, -20)
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        words = f"mark {time.time():.3f}".encode()
        head = HEAD.pack(4, 0, 0, 512, HEAD.size, 0, 0, 0, 0, 0, 0, disk.encode(), b"")
        fcntl.ioctl(control, MESSAGE, (head + struct.pack("=Q", 0) + words).ljust(512, b"\0"))
        time.sleep(0.05)


main(sys.argv[1], float(sys.argv[2]))
