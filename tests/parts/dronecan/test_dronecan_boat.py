"""Motor controllers of others, played by pydronecan, obey the whole boat on a loopback bus; in tests/guest on the kernel's."""

import os

import pytest

from tests.esc_voyage import voyage


@pytest.mark.long
def test_motor_controllers_of_others_are_commanded_and_heard_and_stopped_by_the_dead_man(tmp_path):
    voyage(tmp_path, f"canloop:esc-{os.getpid()}-{tmp_path.name[-8:]}")
