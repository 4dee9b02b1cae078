"""The consoles of one vehicle: which one commands, and their requests. Every change goes through `obey` as a console's command,
and so into the log.
"""

import logging
import math
import secrets
from collections.abc import Callable
from typing import Final

from delfim.parts.mavlink import telemetry
from delfim.parts.mavlink.codec import boatsize, params
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.codec.wire import GUEST, Address, Message, Speaker, dialect
from delfim.parts.mavlink.events import News
from delfim.parts.mavlink.missions import Missions
from delfim.parts.mavlink.peers import HEARD_S, Peer, Peers
from delfim.parts.mavlink.sequences import Sequences
from delfim.parts.mavlink.table import Mavlink
from delfim.parts.mavlink.telemetry import TelemetryView
from delfim.vehicle import console
from delfim.vehicle.grex import SeenVessel
from delfim.vehicle.loop import HELD_BY_HAND, VehicleLoop
from delfim.vehicle.orders.entrusting import PAYLOAD, SENSOR
from delfim.vehicle.state import HANDSET

DOUBT_S: Final = 30.0  # between two texts that a console is not believed

log = logging.getLogger(__name__)

Obey = Callable[[console.Commands, str], str | None]
Review = Callable[[str, console.Plan, Callable[[str | None], None]], None]


class Consoles:
    """`obey` carries out a command of a named console; it returns the reason of a refusal, or None. `review` has a plan obeyed
    after its review; without `review` a plan is obeyed at once. `correct` hands corrections on to the
    receiver; False: it cannot now. None: there is no such receiver."""

    def __init__(
        self,
        boat: VehicleLoop,
        obey: Obey,
        send: Callable[[bytes, Address], object],
        signing: Signing | None,
        review: Review | None,
        correct: Callable[[bytes], bool] | None = None,
    ) -> None:
        self.boat, self.clock, self.settings = boat, boat.clock, boat.helm.settings.of(Mavlink)
        self.system = boat.helm.settings.boat.id
        self.commander: Speaker | None = None  # the console that commands
        self.counts: dict[str, int] = {}
        self.correct = correct
        self.guided: console.Commands | None = None  # the last set point, and why the last was refused
        self.guided_refused: str | None = None
        self.peers = Peers(self.system, self.settings, self.clock, send, signing, self.count)
        self.missions = Missions(boat, self.settings.autopilot == "ardurover")
        self.sequences = Sequences()
        self.answered: dict[tuple[int, int, int, int], Message] = {}  # by console, its number and kind of order or question
        self._obey = obey
        self._review = review or (lambda operator, command, answer: answer(obey(command, operator)))
        self._news = News(boat, self.peers, self.missions)
        self._owner_s = self._namesakes_s = self._doubted_s = -math.inf
        self.obstacles_s = -math.inf  # when OBSTACLE_DISTANCE was taken last
        self._run = secrets.token_hex(8)

    def count(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1

    def doubt(self, words: str) -> None:
        """Tell that a console with the right key is not obeyed, to those that are, and the log."""
        now_s = self.clock.monotonic_s()
        if now_s - self._doubted_s > DOUBT_S:
            self._doubted_s = now_s
            log.warning("%s", words)
            self.peers.say(dialect.MAV_SEVERITY_ERROR, words)

    def tick(self, now_s: float) -> None:
        """Tell what changed, and forget consoles that are gone."""
        self.tell_news()
        self.missions.tick(now_s)
        if self.boat.state.namesakes and now_s - self._namesakes_s > HEARD_S:
            self.boat.on_namesakes("")
        self.peers.forget_silent(now_s)

    def meet(self, peer: Peer) -> None:
        """A console that asks for all modes has just begun: it does not know what was told before."""
        self._news.meet(peer.address)

    def tell_news(self) -> None:
        self._news.tell(self.commander)

    def ask(self, source: Speaker, command: console.Commands) -> str | None:
        """Obey a command if this console commands. The first console to ask commands; so does the next one when the one before
        was silent for long. Any console may stop or kill the boat. Returns the reason of a refusal, or None."""
        if (reason := self._own(source, command)) is not None:
            return reason
        refused = self._obey(command, source.name)
        self.tell_news()
        return refused

    def see(self, sensor: str, target: SeenVessel) -> None:
        """A sensor sees a thing. It is logged as what programs see, so that a replay sees it too."""
        self._obey(console.Sight(target), f"{PAYLOAD}{SENSOR}{sensor}")

    def propose(self, source: Speaker, command: console.Commands, answer: Callable[[str | None], None]) -> None:
        """The same for a plan, whose review takes a while: `answer` gets its outcome."""

        def done(refused: str | None) -> None:
            self.tell_news()
            answer(refused)

        if not isinstance(command, console.Plan):
            answer(self.ask(source, command))
        elif (reason := self._own(source, command)) is not None:
            answer(reason)
        else:
            self._review(source.name, command, done)

    def _own(self, source: Speaker, command: console.Commands) -> str | None:
        """The console that commands becomes the owner. Returns why this one may not command, or None."""
        if self.commander != source and not isinstance(command, console.Halts):
            if (reason := self.refusal(source, isinstance(command, console.Take))) is not None:
                return reason
            self.commander = source
        if self.commander == source:
            self._owner_s = self.clock.monotonic_s()
        return None

    def refusal(self, source: Speaker, takes: bool = False) -> str | None:
        """Why this console may not command, in words. `takes`: the command is to take over."""
        if source.component == GUEST:
            return "the guest computer may not command: use a console"
        if self.boat.state.operator == HANDSET:
            return HELD_BY_HAND
        lost = self.clock.monotonic_s() - self._owner_s > self.boat.helm.settings.failsafe.console_silent.after_s
        if takes or self.commander in (None, source) or lost:
            return None
        self.count("not_owner")
        same = "another " if self.owner == source.system else ""
        return f"console {source.system} refused: {same}console {self.owner} commands; take over first"

    @property
    def owner(self) -> int:
        """The system of the console that commands; the boat's own: its hand-set does; 0: nobody."""
        if self.boat.state.operator == HANDSET:
            return self.system
        return self.commander.system if self.commander is not None else 0

    def alive(self, source: Speaker, address: Address) -> None:
        """A console was heard. It may be the one that commands, or use the number of another one."""
        now_s, state = self.clock.monotonic_s(), self.boat.state
        commanded = bool(state.restarted) and source.name == state.operator  # before the program started again
        if commanded and self.commander is None and self.refusal(source) is None:
            self.commander = source
        if source == self.commander:
            self._owner_s = now_s
            self._obey(console.Alive(), source.name)
        where = self.sequences.namesake(source, address, now_s)
        if where is not None:
            self._namesakes_s = now_s
            places = " and ".join(f"{host}:{port}" for host, port in sorted((address, where)))
            words = f"two consoles have number {source.system}: {places}; give one of them another number"
            self.boat.on_namesakes(self.boat.state.namesakes or words)

    def give_up(self, source: Speaker) -> None:
        """This console no longer commands."""
        if self.commander == source:
            self.commander = None
            self.tell_news()

    def param(self, peer: Peer, name: str) -> Message:
        """PARAM_VALUE, with the value in force for this peer."""
        if name == params.PROFILE:
            return params.message(name, float(telemetry.PROFILES.index(peer.profile)))
        return params.message(name, params.value(self.boat.helm.settings, params.BY_NAME[name]))

    def texts(self) -> dict[str, str]:
        """The parameters that are texts."""
        helm = self.boat.helm
        return {
            params.BOAT_NAME: helm.settings.boat.name,
            params.BOAT_RUN: self._run,
            params.SAILS_BY: helm.sails_by,
            params.BOAT_SIZE: boatsize.told(helm.settings),
        }

    def view(self) -> TelemetryView:
        return TelemetryView(
            self.boat, self.settings, self.owner, self.missions.number, self.missions.checksum, self.clock.monotonic_s()
        )
