"""Other vessels for people and programs: degrees, words, ages. JSON-ready, finite, bounded by the number of targets."""

import math
from typing import Final, cast

import msgspec

from delfim.base.cooperative import Work
from delfim.base.geodesy import Origin, from_plane
from delfim.vehicle.report import OrderInForce, TrafficSeen, VesselSeen
from delfim.vehicle.target import NEVER_S, CourseOrder, Danger, Target, Traffic, VesselTold

TOLD: Final = 5  # comparisons that the words for one vessel cost
_encode: Final = msgspec.json.Encoder().encode


def making(traffic: Traffic, origin: Origin | None) -> Work[tuple[msgspec.Raw, ...]]:
    """The words for all vessels, the nearest first: `Traffic.told`. Places and ages are those of `Traffic.at_s`. They are
    encoded here, in slices and once, and not in the callback that tells the state, nor for each who watches it."""
    known, vessels = {each.key: each for each in traffic.dangers}, list[msgspec.Raw]()
    for each in traffic.targets:
        yield TOLD
        if origin is not None:
            vessels.append(msgspec.Raw(_encode(vessel_told(each, origin) | danger_told(known.get(each.key)))))
    return tuple(vessels)


def traffic_told(traffic: Traffic, now_s: float, awaits: bool = False) -> TrafficSeen | None:
    """The words for all vessels as made last, encoded; None where nobody was ever heard, unless the boat `awaits` somebody."""
    if traffic.is_empty and not awaits:
        return None
    return TrafficSeen(
        heard_s=_age(now_s, traffic.heard_s),
        own_s=_age(now_s, traffic.own_s),
        refused=dict(traffic.refused),
        targets=cast(tuple[VesselSeen, ...], traffic.told),  # they are read in other programs alone, decoded
        order=_ordered(traffic.order, now_s),
        guard=traffic.guard,
    )


def vessel_told(target: Target, origin: Origin) -> VesselTold:
    """The words for a vessel without its danger."""
    latitude_rad, longitude_rad = from_plane(origin, target.north_m, target.east_m)
    is_under_way = target.speed_mps > 0.0
    return {
        "key": target.key,
        "name": target.name,
        "latitude_deg": round(math.degrees(latitude_rad), 7),
        "longitude_deg": round(math.degrees(longitude_rad), 7),
        "course_deg": round(math.degrees(target.course_rad) % 360.0, 1) if is_under_way else None,
        "speed_mps": round(target.speed_mps, 2),
        "heading_deg": None if math.isnan(target.heading_rad) else round(math.degrees(target.heading_rad) % 360.0, 1),
        "length_m": round(target.length_m, 1),
        "beam_m": round(target.beam_m, 1),
        "size_known": target.is_size_known,
        "margin_m": round(target.margin_m, 1),
        "kind": target.kind,
        "status": target.status,
        "age_s": round(target.age_s, 1),
        "lost": target.is_lost,
    }


def danger_told(danger: Danger | None) -> VesselTold:
    """The words for a danger. What is not finite is None: beyond all numbers, or not computed yet."""
    if danger is None:
        return {"cpa_m": None, "tcpa_s": None, "nearness": None, "danger": "none"}
    _, cpa_m, tcpa_s, nearness, level, _ = danger
    return {
        "cpa_m": round(cpa_m, 2) if math.isfinite(cpa_m) else None,
        "tcpa_s": round(tcpa_s, 2) if math.isfinite(tcpa_s) else None,
        "nearness": round(nearness, 2) if math.isfinite(nearness) else None,
        "danger": level,
    }


def _ordered(order: CourseOrder | None, now_s: float) -> OrderInForce | None:
    if order is None:
        return None
    return OrderInForce(
        course_deg=round(math.degrees(order.course_rad) % 360.0, 1),
        speed_mps=round(order.speed_mps, 2),
        words=order.words,
        key=order.key,
        age_s=round(now_s - order.at_s, 1),
    )


def _age(now_s: float, at_s: float) -> float | None:
    """The age, s; None: never heard."""
    return None if at_s == NEVER_S else round(now_s - at_s, 1)
