"""Navigation told to other instruments: when something is told, and when not."""

from types import SimpleNamespace

from delfim.canproxy.dsor.messages import Navigation
from delfim.parts.nmea0183.output import Teller
from delfim.parts.nmea0183.table import Nmea0183Out
from delfim.vehicle.state import State

HERE = Navigation(1795348800 * 10**9, 0.67, -0.16, 1.0, 0.0, 0.5, None, None, None, 3, 9, 0.9, 1)


class Line:
    takes = True

    def __init__(self) -> None:
        self.written: list[bytes] = []

    def write(self, data: bytes) -> bool:
        self.written.append(data)
        return self.takes


def test_old_and_unknown_navigation_is_not_told():
    clock, line, state = SimpleNamespace(monotonic_s=lambda: clock.now_s, now_s=100.0), Line(), State()
    table = Nmea0183Out(to="udp:127.0.0.1:10110", sentences=("HDT", "ROT"), rate_hz=4.0)
    teller = Teller(table, line, 2.5, state, clock)
    assert teller.period_s == 0.25
    teller.tell()
    state.navigation, state.navigation_s = HERE, 100.0
    teller.tell()
    assert line.written == [b"$GPHDT,028.65,T*0C\r\n"]
    state.navigation = HERE._replace(heading_rad=None)
    teller.tell()
    state.navigation, clock.now_s = HERE, 103.0
    teller.tell()
    assert len(line.written) == 1
    state.navigation_s, line.takes = 103.0, False
    teller.tell()
    assert teller.report() == {"told": 1, "unknown": 3, "lost": 1}
