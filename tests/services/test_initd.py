"""etc/init.d/delfim, for boards that keep their init, with a program in the place of Delfim's. The real one is started,
ended and killed by it in tests/guest/test_guest_initd.py, in a kernel of its own.
"""

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAM = """#!/bin/sh
echo "$@" >>"$0.told"
case $1 in
    check) exit $(cat "$0.check") ;;
    supervise) exec tail -f "$0" supervise ;;
esac
"""
Ask = Callable[[str], tuple[int, str]]


@pytest.fixture
def ask(tmp_path: Path) -> Iterator[Ask]:
    """What the script answers to a word: its exit code, and what it says."""
    program, default, script = tmp_path / "delfim", tmp_path / "default", tmp_path / "init.d"
    program.write_text(PROGRAM)
    (tmp_path / "delfim.check").write_text("0")
    program.chmod(0o755)
    default.write_text(f"VEHICLE={tmp_path}/boat.toml DELFIM={program} RUN={tmp_path}/run GROUP={os.getgid()}\n")
    text = (ROOT / "etc/init.d/delfim").read_text()
    script.write_text(text.replace("/etc/default/delfim", str(default)).replace("sleep 1\n", "sleep 0.02\n"))

    def asked(word: str) -> tuple[int, str]:
        done = subprocess.run(["sh", script, word], capture_output=True, text=True, timeout=60, check=False)
        return done.returncode, done.stdout.strip()

    yield asked
    if (tmp_path / "run/init.pid").exists():
        os.kill(number(tmp_path), signal.SIGKILL)


def up(ask: Ask) -> None:
    """Wait until the program runs that was started: before, its process is still the script's."""
    while ask("status")[0] != 0:
        pass


def number(folder: Path) -> int:
    return int((folder / "run/init.pid").read_text())


def test_it_is_started_once_restarted_and_ended(ask: Ask, tmp_path: Path) -> None:
    assert ask("status") == (3, "delfim does not run")
    assert ask("start") == (0, "delfim started")
    up(ask)
    before = number(tmp_path)
    assert ask("start") == (0, "delfim runs already")
    assert ask("status") == (0, "delfim runs")
    told = (tmp_path / "delfim.told").read_text().splitlines()
    assert told == [f"{word} {tmp_path}/boat.toml" for word in ("check", "supervise")]
    assert (tmp_path / "run").stat().st_mode & 0o7777 == 0o2755, "the sockets in it are the group's, too"
    assert ask("restart") == (0, "delfim stopped\ndelfim started")
    up(ask)
    assert number(tmp_path) != before
    assert ask("stop") == (0, "delfim stopped")
    assert ask("stop") == (0, "delfim does not run")
    assert ask("status") == (3, "delfim does not run")


def test_one_that_died_is_told_with_where_its_last_words_are(ask: Ask, tmp_path: Path) -> None:
    ask("start")
    up(ask)
    os.kill(number(tmp_path), signal.SIGKILL)
    while (told := ask("status")) == (0, "delfim runs"):  # until its parent has seen it
        pass
    assert told == (1, f"delfim died; its last words are in {tmp_path}/run/output")
    (tmp_path / "run/init.pid").unlink()


def test_a_file_that_is_wrong_starts_nothing_and_no_other_word_is_known(ask: Ask, tmp_path: Path) -> None:
    (tmp_path / "delfim.check").write_text("2")
    assert ask("start")[0] == 6
    assert not (tmp_path / "run").exists()
    code, told = ask("nonsense")
    assert (code, told.startswith("usage: ")) == (2, True)
