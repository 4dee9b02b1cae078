"""The live view: what a person sees of a state, as text."""

import io
import json

import pytest
from rich.console import Console

from delfim.canproxy.dsor.messages import Fault, Status
from delfim.console.terminal.view import HEIGHT, WIDTH, View, warnings
from delfim.vehicle import console
from delfim.vehicle.snapshot import in_json

SQUARE = [(38.0, -9.0), (38.001, -9.0), (38.001, -8.999), (38.0, -9.0)]


@pytest.fixture
def state(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(90.0, 1.0))
    boat.pass_time(1.0)
    more = {"boat": "test", "log": {"reason": ""}, "services": {}}
    return json.loads(console.answer(None, in_json(boat.vehicle.report(**more))))["state"]


def shown(view: View, width: int = 130, height: int = 40) -> str:
    screen = Console(file=io.StringIO(), width=width, height=height)
    screen.print(view.render(width, height))
    return screen.file.getvalue()


@pytest.mark.parametrize(("width", "height", "chart"), [(80, 24, False), (80, 40, True), (110, 50, True), (130, 24, True)])
def test_everything_that_matters_is_on_the_screen(state, width, height, chart):
    view = View(SQUARE, "square")
    view.feed(state)
    text = shown(view, width, height)
    for words in (
        "test  heading",
        "38.692500",
        "wanted 90.0",
        "p50  p99  worst",
        "propeller_port",
        "no warnings",
        "within 100",
    ):
        assert words in text
    assert any(arrow in text for arrow in "↑↗→↘↓↙←↖") is chart
    assert text.count("\n") <= height


def test_before_the_first_state_it_waits():
    assert "waiting for the vehicle" in shown(View(SQUARE, "square"))


def test_the_chart_keeps_its_size_and_draws_track_waypoints_and_boat(state):
    view = View(SQUARE, "square")
    for step in range(50):
        view.feed({**state, "latitude_deg": 38.0 + step * 2e-5, "longitude_deg": -9.0})
    rows = view.chart()
    assert len(rows) == HEIGHT
    assert {len(row) for row in rows} == {WIDTH}
    text = "".join(rows)
    assert "1/4" in text, "two waypoints at one place share a label"
    assert any(0x2800 < ord(c) < 0x2900 for c in text)
    assert any(arrow in text for arrow in "↑↗→↘↓↙←↖")


def test_of_another_mission_than_its_own_it_draws_no_waypoints(state):
    view = View(SQUARE, "square")
    view.feed({**state, "latitude_deg": 38.0, "longitude_deg": -9.0, "mission": "square"})
    assert "3" in "".join(view.chart())
    view.feed({**state, "latitude_deg": 38.0, "longitude_deg": -9.0, "mission": "another"})
    assert "3" not in "".join(view.chart())


def test_a_boat_that_never_had_a_position_can_be_shown(boat):
    view = View([], "")
    view.feed(json.loads(console.answer(None, in_json(boat.vehicle.report())))["state"])
    assert "never heard" in shown(view)


def test_warnings_say_what_is_wrong(boat, state):
    boat.report(Status.BAD, Fault.OVERHEATED)
    boat.vehicle.on_watchdog()
    bad = json.loads(console.answer(None, in_json(boat.vehicle.report())))["state"]
    bad["services"] = {"canzlogd": {"state": "waiting", "reason": "no bus"}}
    bad["log"] = {"reason": "disk full"}
    bad["counts"] = {"navigation_jumps": 3}
    words = {name: text.plain for name, text in warnings(bad)}
    assert words == {
        "idle": "propeller starboard bad: overheated",
        "sensor bad": "propeller starboard bad: overheated: stop",
        "propeller_starboard": "bad overheated",
        "canzlogd": "waiting: no bus",
        "log": "disk full",
        "navigation jumps": "3",
    }
    assert not warnings(state)


@pytest.mark.parametrize(("width", "height"), [(80, 24), (130, 24), (110, 50)])
def test_the_time_the_consoles_address_and_what_ends_it_are_always_there(state, width, height):
    view = View(SQUARE, "square")
    view.feed(state, "0:12:34  console http://127.0.0.1:8765/?token=AbCdEfGhIjKlMnOp  Ctrl-C ends")
    text = shown(view, width, height)
    for words in ("0:12:34", "http://127.0.0.1:8765/?token=AbCdEfGhIjKlMnOp", "Ctrl-C ends"):
        assert words in text
    assert text.count("\n") <= height
