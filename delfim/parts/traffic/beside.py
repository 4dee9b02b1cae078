"""Vessels that move as the boat does: its own transponder, which the file does not name, or a vessel that lies alongside, tows
or is towed. To turn away from them is of no use: they come along. So the guard leaves them alone while it is so, and people
are told of them.

Whoever stays where the boat is for BESIDE_S and BESIDE_M of the boat's own way is such a one, as told by reports that are
fresh: between two of them a vessel is reckoned straight on, while the boat may turn. Once a fresh report says that it is off,
it is a vessel like others. Who was one is remembered, over a restart, too, and is one again with its first report from the
boat's place, or with one from elsewhere no longer. Pure; of a few vessels at most.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from delfim.parts.traffic.encounter import AT_REST_MPS, Own
from delfim.vehicle.target import BESIDE_MAX, NEVER_S, Danger, Target

KINDS: Final = ("A", "B")  # of AIS. What a payload sees is no transponder, a distress signal is a person
NEAREST: Final = 4  # vessels that are looked at
BESIDE_S, BESIDE_M, REPORTS = 60.0, 50.0, 3  # at least
FRESH_S: Final = 3.0  # age of a report that tells where the vessel is
LATE_S: Final = 2.0  # of the boat's way, by which a report may be late
AWAY: Final = 2.0  # times as far off it is a vessel like others again
GAP_S: Final = 5.0  # of way at most that one look adds


class Companion(NamedTuple):
    """A vessel at the boat's own place."""

    since_s: float
    sailed_m: float  # by the boat until then
    reported_s: float  # the last report
    reports: int
    is_sure: bool


class Company(NamedTuple):
    """The memory from look to look."""

    vessels: Mapping[str, Companion] = {}  # by key
    sailed_m: float = 0.0  # by the boat since its start
    at_s: float = NEVER_S
    remembered: tuple[str, ...] = ()  # keys of those that were sure, the newest last, also of before a restart

    def has(self, key: str) -> bool:
        return key in self.vessels and self.vessels[key].is_sure


def company(before: Company, own: Own, length_m: float, targets: Sequence[Target], now_s: float) -> Company:
    """Call it about once a second. `targets`: the nearest first. `length_m`: of the boat."""
    way_m = own.speed_mps * min(max(now_s - before.at_s, 0.0), GAP_S) if own.speed_mps > AT_REST_MPS else 0.0
    sailed_m, found, remembered = before.sailed_m + way_m, dict[str, Companion](), list(before.remembered)
    looked_at = list(targets[:NEAREST])
    if before.vessels or remembered:
        looked_at += [each for each in targets[NEAREST:] if each.key in before.vessels or each.key in remembered]
    for target in looked_at:
        key = target.key
        new = known = before.vessels.get(key)
        if target.kind not in KINDS:
            continue
        if target.age_s <= FRESH_S:
            near_m = target.margin_m + length_m / 2.0 + LATE_S * own.speed_mps
            far_m = math.hypot(target.north_m - own.north_m, target.east_m - own.east_m)
            new = _seen(known, far_m / near_m, now_s - target.age_s, sailed_m, key in remembered)
            if key in remembered:
                remembered.remove(key)
        if new is not None:
            found[key] = new
            if new.is_sure and key not in remembered:
                remembered.append(key)
    return Company(found, sailed_m, now_s, tuple(remembered[-BESIDE_MAX:]))


def _seen(known: Companion | None, apart: float, reported_s: float, sailed_m: float, was_sure: bool) -> Companion | None:
    """`apart`: 1 is as far as it may be to begin with."""
    if apart > (AWAY if known is not None and known.is_sure else 1.0):
        return None
    if known is None:
        return Companion(reported_s, sailed_m, reported_s, 1, is_sure=was_sure)
    reports = known.reports + (reported_s - known.reported_s > 0.5)
    is_long = reported_s - known.since_s >= BESIDE_S and sailed_m - known.sailed_m >= BESIDE_M
    return known._replace(reported_s=reported_s, reports=reports, is_sure=known.is_sure or (is_long and reports >= REPORTS))


def danger_beside(target: Target) -> Danger:
    """The danger of a companion, for people. How near it comes is no question."""
    key, name = target.key, target.name
    words = f"{name} moves as this boat does and is not avoided. Its own transponder? Then traffic.mmsi = {key[:9]}"
    return Danger(key, math.nan, math.nan, math.nan, "near", words)
