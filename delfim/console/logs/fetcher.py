"""`python -m delfim.console.logs.fetcher`: fetches the logs of a boat, for the console.

One line of JSON comes in: `url`, `folder`, and `state`, for state logs and sidecars alone. Out go lines: `total`, then `done`,
in bytes; at the end `files` and how many are `cut`, or why it was `refused`. What is here already is not fetched again.
With `put`, a file of this computer, that is written there instead, as `path`; at the end come the `bytes` that are `sent`.
"""

import contextlib
import ftplib
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from delfim.base.errors import DelfimError, in_words
from delfim.logging.ashore.fetch import opener, transfer, wanted
from delfim.logging.ashore.tree import ALWAYS

EVERY_S: Final = 0.25  # between two words of how far it is


def main() -> None:
    asked = json.loads(sys.stdin.readline())
    try:
        connect = opener(asked["url"])
        if "put" in asked:
            data = Path(asked["put"]).read_bytes()
            with contextlib.closing(connect()) as boat:
                boat.write(asked["path"], data, _shown(len(data)))
            _say(sent=True, bytes=len(data))
            return
        with contextlib.closing(connect()) as boat:
            entries = wanted(boat.entries(), [], ALWAYS, summary=asked["state"])
        outcome = transfer(connect, entries, Path(asked["folder"]), lambda words: None, _shown)
    except (DelfimError, OSError, EOFError, ftplib.Error, UnicodeError) as error:
        _say(refused=in_words(error) if isinstance(error, DelfimError | OSError) else str(error) or type(error).__name__)
    else:
        _say(files=len(outcome.fetched), bytes=outcome.bytes, cut=len(outcome.cut))


def _shown(total: float) -> Callable[[float], None]:
    due_s = [0.0]
    _say(total=total)

    def told(done: float) -> None:
        now_s = time.monotonic()
        if now_s >= due_s[0] or done >= total:
            due_s[0] = now_s + EVERY_S
            _say(done=done)

    return told


def _say(**words: object) -> None:
    print(json.dumps(words), flush=True)


if __name__ == "__main__":
    main()
