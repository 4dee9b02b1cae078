"""Typed commands and the state, as they go over a wire."""

import contextlib
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.vehicle import console
from delfim.vehicle.orders import handlers
from delfim.vehicle.snapshot import in_json


@pytest.mark.parametrize(
    ("line", "command"),
    [
        ('{"command":"alive"}', console.Alive()),
        ('{"command":"stop"}', console.Stop()),
        ('{"command":"mode","mode":"hold"}', console.SetMode("hold")),
        ('{"command":"manual","starboard":0.5,"port":-0.5}', console.Manual(0.5, -0.5)),
        ('{"command":"heading","heading_deg":90}', console.Heading(90.0)),
        ('{"command":"speed","speed_mps":1.5}', console.SetSpeed(1.5)),
        ('{"command":"goto","latitude_deg":38.7,"longitude_deg":-9.2}', console.Goto(38.7, -9.2)),
        ('{"command":"play","leg":2}', console.Play(2)),
        ('{"command":"state"}', console.TellState()),
    ],
)
def test_every_command_has_one_spelling(line, command):
    assert console.parse(line.encode()) == command


@pytest.mark.parametrize(
    "line",
    [
        "",
        "nonsense",
        "{}",
        '{"command":"fly"}',
        '{"command":"manual","starboard":1.1,"port":0}',
        '{"command":"manual","starboard":NaN,"port":0}',
        '{"command":"heading","heading_deg":"north"}',
        '{"command":"goto","latitude_deg":91}',
        '{"command":"play","leg":-1}',
        '{"command":"stop","now":true}',
    ],
)
def test_what_is_not_understood_is_refused_in_words(line):
    with pytest.raises(FormatError, match="not understood"):
        console.parse(line.encode())


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("nonsense", "it is not JSON"),
        ("[" * 100_000, "it is not JSON"),
        ("{}", "it names no command"),
        ('{"command":"fly"}', "there is no command 'fly'"),
        ('{"command":"heading"}', "heading needs heading_deg"),
        ('{"command":"heading","heading_deg":null}', "heading_deg must be -360.0 to 360.0"),
        ('{"command":"manual","starboard":1.1,"port":0}', "starboard must be -1.0 to 1.0"),
        ('{"command":"speed","speed_mps":"fast"}', "speed_mps must be 0.0 to 30.0"),
        ('{"command":"goto","latitude_deg":38.69}', "goto needs a latitude and a longitude, or neither"),
        ('{"command":"stop","now":true}', "stop has no 'now'"),
        ('{"command":"set","key":"a","value":[]}', "value must be a number or text of up to 64 characters"),
        (
            '{"command":"upload","mission":{}}',
            "mission must be a table of version, name, waypoint, path, action, then, opens, fence",
        ),
    ],
)
def test_a_refusal_is_said_in_our_words_and_not_in_the_librarys(line, why):
    with pytest.raises(FormatError) as refusal:
        console.parse(line.encode())
    assert str(refusal.value) == f"command not understood: {why}"


@given(st.binary(max_size=200))
def test_no_bytes_raise_anything_else(line):
    with contextlib.suppress(FormatError):
        console.parse(line)


def test_the_state_is_json_with_ages_and_words(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(45.0, 1.0))
    boat.clock.advance(0.25)
    state = json.loads(console.answer(None, in_json(boat.vehicle.report())))["state"]
    assert state["mode"] == "heading"
    assert state["latitude_deg"] == pytest.approx(38.6925)
    assert state["reference"]["heading_deg"] == pytest.approx(45.0)
    assert state["age_s"]["navigation"] == pytest.approx(0.25)
    assert state["age_s"]["guest"] is None
    assert state["sysstat"]["propeller_port"]["status"] == "good"


def test_an_empty_boat_has_a_state_too(boat):
    state = json.loads(console.answer(None, in_json(boat.vehicle.report())))["state"]
    assert state["latitude_deg"] is None
    assert state["age_s"]["navigation"] is None


def test_heading_is_shown_on_the_compass(boat):
    boat.navigate(heading_rad=math.radians(359.9999))
    assert 0.0 <= (boat.vehicle.report().heading_deg or 0.0) <= 360.0


def test_what_may_be_asked_is_obeyed() -> None:
    """But for those that the loop answers: they only ask for the state, are the program's own, or of payload programs."""
    others = {
        console.Entrust,
        console.Sight,
        console.Sampled,
        console.Tell,
        console.OfPayload,
        console.TellState,
        console.Watch,
        console.Return,
    }
    assert set(handlers.OBEYED) == set(console.KINDS.values()) - others


@pytest.mark.parametrize(
    ("kind", "numbers", "why"),
    [
        (console.Heading, {"heading_deg": math.nan}, "heading_deg must be "),
        (console.Heading, {"heading_deg": 361.0}, "heading_deg must be "),
        (console.Goto, {"latitude_deg": 38.69}, "goto needs a latitude and a longitude, or neither"),
        (console.Play, {"leg": -1}, "leg must be "),
        (console.Reset, {"node": 300}, "node must be "),
    ],
)
def test_numbers_that_are_no_command_are_refused_in_words(kind, numbers, why):
    with pytest.raises(FormatError) as refusal:
        console.asked(kind, **numbers)
    assert str(refusal.value).startswith(why)
