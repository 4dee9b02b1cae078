"""Mission, zones and harbours of the boat: checked in slices before they become the plan, and laid into the local plane.

A boat that sails its mission goes on with another one that has the same places up to the end of the leg under way.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import msgspec

from delfim import config
from delfim.base import geodesy
from delfim.base.cooperative import Remains, Sliced, Work
from delfim.base.errors import DelfimError, Refused
from delfim.base.modes import Mode
from delfim.vehicle import console
from delfim.vehicle.control.memory import Settings
from delfim.vehicle.control.modes.path import piece_of
from delfim.vehicle.plans import fence, legs, underway
from delfim.vehicle.plans.clearance import Chart, Water
from delfim.vehicle.plans.legs import NOTHING, Behind
from delfim.vehicle.plans.mission import Mission, checked, plan, read_mission
from delfim.vehicle.plans.track import Track
from delfim.vehicle.state import Plan, State, StateLog


class Laid(NamedTuple):
    """A mission in the local plane, and the fence around it: the boat's own zones and the mission's."""

    plan: Plan
    around: fence.Fence | None
    same: underway.Same  # what the plan has in common with the one before
    behind: Behind  # the boat, and forbidden by the fence


class Looked(NamedTuple):
    """The result of checking a plan: its changes, or why it is refused. Valid as long as `basis` does not change."""

    command: console.Plan
    basis: tuple[object, ...]
    wrong: DelfimError | None = None
    mission: Mission | None = None
    laid: Laid | None = None
    origin: geodesy.Origin | None = None
    around: fence.Fence | None = None
    lost: str | None = None  # why the present mission is to be removed
    behind: Behind = NOTHING  # the boat, and forbidden by the fence


def laid(
    mission: Mission,
    origin: geodesy.Origin,
    control: config.ControlTable,
    limits: config.FenceTable,
    before: fence.Fence | None = None,
    was: Plan | None = None,
    now: underway.UnderWay | None = None,
    spared: Behind = NOTHING,
    chart: Chart | None = None,
) -> Work[Laid]:
    """A mission in the local plane. `before`: a fence in this plane with the boat's own zones. `now`: the boat sails the plan
    that `was`. `spared`: what is not held against the fence where it does not. Raises ConfigError, Refused where the boat
    cannot or must not sail it.
    """
    yield from checked(mission)
    planned = yield from plan(mission, origin, control)
    same = underway.Same(0, 0) if was is None else (yield from underway.same(was, planned))
    why = None if now is None else underway.differs(now, same, planned)
    if now is not None and why is not None and not now.is_paused:
        raise Refused(f"mission refused: {why}; {underway.SAILING}")
    if mission.opens and not limits.chart:
        raise Refused(f"mission refused: it opens water of {mission.opens}, and the boat has no chart (fence.chart)")
    water = chart.water(mission.opens) if chart is not None else None
    around = yield from fence.survey(limits, mission.fence, origin, before, water)
    behind = spared if now is None else NOTHING if why is not None else underway.behind(now, not mission.path)
    why, behind = yield from forbidden(around, planned, control.hold.radius_m, behind)
    if why is not None:
        raise Refused(f"mission refused: {why}")
    return Laid(planned, around, same, behind)


def forbidden(around: fence.Fence | None, planned: Plan, radius_m: float, behind: Behind) -> Work[tuple[str | None, Behind]]:
    """Why the fence forbids a mission, in words; None where it forbids no more than what is behind the boat. And that."""
    why = None if around is None else (yield from legs.complaint(around, planned, radius_m))
    if around is None or why is None or behind == NOTHING:
        return why, NOTHING
    return (yield from legs.complaint(around, planned, radius_m, behind)), behind


def _parts(around: fence.Fence) -> Iterator[object]:
    """All that a fence is made of."""
    for zone in around.zones:
        for area in (zone, *zone.areas):
            yield area
            yield from area.sides
            yield from area.parts


class Plans:
    """The plans aboard. `look` checks a plan, `accept` loads it: nothing changes before the second."""

    def __init__(
        self,
        fence_settings: config.FenceTable,
        limits: Settings,
        state: State,
        track: Track,
        log: StateLog,
        sailed: Callable[[], underway.UnderWay | None],
        chart: Chart | None = None,
    ) -> None:
        self.limits = limits  # the helm's, which may change
        self.zones = config.Zones()  # the mission's
        self.mission: Mission | None = None  # as loaded
        self.rally: tuple[tuple[float, float], ...] = ()  # harbours, degrees
        self.fence = fence.unlaid(fence_settings, self.zones)  # the boat's and the mission's; None: none
        self._fence, self._state, self._track, self._log, self._under_way = fence_settings, state, track, log, sailed
        self.chart = chart
        self._number, self.behind = 0, NOTHING  # of the newest plan; what of it the fence forbids
        self.spared = NOTHING  # what the fence forbade of the plan before a restart, which is about to be loaded again
        self._laying: Sliced[fence.Fence | None] | None = None  # of the fence into the plane
        self._looked: Looked | None = None
        self._text = ""  # of a mission, as received so far
        self.remains = Remains()  # of plans

    def gather(self, part: console.LoadMission) -> None:
        """A part of a mission's text that has more. Raises Refused."""
        self._text = self.text(part)

    def text(self, part: console.LoadMission) -> str:
        """A mission's text up to and including this part. Raises Refused."""
        if part.at != (len(self._text) if part.at else 0):
            raise Refused("mission refused: a part of its text is missing; send it again from the start")
        return self._text + part.text if part.at else part.text

    def look(self, command: console.Plan, mission: Mission | None = None) -> Work[None]:
        """Check a plan before its command is obeyed. `mission`: read from its text already."""
        basis = self._basis()
        try:
            if isinstance(command, console.SetFence):
                looked = yield from self._look_at_zones(command)
            else:
                if mission is None:
                    mission = command.mission if isinstance(command, console.Upload) else read_mission(self.text(command))
                looked = yield from self._look_at_mission(command, mission)
        except DelfimError as error:
            looked = Looked(command, basis, error)
        if (old := self._looked) is not None:
            self._leave(old.mission, old.laid.plan if old.laid is not None else None, old.around)
        self._looked = looked

    def has_looked(self, command: console.Plan) -> bool:
        """Whether the plan was checked and the boat has not changed since."""
        looked, now = self._looked, self._under_way()
        if looked is None or looked.command is not command:
            return False
        if looked.behind not in (NOTHING, self.spared) and not self._goes_on(looked, now):
            return False
        return all(was is now for was, now in zip(looked.basis, self._basis(), strict=True))

    def _goes_on(self, looked: Looked, now: underway.UnderWay | None) -> bool:
        """Whether the boat that sails, or is paused, goes on with a checked plan where it is."""
        if now is None or (looked.behind.legs if now.mode is Mode.PLAY else looked.behind.pieces) > now.leg:
            return False
        return looked.laid is None or underway.differs(now, looked.laid.same, looked.laid.plan) is None

    def _basis(self) -> tuple[object, ...]:
        return self._state.origin, self.limits, self.mission, self.zones

    def _look_at_mission(self, command: console.LoadMission | console.Upload, mission: Mission) -> Work[Looked]:
        state, basis = self._state, self._basis()
        first = mission.waypoint[0]
        origin = state.origin or geodesy.origin(math.radians(first.latitude_deg), math.radians(first.longitude_deg))
        was, now = state.setpoint.plan, self._under_way()
        found = yield from laid(
            mission, origin, self.limits.control, self._fence, self.fence, was, now, self.spared, self.chart
        )
        return Looked(command, basis, None, mission, found, origin, found.around, None, found.behind)

    def _look_at_zones(self, command: console.SetFence) -> Work[Looked]:
        """Check new zones of the mission. Without a position there is no plane yet, and no mission in it."""
        origin, basis = self._state.origin, self._basis()
        yield from config.polygons(command.zones, "zones")
        if origin is None:
            return Looked(command, basis, around=fence.unlaid(self._fence, command.zones))
        around = yield from fence.survey(self._fence, command.zones, origin, self.fence, self._water())
        planned, radius_m, now = self._state.setpoint.plan, self.limits.control.hold.radius_m, self._under_way()
        if planned is None or self.mission is None:
            return Looked(command, basis, around=around)
        behind = NOTHING if now is None else underway.behind(now, not self.mission.path)
        why, behind = yield from forbidden(around, planned, radius_m, behind)
        return Looked(command, basis, around=around, lost=why, behind=behind)

    def accept(self, command: console.Plan) -> None:
        """The checked plan becomes the present one; a plan not checked yet is checked now, at once. Raises DelfimError with the
        reason why not: nothing has changed then.
        """
        if not self.has_looked(command):
            Sliced(self.look(command)).finish()
        looked, self._looked, self._text, self.spared, state = self._looked, None, "", NOTHING, self._state
        assert looked is not None
        if looked.wrong is not None:
            raise looked.wrong
        now = self._under_way()
        if now is not None and not now.is_paused:
            self._go_on_with(looked, now)
        goes_on = self._goes_on(looked, now)
        self._leave(self.mission, state.setpoint.plan, self.fence)
        self.fence, self._laying, self.behind = looked.around, None, looked.behind
        if isinstance(command, console.SetFence):
            self.zones = command.zones
            if self.mission is not None:
                self.mission = msgspec.structs.replace(self.mission, fence=command.zones)
            if looked.lost is not None:
                self._forget()
                self._log.note(f"the mission was removed: {looked.lost}")
            return
        assert looked.mission is not None
        assert looked.laid is not None
        assert looked.origin is not None
        if state.origin is None:
            self.found(looked.origin)
        self._number += not goes_on
        leg = min(state.setpoint.leg, len(looked.laid.plan.waypoints) - 1) if goes_on else 0
        piece = min(state.setpoint.piece, max(len(looked.laid.plan.path) - 1, 0)) if goes_on else 0
        planned = looked.laid.plan._replace(number=self._number)
        state.setpoint = state.setpoint._replace(plan=planned, leg=leg, piece=piece)
        self.mission, self.zones, self.fence, self._laying = looked.mission, looked.mission.fence, looked.around, None

    def _go_on_with(self, looked: Looked, now: underway.UnderWay) -> None:
        """Raises Refused where a boat that sails cannot go on like this."""
        planned, why = self._state.setpoint.plan, looked.lost
        if looked.laid is not None:
            planned = looked.laid.plan
            why = underway.differs(now, looked.laid.same, planned)
        assert planned is not None
        if why is None and looked.around is not None:
            why = underway.obstructed(looked.around, now, planned, self._state.motion)
        if why is not None:
            what = "fence" if looked.laid is None else "mission"
            raise Refused(f"{what} refused: {why}; {underway.SAILING}")

    def barred(self, mode: Mode, leg: int) -> str | None:
        """Why a mode cannot sail the mission from a leg or piece on: a fence that came under way forbids what was behind."""
        since = self.behind.legs if mode is Mode.PLAY else self.behind.pieces if mode is Mode.PATH else 0
        what = "waypoint" if mode is Mode.PLAY else "piece"
        return f"the fence forbids the mission before {what} {since + 1}: begin there" if piece_of(leg) < since else None

    def _leave(self, mission: Mission | None, planned: Plan | None, around: fence.Fence | None) -> None:
        """Free the parts that will be replaced."""
        if around is not None:
            self.remains.add(_parts(around))
        if planned is not None:
            self.remains.add(planned.waypoints, planned.path)
        if mission is not None:
            corners = (corner for area in (*mission.fence.keep_in, *mission.fence.keep_out) for corner in area.polygon)
            self.remains.add(mission.waypoint, mission.path, mission.action, corners)

    def found(self, origin: geodesy.Origin) -> None:
        """A local plane exists from now on: lay the fence into it, slice by slice."""
        self._state.origin = origin
        self._laying = Sliced(fence.survey(self._fence, self.zones, origin, water=self._water()))
        self.call_at()
        self.go_on()

    def go_on(self) -> None:
        """A slice of long work."""
        if self._laying is not None and self._laying.step():
            self.fence, self._laying = self._laying.result, None
        self._track.look_back()
        self.remains.let_go()

    def call_at(self, rally: tuple[tuple[float, float], ...] | None = None) -> None:
        """Lay the harbours into the plane; other ones, degrees, where they are given."""
        self.rally = self.rally if rally is None else rally
        if (at := self._state.origin) is not None:
            harbours = tuple(geodesy.to_plane(at, math.radians(place[0]), math.radians(place[1])) for place in self.rally)
            self._track.call_at(harbours, self.limits.control.path.acceptance_m)
            self._track.look_back()

    def unload(self) -> None:
        """Raises Refused while the boat sails the mission."""
        if self._state.mode in underway.SAILS:
            raise Refused("unload refused: the mission is being played; stop or hold first")
        self._forget()

    def _water(self) -> Water | None:
        """The chart, with the band open that the mission opens."""
        return None if self.chart is None else self.chart.water(self.mission.opens if self.mission is not None else "")

    def _forget(self) -> None:
        if (
            self.mission is not None
            and self.mission.opens
            and self.fence is not None
            and (at := self._state.origin) is not None
        ):
            assert self.chart is not None
            self.fence = fence.shut(self.fence, self.chart.water(""), at)
        self.mission, self.behind = None, NOTHING
        self._state.setpoint = self._state.setpoint._replace(plan=None, leg=0, piece=0)
