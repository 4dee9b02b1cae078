"""Troubles at their limit to the last digit, and of boats whose motors turn, tell little, or push to the side."""

import math

import pytest

from delfim.base.modes import Mode
from delfim.vehicle import console
from delfim.vehicle.failsafe.troubles import STILL_RADPS, Trigger, astray
from delfim.vehicle.state import Actuation, Reference
from tests.vehicle.test_failsafe import state
from tests.vehicle.test_troubles import NOW_S, POD, SETTINGS, WITH, going, seen


@pytest.mark.parametrize(
    ("heading_deg", "off_deg", "yaw_radps", "is_told"),
    [
        (0.0, 45.0, 0.0, False),
        (0.0, 46.0, STILL_RADPS, True),
        (0.0, -46.0, -STILL_RADPS, True),
        (30.0, 20.0, 0.0, False),
        (30.0, 90.0, 0.0, True),
        (170.0, 30.0, 0.0, False),
        (-60.0, 60.0, 0.0, True),
    ],
)
def test_how_far_a_boat_is_off_its_heading_is_counted_from_where_it_heads(heading_deg, off_deg, yaw_radps, is_told) -> None:
    here = going(1.0, 1.0, 0.5)
    here.reference = Reference(heading_rad=math.radians(heading_deg + off_deg), speed_mps=1.0)
    here.motion = here.motion._replace(heading_rad=math.radians(heading_deg), yaw_rate_radps=yaw_radps)
    words = f"stuck: {abs(off_deg):.0f} degrees off its heading, and it does not turn at 50% thrust"
    assert seen(Trigger.STUCK, here) == (words if is_told else None)


@pytest.mark.parametrize(("turned_deg", "is_told"), [(0.0, True), (60.0, False), (-60.0, False), (45.0, True)])
def test_a_motor_that_is_turned_aside_pushes_less_ahead(turned_deg: float, is_told: bool) -> None:
    """0.5 of thrust, of which 0.25 and 0.35 are ahead."""
    here, settings = going(0.0, 1.5, 0.5), WITH(SETTINGS, thrusters=(WITH(POD, x_m=-2.0),))
    here.actuation = Actuation((0.5,), (math.radians(turned_deg),), True)
    assert (seen(Trigger.STUCK, here, settings=settings) is not None) is is_told


@pytest.mark.parametrize(("roll_deg", "is_told"), [(75.0, False), (-75.0, False), (75.01, True), (None, False)])
def test_a_boat_has_capsized_beyond_the_roll_of_its_file(roll_deg: float | None, is_told: bool) -> None:
    here = state(Mode.HOLD)
    assert here.navigation is not None
    for most_deg in (75.0, 0.5):
        failsafe = WITH(SETTINGS.failsafe, capsized=WITH(SETTINGS.failsafe.capsized, roll_deg=most_deg))
        here.navigation = here.navigation._replace(roll_rad=None if roll_deg is None else math.radians(roll_deg))
        found = seen(Trigger.CAPSIZED, here, settings=WITH(SETTINGS, failsafe=failsafe))
        assert (found is not None) is (is_told or (most_deg < 1.0 and roll_deg is not None)), (
            "a roll that nobody measures is none"
        )


@pytest.mark.parametrize(("limits", "told"), [({"current_a": 0.5}, "current_a"), ({"temperature_c": 0.5}, "temperature_c")])
def test_a_small_motor_that_does_not_tell_is_not_overloaded(limits: dict[str, float], told: str) -> None:
    failsafe = WITH(SETTINGS.failsafe, thruster=WITH(SETTINGS.failsafe.thruster, **limits))
    own, here = WITH(SETTINGS, failsafe=failsafe), state(Mode.PLAY)
    assert getattr(here.thrusters["port"], told) is None
    assert "port" not in astray(own, here, NOW_S)
    here.thrusters["port"] = here.thrusters["port"]._replace(**{told: 0.75})
    assert "port" in astray(own, here, NOW_S)


def test_the_guard_works_again_at_the_end_of_its_time_and_is_overruled_anew_from_then_on(boat) -> None:
    guard = boat.vehicle.helm.settings.traffic.guard
    for left_s, until_s in ((0.0, guard.overruled_s), (0.5, 0.0)):
        boat.state.overruled_s = boat.clock.monotonic_s() + left_s
        assert boat.vehicle.on_command(console.Overrule()) is None
        assert boat.state.overruled_s == boat.clock.monotonic_s() + until_s
