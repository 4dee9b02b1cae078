"""What was found of a boat, as keys of its vehicle's file, beside what the file told; and what may have changed since.

Mass and thrust are known up to one factor. The file's mass is kept: forces are those of a boat of that mass.
"""

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from delfim import config
from delfim.adoption.changes import changes, unseen
from delfim.adoption.figures import TOO_WINDY, Figure, calm, figures
from delfim.adoption.fitting import Fit
from delfim.adoption.foretold import Motor, motors_of
from delfim.adoption.model import Array, ModelMotion, said, values_of
from delfim.adoption.suited import along_n, hull_unfit, place_of
from delfim.adoption.writing import FoundKey
from delfim.vehicle.control.hull import craft

SPARE: Final = 1.1  # times the measured way to stop, that the fence reckons with
DECELERATION_MOST: Final = 10.0  # m/s2, of [fence]
STRAIGHT: Final = 0.01  # m/s, of a speed that a boat goes

MIDDLE_MOST_DEG: Final = 20.0  # of the file
SMOOTHED_DEG: Final = 3.0  # an estimator's headings tell of the compass no better than this
COMPASS: Final = "hard_ahead", "hard_aside", "soft_along", "soft_across", "compass_offset"
LEFT_DEG: Final = 0.5  # rms: what a file's own numbers may leave
ROUNDS, NUDGE = 12, 1e-6
UNDOING: Final = "nmea0183", "nmea2000"  # sources whose magnetic headings come through [compass]


class BoatFindings(NamedTuple):
    """All that was found."""

    keys: tuple[FoundKey, ...]
    figures: dict[str, Figure]
    changes: tuple[str, ...]  # in words: what is not as the file says
    unseen: tuple[str, ...]  # in words: what the record did not show, and why
    runs: ModelMotion  # in calm water, in lanes: as found, ..., as the file tells


def findings(fit: Fit, vehicle: config.Vehicle, *, is_raw: bool) -> BoatFindings:
    """What a fit says of the boat of this file. `is_raw`: the record had the sensors' own values."""
    runs = calm(fit)
    told = figures(fit, runs)
    keys = [*_thrusters(fit, vehicle), *_boat(fit, vehicle, told), *_fence(vehicle, told), *_twin(fit, vehicle)]
    if is_raw:
        keys += _antenna(fit, vehicle)
    if not hull_unfit(vehicle.thrusters):  # else leeway looks like a compass that is off
        keys += compass(fit, vehicle, 0.0 if is_raw else SMOOTHED_DEG)
    return BoatFindings(tuple(keys), told, tuple(changes(fit)), tuple(unseen(fit, told)), runs)


def _thrusters(fit: Fit, vehicle: config.Vehicle) -> list[FoundKey]:
    """Force, law, dead band and lateness of each motor. A row with a curve keeps it where the law was not seen."""
    p, found, mass_kg = fit.values, list[FoundKey](), craft(vehicle).mass_kg
    motors, gear = motors_of(vehicle), fit.windows.gear
    sides = ("starboard", 0.5, motors.starboard), ("port", -0.5, motors.port)
    alone = (("starboard", 0.0, motors.starboard),)
    for side, sign, motor, row in (
        (*its, vehicle.thrusters[at]) for its in (sides if gear is None else alone) for at in its[2].rows
    ):
        ahead_n = mass_kg * p["ahead"] * math.exp(sign * p["ahead_uneven"]) * _share(vehicle, motor, row)
        astern_n = ahead_n * p["astern"] * math.exp(sign * p["astern_uneven"])
        ends = (-astern_n, ahead_n) if place_of(row).way > 0 else (-ahead_n, astern_n)
        place, dead = ("thrusters", row.name), f"dead_{side}"
        keeps = bool(row.curve) and not {"ahead", "power", dead}.isdisjoint(fit.unseen)
        if row.curve and not keeps:
            found.append(FoundKey((*place, "curve"), (), None, row.curve))
        if not keeps and "ahead" not in fit.unseen:
            unsure = ahead_n * fit.relative("ahead")
            found.append(FoundKey((*place, "thrust_n"), (round(ends[0], 2), round(ends[1], 2)), unsure, row.thrust_n))
        rows = (
            ("power", "power", round(p["power"], 3), p["power"], row.power),
            ("dead", dead, round(p[dead], 3), 1.0, row.dead),
            ("delay_s", "delay", round(p["delay"], 3), 1.0, row.delay_s),
            ("lag_s", "lag", round(max(p["lag"], 0.01), 3), p["lag"], row.lag_s),
        )
        found += [
            FoundKey((*place, key), value, scale * fit.relative(name), told)
            for key, name, value, scale, told in rows
            if name not in fit.unseen and not (keeps and key in ("power", "dead"))
        ]
    for row, its in zip(vehicle.thrusters, fit.windows.rows, strict=False):
        if not its.side and not row.curve and not {"ahead", "across"} & set(fit.unseen):
            found += _across(fit, row, mass_kg, its.shares)
    if gear is not None and "straight" not in fit.unseen:
        found.append(_straight(fit, vehicle.thrusters[0]))
    return found


def _across(fit: Fit, row: config.ThrusterTable, mass_kg: float, shares: tuple[float, float]) -> Iterator[FoundKey]:
    """The force of a motor that pushes aside alone, with law, dead band and lateness of the others, by which it was found."""
    p, unsure = fit.values, fit.relative("ahead", "across")
    full_n = mass_kg * p["ahead"] * p["across"]
    ends = round(-full_n * shares[1], 2), round(full_n * shares[0], 2)
    dead = 0.5 * (p["dead_starboard"] + p["dead_port"])
    for key, value, spread in (
        ("thrust_n", ends, full_n * shares[0] * unsure),
        ("power", round(p["power"], 3), p["power"] * fit.relative("power")),
        ("dead", round(dead, 3), 0.5 * fit.relative("dead_starboard", "dead_port")),
        ("delay_s", round(p["delay"], 3), fit.relative("delay")),
        ("lag_s", round(max(p["lag"], 0.01), 3), p["lag"] * fit.relative("lag")),
    ):
        yield FoundKey(("thrusters", row.name, key), value, spread, getattr(row, key))


def _share(vehicle: config.Vehicle, motor: Motor, row: config.ThrusterTable) -> float:
    """The force of one row over that ahead of all that are commanded alike at its side, as the file has them: they are seen
    together alone."""
    if len(motor.rows) == 1:
        return 1.0
    return along_n(row) / abs(place_of(row).ahead) / sum(along_n(vehicle.thrusters[at]) for at in motor.rows)


def _straight(fit: Fit, row: config.ThrusterTable) -> FoundKey:
    """Where what turns the motor stands when it pushes straight, as its driver has it."""
    steer = row.steer
    assert steer is not None
    way, middle_rad, _ = steer.as_told
    middle_deg = max(-MIDDLE_MOST_DEG, min(MIDDLE_MOST_DEG, math.degrees(middle_rad + way * fit.values["straight"])))
    told = {**config.stated(steer), "middle_deg": round(middle_deg, 1)}
    return FoundKey(("thrusters", row.name, "steer"), told, math.degrees(fit.relative("straight")), config.stated(steer))


def _boat(fit: Fit, vehicle: config.Vehicle, told: dict[str, Figure]) -> list[FoundKey]:
    """Drag as the autopilot needs it, inertia, damping of a turn at cruising speed, and speeds that she makes."""
    p, boat, full = fit.values, vehicle.boat, told["full_mps"]
    linear, square = bollard_drag(fit, vehicle, told)
    inertia = inertia_kgm2(fit, vehicle)
    cruise_mps = min(vehicle.control.speed.cruise_mps, full.found)
    slow, quick = inertia * (p["yaw"] + p["yaw_ahead"] * cruise_mps), inertia * p["yaw2"]
    unsure = fit.relative("surge2") * square + fit.relative("surge") * linear
    turning = inertia * math.hypot(p["yaw"] * fit.relative("yaw"), p["yaw_ahead"] * cruise_mps * fit.relative("yaw_ahead"))
    found = [
        FoundKey(("boat", "drag_n_per_mps"), _round(linear), unsure, boat.drag_n_per_mps),
        FoundKey(("boat", "drag_n_per_mps2"), _round(square), unsure, boat.drag_n_per_mps2),
        FoundKey(("boat", "inertia_kgm2"), _round(inertia), inertia * fit.relative("arm"), boat.inertia_kgm2),
        FoundKey(("boat", "yaw_nm_per_radps"), _round(slow), turning, boat.yaw_nm_per_radps),
        FoundKey(("boat", "yaw_nm_per_radps2"), _round(quick), quick * fit.relative("yaw2"), boat.yaw_nm_per_radps2),
    ]
    if not full.is_beyond:
        found.append(FoundKey(("boat", "full_mps"), round(full.found, 2), full.spread, boat.full_mps))
        most_mps = 0.9 * full.found
        for key in ("cruise_mps", "max_mps"):
            asked_mps = getattr(vehicle.control.speed, key)
            if asked_mps > most_mps:
                found.append(FoundKey(("control", "speed", key), round(most_mps, 2), full.spread, asked_mps))
    return found


def inertia_kgm2(fit: Fit, vehicle: config.Vehicle) -> float:
    """The inertia of a turn with the water's, as the arms of the file's motors have it."""
    motors = motors_of(vehicle)
    arm_m = 0.5 * (motors.starboard.aside_m + motors.port.aside_m)
    return arm_m * craft(vehicle).mass_kg / fit.values["arm"]


def bollard_drag(fit: Fit, vehicle: config.Vehicle, known: dict[str, Figure]) -> tuple[float, float]:
    """(N per m/s, N per (m/s)2): the thrust at rest that the commands of steady speeds would give. It holds the thrust that is
    lost with way, too, as the autopilot's feed-forward needs it."""
    p, mass_kg = fit.values, craft(vehicle).mass_kg
    pairs = list[tuple[float, float]]()
    for part, name in ((0.25, "quarter_mps"), (0.5, "half_mps"), (0.75, "three_quarters_mps"), (1.0, "full_mps")):
        share = [max((part - p[dead]) / (1.0 - p[dead]), 0.0) ** p["power"] for dead in ("dead_starboard", "dead_port")]
        both = share[0] * math.exp(0.5 * p["ahead_uneven"]) + share[1] * math.exp(-0.5 * p["ahead_uneven"])
        if fit.windows.gear is not None:
            both = share[0]
        is_sure = known[name].spread <= TOO_WINDY * known[name].found or part == 0.5
        if is_sure and known[name].found > STRAIGHT and (part <= 0.5 or not known[name].is_beyond):
            pairs.append((known[name].found, mass_kg * p["ahead"] * both))
    speeds, forces = (np.array(each) for each in zip(*pairs, strict=True))
    if len(pairs) > 1:
        square, linear = (float(each) for each in np.polyfit(speeds, forces / speeds, 1))
        if square > 0.0 and linear > 0.0:
            return linear, square
        if square <= 0.0:
            return float((forces * speeds).sum() / (speeds**2).sum()), 0.0
    return 0.0, float((forces * speeds**2).sum() / (speeds**4).sum())


def _fence(vehicle: config.Vehicle, told: dict[str, Figure]) -> list[FoundKey]:
    """Reaction and deceleration whose line bounds the measured ways to stop. One that is extrapolated makes it no shorter."""
    limits = vehicle.fence
    speeds = [told[name].found for name in ("thirty_mps", "sixty_mps", "full_mps")]
    stops = [told[name] for name in ("stop_30_m", "stop_60_m", "stop_full_m")]
    ways = [SPARE * (each.found + each.spread) for each in stops]
    if any(each.is_beyond for each in stops):
        reckoned = [v * limits.reaction_s + v * v / (2.0 * limits.deceleration_mps2) for v in speeds]
        ways = [max(way, was) if stop.is_beyond else way for way, was, stop in zip(ways, reckoned, stops, strict=True)]
    reaction_s, deceleration = bound(speeds, ways)
    unsure = max(each.spread / max(v, STRAIGHT) for each, v in zip(stops, speeds, strict=True))
    return [
        FoundKey(("fence", "reaction_s"), reaction_s, unsure, limits.reaction_s),
        FoundKey(("fence", "deceleration_mps2"), deceleration, unsure * deceleration, limits.deceleration_mps2),
    ]


def bound(speeds: list[float], ways: list[float]) -> tuple[float, float]:
    """(reaction s, deceleration m/s2) of the line of the fence, way / speed = reaction + speed / (2 deceleration), that lies on
    or above all of these ways, and least so."""
    points = [(v, way / v) for v, way in zip(speeds, ways, strict=True) if v > STRAIGHT]
    least = 1.0 / (2.0 * DECELERATION_MOST)
    slopes = [least, *((y2 - y1) / (x2 - x1) for x1, y1 in points for x2, y2 in points if x2 - x1 > STRAIGHT)]
    best = (math.inf, 0.0, 0.0)
    for slope in (max(each, least) for each in slopes):
        reaction = max(0.0, *(y - slope * x for x, y in points))
        spare = sum(reaction + slope * x - y for x, y in points)
        best = min(best, (spare, reaction, slope))
    _, reaction, slope = best
    return math.ceil(100.0 * reaction) / 100.0, math.floor(1e4 / (2.0 * slope)) / 1e4


def _antenna(fit: Fit, vehicle: config.Vehicle) -> list[FoundKey]:
    """Where the antenna is and how late its receiver, for boats with an estimator."""
    if not vehicle.navigation.estimator:
        return []
    p, known = fit.values, vehicle.estimator
    rows = (
        ("antenna_forward_m", "antenna_ahead", known.antenna_forward_m),
        ("antenna_starboard_m", "antenna_aside", known.antenna_starboard_m),
        ("position_latency_s", "late", known.position_latency_s),
    )
    seen = [row for row in rows if row[1] not in fit.unseen]
    return [FoundKey(("estimator", key), round(p[name], 2), fit.relative(name), was) for key, name, was in seen]


def compass(fit: Fit, vehicle: config.Vehicle, least_deg: float) -> list[FoundKey]:
    """The five numbers of a magnetic compass, where all are seen, and what they still bend of the headings is more than this
    (rms). Where the file has some already, the fit sees what these leave, and both become one."""
    known, variation = vehicle.compass, _magnetic(vehicle)
    if set(COMPASS) & set(fit.unseen) or not variation:
        return []
    headings, at_rad = np.radians(np.arange(0.0, 360.0, 10.0)), math.radians(variation[0])
    left = said(values_of(fit.theta[None]), headings[None] + at_rad)[0] - at_rad  # the fit reckons with true headings
    if _rms_deg(left - headings) < (least_deg if known == config.CompassTable() else max(least_deg, LEFT_DEG)):
        return []
    had = (known.hard_ahead, known.hard_aside, known.soft_along, known.soft_across, math.radians(known.offset_deg))
    values = _magnet(headings, _said(np.array(had), left))
    values[-1] = math.degrees(values[-1])
    spreads = [fit.relative(name) for name in COMPASS]
    spreads[-1] = math.degrees(spreads[-1])
    keys = "hard_ahead", "hard_aside", "soft_along", "soft_across", "offset_deg"
    rows = zip(keys, values, spreads, strict=True)
    return [FoundKey(("compass", key), round(float(value), 4), spread, getattr(known, key)) for key, value, spread in rows]


def _magnet(headings: Array, told: Array) -> Array:
    """The five numbers of COMPASS, of the magnet that makes a compass tell these headings: Gauss and Newton."""
    numbers = np.array([0.0, 0.0, 0.0, 0.0, np.angle(np.exp(1j * (told - headings)).mean())])
    for _ in range(ROUNDS):
        off = _turned(_said(numbers, headings) - told)
        slopes = np.stack([_turned(_said(numbers + nudge, headings) - told) - off for nudge in NUDGE * np.eye(5)], 1) / NUDGE
        numbers = numbers - np.linalg.lstsq(slopes, off)[0]
    return numbers


def _said(numbers: Array, headings: Array) -> Array:
    return said(dict(zip(COMPASS, numbers, strict=True)), headings)


def _turned(angle: Array) -> Array:
    return np.asarray(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)


def _rms_deg(off: Array) -> float:
    return float(np.degrees(np.sqrt(np.mean(_turned(off) ** 2))))


def _magnetic(vehicle: config.Vehicle) -> list[float]:
    """The variation, degrees, of the file's first source whose magnetic headings the boat undoes the iron of."""
    return [vehicle.table(name).variation_deg for name in vehicle.navigation.sources if name in UNDOING]


def _twin(fit: Fit, vehicle: config.Vehicle) -> list[FoundKey]:
    """The hull for the simulator, which then sails this boat."""
    p, mass_kg, inertia = fit.values, craft(vehicle).mass_kg, inertia_kgm2(fit, vehicle)
    aside_kg = mass_kg / p["sway_turning"]
    values = {
        "mass_kg": (mass_kg, ()),
        "mass_aside_kg": (aside_kg, ("sway_turning",)),
        "mass_turning_kg": (p["surge_turning"] * mass_kg, ("surge_turning",)),
        "inertia_kgm2": (inertia, ("arm",)),
        "surge_n_per_mps": (p["surge"] * mass_kg, ("surge",)),
        "surge_n_per_mps2": (p["surge2"] * mass_kg, ("surge2",)),
        "sway_n_per_mps": (p["sway"] * aside_kg, ("sway",)),
        "sway_n_per_mps2": (p["sway2"] * aside_kg, ("sway2",)),
        "sway_ahead_n_per_mps2": (p["sway_ahead"] * aside_kg, ("sway_ahead",)),
        "yaw_nm_per_radps": (p["yaw"] * inertia, ("yaw",)),
        "yaw_nm_per_radps2": (p["yaw2"] * inertia, ("yaw2",)),
        "yaw_ahead_nm_s_per_m": (p["yaw_ahead"] * inertia, ("yaw_ahead",)),
    }
    hull = {name: (value, value * fit.relative(*factors) if factors else 0.0) for name, (value, factors) in values.items()}
    hull["sway_yaw_n_per_radps"] = p["sway_yaw"] * aside_kg, fit.relative("sway_yaw") * aside_kg
    hull["munk_nm_per_mps2"] = p["munk"] * inertia, fit.relative("munk") * inertia
    hull["thrust_loss_s_per_m"] = p["loss"], fit.relative("loss")
    known = vehicle.table("simulation").hull
    return [
        FoundKey(("simulation", "hull", name), _round(value), spread or None, getattr(known, name) if known.mass_kg else None)
        for name, (value, spread) in hull.items()
    ]


def _round(value: float) -> float:
    return float(f"{value:.4g}")
