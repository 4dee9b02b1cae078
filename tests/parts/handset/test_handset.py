"""The hand-set as an operator: who has the boat, neutral before thrust, loss in each of its ways, and the kill."""

import pytest

from delfim import config
from delfim.base.modes import Mode
from delfim.parts.handset.operator import Debounced, Handset, fraction, open_handset
from delfim.vehicle import console
from delfim.vehicle.links import Links
from delfim.vehicle.loop import HELD_BY_HAND
from delfim.vehicle.state import HANDSET, Killed, Line, Plan, StartConditions, State, Waypoint
from tests.parts.handset import receivers

DEVICE = "/dev/receiver"
TAKE, KILL = 5, 6
ON, OFF = 2000.0, 1000.0
AHEAD = {3: 2012.0}
PLAN = Plan("", (Waypoint(50.0, 0.0, 1.5, 5.0), Waypoint(50.0, 50.0, 1.5, 5.0)), (Line(0.0, 0.0, 50.0, 0.0, 1.5),))
FREE = {TAKE: OFF, KILL: OFF}
TAKEN = {TAKE: ON, KILL: OFF}


class HandsetPlayed:
    """A hand-set at the other end of the boat's line, its receiver's frames come at 50 Hz."""

    def __init__(self, boat, protocol):
        self.boat, self.protocol = boat, protocol
        self.flags, self.quality_pct, self.cut = 0, 99, False

    def frames(self, pulses):
        if self.cut:
            return b""
        if self.protocol == "sbus":
            return receivers.sbus(pulses, self.flags)
        link = receivers.crsf_link(self.quality_pct)
        return link + (receivers.crsf(pulses) if self.quality_pct else b"")

    def hold(self, pulses, seconds=0.5):
        """Sticks and switches in this position for this time."""
        boat = self.boat
        for tick in range(round(seconds * 50)):
            boat.clock.advance(0.02)
            if data := self.frames(pulses):
                boat.lines[DEVICE].put(data)
            boat.attend()
            if tick % 10 == 0:
                boat.navigate()
            if tick % 50 == 0:
                boat.report()
            if tick % 5 == 0:
                boat.vehicle.on_watchdog()


@pytest.fixture(params=["crsf", "sbus"])
def protocol(request):
    return request.param


@pytest.fixture
def hand(make_boat, protocol):
    return played(make_boat, protocol)


def played(make_boat, protocol, **more):
    table = config.HandsetTable(device=DEVICE, protocol=protocol, kill=config.Switch(KILL), **more)
    boat = make_boat(handset=table)
    boat.ready()
    return HandsetPlayed(boat, protocol)


def mission(hand, operator="console 7"):
    """Another operator sails the boat."""
    assert hand.boat.vehicle.on_command(console.Heading(90.0, 1.0), operator) is None


def thrust(hand):
    starboard, port = hand.boat.propellers()
    return starboard.rpm, port.rpm


def test_the_switch_takes_the_boat_from_a_console_that_commands(hand):
    hand.hold(FREE)
    mission(hand)
    hand.hold(FREE, 2.0)
    assert hand.boat.state.mode is Mode.HEADING
    hand.hold(TAKEN, 0.1)
    assert (hand.boat.state.mode, hand.boat.state.operator) == (Mode.MANUAL, HANDSET)
    hand.hold(TAKEN, 2.0)
    assert thrust(hand) == (0, 0)
    hand.hold(TAKEN | AHEAD, 3.0)
    assert thrust(hand) == (1200, 1200)


def test_it_drives_a_boat_that_no_console_ever_spoke_to(hand):
    hand.hold(TAKEN)
    hand.hold(TAKEN | AHEAD | {1: 1756.0}, 3.0)  # half to starboard
    starboard, port = thrust(hand)
    assert (starboard, port) == (600, 1200)
    hand.hold(TAKEN | {3: 988.0}, 5.0)
    assert thrust(hand) == (-1200, -1200)


@pytest.mark.parametrize("mode", Mode, ids=lambda mode: mode.name)
def test_it_takes_and_kills_the_boat_in_every_mode(make_boat, mode):
    hand = played(make_boat, "crsf")
    hand.hold(FREE)
    state, helm = hand.boat.state, hand.boat.vehicle.helm
    state.setpoint = state.setpoint._replace(plan=PLAN, track=((-20.0, 0.0),), guest_heading_rad=0.5, guest_speed_mps=1.0)
    for switches, reached in ((TAKEN, Mode.MANUAL), (FREE | {KILL: ON}, Mode.IDLE)):
        hand.hold(FREE)
        state.guest_s = hand.boat.clock.monotonic_s()
        helm.enter(mode, "test")
        hand.hold(switches, 0.1)
        assert state.mode is reached
    assert state.reason == "kill: hand-set: its kill switch"


def test_a_switch_counts_after_three_equal_readings_in_a_row(hand):
    hand.hold(FREE)
    hand.hold(TAKEN, 0.04)
    hand.hold(FREE, 0.02)
    hand.hold(TAKEN, 0.04)
    assert hand.boat.state.operator == ""
    hand.hold(TAKEN, 0.02)
    assert hand.boat.state.operator == HANDSET


def test_a_switch_between_its_positions_stays_as_it_was(hand):
    hand.hold(TAKEN)
    hand.hold(TAKEN | {TAKE: 1500.0}, 1.0)
    assert hand.boat.state.operator == HANDSET


def test_sticks_that_are_pushed_as_the_boat_is_taken_go_to_the_middle_first(hand):
    hand.hold(FREE | AHEAD)
    hand.hold(TAKEN | AHEAD, 2.0)
    assert thrust(hand) == (0, 0)
    hand.hold(TAKEN, 0.1)
    hand.hold(TAKEN | AHEAD, 3.0)
    assert thrust(hand) == (1200, 1200)


def test_others_are_refused_while_it_has_the_boat_but_anybody_may_stop_it(hand):
    hand.hold(TAKEN)
    hand.hold(TAKEN | AHEAD, 3.0)
    boat = hand.boat.vehicle
    for command in (console.Heading(0.0), console.Take(), console.Manual(0.0, 0.0), console.Leave(), console.ShutDown()):
        assert boat.on_command(command, "console 7") == f"refused: {HELD_BY_HAND}"
    assert boat.on_command(console.Alive(), "console 7") is None
    assert boat.on_command(console.Stop(), "console 7") is None
    assert (hand.boat.state.mode, hand.boat.state.operator) == (Mode.IDLE, HANDSET)
    hand.hold(TAKEN | AHEAD, 3.0)
    assert hand.boat.state.mode is Mode.IDLE, "a stick that stays pushed does not undo a stop"
    hand.hold(TAKEN, 0.5)
    hand.hold(TAKEN | AHEAD, 3.0)
    assert hand.boat.state.mode is Mode.MANUAL


def test_it_gives_the_boat_back_in_idle_and_a_console_goes_on(hand):
    hand.hold(TAKEN)
    hand.hold(TAKEN | AHEAD, 1.0)
    hand.hold(FREE | AHEAD, 0.1)
    state = hand.boat.state
    assert (state.mode, state.reason, state.operator) == (Mode.IDLE, "operator gave the boat back: hand-set", "")
    assert thrust(hand) == (0, 0)
    mission(hand)
    assert state.operator == "console 7"


def lose(hand, how):
    match how:
        case "radio" if hand.protocol == "sbus":
            hand.flags = 0x0C
        case "radio":
            hand.quality_pct = 0
        case "wire":
            hand.cut = True
        case "frames lost on the air" if hand.protocol == "sbus":
            hand.flags = 0x04
        case _:
            hand.cut = True


@pytest.mark.parametrize("how", ["radio", "wire", "frames lost on the air"])
def test_a_lost_hand_set_ends_its_thrust_at_once_and_then_is_a_manual_silence(hand, how):
    hand.hold(TAKEN)
    hand.hold(TAKEN | AHEAD, 3.0)
    lose(hand, how)
    hand.hold(TAKEN | AHEAD, 0.6)
    state = hand.boat.state
    assert thrust(hand) == (0, 0)
    assert state.mode is Mode.MANUAL
    assert state.reason.startswith(f"no thrust: {HANDSET} ")
    hand.hold(TAKEN | AHEAD, 5.0)
    assert state.mode is Mode.IDLE
    assert state.reason.startswith("no manual command for 5.")
    assert [notice.name for notice in state.notices][-1:] == ["handset_silent"]
    assert not state.killed.reason


def test_the_reason_tells_a_lost_radio_from_a_cut_wire(hand, protocol):
    hand.hold(TAKEN)
    lose(hand, "radio")
    hand.hold(TAKEN, 1.5)
    told = {"sbus": "the receiver's failsafe flag", "crsf": "the quality of its radio is 0 %"}[protocol]
    assert next(n.reason for n in hand.boat.state.notices if n.name == "handset_silent").endswith(f" s: {told}")
    hand.flags, hand.quality_pct = 0, 99
    hand.hold(TAKEN, 5.0)
    assert not hand.boat.state.notices
    hand.cut = True
    hand.hold(TAKEN, 1.5)
    (notice,) = hand.boat.state.notices
    assert notice.reason.startswith("hand-set silent for 1.")


def test_sticks_in_the_middle_are_no_loss(hand):
    hand.hold(TAKEN, 20.0)
    assert hand.boat.state.mode is Mode.MANUAL
    assert not hand.boat.state.notices


def test_a_console_may_command_while_the_hand_set_is_lost_and_the_switch_takes_the_boat_when_it_is_back(hand):
    hand.hold(TAKEN)
    hand.cut = True
    hand.hold(TAKEN, 1.0)
    mission(hand)
    hand.hold(TAKEN, 2.0)
    assert hand.boat.state.mode is Mode.HEADING
    hand.cut = False
    hand.hold(TAKEN | AHEAD, 2.0)
    assert (hand.boat.state.mode, hand.boat.state.operator) == (Mode.MANUAL, HANDSET)
    assert thrust(hand) == (0, 0), "a receiver that comes back with a pushed stick gives no thrust"


def test_a_hand_set_that_has_not_the_boat_is_lost_with_a_warning_only(hand):
    hand.hold(FREE)
    mission(hand)
    hand.cut = True
    hand.hold(FREE, 3.0)
    state = hand.boat.state
    assert state.mode is Mode.HEADING
    assert [(n.name, n.action) for n in state.notices] == [("handset_silent", "warn")]


def test_a_boat_that_cannot_be_driven_stops_when_it_is_taken(hand):
    hand.hold(FREE)
    mission(hand)
    hand.boat.state.computer = StartConditions(is_starting=True)
    hand.hold(TAKEN, 0.1)
    assert (hand.boat.state.mode, hand.boat.state.operator) == (Mode.IDLE, HANDSET)


def test_its_kill_switch_kills_and_the_kill_outlasts_it(hand):
    hand.hold(FREE)
    mission(hand)
    hand.hold(FREE, 2.0)
    hand.hold(FREE | {KILL: ON}, 0.06)
    state, boat = hand.boat.state, hand.boat.vehicle
    assert (state.mode, state.reason) == (Mode.IDLE, "kill: hand-set: its kill switch")
    assert thrust(hand) == (0, 0)
    assert boat.on_command(console.Clear(), "console 7") == "clear refused: hand-set still says kill; release it first"
    hand.hold(FREE, 1.0)
    assert state.killed.reason
    assert boat.on_command(console.Heading(0.0), "console 7") == "heading refused: kill: hand-set: its kill switch"
    assert state.notices[0][:2] == ("kill", "kill: hand-set: its kill switch")
    assert boat.on_command(console.Clear(), "console 7") is None
    assert (state.mode, state.reason) == (Mode.IDLE, "operator cleared the kill")
    assert boat.on_command(console.Heading(0.0), "console 7") is None


def test_the_hand_set_clears_its_own_kill_by_taking_the_boat_afresh(hand):
    hand.hold(TAKEN)
    hand.hold(TAKEN | {KILL: ON})
    hand.hold(TAKEN, 1.0)
    assert hand.boat.state.killed.reason, "to release the switch is not enough"
    hand.hold(FREE)
    assert hand.boat.state.killed.reason
    hand.hold(TAKEN)
    assert not hand.boat.state.killed.reason
    hand.hold(TAKEN | AHEAD, 3.0)
    assert thrust(hand) == (1200, 1200)


def test_the_hand_set_does_not_clear_the_kill_of_another(hand):
    hand.hold(FREE)
    assert hand.boat.vehicle.on_command(console.Kill(), "console 7") is None
    hand.hold(TAKEN)
    hand.hold(TAKEN | AHEAD, 1.0)
    assert hand.boat.state.reason == "kill: operator: commanded"
    assert thrust(hand) == (0, 0)


def test_a_mandatory_hand_set_that_is_lost_kills_and_its_return_does_not_clear(make_boat, protocol):
    hand = played(make_boat, protocol, mandatory=True)
    hand.hold(FREE)
    mission(hand)
    lose(hand, "radio")
    hand.hold(FREE, 0.2 if protocol == "crsf" else 0.6)
    assert hand.boat.state.mode is Mode.IDLE
    assert hand.boat.state.killed.reason.startswith("hand-set: lost: ")
    hand.flags, hand.quality_pct = 0, 99
    hand.hold(TAKEN, 2.0)
    assert hand.boat.state.killed.reason
    assert hand.boat.state.killed.held == ()


@pytest.mark.parametrize("mandatory", [True, False])
def test_a_boat_whose_mandatory_hand_set_was_never_heard_stays_in_idle(make_boat, protocol, mandatory):
    hand = played(make_boat, protocol, mandatory=mandatory)
    hand.cut = True
    hand.hold(FREE)
    refused = hand.boat.vehicle.on_command(console.Heading(0.0), "console 7")
    assert refused == ("heading refused: hand-set not heard yet" if mandatory else None)


def test_noise_alone_gives_no_thrust_and_takes_nothing(hand):
    import random

    chance = random.Random(1)
    hand.frames = lambda pulses: chance.randbytes(80)
    hand.hold(FREE, 20.0)
    assert (hand.boat.state.mode, hand.boat.state.operator) == (Mode.IDLE, "")


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ({"take": config.Switch()}, "needs a switch that takes the boat"),
        ({"kill": config.Switch(5)}, "on channels of their own"),
        ({"mandatory": True}, "name the device"),
    ],
)
def test_a_wrong_hand_set_is_refused_in_words(table, reason):
    with pytest.raises(ValueError, match=reason):
        config.HandsetTable(**table)


def test_ends_of_a_stick_that_do_not_rise_are_refused():
    with pytest.raises(ValueError, match="reversed exchanges the ends"):
        config.Stick(1, low_us=2012.0, high_us=988.0)


def pulses(**us):
    """Of 16 channels; c5=2000.0 is the fifth one."""
    return tuple(us.get(f"c{channel}", 1500.0) for channel in range(1, 17))


class Alone:
    """A hand-set without a boat: its line and its decoder are played, and so is the door that its orders go through."""

    def __init__(self, **more):
        self.pieces, self.lost, self.quality_pct, self.does_obey = [], "", None, True
        table = config.HandsetTable(device=DEVICE, kill=config.Switch(KILL), **more)
        self.handset, self.state = Handset(table, self, self), State()

    def read(self):
        return self.pieces.pop(0) if self.pieces else b""

    def feed(self, piece):
        return [piece]

    def at(self, now_s, *pieces):
        """What it orders after these positions came."""
        self.pieces += pieces
        self.handset.read(self.state, now_s)
        found = []
        for order in self.handset.orders(self.state, now_s):
            found.append(order)
            if isinstance(order, (console.Manual, console.SetMode)) and self.does_obey:
                self.state.mode = Mode.MANUAL
            elif isinstance(order, console.Take):
                self.state.operator = HANDSET
        return found


AT_REST, HELD_AHEAD = pulses(c5=ON, c6=OFF), pulses(c5=ON, c6=OFF, c3=2012.0)
LET_GO = pulses(c5=OFF, c6=OFF)


@pytest.mark.parametrize(
    ("seen", "on", "is_known"),
    [
        ("", False, False),
        ("00", False, False),
        ("000", False, True),
        ("11", False, False),
        ("111", True, True),
        ("11-11", False, False),
        ("11-111", True, True),
        ("111-00", True, True),
        ("111-000", False, True),
        ("110110", False, False),
    ],
)
@pytest.mark.parametrize("way", ["high", "low"])
def test_how_a_switch_is_read(seen, on, is_known, way):
    switch, us = Debounced(config.Switch(TAKE, way)), {"1": 1700.0, "0": 1300.0, "-": 1500.0}
    if way == "low":
        us |= {"1": 1300.0, "0": 1700.0}
    for _ in range(2):  # what was seen before it was forgotten does not count
        switch.forget()
        for each in seen:
            switch.see(pulses(c5=us[each]))
        assert (switch.on, switch.is_known) == (on, is_known)


def test_a_switch_that_there_is_not_is_off():
    switch = Debounced(config.Switch())
    for _ in range(9):
        switch.see(pulses(c16=ON))
    assert (switch.on, switch.is_known) == (False, True)


@pytest.mark.parametrize(
    ("us", "neutral", "part"),
    [
        *((1700.0, 0.1, 0.5), (1200.0, 0.1, -0.5), (1700.0, 0.5, 0.0), (1200.0, 0.5, 0.0)),
        *((1400.0, 0.1, 0.0), (2100.0, 0.1, 1.0), (900.0, 0.1, -1.0), (1400.5, 0.0, 0.5 / 600.0)),
    ],
)
def test_each_way_of_a_stick_counts_by_itself(us, neutral, part):
    stick, reversed_stick = (config.Stick(2, 1000.0, 1400.0, 2000.0, reversed=each) for each in (False, True))
    assert fraction(stick, pulses(c2=us), neutral) == part
    assert fraction(reversed_stick, pulses(c2=us), neutral) == -part


def test_both_protocols_have_a_speed_and_a_form():
    opened = []
    for table in ({"protocol": "sbus"}, {"protocol": "sbus", "baud": 1}, {}, {"baud": 2}):
        open_handset(config.HandsetTable(device=DEVICE, **table), Links(None, lambda *line: opened.append(line)))
    assert opened == [(DEVICE, 100_000, "8E2"), (DEVICE, 1, "8E2"), (DEVICE, 420_000), (DEVICE, 2)]


def test_sticks_that_move_are_told_sooner_than_sticks_that_rest():
    hand = Alone()
    assert hand.at(0.0, *[AT_REST] * 3) == [console.Take(), console.SetMode("manual")]
    told = {now_s: hand.at(now_s, AT_REST) for now_s in (0.0, 0.125, 0.1875, 0.2, 0.375)}
    assert told == {0.0: [console.Manual(0.0, 0.0)], 0.125: [], 0.1875: [], 0.2: [console.Manual(0.0, 0.0)], 0.375: []}
    hand.at(1.0, AT_REST)
    assert hand.at(1.04, HELD_AHEAD) == []
    hand.at(2.0, AT_REST)
    assert hand.at(2.0625, HELD_AHEAD) == [console.Manual(1.0, 1.0)]
    hand = Alone()
    hand.at(0.0, *[AT_REST] * 3)
    hand.at(0.0, AT_REST)
    assert hand.at(0.05, HELD_AHEAD) == [console.Manual(1.0, 1.0)]


@pytest.mark.parametrize(
    ("throttle_us", "steer_us", "told"),
    [
        (1500.0 + 0.2 * 512.0, 1500.0 + 0.3 * 512.0, (-0.1, 0.5)),
        (2012.0, 2012.0, (0.0, 1.0)),
        (2012.0, 988.0, (1.0, 0.0)),
        (988.0, 2012.0, (-1.0, 0.0)),
        (988.0, 988.0, (0.0, -1.0)),
        (1500.0 + 512.0 / 3.0, 1500.0, (0.33, 0.33)),
    ],
)
def test_throttle_and_steer_are_mixed(throttle_us, steer_us, told):
    hand = Alone()
    hand.at(0.0, *[AT_REST] * 3)
    hand.at(0.0, AT_REST)
    assert hand.at(1.0, pulses(c5=ON, c6=OFF, c3=throttle_us, c1=steer_us)) == [console.Manual(*told)]


def test_a_line_that_floods_is_read_a_little_at_a_time():
    hand = Alone()
    hand.pieces = [AT_REST] * 9
    hand.at(0.0)
    assert len(hand.pieces) == 5


def test_who_never_heard_the_hand_set_that_has_the_boat_leaves_and_silence_begins_after_its_time():
    hand = Alone()
    hand.state.operator = HANDSET
    assert hand.at(0.0) == [console.Leave("hand-set not heard yet")]
    assert hand.at(1.0, AT_REST) == []
    assert hand.at(1.5) == []
    assert hand.at(1.51) == [console.Leave("hand-set silent")]


def test_a_boat_that_it_has_at_the_start_waits_for_the_sticks_and_its_kill_for_the_switch():
    hand = Alone()
    hand.state.operator, hand.state.mode = HANDSET, Mode.MANUAL
    assert hand.at(0.0, *[HELD_AHEAD] * 3) == [console.Manual(0.0, 0.0)]
    hand = Alone()
    hand.state.killed = Killed("kill", HANDSET)
    assert console.Clear() not in hand.at(0.0, *[AT_REST] * 3)


def test_the_sticks_wait_in_the_middle_each_time_that_the_boat_is_taken():
    hand = Alone()
    hand.at(0.0, *[LET_GO] * 3)
    hand.state.killed = Killed("kill", HANDSET)
    assert hand.at(0.0, *[AT_REST] * 3) == [console.Clear(), console.Take(), console.SetMode("manual")]
    hand.at(0.0, AT_REST)
    hand.state.operator = ""
    assert hand.at(0.0, AT_REST) == [console.Take(), console.SetMode("manual")], "the switch has not moved"
    hand.at(1.0, AT_REST)
    hand.at(1.0, *[LET_GO] * 3)
    hand.state.operator = ""
    hand.at(2.0, *[HELD_AHEAD] * 3)
    assert hand.at(2.0, HELD_AHEAD) == [console.Manual(0.0, 0.0)]


def test_after_a_stop_it_is_alive_with_sticks_in_the_middle_and_drives_again_once():
    hand = Alone()
    hand.at(0.0, *[AT_REST] * 3)
    hand.at(0.0, AT_REST)
    hand.state.mode = Mode.IDLE
    assert hand.at(1.0, AT_REST) == [console.Alive()]
    hand.does_obey = False
    assert hand.at(2.0, HELD_AHEAD) == [console.Manual(1.0, 1.0)]
    assert hand.at(3.0, HELD_AHEAD) == [console.Alive()], "it was refused"
    assert hand.at(4.0, AT_REST) == [console.Alive()]
    hand.does_obey = True
    assert hand.at(5.0, HELD_AHEAD) == [console.Manual(1.0, 1.0)]
    assert hand.at(6.0, HELD_AHEAD) == [console.Manual(1.0, 1.0)], "it drives"


def test_where_its_kill_switch_was_before_it_was_lost_is_forgotten():
    hand = Alone()
    assert hand.at(0.0, *[pulses(c5=OFF, c6=ON)] * 3) == [console.Kill(HANDSET, "its kill switch", "on")]
    hand.state.killed = Killed("kill", HANDSET, (HANDSET,))
    assert hand.at(1.0) == [console.Kill(HANDSET, switch="off")]
    hand.state.killed = Killed("kill", HANDSET)
    assert hand.at(1.1, LET_GO) == []
