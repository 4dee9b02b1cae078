"""Collision avoidance: chooses the course and speed that keep the boat clear of other vessels, by the rules, as near to its
route as can be.

Trial manoeuvres, a reduced form of scenario-based model predictive control (T. A. Johansen, T. Perez, A. Cristofaro, IEEE
Trans. Intelligent Transportation Systems 17(12), 2016; I. B. Hagen et al., ICRA 2018): going on along the route, and a few
other courses at a few speeds, are laid ahead as straight legs; other vessels keep course and speed; the cheapest trial wins.
Nothing is stepped through time: how near a leg comes to a vessel's elliptical domain has a closed form (`cpa.py`). Distances
follow from times and from the other vessel's length, so that boats of all sizes have the same settings.

`decide` is a pure function that raises nothing and takes a bounded time: memory goes in and comes out. `deciding` is the
same in slices, for a callback that has less time than that. docs/traffic.md has the rules and the limits.
"""

import math
from collections.abc import Sequence
from heapq import nsmallest
from itertools import chain
from typing import Final, NamedTuple

from delfim.base.cooperative import Sliced, Work
from delfim.base.geodesy import wrap
from delfim.base.vessels import THINGS
from delfim.parts.traffic.cpa import Approach, Domain, Leg, approach, domain, passing_by
from delfim.parts.traffic.encounter import PRIVILEGED, Duty, Own, duty, passing, stands_on, words
from delfim.parts.traffic.shoreline import Shoreline
from delfim.parts.traffic.trialways import LOOK_MAX_S, Caution, RouteAhead, clear_m, core, route_legs, trial_legs
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.target import CourseOrder, Target

MOST: Final = 12  # vessels that are judged: those that could be met first
PASS: Final = 2  # comparisons that how one way passes one vessel costs
OFFSETS_DEG: Final = 30, -30, 45, -45, 60, -60, 75, -75, 90, -90, 120, -120, 150, -150, 180
OFFSETS: Final = tuple(map(math.radians, OFFSETS_DEG))  # of courses to try, from the route; to port where negative
PARTS: Final = (1.0, 0.5)  # of the speed that is asked for
TRIALS: Final = tuple((offset, part) for offset in OFFSETS for part in PARTS)
# Half axes of the domain in lengths of the vessel (Y. Fujii, K. Tanaka, J. Navigation 1971).
AHEAD_LENGTHS, ABEAM_LENGTHS = 4.0, 1.6
AHEAD_MIN_M, ABEAM_MIN_M = 50.0, 30.0
SOFT: Final = 1.3  # so many domains are better than one
AMPLE: Final = 4.0  # times that leaving the domain abeam takes: ample time (rule 8 a)
LATE, LATE_S = 1.8, 40.0  # the same, and seconds: a vessel that ought to give way has not (rule 17 a ii)
ESCAPE_S: Final = 30.0  # by then the boat has had time to get out
STATIC_S: Final = 90.0  # so long a way must be clear of the fence
CHANGE, STEADY = 6.0, 0.15  # another course must be better than the one steered by so much, and by this part
LEAVE: Final = 5.0  # the route is not left for less
HELD_S: Final = 30.0  # an order that leads into nothing stands for so long: others must see what the boat does (rule 8 b)
FROM_STARBOARD: Final = ("head-on", "give-way")  # vessels for which the boat does not turn to port (rules 14 and 15)
AGAINST_RULE, TO_PORT = 60.0, 40.0
STARBOARD, PORT, SLOWER = 10.0, 13.0, 12.0  # a right angle to either side; a stop
INSIDE, DEEP, NEAR = 100.0, 900.0, 15.0  # entering the domain, its middle, and the edge of what is soft
THINGS_MOST, THING_S = 12, 60.0  # things that trials are judged by, and for how long ahead
HALF, STRUCK = 0.5, 30000.0  # nearer than so, each domain costs so much more: any domains are better than one collision
ASHORE: Final = 1e6  # no vessel is a reason to cross the fence, nor are MOST of them together
FARTHEST: Final = 2.5  # domains: beyond, a vessel costs nothing
SLOWEST_MPS: Final = 0.3  # a slower boat counts as this fast
PLAUSIBLE_M, PLAUSIBLE_MPS, LONGEST_M = 1e6, 100.0, 1000.0

_new = tuple.__new__  # a third of the time of Seen(...): a decision makes some hundred tuples


class PassedBy(NamedTuple):
    """The passage of a vessel by the boat, within twice the time looked ahead."""

    key: str
    without: Approach  # if it goes on along its route
    nearness: float  # as it does now


class Choice(NamedTuple):
    """The winning trial."""

    course_rad: float
    part: float  # of the speed that is asked for
    is_last: bool  # to port where that is not allowed: all else leads into a domain
    is_ashore: bool = False  # a stop: all else leads over the fence


class Memory(NamedTuple):
    order: CourseOrder | None = None
    choice: Choice | None = None  # of the order
    since_s: float = 0.0  # when it was made
    left_s: float = 0.0  # when the route was left; 0: it is clear
    duties: tuple[tuple[str, Duty], ...] = ()  # not judged again while the vessel is in question


class Decision(NamedTuple):
    memory: Memory
    order: CourseOrder | None  # None: the boat goes on along its route
    passes: tuple[PassedBy, ...]  # of the vessels in question


class WideBerth(NamedTuple):
    """A vessel's domain and what follows from its size."""

    around: Domain
    look_s: float
    late_s: float
    far_m: float  # from its domain at most


class Seen(NamedTuple):
    """A vessel that is judged."""

    target: Target
    around: Domain
    look_s: float
    late_s: float
    without: Approach  # if the boat goes on along its route
    duty: Duty | None  # None: not in question
    rule: str  # what is penalised: "ahead", "port", "starboard"; empty: nothing


BEHIND: Final = Approach(math.inf, math.inf, 0.0, 0.0)  # of a thing if the boat goes on along its route


class Scene(NamedTuple):
    """The data that all trials are judged by."""

    seen: Sequence[Seen]
    shore: Shoreline | None
    weary: float  # a deviation is dearer the longer the boat is away: nobody runs along with a ship for ever
    has_vessels: bool  # among those seen, not things alone: the route leads past these already


def decide(
    limits: Caution, memory: Memory, own: Own, route: RouteAhead, targets: Sequence[Target], around: Fence | None, now_s: float
) -> Decision:
    """Make one decision, at once."""
    return Sliced(deciding(limits, memory, own, route, targets, around, now_s)).finish()


def deciding(
    limits: Caution,
    memory: Memory,
    own: Own,
    route: RouteAhead,
    targets: Sequence[Target],
    around: Fence | None,
    now_s: float,
    things: Sequence[Target] = (),
) -> Work[Decision]:
    """Make one decision, once a second. Never raises; input that is not finite counts as not there. `things`: that stand, the
    nearest first. The route leads past them already; other courses must, too."""
    if not (plausible(*own, *chain.from_iterable(route.points)) and 0.0 <= route.speed_mps < PLAUSIBLE_MPS):
        return Decision(Memory(), None, ())
    on = route_legs(own, route)
    ahead_rad = own.course_rad
    if route.points:
        ahead_rad = math.atan2(route.points[0][1] - own.east_m, route.points[0][0] - own.north_m)
    seen = yield from _in_question(limits, memory, own, ahead_rad, route.speed_mps, targets, on)
    was, is_away = memory.choice, memory.order is not None
    shore = Shoreline(around, own, max(route.speed_mps, own.speed_mps) * STATIC_S) if around is not None else None
    # Who has to give way is left time to do so, unless the boat is under way for another vessel already.
    mine = seen if is_away else [each for each in seen if not _waits(limits, each, on)]
    judged = Scene(mine, shore if route.has_end or mine or is_away else None, 1.0, bool(mine))
    is_under_way = own.speed_mps >= SLOWEST_MPS  # otherwise the boat may turn to anywhere yet
    duties = tuple((each.target.key, each.duty) for each in seen if each.duty is not None and is_under_way)
    # The route is left for what is near, and taken again when it is clear for twice as long.
    if _cost(judged, on, 0.0, 1.0, 2.0 if is_away else 1.0, math.inf, is_route=True) <= (0.0 if is_away else LEAVE):
        return Decision(Memory(duties=duties), None, _passes(seen, on, on))
    left_s, has_vessels = memory.left_s or now_s, bool(seen)
    if things:
        seen = [*seen, *_standing(limits, own, max(route.speed_mps, own.speed_mps), things)]
    scene = Scene(seen, shore, 1.0 + max(now_s - left_s, 0.0) / limits.look_s, has_vessels)
    best = was if now_s - memory.since_s < HELD_S else None
    if best is None or _leads_in(scene, _tried(limits, own, best, route)):
        best = yield from _cheapest(limits, scene, own, ahead_rad, route, on, was)
    if best is None:
        return Decision(Memory(left_s=left_s, duties=duties), None, _passes(seen, on, on))
    legs = _tried(limits, own, best, route)
    passes = _passes(seen, on, legs)
    order = _ordered(scene, best, route.speed_mps, on, legs, passes, memory.order, now_s)
    return Decision(Memory(order, best, memory.since_s if best == was else now_s, left_s, duties), order, passes)


def plausible(*values: float) -> bool:
    """Whether positions, courses and speeds are numbers that make sense."""
    for value in values:  # noqa: SIM110 - a generator costs three times as much
        if not -PLAUSIBLE_M < value < PLAUSIBLE_M:
            return False
    return True


def _in_question(
    limits: Caution,
    memory: Memory,
    own: Own,
    ahead_rad: float,
    speed_mps: float,
    targets: Sequence[Target],
    on: Sequence[Leg],
) -> Work[list[Seen]]:
    """The vessels to judge, the first to meet first, each with what the boat owes it."""
    near, (north_m, east_m, _, own_mps) = list[tuple[float, int, Target]](), own
    for number, target in enumerate(targets):
        yield 1
        its_mps, length_m = target.speed_mps, target.length_m
        far_m = math.hypot(target.north_m - north_m, target.east_m - east_m) - AHEAD_LENGTHS * length_m
        if 0.0 <= its_mps < PLAUSIBLE_MPS and 0.0 <= length_m < LONGEST_M and far_m < PLAUSIBLE_M:
            near.append((far_m / (its_mps + own_mps + SLOWEST_MPS), number, target))
    known, seen = dict(memory.duties), list[Seen]()
    for _, _, target in nsmallest(MOST, near):
        if not -PLAUSIBLE_M < target.course_rad < PLAUSIBLE_M:
            continue
        yield PASS
        around, look_s, late_s, far_m = measured(limits, own, speed_mps, target)
        without, owed = approach(around, on, 2.0 * look_s), known.get(target.key)
        if without.nearness >= SOFT:
            if far_m > look_s * (target.speed_mps + own_mps):
                continue  # even if both went for each other
        elif owed is None:
            owed = duty(own if own_mps >= SLOWEST_MPS else Own(north_m, east_m, ahead_rad, speed_mps), target)
        seen.append(_new(Seen, (target, around, look_s, late_s, without, owed, _rule(owed, target))))
    return seen


def _standing(limits: Caution, own: Own, speed_mps: float, things: Sequence[Target]) -> list[Seen]:
    """The things that the boat can reach within THING_S, for trials; a route was made for them."""
    found, reach_m = list[Seen](), THING_S * speed_mps
    for each in things[:THINGS_MOST]:
        around, _, late_s, _ = measured(limits, own, speed_mps, each)
        if math.hypot(each.north_m - own.north_m, each.east_m - own.east_m) < reach_m + 1.0 / math.hypot(*around[4:6]):
            found.append(_new(Seen, (each, around, THING_S, late_s, BEHIND, None, "")))
    return found


def measured(limits: Caution, own: Own, speed_mps: float, target: Target) -> WideBerth:
    """The domain of a vessel, and how long it matters."""
    length_m, margin_m, least_s = target.length_m, target.margin_m, limits.look_s
    more_m = (margin_m if 0.0 < margin_m < PLAUSIBLE_M else 0.0) + limits.length_m / 2.0
    ahead_m = max(AHEAD_LENGTHS * length_m, AHEAD_MIN_M) + more_m
    abeam_m = max(ABEAM_LENGTHS * length_m, ABEAM_MIN_M) + more_m
    if target.kind in THINGS:
        ahead_m = abeam_m = core(limits, target) + clear_m(limits, target.kind)
        least_s = 0.0
    out_s = abeam_m / max(speed_mps, SLOWEST_MPS)
    far_m = math.hypot(target.north_m - own.north_m, target.east_m - own.east_m) - 1.5 * ahead_m
    look_s = min(max(AMPLE * out_s, least_s), max(LOOK_MAX_S, least_s))
    return _new(WideBerth, (domain(target, ahead_m, abeam_m), look_s, LATE * out_s + LATE_S, far_m))


def _rule(owed: Duty | None, target: Target) -> str:
    if owed == "head-on":
        return "starboard"
    if owed == "stand-on" and target.status not in PRIVILEGED:
        return "port"
    if target.speed_mps <= 0.5 or owed not in ("give-way", "stand-on"):
        return ""
    return "ahead"


def _waits(limits: Caution, this: Seen, on: Sequence[Leg]) -> bool:
    """Whether the boat stands on for this vessel: there is time yet for it to give way (rule 17 a)."""
    if this.duty is None or not stands_on(this.duty, this.target, limits.stand_on):
        return False
    return approach(this.around, on, this.look_s).at_s > this.late_s


def _cheapest(
    limits: Caution, scene: Scene, own: Own, ahead_rad: float, route: RouteAhead, on: Sequence[Leg], was: Choice | None
) -> Work[Choice | None]:
    """The best trial; None: to go on along the route. To port for a vessel head-on or from starboard only if all else leads
    into a domain; but a course to port that is steered already may be kept."""
    lowest, best, extra = _cost(scene, on, 0.0, 1.0, 2.0, math.inf, is_route=True), None, CHANGE
    last, chosen, costs = list[Choice](), on, PASS * (1 + len(scene.seen))
    if any(each.duty in FROM_STARBOARD and each.without.nearness < SOFT for each in scene.seen):
        trials = [_new(Choice, (ahead_rad + offset, part, False, False)) for offset, part in TRIALS if offset > 0.0]
        last = [_new(Choice, (ahead_rad + offset, part, True, False)) for offset, part in TRIALS if offset < 0.0]
    else:
        trials = [_new(Choice, (ahead_rad + offset, part, False, False)) for offset, part in TRIALS]
    trials += [_new(Choice, (ahead_rad, part, False, False)) for part in (0.5, 0.0)]
    if was is not None:
        trials.insert(0, was)
        lowest, extra = lowest + CHANGE, 0.0
    for each in chain(trials, last):
        if last and each is last[0] and not _leads_in(scene, chosen):
            break
        yield costs
        turn_rad, enough = wrap(each.course_rad - ahead_rad), lowest - extra
        if _deviation(scene, turn_rad, each.part) < enough:
            legs = _tried(limits, own, each, route)
            cost = _cost(scene, legs, turn_rad, each.part, 2.0, enough) + extra
            if cost < lowest:
                best, lowest, chosen = each, cost, legs
        if not extra:  # the first was the course that is steered
            extra = CHANGE + STEADY * lowest
    if lowest >= ASHORE and (best is not None or scene.has_vessels):  # nor is the route
        return _new(Choice, (wrap(ahead_rad), 0.0, False, True))
    return None if best is None else best._replace(course_rad=wrap(best.course_rad))


def _tried(limits: Caution, own: Own, choice: Choice, route: RouteAhead) -> tuple[Leg, Leg]:
    return trial_legs(limits, own, choice.course_rad, choice.part * route.speed_mps)


def _leads_in(scene: Scene, legs: Sequence[Leg]) -> bool:
    """Whether a way leads into a domain, or ashore."""
    is_in = any(passing_by(each.around, legs, each.look_s)[0] < 1.0 for each in scene.seen)
    return is_in or (scene.shore is not None and scene.shore.meets(legs, STATIC_S, is_route=False))


def _cost(
    scene: Scene, legs: Sequence[Leg], turn_rad: float, part: float, far: float, enough: float, is_route: bool = False
) -> float:
    """The cost of a trial; any number of at least `enough` where it is more. `far`: times the look ahead."""
    cost = _deviation(scene, turn_rad, part)
    deviates, turns_to_port = bool(turn_rad) or part < 1.0, -2.0 < turn_rad < 0.0
    for _, around, look_s, _, without, _, rule in scene.seen:
        if cost >= enough:
            return cost
        if is_route and without[0] >= FARTHEST:
            continue
        nearness, at_s, ahead, starboard = passing_by(around, legs, look_s * far)
        if nearness >= FARTHEST:
            continue
        cost += _hazard(nearness, at_s, look_s)
        if at_s < ESCAPE_S:
            nearness, at_s, _, _ = passing_by(around, legs, look_s * far, ESCAPE_S)
            cost += _hazard(nearness, at_s, look_s)
        if deviates and rule:
            if starboard > 0.0 if rule == "starboard" else ahead > 0.0 and rule != "port":
                cost += AGAINST_RULE
            elif turns_to_port and rule == "port":
                cost += TO_PORT
    if scene.shore is not None and cost < enough and scene.shore.meets(legs, STATIC_S, is_route):
        cost += ASHORE
    return cost


def _deviation(scene: Scene, turn_rad: float, part: float) -> float:
    """The cost of another course and speed, whoever is about: of a trial the least."""
    sideways = STARBOARD if turn_rad > 0.0 else PORT
    return scene.weary * abs(turn_rad) / (0.5 * math.pi) * sideways + (1.0 - part) * SLOWER


def _hazard(nearness: float, at_s: float, look_s: float) -> float:
    if nearness < 1.0:
        cost = INSIDE + DEEP * (1.0 - nearness) + STRUCK * max(HALF - nearness, 0.0)
        return cost / (1.0 + (at_s / look_s) ** 2)
    return NEAR * (SOFT - nearness) / (SOFT - 1.0) if nearness < SOFT else 0.0


def _passes(seen: Sequence[Seen], on: Sequence[Leg], legs: Sequence[Leg]) -> tuple[PassedBy, ...]:
    found = list[PassedBy]()
    for target, around, look_s, _, without, _, _ in seen:
        nearness = without.nearness if legs is on else passing_by(around, legs, 2.0 * look_s)[0]
        found.append(_new(PassedBy, (target.key, without, nearness)))
    return tuple(found)


def _ordered(
    scene: Scene,
    best: Choice,
    speed_mps: float,
    on: Sequence[Leg],
    legs: Sequence[Leg],
    passes: Sequence[PassedBy],
    was: CourseOrder | None,
    now_s: float,
) -> CourseOrder:
    """The order, with the vessel that it is for: the first whose domain the boat would enter if it went on."""
    course_rad, part, is_last, is_ashore = best
    asked = [(each.without.at_s, i) for i, each in enumerate(passes) if each.without.nearness < SOFT]
    if not asked and was is not None:
        asked = [(0.0, i) for i, each in enumerate(passes) if each.key == was.key]
    speed = "" if part == 1.0 else ", stopped" if part == 0.0 else ", at half speed"
    nearness = min((each.nearness for each in passes), default=math.inf)
    if asked:
        this = scene.seen[min(asked)[1]]
        text, key = _said(this, on, legs), this.target.key
    else:
        text, key = f"keeping clear of {scene.shore.name if scene.shore and scene.shore.name else 'the way back'}", ""
    if is_last:
        text += ", to port as nothing else is clear"
    if is_ashore:
        text += ", as all else leads over the fence"
    if nearness < 1.0:
        text += ", nothing is clear"
    return CourseOrder(course_rad, part, part * speed_mps, text + speed, key, nearness, now_s)


def _said(this: Seen, on: Sequence[Leg], legs: Sequence[Leg]) -> str:
    """The words for what is done for a vessel, how it is passed, and how far away."""
    passed = approach(this.around, legs, 2.0 * this.look_s)
    cpa_m = approach(domain(this.target, 1.0, 1.0), legs, 2.0 * this.look_s).nearness
    owed: Duty = this.duty or "give-way"
    is_late = owed == "stand-on" and approach(this.around, on, this.look_s).at_s <= this.late_s
    return f"{words(owed, this.target, is_late)}, {passing(owed, passed.ahead, passed.starboard)}, CPA {cpa_m:.0f} m"
