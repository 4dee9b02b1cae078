"""UTC as devices tell it, in numbers of the calendar."""

from datetime import UTC, datetime

from delfim.base.errors import FormatError


def utc_ns(year: int, month: int, day: int, hour: int, minute: int, second: int, nano: int) -> int:
    """UTC since 1970 in nanoseconds. `nano` may be negative; a leap second counts as the second before. Raises FormatError."""
    try:
        at = datetime(year, month, day, hour, minute, min(second, 59), tzinfo=UTC)
    except ValueError:
        raise FormatError("no such time") from None
    return round(at.timestamp()) * 1_000_000_000 + nano
