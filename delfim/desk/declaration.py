"""The declaration of a boat under a general exemption of the United Kingdom, MGN 702 or MGN 705, as a form to print.

It fills in what the vehicle's file knows, and says of each other line that the file does not know it. It quotes no condition
of an exemption: who signs has its text before him. Facts of the notices: docs/compliance.md.
"""

from html import escape
from typing import Final

from delfim import config
from delfim.base.modes import Mode
from delfim.desk import htmlpage

SHORT_M: Final = 2.5  # below: MGN 702
LONG_M: Final = 4.5  # below: MGN 705
KNOT_MPS: Final = 1852.0 / 3600.0
FAST_KN: Final = 6.0  # of MGN 705, or planing speed if that is lower
BLANK: Final = "_" * 40
UNKNOWN: Final = f"{BLANK} (the vehicle's file does not know it)"
NOTES: Final = "p.line { margin: 2.2rem 0 .2rem } @media print { body { margin: 0 } }"


def notice(length_m: float) -> str:
    """The notice that a boat of this length may come under; "": neither."""
    return "MGN 702" if length_m < SHORT_M else "MGN 705" if length_m < LONG_M else ""


def form(settings: config.Vehicle, version: str) -> str:
    """The text of the page."""
    boat = settings.boat
    which = notice(boat.length_m)
    title = f"{boat.name}: declaration for {which}" if which else f"{boat.name}: neither MGN 702 nor MGN 705"
    body = [f"<style>{NOTES}</style><h1>{escape(title)}</h1>", f"<p>{escape(_why(boat.length_m, which))}</p>"]
    body.append(htmlpage.table(("the boat", ""), _boat(settings)))
    body.append(htmlpage.table(("control", ""), _control(settings, version)))
    body.append(htmlpage.table(("the hull and the owner", ""), [(each, UNKNOWN) for each in OWNERS]))
    declared = "I have read the exemption and its conditions, and declare that this boat and its operation meet them."
    body += [f"<p>{declared}</p>"] if which else []
    body += [
        f"<p class=line>{BLANK}</p><p>{each}</p>" for each in ("Name of the owner or operator", "Place and date", "Signature")
    ]
    body.append("<p class=soft>Filled in by Delfim from the vehicle's file alone. No authority has seen this form.</p>")
    return htmlpage.whole(title, body)


OWNERS: Final = (
    "Owner, operator, how they are reached",
    "Builder, year, hull number",
    "Safety assurance assessment: reference, date",
    "Where and when the boat is to be operated",
    "Lights, shapes, sound signals",
    "Colour and marks: how the boat is seen",
    "Anti-fouling",
    "Remote camera",
    "Planing speed",
    "Insurance",
)


def _why(length_m: float, which: str) -> str:
    if which:
        bound = f"below {SHORT_M} m" if which == "MGN 702" else f"from {SHORT_M} m to below {LONG_M} m"
        return f"Length overall {length_m} m: {which} is for boats {bound}."
    return f"Length overall {length_m} m: both notices are for boats below {LONG_M} m, and this one is not."


def _boat(settings: config.Vehicle) -> list[tuple[str, str]]:
    boat = settings.boat
    told = [("Name", boat.name), ("Number on its links", str(boat.id)), ("Length overall", f"{boat.length_m} m")]
    told += [("Beam", f"{boat.beam_m} m"), ("Displacement", f"{boat.mass_kg} kg")]
    told += [("Draught", f"{boat.draught_m} m" if boat.draught_m else UNKNOWN)]
    told += [("Height above water", f"{boat.air_draught_m} m" if boat.air_draught_m else UNKNOWN)]
    told += [("Propulsion", ", ".join(f"{row.name} ({row.driver})" for row in settings.thrusters))]
    told += [("MMSI of its transponder", str(settings.traffic.mmsi) if settings.traffic.mmsi else UNKNOWN)]
    return [*told, ("Speed with full thrust", _speed(boat.full_mps, notice(boat.length_m)))]


def _speed(full_mps: float | None, which: str) -> str:
    if full_mps is None:
        return UNKNOWN
    told = f"{full_mps} m/s, {full_mps / KNOT_MPS:.1f} kn"
    if which != "MGN 705":
        return told
    if full_mps > FAST_KN * KNOT_MPS:
        return f"{told}: the boat could be faster than {FAST_KN:.0f} kn, and what keeps it below is for the owner to say"
    return f"{told}: not above {FAST_KN:.0f} kn; whether it planes before, the file does not know"


def _control(settings: config.Vehicle, version: str) -> list[tuple[str, str]]:
    silent = settings.failsafe.console_silent
    handset = settings.handset.device
    return [
        ("Software", f"Delfim {version}"),
        ("Without its console", f"after {silent.after_s:g} s: {silent.action}, other modes as their rows say"),
        ("Who may take control", "any console that has the key, by saying so; any console stops the boat"),
        ("Hand-set above all consoles", f"{settings.handset.protocol} at {handset}" if handset else "none"),
        ("Kill switch", f"{settings.kill.line} of {settings.kill.chip}" if settings.kill.chip else "none that the boat reads"),
        ("Records", f"{settings.log.directory}: each cycle, each command with its sender, each trouble"),
        ("Modes", ", ".join(mode.name.lower() for mode in Mode)),
    ]
