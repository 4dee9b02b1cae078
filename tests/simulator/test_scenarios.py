"""The scenarios of etc/scenarios, each with its expectations; what a scenario may say; and campaigns of mixed faults."""

import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from delfim import config
from delfim.audit import auditor
from delfim.base.errors import ConfigError
from delfim.simulator.faults import KINDS
from delfim.simulator.invariants.onlooker import Onlooker
from delfim.simulator.lockstep import Lockstep
from delfim.simulator.scenarios import random_faults, scenario, trial
from delfim.simulator.scenarios.chased import chased
from delfim.vehicle.failsafe.troubles import NUMBERS, Trigger
from delfim.vehicle.state import NoLog

ROOT = Path(__file__).parents[2]
VEHICLE = ROOT / "etc/delfimx.toml"
SCENARIOS = sorted((ROOT / "etc/scenarios").glob("*.toml"))
LONG = {  # they sail for 400 s and more, or what is in them is sailed by the tests of the guard, of energy, of payloads
    *("things-drawn", "radar", "gyro-drift", "traffic-gives-way", "swimmers", "things", "headland", "calm-mission"),
    *("ais-late", "ais-frozen", "ais-wrong", "ais-receiver-silent", "energy", "payload", "battery-low", "console-lost"),
}
SETTINGS = config.Vehicle(boat=config.BoatTable(name="test"))
SAILING = """version = 1
name = "test"
seconds = 20

[[command]]
at_s = 3
command = "heading"
heading_deg = 90
speed_mps = 1.0
"""


def run(tmp_path: Path, text: str, seed: int = 1) -> trial.Result:
    file = tmp_path / "test.toml"
    file.write_text(text)
    return trial.run_file(file, VEHICLE, seed)


@cache
def sailed(file: Path, seed: int) -> trial.Result:
    """A run of a shipped scenario, and what the second auditor finds in its log. It is the same each time."""
    with TemporaryDirectory() as folder:
        result = trial.run_file(file, VEHICLE, seed, logged_in(folder), logged=True)
        return result._replace(failures=[*result.failures, *auditor.complaints(folder)])


def logged_in(folder: str) -> tuple[str, str]:
    return f'log.directory="{folder}"', 'log.state_method="write"'


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "file", [pytest.param(each, id=each.stem, marks=pytest.mark.long if each.stem in LONG else ()) for each in SCENARIOS]
)
def test_the_scenario_ends_as_it_must(file, seed):
    result = sailed(file, seed)
    assert not result.failures, f"delfim sim {VEHICLE} --scenario {file} --seed {seed}"


@pytest.mark.long
def test_there_are_scenarios_for_every_trouble_of_the_table():
    told = {event.name for file in SCENARIOS for event in sailed(file, 1).events if event.kind == "notice"}
    assert told == NUMBERS.keys() - {"control"}


def test_there_are_scenarios_for_every_fault():
    assert {each.kind for file in SCENARIOS for each in scenario.load_scenario(file).fault} == set(KINDS)


def test_a_boat_whose_hand_set_is_mandatory_sails_a_scenario_without_one(tmp_path):
    handset = '[vehicle.handset]\ndevice = "/dev/receiver"\nmandatory = true\n'
    result = run(tmp_path, f'{SAILING}\n{handset}\n[[expect]]\nmode = "heading"\nat_end = true\n')
    assert result.failures == []


def test_a_scenario_with_a_hand_set_needs_a_boat_that_has_one(tmp_path):
    with pytest.raises(ConfigError, match="name its device"):
        run(tmp_path, f"{SAILING}\n[[handset]]\nat_s = 0\n")


@pytest.mark.parametrize(
    ("expect", "failure"),
    [
        ('mode = "heading"', None),
        ('mode = "heading"\nreason = "operator"\nafter = "heading"\nwithin_s = 0.2\nat_end = true', None),
        ('mode = "hold"', "mode hold: not after 0.0"),
        ('mode = "heading"\nreason = "guest"', "mode heading (guest): not after 0.0"),
        ('mode = "heading"\nwithin_s = 1', "mode heading: 3.0 s after 0.0, not 1 s"),
        ('mode = "heading"\nnever = true', "mode heading at 3.0 s, never expected after 0.0"),
        ('mode = "idle"\nafter = 10\nnever = true', None),
        ('mode = "idle"\nat_end = true', "mode idle: at 20 s it is heading (operator)"),
        ('mode = "heading"\nafter = "bus_off"', "mode heading: bus_off never happened"),
        ('propellers = "stopped"\nafter = 10\nwithin_s = 1', "propellers stopped: not after 10.0"),
        ('notice = "fence"', "notice fence: not after 0.0"),
        ('notice = "fence"\nnever = true', None),
        ("waypoints = 2", "0 of 2 waypoints reached"),
    ],
)
def test_an_expectation_can_be_met_and_can_be_missed(tmp_path, expect, failure):
    result = run(tmp_path, f"{SAILING}\n[[expect]]\n{expect}\n")
    assert result.failures == ([] if failure is None else [failure])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("version = 2", "version"),
        (SAILING.replace("seconds = 20", ""), "seconds: missing"),
        (SAILING + "[[fault]]\nat_s = 1\nkind = 'sunk'", "fault[0]: no fault 'sunk'"),
        (SAILING + "[[fault]]\nat_s = 1\nkind = 'thruster_dead'", "fault[0]: thruster_dead needs one of"),
        (SAILING + "[[command]]\nat_s = 1\ncommand = 'swim'", "command[1]: command not understood"),
        (SAILING + "[[command]]\ncommand = 'play'", "command[1]: a command needs at_s"),
        (SAILING + "[[expect]]\nreason = 'x'", "name one of mode, notice, propellers, waypoints"),
        (SAILING + "[[expect]]\nmode = 'idle'\nnotice = 'log'", "name one of mode, notice, propellers, waypoints"),
        (SAILING + "[vehicle.dsor]\nrpm_max = -1", "dsor.rpm_max"),
        ("mission = 'none.toml'\n" + SAILING, "none.toml"),
        ("vehicle = 2026-11-22\n" + SAILING, "vehicle: 2026-11-22 is a date, not a table (allowed: a table)"),
        ("mission = 2026-11-22\n" + SAILING, "mission: 2026-11-22 is a date, not text"),
        (
            SAILING + "[[command]]\nat_s = 1\ncommand = 'heading'\nheading_deg = 2026-11-22",
            "command[1]: command not understood",
        ),
        (
            SAILING + f"[[command]]\nat_s = 1\ncommand = 'heading'\nheading_deg = 1{400 * '0'}",
            "command[1]: command not understood",
        ),
        (SAILING + f"[[fault]]\nat_s = 1\nkind = 'frames_late'\nvalue = 1{400 * '0'}", "fault[0]"),
        (SAILING + f"[[fault]]\nat_s = 1{400 * '0'}\nkind = 'bus_off'", "fault[0].at_s"),
    ],
)
def test_a_scenario_that_cannot_be_meant_is_refused(tmp_path, text, reason):
    with pytest.raises(ConfigError) as refused:
        run(tmp_path, text)
    assert reason in str(refused.value)


def test_orders_are_repeated_until_obeyed_and_then_given_up(tmp_path):
    early = run(tmp_path, SAILING.replace("at_s = 3", "at_s = 0"))
    assert not early.failures
    assert next(event for event in early.events if event.kind == "command").t_s > 0.5, "refused at first: nothing had reported"
    never = run(
        tmp_path, SAILING.replace('"heading"', '"mode"\nmode = "grex"').replace("heading_deg = 90\nspeed_mps = 1.0", "")
    )
    assert never.failures == ["mode at 3 s: grex refused: no set point from the guest computer"]
    obeyed = run(tmp_path, SAILING + 'refused = "no"')
    assert obeyed.failures == ["heading at 3 s: obeyed, not refused with 'no'"]


def test_a_run_is_repeated_by_its_seed_and_a_file_by_its_command():
    file = ROOT / "etc/scenarios/bad-wire.toml"
    assert trial.run_file(file, VEHICLE, 3) == trial.run_file(file, VEHICLE, 3)
    assert random_faults.sail_mixed(VEHICLE, 7) == random_faults.sail_mixed(VEHICLE, 7)
    assert random_faults.again("a b.toml", "mixed", 7, ["log.required=false"]) == (
        "delfim sim 'a b.toml' --scenario mixed --seed 7 --set log.required=false"
    )


@pytest.mark.parametrize(("seconds", "code"), [(3.0, 0), (1.0, 1)])
def test_the_command_tells_by_its_exit_code_and_how_to_repeat(tmp_path, seconds, code):
    file = tmp_path / "test.toml"
    file.write_text(f'{SAILING}\n[[expect]]\nmode = "heading"\nwithin_s = {seconds}\n')
    words = [sys.executable, "-m", "delfim", "sim", str(VEHICLE), "--scenario", str(file), "--seed", "4"]
    ran = subprocess.run(words, capture_output=True, text=True, timeout=200, check=False)
    assert ran.returncode == code
    assert "mode       heading  operator" in ran.stdout
    assert (f"again: delfim sim {VEHICLE} --scenario {file} --seed 4" in ran.stderr) is bool(code)


@pytest.mark.long
def test_mixed_faults_end_in_nothing_that_must_never_happen(seeds):
    """No exception, not adrift under power, inside the fence, no stop without a reason; nothing that the second auditor finds:
    `pytest --seeds 1000` for more."""
    bad = dict[int, list[str]]()
    for seed in seeds:
        with TemporaryDirectory() as folder:
            failures = random_faults.sail_mixed(VEHICLE, seed, logged_in(folder), logged=True).failures
            if found := failures + auditor.complaints(folder):
                bad[seed] = found
    assert not bad, "\n".join(f"{random_faults.again(str(VEHICLE), 'mixed', seed, [])}: {why}" for seed, why in bad.items())


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 5, 4452))])
def test_vessels_that_follow_and_chase_the_boat_drive_it_nowhere(seed):
    """Some of etc/campaigns/chased.toml: outside the fence in none, though led away from its place beyond a zone (4452)."""
    assert not random_faults.sail_mixed(VEHICLE, seed, (), chased).failures


@pytest.mark.parametrize(
    "seed",
    [
        3374,  # a stopped boat drifts to 0.3 m from the fence before it is told to sail
        5262,  # the straight way from where the fence stopped it to where it holds led through the zone
        5272,  # a stopped boat drifts over the fence, and is further out when it has turned
        9147,  # the same, after navigation was silent
        11155,  # between a zone and the fence there is no room to hold: it drifted over the fence within its radius
        16528,  # the same
        72894,  # navigation is frozen while it holds at rest: it learns only at the fence that it drifted there
        9931,  # a propeller is stuck while its node is silent, and is disconnected when the boat hears of it
    ],
)
def test_seeds_that_failed_once(seed):
    assert not random_faults.sail_mixed(VEHICLE, seed).failures


def test_resets_one_after_the_other_do_not_keep_a_motor_that_turns_on_from_being_cut_off(tmp_path):
    """Each silenced its node for a moment, and the boat waited anew (a run that searched, shrunken to this)."""
    orders = [(8.8, 'goto"\nlatitude_deg = 38.6903008\nlongitude_deg = -9.21565\nend = "hold'), (9.384, "stop")]
    orders += [(at_s, "reset") for at_s in (9.584, 9.984, 13.584, 13.984, 16.784, 17.184)]
    text = "".join(f'[[command]]\nat_s = {at_s}\ncommand = "{words}"\n' for at_s, words in orders)
    fault = '[[fault]]\nat_s = 9.511\nkind = "thruster_stuck"\nwhere = "starboard"\n'
    assert not run(tmp_path, f'version = 1\nname = "test"\nseconds = 23\npatient = false\n{text}{fault}', 2169).failures


BY_BUS = '[vehicle]\nnavigation.sources = ["nmea2000"]\nfailsafe.thruster = {after_s = 3.0, action = "warn"}\n'
BY_LINE = '[vehicle]\nnavigation.sources = ["nmea0183"]\nnmea0183.ports.gnss = {device = "/dev/gnss", baud = 115200}\n'
CARRIED = """[vehicle]
failsafe = {clear_s = 1.0, fence_left.after_s = 0.5, fence.action = "warn"}
simulation.sea = {current_mps = 1.958, current_to_deg = 220.04, wind_mps = 1.16, wind_from_deg = 86.08}
fence.keep_in = [{centre = [[38.6907, -9.2153013]], radius_m = 23.14}]
handset = {device = "/dev/receiver", kill.channel = 6}
[[handset]]
at_s = 18.227
kill = true
"""
PUSHED = '[[command]]\nat_s = 17.5\ncommand = "manual"\nstarboard = -0.716\nport = -0.617\n'


def to(at_s: float, course_deg: float, speed_mps: float) -> str:
    return f'[[command]]\nat_s = {at_s}\ncommand = "course"\ncourse_deg = {course_deg}\nspeed_mps = {speed_mps}\n'


@pytest.mark.parametrize(
    ("seed", "text", "faults"),
    [
        # Cut off too early: the thrusters were off for want of a heading before the boat stopped.
        (
            *(1417, BY_BUS + to(13.6, 117, 1.9)),
            *[((15.06, "navigation_silent", "compass", ""), (14.03, "thruster_reversed", "starboard", ""))],
        ),
        # Blamed wrongly: late frames from before the restart came after it; a kill by hand-set before the look and a mode that
        # was resumed and ended within it.
        (
            *(11633, to(19.578, 204.1, 1.508)),
            *[((20.696, "restarted", "", "for_s = 1.0"), (15.973, "frames_late", "", "value = 0.6635\nfor_s = 6.623"))],
        ),
        (13532, CARRIED + PUSHED, ()),
        (
            *(15376, BY_LINE + to(26.192, 126.6, 2.0)),
            (
                (27.404, "restarted", "", "for_s = 1.0"),
                (28.148, "bus_off", "", "for_s = 3.13"),
                (21.525, "navigation_jumping", "", "value = 26.6017\nfor_s = 9.926"),
            ),
        ),
    ],
    ids=["off without a heading", "late frames", "kill by hand", "resumed and ended"],
)
def test_what_runs_that_searched_were_shrunken_to(tmp_path, seed, text, faults):
    rows = [f'[[fault]]\nat_s = {at_s}\nkind = "{kind}"\nwhere = "{where}"\n{more}\n' for at_s, kind, where, more in faults]
    head = 'version = 1\nname = "test"\nseconds = 35\npatient = false\n'
    assert not run(tmp_path, head + text + "".join(rows), seed).failures


@pytest.mark.parametrize(
    ("boat", "seed"),
    [
        ("wam-v", 13),  # a propeller by pulses is stuck: this boat hears nothing of it, and has no contactor
        ("otter", 4),  # it has no batteries that report
        ("wam-v", 32),  # nor propellers
    ],
)
def test_what_a_boat_does_not_have_does_not_break_and_is_not_blamed_on_it(boat, seed):
    assert not random_faults.sail_mixed(VEHICLE.parent / f"boats/{boat}.toml", seed).failures


@pytest.mark.parametrize(
    ("trigger", "failure", "first"),
    [
        (Trigger.FENCE, "outside the fence in mode", 36),
        (Trigger.NAVIGATION_SILENT, "sailing blind in mode", 10),
        (Trigger.THRUSTER, "adrift under power", 13),
    ],
    ids=lambda each: getattr(each, "name", ""),
)
def test_without_a_row_of_the_table_the_campaign_finds_it(monkeypatch, trigger, failure, first):
    """The watch is not blind: a vehicle that has lost one of its failsafes fails. `first`: the seed that finds it today."""
    module = sys.modules["delfim.vehicle.failsafe.failsafe"]
    whole = module.troubles
    monkeypatch.setattr(module, "troubles", lambda *given: [each for each in whole(*given) if each[0] is not trigger])
    found: list[str] = []
    for seed in range(first, first + 100):
        found += random_faults.sail_mixed(VEHICLE, seed).failures
        if any(failure in words for words in found):
            return
    pytest.fail(f"not found in 100 runs: {failure}; only {found}")


def test_the_watch_sees_propellers_commanded_in_idle():
    sailing = Lockstep(SETTINGS, 1, lambda clock: NoLog())
    watch = Onlooker(sailing)
    list(sailing.cycles(1.0))
    watch.look()
    assert watch.failures == []
    sailing.state.actuation = sailing.state.actuation._replace(thrust=(0.0, 0.1), run=True)
    sailing.state.reason = ""
    watch.look()
    assert [words.partition(" at ")[0] for words in watch.failures] == [
        "commanded Actuation(thrust=(0.0, 0.1), angle_rad=(0.0, 0.0), run=True)",
        "stopped without a reason",
        "thrust from 0.000 to 0.100 in 0.0 s",
    ]
