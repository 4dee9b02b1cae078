"""The record of a trial, for the fit. Needs numpy."""

import math
from collections.abc import Sequence
from typing import Any, Final, Protocol

from delfim.adoption.record import TRIAL, BoatRecord, Manoeuvre, Series
from delfim.adoption.suited import is_several, parts_told
from delfim.adoption.trial.manoeuvres import MotionSeen, Played
from delfim.adoption.trial.motors import MotorsFound, as_corrected
from delfim.base.errors import DelfimError
from delfim.config import ThrusterTable

PROOF: Final = "proof"  # the manoeuvre that proves the motors
HEARD: Final = 0.8  # of the looks, at least, told what the sensors said: a trial that went on from an older program has none
SAME_S: Final = 0.01  # stamps that differ by less are of one value: they are reckoned from ages


class TapedTrial(Protocol):
    """What is known of a trial."""

    @property
    def thrusters(self) -> Sequence[ThrusterTable]: ...
    @property
    def motors(self) -> MotorsFound | None: ...
    @property
    def tape(self) -> Sequence[MotionSeen]: ...
    @property
    def played(self) -> Sequence[Played]: ...


def record_of(progress: TapedTrial, *, is_estimated: bool) -> BoatRecord:
    """The record for the fit: what was told, in the order and with the signs of the corrected rows, and how she moved.
    `is_estimated`: her motion is that of an estimator; what its sensors themselves said is taken where the tape has it."""
    rows, found, tape = progress.thrusters, progress.motors, progress.tape
    if found is None:
        raise DelfimError("the motors were not found: there is nothing to fit")
    if is_several(rows):  # until the motors were proven those at a side were not commanded alike
        proven_s = max((each.to_s for each in progress.played if each.name == PROOF and not each.ended), default=-math.inf)
        tape = [each for each in tape if each.at_s >= proven_s]
    told = [(each.at_s, *as_corrected(found, rows, each.told)) for each in tape]
    velocity = [(each.at_s, each.north_mps, each.east_mps) for each in tape]
    heading, turn = ([(each.at_s, getattr(each, name)) for each in tape] for name in ("heading_rad", "turn_radps"))
    is_raw = not is_estimated or sum("heading" in (each.measured or ()) for each in tape) > HEARD * len(tape)
    if is_estimated and is_raw:
        velocity, heading, turn = (_measured(tape, kind) for kind in ("velocity", "heading", "rate"))
    return BoatRecord(
        thrusters=tuple(row.name for row in rows),
        told=Series.of(told, parts_told(rows)),
        position=Series.of([(each.at_s, each.north_m, each.east_m) for each in tape], 2),
        velocity=Series.of(velocity, 2),
        heading=Series.of(heading, 1),
        turn=Series.of(turn, 1),
        is_raw=is_raw,
        manoeuvres=tuple(Manoeuvre(each.name, each.from_s, each.to_s) for each in progress.played),
        source=TRIAL,
    )


def _measured(tape: Sequence[MotionSeen], kind: str) -> list[Any]:
    """What a sensor said, each value once. The stamps are on the clock of the tape."""
    said, last_s = list[Any](), -math.inf
    for each in tape:
        if (value := (each.measured or {}).get(kind)) and value[0] > last_s + SAME_S:
            said.append(value)
            last_s = value[0]
    return said
