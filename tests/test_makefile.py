"""What the targets of the Makefile would do, asked of make itself."""

import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]


def planned(*words: str) -> str:
    """As no child of the make that runs the tests."""
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    return subprocess.run(["make", "-n", *words], cwd=ROOT, env=alone, capture_output=True, text=True, check=True).stdout


def test_a_first_run_says_that_it_installs_once_and_installs_nothing_for_tests():
    steps = planned("run", "BOAT=.venv/.nobody-made-this", "ARGS=")
    assert "once; this takes about a minute" in steps
    assert "-r requirements/ground.txt" in steps
    assert "requirements/test.txt" not in steps
    assert steps.rstrip().endswith("delfim sim etc/delfimx.toml --console")


def test_what_tests_need_comes_with_the_first_target_that_needs_it():
    assert "-r requirements/test.txt" in planned("check", "READY=.venv/.nobody-made-this")


def test_the_wheel_of_a_checkout_needs_neither_a_tag_nor_what_was_built_before():
    steps = planned("wheel")
    assert steps.index("rm -rf build") < steps.index("-m pip wheel")
    assert "release.py" not in steps
