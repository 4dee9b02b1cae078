"""`python -m tests.survey.pictures FOLDER`: the picture of a chart for the documents, of a survey over a bed from a seed."""

import sys
from pathlib import Path

from delfim.survey.chart.making import made
from delfim.survey.chart.report import depths
from tests.survey.sounded import sounded, ways


def draw(folder: Path) -> Path:
    day = sounded(11, ways(200.0, 10.0))
    file = folder / "chart.png"
    depths(made("Otter", [(day.soundings, day.corrections())])).savefig(file, dpi=90)
    return file


if __name__ == "__main__":
    print(draw(Path(sys.argv[1])))
