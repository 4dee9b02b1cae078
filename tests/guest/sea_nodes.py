"""Inside a guest: the boat's other nodes with a clock of their own, which tells the true time however the guest's is set.

python tests/guest/sea_nodes.py UTC-AT-START-OF-THE-GUEST-S FILE [KEY=VALUE ...]
"""

import sys
import time

from delfim import config
from delfim.simulator.realtime import nodes


class SatelliteClock:
    """UTC counted from the start of the guest's kernel."""

    monotonic_s = staticmethod(time.monotonic)

    def time_ns(self) -> int:
        return round(float(sys.argv[1]) * 1e9) + time.monotonic_ns()


nodes.SystemClock = SatelliteClock  # type: ignore[assignment,misc]
nodes.run_nodes(config.load(sys.argv[2], sys.argv[3:]), 1)
