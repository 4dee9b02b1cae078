"""How a drawn boat sails with gains, and her twin beside her: whole programs in lock step, in her own wind and current."""

import math
from typing import Final

import msgspec
import numpy as np

from delfim import config
from delfim.adoption.model import Array
from delfim.adoption.suited import place_of
from delfim.adoption.trial.boats import SETTLE_S, SimulatedTrial
from delfim.adoption.trial.concluding import told_position_m
from delfim.adoption.trial.hiddenhull import Hidden, LateModel
from delfim.adoption.twin import gains
from delfim.adoption.twin.twintrack import apart
from delfim.adoption.twin.twinvoyage import FACTOR, NEAR_DEG, TwinVoyage, mission_text, sailed, twin_of
from delfim.base.modes import Mode
from delfim.simulator.lockstep import Lockstep, uncollected
from delfim.simulator.measured import measured
from delfim.simulator.tables import Simulation
from delfim.vehicle import console
from delfim.vehicle.state import NoLog

RADIUS_M: Final = 60.0  # of the circle
LONG_S, STEP_S, ROUNDS = 30.0, 0.1, 8
MISSION_M: Final = (8.0, 0.0), (98.0, 0.0), (98.0, 60.0), (8.0, 60.0), (8.0, 10.0)  # north and east of her
MISSION_LONG_M: Final = 300.0


def voyage(settings: config.Vehicle, true: Hidden, seed: int, cruise_mps: float) -> TwinVoyage:
    """The true boat with this file sails turns, lines and a hold."""
    return sailed(SimulatedTrial(twin_of(settings, true.sea), true, seed, RADIUS_M).run, cruise_mps)


def twin_off_m(adopted: config.Vehicle, true: Hidden, seed: int) -> tuple[float, float]:
    """How far the twin's track of a mission is off hers, with quiet receivers, in the same sea, m: rms, most."""
    alone = twin_of(adopted, true.sea)
    begun = {"noise": False, "heading_deg": math.degrees(true.heading_rad) % 360.0}
    quiet = msgspec.structs.replace(alone, simulation=msgspec.structs.replace(alone.of(Simulation), **begun))
    twin = Lockstep(quiet, seed, lambda clock: NoLog())
    for _ in twin.cycles(SETTLE_S):
        pass
    runs, cruise_mps = (SimulatedTrial(quiet, true, seed, RADIUS_M).run, twin), adopted.control.speed.cruise_mps
    mission = mission_text(twin.nodes.model.origin, MISSION_M, cruise_mps)
    tracks = [_track(run, mission, FACTOR * MISSION_LONG_M / cruise_mps) for run in runs]
    if not all(map(len, tracks)):
        return math.inf, math.inf
    off_m = np.concatenate([apart(*tracks), apart(*tracks[::-1])])
    return float(np.sqrt(np.mean(off_m**2))), float(off_m.max())


@uncollected()
def _track(run: Lockstep, mission: str, limit_s: float) -> Array:
    """Where the boat truly is while she sails a mission, m: empty where she does not sail it to its end."""
    places, model = list[tuple[float, float]](), run.nodes.model
    if run.command(console.LoadMission(mission)) is None and run.command(console.Play()) is None:
        for state in run.cycles(limit_s):
            if state.mode is not Mode.PLAY:
                return np.array(places)
            places.append((model.north_m, model.east_m))
    return np.empty((0, 2))


def least_s(settings: config.Vehicle, true: Hidden, seed: int) -> float:
    """The time from an order until she stays within NEAR_DEG of a heading 90 degrees to starboard, from rest in calm water, by
    full power one way and then the other, which go NEAR_DEG beyond it: no control is quicker."""

    def turned(for_s: float) -> tuple[float, float]:
        """How far she turns, rad, with full power for so long, and the time until she is near the heading, s."""
        calm = LateModel(settings, true._replace(sea=type(true.sea)()), seed)
        begun, seconds, near_s, way = calm.heading_rad, 0.0, LONG_S, 1.0
        while seconds < LONG_S and calm.yaw_rate_radps >= 0.0:
            way = 1.0 if seconds < for_s else -1.0
            for row in settings.thrusters:
                calm.push(row.name, math.copysign(way, place_of(row).turn_m))
            calm.advance(STEP_S)
            seconds += STEP_S
            gone_rad = math.remainder(calm.heading_rad - begun - math.pi, math.tau) + math.pi
            if gone_rad >= 0.5 * math.pi - math.radians(NEAR_DEG):
                near_s = min(near_s, seconds)
            if gone_rad > 0.5 * math.pi + math.radians(NEAR_DEG):
                return gone_rad, near_s
        return calm.heading_rad - begun, near_s

    low_s, high_s = 0.0, LONG_S
    for _ in range(ROUNDS):
        middle_s = 0.5 * (low_s + high_s)
        is_far = turned(middle_s)[0] > 0.5 * math.pi + math.radians(NEAR_DEG)
        low_s, high_s = (low_s, middle_s) if is_far else (middle_s, high_s)
    return true.delay_s + turned(high_s)[1]


def of_truth(was: config.Vehicle, adopted: config.Vehicle, true: Hidden) -> config.Vehicle:
    """The file as the same choice of gains makes it of the true hull."""
    its, replace = true.hull, msgspec.structs.replace
    hull = measured(its)
    rows = tuple(
        replace(
            row, thrust_n=motor.thrust_n, curve=(), dead=motor.dead, power=motor.power, delay_s=true.delay_s, lag_s=its.motor_s
        )
        for row, motor in zip(adopted.thrusters, true.rows, strict=True)
    )
    boat = replace(
        adopted.boat,
        mass_kg=hull.mass_kg / 1.05,
        drag_n_per_mps=its.surge_n_per_mps,
        drag_n_per_mps2=its.surge_n_per_mps2,
        inertia_kgm2=hull.inertia_kgm2,
        yaw_nm_per_radps=its.yaw_nm_per_radps + hull.yaw_ahead_nm_s_per_m * adopted.control.speed.cruise_mps,
        yaw_nm_per_radps2=its.yaw_nm_per_radps2,
    )
    file = replace(adopted, boat=boat, thrusters=rows, control=was.control, simulation=replace(was.of(Simulation), hull=hull))
    best = gains.chosen(was, file, told_position_m(adopted)).best
    return gains.with_keys(file, best.keys)
