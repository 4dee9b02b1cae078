"""The hardware watchdog: restarts the machine when it is not fed."""

import logging
import os

log = logging.getLogger(__name__)


class Watchdog:
    """A watchdog device, "" for none; if it does not exist there is none."""

    def __init__(self, device: str) -> None:
        self._fd: int | None = None
        if device and os.path.exists(device):
            try:
                self._fd = os.open(device, os.O_WRONLY)
            except OSError as error:
                log.error("%s: %s; going on without it", device, error.strerror)

    def stroke(self, word: bytes) -> None:
        if self._fd is not None:
            try:
                os.write(self._fd, word)
            except OSError as error:
                log.error("hardware watchdog: %s; going on without it", error.strerror)
                self._fd = None
