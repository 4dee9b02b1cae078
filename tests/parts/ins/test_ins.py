"""Inertial navigation systems: frames of the makers' programs, of a recorded device, any bytes at all, a voyage with each."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock
from delfim.base.modes import Mode
from delfim.canproxy.dsor.messages import Navigation
from delfim.lines.binaryframes import BinaryFrames, mirrored_crc
from delfim.parts.ins import anpp, sbg, vectornav, xsens
from delfim.parts.ins.insmessages import InsState, Readings
from delfim.parts.ins.languages import LANGUAGES
from delfim.parts.ins.table import InsTable
from delfim.simulator.faults import fault
from delfim.simulator.line import LockstepLine
from delfim.simulator.lockstep import Lockstep
from delfim.vehicle import console
from delfim.vehicle.links import Links
from delfim.vehicle.navigation.fixes import open_sources
from delfim.vehicle.state import NoLog, State

ROOT = Path(__file__).parents[3]
PLACE = math.radians(38.69123456), math.radians(-9.12345678)
STATE = InsState(1_790_000_000_250_000_000, PLACE, 0.7, (1.25, -0.5), 4.0, 0.01, 0.05, (0.02, -0.03), 5, 17)
angles = st.floats(-math.pi, math.pi)
states = st.builds(
    InsState,
    st.integers(1_600_000_000_000, 2_000_000_000_000).map(lambda ms: ms * 1_000_000),
    st.tuples(st.floats(0.01, 1.5), angles),
    st.floats(0.01, 100.0),
    st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)),
    st.floats(0.0, 6.28),
    st.floats(0.0009765625, 3.0),
    st.floats(-1.0, 1.0),
    st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)),
    st.sampled_from((3, 4, 5, 6)),
    st.integers(0, 40),
)
every = pytest.mark.parametrize("speaks", LANGUAGES)
# As VectorNav's interface control document has it, and as the maker's vnproglib 1.2 read it: 38.69123456, -9.12345678 ...
VECTORNAV_DOCUMENT = "fa01080093502e42833ef13f48b504bb9288"
VECTORNAV = (
    "fa3b200040021800020113060000000000000000cdcc4c3d1a09150e0d14fa00071108e12e65430b04dcbf5dad923f5dad123f5dad123e5dad123e"
    "06005088c25f7a584340912321ba353f22c000000000000000000000a03f000000bf000000003333333fcdcc4c3d53f3"
)
# Written by the maker's library sbgECom 5.1: UTC time, attitude, receiver, two of rates, navigation.
SBG = (
    "ff5a0200210040e201008000ea070b1c05280780b2e60e010000000000000000000000000000006d4233",
    "ff5a0600280040e201000ad7a33c8fc2f5bc000010c06f12833a6f12033b0ad7233cf40000000000c07f0000c07f2a4c33",
    "ff5a0e003e0078e00100c0010000000000009a9999999959434033333333333322c000000000000000000000000000000000000000000000000011"
    "05006400140000000039d733",
    "ff5a03003a000000000000000000000000000000c3f51cc10000000000000000cdcc4c3d0000a041000000000000000000000000000000000000"
    "000000000000faea33",
    "ff5a2c0020000000000000000000000000000000000000000000000000000000333333000014b69d33",
    "ff5a0800480040e201000000a03f000000bfcdcccc3dcdcc4c3dcdcc4c3dcdcc4c3d5088c25f7a584340912321ba353f22c0000000000000294000"
    "0054429a99993ecdcccc3e9a99193ff4000000397a33",
)
# Framed by the maker's package advanced-navigation 0.2.2: deviations of the angles, and the state.
ANPP = (
    "791a0cc39e6f12833a6f12033b0ad7233c",
    "54146439fb00007f02803bb16a90d00300aa75b096f89be53f38a93ea0ca61c4bf00000000000029400000a03f000000bfcdcccc3d000000000000"
    "0000c3f51cc10000803f0ad7a33c8fc2f5bc000080400000000000000000cdcc4c3d9a99993ecdcccc3e9a99193f",
)
# Of an MTi, as github.com/einride/xsens-go recorded it (testdata/4 and 5): a receiver's data, and a quaternion.
XSENS = (
    "faff367c70105e02f5d5dc07e301140d2f1b37000000051dc9e8f703010c000715235d22612f1d00013dd60000a78f000008ea0000084effffffeeff"
    "ffffedfffffff40000001a00000000000000dd00e55e2600020000009800880043006f004f0035003a10100c1dcd650007e301140d2f1b371060040315"
    "7148102002aabbc9",
    "faff3688102002ab1810600403159bea1070040000143610100c23400c4007e301140d2f1c37e0200400000005202024bf7ffcae3c2262113adf1750"
    "b786f2003e2bb3b0bf7c6020bc24c28cbf7c5cdcbe2bb17040300c3b38ce9ebc30fd11bc6e6d002010103b7c2094bb542cd0bf439afe3f25251a081004"
    "42134000c0200c3daaa4903e41ed4e3e202dcf54",
)


def read(speaks: str, *frames: str) -> Readings:
    """All that these frames say."""
    language, said = LANGUAGES[speaks], dict[str, tuple[float, ...] | None]()
    parser = BinaryFrames(language.framing)
    for each in frames:
        (frame,) = parser.feed(bytes.fromhex(each))
        said |= language.read(frame)
    return said


def close(said: Readings, **wanted: tuple[float, ...]) -> bool:
    return all(said[kind] == pytest.approx(value, rel=1e-6, abs=1e-6) for kind, value in wanted.items())


def test_what_the_makers_programs_say_is_read():
    assert close(read("vectornav", VECTORNAV_DOCUMENT), attitude=(-3.5342e-05, 0.0328946))
    said = read("vectornav", VECTORNAV)
    assert close(
        said, position=PLACE, velocity=(1.25, -0.5), heading=(4.0,), deviation=(0.01,), accuracy=(0.7,), receiver=(5, 17)
    )
    assert said["time"] == (1_790_000_000_250_000_000,)
    said = read("sbg", *SBG)
    assert close(
        said, position=PLACE, velocity=(1.25, -0.5), heading=(-2.25,), deviation=(0.01,), accuracy=(0.5,), rate=(0.05,)
    )
    assert (said["receiver"], said["time"]) == ((5, 17), (1_795_844_407_250_000_000,))
    assert close(read("sbg", SBG[3]), rate=(0.05,))
    said = read("anpp", *ANPP)
    assert close(said, position=PLACE, velocity=(1.25, -0.5), heading=(4.0,), deviation=(0.01,), accuracy=(0.5,), rate=(0.05,))
    assert (said["receiver"], said["time"]) == ((5, 0), (1_790_000_000_250_000_000,))


def test_what_an_mti_said_is_read():
    said = read("xsens", XSENS[0])
    assert said == {"receiver": (3, 12), "accuracy": (2.282,), "time": (1_547_992_047_500_000_000,)}
    said = read("xsens", XSENS[1])
    assert close(said, attitude=(-1.7392612, 0.00170205))
    assert said["heading"] is None, "its filter was not valid yet"


def test_what_is_told_is_what_the_makers_programs_read():
    assert vectornav.told(STATE).hex() == VECTORNAV
    assert anpp.framed(anpp.ANGLE_DEVIATIONS, bytes.fromhex(ANPP[0])[5:]).hex() == ANPP[0]
    assert sbg.framed(sbg.EULER, bytes.fromhex(SBG[1])[6:-3]).hex() == SBG[1]
    assert mirrored_crc(b"123456789") == 0x2189


@every
@given(state=states)
def test_a_state_is_read_as_it_was_told(speaks: str, state: InsState):
    language, said = LANGUAGES[speaks], dict[str, tuple[float, ...] | None]()
    parser = BinaryFrames(language.framing)
    for byte in language.told(state):  # byte by byte
        for frame in parser.feed(bytes((byte,))):
            said |= language.read(frame)
    assert parser.refused == 0
    assert close(said, position=state.position, velocity=state.velocity, rate=(state.rate_radps,))
    assert said["attitude"] == pytest.approx(state.attitude, abs=1e-5)
    (heading_rad,) = said["heading"] or ()
    assert math.isclose(math.cos(heading_rad - state.heading_rad), 1.0, abs_tol=1e-9)
    assert said["accuracy"] == pytest.approx((state.accuracy_m,), abs=6e-4, rel=1e-5)
    assert said["receiver"] == (state.fix, 0 if speaks == "anpp" else state.satellites)
    assert said["time"] == (state.utc_ns,)
    if speaks != "xsens":
        assert close(said, deviation=(state.deviation_rad,))


@pytest.mark.parametrize(
    ("axes", "yaw", "heading"),
    [(xsens.ENU, 0.0, 90.0), (xsens.ENU, 90.0, 0.0), (xsens.NED, 90.0, 90.0), (xsens.NWU, 90.0, -90.0)],
)
def test_an_mti_may_have_any_axes(axes: int, yaw: float, heading: float):
    said = xsens._turned(axes, 0.1, 0.2, math.radians(yaw))
    assert close(said, heading=(math.radians(heading),), attitude=(0.1, 0.2 if axes == xsens.NED else -0.2))


class Bench:
    """A system on a line, and what becomes of what it says."""

    def __init__(self, speaks: str = "vectornav", **keys: float) -> None:
        self.clock, self.state = ManualClock(monotonic_s=1000.0), State()
        self.line = LockstepLine(self.clock)
        settings = config.Vehicle(
            boat=config.BoatTable(name="tried"),
            navigation=config.NavigationTable(sources=("ins",)),
            ins=InsTable(speaks=speaks, **keys),
        )
        links = Links(lambda *_: pytest.fail("no bus"), lambda *_: self.line)
        (self.source,) = open_sources(settings, links, self.state)

    def hear(self, data: bytes) -> Navigation | None:
        self.line.put(data)
        fix = self.source.read(self.clock.monotonic_s())
        return None if fix is None else fix.navigation


@every
@given(
    pieces=st.lists(st.binary(max_size=300) | st.sampled_from([each.told(STATE) for each in LANGUAGES.values()]), max_size=12)
)
def test_any_bytes_raise_nothing_and_little_is_kept(speaks: str, pieces: list[bytes]):
    bench = Bench(speaks)
    for piece in pieces:
        bench.hear(piece)
        assert len(bench.source._frames._rest) <= 5000


@every
@given(at=st.integers(0, 10_000), by=st.integers(1, 255))
def test_a_damaged_message_is_no_position_of_another_place(speaks: str, at: int, by: int):
    bench, good = Bench(speaks), LANGUAGES[speaks].told(STATE)
    data = bytearray(good)
    data[at % len(good)] ^= by
    bench.hear(bytes(data))
    bench.hear(bytes(5000))  # a length that was damaged is waited for
    n = bench.hear(good + bytes(300) + good)
    assert n is not None
    assert (n.latitude_rad, n.longitude_rad) == pytest.approx(PLACE, abs=1e-9)


@every
def test_a_message_of_navigation_has_what_the_system_says(speaks: str):
    n = Bench(speaks).hear(LANGUAGES[speaks].told(STATE))
    assert n is not None
    assert n[1:9] == pytest.approx((*PLACE, 1.25, -0.5, 4.0, 0.05, 0.02, -0.03), abs=1e-6)
    assert (n.utc_ns, n.fix, n.satellites) == (STATE.utc_ns, 5, 0 if speaks == "anpp" else 17)
    assert n.accuracy_m == pytest.approx(0.7, abs=1e-3)


def test_what_it_is_not_sure_of_is_unknown():
    told = vectornav.told
    bench = Bench(position_max_m=2.0, heading_max_deg=3.0)
    n = bench.hear(told(STATE._replace(accuracy_m=2.1)))
    assert n is not None
    assert (n.latitude_rad, n.north_mps, n.fix) == (None, None, 0)
    assert n.heading_rad == pytest.approx(4.0)
    n = bench.hear(told(STATE._replace(deviation_rad=math.radians(3.1))))
    assert n is not None
    assert n.heading_rad is None
    assert n.latitude_rad is not None
    report = bench.source.report(1000.0)
    assert (report["accuracy_m"], report["heading_deg"]) == (0.7, 3.1)
    assert report["kinds"]["heading"] == {"talker": "ins", "age_s": 0.0}
    n = bench.hear(told(STATE._replace(fix=2)))
    assert n is not None
    assert n.fix == 2, "a position without a receiver counts as two-dimensional"


@pytest.mark.parametrize(
    ("mode", "known"),
    [(0, (False, False, False)), (2, (False, False, True)), (3, (False, True, True)), (4, (True, True, True))],
)
def test_the_filter_of_an_sbg_says_what_it_knows(mode: int, known: tuple[bool, ...]):
    data = sbg.told(STATE).replace(b"\xf4\x00\x00\x00", bytes((0xF0 | mode, 0, 0, 0)))
    said = dict[str, tuple[float, ...] | None]()
    for number in (sbg.EULER, sbg.NAV):
        at = data.index(sbg.BEGIN + bytes((number, 0)))
        payload = data[at + 6 : at + 6 + int.from_bytes(data[at + 4 : at + 6], "little")]
        said |= sbg.read(sbg.framed(number, payload))
    assert tuple(said[kind] is not None for kind in ("position", "velocity", "heading")) == known


@pytest.mark.parametrize(("mode", "known"), [(0, False), (1, True), (2, True), (3, False)])
def test_the_filter_of_a_vectornav_says_whether_it_knows_the_place(mode: int, known: bool):
    said = vectornav._readings(
        {"status": (mode,), "place": (38.0, -9.0, 0.0), "velocity": (1.0, 0.0, 0.0), "angles": (90.0, 0.0, 0.0)}
    )
    assert (said["position"] is not None) is (said["velocity"] is not None) is known
    assert (said["heading"] is not None) is (mode > 0)


@pytest.mark.parametrize("wrong", [{"position": (math.nan, 0.0)}, {"velocity": (1e6, 0.0)}, {"rate_radps": math.inf}])
def test_what_no_boat_can_have_is_counted(wrong: dict[str, object]):
    bench = Bench("anpp")
    assert bench.hear(anpp.told(STATE._replace(**wrong))) is None
    assert bench.state.counts == {"ins_malformed": 1}
    assert bench.source.heard_s < 0.0


@every
def test_a_voyage_and_the_silence_of_the_system_in_it(speaks: str):
    settings = config.load(ROOT / "etc/delfimx.toml", ['navigation.sources=["ins"]', f'ins.speaks="{speaks}"'])
    run = Lockstep(settings, 1, lambda clock: NoLog())
    list(run.cycles(5.0))
    assert run.command(console.Heading(3.0, 1.5)) is None
    list(run.cycles(30.0))
    model, motion = run.nodes.model, run.state.motion
    assert (run.state.source, run.state.counts, run.state.mode) == ("ins", {}, Mode.HEADING)
    assert math.cos(motion.heading_rad - model.heading_rad) == pytest.approx(1.0, abs=0.005)
    assert math.hypot(motion.north_mps - model.north_mps, motion.east_mps - model.east_mps) < 0.5
    run.breaks(fault("navigation_silent", ""))
    list(run.cycles(settings.navigation.stale_s + 1.0))
    assert run.state.mode is not Mode.HEADING
    assert "silent" in run.state.reason
    run.close()
