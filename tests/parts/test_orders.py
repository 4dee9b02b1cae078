"""Orders of a part: checked as keys of the vehicle's file, guarded as its modes, admitted as the boat's own."""

import math
from functools import partial
from pathlib import Path

import pytest

from delfim import config
from delfim.base.errors import ConfigError, FormatError
from delfim.console.boats.fleet import Fleet
from delfim.console.terminal.describe import describe
from delfim.console.terminal.drive import command
from delfim.parts.mavlink.codec import ownorders, wire
from delfim.parts.mavlink.received import commands
from delfim.parts.mavlink.station import Station
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.foreign import breaking_off
from delfim.vehicle.state import HANDSET, NoLog
from tests.parts.laboratory import ROOT, installed, known, laboratory

__all__ = ["laboratory"]
WINCH = ('parts.example_order="1.0"', 'sensors.names=["sysstat", "example_order"]', 'example_order.interface="canloop:winch"')


def sailed(run: Lockstep, for_s: float) -> Lockstep:
    for _ in run.cycles(for_s):
        pass
    return run


def boat(*values: str) -> Lockstep:
    return sailed(Lockstep(config.load(ROOT / "etc/delfimx.toml", values or WINCH), 1, lambda clock: NoLog()), 5.0)


def order(run: Lockstep, name: str = "pay_out", **values: console.Values) -> str | None:
    return run.command(console.parse(console._encode(console.PartOrder(name, values))))


def test_an_order_reaches_the_device_and_its_values_come_back(laboratory):
    installed(laboratory, "order")
    run = boat()
    assert order(run, rope_m=3) is None
    assert run.state.operator == "local", "it is a word of the operator"
    sailed(run, 10.0)
    assert run.state.measured["rope_m"][0] == pytest.approx(3.0)
    assert run.command(console.Heading(90.0, 2.0)) is None
    sailed(run, 20.0)
    assert order(run) == "order refused: pay_out: the boat is faster than 1 m/s"
    assert order(run, "station") is None
    assert (run.state.mode.name, run.state.reason) == ("HOLD", "operator paused heading")
    assert sailed(run, 10.0).state.measured["rope_m"][0] == 0.0
    assert not run.state.parts["example_order"].failed


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("pay_out", {"rope_m": 51}, "pay_out.rope_m: 51 is not allowed (allowed: 0.0 to 50.0)"),
        ("pay_out", {"rope_m": "far"}, 'pay_out.rope_m: "far" is text, not a number (allowed: 0.0 to 50.0)'),
        ("pay_out", {"rope": 3}, "pay_out.rope: unknown key; did you mean rope_m?"),
        ("pay_out", {"colour": True}, "pay_out.colour: unknown key (allowed: rope_m, rate_mps)"),
        ("pay_otu", {}, "there is no order 'pay_otu'; did you mean pay_out?"),
        ("ring", {}, "there is no order 'ring'; there are pay_out, station"),
    ],
)
def test_what_makes_no_sense_is_refused_in_the_words_of_the_file(laboratory, name, values, words):
    installed(laboratory, "order")
    run = boat()
    assert order(run, name, **values) == f"order refused: {words}"
    assert not run.state.parts["example_order"].failed, "which is no fault of the part"


def test_it_is_below_the_kill_and_the_hand_set(laboratory):
    installed(laboratory, "order")
    run = boat()
    assert run.command(console.Kill(reason="a swimmer")) is None
    assert order(run) == "order refused: kill: operator: a swimmer"
    assert run.command(console.Clear()) is None
    run.state.operator = HANDSET
    assert order(run) == "refused: the hand-set has the boat, until its take-over switch gives it back"


def test_a_boat_without_the_part_knows_no_order():
    assert order(boat("boat.id=1")) == "order refused: there is no order 'pay_out'; there are none"


ODD = """
from delfim.api import *


class Nothing(Table, frozen=True):
    '''Nothing.'''


def does(asked):
    {}


PART = Part("odd", orders=(OrderRow("odd", Nothing, "odd:does"),))
"""


def odd(place: Path, does: str) -> Lockstep:
    known(place, "odd", "odd:PART")
    (place / "odd.py").write_text(ODD.format(does))
    return boat('parts.odd="1.0"')


@pytest.mark.parametrize(
    ("does", "words"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("while True: pass", "it took more than 0.01 s"),
        ("return 3", "it answered 3, which is no reason and no order that a part may give"),
        ("return ''", "it answered '', which is no reason and no order that a part may give"),
        ("from delfim.vehicle import console; return console.Kill()", "which is no reason and no order that a part may"),
        ("return Heading(float('nan'))", "heading_deg must be -360.0 to 360.0"),
        ("return Goto(100.0, 0.0)", "latitude_deg must be -89.0 to 89.0"),
    ],
)
def test_one_that_raises_hangs_or_lies_is_refused_and_switched_off(laboratory, monkeypatch, does, words):
    run = odd(laboratory, does)
    # A busy machine may take long for the others.
    monkeypatch.setattr("delfim.vehicle.foreign.BROKEN_S", 0.01 if does.startswith("while") else 60.0)
    monkeypatch.setattr("delfim.vehicle.foreign._limit", [breaking_off])
    refused = [order(run, "odd") or "" for _ in range(5)]
    assert refused[0].startswith("order refused: part odd: order odd: ")
    assert all(words in each for each in refused)
    assert refused[-1] == f"order refused: {run.state.parts['odd'].off}"
    assert run.state.parts["odd"].failed == 3, "then it is not called any more"
    assert run.command(console.Heading(90.0, 1.0)) == f"heading refused: {run.state.parts['odd'].off}"


def test_what_it_asks_of_the_boat_is_admitted_as_the_operators_own(laboratory):
    run = odd(laboratory, "return SetMode('path') if asked.state.armed else Heading(90.0, 1.0)")
    assert order(run, "odd") is None
    assert (run.state.mode.name, run.state.reason) == ("HEADING", "operator")
    assert (order(run, "odd") or "").startswith("path refused: ")
    assert run.state.mode.name == "HEADING"


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('"pay_out", PayOut', '"Pay out", PayOut', "'Pay out' is no name for an order: small letters, digits and _"),
        ("31010", "400", "order pay_out has number 400; MAVLink has 31010 to 31014 for users"),
        (
            '"example_order.winch:station"',
            '"example_order.winch:station", 31010',
            "its order station has number 31010, as pay_out has",
        ),
        ("ge=0.1, le=1.0", "ge=0.1", "key rate_mps of an order with a number is a number from (ge) to (le)"),
    ],
)
def test_a_row_that_makes_no_sense_is_refused(laboratory, before, after, words):
    installed(laboratory, "order")
    row = laboratory / "example_order/__init__.py"
    row.write_text(row.read_text().replace(before, after))
    with pytest.raises(ConfigError, match=f"parts.example_order: {words}".replace("(", r"\(").replace(")", r"\)")):
        boat()


def test_two_parts_have_no_order_of_one_name(laboratory):
    installed(laboratory, "order")
    known(laboratory, "odd", "odd:PART")
    (laboratory / "odd.py").write_text(ODD.format("pass").replace('OrderRow("odd"', 'OrderRow("pay_out"'))
    with pytest.raises(ConfigError, match=r"parts.odd: its order pay_out has the name of an order of example_order"):
        boat(*WINCH, 'parts.odd="1.0"')


def test_a_console_is_told_of_it_and_gives_it_by_its_name(laboratory):
    """The gateway and the boat's station; only the sockets between them are left out."""
    installed(laboratory, "order")
    run = boat()
    way, home = ("udp", "127.0.0.1", 14550), ("127.0.0.1", 14550)
    up, down, answers = list[bytes](), list[bytes](), list[tuple[bool, str]]()
    station = Station(run.vehicle, run.order, lambda data, address: down.append(data), None)
    fleet = Fleet(run.clock, lambda address, data: up.append(data), lambda told: None)

    def talk(for_s: float) -> None:
        for _ in run.cycles(for_s):
            station.tick()
            fleet.tick()
            for data in [*up]:
                station.receive(data, home)
            while station.turn():
                pass
            for data in [*down]:
                fleet.receive(way, data)
            up.clear()
            down.clear()

    def asked(**numbers: float) -> tuple[bool, str]:
        words = {"name": "pay_out", "values": numbers}
        fleet.command(run.settings.boat.id, "order", words, lambda well, why: answers.append((well, why)))
        talk(2.0)
        return answers.pop()

    station.receive(wire.Sender(200, 190, None, lambda: 0).pack(wire.dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)), home)
    talk(7.0)
    offered = {each["name"]: each["keys"] for each in fleet.snapshot()[0]["orders"] if each["name"]}
    assert offered == {"pay_out": (("rope_m", 0.0, 50.0, 5.0), ("rate_mps", 0.1, 1.0, 0.5)), "station": ()}
    assert asked(rope_m=2.5, rate_mps=0.3) == (True, "")
    talk(10.0)
    assert run.state.measured["rope_m"][0] == pytest.approx(2.5)
    assert asked(rope_m=1.0) == (True, ""), "the rate is what the part says"
    assert asked(rope_m=70) == (False, "order refused: pay_out.rope_m: 70 is not allowed (allowed: 0.0 to 50.0)")
    assert asked(colour=1.0)[1].startswith("order refused: pay_out.colour: unknown key")
    assert asked(rope_m=math.pi, rate_mps=1.0 / 3.0) == (True, "")
    order = partial(commands.of_part, run.vehicle.helm.orders["pay_out"].row)
    for numbers, words in (((1.0, 1.0, 3.0), "pay_out takes 2 numbers"), ((math.inf,), "infinity is no number")):
        with pytest.raises(FormatError, match=words):
            order(commands.Order(31010, numbers, 1), None)


@pytest.mark.parametrize(
    "keys",
    [
        '"name"',
        '"keys":[["rope_m",0,9]]',
        '"keys":[["rope_m",0,9,NaN]]',
        '"keys":[["rope_m",3,2,3]]',
        '"keys":[["rope_m",0,1e300,5]]',
        f'"keys":[{",".join(["[1,0,1,0]"] * 9)}]',
        '"title":7',
    ],
)
def test_what_a_boat_tells_of_its_orders_is_taken_if_it_makes_sense(keys):
    message = ownorders.told(1, ownorders.Offer("order"), 1)
    assert ownorders.offered(message) == (1, 1, ownorders.Offer("order"))
    message.payload[2:] = f'{{"command":"order",{keys}}}'.encode()
    with pytest.raises(FormatError, match="no offer"):
        ownorders.offered(message)
    for place, count in ((0, 1), (2, 1), (1, 200)):
        with pytest.raises(FormatError, match="no offer"):
            ownorders.offered(ownorders.told(place, ownorders.Offer("order"), count))


def test_an_order_that_a_form_cannot_ask_for_is_given_by_others_and_not_offered(laboratory):
    known(laboratory, "odd", "odd:PART")
    (laboratory / "odd.py").write_text(ODD.format("pass").replace("'Nothing.'''", "'Nothing.'''\n    song: str"))
    run = boat('parts.odd="1.0"')
    assert ownorders.offers([run.vehicle.helm.orders["odd"].row]) == ownorders.own_offers()
    assert order(run, "odd", song="sea") is None


def test_describe_explains_its_keys(laboratory):
    installed(laboratory, "order")
    page = describe(config.kind_of({"parts": {"example_order": "1.0"}}, "lab.toml"))
    assert (
        "## The order `pay_out`\n\n`delfim drive FILE order pay_out KEY=VALUE ...`; by MAVLink 31010.\n\nLet out rope" in page
    )
    assert "| `rope_m` | `5.0` | 0.0 to 50.0 | that shall be out |\n" in page


def test_the_words_of_a_terminal():
    told = {"command": "order", "name": "pay_out", "values": {"rope_m": 3, "line": "port", "slowly": True}}
    assert command(["order", "pay_out", "rope_m=3", "line=port", "slowly=true"]) == told
    with pytest.raises(FormatError, match=r"'3' is not KEY=VALUE: order name \[KEY=VALUE \.\.\.\]"):
        command(["order", "pay_out", "3"])
