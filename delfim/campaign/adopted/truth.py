"""The truth about a drawn boat, and how far what was found is from it."""

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from delfim import config
from delfim.adoption.identify import Identified
from delfim.adoption.model import said
from delfim.adoption.suited import place_of
from delfim.adoption.trial.hiddenhull import Hidden, LateModel
from delfim.adoption.trial.motors import Wiring
from delfim.adoption.trial.several import kinds_of
from delfim.simulator.tables import Sea

STEADY_S: Final = 60.0
STEP_S: Final = 0.05
IRON: Final = "hard_ahead", "hard_aside", "soft_along", "soft_across", "compass_offset"


class BoatTruth(NamedTuple):
    """What a trial should find."""

    wiring: tuple[bool, tuple[bool, ...], bool]  # exchanged, reversed, turned the other way
    full_mps: float
    dead: tuple[float, ...]
    late_s: float


class CompassOff(NamedTuple):
    """What the compass would still tell wrong, degrees."""

    offset_deg: float  # mean over all headings
    rms_deg: float  # of the rest
    most_deg: float


def truth(settings: config.Vehicle, hidden: Hidden) -> BoatTruth:
    """Of a drawn boat; her full speed is sailed in calm water."""
    calm = LateModel(settings, hidden._replace(sea=Sea()), 1)
    for row, is_back in zip(hidden.rows, hidden.reversed, strict=True):
        way = (place_of(row).way if hidden.places else 1) * (1 if hidden.places or not is_back else -1)
        calm.push(row.name, float(way), hidden.middle_rad)
    for _ in range(round(STEADY_S / STEP_S)):
        calm.advance(STEP_S)
    dead = tuple(row.dead for row in hidden.rows)
    wiring = hidden.swapped, hidden.reversed, hidden.turned
    return BoatTruth(wiring, calm.surge_mps, dead, hidden.delay_s + hidden.hull.motor_s)


def is_right(found: Wiring, hidden: Hidden, rows: Sequence[config.ThrusterTable]) -> bool:
    """Whether this is the wiring of a drawn boat. Of three or more motors those that do the same to it may be told one for the
    other."""
    if not hidden.places:
        return found == Wiring(hidden.swapped, hidden.reversed, hidden.turned)
    kinds = kinds_of(rows)
    told, real = ([kinds[at] for at in places] for places in (found.places, hidden.places))
    return told == real and found.reversed == hidden.reversed


def compass_off(hidden: Hidden, numbers: dict[str, Any]) -> CompassOff:
    """Of a compass that is corrected by these five numbers, named as the fit has them."""
    headings = np.radians(np.arange(0.0, 360.0, 5.0))
    off = said(numbers, headings) - np.array([hidden.sensors.said(each) for each in headings])
    off = np.degrees(np.remainder(off + np.pi, 2.0 * np.pi) - np.pi)
    rest = off - off.mean()
    return CompassOff(float(off.mean()), float(rest.std()), float(np.abs(rest).max()))


def figures_off(result: Identified, settings: config.Vehicle, hidden: Hidden, real: BoatTruth) -> dict[str, Any]:
    """What the fit says less the truth, by the columns' names."""
    p, full = result.fit.values, result.found.figures["full_mps"]
    sides = ("dead_starboard", "dead_port")[: len(settings.thrusters)]
    compass = compass_off(hidden, {key: p[key] for key in IRON})
    row = {"full_off": full.found / real.full_mps - 1.0, "beyond": int(full.is_beyond)}
    row |= {"dead_off": max((p[name] - dead for name, dead in zip(sides, real.dead, strict=False)), key=abs)}
    if settings.thrusters[0].steer is not None:
        row["straight_off_deg"] = math.degrees(p["straight"] - (-1.0 if hidden.turned else 1.0) * hidden.middle_rad)
    row["late_off_s"] = p["delay"] + p["lag"] - real.late_s
    return row | {"offset_off_deg": compass.offset_deg, "deviation_off_deg": compass.most_deg}
