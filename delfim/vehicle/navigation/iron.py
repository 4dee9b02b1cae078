"""The boat's own iron about a magnetic compass that tells a heading alone, undone by five numbers of the magnet.

The compass feels the earth's horizontal field, of which soft iron makes an ellipse and hard iron moves its middle, and tells
the direction of what it feels. Its strength it does not tell, but there is one at which the earth's field would be whole.
"""

import math

from delfim.config import CompassTable


class Iron:
    """What stands between a true magnetic heading and the one that is told."""

    def __init__(self, table: CompassTable) -> None:
        along, across = 1.0 + table.soft_along, table.soft_across
        other = 1.0 - table.soft_along
        area = along * other - across * across
        self._inverse = other / area, -across / area, along / area  # of the ellipse, which is symmetric
        self._offset_rad = math.radians(table.offset_deg)
        self._middle = self._rounded(table.hard_ahead, table.hard_aside)

    def undone(self, told_rad: float) -> float:
        """The magnetic heading of the bow, 0 to 2 pi, for the one that the compass tells."""
        direction = told_rad - self._offset_rad
        x, y = self._rounded(math.cos(direction), -math.sin(direction))
        hard_x, hard_y = self._middle
        square, mixed = x * x + y * y, x * hard_x + y * hard_y
        strength = (mixed + math.sqrt(mixed * mixed + square * (1.0 - hard_x * hard_x - hard_y * hard_y))) / square
        return math.atan2(hard_y - strength * y, strength * x - hard_x) % math.tau

    def _rounded(self, x: float, y: float) -> tuple[float, float]:
        """A field ahead and to starboard, with the ellipse made a circle again."""
        a, b, c = self._inverse
        return a * x + b * y, b * x + c * y


def iron_of(table: CompassTable) -> Iron | None:
    """The iron of the vehicle's file; None where it says that there is none."""
    return Iron(table) if table != CompassTable() else None
