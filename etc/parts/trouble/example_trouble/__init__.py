"""A trouble: fewer satellites than the boat shall sail by. Its table stands in `[failsafe]` of the vehicle's file."""

from typing import Annotated

import msgspec

from delfim.api import ActionName, Part, Trouble, TroubleRow


class FewSatellites(Trouble, frozen=True):
    """Fewer satellites than the boat shall sail by."""

    satellites: Annotated[int, msgspec.Meta(ge=0, le=99)] = 4  # of those in use
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 0.3  # for this long
    action: ActionName = "warn"  # in every mode whose own key is "same"


PART = Part(
    "example_trouble", troubles=(TroubleRow("few_satellites", 29, FewSatellites, "example_trouble.sees:few_satellites"),)
)
