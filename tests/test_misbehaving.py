"""A service that crashes, leaks, blocks or eats the processor, in the runtime or in a process of its own: the boat sails on, or
is stopped by its dead-man, as the placement promises; and the page says what happened."""

import contextlib
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from html import unescape
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from delfim.base.errors import DelfimError
from delfim.canproxy.dsor import messages
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.vehicle.operator.link import Link

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]
ROOT = Path(__file__).parents[1]
VEHICLE = str(ROOT / "etc/delfimx.toml")
PLACES = ("runtime", "process")


class Suite(NamedTuple):
    folder: Path
    bus: CanSocket
    address: str

    def misbehave(self, how: str) -> float:
        """When it began."""
        (self.folder / "how.new").write_text(how)
        (self.folder / "how.new").rename(self.folder / "how")
        return time.monotonic()

    def page(self) -> tuple[dict[str, Any], str]:
        """(as JSON, as a person reads it)."""
        with urllib.request.urlopen(f"{self.address}api/state", timeout=200) as answer:
            state = json.load(answer)
        with urllib.request.urlopen(self.address, timeout=200) as answer:
            return state, unescape(re.sub("<[^>]*>", "", answer.read().decode()))

    def service(self, place: str) -> tuple[dict[str, Any], str]:
        """`bad` on the page."""
        state, text = self.page()
        computer = state["computer"] or {"supervisor": {}}  # looked at by a process that may not have spoken yet
        services = state["services"] if place == "runtime" else computer["supervisor"]
        return services.get("bad", {}), text

    def sails_on(self) -> None:
        """Three seconds of commands to a propeller, none of them a stop."""
        while select.select([self.bus], [], [], 0.0)[0]:
            self.bus.recvmsg()  # what came before does not count
        for _ in range(15):
            assert messages.unpack_propeller_command(self.bus.recvmsg().data).run


def until(condition: Callable[[], object], within_s: float = 200.0) -> None:
    """Wait for it."""
    deadline_s = time.monotonic() + within_s
    while True:
        with contextlib.suppress(OSError):  # the page is not there yet
            if condition():
                return
        assert time.monotonic() < deadline_s, "it did not happen"
        select.select([], [], [], 0.1)


@contextlib.contextmanager
def sailing(folder: Path, place: str) -> Iterator[Suite]:
    """A supervised boat under way, with a service that waits to misbehave."""
    bus = f"canloop:bad-{os.getpid()}-{place}-{folder.name[-10:]}"
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    settings = {
        "can.interface": f'"{bus}"',
        "console.socket": f'"{folder}/command"',
        "log.directory": f'"{folder}/log"',
        "runtime.run_directory": f'"{folder}"',
        "supervisor.hardware_watchdog": '""',
        "guest.enabled": "false",
        "cantcpd.listen": '["127.0.0.1:0"]',
        "mavlink.listen": '"127.0.0.1:0"',
        "mavlink.peers": "[]",
        "httpd.listen": f'"127.0.0.1:{port}"',
        "services.bad.place": f'"{place}"',
        "failsafe.console_silent.after_s": "600.0",
    }
    words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    nodes_words = [
        word for key, value in settings.items() if key != "services.bad.place" for word in ("--set", f"{key}={value}")
    ]
    nodes = subprocess.Popen([sys.executable, "-m", "delfim", "nodes", VEHICLE, *nodes_words])
    program = [sys.executable, str(ROOT / "tests/misbehaving.py"), str(folder / "how"), "supervise", VEHICLE, *words]
    supervisor = subprocess.Popen(program)
    try:
        with open_can(bus) as can:
            can.bind(CanAddress(messages.PROPELLER_STARBOARD))
            can.settimeout(200)
            until(lambda: asked(folder, "heading", heading_deg=180.0, speed_mps=1.5))
            while not messages.unpack_propeller_command(can.recvmsg().data).run:
                pass
            boat = Suite(folder, can, f"http://127.0.0.1:{port}/")
            until(lambda: boat.service(place)[0])
            yield boat
    finally:
        for process in (supervisor, nodes):
            process.send_signal(signal.SIGTERM)
            process.wait(200)


def asked(folder: Path, command: str, **words: object) -> bool:
    try:
        with Link(folder / "command") as link:
            return bool(link.ask(command, **words))
    except DelfimError:
        return False


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
def test_one_that_crashes_again_and_again_is_started_again_and_the_boat_sails_on(tmp_path: Path, place: str) -> None:
    with sailing(tmp_path, place) as boat:
        boat.misbehave("crashes")
        until(lambda: boat.service(place)[0]["restarts"] >= 2)
        boat.sails_on()
        bad, text = boat.service(place)
        assert bad["reason"] == "RuntimeError: it crashes"
        assert "RuntimeError: it crashes" in text


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
def test_one_that_leaks_is_seen_to_grow_and_the_boat_sails_on(tmp_path: Path, place: str) -> None:
    def memory_bytes() -> int:
        process = "runtime" if place == "runtime" else "bad"
        computer = boat.page()[0]["computer"]  # looked at by a process that may not have spoken yet
        return int(computer["supervisor"][process]["memory_bytes"]) if computer else 0

    with sailing(tmp_path, place) as boat:
        until(lambda: memory_bytes() > 0)
        before_bytes = memory_bytes()
        boat.misbehave("leaks")
        boat.sails_on()
        until(lambda: memory_bytes() > before_bytes + 3 * (1 << 20))
        boat.sails_on()


def test_one_that_blocks_in_the_runtime_loses_the_propellers_and_the_suite_is_back(tmp_path: Path) -> None:
    with sailing(tmp_path, "runtime") as boat:
        began_s = boat.misbehave("blocks")
        while messages.unpack_propeller_command(boat.bus.recvmsg().data).run:
            pass
        print(f"stopped after {time.monotonic() - began_s:.2f} s")
        until(lambda: asked(tmp_path, "heading", heading_deg=180.0, speed_mps=1.5))
        boat.sails_on()
        until(lambda: (boat.page()[0]["computer"] or {"deadman": ""})["deadman"])
        _, text = boat.page()
        assert re.search(r"Dead-man: beat stopped for \d\.\d s", text)


@pytest.mark.long
def test_one_that_blocks_in_a_process_hurts_nobody(tmp_path: Path) -> None:
    with sailing(tmp_path, "process") as boat:
        boat.misbehave("blocks")
        boat.sails_on()

        def is_told() -> bool:
            service, text = boat.service("process")  # of one look: a moment later it may have been ended
            return bool(service["reason"] == "does not answer" and "does not answer" in text)

        until(is_told)
        until(lambda: boat.service("process")[0]["reason"].startswith("did not answer for "))
        boat.sails_on()


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
def test_one_that_eats_the_processor_gets_what_is_left(tmp_path: Path, place: str) -> None:
    with sailing(tmp_path, place) as boat:
        boat.misbehave("eats")
        boat.sails_on()
        until(lambda: boat.service(place)[0]["busy_s"] > 3.0)
        boat.sails_on()
        assert re.search(r"bad.{0,80}\d\d\.\d % busy", boat.page()[1], re.DOTALL)
