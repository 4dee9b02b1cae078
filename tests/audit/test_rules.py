"""Each rule of the auditor with a log that keeps it and a log that breaks it."""

from collections.abc import Callable

import numpy as np
import pytest

from delfim.audit.auditor import RULES, judge
from delfim.audit.evidence import Sent, Unjudged
from tests.audit.forging import BEGAN_NS, LEFT_S, Forged

FENCE = ("fence={keep_in=[{polygon=[[38.689,-9.211],[38.691,-9.211],[38.691,-9.209],[38.689,-9.209]]}]}",)  # 100 m about
SQUARE_M = 111.0  # from its middle to its northern edge
HAND = {"command": "manual", "starboard": 0.4, "port": 0.4}


def quiet(log: Forged) -> None:
    """Nothing is changed."""


def sets(name: str, t_s: float, value: float) -> Callable[[Forged], None]:
    """One record says something else."""

    def change(log: Forged) -> None:
        log.columns[name] = log.columns[name].astype(float)
        log.columns[name][log.at(t_s)] = value

    return change


def event_goes_back(log: Forged) -> None:
    log.event(120.0, "vessels", value=[])
    log.event(121.0, "vessels", value=[])
    log.events[-1]["monotonic_s"] = 119.0


def watchdog_rests(log: Forged) -> None:
    log.columns["watchdog_s"] = np.minimum(log.columns["watchdog_s"], 120.0)


def driven_in_idle(log: Forged) -> None:
    log.mode(120.0, "idle", "operator")
    log.order(120.0, {"command": "stop"})
    log.command(125.0, 0.05)


def stopped(log: Forged) -> None:
    log.mode(120.0, "idle", "operator")
    log.order(120.0, {"command": "stop"})


def turns_in_idle(log: Forged) -> None:
    stopped(log)
    log.columns["port_rpm_measured"] = np.where(log.since(120.0), 400.0, log.columns["port_rpm_measured"])


def turns_in_idle_and_is_told(log: Forged) -> None:
    turns_in_idle(log)
    log.trouble("thruster", 124.2, "port propeller turns 400 instead of 0 rpm", "disconnect")


def drifts_without_speed(log: Forged) -> None:
    log.columns["north"] = log.columns["north"] + np.where(log.since(120.0), 1.0 * (log.t_s - 120.0), 0.0)


def drifts_with_speed(log: Forged) -> None:
    drifts_without_speed(log)
    log.columns["north_speed"] = log.columns["north_speed"] + log.since(120.0)


def by_hand(log: Forged, stop_s: float = 125.0) -> None:
    log.mode(110.0, "manual", "operator")
    for t_s in np.arange(110.0, 124.0, 0.5):
        log.order(float(t_s), HAND)
    log.command(125.8, 0.0)
    log.event(125.8, "note", value="no thrust: no manual command for 2.0 s")
    if stop_s < 128.6:
        return
    log.trouble("manual_silent", 128.6, "no manual command for 5.1 s", "stop")
    log.mode(128.6, "idle", "no manual command for 5.1 s")


def by_hand_in_order(log: Forged) -> None:
    by_hand(log, 128.6)


def by_hand_too_long(log: Forged) -> None:
    by_hand(log)
    log.columns["starboard_command"] = np.where(log.since(125.8), 0.4, log.columns["starboard_command"])


def by_hand_harder(log: Forged) -> None:
    by_hand(log, 128.6)
    log.columns["port_command"] = np.where(log.since(116.0, 120.0), 0.5, log.columns["port_command"])


def steers_elsewhere(log: Forged) -> None:
    log.columns["reference_heading"] = np.where(log.since(115.0), 1.2, log.columns["reference_heading"])


def trouble(name: str, words: str, action: str, mode: str = "", over_s: float = 0.0) -> Callable[[Forged], None]:
    """At 120 s; the mode that follows, if one does."""

    def change(log: Forged) -> None:
        log.trouble(name, 120.0, words, action, over_s)
        if mode:
            log.mode(120.0, mode, words)

    return change


def silent(told: bool, stops: bool) -> Callable[[Forged], None]:
    """No navigation from 115 to 121 s."""

    def change(log: Forged) -> None:
        if told:
            log.trouble("navigation_silent", 116.1, "navigation silent for 1.1 s", "stop")
        if stops:
            log.mode(116.1, "idle", "navigation silent for 1.1 s")
        log.without(115.0, 121.0)

    return change


def pauses(home_s: float) -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        log.settings = {**log.settings, "failsafe": {**log.settings["failsafe"], "pause_s": 8.0}}
        log.columns["console_s"] = np.minimum(log.columns["console_s"], 109.8)
        log.trouble("console_silent", 120.0, "console silent for 10.2 s; home in 8 s", "hold")
        log.mode(120.0, "hold", "console silent for 10.2 s; home in 8 s")
        if home_s:
            log.trouble("console_silent", home_s, "console silent for 18.2 s", "home")
            log.mode(home_s, "home", "console silent for 18.2 s")

    return change


def repeats_itself(log: Forged) -> None:
    for name in ("latitude", "longitude", "north_speed", "east_speed", "heading", "yaw_rate"):
        log.columns[name] = np.where(log.since(115.0, 130.0), 0.5, log.columns[name])


def repeats_itself_and_stops(log: Forged) -> None:
    repeats_itself(log)
    log.trouble("navigation_frozen", 118.2, "navigation frozen for 3.2 s", "stop")
    log.mode(118.2, "idle", "navigation frozen for 3.2 s")


def console_gone(told_s: float) -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        log.columns["console_s"] = np.minimum(log.columns["console_s"], 110.0)
        if told_s:
            words = f"console silent for {told_s - 110.0:.1f} s; home in 30 s"
            log.trouble("console_silent", told_s, words, "hold")
            log.mode(told_s, "hold", words)

    return change


def guest_gone(told: bool) -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        log.order(105.0, {"command": "mode", "mode": "grex"})
        log.mode(105.0, "grex", "operator")
        log.columns["guest_s"] = np.minimum(log.t_s, 110.0)
        if told:
            log.trouble("guest_silent", 115.2, "guest silent for 5.2 s", "hold")
            log.mode(115.2, "hold", "guest silent for 5.2 s")

    return change


def program(
    *, given: bool = True, may: tuple[str, ...] = ("heading",), back_s: float = 130.0, told: bool = True, of: str = "uphill"
) -> Callable[[Forged], None]:
    """A payload program that has the boat from 105 s on turns it at 120 s, and is silent from 125 s on."""

    def change(log: Forged) -> None:
        log.settings = log.settings | {"payload": {"uphill": {"may": may}}}
        if given:
            log.order(105.0, {"command": "payload", "name": "uphill"})
            log.mode(105.0, "hold", "operator")
        log.order(min(back_s, 140.0), {"command": "take"})
        log.events.sort(key=lambda each: each["monotonic_s"])
        log.order(120.0, {"command": "heading", "heading_deg": 90}, operator=f"payload:{of}" if of else "local")
        log.mode(120.0, "heading", "payload uphill")
        log.events.sort(key=lambda each: each["monotonic_s"])
        log.columns["payload_uphill_s"] = np.minimum(log.t_s, 125.0)
        log.columns["helmsman"] = np.where(log.since(105.0, 130.2), 1, 0)
        if told:
            log.trouble("guest_silent", 130.2, "no word from payload uphill for 5.2 s", "hold")
            log.mode(130.2, "hold", "no word from payload uphill for 5.2 s")
        else:
            log.columns["helmsman"] = np.where(log.since(105.0), 1, 0)

    return change


def battery(charge: float, told: bool) -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        log.columns["port_charge"] = np.where(log.since(110.0), charge, log.columns["port_charge"])
        if told:
            words = f"batteries port at {charge:.0%}; home in 30 s"
            log.trouble("battery_low", 115.2, words, "hold")
            log.mode(115.2, "hold", words)

    return change


def satellites(told: bool) -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        log.columns["satellites"] = np.where(log.since(110.0), 4, 10)
        if told:
            log.trouble("gnss_poor", 115.2, "satellite navigation poor: 4 satellites", "warn")

    return change


def dead(told: bool) -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        log.columns["port_rpm_measured"] = np.where(log.since(110.0), 0.0, log.columns["port_rpm_measured"])
        if told:
            words = "port propeller turns 0 instead of 480 rpm: the boat cannot turn to both sides while it goes ahead"
            log.trouble("thruster", 114.2, words, "stop")
            log.mode(114.2, "idle", words)
        else:
            log.columns["port_rpm"] = np.where(log.since(110.0), 840.0, log.columns["port_rpm"])
            log.columns["port_command"] = log.columns["port_rpm"] / 1200.0

    return change


def unlogged(told: bool) -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        if told:
            log.trouble("log", 115.2, "log not written: no space left on device", "warn", 125.0)
        log.without(110.0, 124.0, cycles_lost=True)

    return change


def leaves_idle(reason: str, ordered: bool) -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        stopped(log)
        if ordered:
            log.order(125.0, {"command": "play"})
        log.mode(125.0, "play", reason)
        log.columns["run"] = log.columns["mode"] != 4

    return change


def refused(reason: str, mode: str = "") -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        log.order(125.0, {"command": "play"}, reason)
        if mode:
            log.mode(125.0, mode, "operator")

    return change


def ordered(value: dict[str, object], mode: str) -> Callable[[Forged], None]:
    def change(log: Forged) -> None:
        log.order(125.0, value)
        if mode:
            log.mode(125.0, mode, "operator")

    return change


def other_mode_in_records(log: Forged) -> None:
    log.columns["mode"] = np.where(log.since(130.0), 5, log.columns["mode"])


def sails_north(log: Forged, north_m: float = 0.0, speed_mps: float = 2.0) -> None:
    """Along the meridian, from there at LEFT_S."""
    way_m = north_m + speed_mps * np.maximum(log.t_s - LEFT_S, 0.0)
    log.columns["latitude"] = np.radians(38.69 + way_m / 111_000.0)
    log.columns["longitude"] = np.full(len(log.t_s), np.radians(-9.21))
    log.columns["north"], log.columns["north_speed"] = way_m, np.where(log.since(LEFT_S), speed_mps, 0.0)


def sails_over_the_fence(log: Forged) -> None:
    sails_north(log, 60.0)


def stops_at_the_fence(log: Forged) -> None:
    """Told where it could stop 3 m before it: 111 - 60 - 2 t = 3 + 2 + 6.7."""
    sails_north(log, 60.0)
    log.trouble("fence", LEFT_S + 20.0, "keep-in zone 11.6 m away at 2.0 m/s", "hold")
    log.mode(LEFT_S + 20.0, "hold", "keep-in zone 11.6 m away at 2.0 m/s")


def stops_for_no_fence(log: Forged) -> None:
    sails_north(log, 0.0, 1.0)
    log.trouble("fence", 120.0, "keep-in zone 10.0 m away at 1.0 m/s", "hold")
    log.mode(120.0, "hold", "keep-in zone 10.0 m away at 1.0 m/s")


def holds_outside(log: Forged) -> None:
    sails_north(log, 130.0, 0.1)
    log.order(LEFT_S, {"command": "mode", "mode": "hold"})
    log.mode(LEFT_S, "hold", "operator")


def comes_back(log: Forged) -> None:
    holds_outside(log)
    sails_north(log, 130.0, -0.3)


def starts_by_hand_outside(log: Forged) -> None:
    sails_north(log, 130.0, 0.0)
    log.order(LEFT_S, HAND)
    log.events = [each for each in log.events if each["event"] != "mode"]
    log.mode(LEFT_S, "manual", "operator")


def starts_outside(log: Forged) -> None:
    sails_north(log, 130.0, 0.0)


def boxed(log: Forged) -> None:
    log.frames()


def another_frame(identifier: int, rpm: int, t_s: float = 120.1) -> Callable[[Forged], None]:
    """Somebody else's frame, between two records."""

    def change(log: Forged) -> None:
        log.frames()
        t_ns = BEGAN_NS + round(t_s * 1e9)
        log.boxes["can0"].append(Sent(t_ns, identifier, rpm.to_bytes(2, "little", signed=True) + bytes([1, 0])))
        log.boxes["can0"].sort()

    return change


def turns_without_navigation(log: Forged) -> None:
    silent(told=True, stops=True)(log)
    another_frame(0x41, 480, 119.0)(log)


def silent_on_the_bus(log: Forged) -> None:
    silent(told=True, stops=True)(log)
    log.frames()


def says_other_revolutions(log: Forged) -> None:
    log.frames()
    log.columns["port_rpm_measured"] = np.where(log.since(120.0, 121.0), 300.0, log.columns["port_rpm_measured"])


Change = Callable[[Forged], None]
CASES: list[tuple[str, Change, Change, str]] = [
    ("time-forward", quiet, sets("monotonic_s", 120.0, 119.0), "time since boot goes"),
    ("time-forward", quiet, sets("cycle", 120.0, 90), "number of the cycle goes"),
    ("time-forward", quiet, event_goes_back, "at 119.00 s stands after one at 120.00 s"),
    ("words-age", quiet, sets("console_s", 120.0, 130.0), "console is 10.00 s ahead"),
    ("words-age", quiet, sets("guest_s", 120.0, 5.0), "guest goes back"),
    ("watchdog-looks", quiet, watchdog_rests, "had not looked for 1"),
    ("commands-bounded", quiet, sets("port_command", 120.0, 1.5), "port is commanded 1.5"),
    ("commands-bounded", quiet, sets("port_command", 120.0, float("nan")), "port is commanded nan"),
    ("commands-bounded", quiet, sets("port_rpm", 120.0, 700.0), "which is not 700 of 1200 rpm"),
    ("commands-gradual", quiet, sets("starboard_command", 120.0, 0.9), "from 0.400 to 0.900 within 0.20 s"),
    ("idle-commands-nothing", stopped, driven_in_idle, "commands of [0.05, 0.05] in idle"),
    ("idle-propellers-rest", turns_in_idle_and_is_told, turns_in_idle, "port turned for"),
    ("way-plausible", drifts_with_speed, drifts_without_speed, "farther north"),
    ("positions-steady", quiet, sets("north", 120.0, 40.0), "believed a jump of 40 m"),
    ("batteries-plausible", quiet, sets("port_charge", 120.0, 1.2), "port_charge is 1.2"),
    ("batteries-plausible", quiet, sets("starboard_voltage", 120.0, -3.0), "is -3 V"),
    ("manual-as-ordered", by_hand_in_order, by_hand_harder, "port is commanded 0.500, 0.400 was ordered"),
    ("steers-as-ordered", quiet, steers_elsewhere, "68.8 degrees, 90.0 was ordered"),
    (
        "table-obeyed",
        trouble("kill", "kill: its switch", "stop", "idle"),
        trouble("gnss_poor", "poor: 4 satellites", "stop"),
        "the table says warn",
    ),
    (
        "table-obeyed",
        trouble("sensor_bad", "gps bad", "stop", "idle"),
        trouble("sensor_bad", "gps bad", "warn"),
        "only warns; the table says stop",
    ),
    (
        "action-taken",
        trouble("sensor_bad", "gps bad", "stop", "idle"),
        trouble("sensor_bad", "gps bad", "stop"),
        "the boat went on in heading",
    ),
    ("home-after-pause", pauses(128.0), pauses(122.0), "home 2.0 s after"),
    ("home-after-pause", pauses(128.0), pauses(0.0), "does not go home"),
    ("told-in-time", console_gone(120.2), console_gone(118.0), "too early"),
    ("told-in-time", console_gone(120.2), console_gone(124.0), "too late"),
    (
        "notices-end",
        trouble("gnss_poor", "poor: 4 satellites", "warn", "", 123.0),
        trouble("gnss_poor", "poor: 4 satellites", "warn", "", 121.0),
        "over after 1.0 s",
    ),
    (
        "bits-as-notices",
        trouble("log", "log not written", "warn"),
        sets("troubles", 120.0, 1 << 12),
        "tell of log, and no note does",
    ),
    ("bits-as-notices", quiet, lambda log: log.event(120.0, "note", value="log: full: warn"), "the records know nothing of it"),
    ("navigation-heard", silent(told=True, stops=True), silent(told=False, stops=True), "nobody was told"),
    ("navigation-heard", silent(told=True, stops=True), silent(told=True, stops=False), "goes on in heading"),
    ("navigation-moves", repeats_itself_and_stops, repeats_itself, "navigation_frozen was not told"),
    ("console-heard", console_gone(120.2), console_gone(0.0), "console_silent was not told"),
    ("console-heard", console_gone(120.2), console_gone(112.0), "2.0 s after its last word"),
    ("guest-heard", guest_gone(told=True), guest_gone(told=False), "guest_silent was not told"),
    ("guest-heard", program(), program(told=False), "guest_silent was not told"),
    ("mode-causes", program(), program(of=""), "no order of this time asked for it"),
    ("programs-below", program(), program(given=False), "no operator had given it the boat"),
    ("programs-below", program(), program(back_s=110.0), "no operator had given it the boat"),
    ("programs-below", program(), program(may=("goto",)), "which has no right to it"),
    ("manual-heard", by_hand_in_order, by_hand_too_long, "thrust by hand"),
    ("manual-heard", by_hand_in_order, by_hand, "manual mode 6."),
    ("batteries-watched", battery(0.2, told=True), battery(0.2, told=False), "battery_low was not told"),
    ("batteries-watched", battery(0.2, told=True), battery(0.4, told=True), "40.0% in the emptier"),
    ("reception-watched", satellites(told=True), satellites(told=False), "gnss_poor was not told"),
    ("thrusters-obey", dead(told=True), dead(told=False), "port turns 0 instead of 840 rpm"),
    ("log-kept", unlogged(told=True), unlogged(told=False), "records are missing"),
    (
        "mode-causes",
        quiet,
        trouble("sensor_bad", "gps bad", "warn", "idle"),
        "from heading to idle (gps bad): sensor_bad says warn",
    ),
    ("mode-causes", quiet, lambda log: log.mode(120.0, "hold", ""), "without a reason"),
    ("mode-causes", leaves_idle("operator", ordered=True), leaves_idle("operator", ordered=False), "no order of this time"),
    ("mode-causes", quiet, lambda log: log.mode(120.0, "play", "heading done"), "heading does not end in play"),
    ("idle-left", leaves_idle("operator", ordered=True), leaves_idle("goto done", ordered=False), "by itself"),
    ("refused-changes-nothing", refused("play refused: no mission"), refused(" no "), "without a reason"),
    (
        "refused-changes-nothing",
        refused("play refused: no mission"),
        refused("play refused: no mission", "play"),
        "the boat went to play",
    ),
    (
        "orders-obeyed",
        ordered({"command": "play"}, "play"),
        ordered({"command": "play"}, ""),
        "play was obeyed, and the boat is in heading",
    ),
    ("modes-agree", quiet, other_mode_in_records, "the records say hold, the sidecar heading"),
    ("fence-watched", stops_at_the_fence, sails_over_the_fence, "nobody was told"),
    ("fence-watched", stops_at_the_fence, stops_for_no_fence, "the boat would stop"),
    ("outside-stopped", stops_at_the_fence, sails_over_the_fence, "outside the fence, under power"),
    ("outside-stopped", comes_back, holds_outside, "comes no nearer"),
    ("idle-left-outside", starts_by_hand_outside, starts_outside, "only manual is allowed"),
    ("frames-as-records", boxed, another_frame(0x41, 900), "900 rpm went to port; the records say 480"),
    ("silence-on-bus", silent_on_the_bus, turns_without_navigation, "after the last navigation"),
    ("reports-as-records", boxed, says_other_revolutions, "port reported 480 rpm, and the records say 300"),
]


def found(name: str, change: Change) -> list[str]:
    log = Forged(
        *(FENCE if "fence" in change.__name__ or name in ("outside-stopped", "idle-left-outside", "fence-watched") else ())
    )
    change(log)
    (rule,) = [each for each in RULES if each.name == name]
    return [f"{finding.t_s:.1f} s: {finding.words}" for finding in rule.check(log.evidence())]


@pytest.mark.parametrize(
    ("name", "keeps", "breaks", "words"), CASES, ids=[f"{name}: {words[:30]}" for name, _, _, words in CASES]
)
def test_a_rule_tells_the_log_that_breaks_it_from_the_one_that_keeps_it(name, keeps, breaks, words):
    assert found(name, keeps) == []
    told = found(name, breaks)
    assert any(words in each for each in told), told


def test_every_rule_has_its_logs():
    assert {name for name, *_ in CASES} == {rule.name for rule in RULES}
    assert len({rule.name for rule in RULES}) == len(RULES)


def test_a_quiet_log_keeps_all_rules():
    log = Forged(*FENCE)
    log.frames()
    for judged in judge(log.evidence()):
        assert judged.findings == (), judged.rule.name
        assert judged.unjudged == "", judged.rule.name


@pytest.mark.parametrize(
    ("name", "change", "why"),
    [
        ("frames-as-records", quiet, "there is no black box of can0"),
        ("fence-watched", lambda log: setattr(log, "settings", {}), "the log does not say fence"),
        (
            "console-heard",
            lambda log: log.order(120.0, {"command": "set", "key": "failsafe.console_silent"}),
            "was changed at sea",
        ),
        ("navigation-moves", lambda log: log.settings["navigation"].update(estimator=True), "estimator"),
        ("words-age", lambda log: log.columns.pop("guest_s"), "no field guest_s"),
    ],
)
def test_what_a_log_does_not_have_is_not_judged_and_said(name, change, why):
    log = Forged()
    log.settings = {key: dict(value) if isinstance(value, dict) else value for key, value in log.settings.items()}
    change(log)
    (rule,) = [each for each in RULES if each.name == name]
    with pytest.raises(Unjudged, match=why):
        list(rule.check(log.evidence()))
