"""Inside the guest: `delfim can` and a node of pydronecan's on the kernel's own CAN, with parameters and a program of 100 kB.

python tests/guest/guest_nodetool.py INTERFACE
"""

import os
import subprocess
import sys
from pathlib import Path

FOLDER = Path(os.environ["FOLDER"])
LOST = 997  # one of so many frames
ALONE = """import sys
sys.modules["can"] = sys.modules["pymavlink"] = None  # pydronecan would load them, seconds and 100 MB, and needs neither
from tests.dronecan_device import main
main()"""


def delfim(*words: str) -> None:
    told = " ".join(Path(word).name for word in words)
    print(f"$ delfim can {told}", flush=True)
    subprocess.run([sys.executable, "-m", "delfim", "can", *words], check=True)


def main(interface: str) -> None:
    image = FOLDER / "esc-2.0.bin"
    image.write_bytes(b"DELF" + os.urandom(102_396))
    words = (sys.executable, "-c", ALONE, interface, str(LOST))
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as device:
        try:
            assert device.stdout is not None
            assert device.stdout.readline() == "there\n"
            delfim("nodes", interface)
            delfim("param", interface, "42")
            delfim("param", interface, "42", "ESC_INDEX=1", "BI_DIRECTIONAL=1", "--save")
            delfim("firmware", interface, "42", str(image))
            delfim("restart", interface, "42")
        finally:
            device.terminate()


if __name__ == "__main__":
    main(sys.argv[1])
