"""The command line itself: the list of commands, mistakes, and what a command loads."""

import subprocess
import sys
from pathlib import Path

import pytest

from delfim import commands
from delfim.__main__ import main, parsed
from tests.logging.sailing import sailed

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("words", [[], ["--help"], ["-h"]])
def test_without_a_command_all_of_them_are_listed_by_what_people_do(words, capsys):
    assert main(words) == 0
    out = capsys.readouterr().out
    for group, its in commands.GROUPS.items():
        assert f"\n{group}:\n" in out
        assert all(f"\n  {name:10} {sentence}\n" in out for name, sentence in its.items())


def test_every_command_is_a_file_and_every_file_a_command():
    folder = Path(commands.__file__).parent
    files = {str(path.relative_to(folder).with_suffix("")) for path in folder.glob("*/[!_]*.py")}
    files -= {"description/newform"}  # the page's way to `delfim new`
    groups = zip(commands.FOLDERS, commands.GROUPS.values(), strict=True)
    assert files == {f"{its}/{name}" for its, group in groups for name in group}


@pytest.mark.parametrize("name", commands.SENTENCES)
def test_help_is_in_whole_sentences_and_shows_defaults(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")  # no path is broken at its hyphen, whatever the terminal
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    out = " ".join(capsys.readouterr().out.split())
    assert commands.SENTENCES[name] in out
    assert commands.SENTENCES[name].endswith(".")
    if name == "sim":
        assert "Seed of noise and gusts. (default: 1)" in out


def test_a_command_that_does_not_exist_is_one_line_with_a_proposal(capsys):
    assert main(["chekc"]) == 2
    assert capsys.readouterr().err == "delfim: there is no command 'chekc'; did you mean check?; delfim alone lists all\n"


@pytest.mark.parametrize(
    "words", [["charts", "US5OH10M.000", "--at", "-33.85,151.2"], ["survey", "rest", "a.survey.json", "--at", "-33.85,151.2"]]
)
def test_a_place_of_the_southern_half_is_no_option(words):
    _, asked = parsed(words)
    assert asked.at in ((-33.85, 151.2), [(-33.85, 151.2)])


@pytest.mark.parametrize("words", [["charts", "a.000", "--at", "1,1"], ["survey", "lines", "a.geojson"]])
def test_a_picture_of_a_kind_that_is_not_drawn_is_refused_before_anything_is_written(words, capsys):
    with pytest.raises(SystemExit):
        parsed([*words, "--picture", "a.bmp"])
    assert capsys.readouterr().err.endswith("argument --picture: a.bmp ends neither with .png nor with .svg\n")


@pytest.mark.parametrize(
    ("missing", "words", "extra"),
    [
        ("aiohttp", ["console", "--no-browser"], "ground"),
        ("numpy", ["log", "info"], "ground"),
        ("matplotlib", ["log", "plot"], "ground"),
        ("pyarrow", ["log", "export", "parquet"], "formats"),
        ("asammdf", ["log", "export", "mf4"], "formats"),
    ],
)
def test_a_package_that_is_not_installed_is_named_with_what_installs_it(missing, words, extra, tmp_path):
    sailed(tmp_path / "log").end()
    words = [*words, str(tmp_path / "log")] if words[0] == "log" else words
    without = f"import sys; sys.modules[{missing!r}] = None; from delfim.__main__ import main; sys.exit(main({words!r}))"
    ended = subprocess.run([sys.executable, "-c", without], capture_output=True, text=True, cwd=tmp_path)
    told = f"delfim: {words[0]} needs {missing}, which is not installed: pip install 'delfim[{extra}]'\n"
    assert (ended.returncode, ended.stderr) == (2, told)


def test_a_boat_loads_its_own_command_alone():
    look = "import sys; from delfim.__main__ import parsed; parsed(['run', 'boat.toml']); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    ours = {name for name in loaded if name.startswith("delfim.")}
    assert ours == {
        *("delfim.__main__", "delfim.base", "delfim.base.errors"),
        *("delfim.commands", "delfim.commands.aboard", "delfim.commands.aboard.run"),
    }


def test_a_question_that_nobody_answers_ends_in_a_line():
    """Away from any terminal."""
    command = [sys.executable, "-m", "delfim", "password"]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith("delfim: password: the answers ended too early")
