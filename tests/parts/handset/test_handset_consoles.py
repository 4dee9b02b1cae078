"""The hand-set and the consoles at once, by their real link: who commands, and that everybody is told."""

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.vehicle import console
from delfim.vehicle.loop import HELD_BY_HAND
from delfim.vehicle.state import HANDSET
from tests.parts.handset.test_handset import DEVICE, FREE, KILL, ON, TAKEN, HandsetPlayed
from tests.parts.mavlink.mavlink_console import newest, texts
from tests.parts.mavlink.test_mavlink_helm import ACCEPTED, LATER, MESSAGES, at_sea

HEADING = (43002, 1, 90.0)


@pytest.fixture
def sea(make_boat):
    table = config.HandsetTable(device=DEVICE, kill=config.Switch(KILL))
    sea = at_sea(lambda: make_boat(handset=table), None)
    sea.hand = HandsetPlayed(sea.boat, "crsf")
    sea.hand.hold(FREE)
    assert sea.consoles["owner"].command(*HEADING)[0] == ACCEPTED
    assert sea.state.mode is Mode.HEADING
    return sea


def told(sea):
    """What the owner's console hears until the station has said everything."""
    before = len(sea.radio.sent)
    sea.boat.clock.advance(1.1)
    sea.station.tick()
    while sea.station.turn():
        pass
    return sea.consoles["owner"].listen(before)


def test_a_console_that_commands_is_refused_in_words_while_the_hand_set_has_the_boat(sea):
    sea.hand.hold(TAKEN)
    assert sea.state.operator == HANDSET
    for number, *numbers in (HEADING, (176, 1, 3), (32100, 0, 1), (300, 0), (400, 1)):
        result, words = sea.consoles["owner"].command(number, *numbers)
        assert (result, words.endswith(f"refused: {HELD_BY_HAND}")) == (LATER, True)
    assert sea.state.mode is Mode.MANUAL


@pytest.mark.parametrize(("name", "numbers"), MESSAGES, ids=lambda each: each if isinstance(each, str) else "")
def test_no_other_message_of_a_console_changes_anything_meanwhile(sea, name, numbers):
    sea.hand.hold(TAKEN)
    before = sea.state.setpoint, sea.state.mode, sea.boat.vehicle.helm.plans.mission
    sea.consoles["owner"].say(name, *numbers)
    assert (sea.state.setpoint, sea.state.mode, sea.boat.vehicle.helm.plans.mission) == before
    assert sea.state.operator == HANDSET


def test_anybody_may_stop_and_kill_meanwhile(sea):
    sea.hand.hold(TAKEN)
    assert sea.consoles["other"].mode(Mode.IDLE)[0] == ACCEPTED
    assert sea.state.mode is Mode.IDLE
    assert sea.consoles["other"].command(185, 1)[0] == ACCEPTED
    assert sea.state.killed.reason == "operator: commanded"
    assert sea.state.operator == HANDSET


def test_every_console_is_told_who_commands(sea):
    assert newest(told(sea), "NAMED_VALUE_INT").value == 250
    sea.hand.hold(TAKEN)
    heard = told(sea)
    assert newest(heard, "NAMED_VALUE_INT").value == 1, "the boat's own number: its hand-set"
    assert "hand-set commands" in texts(heard)
    sea.hand.hold(FREE)
    heard = told(sea)
    assert newest(heard, "NAMED_VALUE_INT").value == 250
    assert "idle: operator gave the boat back: hand-set" in texts(heard)


def test_a_console_goes_on_after_the_hand_set_gave_the_boat_back(sea):
    sea.hand.hold(TAKEN)
    sea.hand.hold(FREE)
    assert sea.consoles["owner"].command(*HEADING)[0] == ACCEPTED


def test_a_kill_is_told_with_its_reason_and_cleared_by_a_console(sea):
    sea.hand.hold(FREE | {KILL: ON})
    assert "idle: kill: hand-set: its kill switch" in texts(told(sea))
    for command, why in (
        (HEADING, "heading refused: kill: hand-set: its kill switch"),
        ((185, 0), "clear refused: hand-set still says kill; release it first"),
    ):
        result, words = sea.consoles["owner"].command(*command)
        assert (result, words.strip()) == (LATER, why)
    sea.hand.hold(FREE)
    assert sea.consoles["other"].command(185, 0)[0] == LATER, "who commands, clears"
    assert sea.consoles["owner"].command(185, 0)[0] == ACCEPTED
    assert not sea.state.killed.reason
    assert sea.consoles["owner"].command(*HEADING)[0] == ACCEPTED


def test_half_a_kill_is_none(sea):
    assert sea.consoles["owner"].command(185, 0.5)[0] == 2
    assert sea.state.mode is Mode.HEADING


def test_the_guest_is_not_followed_while_the_hand_set_has_the_boat(sea):
    sea.hand.hold(TAKEN)
    sea.boat.vehicle.on_guest(b'{"heading_deg": 45, "speed_mps": 1.5}')
    refused = sea.boat.vehicle.on_command(console.SetMode("grex"), "console 250")
    assert refused == f"refused: {HELD_BY_HAND}"
    sea.hand.hold(TAKEN, 1.0)
    assert sea.state.mode is Mode.MANUAL
