"""Blocking calls in threads, for services that read and write files."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


async def worked(workers: ThreadPoolExecutor, do: Callable[..., T], *arguments: object) -> T:
    """Run a call in a worker, and return its result. A caller that is cancelled goes on when the call has ended, or was taken
    back before it began: what he then closes is not in use any more, and what was opened for him, into an ExitStack of his, he
    closes, too."""
    call = workers.submit(do, *arguments)
    doing = asyncio.wrap_future(call)
    try:
        return await asyncio.shield(doing)
    except asyncio.CancelledError:
        if not call.cancel():
            await asyncio.wait([doing])
        raise
