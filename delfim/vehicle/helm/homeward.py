"""The way home where a chart is aboard: the driven track, with ways round where a piece of it leads where nobody may sail.

The track was driven, but a long one has lost points, a mission may have opened water that is closed now, and a boat that was
off has drifted. So each piece is looked at as it is driven, in slices beside the loop, and mended: whoever asks for the way
home, operator, failsafe or energy, has it at once.
"""

from collections.abc import Iterable
from typing import Final

from delfim.base.cooperative import Remains, Sliced
from delfim.vehicle.helm.detour import SLICE, most, way_kept
from delfim.vehicle.helm.waterway import Shut
from delfim.vehicle.plans import fence
from delfim.vehicle.plans.fence import Fence
from delfim.vehicle.plans.track import Point, Track

SEEKING: Final = "the way home is being looked for"


class Homeward:
    """Call `look` ten times a second. `why` there is no way home, in words; empty: it is the track's."""

    def __init__(self, track: Track, remains: Remains) -> None:
        self._track, self._remains = track, remains
        self._around: Fence | None = None  # in which the pieces were looked at
        self._is_charted, self._most = False, 0
        self._piece: tuple[Point, Point] | None = None  # that a way round is looked for, or was not found
        self._work: Sliced[tuple[Point, ...] | Shut] | None = None
        self._held, self._shut = list[Iterable[object]](), ""

    @property
    def is_sought(self) -> bool:
        """Whether it is not known yet."""
        piece = self._track.piece() if self._is_charted else None
        return piece is not None and not (self._shut and piece == self._piece)

    @property
    def why(self) -> str:
        if not self._is_charted or (piece := self._track.piece()) is None:
            return ""
        return f"no way home: {self._shut}" if self._shut and piece == self._piece else SEEKING

    def look(self, around: Fence | None, speed_mps: float) -> None:
        """A slice of looking at it, for a boat that goes home at this speed."""
        if around is not self._around:
            self._leave(None)
            self._around = around
            self._is_charted = around is not None and any(zone.field is not None for zone in around.zones)
            self._most = most(around) if around is not None else 0
            self._track.look_again()
        left = SLICE
        while around is not None and self._is_charted and left > 0 and (piece := self._track.piece()) is not None:
            if piece != self._piece:
                self._leave(None)
                left -= self._looked(around, *piece, speed_mps)
            elif self._work is None:
                if not self._steps_aside(around, piece[0]):
                    return
            else:
                self._search(self._work, left)
                return

    def _looked(self, around: Fence, a: Point, b: Point, speed_mps: float) -> int:
        """Judge a piece, or begin a search for its mending; how many comparisons that took."""
        leads, looked = fence.is_clear(around, a, b)
        has_room, more = fence.has_room(around, b, around.limits.margin_m)
        if leads and has_room:
            self._track.mend(())
        elif not has_room:
            if not self._track.drop(older=True):
                self._leave((a, b), "its end is in water that is forbidden")
        elif not self._steps_aside(around, a):
            self._leave((a, b))
            self._work = Sliced(way_kept(around, a, b, speed_mps, self._held))
        return looked + more + 1

    def _steps_aside(self, around: Fence, a: Point) -> bool:
        """Whether the newer point of the piece is no place to go by, and the boat has come on since."""
        return not fence.has_room(around, a, around.limits.margin_m)[0] and self._track.drop(older=False)

    def _search(self, work: Sliced[tuple[Point, ...] | Shut], left: int) -> None:
        if work.step(left):
            if isinstance(work.result, Shut):
                self._leave(self._piece, work.result.why)
            else:
                self._leave(None)
                self._track.mend(work.result)
        elif work.spent >= self._most:
            self._leave(self._piece, "the search took too long")

    def _leave(self, piece: tuple[Point, Point] | None, shut: str = "") -> None:
        """Let the search go."""
        self._remains.add(*self._held)
        self._piece, self._work, self._held, self._shut = piece, None, [], shut
