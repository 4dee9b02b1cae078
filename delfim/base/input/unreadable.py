"""What is caught where msgspec reads a message. Apart from the rest: without msgspec a program that reads none, as a log's
writer, is smaller by 3 MB."""

from typing import Final

import msgspec

UNREADABLE: Final = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)  # raised by msgspec for invalid JSON
