"""Motors that are driven by pulses: a tree of files stands for the computer's PWM chip, and what the outlet writes there moves
the thrusters of the model. `delfim sim` drives the motors of front seats in this way, too (docs/simulator.md)."""

import math
from pathlib import Path
from typing import Final

from delfim import config
from delfim.base.frames import Frame
from delfim.parts.pwm.table import Pwm, PwmChannel
from delfim.simulator.model import Model
from delfim.simulator.nodes.period import Period

READ_S: Final = 0.05
USUAL: Final = PwmChannel()


class PulseMotor:
    """The motor of a row, and the servo that turns it."""

    hears: tuple[int, ...] = ()

    def __init__(self, model: Model, row: config.ThrusterTable, chip: Path) -> None:
        """Make the files of its channels. Raises OSError."""
        self._model, self._row, self._period = model, row, Period(READ_S)
        channels = (row.address,) if row.steer is None else (row.address, row.steer.address)
        self._files = [_made(chip / f"pwm{each}") for each in channels]

    @property
    def due_s(self) -> float:
        return self._period.due_s

    def feed(self, frame: Frame, now_s: float) -> None:
        """Ignore the frame: the motor is on no bus."""

    def step(self, now_s: float, utc_ns: int) -> list[Frame]:
        if self._period.passed(now_s):
            part, *turned = map(_part, self._files)
            most_deg = self._row.steer.angle_max_deg if self._row.steer else 0.0
            self._model.push(self._row.name, part, math.radians(most_deg * sum(turned)))
        return []


def _made(place: Path) -> Path:
    """Make the files of a channel; returns that of its pulse."""
    place.mkdir(parents=True, exist_ok=True)
    for name in ("period", "duty_cycle", "enable"):
        (place / name).write_text("0\n")
    return place / "duty_cycle"


def _part(file: Path) -> float:
    """The fraction, -1 to 1, that a channel's pulse commands; 0 without pulses."""
    pulse_us = int(file.read_text().partition("\n")[0] or 0) / 1000.0
    if pulse_us < USUAL.astern_us:
        return 0.0
    return (pulse_us - USUAL.neutral_us) / (USUAL.ahead_us - USUAL.neutral_us)


def nodes(settings: config.Vehicle, model: Model, seed: int) -> dict[str, PulseMotor]:
    """The motors by name; none where the chip is a real one: that of a simulation is a folder of its own."""
    chip = Path(settings.of(Pwm).chip)
    rows = [row for row in settings.thrusters if row.driver == "pwm" and chip.is_relative_to(settings.runtime.run_directory)]
    return {row.name: PulseMotor(model, row, chip) for row in rows}
