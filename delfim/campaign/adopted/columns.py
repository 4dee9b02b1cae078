"""The columns of a run that is an adoption: what was found less the truth, and how the boat sails with it."""

from typing import Final, NamedTuple

ADOPTION: Final = "adoption"  # the scenario's name


class Column(NamedTuple):
    name: str  # with its unit
    kind: str  # of DuckDB
    words: str


def _of(kind: str, rows: dict[str, str]) -> tuple[Column, ...]:
    return tuple(Column(name, kind, words) for name, words in rows.items())


VOYAGE: Final = {
    "over_deg": "beyond a heading 90 degrees to starboard",
    "settled_s": "from that order until she stays within 5 degrees of it",
    "path_m": "off two lines, root of the mean square, in truth",
    "hold_m": "off the point that she holds, the same",
    "speed_off": "off the speed asked for on the lines, as a part of it, the same",
}
WITH: Final = {"": "with what was found", "today_": "with the gains before", "truth_": "with gains of her true hull"}

COLUMNS: Final = (
    *_of(
        "VARCHAR",
        {
            "ended": "why the trial ended before its end, in words",
            "motors": "right, wrong, none",
            "refused": "why the fit was refused, in words",
            "proof": "why the proof sail did not prove it, in words",
        },
    ),
    *_of("INTEGER", {"beyond": "1: full speed was not sailed, and is extrapolated", "proven": "1: the proof sail proved it"}),
    *_of(
        "DOUBLE",
        {
            "sailed_s": "time of the trial",
            "most_m": "farthest from the middle of the circle, in truth",
            "most_part": "the same as a part of its radius",
            "full_off": "full speed, as a part of the true one",
            "dead_off": "dead band, of the motor that is more wrong, parts of command",
            "late_off_s": "delay and lag of the motors",
            "straight_off_deg": "angle at which she goes straight",
            "offset_off_deg": "offset of the compass",
            "deviation_off_deg": "deviation on the worst heading",
            "least_s": "in which full power one way and the other turns her by 90 degrees: no control is quicker",
            "twin_rms_m": "the twin's track of a mission of 300 m off hers, in the same sea",
            "twin_most_m": "the same at most",
        },
    ),
    *_of("DOUBLE", {f"{of}{name}": f"{words}, {what}" for of, what in WITH.items() for name, words in VOYAGE.items()}),
)
