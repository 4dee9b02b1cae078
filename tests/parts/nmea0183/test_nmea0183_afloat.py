"""A boat with a GNSS receiver on one port and a compass on another sails through the real runtime.

The hull is the one of `delfim nodes`; instruments hear where it is and say so in sentences, over ptys or sockets.
"""

import contextlib
import json
import os
import select
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pynmea2
import pytest

from delfim import config
from delfim.base.errors import DelfimError
from delfim.canproxy.dsor.messages import Navigation
from delfim.canproxy.opening import open_bound
from delfim.lines.nmea0183.framing import framed
from delfim.lines.nmea0183.speaking import gga, hdt, rmc
from delfim.parts.dsor import source as dsor
from delfim.vehicle.links import Links
from delfim.vehicle.operator.link import Link
from delfim.vehicle.state import State
from tests.afloat import running

ROOT = Path(__file__).parents[3]
PATIENCE_S = 200.0


class Pty:
    """A device that can be pulled out and put back under its name."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self.plug()

    def plug(self) -> None:
        self._end, self._port = os.openpty()
        os.set_blocking(self._end, False)
        self.name.symlink_to(os.ttyname(self._port))

    def pull(self) -> None:
        self.name.unlink()
        for each in (self._end, self._port):
            os.close(each)

    def say(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):  # nobody reads it yet
            os.write(self._end, data)


class Sea:
    """The simulated hull, heard on its bus, and an operator who looks at the boat that steers it."""

    def __init__(self, command: Path, tmp_path: Path, say: Callable[[Navigation], None]) -> None:
        bus = f"canloop:afloat-{os.getpid()}-{tmp_path.name[-8:]}"
        settings = config.Vehicle(boat=config.BoatTable(name="hull"), can=config.Can(interface=bus))
        links = Links(lambda interface, filters: open_bound(settings.can, interface, filters), lambda *_: None)
        self._hull, self._command, self._say = dsor.open_source(settings, links, State()), command, say

    def close(self) -> None:
        self._hull.input.close()

    def asked(self, command: str = "state", **words: object) -> dict[str, Any]:
        with Link(self._command, 60.0) as link:
            return link.ask(command, **words)

    def until(self, wanted: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """The instruments speak until the state is as wanted."""
        deadline_s, state = time.monotonic() + PATIENCE_S, None
        while time.monotonic() < deadline_s:
            select.select([self._hull.input], [], [], 1.0)
            if (fix := self._hull.read(time.monotonic())) is not None:
                self._say(fix.navigation)
            with contextlib.suppress(DelfimError):  # it does not run yet
                state = self.asked()
                if wanted(state):
                    return state
        raise AssertionError(f"not in {PATIENCE_S:.0f} s: {state}")

    def sail(self, command: str, **words: object) -> None:
        """Until the command is carried out."""

        def accepted(_: dict[str, Any]) -> bool:
            self.asked(command, **words)
            return True

        self.until(accepted)


@contextlib.contextmanager
def at_sea(tmp_path: Path, say: Callable[[Navigation], None], *values: str) -> Iterator[Sea]:
    more = (
        'navigation.sources=["nmea0183"]',
        "mavlink.enabled=false",
        "navigation.stale_s=2.5",
        "checks.clock_s=3600.0",
        *(f"simulation.{each}_hz=0" for each in ("receiver", "compass", "sounder", "wind")),  # the test speaks itself
        *values,
    )
    with running(tmp_path, 14550, *more) as command, contextlib.closing(Sea(command, tmp_path, say)) as sea:
        yield sea


def port(name: str, device: object, baud: int = 38400) -> tuple[str, str]:
    return f'nmea0183.ports.{name}.device="{device}"', f"nmea0183.ports.{name}.baud={baud}"


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as any_socket:
        any_socket.bind(("127.0.0.1", 0))
        number: int = any_socket.getsockname()[1]
        return number


def replayed(tmp_path: Path) -> str:
    command = [sys.executable, "-m", "delfim", "log", "replay", str(tmp_path / "log")]
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=120, cwd=ROOT).stdout


@pytest.mark.long
@pytest.mark.parametrize(("estimator", "silent"), [("false", "navigation silent"), ("true", "position silent")])
def test_a_gnss_receiver_and_a_compass_on_two_ports_sail_the_boat(tmp_path, estimator, silent):
    gnss, compass = Pty(tmp_path / "gnss"), Pty(tmp_path / "compass")

    def say(n: Navigation) -> None:
        compass.say(hdt(n) + framed("SDDPT,7.5,0.3,"))
        with contextlib.suppress(OSError):  # pulled out
            gnss.say(gga(n) + rmc(n))

    more = ('sensors.names=["sysstat", "nmea0183"]', f"navigation.estimator={estimator}")
    with at_sea(tmp_path, say, *port("gnss", gnss.name), *port("compass", compass.name, 4800), *more) as sea:
        sea.sail("heading", heading_deg=90.0, speed_mps=1.0)
        state = sea.until(lambda s: s["speed_mps"] and s["speed_mps"] > 0.7 and abs(s["heading_deg"] - 90.0) < 10.0)
        assert state["source"] == "nmea0183"
        assert state["fix"] == 3
        kinds = {name: kind["talker"] for name, kind in state["nmea0183"]["kinds"].items()}
        assert (kinds["position"], kinds["velocity"], kinds["heading"]) == ("gnss:GN", "gnss:GN", "compass:GN")
        assert state["measured"]["depth_m"] == 7.5
        assert state["nmea0183"]["ports"]["gnss"]["refused"] == {}

        gnss.pull()
        state = sea.until(lambda s: s["mode"] == "idle")
        assert silent in state["reason"]
        name = "-".join(("", *gnss.name.parts[1:]))
        sea.until(
            lambda s: s[name]["trouble"] == "No such file or directory"
        )  # once it is looked for again; before, it hung up
        cycle = sea.asked()["cycle"]
        gnss.plug()
        sea.until(lambda s: s["cycle"] > cycle + 5 and not s[name]["trouble"])
        sea.sail("heading", heading_deg=90.0, speed_mps=1.0)
        sea.until(lambda s: s["run"])
    told = replayed(tmp_path)
    assert "all the same, bit by bit" in told, told
    assert int(told.split()[0]) > 20, "cycles"


@pytest.fixture
def gpsd(tmp_path: Path) -> Iterator[tuple[Pty, int]]:
    """The daemon on a device of its own, and its port."""
    if not shutil.which("gpsd"):
        pytest.skip("needs gpsd")
    number = free_port()
    device = Pty(tmp_path / "gpsd-device")
    words = ("gpsd", "-N", "-n", "-b", "-S", str(number), str(device.name.resolve()))
    program = subprocess.Popen(words)
    yield device, number
    program.terminate()
    program.wait(200)


class Listener:
    """gpsd, which hears the boat by UDP, and the last position that it reports."""

    def __init__(self, number: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", number), PATIENCE_S)
        self._lines = self._socket.makefile("rb")
        self._socket.sendall(b'?WATCH={"enable":true,"json":true};\n')

    def position(self) -> dict[str, Any]:
        while (told := json.loads(self._lines.readline())).get("class") != "TPV" or told.get("mode", 0) < 2:
            pass
        return told

    def close(self) -> None:
        self._lines.close()
        self._socket.close()


@pytest.mark.long
def test_the_boat_tells_other_instruments_where_it_is(tmp_path):
    """A sonar on a serial port, read by pynmea2, and gpsd, which takes the boat for a receiver."""
    if not shutil.which("gpsd"):
        pytest.skip("needs gpsd")
    sonar, gnss = Pty(tmp_path / "sonar"), Pty(tmp_path / "gnss")
    number, place = free_port(), f"udp:127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    daemon = subprocess.Popen(("gpsd", "-N", "-n", "-b", "-S", str(number), place.replace("udp:", "udp://")))
    heard = b""

    def say(n: Navigation) -> None:
        nonlocal heard
        gnss.say(gga(n) + rmc(n) + hdt(n))
        with contextlib.suppress(BlockingIOError):
            heard += os.read(sonar._end, 4096)

    out = (
        f'nmea0183.out.sonar={{to="{sonar.name}", baud=38400, sentences=["HDT", "ROT", "RMC"], rate_hz=10.0}}',
        f'nmea0183.out.plotter={{to="{place}", sentences=["GGA", "RMC", "VTG", "HDT"], rate_hz=5.0}}',
    )
    try:
        with at_sea(tmp_path, say, *port("gnss", gnss.name), *out) as sea:
            state = sea.until(lambda s: s.get("nmea0183.out.sonar", {}).get("told", 0) > 30 and heard.count(b"RMC") > 5)
            with contextlib.closing(Listener(number)) as listener:
                told = listener.position()
            assert state["nmea0183.out.sonar"]["lost"] == state["nmea0183.out.plotter"]["lost"] == 0
    finally:
        daemon.terminate()
        daemon.wait(200)
    assert (told["lat"], told["lon"]) == pytest.approx((state["latitude_deg"], state["longitude_deg"]), abs=1e-4)
    read = [pynmea2.parse(line.decode(), check=True) for line in heard.split(b"\r\n")[1:-1]]
    assert {each.sentence_type for each in read} == {"HDT", "RMC"}, "the rate of turn is unknown, so it is not told"
    last = [each for each in read if each.sentence_type == "RMC"][-1]
    assert (last.latitude, last.longitude) == pytest.approx((state["latitude_deg"], state["longitude_deg"]), abs=1e-4)


@pytest.mark.long
def test_gpsd_for_the_receiver_and_datagrams_for_the_compass_sail_the_boat(tmp_path, gpsd):
    receiver, number = gpsd
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as compass:
        compass.bind(("127.0.0.1", 0))
        to = ("127.0.0.1", compass.getsockname()[1] % 60_000 + 2000)

        def say(n: Navigation) -> None:
            receiver.say(gga(n) + rmc(n))
            compass.sendto(hdt(n), to)

        ports = (*port("gnss", f"gpsd:127.0.0.1:{number}"), *port("compass", f"udp:{to[0]}:{to[1]}"))
        with at_sea(tmp_path, say, *ports) as sea:
            sea.sail("heading", heading_deg=90.0, speed_mps=1.0)
            state = sea.until(lambda s: s["speed_mps"] and s["speed_mps"] > 0.7 and abs(s["heading_deg"] - 90.0) < 10.0)
            kinds = {name: kind["talker"] for name, kind in state["nmea0183"]["kinds"].items()}
            assert (kinds["position"], kinds["heading"]) == ("gnss:GN", "compass:GN")
    assert "all the same, bit by bit" in replayed(tmp_path)
