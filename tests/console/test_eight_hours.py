"""A watch of eight hours: three boats on poor radios, troubles by chance, two operators who hand the command to and fro on poor
links of their own, and a console that ends now and then and is started again. No alert is lost.

The machines are the console's own; the boats tell their troubles as `delfim.parts.mavlink.events` does. Time is handed in.
"""

from pathlib import Path
from random import Random
from typing import Any, cast

import pytest

from delfim.base.errors import Refused
from delfim.console.gateway import page_messages
from delfim.console.gateway.bridging import BridgeDesk
from delfim.console.gateway.onwatch import LOST, WatchKeeper
from delfim.console.gateway.watchlog import since
from delfim.console.watch.alerts import cause
from delfim.console.watch.alertstate import UNSEEN, AlertState
from delfim.console.watch.operators import OperatorsFile, add_operator
from delfim.vehicle.failsafe.troubles import Trigger

STEP_S = 1.0
BEGAN_S = 1_790_000_000.0
LOSS = 0.3  # of the frames of a boat
HEARD_S = 25.0  # a trouble that lasted so long while the radio carried something is known
UNTOLD = "words were lost on the link"
WORDS = {
    Trigger.NAVIGATION_SILENT: ("navigation: no estimate for {:.1f} s", "stop"),
    Trigger.THRUSTER: ("port propeller: no report for {:.1f} s", "stop"),
    Trigger.BATTERY_LOW: ("battery at 18 %", "warn"),
    Trigger.FENCE: ("fence 4 m ahead", "hold"),
    Trigger.LOG: ("the log is not written: disk full", "warn"),
}


class TroubledBoat:
    """Its troubles, and the radio that tells of them."""

    def __init__(self, number: int, chance: Random) -> None:
        self.number, self.heard_s, self._chance = number, 0.0, chance
        self.began = dict[Trigger, float]()
        self.carried_s = dict[Trigger, float]()  # while it was there and the radio was not out
        self._told = dict[Trigger, float]()
        self._out_until_s = 0.0

    def has_weak_link(self, now_s: float) -> bool:
        return self._chance.random() < 0.001

    def step(self, now_s: float, keeper: WatchKeeper) -> None:
        for trigger in WORDS:
            if trigger in self.began:
                if self._chance.random() < STEP_S / 200.0:
                    del self.began[trigger], self.carried_s[trigger]
                    self._told.pop(trigger, None)
            elif self._chance.random() < STEP_S / 900.0:
                self.began[trigger], self.carried_s[trigger] = now_s, 0.0
        if self._chance.random() < STEP_S / 600.0:
            self._out_until_s = now_s + self._chance.choice((5.0, 30.0, 300.0))
        self._tell(now_s, keeper)

    def _tell(self, now_s: float, keeper: WatchKeeper) -> None:
        is_out = now_s < self._out_until_s
        for trigger, began_s in self.began.items():
            self.carried_s[trigger] = 0.0 if is_out else self.carried_s[trigger] + STEP_S
            told_s = self._told.get(trigger)
            if told_s is None or now_s - told_s >= max(told_s - began_s, 2.0):
                self._told[trigger] = now_s
                if self._is_heard(is_out):
                    words, action = WORDS[trigger]
                    text = f"{words.format(now_s - began_s)}: {action}"
                    told = {"t": "text", "boat": self.number, "severity": 4 if action == "warn" else 2, "text": text}
                    keeper.hear(told | {"alarm": "boat"})
        if self._is_heard(is_out):
            self.heard_s = now_s
            keeper.alerts.troubles(self.number, sum(1 << trigger for trigger in self.began))

    def _is_heard(self, is_out: bool) -> bool:
        return not is_out and self._chance.random() >= LOSS


class WatchPage:
    """An operator's page, which acknowledges what stands in its bar, hands the command over, and is deaf for some time."""

    def __init__(self, number: int, operator: Any, chance: Random) -> None:
        self.number, self.operator, self._chance = number, operator, chance
        self.told: list[dict[str, Any]] = []
        self._deaf_until_s = 0.0

    @property
    def who(self) -> str:
        return str(self.operator.name)

    def tell(self, message: dict[str, Any]) -> None:
        self.told.append(message)

    def end(self) -> None: ...

    def step(self, now_s: float, desk: BridgeDesk, keeper: WatchKeeper, pages: list["WatchPage"]) -> None:
        said, self.told = self.told, []
        if self._chance.random() < STEP_S / 400.0:
            self._deaf_until_s = now_s + self._chance.uniform(0.5, 20.0)
        if now_s < self._deaf_until_s:
            return
        for word in said:
            desk.ask(self, page_messages.Here(n=word["n"], grant=word["grant"]), pages, now_s)
        deed = self._chance.choice(("take", "offer", "accept", "leave")) if self._chance.random() < STEP_S / 60.0 else ""
        if deed and (deed != "leave" or self._chance.random() < 0.1):
            try:
                desk.ask(self, page_messages.Handover(do=cast(Any, deed), page=3 - self.number), pages, now_s)
            except Refused:
                return
        if self._chance.random() < STEP_S / 30.0 and (first := next(iter(keeper.alerts.shown()), None)):
            (keeper.silence if self._chance.random() < 0.2 else keeper.acknowledge)(self.who, [first["id"]])


class WatchedConsole:
    """What a gateway has of the watch, over its starts."""

    def __init__(self, place: Path, operators: OperatorsFile) -> None:
        self.now_s, self._place, self._operators = 0.0, place, operators
        self.start()

    def start(self) -> None:
        self.keeper = WatchKeeper(
            lambda message: None, lambda: BEGAN_S + self.now_s, lambda number: f"boat{number}", self._place
        )
        self.keeper.resume()
        self.desk = BridgeDesk(self._operators, lambda *words: self.keeper.note(None, *words), self._handed)

    def _handed(self, name: str, before: int) -> None:
        if name:
            self.keeper.alerts.transfer(name)
        else:
            self.keeper.alerts.give_back()

    def end(self) -> None:
        self.keeper.log.write(self._place / f"20260921-{int(self.now_s):06}.csv")
        assert self.keeper.file is not None
        self.keeper.file.put(self.keeper.alerts)
        self.keeper.file.close()
        assert self.keeper.file.reason == ""


class LookOut:
    """A second account of what was there, and who took note of it."""

    def __init__(self, boats: list[TroubledBoat]) -> None:
        self._boats, self.lost, self.standing = boats, list[str](), dict[int, AlertState]()
        self.known = set[tuple[int, Trigger, float]]()

    def step(self, keeper: WatchKeeper, now_s: float) -> None:
        standing = keeper.alerts.shown()
        now = {each["id"]: AlertState(each["state"]) for each in standing}
        shown = {(each["boat"], cause(each["text"])) for each in standing}
        untold = {
            (boat, name) for boat, text in shown if text.endswith(UNTOLD) for name in text.partition(":")[0].split(" or ")
        }
        for boat in self._boats:
            for trigger, carried_s in boat.carried_s.items():
                told = boat.number, cause(WORDS[trigger][0].format(1.0))
                if told in shown or (boat.number, trigger.name.lower().replace("_", " ")) in untold:
                    self.known.add((boat.number, trigger, boat.began[trigger]))
                elif carried_s > HEARD_S:
                    self.lost.append(f"{now_s}: boat {boat.number}: {trigger.name}")
        ended = {each["id"]: each for each in keeper.alerts.history}
        for number, state in self.standing.items():
            if number not in now and state in UNSEEN and not ended.get(number, {"by": "again"})["by"]:
                self.lost.append(f"{now_s}: alert {number} left, and nobody took note")
        self.standing = now


@pytest.mark.parametrize("hours", [2, pytest.param(8, marks=pytest.mark.long)])
def test_in_a_watch_of_hours_no_alert_is_lost(tmp_path: Path, hours: int) -> None:
    chance = Random(62923)
    keys = [add_operator(tmp_path / "operators.json", name, "command") for name in ("Ana", "Rui")]
    operators = OperatorsFile(tmp_path / "operators.json")
    console = WatchedConsole(tmp_path, operators)
    boats = [TroubledBoat(number, chance) for number in (1, 2, 3)]
    pages = [WatchPage(number, operators.of(key), chance) for number, key in enumerate(keys, 1)]
    lookout, starts = LookOut(boats), 1
    while console.now_s < hours * 3600:
        console.now_s = now_s = console.now_s + STEP_S
        for boat in boats:
            boat.step(now_s, console.keeper)
        for page in pages:
            page.step(now_s, console.desk, console.keeper, pages)
        console.desk.tick(pages, now_s)
        console.keeper.tick(cast(Any, boats), now_s)
        lookout.step(console.keeper, now_s)
        if chance.random() < STEP_S / 1800.0:
            before = {each["id"] for each in console.keeper.alerts.shown() if AlertState(each["state"]) in UNSEEN}
            console.end()
            console.start()
            starts += 1
            assert before <= {each["id"] for each in console.keeper.alerts.shown()}, "what nobody has seen comes back"
    console.end()
    assert lookout.lost == []
    told = since(tmp_path, 0.0)
    noted, commands = ([line for line in told if line.what == what] for what in ("acknowledged", "command"))
    assert len(lookout.known) > 35 * hours
    assert starts > hours
    assert {line.who for line in noted} == {"Ana", "Rui"}
    assert sum(line.text == "commands" for line in commands) > 3 * hours
    assert any(line.text == LOST for line in noted)
    print(f"{len(lookout.known)} troubles, {len(noted)} alerts acknowledged, {starts} starts, {len(lookout.lost)} lost")
