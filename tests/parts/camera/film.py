"""aiortc for tests: `make test-long` brings it into a folder of its own, which only these tests have on their path."""

import os
from importlib.util import find_spec
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[3] / ".venv/webrtc"


@pytest.fixture
def aiortc(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is at hand here, and in all programs that are started."""
    if find_spec("aiortc") is not None:
        return
    if not FOLDER.is_dir():
        pytest.skip("aiortc is not installed: make test-long brings it")
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(FOLDER), os.environ.get("PYTHONPATH", "")))))
