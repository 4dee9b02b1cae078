"""Texts of boats: long ones come in pieces (STATUSTEXT `id` and `chunk_seq`), each of which may be lost."""

from typing import Any, Final

PIECE: Final = 50  # bytes; a shorter piece is the last one
PIECES_MAX: Final = 20
TWICE_S: Final = 3.0
HEARD_MAX: Final = 64


class Words:
    """Of one boat."""

    def __init__(self) -> None:
        self._id, self._pieces = 0, dict[int, str]()
        self._links: dict[tuple[int, int, str], tuple[Any, float]] = {}  # of each piece: where it was heard first, and when

    def is_new(self, message: Any, link: Any, now_s: float) -> bool:
        """Whether this piece was not heard on another link just now: a boat tells it on all of them."""
        self._links = {piece: heard for piece, heard in self._links.items() if now_s - heard[1] < TWICE_S}
        if len(self._links) >= HEARD_MAX:
            self._links.clear()
        first = self._links.setdefault((message.id, message.chunk_seq, message.text), (link, now_s))
        return bool(first[0] == link)

    def hear(self, message: Any) -> str | None:
        """The whole text, when this piece completes it. A piece that was lost is an ellipsis."""
        text: str = message.text
        if not message.id:
            return text
        if message.id != self._id:
            self._id, self._pieces = message.id, {}
        if message.chunk_seq < PIECES_MAX:
            self._pieces[message.chunk_seq] = text
        if len(text) >= PIECE:
            return None
        pieces = [self._pieces.get(n, "...") for n in range(min(message.chunk_seq, PIECES_MAX - 1) + 1)]
        self._id = 0
        return "".join(pieces)
