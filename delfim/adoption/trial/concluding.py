"""The end of a trial: the rows of the motors are corrected, the hull is fitted, and both are written into the file if asked."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from delfim import config
from delfim.adoption import identify, magnet
from delfim.adoption.found import Key
from delfim.adoption.trial.motors import corrected
from delfim.adoption.trial.session import TrialProgress
from delfim.adoption.trial.taped import record_of
from delfim.adoption.writing import changed, replaced
from delfim.base.errors import DelfimError
from delfim.base.input.untrusted import parse_toml, read_text
from delfim.base.tables import inline

Ask = Callable[[str], bool]
Tell = Callable[[str], object]


def corrections(progress: TrialProgress) -> Iterator[tuple[Key, Any]]:
    """The keys of the file that change, once the motors are proven."""
    if progress.motors is None or not progress.is_proven:
        return
    for row, keys in zip(progress.thrusters, corrected(progress.motors, progress.thrusters), strict=True):
        for key, value in keys.items():
            yield ("thrusters", row.name, key), value
    yield ("adopted", "proven"), True


def motors_told(progress: TrialProgress, tell: Tell) -> None:
    """Tell the keys of the file that change."""
    for key, value in corrections(progress):
        tell(f"{'.'.join(key)} = {inline(value)}")


def conclude(progress: TrialProgress, file: Path, report: Path, on: str, ask: Ask | None, tell: Tell) -> str:
    """Correct the rows, fit the hull, write what is agreed to; `ask` None: nothing is written. Returns why the fit was refused,
    in words; empty: it was not. `on`: the day."""
    text = changed(read_text(file), {key: (value, f"found {on}") for key, value in corrections(progress)}, str(file))
    vehicle = config.read(parse_toml(text), str(file))
    motors_told(progress, tell)
    is_written = ask is not None and ask(f"Write this into {file}?")
    if is_written:
        replaced(file, text)
        tell(f"{file} is written. The boat's program has the old one until it is started again.")
    try:
        record = record_of(progress, is_estimated=vehicle.navigation.estimator)
        for line in magnet.told(record):
            tell(line)
        result = identify.identified(record, vehicle, on)
    except DelfimError as error:
        return str(error)
    for line in identify.told(result):
        tell(line)
    identify.report(result, vehicle, report, f"delfim adopt {file}")
    tell(f"{report}: the report, with measured and modelled motion")
    if not result.fit.refusal and is_written and ask is not None and ask(f"Write these, too, into {file}?"):
        identify.write(result, file)
    return result.fit.refusal
