"""From a plan's last place to the end of the way home: straight, or round the zones and the chart that are in the way."""

from collections.abc import Iterable

from delfim.base.cooperative import Sliced
from delfim.vehicle.control.modes.path import end_of
from delfim.vehicle.helm.detour import most, way_kept
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.helm.waterway import Shut
from delfim.vehicle.plans.fence import Fence, is_clear
from delfim.vehicle.plans.track import Point
from delfim.vehicle.state import Plan


class WayBack:
    """`turns` of the way; None: they are not known, or there is no way."""

    def __init__(self) -> None:
        self.turns: tuple[Point, ...] | None = ()
        self._around: Fence | None = None
        self._plan: Plan | None = None
        self._end: Point | None = None
        self._work: Sliced[tuple[Point, ...] | Shut] | None = None
        self._held, self._most = list[Iterable[object]](), 0

    def look(self, helm: Helm, speed_mps: float) -> bool:
        """A slice of a search, for a boat at this speed; False: there was nothing to do."""
        around, plan, end = helm.plans.fence, helm.state.setpoint.plan, helm.track.end()
        if around is not self._around or plan is not self._plan or end != self._end:
            helm.plans.remains.add(*self._held)
            self._around, self._plan, self._end = around, plan, end
            self._work, self._held, self.turns = None, [], ()
            if around is not None and plan is not None and end is not None:
                last = end_of(plan.path[-1]) if not plan.waypoints else plan.waypoints[-1][:2]
                if not is_clear(around, last, end)[0]:
                    self.turns, self._most = None, most(around)
                    self._work = Sliced(way_kept(around, last, end, speed_mps, self._held))
            return around is not None
        if self._work is None:
            return False
        if self._work.step():
            self.turns = None if isinstance(self._work.result, Shut) else self._work.result
        elif self._work.spent < self._most:
            return True
        helm.plans.remains.add(*self._held)
        self._work, self._held = None, []
        return True
