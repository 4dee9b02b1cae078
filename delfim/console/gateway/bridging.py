"""The bridge of a console with operators: what each page may ask, who commands, and that all pages know it."""

from collections.abc import Callable, Iterable
from typing import Any, Final, Protocol

from delfim.console.gateway import page_messages
from delfim.console.watch import bridge
from delfim.console.watch.operators import ConsoleOperator, OperatorsFile, Role

LOOKING: Final = ("list", "load", "check", "dryrun", "compare")  # at missions
PROOFS: Final = 64  # of the gateway's words, that a page may still prove


class BridgePage(Protocol):
    number: int
    operator: ConsoleOperator | None

    @property
    def who(self) -> str: ...
    def tell(self, message: dict[str, Any]) -> None: ...
    def end(self) -> None: ...


def needed(asked: page_messages.Message) -> Role:
    """The least role for what a page asks. To stop boats, and to let go, is everybody's."""
    match asked:
        case (
            page_messages.Command(command="stop")
            | page_messages.Release()
            | page_messages.Acknowledge()
            | page_messages.Quiet()
            | page_messages.Note()
        ):
            return Role.WATCH
        case page_messages.Home() | page_messages.Afford() | page_messages.Replay() | page_messages.Survey():
            return Role.WATCH
        case page_messages.See() | page_messages.Snapshot():
            return Role.WATCH
        case page_messages.Logs(do=deed) if deed != "chart":
            return Role.WATCH
        case page_messages.Mission(do=deed) if deed in LOOKING:
            return Role.WATCH
        case page_messages.Itself(do=deed) if deed != "change":
            return Role.WATCH
        case page_messages.Adopt() | page_messages.Depths():
            return Role.MAINTAIN
        case _:
            return Role.COMMAND


class BridgeDesk:
    """`note` puts a line into the log of the watch. `changed` is told who commands now, and the page that did."""

    def __init__(
        self, operators: OperatorsFile, note: Callable[[str, str, str], None], changed: Callable[[str, int], None]
    ) -> None:
        self.operators, self.bridge = operators, bridge.Bridge()
        self._note, self._changed = note, changed
        self._told = dict[int, float]()  # by the number of a word: when
        self._proven = dict[int, float]()  # by page: when the word was said that it proved last
        self._due_s, self._said = 0.0, 0
        self._names = dict[int, str]()

    def refusal(self, page: BridgePage, asked: page_messages.Message) -> str:
        """Why a page may not ask this; empty: it may."""
        if not self.operators.closed:
            return ""
        if page.operator is None or page.operator not in self.operators.known:
            return "the key of this page was revoked"
        need = Role.WATCH if isinstance(asked, page_messages.Here) else needed(asked)
        if page.operator.rank < need:
            return f"{page.who} has the role {page.operator.role}: this needs {need.name.lower()}"
        if isinstance(asked, page_messages.Handover) or need < Role.COMMAND or page.number == self.bridge.holder:
            return ""
        if page.number == self.bridge.granted:
            return "the command is on its way to this page: again in a moment"
        holder = self._names.get(self.bridge.holder)
        return f"{holder} commands" if holder else "nobody commands: take the command first"

    def ask(
        self, page: BridgePage, asked: page_messages.Here | page_messages.Handover, pages: Iterable[BridgePage], now_s: float
    ) -> None:
        """What a page says of the command. Raises Refused."""
        if isinstance(asked, page_messages.Here):
            self._hear(page, asked, now_s)
        else:
            self._hand(page, asked, pages, now_s)

    def _hear(self, page: BridgePage, asked: page_messages.Here, now_s: float) -> None:
        """A page proves that it heard a word."""
        self._proven[page.number] = max(self._told.get(asked.n, -bridge.LEASE_S), self._proven.get(page.number, 0.0))
        self._turn(bridge.know(self.bridge, page.number, asked.grant), now_s)

    def _hand(self, page: BridgePage, asked: page_messages.Handover, pages: Iterable[BridgePage], now_s: float) -> None:
        proof_s = now_s - self._proven.get(page.number, float("-inf"))
        match asked.do:
            case "take":
                new, words = bridge.take(self.bridge, page.number, proof_s), "takes the command"
            case "accept":
                new, words = bridge.accept(self.bridge, page.number, proof_s), "accepts the command"
            case "offer":
                able = {each.number: each.who for each in pages if each.operator and each.operator.rank >= Role.COMMAND}
                to = asked.page if asked.page in able else 0
                new = bridge.offer(self.bridge, page.number, to)
                words = f"offers the command to {able[to]}" if to else "withdraws the offer"
            case _:
                new, words = (
                    bridge.leave(self.bridge, page.number),
                    "leaves the command" if self.bridge.holder == page.number else "declines",
                )
        self._note(page.who, "command", words)
        self._turn(new, now_s)

    def gone(self, page: int, now_s: float) -> None:
        self._proven.pop(page, None)
        self._turn(bridge.leave(self.bridge, page), now_s)

    def tick(self, pages: Iterable[BridgePage], now_s: float) -> None:
        """Often: who is deaf, whose key was revoked; and tells all pages."""
        if not self.operators.closed or now_s < self._due_s:
            return
        self._due_s = now_s + bridge.TOLD_S
        pages = list(pages)
        self._names = {each.number: each.who for each in pages}
        if self.operators.changed():
            for each in pages:
                if each.operator not in self.operators.known:
                    self._note(each.who, "command", "key revoked")
                    self._turn(bridge.leave(self.bridge, each.number), now_s)
                    each.end()
        for number in (self.bridge.holder, self.bridge.granted):
            if number and now_s - self._proven.get(number, float("-inf")) > bridge.LEASE_S:
                self._note(self._names.get(number, ""), "command", "link lost: nobody commands")
                self._turn(bridge.leave(self.bridge, number), now_s)
        self._tell(pages, now_s)

    def _turn(self, new: bridge.Bridge, now_s: float) -> None:
        old, self.bridge = self.bridge, new
        if new != old:
            self._due_s = now_s  # all pages hear it with the next tick
        if new.holder != old.holder:
            name = self._names.get(new.holder, "")
            if name:
                self._note(name, "command", "commands")
            self._changed(name, old.holder)

    def _tell(self, pages: list[BridgePage], now_s: float) -> None:
        self._said += 1
        self._told[self._said] = now_s
        self._told.pop(self._said - PROOFS, None)
        others = [
            {"page": each.number, "name": each.who, "role": each.operator.role, "carries": self._carries(each.number, now_s)}
            for each in pages
            if each.operator
        ]
        for each in pages:
            each.tell({"t": "bridge", "n": self._said, "you": each.number, **self.bridge._asdict(), "pages": others})

    def _carries(self, page: int, now_s: float) -> bool:
        return now_s - self._proven.get(page, float("-inf")) <= bridge.CARRY_S
