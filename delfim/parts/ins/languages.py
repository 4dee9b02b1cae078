"""The protocols, by their names in a vehicle's file."""

from typing import Final

from delfim.parts.ins import anpp, sbg, vectornav, xsens
from delfim.parts.ins.insmessages import Language

LANGUAGES: Final[dict[str, Language]] = {
    "vectornav": vectornav.LANGUAGE,
    "xsens": xsens.LANGUAGE,
    "sbg": sbg.LANGUAGE,
    "anpp": anpp.LANGUAGE,
}
