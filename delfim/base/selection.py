"""The choice among several devices that send the same kind of data."""

from typing import Any, Generic, Protocol, TypeVar


class _Ordered(Protocol):
    def __lt__(self, other: Any, /) -> bool: ...


A = TypeVar("A", bound=_Ordered)  # an address: of a bus, or a name
T = TypeVar("T")


class Newest(Generic[A, T]):
    """The newest value of one kind from each address, and the chosen address: the first preferred one whose value is
    fresh; else the present one while it is fresh; else the lowest fresh address. The caller bounds the addresses."""

    def __init__(self, preferred: tuple[A, ...], limit_s: float) -> None:
        self._limit_s = limit_s
        self._values: dict[A, tuple[T, float]] = {}
        self._preferred = preferred
        self._order: tuple[A, ...] = preferred  # preferred, then the present one

    def prefer(self, preferred: tuple[A, ...]) -> None:
        """Set another order of preference."""
        self._preferred = self._order = preferred

    def put(self, address: A, value: T | None, now_s: float) -> None:
        """File a value. None: the device reports that it has none, which cancels its last value."""
        if value is None:
            self._values.pop(address, None)
        else:
            self._values[address] = value, now_s

    def choose(self, now_s: float) -> A | None:
        """Choose an address; None when none is fresh."""
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
        if not self._order or self._order[-1] != address:
            self._order = (*self._preferred, address)
        return address

    def get(self, now_s: float) -> T | None:
        """The value of the chosen address."""
        address = self.choose(now_s)
        return None if address is None else self._values[address][0]

    def of(self, address: A, now_s: float) -> T | None:
        """The value of one address, None when it is not fresh."""
        held = self._values.get(address)
        return held[0] if held is not None and held[1] >= now_s - self._limit_s else None

    def age_s(self, address: A, now_s: float) -> float:
        return now_s - self._values[address][1]
