"""The text `BOAT_SIZE`: how large a boat is and what its motors turn at most. Both ends of it."""

from typing import Final, NamedTuple

from delfim import config

SIZE_MAX: Final = (500.0, 100.0, 100_000.0)


class BoatSize(NamedTuple):
    """Over all, and the revolutions a minute of its motors at full command; 0: not known."""

    length_m: float
    beam_m: float
    rpm_max: float


def told(settings: config.Vehicle) -> str:
    """As the boat says it."""
    rpm_max = max((settings.rpm_max(row) for row in settings.thrusters), default=0.0)
    return f"{settings.boat.length_m:g} {settings.boat.beam_m:g} {rpm_max:g}"


def heard(text: str) -> BoatSize | None:
    """None: it is no size of a boat."""
    try:
        size = BoatSize(*map(float, text.split()))
    except (TypeError, ValueError):
        return None
    return size if all(0.0 <= each <= most for each, most in zip(size, SIZE_MAX, strict=True)) else None
