"""Navigation made of many devices: which one is believed for each kind of data, for how long, and the message of it all.

A bus or a line decodes what it hears and files each reading here, under its kind and its device. The rules are those of
docs/nmea2000.md, "Which source counts", on all of them.
"""

import math
from typing import Any, Final, Generic, NamedTuple, Protocol

from delfim.base.selection import A, Newest
from delfim.canproxy.dsor.messages import Navigation

# Ages to which a value counts, whatever the vehicle's `stale_s`, of kinds that come less often than positions.
SLOW_S: Final = 2.5  # once a second
VARIATION_S: Final = 60.0  # some devices send it every ten seconds, and it changes by a minute of arc in a day's sail
STANDSTILL_MPS: Final = 0.1  # receivers give no course at rest; an unknown course up to this speed means zero velocity
SQRT2: Final = math.sqrt(2.0)  # an accuracy in the plane is that of two axes

MOVING: Final = dict.fromkeys(("position", "velocity", "heading", "rate"), 0.0)  # kinds of every bus, with no such age


class Hearer(Protocol):
    """Takes a value of the chosen device: "position" (latitude, longitude), "velocity" (north, east), "heading" (true), "rate"
    (positive to starboard); rad, m/s. `utc_ns`: when it was so, 0 where the device does not say. `deviation`: its standard
    deviation per axis, m, m/s or rad, as the device states it; 0 where it does not."""

    def __call__(self, kind: str, value: tuple[float, ...], utc_ns: int, deviation: float = 0.0) -> None: ...


class Quality(NamedTuple):
    """What a receiver says of its positions, as in `Navigation`."""

    fix: int
    satellites: int
    hdop: float | None
    corrections_s: float | None = None


UNSTATED: Final = Quality(2, 0, None)  # a position without quality data counts as two-dimensional


class Fusion(Generic[A]):
    """The newest reading of each kind from each device, and the message made of those that are chosen: a value older than its
    limit is None there. Of the kinds used here position, velocity and attitude are (latitude, longitude), (north, east) and
    (roll, pitch), heading and rate are alone in a tuple, variation and time are numbers; a bus may have others."""

    def __init__(
        self, kinds: dict[str, float], stale_s: float, preferred: tuple[A, ...] = (), variation_deg: float = 0.0
    ) -> None:
        """`kinds`, in the order of the report: the age to which each counts where `stale_s` is shorter. `variation_deg` holds
        where no device tells one."""
        self.kinds: dict[str, Newest[A, Any]] = {kind: Newest(preferred, max(stale_s, at_s)) for kind, at_s in kinds.items()}
        self.talking: Newest[A, bool] = Newest(preferred, stale_s)  # sends positions, even if only to say that it has none
        self.all = (*self.kinds.values(), self.talking)
        self.hearer: Hearer | None = None
        self._variation_rad = math.radians(variation_deg)
        self._counter = 0

    def put(self, kind: str, device: A, value: object, now_s: float) -> None:
        """File a reading. None: the device says that it does not know, which ends what it said before."""
        self.kinds[kind].put(device, value, now_s)

    def take(self, kind: str, device: A, value: tuple[float, ...] | None, now_s: float, deviation: float = 0.0) -> None:
        """File a reading, and hand it over."""
        newest = self.kinds[kind]
        newest.put(device, value, now_s)
        if self.hearer is not None and value is not None and newest.choose(now_s) == device:
            self.hearer(kind, value, 0, deviation)

    def tell(
        self, kind: str, device: A, value: tuple[float, ...] | None, now_s: float, utc_ns: int | None, deviation: float = 0.0
    ) -> None:
        """Hand a value over, if it is of the device that is chosen for its kind."""
        if self.hearer is not None and value is not None and self.kinds[kind].choose(now_s) == device:
            self.hearer(kind, value, utc_ns or 0, deviation)

    def place(self, device: A, position: tuple[float, float] | None, now_s: float) -> bool:
        """File a position. Whether it makes a message: the device is the chosen one, or, while none has a position, the chosen
        one of those that talk of it."""
        positions = self.kinds["position"]
        positions.put(device, position, now_s)
        chosen = positions.choose(now_s)
        if chosen is None:
            chosen = self.talking.choose(now_s)
        return chosen == device

    def message(
        self,
        position: tuple[float, float] | None,
        utc_ns: int,
        now_s: float,
        fix: int,
        satellites: int,
        hdop: float | None,
        accuracy_m: float | None = None,
        corrections_s: float | None = None,
    ) -> Navigation:
        """The message of a position that was placed, with the newest of everything else."""
        kinds = self.kinds
        latitude_rad, longitude_rad = position or (None, None)
        north_mps, east_mps = kinds["velocity"].get(now_s) or (None, None)
        (heading_rad,) = kinds["heading"].get(now_s) or (None,)
        (rate_radps,) = kinds["rate"].get(now_s) or (None,)
        roll_rad, pitch_rad = kinds["attitude"].get(now_s) or (None, None)
        self._counter = self._counter + 1 & 0xFF
        fields = (
            utc_ns,
            latitude_rad,
            longitude_rad,
            north_mps,
            east_mps,
            heading_rad,
            rate_radps,
            roll_rad,
            pitch_rad,
            fix if position else 0,
            satellites,
            hdop,
            self._counter,
            accuracy_m if position else None,
            corrections_s,
        )
        return tuple.__new__(Navigation, fields)  # half the time of Navigation(...): this is on the critical path

    def variation_rad(self, device: A, now_s: float) -> float:
        """For a magnetic angle of a device: its own variation, else that of the chosen device, else the vehicle's file."""
        variations: Newest[A, float] = self.kinds["variation"]
        found = variations.of(device, now_s)
        found = variations.get(now_s) if found is None else found
        return self._variation_rad if found is None else found

    def set_time(self, device: A, utc_ns: int | None, now_s: float) -> None:
        self.put("time", device, None if utc_ns is None else utc_ns - round(now_s * 1e9), now_s)

    def utc_ns(self, device: A, now_s: float) -> int:
        """The time now, by the device of the position if it tells the time; 0 while nobody does: the computer's own clock is
        not compared with itself."""
        times: Newest[A, int] = self.kinds["time"]  # UTC minus monotonic time, ns
        offset_ns = times.of(device, now_s)
        offset_ns = times.get(now_s) if offset_ns is None else offset_ns
        return 0 if offset_ns is None else offset_ns + round(now_s * 1e9)

    def used(self, now_s: float) -> dict[str, tuple[A | None, float | None]]:
        """The device used for each kind, and the age of its value. None, None: nobody (for variation: the vehicle's file)."""
        chosen = {kind: newest.choose(now_s) for kind, newest in self.kinds.items()}
        return {kind: (each, None if each is None else self.kinds[kind].age_s(each, now_s)) for kind, each in chosen.items()}


def over_ground(course_rad: float | None, speed_mps: float | None) -> tuple[float, float] | None:
    """(north_mps, east_mps)."""
    if speed_mps is None:
        return None
    if course_rad is None:
        return (0.0, 0.0) if speed_mps <= STANDSTILL_MPS else None
    return speed_mps * math.cos(course_rad), speed_mps * math.sin(course_rad)
