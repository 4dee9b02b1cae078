"""Navigation sources: each input puts together complete navigation messages.

Sources stand in order of preference; a message of a less preferred source counts only while every better one is silent. A
source is a module of a part, named by its row (CONTRIBUTING.md, "A part is a folder").
"""

import math
from typing import NamedTuple, Protocol

from delfim import config
from delfim.base import geodesy, parts
from delfim.canproxy.dsor.messages import Navigation
from delfim.vehicle.links import Links, Readable
from delfim.vehicle.state import Motion, State

BACK_S = 0.5  # age to which a reserve's heading and velocity serve the source that takes over, until it knows its own


class Fix(NamedTuple):
    """One navigation message and when its last frame arrived."""

    navigation: Navigation
    t0_ns: int  # the kernel's stamp, or when it was read
    received_s: float  # monotonic


class Source(Protocol):
    """A navigation input. `read` never raises and never waits."""

    name: str  # as in `navigation.sources`
    input: Readable  # to be read when it is readable
    heard_s: float  # monotonic time of its last message

    def read(self, now_s: float) -> Fix | None: ...
    def report(self, now_s: float) -> dict[str, object]: ...  # JSON-ready figures, empty where there are none


def open_sources(settings: config.Vehicle, links: Links, state: State) -> tuple[Source, ...]:
    """The vehicle's sources in order of preference. A source's module is loaded only when it is used. Raises DelfimError."""
    names = settings.navigation.sources
    return tuple(open_source(name, settings, links, state) for name in names)


def open_source(name: str, settings: config.Vehicle, links: Links, state: State) -> Source:
    """Raises DelfimError."""
    module = parts.module(settings.aboard, "source", name)
    source: Source = module.open_source(settings, links, state)
    return source


def preferred(source: Source, sources: tuple[Source, ...], now_s: float, stale_s: float) -> bool:
    """Whether every preferred source is silent."""
    for better in sources:
        if better is source:
            return True
        if now_s - better.heard_s <= stale_s:
            return False
    return True


def take(source: Source, fix: Fix, sources: tuple[Source, ...], state: State, limits: config.NavigationTable) -> bool:
    """A fix into the state; False when it is not used: a better source is heard, or no boat moves that fast."""
    if not preferred(source, sources, fix.received_s, limits.stale_s):
        return False
    n, last = fix.navigation, state.navigation
    if last is not None and n.counter == last.counter and n.utc_ns == last.utc_ns and state.source == source.name:
        state.count("navigation_repeated")
        source.heard_s = state.navigation_s  # a source that repeats itself counts as silent: the next one may be used
        return False
    if state.source != source.name:
        state.before, state.before_s = state.motion, state.navigation_s
    if (n.heading_rad is None or n.north_mps is None) and fix.received_s - state.before_s <= BACK_S:
        n = _with_reserve(n, state.before)
    if n.latitude_rad is not None and n.longitude_rad is not None:
        if not (abs(n.latitude_rad) < math.pi / 2 and abs(n.longitude_rad) <= math.tau):  # refuses NaN, too
            state.count("navigation_malformed")
            return False
        if state.origin is None:
            state.origin = geodesy.origin(n.latitude_rad, n.longitude_rad)
        north_m, east_m = geodesy.to_plane(state.origin, n.latitude_rad, n.longitude_rad)
        has = _POSITION
    else:
        north_m, east_m, has = state.motion.north_m, state.motion.east_m, 0
    if has and _jumped(state, limits, north_m, east_m, fix.received_s):
        return False
    moving, headed = n.north_mps is not None, n.heading_rad is not None
    known = _HAS[has | (_HEADING if headed else 0) | (_VELOCITY if moving else 0)]
    fields = (known, north_m, east_m, n.heading_rad or 0.0, n.yaw_rate_radps or 0.0, n.north_mps or 0.0, n.east_mps or 0.0)
    state.motion = tuple.__new__(Motion, fields)  # half the time of Motion(...): this is on the critical path
    if last is None or n[_MEASURED] != last[_MEASURED]:
        state.changed_s = fix.received_s
    state.navigation, state.navigation_s, state.source = n, fix.received_s, source.name
    state.cycles += 1
    return True


def _with_reserve(n: Navigation, before: Motion) -> Navigation:
    """The message with the values that it lacks, as the source before told them a moment ago: an estimate begins with a
    position alone, and a boat that sails by the reserve would stop for it."""
    if n.heading_rad is None and "heading" in before.has:
        n = n._replace(heading_rad=before.heading_rad, yaw_rate_radps=before.yaw_rate_radps)
    if n.north_mps is None and "velocity" in before.has:
        n = n._replace(north_mps=before.north_mps, east_mps=before.east_mps)
    return n


def _jumped(state: State, limits: config.NavigationTable, north_m: float, east_m: float, now_s: float) -> bool:
    """Whether the boat would have to move impossibly fast to be here. After a silence any position is accepted."""
    age_s = now_s - state.navigation_s
    if age_s > limits.stale_s or "position" not in state.motion.has:
        return False
    moved_m = math.hypot(north_m - state.motion.north_m, east_m - state.motion.east_m)
    if moved_m <= limits.jump_m + limits.jump_mps * age_s:
        return False
    state.count("navigation_jumps")
    if now_s - state.jumped_s > limits.stale_s:
        state.jumping_s = now_s
    state.jumped_s, state.jumped_m = now_s, moved_m
    return True


_MEASURED = slice(1, 9)  # of a navigation message: position, velocity, attitude
_POSITION, _HEADING, _VELOCITY = 1, 2, 4
_HAS = tuple(
    frozenset(name for bit, name in ((1, "position"), (2, "heading"), (4, "velocity")) if known & bit) for known in range(8)
)
