"""The workers that sail the batches: processes of this machine, or those of a Dask cluster. Both get few batches at a time."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from itertools import islice
from multiprocessing.connection import Connection
from typing import Any, Final

from delfim.base.errors import DelfimError
from delfim.campaign.runplan import Batch, Plan
from delfim.campaign.sailing import VERSION, sail_batch

AHEAD: Final = 3  # batches handed out for each worker: enough that nobody waits, few enough that nobody remembers a million
START_S: Final = 60.0  # until the first worker of a cluster must be there
DEATHS: Final = 3  # of workers, one after the other without a finished batch between, until it is given up

Rows = list[dict[str, Any]]
Work = Callable[[Plan, Batch, str], Rows]  # what a worker does with a batch, given the version of who asks


def by_processes(
    plan: Plan, batches: Iterable[Batch], count: int, work: Work = sail_batch
) -> Generator[tuple[int, Rows], None, None]:
    """Sail batches by processes; yields their rows in any order. A killed process breaks the whole pool: it is made anew with
    what is missing. Whoever closes this need not wait for what is being sailed. Raises DelfimError when workers go on dying."""
    left, deaths, rest = deque[Batch](), 0, iter(batches)
    kind = multiprocessing.get_context("forkserver")  # the program is imported once, and not by each worker
    kind.set_forkserver_preload(["delfim.campaign.sailing"])
    while True:
        heard, told = kind.Pipe(duplex=False)
        pool = ProcessPoolExecutor(count, kind, _deaf, (heard,))
        waiting = dict[Future[Rows], Batch]()
        try:
            while True:
                while len(waiting) < AHEAD * count and (left := left or deque(islice(rest, 1))):
                    waiting[pool.submit(work, plan, left[0], VERSION)] = left[0]  # a broken pool refuses it: then it stays
                    left.popleft()
                if not waiting:
                    return
                for each in wait(waiting, return_when=FIRST_COMPLETED).done:
                    rows = each.result()
                    number, deaths = waiting.pop(each).number, 0
                    yield number, rows
        except BrokenProcessPool:
            deaths += 1
            if deaths >= DEATHS:
                raise DelfimError(f"{DEATHS} worker processes died one after the other") from None
            left.extend(waiting.values())
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            told.close()
            heard.close()


def _deaf(heard: Connection) -> None:
    """Ignore signals, which are for the process that writes; a worker ends when that closes its end of the pipe, however it
    ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_it() -> None:
        heard.poll(None)
        os._exit(1)

    threading.Thread(target=end_with_it, daemon=True).start()


def by_cluster(
    plan: Plan, batches: Iterable[Batch], address: str, work: Work = sail_batch
) -> Generator[tuple[int, Rows], None, None]:
    """Sail batches by a Dask scheduler, whose workers may come and go. Nothing that a batch needs lives on workers alone: the
    plan goes with each. Raises DelfimError where there is no cluster, or it was lost, or a worker has other code."""
    dask: Any = import_module("distributed")
    try:
        client = dask.Client(address, timeout="10s")
    except OSError as error:
        raise DelfimError(f"no Dask cluster at {address}: {error}") from None
    with client:
        _check(client, address)
        rest, taken, waiting, deaths = iter(batches), dask.as_completed(), dict[str, Batch](), 0

        def hand_out(some: Iterable[Batch]) -> None:
            for batch in some:
                key = f"{plan.digest}-{batch.number}-{deaths}"
                waiting[key] = batch
                taken.add(client.submit(work, plan, batch, VERSION, key=key, pure=False, retries=2))

        def free() -> int:
            threads: int = sum(client.nthreads().values())
            return max(0, AHEAD * max(1, threads) - len(waiting))

        hand_out(islice(rest, free()))
        for future in taken:
            batch = waiting.pop(future.key)
            try:
                rows: Rows = future.result()
            except dask.scheduler.KilledWorker:  # Dask has seen several workers die that had this batch
                deaths += 1
                if deaths >= DEATHS:
                    raise DelfimError(f"workers of the cluster at {address} die one after the other") from None
                hand_out([batch])
                continue
            except (dask.CancelledError, OSError) as error:
                raise DelfimError(f"the cluster at {address} lost a batch: {error}; the same command goes on") from None
            deaths = 0
            yield batch.number, rows
            future.release()
            hand_out(islice(rest, free()))


def _check(client: Any, address: str) -> None:
    """Check that every worker has this code, by its digest and not by its number alone."""
    try:
        client.wait_for_workers(1, timeout=START_S)
    except TimeoutError:
        raise DelfimError(f"the Dask cluster at {address} has no workers") from None
    found = client.run(_version, on_error="ignore")  # one that dies now is asked again by its first batch
    for worker, version in found.items():
        if version != VERSION:
            raise DelfimError(f"the worker {worker} has {version}, this is {VERSION}")


def _version() -> str:
    return VERSION
