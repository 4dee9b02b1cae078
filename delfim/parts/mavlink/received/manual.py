"""Thrust by hand: MANUAL_CONTROL and RC_CHANNELS_OVERRIDE, in manual mode only, from the console that commands. The dead-man of
docs/mavlink.md is the same for both.
"""

from typing import Final

from delfim.base.modes import Mode
from delfim.parts.mavlink.codec.wire import Message, Speaker
from delfim.parts.mavlink.consoles import Consoles
from delfim.parts.mavlink.peers import Peer
from delfim.vehicle import console

RELEASED: Final = frozenset({0, 0xFFFF})  # of a channel: nobody holds it
MIDDLE_US, ENDS_US = 1500, 500  # of a channel's pulse


def manual(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """MANUAL_CONTROL"""
    ahead, turn = (message.z, message.y) if consoles.settings.autopilot == "ardurover" else (message.x, message.r)
    _push(consoles, source, message.target, ahead / 1000.0, turn / 1000.0)


def channels(consoles: Consoles, peer: Peer, source: Speaker, message: Message) -> None:
    """RC_CHANNELS_OVERRIDE: 1 steers, 3 is thrust, as ArduRover has them. A channel that is released is in the middle. Both
    released end the thrust, and after that are silence."""
    pulses = message.chan3_raw, message.chan1_raw
    held = consoles.boat.state.setpoint.port or consoles.boat.state.setpoint.starboard
    if RELEASED.issuperset(pulses) and not held:
        return
    ahead, turn = (0.0 if us in RELEASED else (us - MIDDLE_US) / ENDS_US for us in pulses)
    _push(consoles, source, message.target_system, ahead, turn)


def _push(consoles: Consoles, source: Speaker, target: int, ahead: float, turn: float) -> None:
    """A stream that did not end must not change the mode, and a number out of range is no thrust."""
    fits = -1.0 <= ahead <= 1.0 and -1.0 <= turn <= 1.0
    is_his = target == consoles.system and source == consoles.commander
    if not (fits and is_his and consoles.boat.state.mode is Mode.MANUAL):
        consoles.count("manual_ignored")
        return
    port, starboard = (max(min(ahead + side * turn, 1.0), -1.0) for side in (1, -1))
    if consoles.ask(source, console.Manual(starboard, port)):
        consoles.count("manual_refused")
