"""One thruster on the bench, by hand: armed by its name, and turning only while a key is held (docs/bench.md).

Where the boat's program runs, it is asked to turn the thruster. Otherwise this opens the boat's own driver, behind the same
gate: instead of that program, never beside it.
"""

import contextlib
import errno
import os
import select
import signal
import socket
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, Protocol

from delfim import config
from delfim.base.errors import DelfimError, Refused, did_you_mean
from delfim.services.supervision.stop import opened_driver
from delfim.vehicle.propulsion.actuators import Actuator
from delfim.vehicle.propulsion.gate import GateLimits, limited
from delfim.vehicle.state import Actuation, State

HELD_S: Final = 0.8  # that a key counts as held: keyboards repeat it after 0.25 to 0.66 s
TICK_S: Final = 0.05
STOPS: Final = 5  # said one after the other at the end
SHOW_S: Final = 0.25
SAY_S: Final = 0.2  # between two words to the boat's program, which stops the thruster 0.8 s after the last
OUTLET_S: Final = 20.0  # for the outlet to come up


class RunningBoat(Protocol):
    """The boat's program."""

    def ask(self, command: str, **words: object) -> dict[str, Any]: ...  # its state; raises DelfimError with its reason


class DeadMan:
    """The dead-man: a key that is held. Times are monotonic."""

    def __init__(self, for_s: float) -> None:
        self._for_s, self._key_s = for_s, 0.0
        self._begun_s: float | None = None
        self.ended = ""  # why, in words

    def is_held(self, now_s: float, is_pressed: bool) -> bool:
        """Whether the key is held. It begins with a press, and ends for good when the key is let go, or in time."""
        if is_pressed:
            self._key_s = now_s
            self._begun_s = now_s if self._begun_s is None else self._begun_s
        if self._begun_s is None:
            return False
        if now_s - self._key_s > HELD_S:
            self.ended = "the key was let go"
        elif now_s - self._begun_s > self._for_s:
            self.ended = f"{self._for_s:g} s are over"
        return not self.ended


class Trial:
    """The command of the thruster from one moment to the next. Times are monotonic."""

    def __init__(self, limits: GateLimits, row: int, part: float, key: DeadMan) -> None:
        thrust = tuple(part if each == row else 0.0 for each in range(len(limits.rates_per_s)))
        self._limits, self._wanted, self._key = limits, limits.still._replace(thrust=thrust, run=True), key
        self._sent, self._sent_s = limits.still, 0.0

    def at(self, now_s: float, is_pressed: bool) -> Actuation:
        """The command now."""
        wanted = self._wanted if self._key.is_held(now_s, is_pressed) else self._limits.still
        dt_s = now_s - self._sent_s if self._sent.run else 0.0
        self._sent, self._sent_s = limited(wanted, self._sent, self._limits, dt_s), now_s
        return self._sent


def runs(settings: config.Vehicle) -> bool:
    """Whether the boat's program answers on its socket. Raises DelfimError where that cannot be found out."""
    with socket.socket(socket.AF_UNIX) as knock:
        number = knock.connect_ex(settings.console.socket)
    if number not in (0, errno.ENOENT, errno.ECONNREFUSED):
        words = f"{settings.console.socket}: {os.strerror(number)}"
        raise DelfimError(f"it cannot be told whether the boat's program runs, which has the thrusters then: {words}")
    return number == 0


def actuate(
    settings: config.Vehicle,
    file: str,
    overrides: Sequence[str],
    name: str,
    part: float,
    for_s: float,
    boat: RunningBoat | None,
) -> None:
    """Run `delfim actuate`. `boat` None: its program does not run. Raises DelfimError."""
    rows = {row.name: index for index, row in enumerate(settings.thrusters)}
    if name not in rows:
        raise DelfimError(f"{file}: there is no thruster {name!r}{did_you_mean(name, rows)}; there are {', '.join(rows)}")
    if not sys.stdin.isatty():
        raise DelfimError("this needs a terminal: the thruster turns only while a key is held")
    if boat is not None and (mode := boat.ask("state")["mode"]) != "idle":
        raise DelfimError(f"the boat's program runs, in mode {mode}: a thruster is tried in idle alone; stop it first")
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    row, key = settings.thrusters[rows[name]], DeadMan(for_s)
    with contextlib.ExitStack() as held:
        if boat is not None:
            print(f"The boat's program runs: it turns {name}, and nothing else.")
            _armed(row, part, for_s)
            held.enter_context(keys())
            _ask(boat, name, part, for_s, key)
            return
        if settings.drives(row).outlet:
            held.enter_context(_outlet(file, overrides))
        driver, links = opened_driver(settings, row.driver)
        held.enter_context(links)
        _armed(row, part, for_s)
        held.callback(_stopped, driver)
        held.enter_context(keys())
        _turn(driver, Trial(GateLimits(settings.thrusters), rows[name], part, key), key, name)


def _armed(row: config.ThrusterTable, part: float, for_s: float) -> None:
    """Ask for the thruster's name. Raises DelfimError for another word."""
    print(f"{row.name}: {row.driver} {row.address}, {part:.0%} for {for_s:g} s at most. Are the propellers off, and all hands?")
    if input(f"Type {row.name} to arm it: ").strip() != row.name:
        raise DelfimError("not armed: that is not its name")
    print("Hold the space bar: it turns while you hold it, and stops when you let go. Ctrl-C ends.", flush=True)


def _ask(boat: RunningBoat, name: str, part: float, for_s: float, key: DeadMan) -> None:
    """Turn the thruster through the boat's program. A refusal is the end, without another order: somebody else may have the
    boat now."""
    said_s = shown_s = 0.0
    try:
        while not key.ended:
            is_pressed, now_s = pressed(), time.monotonic()
            if not key.is_held(now_s, is_pressed) or now_s - said_s < SAY_S:
                continue
            told, said_s = boat.ask("actuate", thruster=name, part=part, for_s=for_s)["thrusters"][name], now_s
            if now_s - shown_s > SHOW_S:
                shown_s = now_s
                thrust = told.pop("thrust")
                print(f"thrust {thrust:+.0%} {_words(told)}", flush=True)
    except KeyboardInterrupt:
        key.ended = "Ctrl-C"
    with contextlib.suppress(Refused):  # the boat has ended it already
        boat.ask("actuate", thruster=name, part=0.0)
    print(f"stopped: {key.ended}", flush=True)


def _words(report: Mapping[str, object]) -> str:
    """The values of a report that are known, in words."""
    known = {
        what: round(each, 2) if isinstance(each, float) else each for what, each in report.items() if each not in (None, [], ())
    }
    return ", ".join(f"{what} {each}" for what, each in known.items())


def pressed(within_s: float = TICK_S) -> bool:
    """Whether a key was pressed within this time."""
    ready, _, _ = select.select([sys.stdin], [], [], within_s)
    return bool(ready and os.read(sys.stdin.fileno(), 4096))


def _turn(driver: Actuator, trial: Trial, key: DeadMan, name: str) -> None:
    state, shown_s = State(), 0.0
    while not key.ended:
        is_pressed, now_s = pressed(), time.monotonic()
        sent = trial.at(now_s, is_pressed)
        unsent = driver.send(sent, now_s) + driver.repeat(now_s)
        for each in driver.inputs:
            each.read(state, now_s)
        if now_s - shown_s > SHOW_S:
            report, shown_s = state.thrusters.get(name), now_s
            told = {} if report is None else report._asdict()
            told.pop("heard_s", None)
            print(f"thrust {max(sent.thrust, key=abs):+.0%}{', not taken' if unsent else ''} {_words(told)}", flush=True)
    print(f"stopped: {key.ended}", flush=True)


def _stopped(driver: Actuator) -> None:
    """Stop the driver. Raises DelfimError where no stop was taken."""
    taken = 0
    for _ in range(STOPS):
        with contextlib.suppress(OSError):
            driver.stop()
            taken += 1
    if not taken:
        raise DelfimError("the stop was not taken: cut the power of the motors")


@contextlib.contextmanager
def keys() -> Iterator[None]:
    """Read keys one by one, without showing them."""
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSANOW, before)


@contextlib.contextmanager
def _outlet(file: str, overrides: Sequence[str]) -> Iterator[None]:
    """Start the process that writes pulses, as the supervisor does."""
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
