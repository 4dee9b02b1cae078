"""A mission of a log, and the twin in it: it sails the same waypoints from the same place, in the current that was found."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np

from delfim import config
from delfim.adoption.fitting import Fit
from delfim.adoption.model import Array
from delfim.adoption.twin.twinvoyage import SETTLE_S, twin_of
from delfim.base.geodesy import from_plane, origin, to_plane
from delfim.base.modes import Mode
from delfim.logging.ashore.table import table
from delfim.logging.ashore.tree import LogFile
from delfim.simulator.lockstep import Lockstep, uncollected
from delfim.simulator.tables import Sea, Simulation
from delfim.vehicle import console
from delfim.vehicle.plans.mission import Mission
from delfim.vehicle.state import NoLog

SHORTEST_S: Final = 20.0  # of a mission that is worth looking at
APART_S: Final = 2.0  # between two records of one mission
POINTS: Final = 2000  # of a track
LONGER: Final = 2.0  # times what the boat took, that the twin may take


class TwinTrack(NamedTuple):
    """Two tracks of a mission: (n, 2), m north and east of where it began."""

    name: str
    measured: Array
    twin: Array
    rms_m: float  # of the twin off the track of the boat
    most_m: float
    measured_s: float
    twin_s: float


def twin_track(files: Sequence[LogFile], mission: Mission, fit: Fit, vehicle: config.Vehicle) -> TwinTrack | None:
    """The last mission of state logs, sailed by the twin of `vehicle`; None: no mission was sailed, or not for long."""
    columns, _ = table([file for file in files if file.suffix.startswith(".state")])
    at_s, plays = np.asarray(columns["monotonic_s"], float), np.asarray(columns["mode"]) == Mode.PLAY
    known = plays & np.isfinite(np.asarray(columns["latitude"], float)) & np.isfinite(np.asarray(columns["heading"], float))
    rows = np.flatnonzero(known)
    if not len(rows):
        return None
    last = rows[np.flatnonzero(np.abs(np.diff(at_s[rows], prepend=-math.inf)) > APART_S)[-1] :]
    measured_s = float(at_s[last[-1]] - at_s[last[0]])
    if measured_s < SHORTEST_S:
        return None
    latitude, longitude, heading = (np.asarray(columns[name], float)[last] for name in ("latitude", "longitude", "heading"))
    zero = origin(float(latitude[0]), float(longitude[0]))
    measured = np.array([to_plane(zero, north, east) for north, east in zip(latitude, longitude, strict=True)])
    leg = int(np.asarray(columns["leg"])[last[0]])
    current = fit.values["current_north"], fit.values["current_east"]
    began = from_plane(zero, -SETTLE_S * current[0], -SETTLE_S * current[1])
    start = {"latitude_deg": math.degrees(began[0]), "longitude_deg": math.degrees(began[1])}
    start["heading_deg"] = math.degrees(float(heading[0])) % 360.0
    sea = Sea(
        current_mps=min(math.hypot(*current), 3.0), current_to_deg=math.degrees(math.atan2(current[1], current[0])) % 360.0
    )
    twin = twin_of(vehicle, sea)
    twin = msgspec.structs.replace(twin, simulation=msgspec.structs.replace(twin.of(Simulation), **start))
    run = Lockstep(twin, 1, lambda clock: NoLog())
    places, twin_s = _played(run, mission, min(leg, len(mission.waypoint) - 1), LONGER * measured_s + SHORTEST_S)
    if not len(places):
        return None
    north, east = to_plane(zero, run.nodes.model.origin.latitude_rad, run.nodes.model.origin.longitude_rad)
    places = places + np.array([north, east])
    off = apart(places, measured)
    return TwinTrack(mission.name, measured, places, float(np.sqrt(np.mean(off**2))), float(off.max()), measured_s, twin_s)


@uncollected()
def _played(run: Lockstep, mission: Mission, leg: int, limit_s: float) -> tuple[Array, float]:
    """Where the twin was, m from its start, and how long it took, s."""
    places = list[tuple[float, float]]()
    for _ in run.cycles(SETTLE_S):
        pass
    if run.command(console.Upload(mission)) is None and run.command(console.Play(leg)) is None:
        began_s = run.elapsed_s
        for state in run.cycles(limit_s):
            if state.mode is not Mode.PLAY:
                break
            places.append((run.nodes.model.north_m, run.nodes.model.east_m))
        return np.array(places), run.elapsed_s - began_s
    return np.empty((0, 2)), 0.0


def apart(these: Array, those: Array) -> Array:
    """The distance of each of these points from the nearest of those, m."""
    some, other = (each[:: len(each) // POINTS + 1] for each in (these, those))
    return np.asarray(np.sqrt(((some[:, None] - other[None]) ** 2).sum(-1)).min(1))
