"""The keys of the boat's energy in a vehicle's file."""

from typing import Annotated

import msgspec

from delfim.base.ranges import Fraction
from delfim.base.tables import Table

Watts = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]


class EnergyTable(Table, frozen=True):
    """The energy of the batteries, and what is kept of it for the way home (docs/energy.md). The batteries tell their charge,
    their voltage and their current."""

    capacity_wh: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)] = 0.0  # of all batteries together, full; 0: nothing is reckoned
    reserve: Fraction = 0.15  # of it, that is left when the boat is home
    idle_w: Watts = 10.0  # of all that is on while the motors rest: a guess, until the batteries tell
    full_w: Watts = 0.0  # of the motors at full thrust ahead: a guess, until the batteries tell; 0: 8 W for each newton
