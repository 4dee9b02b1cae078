"""A mode: the boat weaves about a course, as a net or an array is towed. Its row and its keys."""

from typing import Annotated

import msgspec

from delfim.api import ModeRow, Part, Seconds, Speed, Table


class WeaveTable(Table, frozen=True):
    """Weaving about the heading that the boat had at the beginning."""

    width_deg: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 20.0  # to either side
    period_s: Seconds = 40.0  # of one weave
    speed_mps: Speed = 1.0  # through the water


PART = Part("example_mode", WeaveTable, modes=(ModeRow("weave", 120, "example_mode.weave"),))
