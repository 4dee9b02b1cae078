"""The look at the computer, against the texts that the kernel and iproute2 write."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.services import computer
from delfim.services.computer import ComputerLook, can_bus, memory, networks, process, processors, program, programs, service
from delfim.vehicle.report import Service

DEV = """Inter-|   Receive                                                |  Transmit
 face |bytes    packets errs drop fifo frame compressed multicast|bytes    packets errs drop fifo colls carrier compressed
    lo: 100 2 0 0 0 0 0 0 100 2 0 0 0 0 0 0
  eth0:5000 7 1 2 0 0 0 0 900 3 4 5 0 0 0 0
"""


def test_processors_are_told_apart():
    stat = "cpu  9 9 9 9 9 9 9 9 0 0\ncpu0 10 0 10 70 10 0 0 0 0 0\ncpu1 50 0 50 0 0 0 0 0 0 0\nintr 1 2\n"
    assert processors(stat) == [(20, 100), (100, 100)]


def test_memory_is_in_bytes():
    found = memory("MemTotal:  1000 kB\nMemFree:  1 kB\nMemAvailable:  600 kB\nHugePages_Total:  0\n")
    assert (found.total_bytes, found.available_bytes) == (1_024_000, 614_400)


def test_counters_of_networks():
    found = networks(DEV)
    assert list(found) == ["lo", "eth0"]
    assert (found["eth0"][0], found["eth0"][2], found["eth0"][8], found["eth0"][11]) == (5000, 1, 900, 5)


@given(st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0\n"), min_size=1, max_size=15))
def test_a_process_may_be_called_anything(name):
    numbers = "S 1 1 1 0 -1 4194560 1 0 0 0 25 5 0 0 30 10 3 0 569528 3133440 407 1 1"
    found = process(f"123 ({name}) {numbers}")
    assert found == (123, name, 30, 10, 3, 407 * os.sysconf("SC_PAGE_SIZE"))


@pytest.mark.parametrize(
    ("name", "words", "shown"),
    [
        ("sshd", ["/usr/sbin/sshd", "-D", "secret"], "sshd"),
        ("python", ["python", "-m", "delfim", "run", "etc/boat.toml"], "delfim run"),
        ("python3.11", ["python3.11", "-u", "-m", "http.server", "secret"], "http.server"),
        (
            "python",
            ["python", "-m", "delfim", "run", "etc/boat.toml", "--service", "ftpd", "--beat-fd", "7"],
            "delfim run ftpd",
        ),
        ("python3", ["/opt/delfim/bin/python", "-P", "/usr/bin/delfim", "supervise", "boat.toml"], "delfim supervise"),
        ("python", ["python", "-m", "delfim"], "delfim"),
        ("python", ["python", "/opt/app/tool.py", "--key=secret"], "tool.py"),
        ("python", ["python", "/opt/app/tool.py", "-m", "secret"], "tool.py"),
        ("python3", ["python3", "-B", "-P", "-c", "from secret import main; main(7)"], "python3 -c"),
        ("python3", ["python3", "-c"], "python3 -c"),
        ("python", ["python"], "python"),
        ("python", ["python", "-m"], "python"),
        ("python", [""], "python"),
    ],
)
def test_a_python_program_has_a_name_of_its_own(name, words, shown):
    assert program(name, words) == shown


def test_a_can_controller():
    name, bus, bits = can_bus(
        {
            "ifname": "can0",
            "linkinfo": {
                "info_data": {
                    "state": "ERROR-PASSIVE",
                    "bittiming": {"bitrate": 1_000_000},
                    "berr_counter": {"tx": 128, "rx": 3},
                },
                "info_xstats": {"bus_error": 9, "bus_off": 2},
            },
            "stats64": {"rx": {"packets": 10, "bytes": 80, "errors": 1, "dropped": 4}, "tx": {"packets": 5, "bytes": 40}},
        }
    )
    assert (name, bus.state, bus.bitrate_bps, bus.frames, bus.dropped) == ("can0", "error passive", 1_000_000, 15, 4)
    assert (bus.errors, bus.bus_off, bus.transmit_errors, bus.receive_errors) == (10, 2, 128, 3)
    assert bits == 8 * 120 + 15 * computer.FRAME_OVERHEAD_BITS
    assert can_bus({"ifname": "vcan0", "operstate": "UNKNOWN"})[1].state == "unknown"


def test_the_supervisors_state():
    text = (
        '{"pid": 1, "programs": {"runtime": {"state": "running", "pid": 7, "restarts": 2, "reason": "killed", "since_s": 90.0}}'
        ', "deadman": {"reason": "beat stopped", "at_s": 80.0}}'
    )
    found, deadman = programs(text, 100.0)
    assert (found["runtime"].restarts, found["runtime"].for_s, deadman) == (2, 10.0, "beat stopped, 20 s ago")


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"programs": {"x": {}}, "deadman": null}', '{"programs": 1}'])
def test_a_state_file_that_is_not_there_or_torn_is_nothing(text):
    assert programs(text, 0.0) == ({}, "")


def test_when_the_disk_will_be_full(tmp_path, monkeypatch):
    free = 1000

    class Disk:
        f_frsize, f_blocks = 1, 5000
        f_bavail = property(lambda self: free)

    monkeypatch.setattr(computer.os, "statvfs", lambda path: Disk())
    look = ComputerLook(str(tmp_path), 100, str(tmp_path))
    assert look._disk(0.0).full_in_s is None, "nothing to compare with"
    free = 900
    assert look._disk(10.0).full_in_s is None, "too short to tell"
    free = 700
    assert look._disk(60.0).full_in_s == pytest.approx(120.0), "600 above what is kept free, 5 a second"
    free = 1200
    assert look._disk(70.0).full_in_s is None, "the guard made room"
    free = 1000
    assert look._disk(665.0).full_in_s == pytest.approx((1000 - 100) / (200 / 595)), "what is long ago is forgotten"


def test_a_disk_that_is_not_there(tmp_path):
    assert ComputerLook(str(tmp_path / "gone"), 0, str(tmp_path))._disk(0.0) is None


def test_this_computer(tmp_path):
    look = ComputerLook(str(tmp_path), 0, str(tmp_path))
    look.look(0.0, time.time_ns())
    found = look.look(1.0, time.time_ns())
    assert found.memory.total_bytes > found.memory.available_bytes > 0
    assert found.networks["lo"].up
    assert "127.0.0.1" in found.networks["lo"].addresses
    assert found.disk is not None
    assert found.disk.free_bytes > 0
    assert found.process_count >= len(found.processes) > 0
    assert all(0.0 <= share <= 1.0 for share in found.cpu)


def test_a_computer_without_anything(tmp_path):
    (tmp_path / "proc").mkdir()
    found = ComputerLook(str(tmp_path), 0, str(tmp_path), tmp_path).look(0.0, 0)
    assert (found.uptime_s, found.cpu, found.temperature_c, found.processes) == (0.0, (), None, ())


def test_the_hottest_zone(tmp_path):
    for number, text in enumerate(("41000\n", "55500\n", "nonsense\n", "-5000\n")):
        zone = tmp_path / f"sys/class/thermal/thermal_zone{number}"
        zone.mkdir(parents=True)
        (zone / "temp").write_text(text)
    assert computer.temperature_c(Path(tmp_path)) == 55.5


def test_a_process_is_as_the_supervisor_and_its_service_say():
    known = Service(state="running", restarts=1, reason="exit code 1", pid=7)
    own = '{"place": "process", "state": "waiting", "restarts": 2, "reason": "%s", "pid": %d, "figures": {"connections": 3}}'
    both = service(known, own % ("OSError: full", 7))
    assert (both.state, both.restarts, both.reason, both.figures) == ("waiting", 3, "OSError: full", {"connections": 3})
    assert service(known, own % ("", 7)).reason == "exit code 1"
    assert service(known, own % ("OSError: full", 6)) == known, "of the process before"
    assert service(known, "{") == known
    silent = Service(state="running", reason="does not answer", pid=7)
    assert service(silent, own % ("OSError: full", 7)).reason == "does not answer"
    ended = Service(state="failed", reason="exit code 100")
    assert service(ended, own % ("no such user", 7)).reason == "no such user"
    assert service(ended, own % ("no such user", 7)).state == "failed"


def test_the_sampler_loads_no_loop():
    """It is a process of its own on every boat that has a page, and asyncio with ssl is 5 MB."""
    look = "import sys, delfim.services.computer; print(*sys.modules)"
    loaded = set(subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout.split())
    assert "msgspec" in loaded
    assert loaded & {"asyncio", "ssl", "aiohttp"} == set()
