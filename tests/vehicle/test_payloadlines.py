"""The orders of payload programs on their way from a line of JSON to a command, whatever they write."""

import json
import math

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.vehicle import console
from delfim.vehicle.orders import payloadlines
from delfim.vehicle.orders.entrusting import RIGHTS
from delfim.vehicle.orders.payloadlines import ORDER_BYTES, OrderBudget, ordered, values, word_of
from delfim.vehicle.plans.mission import Mission, Waypoint

degrees = st.floats(-89.0, 89.0)
speeds = st.none() | st.floats(0.0, 30.0)
ORDERS = st.one_of(
    st.builds(console.Goto, degrees, degrees, speeds, st.just("hold")),
    st.builds(console.Heading, degrees, speeds),
    st.builds(console.Course, degrees, speeds),
    st.builds(console.SetSpeed, speeds),
    st.builds(console.Play, st.integers(0, 1000)),
    st.builds(
        lambda places: console.Upload(Mission(version=1, name="a", waypoint=tuple(Waypoint(*place) for place in places))),
        st.lists(st.tuples(degrees, degrees), min_size=1, max_size=5),
    ),
    st.sampled_from([console.Pause(), console.Continue(), console.Alive()]),
)
KEYS = st.sampled_from(
    ["command", "heading_deg", "latitude_deg", "longitude_deg", "speed_mps", "mission", "target", "end", "leg"]
)
SCALARS = st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=20) | st.sampled_from([*console.KINDS])
TREES = st.dictionaries(
    KEYS, st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3))
)


@settings(max_examples=60)
@given(ORDERS)
def test_an_order_comes_back_as_it_was_written(command: console.Commands) -> None:
    line = msgspec.json.encode(command)
    assert ordered(line) == command
    assert word_of(line) == command.__struct_config__.tag


@settings(max_examples=60)
@given(TREES.map(lambda tree: json.dumps(tree).encode()) | st.binary(max_size=200).map(lambda text: b'{"command":' + text))
def test_whatever_it_writes_is_a_command_in_range_or_refused_in_words(line: bytes) -> None:
    """Python writes NaN and Infinity, which are no JSON."""
    try:
        command = ordered(line)
    except FormatError:
        return
    assert type(command) in RIGHTS or isinstance(command, console.Alive)
    numbers = [each for each in msgspec.structs.astuple(command) if isinstance(each, float)]
    assert all(math.isfinite(each) and abs(each) <= 360.0 for each in numbers)
    assert not isinstance(command, console.Goto) or command.end is not None


@given(
    st.dictionaries(st.from_regex("[a-z_]{1,8}", fullmatch=True).filter(lambda name: name != "command"), SCALARS, max_size=4)
)
def test_values_are_never_taken_for_an_order(found: dict[str, object]) -> None:
    for line in (json.dumps(found).encode(), json.dumps({**found, "text": '"command": "stop"'}).encode()):
        assert word_of(line) is None


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b'{"command": "heading", "heading_deg": NaN}', "command not understood: it is not JSON"),
        (b'{"command": "heading", "heading_deg": 1e999}', "command not understood: it is not JSON"),
        (b'{"command": "goto", "latitude_deg": 38.7}', "goto needs a latitude and a longitude, or neither"),
        (b'{"command": "goto", "latitude_deg": 95, "longitude_deg": 0}', "latitude_deg must be -89.0 to 89.0"),
        (b'{"command": "heading"}', "heading needs heading_deg"),
        (b'{"command": "sail"}', "there is no command 'sail'"),
        (b'{"command": "kill"}', "kill is for operators alone"),
        (b'{"command": "manual", "starboard": 1, "port": 1}', "manual is for operators alone"),
        (b'{"command": "ordered", "payload": "other", "order": {"command": "pause"}}', "ordered is for operators alone"),
        (b'{"command": "upload", "mission": ' + b"[" * ORDER_BYTES, f"an order is a line of up to {ORDER_BYTES} bytes"),
        (b'{"command": "upload", "mission": ' + b"[" * 5000, "it is not JSON"),
    ],
)
def test_an_order_that_cannot_be_is_refused_with_its_reason(line: bytes, why: str) -> None:
    with pytest.raises(FormatError) as refusal:
        ordered(line)
    assert why in str(refusal.value)
    assert word_of(line) is not None
    assert values(line) is None or b"{" not in line[1:]


def test_a_program_has_a_budget_of_orders_and_one_of_vessels() -> None:
    budget, sight = OrderBudget(), console.Sight(console.SeenVessel("7", 38.0, -9.0))
    granted = [not budget.exceeded(console.Pause(), i / 100.0) for i in range(1000)]
    assert sum(granted) == payloadlines.ORDERS[1] + 9.9 * payloadlines.ORDERS[0] // 1
    assert budget.exceeded(console.Pause(), 9.99) == "more than 5 orders a second"
    assert [budget.exceeded(sight, 9.99) for _ in range(41)][-2:] == ["", "more than 20 vessels a second"]
