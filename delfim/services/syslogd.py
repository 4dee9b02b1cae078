"""syslogd: writes the records of all programs of the suite to the disk (docs/log-format.md).

It has a process of its own: a slow disk holds up nobody else. The others write into its pipe and do not wait for it
(delfim.logging.systemlog). It is the first to start beside the runtime and the last to end, so that it hears the others.
"""

import asyncio
import logging
import os
from pathlib import Path

from delfim import __version__
from delfim.base import tables
from delfim.logging.openlog import log_settings
from delfim.logging.systemlog import PIPE, open_pipe
from delfim.logging.systemlog.writer import ID, SUFFIX, SystemWriter
from delfim.logging.writer import step_back
from delfim.services.runtime import Runtime

LOOK_S = 0.1  # between two looks into the pipe

log = logging.getLogger(__name__)


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled; then write what is left in the pipe. It does little, but not only when the
    processor is idle, as other services beside the runtime: on a busy one it would be seconds late, and a power cut would cost
    them."""
    step_back(0)
    settings = runtime.config
    directory = settings.runtime.run_directory
    pipe = open_pipe(str(Path(directory) / PIPE))
    start: dict[str, object] = {"version": __version__, "settings": tables.shown(settings)}
    limits = log_settings(settings.log, ID, SUFFIX)
    writer = SystemWriter(pipe, limits, directory, runtime.clock, start, lambda words: log.warning("the system log: %s", words))
    try:
        with runtime.publishing("syslogd", writer.figures):
            while True:
                writer.turn()
                await asyncio.sleep(LOOK_S)
    finally:
        writer.close()
        os.close(pipe)
