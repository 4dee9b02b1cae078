"""A recorded run of a boat with motors of other makes, once more: what it told them is the same, or told where not."""

import re
from pathlib import Path

import pytest

from delfim.base.errors import DelfimError
from delfim.logging.ashore.table import frames, table
from delfim.simulator.faults import fault
from delfim.simulator.replay.rerun import rerun
from delfim.vehicle import console
from tests.logging.sailing import Day, logged, sailed
from tests.simulator.test_rerun import copied

SKIFF = ", ".join(
    f'{{name="{name}", driver="DRIVER", address={n}, x_m=-1.0, y_m={0.5 - n}, thrust_n=[-200.0, 300.0], rpm_max=1800.0}}'
    for n, name in enumerate(("starboard", "port"))
)
OUTBOARD = '{name="outboard", driver="DRIVER", address=3, x_m=-1.5, thrust_n=[-200.0, 400.0], steer=' + (
    '{kind="azimuth", address=4, angle_max_deg=40.0}}'
)
ARMED = '{name="bow", driver="DRIVER", address=7, x_m=1.5, angle_deg=90.0, thrust_n=[-50.0, 50.0]}'
BOATS = {
    "dronecan": (f"thrusters=[{SKIFF}]".replace("DRIVER", "dronecan"),),
    "dronecan-rpm": (f"thrusters=[{SKIFF}]".replace("DRIVER", "dronecan"), 'dronecan.command="rpm"'),
    "dronecan-many": (f"thrusters=[{SKIFF}, {ARMED}, {OUTBOARD}]".replace("DRIVER", "dronecan"),),  # commands of several frames
    "vesc": (f"thrusters=[{SKIFF}]".replace("DRIVER", "vesc"),),
    "vesc-duty": (f"thrusters=[{SKIFF}]".replace("DRIVER", "vesc"), 'vesc.command="duty"'),
    "pwm": (f"thrusters=[{OUTBOARD}]".replace("DRIVER", "pwm"),),
    "otter": (f"thrusters=[{SKIFF}]".replace("DRIVER", "otter"),),
    "torqlink": (
        f"thrusters=[{SKIFF}]".replace("DRIVER", "torqlink"),
        *(f'torqlink.ports.{name}.interface="can{at}"' for at, name in ((1, "starboard"), (2, "port"))),
    ),
    "mavlink": (f"thrusters=[{SKIFF}]".replace("DRIVER", "mavlink_front_seat"),),
}
COMMANDED = {"dronecan": r" 0804060A#", "vesc": r" 000003[0-9A-F]{2}#"}
GPS = 'sysstat.required=["gps"]'


@pytest.fixture(scope="module")
def days(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A day of each kind of boat."""
    found = dict[str, Path]()
    for name, values in BOATS.items():
        found[name] = tmp_path_factory.mktemp(name)
        sailed(found[name], GPS, *values).end()
    return found


def box(day: Path, place: Path) -> Path:
    """The black box of the motors' bus, to be tampered with."""
    return copied(day, place) / "can1/000000.log"


def tampered(file: Path, driver: str, change: str, after: float = 0.5) -> int:
    """Changes a command, after this part of the log; its time."""
    lines = file.read_text().splitlines(keepends=True)
    sent = [i for i, line in enumerate(lines) if re.search(COMMANDED[driver], line)]
    at = sent[round(after * len(sent))]
    lines[at] = re.sub("#..", change, lines[at])
    file.write_text("".join(lines))
    return round(float(lines[at][1:].partition(")")[0]) * 1e9)


@pytest.mark.parametrize("boat", BOATS)
def test_what_the_motors_were_told_is_the_same(days: dict[str, Path], boat: str) -> None:
    result = rerun(logged(days[boat]), None)
    assert result.exact, result.text()
    assert result.cycles >= 320
    if boat.startswith(("dronecan", "vesc")):
        assert result.frames > 1.5 * result.cycles, "each cycle's command and its repetitions"
        assert result.commands == 0
        assert "propulsion frames compared: all the same, bit by bit" in result.text()
    else:
        assert result.commands == 2 * result.cycles, "two thrusters, or one and its angle"
        assert f"{result.commands} commands in the state log compared: all the same, bit by bit" in result.text()


@pytest.mark.parametrize("driver", COMMANDED)
def test_one_changed_frame_is_found_with_its_cycle(days: dict[str, Path], driver: str, tmp_path: Path) -> None:
    at_ns = tampered(box(days[driver], tmp_path), driver, "#7A")
    (difference,) = rerun(logged(tmp_path), None).differences
    assert difference.t_ns == pytest.approx(at_ns, abs=2e6)
    cycle = [i for i, t1 in enumerate(table([each for each in logged(tmp_path) if each.id == "state"])[0]["t1"]) if t1 <= at_ns]
    assert difference.cycle == len(cycle)
    assert difference.told.startswith(f"{driver} ")
    assert "7a" in difference.recorded
    assert difference.recorded != difference.repeated
    text = rerun(logged(tmp_path), None).text()
    assert (
        f"cycle {difference.cycle}  {difference.told}: recorded {difference.recorded}  repeated {difference.repeated}" in text
    )


@pytest.mark.parametrize("driver", COMMANDED)
def test_a_command_that_never_was_on_the_bus_is_found(days: dict[str, Path], driver: str, tmp_path: Path) -> None:
    file = box(days[driver], tmp_path)
    lines = file.read_text().splitlines(keepends=True)
    motor = [i for i, line in enumerate(lines) if re.search(COMMANDED[driver].replace("[0-9A-F]{2}", "01"), line)]
    words = [lines[i].split("#")[1][:8] for i in motor]
    start = next(n for n in range(len(motor) // 3, len(motor)) if words[n] != words[n - 1])
    gone = {motor[n] for n in range(start, len(motor)) if words[n] == words[start] and set(words[start:n]) <= {words[start]}}
    file.write_text("".join(line for i, line in enumerate(lines) if i not in gone))
    (difference,) = rerun(logged(tmp_path), None).differences
    assert difference.recorded == "nothing"
    assert words[start].lower() in difference.repeated


@pytest.mark.parametrize("boat", ["dronecan-many", "vesc", "pwm", "otter"])
def test_other_gains_give_other_commands(days: dict[str, Path], boat: str, tmp_path: Path) -> None:
    sidecar = copied(days[boat], tmp_path) / "state/000000.meta.jsonl"
    sidecar.write_text(sidecar.read_text().replace('"p_nm_per_rad": null', '"p_nm_per_rad": 634.0'))
    result = rerun(logged(tmp_path), None)
    assert len(result.differences) > 10
    assert result.differences[0].cycle < result.cycles
    assert re.search(r"cycle \d+  .*: recorded [0-9a-f+.-]+  repeated [0-9a-f+.-]+", result.text())


def test_one_changed_value_of_the_state_log_is_found(days: dict[str, Path], tmp_path: Path) -> None:
    """Where what was sent is on no bus."""
    state = copied(days["otter"], tmp_path) / "state/000000.state"
    its = [each for each in logged(tmp_path) if each.id == "state"]
    columns, _ = table(its)
    data, value = bytearray(state.read_bytes()), columns["port_command"]
    at = next(i for i in range(len(value) // 2, len(value)) if abs(value[i]) > 0.05)
    before = value[at].tobytes() + columns["port_rpm"][at].tobytes()
    place = data.find(before, len(data) * at // len(value) - 400)
    data[place + 1] ^= 0x10
    state.write_bytes(data)
    (difference,) = rerun(logged(tmp_path), None).differences
    assert (difference.cycle, difference.told) == (at + 1, "port command")


@pytest.mark.parametrize("driver", COMMANDED)
def test_after_a_power_cut_what_both_logs_have_is_the_same(days: dict[str, Path], driver: str, tmp_path: Path) -> None:
    file = box(days[driver], tmp_path)
    content = file.read_bytes()
    file.write_bytes(content[: round(0.8 * len(content))])
    sidecar = tmp_path.glob("*/state/000000.meta.jsonl")
    for each in sidecar:
        each.write_text("".join(line for line in each.read_text().splitlines(keepends=True) if '"event": "end"' not in line))
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()
    assert 0.7 < result.frames / rerun(logged(days[driver]), None).frames < 0.85


def test_a_motor_that_fails_and_drops_out_is_repeated(tmp_path: Path) -> None:
    """Its reports are inputs, from the same bus."""
    day = sailed(tmp_path, GPS, *BOATS["vesc"])
    assert day.command(console.Heading(90.0, 1.0)) is None
    day.sail(5.0)
    day.sailing.breaks(fault("thruster_dead", "port"))
    day.sail(10.0)
    assert "port propeller turns " in day.sailing.state.reason
    day.end()
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()


def test_the_stop_at_the_end_of_a_boat_under_way_is_repeated(tmp_path: Path) -> None:
    day = Day(tmp_path, GPS, *BOATS["dronecan"])
    day.sail(5.0)
    assert day.command(console.Heading(90.0, 1.0)) is None
    day.sail(10.0)
    day.end()
    result = rerun(logged(tmp_path), None)
    assert result.exact, result.text()
    (box,) = [each for each in logged(tmp_path) if each.id == "can1"]
    told = [frame.data for _, frame in frames([box]) if frame.identifier == 0x0804060A]
    assert (any(told[-2][:4]), any(told[-1][:4])) == (True, False), "the stop is in the black box"


def test_the_black_box_of_the_motors_must_be_there(days: dict[str, Path], tmp_path: Path) -> None:
    box(days["vesc"], tmp_path).unlink()
    with pytest.raises(DelfimError, match="no black box of can1 beside"):
        rerun(logged(tmp_path), None)
