"""Mission, zones and harbours of the boat: checked in slices before they become the plan, and laid into the local plane."""

import math
from typing import NamedTuple

import msgspec

from delfim import config, geodesy
from delfim.errors import DelfimError, Refused
from delfim.modes import Mode
from delfim.slices import Remains, Sliced, Work
from delfim.vehicle import console, fence, legs
from delfim.vehicle.control.memory import Settings
from delfim.vehicle.mission import Mission, checked, plan, read_mission
from delfim.vehicle.state import Plan, State, StateLog
from delfim.vehicle.track import Track


class Looked(NamedTuple):
    """The result of checking a plan: its changes, or why it is refused. Valid as long as `basis` does not change."""

    command: console.Plan
    basis: tuple[object, ...]
    wrong: DelfimError | None = None
    mission: Mission | None = None
    plan: Plan | None = None
    origin: geodesy.Origin | None = None
    around: fence.Fence | None = None
    lost: str | None = None  # why the present mission is to be removed


def laid(
    mission: Mission,
    origin: geodesy.Origin,
    control: config.ControlTable,
    limits: config.FenceTable,
    before: fence.Fence | None = None,
) -> Work[tuple[Plan, fence.Fence | None]]:
    """A mission in the local plane, and the fence around it: the boat's own zones and the mission's. `before`: a fence in this
    plane with the boat's own zones. Raises ConfigError, Refused where the boat cannot or must not sail it.
    """
    yield from checked(mission)
    planned = yield from plan(mission, origin, control)
    around = yield from fence.survey(limits, mission.fence, origin, before)
    if around is not None and (why := (yield from legs.complaint(around, planned, control.hold.radius_m))) is not None:
        raise Refused(f"mission refused: {why}")
    return planned, around


class Plans:
    """The plans aboard. `look` checks a plan, `accept` loads it: nothing changes before the second."""

    def __init__(self, fence_settings: config.FenceTable, limits: Settings, state: State, track: Track, log: StateLog) -> None:
        self.limits = limits  # the helm's, which may change
        self.zones = config.Zones()  # the mission's
        self.mission: Mission | None = None  # as loaded
        self.rally: tuple[tuple[float, float], ...] = ()  # harbours, degrees
        self.fence = fence.unlaid(fence_settings, self.zones)  # the boat's and the mission's; None: none
        self._fence, self._state, self._track, self._log = fence_settings, state, track, log
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
            self.spare("fence" if isinstance(command, console.SetFence) else "mission")
            if isinstance(command, console.SetFence):
                looked = yield from self._look_at_zones(command)
            else:
                if mission is None:
                    mission = command.mission if isinstance(command, console.Upload) else read_mission(self.text(command))
                looked = yield from self._look_at_mission(command, mission)
        except DelfimError as error:
            looked = Looked(command, basis, error)
        self._leave(self._looked)
        self._looked = looked

    def has_looked(self, command: console.Plan) -> bool:
        """Whether the plan was checked and the boat has not changed since."""
        looked = self._looked
        return (
            looked is not None
            and looked.command is command
            and all(was is now for was, now in zip(looked.basis, self._basis(), strict=True))
        )

    def _basis(self) -> tuple[object, ...]:
        return self._state.origin, self.limits, self.mission, self.zones

    def _look_at_mission(self, command: console.LoadMission | console.Upload, mission: Mission) -> Work[Looked]:
        state, basis = self._state, self._basis()
        first = mission.waypoint[0]
        origin = state.origin or geodesy.origin(math.radians(first.latitude_deg), math.radians(first.longitude_deg))
        planned, around = yield from laid(mission, origin, self.limits.control, self._fence, self.fence)
        return Looked(command, basis, None, mission, planned, origin, around)

    def _look_at_zones(self, command: console.SetFence) -> Work[Looked]:
        """Check new zones of the mission. Without a position there is no plane yet, and no mission in it."""
        origin, basis = self._state.origin, self._basis()
        yield from config.polygons(command.zones, "zones")
        if origin is None:
            return Looked(command, basis, around=fence.unlaid(self._fence, command.zones))
        around = yield from fence.survey(self._fence, command.zones, origin, self.fence)
        planned, radius_m, why = self._state.setpoint.plan, self.limits.control.hold.radius_m, None
        if planned is not None and around is not None:
            why = yield from legs.complaint(around, planned, radius_m)
        return Looked(command, basis, around=around, lost=why)

    def accept(self, command: console.Plan) -> None:
        """The checked plan becomes the present one; a plan not checked yet is checked now, at once."""
        self.spare("fence" if isinstance(command, console.SetFence) else "mission")
        if not self.has_looked(command):
            Sliced(self.look(command)).finish()
        looked, self._looked, self._text = self._looked, None, ""
        assert looked is not None
        if looked.wrong is not None:
            raise looked.wrong
        state = self._state
        self._leave(Looked(command, (), None, self.mission, state.setpoint.plan, None, self.fence))
        self.fence, self._laying = looked.around, None
        if isinstance(command, console.SetFence):
            self.zones = command.zones
            if self.mission is not None:
                self.mission = msgspec.structs.replace(self.mission, fence=command.zones)
            if looked.lost is not None:
                self.unload()
                self._log.note(f"the mission was removed: {looked.lost}")
            return
        assert looked.mission is not None
        assert looked.origin is not None
        if state.origin is None:
            self.found(looked.origin)
        state.setpoint = state.setpoint._replace(plan=looked.plan, leg=0)
        self.mission, self.zones, self.fence, self._laying = looked.mission, looked.mission.fence, looked.around, None

    def _leave(self, old: Looked | None) -> None:
        """Free the parts that will be replaced."""
        if old is None:
            return
        if old.around is not None:
            zones = [area for zone in old.around.zones for area in (zone, *zone.areas)]
            self.remains.add(zones, *(zone.sides for zone in zones), *(zone.parts for zone in zones))
        if old.plan is not None:
            self.remains.add(old.plan.waypoints, old.plan.path)
        if old.mission is not None:
            areas = (*old.mission.fence.keep_in, *old.mission.fence.keep_out)
            self.remains.add(old.mission.waypoint, old.mission.path, old.mission.action, *(each.polygon for each in areas))

    def found(self, origin: geodesy.Origin) -> None:
        """A local plane exists from now on: lay the fence into it, slice by slice."""
        self._state.origin = origin
        self._laying = Sliced(fence.survey(self._fence, self.zones, origin))
        self.call_at()
        self.go_on()

    def go_on(self) -> None:
        """A slice of long work."""
        if self._laying is not None and self._laying.step():
            self.fence, self._laying = self._laying.result, None
        self._track.look_back()
        self.remains.let_go()

    def call_at(self) -> None:
        """Lay the harbours into the plane."""
        if (at := self._state.origin) is not None:
            harbours = tuple(geodesy.to_plane(at, math.radians(place[0]), math.radians(place[1])) for place in self.rally)
            self._track.call_at(harbours, self.limits.control.path.acceptance_m)
            self._track.look_back()

    def unload(self) -> None:
        self.spare("unload")
        self.mission, self._state.setpoint = None, self._state.setpoint._replace(plan=None, leg=0)

    def spare(self, what: str) -> None:
        """Raises Refused while the boat sails the mission."""
        if self._state.mode in (Mode.PLAY, Mode.PATH):
            raise Refused(f"{what} refused: the mission is being played; stop or hold first")
