"""Opens a log as the vehicle's file says. Not in liblog: its writers need no vehicle's file."""

from delfim.base.clock import Clock
from delfim.config import LogTable as Limits
from delfim.logging.filelog import FileLog
from delfim.logging.liblog import Log, LogSettings, Method
from delfim.logging.pipelog import PipeLog


def open_log(
    limits: Limits,
    id: str,  # noqa: A002  # the word of the thesis
    suffix: str,
    method: Method,
    clock: Clock,
    *,
    header: bytes = b"",
    nice: int = 10,
) -> Log:
    """Open a log; if that fails the log's status says why, and it retries.

    `header` starts every file. A file ends past `file_bytes` on disk or `file_s`. The guard keeps `free_bytes_min` of the disk
    free by deleting the oldest days, or stops the log (`when_full`), and leaves uploads their own room; see
    delfim.logging.free_space. With "zpipe" the child lives by the computer's own clock, and `clock` only measures its
    silence.
    """
    settings = log_settings(limits, id, suffix, header)
    if method == "zpipe":
        return PipeLog(settings, clock, nice)
    return FileLog(settings, clock, deflate=method == "zwrite")


def log_settings(limits: Limits, id: str, suffix: str, header: bytes = b"") -> LogSettings:  # noqa: A002
    """The settings of a log, from those of all logs."""
    return LogSettings(
        limits.directory,
        id,
        suffix,
        header,
        limits.file_bytes,
        limits.file_s,
        limits.free_bytes_min,
        limits.when_full,
        limits.upload_folder,
        limits.upload_bytes_max,
    )
