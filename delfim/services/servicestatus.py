"""The state of a service of the runtime, for its page and its console."""

import logging
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from delfim.services.priority.navigation_loop import Account

Stage = Literal["starting", "running", "waiting", "failed", "stopped"]


log = logging.getLogger(__name__)


@dataclass(slots=True)
class ServiceStatus:
    """The state of a service. `since_s` is the monotonic time of the last change of state."""

    name: str
    place: str
    account: Account
    pid: int
    since_s: float
    state: Stage = "starting"
    restarts: int = 0
    reason: str = ""  # of the last end, in words
    told: str = ""  # the reason in the log, until it runs again
    failure: Exception | None = None  # raised by a callback and not yet acted upon

    def report(self, now_s: float) -> dict[str, object]:
        """The report, JSON-ready."""
        return {
            "place": self.place,
            "state": self.state,
            "for_s": round(now_s - self.since_s, 1),
            "restarts": self.restarts,
            "reason": self.reason,
            "pid": self.pid,
            "busy_s": round(self.account.busy_s, 3),
            "longest_callback_s": round(self.account.longest_s, 6),
            "over_budget": self.account.over_budget,
        }


def status_file(path: Path) -> int:
    """Open the file of the status; -1 if it cannot be opened."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        log.warning("%s: %s; going on without it", path, error.strerror)
        return -1
