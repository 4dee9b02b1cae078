"""The state of a service of the runtime, for its page and its console."""

from dataclasses import dataclass
from typing import Literal

from delfim.services.priority import Account

Stage = Literal["starting", "running", "waiting", "failed", "stopped"]


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
        """JSON-ready."""
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
