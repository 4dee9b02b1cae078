"""Rules of the fence, with a geometry of their own: a plane about the first corner, good to a decimetre within kilometres."""

import tomllib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from delfim.audit.evidence import IDLE, LOOK_S, Evidence, Unjudged, spells
from delfim.audit.rule import Finding, Rule

AXIS_M: Final = 6_378_137.0
SQUARE: Final = 0.006_694_38  # of the eccentricity: WGS 84
SURE_M: Final = 0.5  # less is not judged
SURE_S: Final = 1.0
POINTS: Final = 6  # of the way that the boat needs to stop
NEARS_MPS: Final = 0.1  # a boat outside that comes nearer so fast is coming back
AWAY: Final = ("manual", "hold", IDLE)  # what a boat outside may be in

Array = NDArray[np.float64]


class FenceZones:
    """One fence: areas of which the boat stays in one, and areas that it stays out of."""

    def __init__(self, tables: Mapping[str, Any], zero: tuple[float, float]) -> None:
        self._zero = zero
        self.margin_m = float(tables.get("margin_m", 3.0))
        self.keep_in = [self._shape(each) for each in tables.get("keep_in", ())]
        self.keep_out = [self._shape(each) for each in tables.get("keep_out", ())]

    def _shape(self, table: Mapping[str, Any]) -> tuple[Array, float]:
        """A zone's corners, or its centre, in metres; and the radius."""
        points = np.radians(np.array(table.get("polygon") or table.get("centre"), float).reshape(-1, 2))
        return self.plane_m(points[:, 0], points[:, 1]), float(table.get("radius_m", 0.0))

    def plane_m(self, latitude_rad: Array, longitude_rad: Array) -> Array:
        """North and east of the zero point, m."""
        sine = np.sin(self._zero[0])
        root = np.sqrt(1.0 - SQUARE * sine**2)
        north_m = (latitude_rad - self._zero[0]) * AXIS_M * (1.0 - SQUARE) / root**3
        return np.column_stack((north_m, (longitude_rad - self._zero[1]) * AXIS_M * np.cos(self._zero[0]) / root))

    def clear_m(self, at_m: Array) -> Array:
        """The distance of each point to what is forbidden, m; negative inside of it."""
        clear = np.full(len(at_m), np.inf)
        if self.keep_in:
            clear = np.max([_inside_m(at_m, *shape) for shape in self.keep_in], axis=0)
        for shape in self.keep_out:
            clear = np.minimum(clear, -_inside_m(at_m, *shape))
        return clear


def _inside_m(at_m: Array, corners_m: Array, radius_m: float) -> Array:
    """The distance of each point to the edge of an area, m; negative outside."""
    if len(corners_m) == 1:
        round_m: Array = radius_m - np.hypot(*(at_m - corners_m[0]).T)
        return round_m
    inside, nearest = np.zeros(len(at_m), bool), np.full(len(at_m), np.inf)
    for begin, end in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        side = end - begin
        part = np.clip(((at_m - begin) @ side) / max(float(side @ side), 1e-9), 0.0, 1.0)
        nearest = np.minimum(nearest, np.hypot(*(at_m - begin - part[:, None] * side).T))
        crosses = (begin[0] > at_m[:, 0]) != (end[0] > at_m[:, 0])
        if side[0]:
            inside ^= crosses & (at_m[:, 1] < begin[1] + (at_m[:, 0] - begin[0]) / side[0] * side[1])
    return np.where(inside, nearest, -nearest)


class FenceView:
    """A run with respect to the fence: the clearance of each record, and that where the boat could stop."""

    def __init__(self, e: Evidence) -> None:
        if any(each.name == "fence" and not each.refused for each in e.orders):
            raise Unjudged("a fence was sent at sea")
        table = e.setting("fence")
        latitude, longitude = e.column("latitude").astype(float), e.column("longitude").astype(float)
        known = np.isfinite(latitude)
        if not known.any():
            raise Unjudged("no record has a position")
        zero = (float(latitude[known][0]), float(longitude[known][0]))
        fences = [(-np.inf, FenceZones(table, zero)), *_of_missions(e, zero)]
        if not any(zones.keep_in or zones.keep_out for _, zones in fences):
            raise Unjudged("there is no fence")
        at_m = fences[0][1].plane_m(latitude, longitude)
        speed = np.column_stack([np.nan_to_num(e.column(name).astype(float)) for name in ("north_speed", "east_speed")])
        v_mps = np.hypot(*speed.T)
        stop_m = v_mps * float(table["reaction_s"]) + v_mps**2 / (2.0 * float(table["deceleration_mps2"]))
        ahead = speed / np.maximum(v_mps, 1e-9)[:, None] * stop_m[:, None]
        self.known, self.v_mps, self.margin_m = known, v_mps, fences[0][1].margin_m
        self.here_m, self.least_m = (np.full(len(e.t_s), np.inf) for _ in range(2))
        for i, (from_s, zones) in enumerate(fences):
            until_s = (
                fences[i + 1][0] if 0 < i < len(fences) - 1 else np.inf
            )  # a mission takes the fence of the one before away
            its = known & (e.t_s >= from_s) & (e.t_s < until_s)
            way = [zones.clear_m(at_m[its] + ahead[its] * part) for part in np.linspace(0.0, 1.0, POINTS)]
            self.here_m[its] = np.minimum(self.here_m[its], way[0])
            self.least_m[its] = np.minimum(self.least_m[its], np.min(way, axis=0))


@lru_cache(maxsize=1)
def _view(e: Evidence) -> FenceView:
    return FenceView(e)


def _of_missions(e: Evidence, zero: tuple[float, float]) -> list[tuple[float, FenceZones]]:
    """The fences of missions that were accepted, each with its time."""
    found = list[tuple[float, FenceZones]]()
    for each in e.orders:
        if each.name == "mission" and not each.refused:
            try:
                told = tomllib.loads(str(each.value.get("text", "")))
            except tomllib.TOMLDecodeError:
                raise Unjudged("a mission came in pieces") from None
            found.append((each.t_s, FenceZones(told.get("fence", {}), zero)))
    return found


def fence_watched(e: Evidence) -> Iterator[Finding]:
    view = _view(e)
    nears = view.least_m < view.here_m - SURE_M
    due = view.known & nears & (view.least_m < view.margin_m - SURE_M) & (view.v_mps > 0.4) & (e.record_modes != IDLE)
    after_s = float(e.setting("failsafe.fence.after_s")) + SURE_S
    for first, last in spells(due):
        if e.t_s[last] - e.t_s[first] >= after_s and not _is_reported(e, float(e.t_s[first]), after_s):
            words = f"the boat could stop {view.least_m[first]:.1f} m from the fence, and nobody was told"
            yield Finding(e.t_s[first] + after_s, f"{words}; fence.margin_m is {view.margin_m:g}")
    for alarm in e.named("fence"):
        at = e.last(alarm.begin_s)
        told = alarm.told[0].words
        if at is None or " away at " not in told or " of chart " in told or not view.known[at] or e.lost[max(at - 1, 0)]:
            continue
        if view.least_m[at] > view.margin_m + SURE_M + view.v_mps[at] * LOOK_S:
            words = f"the boat would stop {view.least_m[at]:.1f} m from the fence"
            yield Finding(alarm.begin_s, f"fence ({told}): {words}; fence.margin_m is {view.margin_m:g}")


def _is_reported(e: Evidence, t_s: float, after_s: float) -> bool:
    return any(each.begin_s <= t_s + after_s and each.end_s >= t_s - SURE_S for each in e.named("fence", "fence_left"))


def outside_stopped(e: Evidence) -> Iterator[Finding]:
    """Nothing drives outside by itself but a hold that comes back."""
    view = _view(e)
    if e.action("fence", "heading") == "warn":
        raise Unjudged("failsafe.fence only warns")
    outside = view.known & (view.here_m < -SURE_M)
    alone = outside & e.is_driven & ~np.isin(e.record_modes, AWAY)
    for first, last in spells(alone):
        if e.t_s[last] - e.t_s[first] > SURE_S:
            yield Finding(
                e.t_s[first], f"in {e.record_modes[first]} {-view.here_m[first]:.1f} m outside the fence, under power"
            )
    after_s, clear_m = float(e.setting("failsafe.fence_left.after_s")), -view.here_m
    away = outside & (clear_m > view.margin_m + SURE_M) & e.is_driven & (e.record_modes == "hold")
    for first, last in spells(away):
        best = np.minimum.accumulate(clear_m[first : last + 1])
        for at in range(first, last + 1):
            since = int(np.searchsorted(e.t_s, e.t_s[at] - after_s - 2 * SURE_S))
            if since <= first or e.t_s[at] - e.t_s[since] < after_s + SURE_S:
                continue
            if best[since - first] - best[at - first] < NEARS_MPS * SURE_S:
                yield Finding(
                    e.t_s[at], f"{clear_m[at]:.1f} m outside the fence in hold for {after_s:g} s, and comes no nearer"
                )
                break


def idle_left_outside(e: Evidence) -> Iterator[Finding]:
    view = _view(e)
    for each in e.modes:
        at = e.last(each.t_s)
        if (
            each.before == IDLE
            and each.mode not in (IDLE, "manual")
            and at is not None
            and view.known[at]
            and view.here_m[at] < -SURE_M
        ):
            yield Finding(
                each.t_s, f"from idle to {each.mode} {-view.here_m[at]:.1f} m outside the fence; only manual is allowed"
            )


_FENCE: Final = "failsafe.md#the-fence"
RULES: Final = (
    Rule(
        "fence-watched",
        "A boat that can no longer stop fence.margin_m from the fence is told of, and no other.",
        _FENCE,
        fence_watched,
    ),
    Rule("outside-stopped", "Outside the fence nothing drives by itself but a hold that comes back.", _FENCE, outside_stopped),
    Rule("idle-left-outside", "From idle only manual mode is allowed outside.", _FENCE, idle_left_outside),
)
