"""A trial for the console's page, in a process of its own: numpy and minutes of manoeuvres are nothing for the gateway's loop.

`python -m delfim.adoption.trial.linked FILE --radius M --output FOLDER` speaks JSON, a line each. It hears what the gateway
hears of the boat (`BoatHeard`), answers to orders and questions, and the end; it says orders, sentences, questions,
steps, and the end. The gateway gives the orders over its own link: whatever ends a trial aboard ends this one.
"""

import argparse
import contextlib
import math
import queue
import sys
import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import msgspec

from delfim import config
from delfim.adoption.suited import BY_HAND, is_several, unfit
from delfim.adoption.trial import dialogue, session
from delfim.adoption.trial.boats import BERTH_PART, BERTH_S, MODE, TrialCircle
from delfim.adoption.trial.manoeuvres import MotionSeen, Parts, StepTold, TrialEnded
from delfim.adoption.trial.proof import ProofSeen
from delfim.base.errors import DelfimError, Refused, in_words
from delfim.vehicle.propulsion.thrusters import sides

SILENT_S: Final = 3.0  # without a word of the boat the trial ends; the boat itself ends it sooner
ENTERS_S: Final = 3.0  # from the answer to an order until the boat says that it is in the mode
TELLS_S: Final = 3.0  # until a boat has told by which file she sails
BERTH_M: Final = 15.0  # of the circle in which she lies at her lines
ENDS: Final = "STOP, and any other order to her, ends it"
UNTOLD: Final = (
    "over the link she tells of {told} thrusters what each is told, and her file has {count}: her program is older than this "
    "console, or it has another file; bring it up to date, or adopt her on her own computer"
)
FOLDER: Final = "adopt"  # where trials are kept, as `delfim adopt` has it


class BoatHeard(msgspec.Struct, tag=True):
    """The boat, as the link tells it: degrees, m/s, its own clock."""

    at_s: float
    latitude_deg: float
    longitude_deg: float
    heading_deg: float
    turn_dps: float
    north_mps: float
    east_mps: float
    port: float  # parts of full command in force
    starboard: float
    turned: float  # of the greatest angle, clockwise; it means nothing where nothing turns
    mode: str
    reason: str
    measured: dict[str, tuple[float, ...]] | None = None  # behind an estimator: what each sensor said, its time first
    sails_by: str = ""  # the digest of the file with which it was started; empty: it has not told it
    each: tuple[float, ...] = ()  # of more than two thrusters: the part of each row, positive along its angle


class OrderAnswered(msgspec.Struct, tag=True):
    """The boat's answer to the last order that enters a mode; empty: it took it."""

    refused: str


class QuestionAnswered(msgspec.Struct, tag=True):
    """The person's answer to the question."""

    yes: bool


class OperatorEnded(msgspec.Struct, tag=True):
    """The trial is over; in words."""

    why: str


GatewayLine = BoatHeard | OrderAnswered | QuestionAnswered | OperatorEnded


class GatewayWire:
    """The lines from and to the gateway. What is heard of the boat is the newest; a gateway that is gone ends the trial."""

    def __init__(self, source: Any, sink: Any) -> None:
        self._source, self._sink = source, sink
        self._heard: queue.Queue[BoatHeard] = queue.Queue()
        self._orders: queue.Queue[OrderAnswered] = queue.Queue()
        self._answers: queue.Queue[QuestionAnswered] = queue.Queue()
        self.ended = ""
        threading.Thread(target=self._listen, daemon=True).start()

    def say(self, **words: Any) -> None:
        """A line for the gateway."""
        self._sink.write(msgspec.json.encode(words) + b"\n")
        self._sink.flush()

    def _listen(self) -> None:
        for line in self._source:
            match msgspec.json.decode(line, type=GatewayLine):
                case BoatHeard() as heard:
                    self._heard.put(heard)
                case OrderAnswered() as answer:
                    self._orders.put(answer)
                case QuestionAnswered() as answer:
                    self._answers.put(answer)
                case OperatorEnded(why=why):
                    self.ended = why
                    self._answers.put(QuestionAnswered(False))
        self.ended = self.ended or "the console is gone"
        self._answers.put(QuestionAnswered(False))

    def newest(self) -> BoatHeard:
        """What the boat tells next. Raises TrialEnded, DelfimError."""
        heard = None
        if not self.ended:
            with contextlib.suppress(queue.Empty):
                heard = self._heard.get(timeout=SILENT_S)
        if self.ended or heard is None:
            raise TrialEnded(self.ended or f"nothing is heard of the boat for {SILENT_S:g} s")
        return heard

    def sails_by(self) -> str:
        """The digest of the boat's file; empty: she does not tell it. Raises TrialEnded."""
        heard = first = self.newest()
        while not heard.sails_by and heard.at_s < first.at_s + TELLS_S:
            heard = self.newest()
        return heard.sails_by

    def forget(self) -> None:
        """What the boat told until now is old."""
        while not self._heard.empty():
            self._heard.get()

    def order_answered(self) -> str:
        try:
            return self._orders.get(timeout=2.0 * SILENT_S).refused
        except queue.Empty:
            return "no answer from the boat"

    def answered(self) -> bool:
        return self._answers.get().yes


class LinkedTrial:
    """The boat of a trial over the gateway's link."""

    def __init__(
        self,
        wire: GatewayWire,
        rows: tuple[config.ThrusterTable, ...],
        radius_m: float,
        middle: tuple[float, float] | None = None,
        *,
        is_berth: bool = False,
    ) -> None:
        """`middle`: of the circle of a trial that goes on, degrees. `is_berth`: nothing is learned of what was told."""
        self._wire, (self._port, _) = wire, sides(rows)
        self._rows, self._mode, self._is_berth = rows, MODE, is_berth
        self._turning = [row for row in rows if row.steer is not None]  # one, at most: of more the link does not tell
        heard = wire.newest()
        self._told(heard)
        latitude_deg, longitude_deg = middle or (heard.latitude_deg, heard.longitude_deg)
        self.circle = TrialCircle(latitude_deg, longitude_deg, radius_m)

    @property
    def middle(self) -> tuple[float, float]:
        return self.circle.middle

    def wait(self) -> MotionSeen:
        return self._seen(self._wire.newest())

    def _seen(self, heard: BoatHeard) -> MotionSeen:
        self._mode = heard.mode
        at = self.circle.place(heard.latitude_deg, heard.longitude_deg)
        moves = math.radians(heard.heading_deg), math.radians(heard.turn_dps), heard.north_mps, heard.east_mps
        return MotionSeen(heard.at_s, *at, *moves, self._told(heard), heard.mode == MODE, heard.reason, heard.measured)

    def _told(self, heard: BoatHeard) -> Parts:
        """What the rows were told, and what turns one. Raises DelfimError where the boat does not tell it."""
        if is_several(self._rows) and not self._is_berth:
            if len(heard.each) != len(self._rows):
                raise DelfimError(UNTOLD.format(told=len(heard.each) or "no", count=len(self._rows)))
            return heard.each
        parts = (heard.port if row in self._port else heard.starboard for row in range(len(self._rows)))
        signs = (1.0 if abs(row.angle_deg) < 90.0 else -1.0 for row in self._rows)  # what is told is positive ahead
        return (*(part * sign for part, sign in zip(parts, signs, strict=True)), *(heard.turned for _ in self._turning))

    def play(self, parts: Parts, for_s: float, name: str, *, begin: bool, comes_back: bool) -> None:
        if self._wire.ended:
            raise TrialEnded(self._wire.ended)
        order = self.circle.order(parts, for_s, name, begin=begin, comes_back=comes_back)
        self._wire.say(order=order)
        if not begin:
            return
        entered(self._wire, MODE)

    def turn_alone(self, name: str) -> str:
        """Turn a motor at the berth; returns that it was told to, in words."""
        parts = (*(BERTH_PART if row.name == name else 0.0 for row in self._rows), *(0.0 for _ in self._turning))
        self.play(parts, BERTH_S, "berth", begin=True, comes_back=False)
        while self.wait().is_on:
            pass
        return f"{BERTH_PART:.0%} for {BERTH_S:g} s"

    def end(self, mode: str) -> None:
        if self._wire.ended or self._mode not in (MODE, "idle"):  # somebody, or a failsafe, has told the boat what to do
            return
        self._wire.say(end=mode)
        until_s = time.monotonic() + ENTERS_S
        while self._wire.newest().mode == MODE and time.monotonic() < until_s:
            pass


def entered(wire: GatewayWire, mode: str) -> None:
    """Wait for the answer to an order, and until the boat says that it is in this mode. Raises DelfimError, Refused."""
    if why := wire.order_answered():
        raise Refused(wire.ended or why)
    until_s = time.monotonic() + ENTERS_S
    while time.monotonic() < until_s:
        if wire.newest().mode == mode:
            return
    raise DelfimError(f"the boat took the order and does not enter mode {mode}")


class LinkedProof:
    """The boat of a proof sail over the gateway's link."""

    def __init__(self, wire: GatewayWire, circle: TrialCircle) -> None:
        self._wire, self._circle = wire, circle

    def wait(self) -> ProofSeen:
        heard = self._wire.newest()
        at = self._circle.place(heard.latitude_deg, heard.longitude_deg)
        moves = math.radians(heard.heading_deg), heard.north_mps, heard.east_mps
        return ProofSeen(heard.at_s, *at, *moves, heard.mode, heard.reason)

    def order(self, command: str, **words: Any) -> None:
        if self._wire.ended:
            raise TrialEnded(self._wire.ended)
        self._wire.say(steer={"command": command} | words)
        entered(self._wire, {"stop": "idle", "mode": words.get("mode", "")}.get(command, command))


class PagePerson:
    """The person at the page."""

    def __init__(self, wire: GatewayWire) -> None:
        self._wire = wire

    def tell(self, words: str) -> None:
        self._wire.say(tell=words)

    def ask(self, question: str) -> bool:
        self._wire.say(ask=question)
        yes = self._wire.answered()
        if self._wire.ended:
            raise TrialEnded(self._wire.ended)
        self._wire.forget()
        return yes

    def step(self, told: StepTold) -> None:
        self._wire.say(step=told._asdict())


def tried(wire: GatewayWire, file: Path, radius_m: float, folder: Path, what: str = "") -> int:
    """A trial and what follows of it; the end of all is said. `what`: "afresh", or "berth" for the motors alone. Raises
    DelfimError."""
    settings, person = config.load(file), PagePerson(wire)
    if why := unfit(settings.thrusters):
        raise DelfimError(f"this boat cannot be adopted: {why}; {BY_HAND}")
    place = folder / f"{file.stem}.trial"
    progress = session.TrialProgress(settings.thrusters) if what == "afresh" else session.kept(place, settings)
    if what == "berth":
        dialogue.at_the_berth(LinkedTrial(wire, settings.thrusters, BERTH_M, is_berth=True), settings, person)
        return 0
    if progress.written is not None and progress.written.proof:
        person.tell(f"Adopted already, on {progress.written.on}: {progress.written.proof}.")
        return 0
    boat = LinkedTrial(wire, settings.thrusters, radius_m, progress.middle if progress.is_proven else None)
    latitude_deg, longitude_deg = boat.middle
    wire.say(circle={"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "radius_m": radius_m})
    if progress.written is not None and progress.written.gains:
        dialogue.may_prove(settings, wire.sails_by(), file, radius_m, person)
        code = dialogue.proof(progress, place, str(file), LinkedProof(wire, boat.circle), radius_m, person)
        wire.say(sailed=True)
        return code
    if not progress.is_whole and (ended := _sailed(wire, boat, settings, progress, (file, place), person)):
        return dialogue.interrupted(progress, ended, place, person)
    return dialogue.adopted(progress, place, str(file), f"{datetime.now(UTC):%Y-%m-%d}", person)


def _sailed(
    wire: GatewayWire,
    boat: LinkedTrial,
    settings: config.Vehicle,
    progress: session.TrialProgress,
    files: tuple[Path, Path],
    person: PagePerson,
) -> str:
    """Sail the trial, or the rest of it. `files`: of the boat, and of the trial. Returns why it ended before its time, in
    words. Raises DelfimError."""
    file, place = files
    if progress.is_proven:
        person.tell(f"Goes on with {place}, behind: {', '.join(('motors', *dict.fromkeys(progress.done)))}.")
    radius_m = boat.circle.radius_m
    dialogue.may_begin(settings, wire.sails_by(), file, person)
    if not person.ask(dialogue.before(settings, radius_m, ENDS)):
        raise DelfimError("the circle is not free")
    trial = session.TrialSession(boat, settings, progress, place, radius_m, person.ask, lambda words: None)
    trial.trial.step = person.step
    ended = trial.run()
    wire.say(sailed=True)
    for sentence in trial.differences():
        person.tell(sentence)
    return ended


def main() -> int:
    """The process."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--radius", type=float, default=60.0)
    parser.add_argument("--output", type=Path, default=Path(FOLDER))
    for what in ("afresh", "berth"):
        parser.add_argument(f"--{what}", dest="what", action="store_const", const=what, default="")
    asked = parser.parse_args()
    wire = GatewayWire(sys.stdin.buffer, sys.stdout.buffer)
    try:
        code, why = tried(wire, asked.file, asked.radius, asked.output, asked.what), ""
    except ModuleNotFoundError as error:
        code, why = 1, f"the fit needs {error.name}, which is not installed: pip install 'delfim[ground]'"
    except (DelfimError, OSError) as error:
        code, why = 1, in_words(error)
    wire.say(done=code == 0, why=why)
    return code


if __name__ == "__main__":
    sys.exit(main())
