"""The sections: whatever the boat says, they are well-formed, and the figures stay in their frames."""

import re
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from delfim import config
from delfim.services.page import api, document, figures, page
from delfim.services.page.metrics import metrics
from delfim.services.page.page import SECTIONS, PageView, head, mood
from delfim.services.page.wording import size, span
from delfim.vehicle.report import (
    BoatReport,
    LatencyFacts,
    LogFacts,
    NodeFacts,
    NoticeFacts,
    OrderInForce,
    ReferenceFacts,
    Service,
    ThrusterFacts,
    TrafficSeen,
    VesselSeen,
)
from tests.services.boat import STATE

ROOT = Path(__file__).parents[2]

FILE = config.Vehicle(boat=config.BoatTable(name="Test"))
VEHICLE = msgspec.convert(STATE, BoatReport)
words = st.text(st.characters(exclude_categories=("Cs", "Cc"), exclude_characters="\ufffe\uffff"), max_size=12)
numbers = st.one_of(st.none(), st.floats(-1e9, 1e9), st.floats(allow_nan=True, allow_infinity=True))


def rendered(report: api.Report) -> dict[str, ElementTree.Element]:
    view = PageView(report, FILE)
    texts = {"head": head(view), **{section.id: section.render(view) for section in SECTIONS}}
    return {name: ElementTree.fromstring(f"<div>{text.replace('&nbsp;', ' ')}</div>") for name, text in texts.items()}


def report(vehicle: BoatReport | None, computer: api.Computer | None = None) -> api.Report:
    services = vehicle.services if vehicle else {}
    now_ns = 1_795_231_735_093_121_524
    return api.Report(utc_ns=now_ns, vehicle=vehicle, reason="", services=services, computer=computer, computer_age_s=None)


def test_the_page_says_who_commands_and_why_the_boat_is_killed():
    killed = msgspec.structs.replace(VEHICLE, mode="idle", reason="kill: hand-set: its kill switch", operator="hand-set")
    band = "".join(rendered(report(killed))["head"].itertext())
    assert "kill: hand-set: its kill switch (hand-set commands)" in band


def test_other_vessels_are_told_those_first_that_are_met_first():
    def vessel(name: str, tcpa_s: float, danger: str = "none", **more: object) -> dict[str, object]:
        place = {"latitude_deg": 51.9, "longitude_deg": 4.5, "speed_mps": 3.0, "cpa_m": 21.4, "age_s": 8.0}
        return {"key": name, "name": name, "tcpa_s": tcpa_s, "danger": danger} | place | more

    targets = [vessel("PAST", -40.0), vessel("MARIA", 300.0, "near"), vessel("TEJO", 90.0, lost=True, size_known=True)]
    order = {"course_deg": 45.0, "speed_mps": 1.5, "words": "giving way to MARIA", "key": "MARIA", "age_s": 0.4}
    told = STATE | {"traffic": {"heard_s": 3.0, "targets": targets, "order": order, "guard": "on"}}
    section = rendered(report(msgspec.convert(told, BoatReport)))["vessels"]
    text = "".join(section.itertext())
    assert "3 vessels, last report 3.0 s ago. Sees only who transmits." in text
    assert "giving way to MARIA" in text
    names = [row.findtext("th/b") or row.findtext("th") for row in section.iter("tr")][1:]
    assert names == ["MARIA (size unknown): near", "TEJO", "PAST (size unknown)"]
    assert "lost, 8.0 s" in text
    assert "past" in text


def test_no_vessel_is_no_clear_water():
    assert "Sees only who transmits." in "".join(rendered(report(VEHICLE))["vessels"].itertext())


networks = st.dictionaries(words, st.builds(api.Network, up=st.booleans(), addresses=st.tuples(words)), max_size=2)
computers = st.builds(
    api.Computer,
    networks=networks,
    buses=st.dictionaries(words, st.builds(api.Bus, state=words, load=st.one_of(st.none(), st.floats(0, 2))), max_size=2),
    processes=st.tuples(
        st.builds(api.Process, pid=st.just(1), name=words, nice=st.just(0), cpu=st.just(0.5), memory_bytes=st.just(9))
    ),
    supervisor=st.dictionaries(words, st.builds(Service, state=words, reason=words), max_size=2),
    deadman=words,
    disk=st.one_of(st.none(), st.builds(api.Disk, path=words)),
)
states = st.builds(
    BoatReport,
    mode=words,
    reason=words,
    boat=words,
    source=words,
    mission=st.one_of(st.none(), words),
    heading_deg=numbers,
    speed_mps=numbers,
    latitude_deg=numbers,
    thrusters=st.dictionaries(
        words, st.builds(ThrusterFacts, thrust=st.floats(-1e6, 1e6), rpm=numbers, faults=st.tuples(words))
    ),
    reference=st.builds(ReferenceFacts, heading_deg=numbers, speed_mps=numbers, distance_m=numbers, cross_track_m=numbers),
    age_s=st.dictionaries(words, numbers, max_size=3),
    sysstat=st.dictionaries(words, st.builds(NodeFacts, status=words, faults=st.tuples(words), charge=numbers), max_size=2),
    measured=st.dictionaries(words, numbers, max_size=2),
    counts=st.dictionaries(words, st.integers(0, 9), max_size=2),
    services=st.dictionaries(
        words, st.builds(Service, state=words, reason=words, figures=st.dictionaries(words, words, max_size=1)), max_size=2
    ),
    traffic=st.one_of(
        st.none(),
        st.builds(
            TrafficSeen,
            targets=st.tuples(st.builds(VesselSeen, name=words, danger=words, cpa_m=numbers, tcpa_s=st.floats(-9, 9))),
            order=st.one_of(st.none(), st.builds(OrderInForce, words=words)),
            guard=words,
        ),
    ),
    notices=st.tuples(st.builds(NoticeFacts, name=words, reason=words, action=words)),
    log=st.builds(LogFacts, writable=st.booleans(), reason=words),
)


@given(states, computers)
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_whatever_is_said_the_page_is_well_formed(vehicle, computer):
    assert set(rendered(report(vehicle, computer))) == {"head", *(section.id for section in SECTIONS)}


def test_without_vehicle_and_computer_the_page_says_so():
    found = {name: "".join(section.itertext()) for name, section in rendered(report(None)).items()}
    assert "No answer" in found["head"]
    assert "the vehicle does not answer" in found["warnings"]
    assert "no data yet" in found["computer"]


def test_the_figures_of_a_service_are_tables():
    shown = {"frames_lost": 0, "buses": {"can<0>": {"received": 7, "failure": ""}, "b": {"received": 8}}, "clients": {}}
    vehicle = msgspec.structs.replace(VEHICLE, services={"cantcpd": Service(state="running", figures=shown)})
    section = rendered(report(vehicle))["services"]
    single, several = (
        [["".join(cell.itertext()) for cell in row] for row in table.iter("tr")] for table in section.iter("table")
    )
    assert single == [["frames lost", "0"], ["clients", "none"]]
    assert several == [["buses", "received", "failure"], ["can<0>", "7", "none"], ["b", "8", "none"]]
    assert not set("{}'") & set("".join(section.itertext()))


def test_the_value_of_a_sensor_stands_beside_its_age():
    vehicle = msgspec.structs.replace(VEHICLE, age_s={"depth_m": 0.3}, measured={"depth_m": 7.5})
    assert "".join(rendered(report(vehicle))["inputs"].itertext()).startswith("depth m7.500.3 s")
    assert 'delfim_measured{value="depth_m"} 7.5\n' in metrics(report(vehicle))


def test_a_network_that_never_was_up_is_no_news():
    networks = {
        "eth0": api.Network(up=True, addresses=("192.0.2.2",)),
        "ifb0": api.Network(up=False, addresses=()),
        "wlan0": api.Network(up=False, addresses=(), received_bytes=9),
    }
    text = "".join(rendered(report(VEHICLE, api.Computer(networks=networks)))["networks"].itertext())
    assert "ifb0" not in text
    assert "No longer up: wlan0" in text


@pytest.mark.parametrize(("asked_mps", "words"), [(None, ""), (1.5, "asked for 1.5"), (0.0, "asked to lie still")])
def test_the_speed_that_was_asked_for_is_said_in_words(asked_mps, words):
    vehicle = msgspec.structs.replace(VEHICLE, reference=ReferenceFacts(speed_mps=asked_mps))
    text = "".join(rendered(report(vehicle))["motion"].itertext())
    assert ("asked" in text) == bool(words)
    assert words in text


def test_speed_is_in_knots_too_and_the_kind_of_fix_is_in_words():
    vehicle = msgspec.structs.replace(VEHICLE, speed_mps=1.5, fix=6, satellites=14, hdop=0.7, accuracy_m=0.3, corrections_s=2)
    text = "".join(rendered(report(vehicle))["motion"].itertext())
    assert "1.50m/s2.9 kn" in text
    assert "RTK float, 14 satellites, HDOP 0.7, accuracy 0.30 m, corrections 2 s old" in text


places = st.tuples(st.floats(-80, 80), st.floats(-179, 179))


@given(st.lists(places, max_size=20), places, st.one_of(st.none(), places), st.one_of(st.none(), st.floats(0, 360)))
def test_the_map_shows_all_of_the_way_in_its_frame(way, here, there, heading_deg):
    drawing = figures.chart(way, here, heading_deg, there)
    ElementTree.fromstring(drawing)
    points = re.findall(r"[ML](-?[0-9.]+) (-?[0-9.]+)", "".join(re.findall(r'class="(?:way|to)" d="([^"]+)"', drawing)))
    assert len(points) == len(way) + 1 + (2 if there else 0)
    assert all(0 <= float(x) <= figures.WIDTH and 0 <= float(y) <= figures.HEIGHT for x, y in points)


def test_the_map_has_a_scale():
    drawing = figures.chart([(38.6900, -9.2150)], (38.6909, -9.2150), 0.0, None)
    rule = re.search(r'class="rule" d="M10 \d+v5h([0-9.]+)v-5"', drawing)
    length = re.search(r">(\d+) m<", drawing)
    ends = re.search(r'class="way" d="M([0-9.]+) ([0-9.]+)L([0-9.]+) ([0-9.]+)"', drawing)
    assert None not in (rule, length, ends)
    metres_a_pixel = float(length[1]) / float(rule[1])
    assert (float(ends[2]) - float(ends[4])) * metres_a_pixel == pytest.approx(100.0, abs=2.0)


@pytest.mark.parametrize(
    ("changes", "colour"),
    [
        ({"notices": ()}, "good"),
        ({}, "warn"),
        ({"notices": (NoticeFacts(name="sensor_bad", reason="gps", action="stop"),)}, "bad"),
        ({"mode": "idle", "notices": ()}, "calm"),
        ({"mode": "idle", "reason": "navigation silent for 1.2 s", "notices": ()}, "warn"),
    ],
)
def test_the_colour_of_the_band(changes, colour):
    assert mood(msgspec.structs.replace(VEHICLE, **changes)) == colour


bars = st.lists(st.tuples(st.floats(10, 1e7), st.integers(1, 10**7)), max_size=40).map(
    lambda found: tuple(sorted(dict(found).items()))
)


@given(bars, st.floats(0, 1e7))
def test_the_histogram_stays_in_its_frame(found, worst_us):
    latency = LatencyFacts(n=sum(n for _, n in found), worst_us=worst_us, p50_us=worst_us / 2, histogram=found)
    drawing = figures.histogram(latency)
    ElementTree.fromstring(drawing)
    points = re.findall(r"[MVH](-?[0-9.]+)(?: (-?[0-9.]+))?", " ".join(re.findall(r' d="([^"]+)"', drawing)))
    assert all(-0.5 <= float(value) <= figures.WIDTH for pair in points for value in pair if value)


def test_higher_counts_are_higher_bars():
    drawing = figures.histogram(LatencyFacts(n=111, histogram=((20.0, 1), (40.0, 10), (80.0, 100))))
    path = re.search(r'class="bars" d="([^"]+)"', drawing)
    assert path is not None
    tops = [float(each) for each in re.findall(r"V([0-9.]+)H", path[1])]
    assert tops == sorted(tops, reverse=True)


@pytest.mark.parametrize(
    ("value", "text"), [(0.04, "0.0 s"), (59.4, "59 s"), (61, "1 min 1 s"), (7260, "2 h 1 min"), (200_000, "2 d 7 h")]
)
def test_times_as_people_say_them(value, text):
    assert span(value) == text


@pytest.mark.parametrize(("value", "text"), [(0, "0 B"), (1500, "1.5 kB"), (123e6, "123 MB"), (2.5e9, "2.5 GB")])
def test_sizes(value, text):
    assert size(value) == text


@pytest.mark.parametrize(("value", "text"), [(7.25, "7.25 µs"), (640.2, "640 µs"), (1234, "1.23 ms"), (2.5e6, "2.5 s")])
def test_micros(value, text):
    assert figures.micros(value) == text


def test_style_and_script_are_what_the_policy_lets_run():
    whole = document.live({section.id: "" for section in page.SECTIONS} | {"head": ""}, 1.0)
    for tag, text in (("style", document.STYLE), ("script", document.SCRIPT), ("script", document.COLOURS)):
        assert f"<{tag}>{text}</{tag}>" in whole
        assert document._digest(text) in document.POLICY
    assert not re.search(r'\sstyle="|\son[a-z]+="', whole), "the policy would refuse it"


def test_the_colours_are_the_consoles_and_only_those_that_are_used():
    tokens = (ROOT / "delfim/console/web/src/tokens.css").read_bytes()
    assert (ROOT / "delfim/services/page/tokens.css").read_bytes() == tokens, "make page"
    used = set(re.findall(r"var\((--\w+)\)", document.STYLE))
    assert used == set(re.findall(r"(--\w+):", document.STYLE))
    for theme in ("bright", "dusk", "night"):
        assert f':root[data-theme="{theme}"]{{' in document.STYLE


def test_the_troubles_of_a_services_parts_are_to_look_at() -> None:
    figures = {"troubles": {"sonar": "waiting: exit code 1: <no port>"}}
    computer = api.Computer(supervisor={"payload": Service(state="running", figures=figures)})
    shown = rendered(report(VEHICLE, computer))["warnings"]
    assert "payload sonar waiting: exit code 1: <no port>" in "".join(shown.itertext())
