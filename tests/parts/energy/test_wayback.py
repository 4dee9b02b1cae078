"""The way from a plan's last place home, which its energy is reckoned by: never across what is forbidden."""

from typing import Any

import pytest

from delfim.base.cooperative import Remains
from delfim.config import HomeTable
from delfim.parts.energy import wayback
from delfim.parts.energy.wayback import WayBack
from delfim.vehicle.plans.track import Track
from delfim.vehicle.state import Line, Plan, State, Waypoint
from tests.vehicle.test_homeward import BAR, Fence, Point, least_m, water

HOME = (0.0, 0.0)


class Helmed:
    """As much of a helm as is asked."""

    def __init__(self, around: Fence | None, *places: Point, is_path: bool = False) -> None:
        self.track, self.state = Track(HomeTable()), State()
        self.plans: Any = type("Told", (), {"fence": around, "remains": Remains()})
        self.track.add(*HOME)
        rows = tuple(Waypoint(*place, 1.5, 5.0) for place in places)
        path = tuple(Line(*HOME, *place, 1.5) for place in places)
        if places:
            plan = Plan("test", (), path) if is_path else Plan("test", rows, ())
            self.state.setpoint = self.state.setpoint._replace(plan=plan)

    def looked(self, found: WayBack, most: int = 3000) -> int:
        """Until there is nothing to do; how many slices that took."""
        return next(number for number in range(most) if not found.look(self, 1.5))  # type: ignore[arg-type]


@pytest.mark.parametrize("is_path", [False, True])
def test_a_plan_that_ends_behind_a_bar_leads_home_round_it(is_path: bool) -> None:
    around, found = water(BAR), WayBack()
    helm = Helmed(around, (0.0, 110.0), (120.0, 0.0), is_path=is_path)
    found.look(helm, 1.5)  # type: ignore[arg-type]
    assert found.turns is None, "not known yet"
    assert helm.looked(found) > 1
    assert found.turns
    assert max(east_m for _, east_m in found.turns) > 72.0
    assert least_m(around, ((120.0, 0.0), *found.turns, HOME)) > 2.0
    helm.state.setpoint = helm.state.setpoint._replace(plan=None)
    assert helm.looked(found) == 1
    assert found.turns == ()


def test_without_a_fence_or_with_a_free_way_it_is_straight() -> None:
    for around, places in ((None, [(120.0, 0.0)]), (water(BAR), [(40.0, 0.0)]), (water(BAR), [])):
        found = WayBack()
        assert Helmed(around, *places).looked(found) <= 1
        assert found.turns == ()


def test_without_a_way_nothing_is_reckoned(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = water([(60.0, east, 12.0) for east in range(-300, 301, 10)])
    found = WayBack()
    assert Helmed(wall, (120.0, 0.0)).looked(found) > 1
    assert found.turns is None
    monkeypatch.setattr(wayback, "most", lambda around: 1)
    found = WayBack()
    assert Helmed(water(BAR), (120.0, 0.0)).looked(found) == 2, "it took too long"
    assert found.turns is None
