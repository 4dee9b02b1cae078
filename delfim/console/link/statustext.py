"""Texts of boats: long ones come in pieces (STATUSTEXT `id` and `chunk_seq`), each of which may be lost."""

from typing import Any, Final

PIECE: Final = 50  # bytes; a shorter piece is the last one
PIECES_MAX: Final = 20


class Words:
    """Of one boat."""

    def __init__(self) -> None:
        self._id, self._pieces = 0, dict[int, str]()

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
