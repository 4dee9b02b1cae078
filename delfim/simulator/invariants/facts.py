"""What the boat reports of its motion, batteries and times is plausible; what it reports to its operator and its log is what it
knows, and, where nothing deceives its sensors, the truth."""

import math
from collections.abc import Iterable, Iterator
from typing import Final

from delfim.base.geodesy import wrap
from delfim.base.modes import Mode
from delfim.base.parts import OWN_NODES
from delfim.simulator.faults import OF_THRUSTERS
from delfim.simulator.invariants.cycle import CycleSeen
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.model import WATER, Hull
from delfim.simulator.propulsor import VOLTAGE_V
from delfim.simulator.tables import Simulation
from delfim.vehicle import snapshot
from delfim.vehicle.control.hull import full_mps
from delfim.vehicle.failsafe.troubles import NUMBERS
from delfim.vehicle.log import record
from delfim.vehicle.report import LocalReport
from delfim.vehicle.state import Notice, State

HONEST: Final = frozenset((*OF_THRUSTERS, "console_lost", "guest_lost", "disk_full", "disk_slow", "shallow", "gnss_poor"))
SETTLES_S: Final = 5.0  # after a fault of sensors or bus: late frames come, and sources change
SIGMAS: Final = 7.0  # of an error with a normal distribution: once in 1e11
ROUNDING_M: Final = 0.1  # of a plane that touches the ellipsoid, and of degrees with seven digits
SWIFTER: Final = 1.3  # than at full thrust: a boat that turns, or that wind and gusts push
LEEWAY: Final = 0.1  # of the wind's speed, at most, that it pushes a boat without thrust through the water
TIMES: Final = 5  # cycles between two looks at times
CYCLES: Final = 60  # between two looks at report, record and batteries
DRAIN: Final = 2.0  # times the current at full revolutions: a propeller that the water turns against
STEP: Final = 0.011  # of a charge that is told in whole percent
NOT_A_MODE: Final = "a way round is looked for"  # ends a note that begins with goto
MODES: Final = {mode.name.lower(): mode for mode in Mode}
SIDES: Final = "batteries_starboard", "batteries_port"  # by the address of their thruster


def _settled_s(run: Lockstep) -> float:
    """The time from which a boat that nobody observed before knows only what sound sensors have measured."""
    return run.elapsed_s + SETTLES_S if run.elapsed_s else 0.0


class Plausible:
    """Time goes on, cycles are counted one by one, and a boat goes no farther than it can."""

    def __init__(self, run: Lockstep) -> None:
        settings = run.settings
        sea, there = settings.of(Simulation).sea, settings.of(Simulation)
        noise_m, noise_mps = (there.position_noise_m, there.speed_noise_mps) if there.noise else (0.0, 0.0)
        self._most_mps = SWIFTER * full_mps(settings.boat) + sea.current_mps + LEEWAY * sea.wind_mps * (1.0 + 4.0 * sea.gusts)
        self._most_mps += SIGMAS * noise_mps
        self._noise_m = SIGMAS * noise_m + ROUNDING_M
        self._sources = len(settings.navigation.sources)
        self._times: tuple[float, ...] = ()
        self._doubt_s, self._place, self._source = _settled_s(run), (math.nan, math.nan), ""

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        state, was, run = cycle.state, cycle.was, cycle.run
        motion = state.motion
        place, self._place = self._place, (motion.north_m, motion.east_m)
        if state.source != self._source or run.faults.on:
            self._doubt_s, self._source = was.now_s + SETTLES_S, state.source
        rose = state.cycles - was.cycles
        if not state.cycles % TIMES:
            yield from self._of_times(cycle)
        if not rose:
            if state.navigation_s != was.navigation_s:
                yield "a navigation message was used, and no cycle is counted"
            return
        is_doubtful = was.now_s < self._doubt_s
        if rose != 1 and (rose < 0 or (rose > self._sources and not is_doubtful)):
            yield f"{rose} cycles at once"
        speed_mps = math.hypot(motion.north_mps, motion.east_mps)
        if speed_mps > self._most_mps:
            yield f"{speed_mps:.2f} m/s over ground, and no more than {self._most_mps:.2f} can be"
        if is_doubtful or "position" not in motion.has:
            return
        passed_s, way_m = state.navigation_s - was.navigation_s, math.dist(self._place, place)
        if way_m > self._most_mps * passed_s + self._noise_m:
            yield f"{way_m:.2f} m in {passed_s:.2f} s"

    def _of_times(self, cycle: CycleSeen) -> Iterator[str]:
        state, was, now_s = cycle.state, cycle.was, cycle.run.elapsed_s
        times = state.navigation_s, state.changed_s, state.watchdog_s, state.console_s, state.manual_s, state.guest_s
        before, self._times = self._times, times
        if now_s <= was.now_s or max(times) > was.now_s:
            yield f"a cycle from {was.now_s:.3f} to {now_s:.3f} s, and something was heard at {max(times):.3f} s"
        if before and not all(map(float.__le__, before, times)):
            yield f"the times of what was heard went back from {before} to {times}"
        if list(state.profile[1:]) != sorted(state.profile[1:]):
            yield f"the stamps of the cycle go back: {state.profile}"


class Batteries:
    """Charge is never gained, goes no faster than a motor can draw it, and is reported as it is."""

    def __init__(self, run: Lockstep) -> None:
        hull: Hull = run.nodes.model.hull
        turns = hull.rpm_max / 60.0
        watt = math.tau * turns * WATER * turns**2 * hull.propeller_diameter_m**5 * hull.torque
        most_a = DRAIN * watt / (hull.motor_efficiency * VOLTAGE_V) + hull.idle_a
        self._per_s = most_a / (3600.0 * hull.capacity_ah)
        rows = run.settings.driven("nodes")
        self._drives = [(SIDES[row.address], run.nodes.model.drives[row.name]) for _, row in rows]
        self._charges = [drive.charge for _, drive in self._drives]
        self._looked_s, self._sags = 0.0, False

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        now_s, on = cycle.run.elapsed_s, cycle.run.faults.on
        self._sags = self._sags or "battery_sag" in on
        if cycle.state.cycles % CYCLES:
            return
        sags, self._sags = self._sags, "battery_sag" in on
        passed_s, self._looked_s = now_s - self._looked_s, now_s
        for i, (name, drive) in enumerate(self._drives):
            before, self._charges[i] = self._charges[i], drive.charge
            if drive.charge > before:
                yield f"{name} rose from {before} to {drive.charge}"
            elif drive.charge < before - self._per_s * passed_s and not sags:
                yield f"{name} fell from {before} to {drive.charge} in {passed_s:.1f} s"
            told, at_s = cycle.state.sysstat.get(name, (None, 0.0))
            charge = getattr(told, "charge", None)
            if charge is None or not on.keys() <= HONEST or sags:
                continue
            if not -STEP <= charge - drive.charge <= self._per_s * (now_s - at_s + 1.0) + STEP:
                yield f"{name} is told to be at {charge}, and is at {drive.charge}"


class Struck:
    """A boat that goes somewhere by itself touches nothing that stands in the water, and no swimmer while its propellers turn:
    one may swim into a boat that drifts."""

    def __init__(self, run: Lockstep) -> None:
        self._things = run.nodes.things

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        yield from (f"struck {each.name}" for each in self._things if each.nearest_m <= 0.0)


class NotedChanges:
    """Each change of mode, and each trouble that comes or goes, is noted when it happens, with its reason; nothing else is."""

    def __init__(self, run: Lockstep) -> None:
        state = run.state
        self._noted = run.noted
        self._noted.clear()  # what was told before it looks
        self._mode, self._reason, self._notices, self._mode_s = state.mode, state.reason, state.notices, state.mode_s

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        state = cycle.state
        is_same = state.mode is self._mode and state.reason == self._reason
        if is_same and not self._noted and state.notices is self._notices:
            return
        noted = tuple(self._noted)
        self._noted.clear()
        yield from self._of_mode(state, noted)
        yield from _of_troubles(self._notices, state.notices, noted)
        self._mode, self._reason, self._notices, self._mode_s = state.mode, state.reason, state.notices, state.mode_s

    def _of_mode(self, state: State, noted: tuple[str, ...]) -> Iterator[str]:
        mode, reason = self._mode, self._reason
        for text in noted:
            name, _, rest = text.partition(": ")
            if name in MODES and not text.endswith(NOT_A_MODE):
                mode, reason = MODES[name], rest
            elif text == state.reason:
                reason = text
        if mode is not state.mode or reason != state.reason:
            yield f"told is {mode.name.lower()} ({reason}), and the boat is in {state.mode.name.lower()}"
        if not state.reason:
            yield f"{state.mode.name.lower()} without a reason"
        if state.mode is not self._mode and state.mode_s == self._mode_s:
            yield f"{state.mode.name.lower()} has begun, and is told to be there since {state.mode_s:.1f} s"


def _of_troubles(before: Iterable[Notice], after: Iterable[Notice], noted: tuple[str, ...]) -> Iterator[str]:
    """The notes of a cycle about troubles agree with how the notices changed."""
    known, present = {(each.name, each.action) for each in before}, {each.name for each in after}
    news = {f"{each.name}: {each.reason}: {each.action}" for each in after if (each.name, each.action) not in known}
    gone = {f"{name}: over" for name, _ in known if name not in present}
    for text in (news | gone).difference(noted):
        yield f"not told: {text}"
    for text in noted:
        if text.endswith(": over") and text.partition(": ")[0] in NUMBERS and text not in gone:
            yield f"told, and not so: {text}"
    if any(not each.reason for each in after):
        yield "a trouble without a reason"


class Reported:
    """The report that pages and `/api/state` show, and the record of the log, agree with what the boat knows; and this is the
    truth where nothing deceives it."""

    def __init__(self, run: Lockstep) -> None:
        there = run.settings.of(Simulation)
        noise = (there.position_noise_m, there.heading_noise_deg, there.speed_noise_mps) if there.noise else (0.0, 0.0, 0.0)
        self._position_m = SIGMAS * math.sqrt(2.0) * noise[0] + ROUNDING_M
        self._heading_rad = SIGMAS * math.radians(noise[1]) + math.radians(0.02)
        self._speed_mps = SIGMAS * math.sqrt(2.0) * noise[2] + 0.01
        self._is_plain = run.settings.navigation.sources == (OWN_NODES,)  # others filter, and come later
        self._record, self._rows = record.of(run.settings), run.settings.thrusters
        self._doubt_s, self._mode = _settled_s(run), run.state.mode

    def look(self, cycle: CycleSeen) -> Iterator[str]:
        state, run = cycle.state, cycle.run
        on, now_s = run.faults.on, run.elapsed_s
        if on and not on.keys() <= HONEST:
            self._doubt_s = now_s + SETTLES_S
        if state.mode is self._mode and state.cycles % CYCLES:
            return
        self._mode = state.mode
        report = snapshot.report(state, now_s, self._rows)
        yield from self._of_boat(report, state, now_s)
        yield from self._of_record(state, now_s)
        if self._is_plain and now_s > self._doubt_s and state.navigation_s == cycle.was.now_s and state.navigation is not None:
            yield from self._of_truth(report, run)

    def _of_boat(self, report: LocalReport, state: State, now_s: float) -> Iterator[str]:
        plan, sent = state.setpoint.plan, state.actuation
        should = {
            "mode": state.mode.name.lower(),
            "reason": state.reason,
            "armed": state.armed,
            "operator": state.operator,
            "cycle": state.cycles,
            "run": sent.run,
            "mission": plan.name if plan else None,
            "legs": len(plan.waypoints) if plan else 0,
        }
        for name, value in should.items():
            if (told := getattr(report, name)) != value:
                yield f"reported is {name} {told}, and it is {value}"
        notices = [(each.name, each.reason, each.action) for each in report.notices]
        if notices != [(each.name, each.reason, each.action) for each in state.notices]:
            yield f"reported are {notices}, and there are {state.notices}"
        for name, at_s in (("navigation", state.navigation_s), ("console", state.console_s), ("guest", state.guest_s)):
            age_s = report.age_s[name]
            if (age_s is None) is (at_s > -1e8) or (age_s is not None and abs(age_s - now_s + at_s) > 1e-3):
                yield f"reported is {name} {age_s} s ago, and it was at {at_s:.3f} s"
        for row, part in zip(self._rows, sent.thrust, strict=False):
            if abs((told := report.thrusters[row.name].thrust) - part) > 1e-4:
                yield f"reported is {row.name} {told}, and it is {part:.4f}"

    def _of_record(self, state: State, now_s: float) -> Iterator[str]:
        values = dict(zip([each.name for each in self._record.fields], record.values(self._record, state, now_s), strict=True))
        should: dict[str, object] = {
            "monotonic_s": now_s,
            "cycle": state.cycles,
            "mode": state.mode.value,
            "run": state.actuation.run,
            "console_s": state.console_s,
            "guest_s": state.guest_s,
            "watchdog_s": state.watchdog_s,
            "leg": state.reference.leg,
            "line": state.reference.line,
        }
        if "position" in state.motion.has:
            should |= {"north": state.motion.north_m, "east": state.motion.east_m}
        if state.navigation is not None and state.navigation.heading_rad is not None:
            should |= {"heading": state.navigation.heading_rad, "utc_ns": state.navigation.utc_ns}
        should |= {f"{row.name}_command": part for row, part in zip(self._rows, state.actuation.thrust, strict=False)}
        for name, value in should.items():
            if values[name] != value:
                yield f"logged is {name} {values[name]}, and it is {value}"
        troubles = values["troubles"]
        named = {name for name, bit in NUMBERS.items() if isinstance(troubles, int) and troubles >> bit & 1}
        if named != {each.name for each in state.notices}:
            yield f"logged are the troubles {named}, and there are {state.notices}"

    def _of_truth(self, report: LocalReport, run: Lockstep) -> Iterator[str]:
        model, motion, at = run.nodes.model, run.state.motion, run.nodes.model.origin
        latitude_deg, longitude_deg = report.latitude_deg, report.longitude_deg
        if latitude_deg is not None and longitude_deg is not None:
            north_m = (math.radians(latitude_deg) - at.latitude_rad) * at.north_m_per_rad
            east_m = (math.radians(longitude_deg) - at.longitude_rad) * at.east_m_per_rad
            if (off_m := math.dist((north_m, east_m), (model.north_m, model.east_m))) > self._position_m:
                yield f"the reported position is {off_m:.2f} m from the truth"
        if report.heading_deg is not None:
            off_rad = wrap(math.radians(report.heading_deg) - model.heading_rad)
            if abs(off_rad) > self._heading_rad or abs(wrap(motion.heading_rad - model.heading_rad)) > self._heading_rad:
                yield f"the reported heading is {math.degrees(off_rad):.1f} degrees from the truth"
        if report.speed_mps is not None:
            true_mps = math.hypot(model.north_mps, model.east_mps)
            if abs(report.speed_mps - true_mps) > self._speed_mps:
                yield f"reported are {report.speed_mps:.2f} m/s, and the boat makes {true_mps:.2f}"
