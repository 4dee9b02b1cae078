"""XML from anybody: elements as they come, of bounded depth."""

from collections.abc import Callable
from typing import Final
from xml.parsers import expat

from delfim.base.errors import FormatError

DEEP: Final = 64  # elements within each other


class Elements:
    """What a file of XML says within an element: `begin`, `end` and `text` are called with its name, without its namespace.
    Nothing is kept, and a document that declares anything is refused, because entities may grow without bound."""

    def __init__(self, begin: Callable[[str, dict[str, str]], None], end: Callable[[str, str], None]) -> None:
        self._begin, self._end, self._deep, self._text = begin, end, 0, list[str]()
        self._parser = expat.ParserCreate()
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._started
        self._parser.EndElementHandler = self._ended
        self._parser.CharacterDataHandler = self._text.append
        self._parser.StartDoctypeDeclHandler = self._declared

    def read(self, data: bytes) -> None:
        """Read it all. Raises FormatError."""
        try:
            self._parser.Parse(data, True)
        except (KeyError, IndexError):  # of who is called
            raise
        except (expat.ExpatError, LookupError) as error:  # also an encoding that nobody knows
            raise FormatError(f"not XML: {error}") from None

    def _started(self, name: str, keys: dict[str, str]) -> None:
        self._deep += 1
        if self._deep > DEEP:
            raise FormatError("not XML: nested too deep")
        self._text.clear()
        self._begin(name.rpartition(":")[2], keys)

    def _ended(self, name: str) -> None:
        self._deep -= 1
        self._end(name.rpartition(":")[2], "".join(self._text))
        self._text.clear()

    def _declared(self, *_: object) -> None:
        raise FormatError("not XML that is read here: it declares entities")
