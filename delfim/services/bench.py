"""One thruster on the bench, by hand: armed by its name, and turning only while a key is held (docs/bench.md).

The driver is the boat's own, and so is the gate before it. It runs instead of the boat's program, never beside it.
"""

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Iterator, Sequence
from typing import Final

from delfim import config
from delfim.errors import DelfimError, did_you_mean
from delfim.services.stop import opened_driver
from delfim.vehicle.actuators import Actuator
from delfim.vehicle.gate import GateLimits, limited
from delfim.vehicle.state import Actuation, State

HELD_S: Final = 0.8  # that a key counts as held: keyboards repeat it after 0.25 to 0.66 s
TICK_S: Final = 0.05
STOPS: Final = 5  # said one after the other at the end
SHOW_S: Final = 0.25
OUTLET_S: Final = 20.0  # for the outlet to come up


class Trial:
    """What the thruster is told from one moment to the next. Times are monotonic."""

    def __init__(self, limits: GateLimits, row: int, part: float, for_s: float) -> None:
        thrust = tuple(part if each == row else 0.0 for each in range(len(limits.rates_per_s)))
        self._limits, self._wanted, self._for_s = limits, limits.still._replace(thrust=thrust, run=True), for_s
        self._sent, self._sent_s = limits.still, 0.0
        self._begun_s: float | None = None
        self._key_s = 0.0
        self.ended = ""  # why, in words

    def at(self, now_s: float, is_pressed: bool) -> Actuation:
        """The command now. It begins with a key, and ends for good when that is let go, or in time."""
        if is_pressed:
            self._key_s = now_s
        if self._begun_s is None:
            self._begun_s, self._sent_s = (now_s if is_pressed else None), now_s
            return self._limits.still
        if now_s - self._key_s > HELD_S:
            self.ended = "the key was let go"
        elif now_s - self._begun_s > self._for_s:
            self.ended = f"{self._for_s:g} s are over"
        wanted = self._limits.still if self.ended else self._wanted
        self._sent, self._sent_s = limited(wanted, self._sent, self._limits, now_s - self._sent_s), now_s
        return self._sent


def actuate(file: str, overrides: Sequence[str], name: str, part: float, for_s: float) -> None:
    """`delfim actuate`. Raises DelfimError."""
    settings = config.load(file, overrides)
    rows = {row.name: index for index, row in enumerate(settings.thrusters)}
    if name not in rows:
        raise DelfimError(f"{file}: there is no thruster {name!r}{did_you_mean(name, rows)}; there are {', '.join(rows)}")
    if not sys.stdin.isatty():
        raise DelfimError("this needs a terminal: the thruster turns only while a key is held")
    _alone(settings)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    row = settings.thrusters[rows[name]]
    with contextlib.ExitStack() as held:
        if row.driver == "pwm":
            held.enter_context(_outlet(file, overrides))
        driver, links = opened_driver(settings, row.driver)
        held.enter_context(links)
        print(f"{name}: {row.driver} {row.address}, {part:.0%} for {for_s:g} s at most. Are the propellers off, and all hands?")
        if input(f"Type {name} to arm it: ").strip() != name:
            raise DelfimError("not armed: that is not its name")
        print("Hold the space bar: it turns while you hold it, and stops when you let go. Ctrl-C ends.", flush=True)
        held.callback(_stopped, driver)
        held.enter_context(_keys())
        _turn(driver, Trial(GateLimits(settings.thrusters), rows[name], part, for_s), name)


def _turn(driver: Actuator, trial: Trial, name: str) -> None:
    state, shown_s = State(), 0.0
    while not trial.ended:
        pressed, _, _ = select.select([sys.stdin], [], [], TICK_S)
        now_s = time.monotonic()
        sent = trial.at(now_s, bool(pressed and os.read(sys.stdin.fileno(), 4096)))
        unsent = driver.send(sent, now_s) + driver.repeat(now_s)
        for each in driver.inputs:
            each.read(state, now_s)
        if now_s - shown_s > SHOW_S:
            report, shown_s = state.thrusters.get(name), now_s
            told = {} if report is None else {key: value for key, value in report._asdict().items() if value is not None}
            told.pop("heard_s", None)
            words = ", ".join(f"{key} {value}" for key, value in told.items())
            print(f"thrust {max(sent.thrust, key=abs):+.0%}{', not taken' if unsent else ''} {words}", flush=True)
    print(f"stopped: {trial.ended}", flush=True)


def _stopped(driver: Actuator) -> None:
    """Raises DelfimError where no stop was taken."""
    taken = 0
    for _ in range(STOPS):
        with contextlib.suppress(OSError):
            driver.stop()
            taken += 1
    if not taken:
        raise DelfimError("the stop was not taken: cut the power of the motors")


def _alone(settings: config.Vehicle) -> None:
    with socket.socket(socket.AF_UNIX) as knock:
        if knock.connect_ex(settings.console.socket) == 0:
            raise DelfimError(f"the boat's program answers on {settings.console.socket} and has the thrusters: end it first")


@contextlib.contextmanager
def _keys() -> Iterator[None]:
    """Keys come one by one, and are not shown."""
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSANOW, before)


@contextlib.contextmanager
def _outlet(file: str, overrides: Sequence[str]) -> Iterator[None]:
    """The process that writes pulses, as the supervisor starts it."""
    words = [word for each in overrides for word in ("--set", each)]
    beats, beat = os.pipe()
    program = subprocess.Popen(
        [sys.executable, "-m", "delfim", "outlet", file, *words, "--beat-fd", str(beat)], pass_fds=(beat,)
    )
    os.close(beat)
    try:
        if not select.select([beats], [], [], OUTLET_S)[0] or not os.read(beats, 1):
            raise DelfimError("the outlet, which writes the pulses, does not come up")
        yield
    finally:
        os.close(beats)  # it ends without us
        program.wait()
