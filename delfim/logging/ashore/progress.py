"""A progress bar for work that takes longer than two seconds, on a terminal. Needs rich there; elsewhere nothing is shown."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Final, TypeVar

SHOWN_AFTER_S: Final = 2.0

T = TypeVar("T")


def progress(what: str, total: float, *, bytes: bool = False) -> Callable[[float], None]:  # noqa: A002
    """Make a function to call with the work done so far; the bar shows share and time left, and for bytes the rate."""
    if not sys.stderr.isatty():
        return lambda done: None
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    columns = [TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %")]
    columns += [DownloadColumn(), TransferSpeedColumn()] if bytes else []
    bar = Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True)
    task, began_s = bar.add_task(what, total=max(total, 1)), time.monotonic()

    def told(done: float) -> None:
        bar.update(task, completed=done)
        if done >= total:
            bar.stop()
        elif not bar.live.is_started and time.monotonic() - began_s > SHOWN_AFTER_S:
            bar.start()

    return told


def tracked(what: str, items: Iterable[T], total: float, size: Callable[[T], float]) -> Iterator[T]:
    """The items, with a bar that shows how much of the total their sizes make up."""
    told, done = progress(what, total), 0.0
    for item in items:
        yield item
        done += size(item)
        told(done)
    told(total)
