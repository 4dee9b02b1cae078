"""The gains of a boat whose hull was found: each candidate sails the twin by the boat's own program, in lock step, and so do
the gains that the boat has. What limits small boats is what their motors give, so margins alone choose badly: they are
reckoned for the winner, and one that is below the limits gives way to the next.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import islice, product
from typing import Any, Final, NamedTuple

import msgspec

from delfim import config
from delfim.adoption.suited import place_of
from delfim.adoption.twin.margins import Loop, Margins
from delfim.adoption.twin.twinvoyage import TwinVoyage, sailed, twin_of
from delfim.adoption.writing import FoundKey, Key
from delfim.base.errors import DelfimError
from delfim.base.input.untrusted import parse_toml
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.measured import model_of
from delfim.simulator.tables import Sea, SimulatedHull, Simulation
from delfim.vehicle.control.hull import AGE_S, LAG_S, Gains, craft, gains
from delfim.vehicle.state import NoLog

NATURALS: Final = (  # rad/s, of the heading, the quickest first
    *(1.4, 1.25, 1.1, 0.98, 0.87, 0.77, 0.69, 0.61, 0.54, 0.48, 0.42, 0.36, 0.3),
)
DAMPED: Final = 1.0, 0.8  # of critical
COUNTS: Final = 0.8  # of the water's damping: less is no surprise
OWN: Final = 0.15  # of the heading's damping is the autopilot's, at least
SAILED: Final = 12  # of these loops, at most
TOLD_EACH: Final = 5
LOOKS_S: Final = 2.5, 4.0, 7.0  # of way at cruising speed, that the path is looked ahead
SAILS: Final = (  # of each candidate: how many times the delay that was found, and the wind, m/s and from where, deg
    *((1.0, 2.0, 300.0), (1.4, 4.0, 210.0)),
)
SEED: Final = 1
AUTHORITIES: Final = 1.5, 0.75  # of the most yaw moment: a heading error asks for no more, damping takes from it ...
SPIN: Final = 0.85  # ... and for no more than this part of the rate of a spin ...
SPIN_MOST_RADPS: Final = 0.5  # ... nor for this: a compass that is not quite right seems to jump in a quicker one
TURN_RADPS, TURN_RADPS2 = 0.35, 0.35  # of a turn to a new heading, at most ...
OF_THE_TURN, OF_THE_CHANGE = 0.6, 0.5  # ... and what they may take of the most yaw moment: the rest is for wind
GROWS: Final = 1.0, 0.7, 0.4, 0.0  # of how the water's damping grows with the way, that the gains grow with it
CRUISE, MOST, COMING_BACK = 0.65, 0.85, 0.6  # of full speed
RAMP_MPS2: Final = 0.4
SPEED_PER_S: Final = 0.8  # of the speed's loop, at most
SPEED_STEP: Final = 0.98  # from one loop that is tried to the next: boats that are nearly alike get gains that are
SPEED_MARGINS: Final = 60.0, 3.0  # with 30 % more delay
SPEED_AGE_S: Final = 0.35  # of velocity, when it is used
POSITIONS: Final = 2.5  # deviations of the receiver, that hold does not answer
HOLD_LEAST_M, RUN_IN_LEAST_M = 1.5, 3.0
AT_REST, AT_CRUISE = (30.0, 2.0), (45.0, 2.0)  # least phase margin, deg, and gain margin
LEAST_WORDS: Final = (
    f"{AT_REST[0]:.0f} deg and {AT_REST[1]:.1f} at rest, {AT_CRUISE[0]:.0f} deg and {AT_CRUISE[1]:.1f} at speed"
)
FIGURES: Final = (  # of a voyage of the twin, for people
    *("beyond a new heading, deg", "until a turn of 90 deg is settled, s", "off the lines, rms, m"),
    *("from the point that she holds, rms, m", "travel of the motors, full commands a second"),
)
TURNING_RADPS: Final = 0.1  # of a turn at cruising speed
STEADY_S: Final = 60.0  # until a speed is steady
DRIFT_ROUNDS, LEAST_DRAG = 60, 1e-3  # until a drift is steady
HEADING: Final = Gains._fields[:6]
TURN: Final = "turn_dps", "turn_dps2"
AHEAD: Final = "control", "heading", "ahead_per_mps"
SPEED: Final = Gains._fields[6:]

Keys = dict[Key, Any]
Tell = Callable[[str], object]


class TwinHull(NamedTuple):
    """What gains follow from: the twin in numbers, SI units."""

    its: SimulatedHull
    length_m: float
    turn_nm: float
    ahead_n: float
    delay_s: float
    lag_s: float
    full_mps: float
    spin_radps: float
    cruise_mps: float
    period_s: float  # of navigation

    def damping(self, ahead_mps: float, turn_radps: float) -> float:
        """Against a small change of a rate of turn, N m per rad/s."""
        its = self.its
        return its.yaw_nm_per_radps + its.yaw_ahead_nm_s_per_m * ahead_mps + 2.0 * its.yaw_nm_per_radps2 * turn_radps

    def steady_damping(self, turn_radps: float) -> float:
        """Against a steady turn at cruising speed, with the drift that it makes, N m per rad/s."""
        its, u, v = self.its, self.cruise_mps, 0.0
        for _ in range(DRIFT_ROUNDS):
            drag = its.sway_n_per_mps + its.sway_n_per_mps2 * abs(v) + its.sway_ahead_n_per_mps2 * u
            v = 0.5 * (v - (its.mass_kg * u + its.sway_yaw_n_per_radps) * turn_radps / max(drag, LEAST_DRAG))
        slow = self.damping(u, 0.5 * turn_radps) + its.munk_nm_per_mps2 * u * v / turn_radps
        return max(slow, its.yaw_nm_per_radps)

    def both(self, keys: Mapping[Key, Any]) -> tuple[Margins, Margins]:
        """Margins of the heading's loop with these gains: at rest, and turning at cruising speed."""
        p, _, d, _, i, _ = (keys["control", "heading", name] for name in HEADING)
        loop = Loop(p, i, d, self.its.inertia_kgm2, 0.0, self.lag_s, self.delay_s + 0.5 * self.period_s + AGE_S, 2)
        at_rest, at_cruise = self.damping(0.0, 0.0), self.damping(self.cruise_mps, TURNING_RADPS)
        more = 1.0 + keys.get(AHEAD, 0.0) * self.cruise_mps
        return loop._replace(damping=at_rest).margins, loop._replace(p=more * p, i=more * i, damping=at_cruise).margins


class GainCandidate(NamedTuple):
    """Keys of the vehicle's file that are tried, and what came of it."""

    name: str
    keys: Keys
    voyages: tuple[TwinVoyage, ...]  # of SAILS
    at_rest: Margins
    at_cruise: Margins

    @property
    def cost(self) -> float:
        return sum(each.cost for each in self.voyages) / len(self.voyages)

    @property
    def is_steady(self) -> bool:
        """Whether its margins are the least ones or more."""
        return self.at_rest.holds(AT_REST) and self.at_cruise.holds(AT_CRUISE)

    @property
    def words(self) -> str:
        return (
            f"margins at rest {self.at_rest.phase_deg:.0f} deg and {self.at_rest.gain:.1f}, "
            f"at cruising speed {self.at_cruise.phase_deg:.0f} deg and {self.at_cruise.gain:.1f}"
        )


class ChosenGains(NamedTuple):
    """What came of all of it."""

    best: GainCandidate
    today: GainCandidate  # with the heading's gains that the boat has
    tried: tuple[GainCandidate, ...]  # the best first
    keys: tuple[FoundKey, ...]  # for the vehicle's file


def chosen(was: config.Vehicle, vehicle: config.Vehicle, position_m: float, tell: Tell = lambda words: None) -> ChosenGains:
    """Choose the gains of a boat. `was` is the file that the boat has, `vehicle` the same with what was found; `position_m` the
    deviation of its receiver. Takes about ten seconds of a processor. Raises DelfimError where the file has no twin."""
    hull, tried = twin_hull(vehicle), list[GainCandidate]()
    common = _common(vehicle, hull, position_m)
    table = was.control.heading
    todays = {("control", "heading", name): getattr(table, name) for name in (AHEAD[2], *TURN)}
    derived = _heading(gains(_bare(vehicle), craft(vehicle)))
    headings = {"today's": _heading(gains(was, craft(was))) | todays, "by the hull": derived | _turning(hull, derived)}
    headings |= dict(islice(_steady(hull), SAILED))

    def judge(name: str, keys: Keys) -> None:
        tried.append(judged(vehicle, hull, name, keys))
        if len(tried) % TOLD_EACH == 0:
            tell(f"Gains on the twin: {len(tried)} of about {len(headings) + len(LOOKS_S)} sailed.")

    for name, keys in headings.items():
        judge(name, common | keys)
    ahead = _ranked(tried)[0]
    looks_m = {round(max(1.5 * hull.length_m, look_s * hull.cruise_mps, 2.0), 1) for look_s in LOOKS_S}
    for look_m in sorted(looks_m - {vehicle.control.path.lookahead_m}):
        judge(f"{ahead.name}, looks {look_m:g} m ahead", ahead.keys | {("control", "path", "lookahead_m"): look_m})
    ranked = _ranked(tried)
    return ChosenGains(ranked[0], tried[0], tuple(ranked), tuple(_found(ranked[0], vehicle)))


def chosen_of(was: str, text: str, file: str, position_m: float, tell: Tell) -> ChosenGains:
    """The same for the texts of a vehicle's file before and with what was found: for another process."""
    return chosen(config.read(parse_toml(was), file), config.read(parse_toml(text), file), position_m, tell)


def told(result: ChosenGains) -> Iterator[str]:
    """What was chosen, in lines for a terminal."""
    best, today = result.best, result.today
    yield f"gains: {best.name}; {best.words}"
    if not best.is_steady:
        yield f"no gains have the margins of {LEAST_WORDS}: these come nearest"
    for words, had, has in zip(FIGURES, voyage_figures(today), voyage_figures(best), strict=True):
        yield f"{words:44}{has:9.2f}{'':9}{had:11.2f} by today's gains"


def voyage_figures(tried: GainCandidate) -> tuple[float, ...]:
    """The figures of FIGURES, with the delay that was found."""
    its = tried.voyages[0]
    return its.over_deg, its.quarter.settled_s, its.path_m, its.hold_m, its.travel_per_s


def twin_hull(vehicle: config.Vehicle) -> TwinHull:
    """What the gains of this file follow from. Raises DelfimError where it has no twin."""
    its, rows = vehicle.of(Simulation).hull, vehicle.thrusters
    if not its.mass_kg:
        raise DelfimError("gains follow from [simulation.hull], which this file has not")
    boat, model = craft(vehicle), model_of(twin_of(vehicle, Sea()), SEED)
    ways = [float(place_of(row).way) for row in rows]
    for row, way in zip(rows, ways, strict=True):
        model.push(row.name, way)
    model.advance(STEADY_S)
    full_mps = model.surge_mps
    for row, way in zip(rows, ways, strict=True):
        if row.steer is not None:
            model.push(row.name, 0.9, math.radians(row.steer.angle_max_deg))
        else:
            model.push(row.name, -0.9 * way * place_of(row).side)
    model.advance(STEADY_S)
    cruise_mps = round(min(vehicle.control.speed.cruise_mps, CRUISE * full_mps), 2)
    lags = [row.lag_s for row in rows if row.lag_s is not None]
    delay_s, lag_s = sum(row.delay_s for row in rows) / len(rows), sum(lags) / len(lags) if lags else LAG_S
    return TwinHull(
        *(its, vehicle.boat.length_m, boat.turn_nm, boat.ahead_n, delay_s, lag_s, full_mps, abs(model.yaw_rate_radps)),
        *(cruise_mps, 1.0 / vehicle.navigation.rate_hz),
    )


def judged(vehicle: config.Vehicle, hull: TwinHull, name: str, keys: Keys) -> GainCandidate:
    """Sail the twin with these keys in each of SAILS."""
    current, voyages = {"current_mps": 0.2 * min(hull.cruise_mps, 1.0), "current_to_deg": 65.0}, list[TwinVoyage]()
    changed = with_keys(vehicle, keys)
    for later, wind_mps, from_deg in SAILS:
        sea = Sea(wind_mps=wind_mps, wind_from_deg=from_deg, **current)
        run = Lockstep(twin_of(changed, sea, later), SEED, lambda clock: NoLog())
        voyages.append(sailed(run, hull.cruise_mps))
    return GainCandidate(name, keys, tuple(voyages), *hull.both(keys))


def with_keys(vehicle: config.Vehicle, keys: Mapping[Key, Any]) -> config.Vehicle:
    """The vehicle's file with these keys of [control]."""
    replace, control = msgspec.structs.replace, vehicle.control
    tables = dict[str, dict[str, Any]]()
    for (room, table, name), value in keys.items():
        assert room == "control"
        tables.setdefault(table, {})[name] = value
    for table, its in tables.items():
        control = replace(control, **{table: replace(getattr(control, table), **its)})
    return replace(vehicle, control=control)


def _ranked(tried: list[GainCandidate]) -> list[GainCandidate]:
    """The best first: those with the margins, by their cost; then the others, by their margins."""
    return sorted(tried, key=lambda each: (not each.is_steady, each.cost if each.is_steady else -_least(each)))


def _least(tried: GainCandidate) -> float:
    """The least margin, as a part of its limit."""
    pairs = (tried.at_rest, AT_REST), (tried.at_cruise, AT_CRUISE)
    return min(min(had.phase_deg / least[0], had.gain / least[1]) for had, least in pairs)


def _bare(vehicle: config.Vehicle) -> config.Vehicle:
    """The file without gains: they follow from the hull."""
    replace, control = msgspec.structs.replace, vehicle.control
    speed = replace(control.speed, **dict.fromkeys(SPEED))
    return replace(vehicle, control=replace(control, heading=config.HeadingTable(), speed=speed))


def _heading(its: Gains) -> Keys:
    return {("control", "heading", name): _round(getattr(its, name)) for name in HEADING}


def _steady(hull: TwinHull) -> Iterator[tuple[str, Keys]]:
    """Heading loops with the margins, the quickest first: some damped enough with the water's damping at rest, some at
    speed."""
    inertia, keeps_nm = hull.its.inertia_kgm2, hull.damping(hull.cruise_mps, TURNING_RADPS)
    turn_radps, seen = min(SPIN_MOST_RADPS, SPIN * hull.spin_radps), list[Keys]()
    for natural, damped, where, most in product(NATURALS, DAMPED, ("at rest", "at speed"), AUTHORITIES):
        p, total = natural**2 * inertia, 2.0 * damped * natural * inertia
        d = max(total - COUNTS * (hull.damping(0.0, 0.0) if where == "at rest" else keeps_nm), OWN * total)
        turns_nm = (hull.damping(0.3 * hull.cruise_mps, 0.5 * turn_radps) + d) * turn_radps
        limit = min(max(turns_nm, 0.3 * hull.turn_nm), most * hull.turn_nm, max(1.2 * p, 0.1 * hull.turn_nm))
        keys = _heading(Gains(p, limit, d, keeps_nm, p * natural / 8.0, 0.3 * hull.turn_nm, 0.0, 0.0, 0.0))
        keys |= _turning(hull, keys)
        if keys not in seen and all(had.holds(least) for had, least in zip(hull.both(keys), (AT_REST, AT_CRUISE), strict=True)):
            seen.append(keys)
            yield (
                f"{natural:g} rad/s, damped {damped:g} {where}, limit {keys['control', 'heading', 'p_limit_nm']:.3g} N m",
                keys,
            )


def _turning(hull: TwinHull, keys: Keys) -> Keys:
    """How these gains grow with the way, and how a turn to a new heading goes that the motors can give."""
    at_rest = hull.damping(0.0, 0.0)
    grows = (hull.damping(hull.cruise_mps, TURNING_RADPS) - at_rest) / (at_rest + keys["control", "heading", HEADING[2]])
    radps = min(TURN_RADPS, SPIN * hull.spin_radps, OF_THE_TURN * hull.turn_nm / hull.steady_damping(TURN_RADPS))
    found: Keys = {
        AHEAD: 0.0,
        ("control", "heading", HEADING[3]): _round(hull.steady_damping(radps)),
        ("control", "heading", TURN[0]): _round(math.degrees(radps)),
        ("control", "heading", TURN[1]): _round(
            math.degrees(min(TURN_RADPS2, OF_THE_CHANGE * hull.turn_nm / hull.its.inertia_kgm2))
        ),
    }
    for part in GROWS:
        found[AHEAD] = _round(part * grows / hull.cruise_mps)
        if hull.both(keys | found)[1].holds(AT_CRUISE):
            break
    return found


def _common(vehicle: config.Vehicle, hull: TwinHull, position_m: float) -> Keys:
    """What does not need a voyage: speed, ramp, hold, acceptance."""
    its, control = hull.its, vehicle.control
    drag = its.surge_n_per_mps + its.surge_n_per_mps2 * hull.cruise_mps
    natural, dead_s = SPEED_PER_S, 1.3 * (hull.delay_s + SPEED_AGE_S)
    while natural > 0.05:
        p, i = natural * its.mass_kg, 0.2 * natural**2 * its.mass_kg
        if Loop(p, i, 0.0, its.mass_kg, drag, hull.lag_s, dead_s, 1).margins.holds(SPEED_MARGINS):
            break
        natural *= SPEED_STEP
    ramp = min(RAMP_MPS2, control.speed.ramp_mps2, 0.5 * hull.ahead_n / its.mass_kg)
    near_m = max(HOLD_LEAST_M, POSITIONS * position_m)
    turn_m = hull.cruise_mps / min(SPIN_MOST_RADPS, SPIN * hull.spin_radps)
    found = {
        ("speed", "p_n_per_mps"): p,
        ("speed", "i_n_per_m"): i,
        ("speed", "i_limit_n"): 0.5 * hull.ahead_n,
        ("speed", "ramp_mps2"): max(ramp, 0.01),
        ("speed", "cruise_mps"): hull.cruise_mps,
        ("speed", "max_mps"): round(max(min(control.speed.max_mps, MOST * hull.full_mps), hull.cruise_mps), 2),
        ("hold", "radius_m"): round(max(near_m, hull.length_m), 1),
        ("hold", "speed_mps"): round(min(control.hold.speed_mps, COMING_BACK * hull.full_mps), 2),
        ("home", "speed_mps"): min(control.home.speed_mps, hull.cruise_mps),
        ("path", "acceptance_m"): round(max(near_m, 0.5 * hull.length_m, turn_m), 1),
    }
    return {("control", *key): _round(value) for key, value in found.items()}


def _found(best: GainCandidate, vehicle: config.Vehicle) -> list[FoundKey]:
    """The keys for the file, with what surveys reckon with."""
    keys = [
        FoundKey(key, value, None, getattr(getattr(vehicle.control, key[1]), key[2]))
        for key, value in best.keys.items()
        if getattr(getattr(vehicle.control, key[1]), key[2]) != value
    ]
    known, voyage = vehicle.adopted, best.voyages[0]
    turn_s, run_in_m = round(voyage.turn_s, 1), round(max(voyage.run_in_m, RUN_IN_LEAST_M), 1)
    keys.append(FoundKey(("adopted", "turn_s"), turn_s, None, known.turn_s))
    keys.append(FoundKey(("adopted", "run_in_m"), run_in_m, None, known.run_in_m))
    return keys


def _round(value: float) -> float:
    return float(f"{value:.4g}")
