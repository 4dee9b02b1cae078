"""The function that sees it, ten times a second."""

from delfim.api import Look
from example_trouble import FewSatellites


def few_satellites(look: Look) -> str | None:
    """Why it is there, in words; None: it is not."""
    navigation, least = look.state.navigation, look.settings.failsafe.of(FewSatellites).satellites
    if navigation is None or navigation.satellites >= least:
        return None
    return f"{navigation.satellites} satellites"
