"""A new node of the simulator: one file and one row. It hears and answers on the bus."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress
from delfim.frames import standard
from tests.enlarged import Enlarged

HORN = '''"""A horn that says how often it was blown."""

import math

from delfim import config
from delfim.frames import Frame, standard
from delfim.simulator.model import Model


class Horn:
    hears = (standard(0x160),)

    def __init__(self) -> None:
        self.due_s, self._blown = math.inf, 0

    def feed(self, frame: Frame, now_s: float) -> None:
        self._blown += 1
        self.due_s = now_s

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        if now_s < self.due_s:
            return []
        self.due_s = math.inf
        return [Frame(standard(0x161), bytes([self._blown & 255]))]


def nodes(settings: config.Vehicle, model: Model, seed: int) -> dict[str, Horn]:
    return {"horn": Horn()}
'''


def test_a_new_node_hears_and_answers_on_the_bus(tmp_path):
    copy = Enlarged(tmp_path / "copy")
    copy.file("delfim/simulator/nodes/horn.py", HORN)
    copy.row("delfim/simulator/nodes/__init__.py", ")  # files of this folder", ', "horn"')
    vehicle, bus = str(Path(__file__).parents[1] / "etc/delfimx.toml"), f"canloop:horn-{os.getpid()}"
    words = ("nodes", vehicle, "--set", f'can.interface="{bus}"', "--set", f'runtime.run_directory="{tmp_path}"')
    with open_can(bus) as ear:
        ear.bind(CanAddress(standard(0x161)))
        ear.settimeout(0.2)
        nodes = subprocess.Popen([sys.executable, "-m", "delfim", *words], env=copy.env)
        try:
            while True:  # until it runs
                ear.sendto(b"", CanAddress(standard(0x160)))
                try:
                    assert ear.recv(8)[0] > 0
                    break
                except TimeoutError:
                    continue
        finally:
            nodes.send_signal(signal.SIGTERM)
            nodes.wait(200)
