"""The keys of the boat's own propellers in its file."""

from typing import Annotated

import msgspec

from delfim.base.tables import Table


class Dsor(Table, frozen=True):
    """The propellers of DelfimX, on the bus of the boat's own nodes: address 0 is the starboard one, 1 the port one."""

    rpm_max: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 1200  # at full command, ahead and astern
