"""The record of a trial, for the fit. Needs numpy."""

from delfim.adoption.record import BoatRecord, Manoeuvre, Series
from delfim.adoption.trial.motors import as_corrected
from delfim.adoption.trial.session import TrialProgress
from delfim.base.errors import DelfimError


def record_of(progress: TrialProgress) -> BoatRecord:
    """The record for the fit: what was told, in the order and with the signs of the corrected rows, and how she moved."""
    rows, found = progress.thrusters, progress.motors
    if found is None:
        raise DelfimError("the motors were not found: there is nothing to fit")
    told = [(each.at_s, *as_corrected(found, rows, each.told)) for each in progress.tape]
    return BoatRecord(
        thrusters=tuple(row.name for row in rows),
        told=Series.of(told, len(rows)),
        position=Series.of([(each.at_s, each.north_m, each.east_m) for each in progress.tape], 2),
        velocity=Series.of([(each.at_s, each.north_mps, each.east_mps) for each in progress.tape], 2),
        heading=Series.of([(each.at_s, each.heading_rad) for each in progress.tape], 1),
        turn=Series.of([(each.at_s, each.turn_radps) for each in progress.tape], 1),
        is_raw=False,
        manoeuvres=tuple(Manoeuvre(each.name, each.from_s, each.to_s) for each in progress.played),
        source="trial",
    )
