"""The private details of asyncio on which navigation_loop.py rests, on every interpreter that this machine has.

As a program it says where the newest one is.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLACES = (Path.home() / ".pyenv/versions", Path("/usr/bin"), Path("/usr/local/bin"), Path(sys.executable).parent)
OLDEST = 11  # of Python 3
PROGRAM = """
import asyncio
import socket
from contextvars import copy_context

from delfim.base.clock import ManualClock
from delfim.services.priority.navigation_loop import ACCOUNT, Account, NavigationLoop
from delfim.services.priority.window import NavigationWindow

clock, order, account = ManualClock(), [], Account("service", 0.1)
receiver, sender = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)

def navigation():
    order.append(receiver.recv(16).decode())
    return True

def work(name):
    order.append(name)
    clock.advance(0.25)
    if name == "first":
        sender.send(b"navigation")

async def main():
    loop = asyncio.get_running_loop()
    loop.add_navigation(receiver.fileno(), navigation, print)
    context = copy_context()
    context.run(ACCOUNT.set, account)
    for name in ("first", "second"):
        loop.call_soon(work, name, context=context)
    while len(order) < 3:
        await asyncio.sleep(0)

with asyncio.Runner(loop_factory=lambda: NavigationLoop(NavigationWindow(0.0006, 0.0), clock, Account("loop", 1.0))) as runner:
    runner.run(main())
receiver.close()
sender.close()
print(*order, account.busy_s)
"""


def interpreters() -> dict[str, Path]:
    """One of each version, such as "3.11"."""
    versions = [f"3.{minor}" for minor in range(OLDEST, OLDEST + 20)]
    named = {version: [place / f"python{version}" for place in PLACES] for version in versions}
    kept = {version: sorted(PLACES[0].glob(f"{version}.*/bin/python")) for version in versions}
    found = {version: [path for path in named[version] + kept[version] if os.access(path, os.X_OK)] for version in versions}
    own = {f"3.{sys.version_info.minor}": Path(sys.executable)}
    kept_or_own = {version: paths[-1] for version, paths in found.items() if paths} | own
    return {version: kept_or_own[version] for version in versions if version in kept_or_own}


@pytest.mark.parametrize(("version", "python"), interpreters().items())
def test_navigation_comes_between_two_callbacks_and_each_is_charged_to_its_context(version: str, python: Path) -> None:
    settings = {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([python, "-W", "error", "-c", PROGRAM], capture_output=True, text=True, env=settings, timeout=100)
    assert (done.stdout, done.stderr) == ("first navigation second 0.5\n", ""), version


def test_the_interpreter_of_these_tests_is_among_them() -> None:
    assert f"3.{sys.version_info.minor}" in interpreters()


if __name__ == "__main__":
    print(list(interpreters().values())[-1])
