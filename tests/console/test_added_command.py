"""A command and a field of the log that were added as CONTRIBUTING.md says, on a real boat: the command from the page's menu
and by its key, by MAVLink and over the local socket; the field in the log, in an export and in a replay.
"""

import asyncio
import csv
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from delfim.vehicle.mavlink import wire
from tests.console.chain import PATIENCE_S, Sea, operating, ordered
from tests.console.scenes import choose
from tests.enlarged import Enlarged

NUMBER = 31010  # MAV_CMD_USER_1
ROWS = {
    "delfim/vehicle/console.py": {
        "    reboot: bool = False\n": '\n\nclass Bell(Command, frozen=True):\n    """The bell, once."""\n',
        "Take | Arm | Reset | Set | TellState | Watch | Return | ShutDown\n": "    | Bell\n",
    },
    "delfim/vehicle/helm.py": {
        "    console.ShutDown: Helm._halt,\n": '    console.Bell: lambda helm, command, now_s: helm.state.count("bells"),\n'
    },
    "delfim/vehicle/mavlink/commands.py": {
        "    dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reset,\n": f"    {NUMBER}: lambda o, boat: console.Bell(),\n"
    },
    "delfim/console/orders.py": {
        'title="Reset the peripherals", key="R"),\n': (
            f'    "bell": OrderRow(lambda n: CommandLong({NUMBER}, ()), title="Ring the bell", key="U"),\n'
        )
    },
    "delfim/vehicle/record.py": {
        "lambda s, now_s: s.watchdog_s),\n": (
            '    Field("bells", "I", "", "times that the bell was rung", lambda s, now_s: s.counts.get("bells", 0)),\n'
        )
    },
}
OTHER = 199  # another console
CONTROL = 32100
ASK = "from delfim.console.link import Link; import sys; Link(sys.argv[1]).ask('bell')"


class Sailed(NamedTuple):
    log: Path
    rung: list[int]  # how often, after each of the ways
    delfim: Callable[..., str]  # the extended program


@pytest.fixture(scope="module")
def sailed(tmp_path_factory: pytest.TempPathFactory) -> Sailed:
    """The bell was rung in all ways, under way, and the boats are in harbour again."""
    folder = tmp_path_factory.mktemp("added-command")
    program = Enlarged(folder / "program")
    for path, rows in ROWS.items():
        for beside, row in rows.items():
            program.row(path, beside, row, behind=True)
    env = program.env

    async def voyage() -> list[int]:
        async with operating(folder, env=env, gateway_env=env) as sea:
            rung = await _rung(sea, env)
            await sea.nothing_amiss()
            return rung

    return Sailed(folder / "1/log", asyncio.run(voyage()), program.told)


async def _rung(sea: Sea, env: dict[str, str]) -> list[int]:
    page, boat = await sea.at_rest(1)
    await page.press("h")
    rung = []

    async def heard() -> None:
        state = await boat.until(lambda state: state["mode"] == "heading" and state["counts"].get("bells", 0) > len(rung))
        rung.append(state["counts"]["bells"])
        await boat.sails_on(3)

    await page.press("Enter")
    await choose(page, "More", "Ring the bell")
    await heard()
    await page.press("u")
    await heard()
    console = wire.Sender(OTHER, 190, None, lambda: 0)
    sea.radios[0].say(console.pack(ordered(1, CONTROL, 0.0, 1.0)) + console.pack(ordered(1, NUMBER)))
    await heard()
    asked = [sys.executable, "-c", ASK, str(boat.place / "command")]
    await asyncio.to_thread(subprocess.run, asked, env=env, check=True, timeout=PATIENCE_S)
    await heard()
    return rung


def test_the_command_comes_from_page_and_key_by_mavlink_and_over_the_local_socket(sailed: Sailed) -> None:
    assert sailed.rung == [1, 2, 3, 4]


def test_the_field_is_in_the_log_in_its_export_and_in_a_replay(sailed: Sailed, tmp_path: Path) -> None:
    file = tmp_path / "state.csv"
    sailed.delfim("log", "export", "csv", "--output", str(file), str(sailed.log))
    with file.open() as lines:
        counted = [int(row["bells"]) for row in csv.DictReader(lines)]
    assert sorted(set(counted)) == [0, 1, 2, 3, 4]
    assert "all the same, bit by bit" in sailed.delfim("log", "replay", str(sailed.log))
