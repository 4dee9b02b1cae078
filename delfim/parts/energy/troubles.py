"""The trouble of the energy: the way home takes what is left but the reserve."""

from typing import Final

from delfim.parts.energy.table import EnergyTable
from delfim.vehicle.failsafe.troubles import NUMBERS, Look

BACK: Final = 0.02  # of the capacity: the trouble stays until so much more is there


def energy(look: Look) -> str | None:
    now = look.state.energy
    if now is None or now.left_wh is None:
        return None
    if now.no_way_home:
        return f"no way home: the water runs at {now.current_mps:.1f} m/s towards {now.current_deg:.0f} degrees"
    back_wh = BACK * look.settings.of(EnergyTable).capacity_wh if NUMBERS["energy"] in look.present else 0.0
    if now.home_wh is None or now.left_wh - now.home_wh - now.doubt_wh > now.reserve_wh + back_wh:
        return None
    takes = f"{now.home_wh:.0f} to {now.home_wh + now.doubt_wh:.0f}" if now.doubt_wh >= 1.0 else f"{now.home_wh:.0f}"
    return f"home takes {takes} Wh of the {now.left_wh:.0f} Wh left, and {now.reserve_wh:.0f} Wh are the reserve"
