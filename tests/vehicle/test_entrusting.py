"""A payload program that has the boat: who gives it, what it may, and how it is lost."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from delfim import config
from delfim.base.errors import ConfigError
from delfim.base.modes import PAYLOADS, Mode
from delfim.base.tables import decode
from delfim.parts.payload.table import PayloadTable
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.operator.command import CommandServer
from delfim.vehicle.operator.reviews import Reviews
from delfim.vehicle.plans.mission import Mission, Waypoint
from delfim.vehicle.state import HANDSET, NoLog
from tests.parts.mavlink.mavlink_console import newest, texts
from tests.vehicle.test_reviews import sea, turn, zones

__all__ = ["sea"]

ALL = ("hold", "goto", "speed", "heading", "mission", "obstacles")
HERE = 38.6925, -9.2150
THERE = console.Goto(38.6930, -9.2150, end="hold")
EAST = console.Heading(90.0, 1.0)
MISSION = Mission(version=1, name="found", waypoint=(Waypoint(latitude_deg=38.6930, longitude_deg=-9.2150),))
SEEN = console.parse(
    b'{"command": "sight", "target": {"id": "radar 7", "latitude_deg": 38.694, "longitude_deg": -9.215, "speed_mps": 3}}'
)


def payload(*may: str) -> PayloadTable:
    return PayloadTable(command=("/bin/true",), may=may)


@pytest.fixture
def boat(make_boat):
    """A boat at sea in hold, with two programs that may have it, and one that may not; all of them speak."""
    tables = {"gradient": payload(*ALL), "shy": payload("hold", "speed"), "radar": payload("obstacles"), "sonar": payload()}
    boat = make_boat(payload=tables)
    boat.ready()
    for name in ("gradient", "shy"):
        assert says(boat, console.Alive(), name) is None
    assert boat.vehicle.on_command(console.SetMode("hold")) is None
    return boat


def says(boat, command: console.Commands, name: str = "gradient") -> str | None:
    return boat.vehicle.on_command(command, f"payload:{name}")


def given(boat, name: str = "gradient"):
    assert boat.vehicle.on_command(console.Entrust(name)) is None
    return boat


def test_the_boat_holds_for_the_program_that_it_was_given_to_and_does_what_that_asks(boat) -> None:
    given(boat)
    state = boat.state
    assert (state.helmsman, state.mode, state.reason) == ("gradient", Mode.HOLD, "operator gave the boat to payload gradient")
    operator, console_s = state.operator, state.console_s
    boat.clock.advance(1.0)
    assert says(boat, THERE) is None
    assert (state.mode, state.reason) == (Mode.GOTO, "payload gradient")
    assert says(boat, EAST) is None
    assert state.mode is Mode.HEADING
    assert says(boat, console.SetSpeed(30.0)) is None
    assert state.setpoint.speed_mps == boat.vehicle.helm.settings.control.speed.max_mps, "no faster than the boat may"
    assert says(boat, console.Upload(MISSION)) is None
    assert says(boat, console.Play()) is None
    assert state.mode is Mode.PLAY
    assert says(boat, console.Pause()) is None
    assert (state.mode, state.reason) == (Mode.HOLD, "payload gradient paused play on leg 1")
    assert says(boat, console.Continue()) is None
    assert (state.mode, state.reason) == (Mode.PLAY, "payload gradient continues")
    assert (state.operator, state.console_s) == (operator, console_s), "no program is an operator, or speaks for one"
    report = boat.vehicle.report()
    assert (report.mode, report.helmsman, report.age_s["payload gradient"]) == ("play", "gradient", 0.0)


@pytest.mark.parametrize(
    ("name", "command", "why"),
    [
        ("shy", console.Pause(), "refused: shy does not have the boat: no operator has given it"),
        ("shy", EAST, "refused: heading is not among the rights of shy, which has hold, speed"),
        ("sonar", console.Alive(), "refused: alive is not among the rights of sonar, which has none"),
        ("nobody", console.Pause(), "refused: there is no payload nobody"),
        ("gradient", console.Stop(), "refused: stop is for operators alone"),
        ("gradient", console.Entrust("gradient"), "refused: payload is for operators alone"),
        ("gradient", console.SetMode("home"), "refused: mode is for operators alone"),
        ("gradient", console.Goto(38.6930, -9.2150), 'refused: a payload goes to a point with "end": "hold"'),
        ("gradient", console.Goto(40.0, -9.2150, end="hold"), "goto refused: 145.1 km to go; up to 20 km are allowed"),
        ("gradient", console.Play(), "play refused: no mission loaded"),
        (
            "gradient",
            console.Upload(Mission(version=1, name="home", waypoint=MISSION.waypoint, then="home")),
            'refused: a mission of a payload ends with "then": "hold"',
        ),
    ],
)
def test_an_order_is_refused_with_its_reason_and_changes_nothing(boat, name, command, why) -> None:
    given(boat)
    was = boat.state.mode, boat.state.reason, boat.state.setpoint, dict(boat.state.payloads_s)
    boat.clock.advance(1.0)
    assert says(boat, command, name) == why
    assert (boat.state.mode, boat.state.reason, boat.state.setpoint, boat.state.payloads_s) == was


@pytest.mark.parametrize(
    ("end", "why"),
    [
        (lambda boat: boat.vehicle.on_command(console.SetSpeed(1.0)), "operator took it back"),
        (lambda boat: boat.vehicle.on_command(console.Play()), "operator took it back"),  # refused, and an order all the same
        (lambda boat: boat.vehicle.on_command(console.Take(), HANDSET), "operator took it back"),
        (lambda boat: boat.vehicle.on_command(console.Kill()), "operator took it back"),
        (lambda boat: boat.pass_time(5.5), "failsafe: no word from payload gradient for 5.1 s"),
        (lambda boat: spoken(boat, 12.0, operator=False), "failsafe: console silent for 10.1 s; home in 30 s"),
        (lambda boat: spoken(boat, 2.0, navigation=False), "failsafe: navigation silent for 1.1 s"),
        (lambda boat: boat.vehicle.helm.stop("shutdown"), "shutdown"),
    ],
)
def test_an_operator_the_failsafe_and_its_own_silence_take_the_boat_back(boat, end, why) -> None:
    given(boat)
    says(boat, EAST)
    end(boat)
    assert (boat.state.helmsman, boat.state.relieved) == ("", why)
    mode = boat.state.mode
    assert says(boat, THERE) == f"refused: gradient does not have the boat: {why}"
    assert boat.state.mode is mode
    assert any("payload gradient no longer has the boat" in note for note in boat.log.notes) is (why != "shutdown")


def spoken(boat, seconds: float, *, operator: bool = True, navigation: bool = True) -> None:
    """Time passes; the program, and the operator, say that they are there."""
    for _ in range(round(seconds)):
        boat.pass_time(1.0, navigation=navigation)
        says(boat, console.Alive())
        if operator:
            boat.vehicle.on_command(console.Alive())


def test_what_a_program_asks_again_and_again_is_noted_once(boat) -> None:
    given(boat)
    before = len(boat.log.notes)
    for _ in range(3):
        assert says(boat, EAST) is None
    assert [note for note in boat.log.notes[before:] if note.startswith("heading")] == ["heading: payload gradient"]
    assert boat.vehicle.on_command(EAST) is None
    assert boat.vehicle.on_command(EAST) is None
    assert boat.log.notes.count("heading: operator") == 2, "an operator's are each noted"


def test_a_program_goes_on_with_a_mission_that_was_interrupted_and_with_nothing_else(boat) -> None:
    assert boat.vehicle.on_command(EAST) is None
    given(boat)
    assert says(boat, console.Continue()) == "continue refused: heading was interrupted, which is no mission"
    assert boat.state.mode is Mode.HOLD


def test_who_is_there_keeps_the_boat_and_a_goto_that_is_done_holds_for_it(boat) -> None:
    given(boat)
    assert says(boat, console.Goto(*HERE, end="hold")) is None
    spoken(boat, 15.0)
    assert (boat.state.mode, boat.state.reason, boat.state.helmsman) == (Mode.HOLD, "goto done", "gradient")


def test_a_program_that_only_asks_for_what_it_may_not_is_silent(boat) -> None:
    given(boat)
    for _ in range(6):
        boat.pass_time(1.0)
        assert says(boat, console.Goto(40.0, -9.2150, end="hold")) is not None
    assert boat.state.relieved == "failsafe: no word from payload gradient for 5.1 s"


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("radar", "payload refused: no payload 'radar' may have the boat; there are gradient, shy"),
        ("nobody", "payload refused: no payload 'nobody' may have the boat; there are gradient, shy"),
    ],
)
def test_a_boat_is_not_given_to_who_may_not_have_it_or_is_silent(boat, name, why) -> None:
    assert boat.vehicle.on_command(console.Entrust(name)) == why
    boat.pass_time(5.5)
    assert boat.vehicle.on_command(console.Entrust("gradient")) == "payload refused: no word from gradient"
    assert boat.state.helmsman == ""
    assert boat.vehicle.on_command(SEEN) == "refused: only a payload program says this"


def test_what_a_program_sees_is_heard_in_any_mode_and_is_no_sign_of_life(boat) -> None:
    was = dict(boat.state.payloads_s)
    assert says(boat, SEEN, "radar") is None
    assert says(boat, SEEN, "shy") == "refused: obstacles is not among the rights of shy, which has hold, speed"
    assert {(each.key, each.by) for each in boat.state.heard.values()} == {("payload radar 7", "payload radar")}
    assert boat.state.payloads_s == was


def test_a_program_overrules_no_failsafe(boat) -> None:
    """An operator who chooses a mode again does not go home for a trouble; a program's order leaves that as it is."""
    given(boat)
    boat.log.why = "disk full"
    spoken(boat, 3.0)
    before = boat.vehicle.helm.troubles
    assert [trigger.name for trigger in before] == ["LOG"]
    for command in (EAST, console.Pause()):
        assert says(boat, command) is None
        assert boat.vehicle.helm.troubles is before


def test_a_restarted_boat_is_nobodys_and_holds_what_a_program_ordered_though_its_file_says_resume() -> None:
    rights = 'payload.gradient={command=["/bin/true"], may=["heading"]}'
    settings = config.load(str(Path(__file__).parents[2] / "etc/delfimx.toml"), (rights, 'failsafe.restarted.action="resume"'))
    run = Lockstep(settings, 1, lambda clock: NoLog())
    for _ in run.cycles(4):
        pass
    name, order = "payload:gradient", run.vehicle.on_command
    assert [order(console.Alive(), name), order(console.Entrust("gradient")), order(EAST, name)] == [None] * 3
    for _ in run.cycles(2):
        pass
    assert run.state.mode is Mode.HEADING
    run.restart(1.0)
    for _ in run.cycles(2):
        pass
    assert (run.state.mode, run.state.helmsman) == (Mode.HOLD, "")
    assert run.state.restarted == "it was in heading of payload gradient; hold now"
    refused = run.vehicle.on_command(EAST, name)  # of the program that was started again
    assert refused == "refused: gradient does not have the boat: no operator has given it"


def test_a_way_round_zones_is_the_programs_own(boat) -> None:
    given(boat)
    rock = config.Area(name="rock", centre=((38.6940, -9.2150),), radius_m=30.0)
    boat.vehicle.helm.plans.accept(console.SetFence(config.Zones(keep_out=(rock,))))
    assert says(boat, console.Goto(38.6955, -9.2150, end="hold")) is None
    assert boat.state.setpoint.target is None
    spoken(boat, 2.0)
    assert boat.state.reason == "payload gradient; by 1 points, as the way leads through rock"
    assert boat.state.helmsman == "gradient"


def test_its_mission_is_reviewed_within_the_zones_in_force_and_never_instead_of_an_operators(sea, counted) -> None:
    """Through the real review, slice by slice."""
    state, answers, plans = sea.state, [], sea.vehicle.helm.plans
    settings = sea.vehicle.helm.settings
    sea.vehicle.helm.settings = config.msgspec.structs.replace(settings, payload={"gradient": payload("mission")})
    begin = sea.reviews.begin
    begin("payload:gradient", console.Upload(MISSION), answers.append)
    assert answers.pop() == "refused: gradient does not have the boat: no operator has given it"
    assert sea.vehicle.on_command(console.SetFence(zones(3)), "local") is None
    counted.clear()
    state.helmsman = "gradient"
    begin("local", console.Upload(MISSION), answers.append)
    begin("payload:gradient", console.Upload(MISSION), answers.append)
    assert answers.pop() == "refused: a plan of local is being checked"
    sea.reviews.hear(console.Pause(), "payload:gradient")
    turn(sea)
    assert answers.pop() is None, "an order of a program ends no review of an operator's plan"
    assert not plans.zones.keep_in
    sea.vehicle.on_command(console.SetFence(zones(3)), "local")
    state.helmsman = "gradient"
    begin("payload:gradient", console.Upload(config.msgspec.structs.replace(MISSION, fence=zones(1))), answers.append)
    assert answers.pop() == "refused: the zones are the operator's: send the mission without a fence"
    begin("payload:gradient", console.Upload(MISSION), answers.append)
    turn(sea)
    assert answers.pop() is None
    assert (plans.mission.name, plans.zones) == ("found", zones(3))
    assert state.helmsman == "gradient"


def test_consoles_show_it_as_a_mode_of_its_name_and_give_the_boat_by_that(sea) -> None:
    settings = sea.vehicle.helm.settings
    sea.vehicle.helm.settings = config.msgspec.structs.replace(settings, payload={"gradient": payload(*ALL)})
    sea.vehicle.on_command(console.Alive(), "payload:gradient")
    sea.station.tick()
    assert sea.console.mode(PAYLOADS)[0] == 0
    assert sea.state.helmsman == "gradient"
    sea.station.tick()
    heard = sea.console.listen()
    assert newest(heard, "HEARTBEAT").custom_mode == PAYLOADS
    assert "payload gradient: operator gave the boat to payload gradient" in texts(heard)
    answers = sea.console.say("command_long", 1, 1, 512, 0, 435, 0, 0, 0, 0, 0, 0)
    named = [(m.custom_mode, m.mode_name) for m in answers if m.get_type() == "AVAILABLE_MODES"]
    assert named[-1] == (PAYLOADS, "payload gradient")
    assert sea.console.mode(PAYLOADS + 1)[1].strip() == f"no mode {PAYLOADS + 1}"
    assert sea.state.helmsman == "gradient", "what is no mode changes nothing"
    assert sea.console.mode(Mode.HOLD)[0] == 0
    assert (sea.state.helmsman, sea.state.reason) == ("", "operator")


def test_over_the_socket_its_answer_is_brief(boat) -> None:
    given(boat)
    wrote: list[bytes] = []
    loop = SimpleNamespace(call_soon=lambda call: None)
    server = CommandServer(boat.vehicle.on_command, Reviews(boat.vehicle, boat.vehicle.on_command, loop), lambda: b"{}", 1)
    link = SimpleNamespace(write=wrote.append, get_write_buffer_size=lambda: 0, resume_reading=lambda: None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("asyncio.get_running_loop", lambda: loop)
        connection = server.connection()
    connection.connection_made(link)
    connection.data_received(b'{"command": "ordered", "payload": "gradient", "order": {"command": "pause"}}\n')
    assert json.loads(wrote.pop()) == {"ok": True, "reason": "", "state": {}}


def test_names_that_a_console_could_not_tell_apart_are_refused() -> None:
    tree = {
        "boat": {"name": "b"},
        "payload": {name: {"command": ["/bin/true"], "may": ["hold"]} for name in ("Sonar", "sonar")},
    }
    with pytest.raises(ConfigError, match="a console shows each as a mode of its name"):
        decode(tree, config.Vehicle, "file")
