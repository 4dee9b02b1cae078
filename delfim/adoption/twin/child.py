"""A process of its own for work that takes seconds: who asked stays quick, and may end it."""

import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Final

from delfim.base.errors import DelfimError

KIND: Final = "spawn"  # a fork would take threads and sockets with it
Tell = Callable[[str], object]


def in_child(work: Callable[..., Any], *values: object, tell: Tell) -> Any:
    """Call `work(*values, tell)` in a process that ends with this one, and return what it returns; what it tells is told here.
    Where this is such a process already, it works in it. Raises DelfimError: its own, or that it died."""
    if multiprocessing.current_process().daemon:
        return work(*values, tell)
    kind = multiprocessing.get_context(KIND)
    heard, said = kind.Pipe(duplex=False)
    child = kind.Process(target=_work, args=(said, work, values), daemon=True)
    child.start()
    said.close()
    try:
        while True:
            match heard.recv():
                case ("told", words):
                    tell(words)
                case ("done", result):
                    return result
                case (_, why):
                    raise DelfimError(why)
    except EOFError:
        raise DelfimError("the process that reckoned it died") from None
    finally:
        child.terminate()
        child.join()
        heard.close()


def _work(said: Connection, work: Callable[..., Any], values: tuple[object, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is for the process that asked, which then ends this one
    try:
        said.send(("done", work(*values, lambda words: said.send(("told", words)))))
    except DelfimError as error:
        said.send(("failed", str(error)))
