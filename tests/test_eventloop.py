"""Which loop carries which process."""

import asyncio
import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

from delfim import config
from delfim.base.clock import SystemClock
from delfim.base.eventloop import new_event_loop
from delfim.services import runtime

VEHICLE = Path(__file__).parents[1] / "etc" / "delfimx.toml"


def test_a_process_without_a_navigation_window_has_uvloops_loop() -> None:
    import uvloop

    with asyncio.Runner(loop_factory=new_event_loop) as runner:
        assert isinstance(runner.get_loop(), uvloop.Loop)


def test_where_uvloop_is_not_installed_a_line_says_so(monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "uvloop", None)
    with caplog.at_level(logging.INFO), asyncio.Runner(loop_factory=new_event_loop) as runner:
        assert type(runner.get_loop()) is asyncio.SelectorEventLoop
    assert [record.message for record in caplog.records] == ["uvloop is not installed; asyncio's own loop serves this process"]


def test_a_service_in_a_process_of_its_own_runs_on_the_loop_that_it_is_given(tmp_path: Path) -> None:
    seen = list[type]()

    async def look(_: runtime.Runtime) -> None:
        seen.append(type(asyncio.get_running_loop()))

    settings = config.load(VEHICLE, [f'runtime.run_directory="{tmp_path}"'])
    for new_loop in (None, new_event_loop):
        running = runtime.Runtime(settings, SystemClock(), alone=True, new_loop=new_loop)
        assert running.main([runtime.LoadedService("look", look)]) == 0
    assert [each.__name__ for each in seen] == ["NavigationLoop", "Loop"]


def test_what_a_command_over_ssh_leaves_in_a_session_of_its_own_keeps_nobody_waiting(tmp_path: Path) -> None:
    subprocess.run(("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", tmp_path / "key"), check=True)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    settings = {
        "sshd.users.ana.keys": f"[{(tmp_path / 'key.pub').read_text().strip()!r}]",
        "sshd.listen": f"'127.0.0.1:{port}'",
        "sshd.root": f"'{tmp_path}'",
        "sshd.host_key": f"'{tmp_path}/host_key'",
        "runtime.run_directory": f"'{tmp_path}'",
    }
    words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    command = [sys.executable, "-m", "delfim", "run", str(VEHICLE), "--service", "sshd", *words]
    daemon = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert daemon.stderr is not None
    options = ["StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "IdentitiesOnly=yes", "LogLevel=ERROR"]
    ssh = ["ssh", "-F", "none", "-i", str(tmp_path / "key"), *(word for each in options for word in ("-o", each))]
    left = f"setsid sleep 600 >/dev/null 2>&1 </dev/null & echo $! >{tmp_path}/pid"
    try:
        while "ssh://" not in daemon.stderr.readline():
            pass
        done = subprocess.run(
            [*ssh, "-p", str(port), "ana@127.0.0.1", left], stdin=subprocess.DEVNULL, timeout=200, check=False
        )
        assert done.returncode == 0
    finally:
        with contextlib.suppress(OSError, ValueError):
            os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)
        daemon.terminate()
        daemon.communicate()
