"""An outlet repeats the last command for devices that stop sooner than the loop commands, but never outlives its control."""

from delfim.vehicle import console
from delfim.vehicle.links import LoopInput
from delfim.vehicle.state import Actuation


class Impatient:
    """An actuator whose devices want to hear something twenty times a second."""

    name = "impatient"
    period_s: float | None = 0.05
    inputs: tuple[LoopInput, ...] = ()

    def __init__(self) -> None:
        self.repeated, self.unsent = 0, 0

    def send(self, sent: Actuation, now_s: float) -> int:
        return 0

    def repeat(self, now_s: float) -> int:
        self.repeated += 1
        return self.unsent

    def stop(self) -> None:
        """Nothing turns."""

    def disconnect(self, sides: tuple[str, ...]) -> None:
        """Nothing to cut."""

    def report(self) -> dict[str, object]:
        return {}


def test_a_young_command_is_repeated_and_an_old_one_becomes_a_stop_of_all(boat):
    boat.ready()
    assert boat.vehicle.on_command(console.Heading(90.0, 1.0)) is None
    boat.pass_time(2.0)
    outlet = Impatient()
    boat.clock.advance(0.75)
    boat.heard()
    boat.vehicle.on_outlet(outlet)
    assert (outlet.repeated, boat.heard(), boat.state.actuation.run) == (1, [], True)
    boat.clock.advance(0.1)
    boat.vehicle.on_outlet(outlet)
    assert not any(command.run for command in boat.propellers()), "the loop turns, and nobody controls the boat"
    assert not boat.state.actuation.run
    assert outlet.repeated == 2, "what its devices are told now is the stop"


def test_the_watchdog_alone_keeps_a_slow_navigation_from_a_stutter(boat):
    """Navigation once a second: between two messages the watchdog commands, soon enough for every outlet."""
    boat.ready()
    assert boat.vehicle.on_command(console.Heading(90.0, 1.0)) is None
    outlet = Impatient()
    for tick in range(200):
        boat.clock.advance(0.05)
        if tick % 20 == 19:
            boat.report()
            boat.navigate()
        if tick % 2:
            boat.vehicle.on_watchdog()
        boat.vehicle.on_outlet(outlet)
        assert boat.state.actuation.run, tick


def test_repetitions_that_the_bus_does_not_take_are_counted(boat):
    boat.ready()
    outlet = Impatient()
    outlet.unsent = 3
    boat.vehicle.on_outlet(outlet)
    assert boat.state.counts["propulsion_unsent"] == 3
