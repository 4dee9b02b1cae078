"""The missions of the boats that sail a survey together: its lines at first, and after their logs what is left of them."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import shapely

from delfim import config
from delfim.base.errors import DelfimError
from delfim.survey import planning, progress
from delfim.survey.areafile import Shape
from delfim.survey.chart.reduction import good_places
from delfim.survey.ground import Place, in_plane, laid
from delfim.survey.picture import draw
from delfim.survey.planning import LinesWanted, SurveyPlan
from delfim.survey.progress import Announced, KeptSurvey, SurveyWishes
from delfim.survey.sharing import BoatShare, shared
from delfim.vehicle.plans.estimate import in_hours
from delfim.vehicle.plans.mission import PayloadItem, save_mission


class SurveyBoat(NamedTuple):
    """A boat by the name of its file."""

    name: str
    settings: config.Vehicle

    def wanted(self, wishes: SurveyWishes) -> LinesWanted:
        """What is asked of it. Raises DelfimError."""
        return planning.wanted_of(self.settings, **msgspec.structs.asdict(wishes))


def boats_of(files: Sequence[str], overrides: Sequence[str]) -> list[SurveyBoat]:
    """The boats of vehicles' files. Raises ConfigError, DelfimError."""
    boats = [SurveyBoat(Path(file).stem, config.load(file, overrides)) for file in files]
    if len({boat.name for boat in boats}) < len(boats):
        raise DelfimError(f"{', '.join(files)}: each boat has a file of its own name, after which its mission is named")
    return boats


def begun(areas: list[Shape], wishes: SurveyWishes, boats: Sequence[SurveyBoat]) -> tuple[SurveyPlan, list[SurveyPlan | None]]:
    """The survey as the first boat would sail it alone, and the plan of each; None: it has no line. Raises DelfimError."""
    wanted = [boat.wanted(wishes) for boat in boats]
    plan = planning.planned(laid(areas), wanted[0], boats[0].settings.fence)
    if len(boats) == 1:
        return plan, [plan]
    main, across = plan.lines[: len(plan.lines) - plan.across], plan.lines[len(plan.lines) - plan.across :]
    shares = [BoatShare(its, boat.settings.fence) for its, boat in zip(wanted, boats, strict=True)]
    return plan, shared(plan.ground, plan.heading_deg, main, across, shares)


def go_on(survey: KeptSurvey, logs: Sequence[str]) -> Place | None:
    """Note in a survey what logs say is done, and return where the last one ends. Raises DelfimError, OSError."""
    ground = laid(survey.areas)
    lines, last, every = survey.segments(ground), None, list[Place]()
    for log in logs:
        places = [in_plane(ground.at, *place) for place in good_places(log)]
        every += places
        last = places[-1] if places else last
        found = progress.sailed(lines, places, survey.asked.spacing_m, bool(survey.asked.side))
        survey.done = [progress.merged(*both) for both in zip(survey.done, found, strict=True)]
    if every and not survey.asked.side:
        sounded, spacing_m = shapely.STRtree(shapely.points(every)), survey.asked.spacing_m
        for number in range(len(lines) - survey.across):  # a line across is there to cross the others, not to cover
            its = survey.done[number]
            survey.done[number] = progress.with_covered(lines[number], its, sounded, ground.area, spacing_m)
    return last


def rest(survey: KeptSurvey, boats: Sequence[SurveyBoat], starts: Sequence[Place | None]) -> list[SurveyPlan | None]:
    """The plan of each boat for what is left, from where it is; none at all: the survey is done. Raises DelfimError."""
    ground, wanted = laid(survey.areas), [boat.wanted(survey.asked) for boat in boats]
    lines, joined_m = survey.segments(ground), max(its.cut.joined_m for its in wanted)
    least_m = progress.least_m(survey.asked.spacing_m)
    left = [progress.left(line, done, least_m, joined_m) for line, done in zip(lines, survey.done, strict=True)]
    first_across = len(lines) - survey.across
    main, across = ([piece for its in part for piece in its] for part in (left[:first_across], left[first_across:]))
    if not main and not across:
        return []
    each = zip(wanted, boats, starts, strict=True)
    shares = [BoatShare(its, boat.settings.fence, start) for its, boat, start in each]
    return shared(ground, survey.heading_deg, main, across, shares)


class LineAnnounced(NamedTuple):
    """What is announced to payloads where each line begins and ends."""

    begin: list[Announced]
    end: list[Announced]

    def actions(self) -> planning.LineActions:
        return planning.LineActions(*(tuple(map(_item, its)) for its in self))


def _item(told: Announced) -> PayloadItem:
    return PayloadItem(command=int(told[0]), params=told[1:])


def _foretold(boat: SurveyBoat, plan: SurveyPlan) -> str:
    """The time and the energy of a plan, as the simulated boat takes them for a few lines."""
    from delfim.survey.trialsail import foretold  # the simulator, which nobody waits for who asks only for what is left

    time_s, energy_wh = foretold(boat.settings, plan)
    energy = "" if energy_wh is None else f" and {energy_wh:,.0f} Wh"
    return f"{in_hours(time_s)}{energy} at {plan.wanted.speed_mps:g} m/s"


def written(
    plans: Sequence[SurveyPlan | None], boats: Sequence[SurveyBoat], name: str, file: Path, announced: LineAnnounced
) -> Iterator[str]:
    """Write the mission of each boat, and say what it is. Raises DelfimError, OSError."""
    for its, plan in zip(boats, plans, strict=True):
        boat, settings = its
        if plan is None:
            yield f"{boat}: no line is left for it"
            continue
        ours = file.with_stem(f"{file.stem}-{boat}") if len(boats) > 1 else file
        mission = planning.mission(plan, name if len(boats) == 1 else f"{name} {boat}", announced.actions())
        planning.check(mission, plan, settings)
        save_mission(mission, ours)
        across = f", {plan.across} of them across" if plan.across else ""
        lines = f"{len(plan.lines)} lines {plan.wanted.spacing_m:g} m apart" if len(plan.lines) > 1 else "a line"
        yield f"{ours}: {lines} at {plan.heading_deg:.0f}°{across}"
        yield f"  {plan.line_m:,.0f} m of lines, {plan.way_m:,.0f} m in all, {_foretold(its, plan)}"


def drawn(plans: Sequence[SurveyPlan | None], boats: Sequence[SurveyBoat], name: str, picture: str | None) -> Iterator[str]:
    """Draw the plan of each boat, if a picture is asked for, and say where. Raises OSError."""
    for (boat, _), plan in zip(boats, plans, strict=True):
        if plan is not None and picture:
            file = Path(picture).with_stem(f"{Path(picture).stem}-{boat}") if len(boats) > 1 else Path(picture)
            draw(plan, f"{name}: {len(plan.lines)} lines, {in_hours(plan.time_s)}", file)
            yield str(file)
