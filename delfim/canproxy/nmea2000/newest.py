"""Chooses which of several devices on an NMEA 2000 bus is used."""

from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """The newest value of one kind from each address, and the chosen address: the first preferred one whose value is
    fresh; else the present one while it is fresh; else the lowest fresh address. At most 256 addresses exist."""

    def __init__(self, preferred: tuple[int, ...], limit_s: float) -> None:
        self._preferred, self._limit_s = preferred, limit_s
        self._values: dict[int, tuple[T, float]] = {}
        self._order: tuple[int, ...] = preferred  # preferred, then the present one

    def put(self, address: int, value: T | None, now_s: float) -> None:
        """File a value. None: the source says that it has none, which cancels its last value."""
        if value is None:
            self._values.pop(address, None)
        else:
            self._values[address] = value, now_s

    def choose(self, now_s: float) -> int | None:
        """The address chosen now, None when none is fresh."""
        values, oldest_s = self._values, now_s - self._limit_s
        for address in self._order:
            held = values.get(address)
            if held is not None and held[1] >= oldest_s:
                break
        else:
            fresh = [address for address, (_, t_s) in values.items() if t_s >= oldest_s]
            if not fresh:
                return None
            address = min(fresh)
        self._order = (*self._preferred, address)
        return address

    def get(self, now_s: float) -> T | None:
        """The value of the chosen address."""
        address = self.choose(now_s)
        return None if address is None else self._values[address][0]

    def of(self, address: int, now_s: float) -> T | None:
        """The value of one address, None when it is not fresh."""
        held = self._values.get(address)
        return held[0] if held is not None and held[1] >= now_s - self._limit_s else None

    def age_s(self, address: int, now_s: float) -> float:
        return now_s - self._values[address][1]
