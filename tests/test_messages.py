"""Layouts of the boat's messages: round trips, unknowns, and bytes that mean nothing."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.base.frames import Frame
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import (
    BatteriesStatus,
    Fault,
    GpsStatus,
    Navigation,
    Node,
    PropellerCommand,
    PropellerStatus,
    Status,
)

NAN = math.nan
STRANGE = (NAN, math.inf, -math.inf, 1e300, -1e300)

u8 = st.integers(0, 255)
u64 = st.integers(0, 2**64 - 1)


def known_or_not(low: float, high: float) -> st.SearchStrategy[float | None]:
    return st.none() | st.floats(low, high)


navigations = st.builds(
    Navigation,
    utc_ns=u64,
    latitude_rad=st.floats(-math.pi / 2, math.pi / 2),
    longitude_rad=st.floats(-math.pi, math.pi),
    north_mps=st.floats(-32.7, 32.7),
    east_mps=st.floats(-32.7, 32.7),
    heading_rad=known_or_not(0.0, math.tau),
    yaw_rate_radps=known_or_not(-3.2, 3.2),
    roll_rad=known_or_not(-math.pi, math.pi),
    pitch_rad=known_or_not(-math.pi / 2, math.pi / 2),
    fix=st.integers(1, 5),
    satellites=u8,
    hdop=known_or_not(0.0, 25.4),
    counter=u8,
)
NOTHING_KNOWN = Navigation(0, None, None, None, None, None, None, None, None, 0, 0, None, 0)
HERE = Navigation(1, 0.6753, -0.1608, 0.5, -1.0, 1.0, 0.1, 0.01, -0.02, 3, 9, 1.2, 7)


def changed(change: dict[str, Any]) -> Navigation:
    return HERE._replace(**change)


def close(value: float | None, expected: float | None, step: float) -> bool:
    """Both unknown, or the same within half a step of the field."""
    return value is expected or (value is not None and expected is not None and abs(value - expected) <= step * 0.501)


@given(navigations)
def test_navigation_round_trip_within_the_resolution(n: Navigation) -> None:
    back = messages.unpack_navigation(messages.pack_navigation(n))
    assert (back.utc_ns, back.fix, back.satellites, back.counter) == (n.utc_ns, n.fix, n.satellites, n.counter)
    assert close(back.latitude_rad, n.latitude_rad, math.radians(1e-7))  # 11 mm
    assert close(back.longitude_rad, n.longitude_rad, math.radians(1e-7))
    assert close(back.north_mps, n.north_mps, 1e-3)
    assert close(back.east_mps, n.east_mps, 1e-3)
    assert close(back.yaw_rate_radps, n.yaw_rate_radps, 1e-4)
    assert close(back.roll_rad, n.roll_rad, 1e-4)
    assert close(back.pitch_rad, n.pitch_rad, 1e-4)
    assert close(back.hdop, n.hdop, 0.1)
    if n.heading_rad is None or back.heading_rad is None:
        assert back.heading_rad is n.heading_rad
    else:
        assert 0.0 <= back.heading_rad < math.tau
        assert abs(math.remainder(back.heading_rad - n.heading_rad, math.tau)) <= 0.501e-4


def test_navigation_is_32_bytes() -> None:
    assert len(messages.pack_navigation(HERE)) == 32


def test_unknown_is_never_zero() -> None:
    assert messages.unpack_navigation(messages.pack_navigation(NOTHING_KNOWN)) == NOTHING_KNOWN


def test_half_a_position_and_half_a_velocity_are_none() -> None:
    back = messages.unpack_navigation(messages.pack_navigation(HERE._replace(longitude_rad=None, east_mps=None)))
    assert (back.latitude_rad, back.longitude_rad, back.north_mps, back.east_mps) == (None, None, None, None)


def test_without_a_fix_there_is_no_position() -> None:
    back = messages.unpack_navigation(messages.pack_navigation(HERE._replace(fix=0)))
    assert (back.latitude_rad, back.longitude_rad) == (None, None)


@pytest.mark.parametrize(
    "field",
    ["latitude_rad", "longitude_rad", "north_mps", "east_mps", "heading_rad", "yaw_rate_radps", "roll_rad", "pitch_rad"],
)
@pytest.mark.parametrize("value", [NAN, math.inf, -math.inf])
def test_what_is_not_finite_is_sent_as_unknown(field: str, value: float) -> None:
    back = messages.unpack_navigation(messages.pack_navigation(changed({field: value})))
    assert getattr(back, field) is None


@pytest.mark.parametrize("field", ["north_mps", "east_mps", "yaw_rate_radps", "roll_rad", "pitch_rad"])
@pytest.mark.parametrize("value", [1e4, -1e4, 1e300])
def test_what_does_not_fit_is_sent_as_unknown(field: str, value: float) -> None:
    back = messages.unpack_navigation(messages.pack_navigation(changed({field: value})))
    assert getattr(back, field) is None


@pytest.mark.parametrize(
    ("sent", "arrives"), [(None, None), (NAN, None), (-1.0, None), (math.inf, 25.4), (99.9, 25.4), (25.4, 25.4), (0.0, 0.0)]
)
def test_hdop(sent: float | None, arrives: float | None) -> None:
    assert messages.unpack_navigation(messages.pack_navigation(HERE._replace(hdop=sent))).hdop == arrives
    gps = GpsStatus(Status.GOOD, Fault(0), 3, 9, sent, 5)
    assert messages.unpack_sysstat(Node.GPS, messages.pack_gps_status(gps)) == gps._replace(hdop=arrives)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"latitude_rad": 1.6}, "impossible position"),
        ({"latitude_rad": -1.6}, "impossible position"),
        ({"longitude_rad": 3.2}, "impossible position"),
    ],
)
def test_positions_that_no_boat_has(change: dict[str, float], reason: str) -> None:
    data = messages.pack_navigation(changed(change))
    with pytest.raises(FormatError, match=reason):
        messages.unpack_navigation(data)


def test_a_heading_beyond_a_turn_is_impossible() -> None:
    data = bytearray(messages.pack_navigation(HERE))
    data[20:22] = (62_833).to_bytes(2, "little")
    with pytest.raises(FormatError, match=r"impossible heading 6\.2833"):
        messages.unpack_navigation(bytes(data))
    data[20:22] = (62_832).to_bytes(2, "little")  # 2 pi rounded up
    assert messages.unpack_navigation(bytes(data)).heading_rad == pytest.approx(0.0, abs=1e-4)


@given(st.binary(min_size=32, max_size=32))
def test_any_32_bytes_are_a_possible_navigation_or_a_format_error(data: bytes) -> None:
    try:
        n = messages.unpack_navigation(data)
    except FormatError:
        return
    assert n.latitude_rad is None or abs(n.latitude_rad) <= math.pi / 2 + 1e-9
    assert n.longitude_rad is None or abs(n.longitude_rad) <= math.pi + 1e-9
    assert n.heading_rad is None or 0.0 <= n.heading_rad < math.tau
    assert (n.latitude_rad is None) == (n.longitude_rad is None)
    assert (n.north_mps is None) == (n.east_mps is None)
    assert all(math.isfinite(value) for value in n if value is not None)


UNPACKERS = [
    (messages.unpack_navigation, 32),
    (messages.unpack_propeller_command, 4),
    (messages.unpack_batteries_command, 2),
    *((lambda data, node=node: messages.unpack_sysstat(node, data), 8) for node in (0x10, 0x11, 0x20, 0x21)),
    (lambda data: messages.unpack_sysstat(Node.GPS, data), 16),
]


@pytest.mark.parametrize(("unpack", "size"), UNPACKERS)
def test_every_other_length_is_a_format_error(unpack: Any, size: int) -> None:
    for length in range(40):
        if length == size:
            unpack(bytes(length))
        else:
            with pytest.raises(FormatError):
                unpack(bytes(length))


@given(st.integers(-1, 0x80) | st.sampled_from(Node), st.binary(max_size=17))
def test_any_status_is_understood_or_a_format_error(node: int, data: bytes) -> None:
    try:
        status = messages.unpack_sysstat(node, data)
    except FormatError:
        return
    assert status.status in Status
    assert all(math.isfinite(value) for value in status if value is not None)


@pytest.mark.parametrize("node", [Node.VEHICLE, Node.NAVIGATION, Node.BROADCAST, 0x55])
def test_nodes_without_a_status(node: int) -> None:
    with pytest.raises(FormatError, match="has no system status"):
        messages.unpack_sysstat(node, bytes(8))


def test_a_status_beyond_bad_is_a_format_error() -> None:
    with pytest.raises(FormatError, match="3 is not a valid Status"):
        messages.unpack_sysstat(Node.PROPELLER_PORT, b"\3" + bytes(7))


@pytest.mark.parametrize("rpm", [*STRANGE, 32767, -32768])
def test_a_reference_that_is_none_is_sent_as_motor_off(rpm: Any) -> None:
    data = messages.pack_propeller_command(PropellerCommand(rpm, True, 300))
    assert messages.unpack_propeller_command(data) == PropellerCommand(0, False, 300 & 0xFF)


@given(st.integers(-32766, 32766), st.booleans(), st.integers(0, 1000))
def test_propeller_command_round_trip(rpm: int, run: bool, counter: int) -> None:
    data = messages.pack_propeller_command(PropellerCommand(rpm, run, counter))
    assert messages.unpack_propeller_command(data) == PropellerCommand(rpm, run, counter & 0xFF)


@given(st.binary(min_size=4, max_size=4))
def test_any_four_bytes_are_a_command(data: bytes) -> None:
    command = messages.unpack_propeller_command(data)
    assert command.run == bool(data[2] & 1)


@pytest.mark.parametrize("value", [None, *STRANGE])
def test_strange_measurements_are_sent_as_unknown(value: Any) -> None:
    propeller = PropellerStatus(Status.BAD, Fault.HARDWARE, value, value, value, 1)
    arrived = messages.unpack_sysstat(Node.PROPELLER_PORT, messages.pack_propeller_status(propeller))
    assert arrived == PropellerStatus(Status.BAD, Fault.HARDWARE, None, None, None, 1)
    batteries = BatteriesStatus(Status.GOOD, Fault(0), value, value, value, value)
    assert messages.unpack_sysstat(Node.BATTERIES_PORT, messages.pack_batteries_status(batteries)) == (0, 0, *[None] * 4)


@pytest.mark.parametrize(("sent", "arrives"), [(0.0, 0.0), (1.0, 1.0), (-0.001, 0.0), (-0.1, None), (1.1, None), (0.501, 0.5)])
def test_charge(sent: float, arrives: float | None) -> None:
    data = messages.pack_batteries_status(BatteriesStatus(Status.GOOD, Fault(0), 48.0, 1.0, sent, 20))
    status = messages.unpack_sysstat(Node.BATTERIES_PORT, data)
    assert isinstance(status, BatteriesStatus)
    assert status.charge == arrives


@given(st.sampled_from(Status), st.integers(0, 255).map(Fault), u8, u8, known_or_not(0.0, 25.4), u64)
def test_gps_status_round_trip(status, fault, fix, satellites, hdop, utc_ns):
    sent = GpsStatus(status, fault, fix, satellites, hdop, utc_ns)
    back = messages.unpack_sysstat(Node.GPS, messages.pack_gps_status(sent))
    assert isinstance(back, GpsStatus)
    assert back._replace(hdop=None) == sent._replace(hdop=None)
    assert close(back.hdop, hdop, 0.1)


def test_identifiers_are_unique_and_ordered_by_urgency() -> None:
    commands = [messages.PROPELLER_STARBOARD, messages.PROPELLER_PORT, messages.BATTERIES_STARBOARD, messages.BATTERIES_PORT]
    reports = [messages.sysstat_arb(node) for node in sorted(Node) if node not in (Node.VEHICLE, Node.BROADCAST)]
    ranked = [*commands, messages.TIME_FRAME, messages.SHUTDOWN, messages.SHUTDOWN_ACKNOWLEDGE, *reports]
    assert ranked == sorted(set(ranked))


@given(st.sampled_from(Node), st.sampled_from(Node))
def test_the_mask_accepts_the_status_of_any_node(a: Node, b: Node) -> None:
    assert (messages.sysstat_arb(a) ^ messages.sysstat_arb(b)) & ~messages.SYSSTAT_MASK == 0
    frame = Frame(messages.sysstat_arb(a))
    assert frame.extended
    assert frame.identifier >> 12 & 0x7F == a


@given(st.binary(max_size=8))
def test_no_other_bytes_are_a_shutdown_order(data: bytes) -> None:
    with pytest.raises(FormatError, match="shutdown order"):
        messages.unpack_shutdown(data)


@pytest.mark.parametrize("data", [b"", b"\x02", b"\x00\x00", b"\x04\x00", b"\x02\x00\x00"])
def test_no_other_bytes_say_that_the_power_may_be_cut(data: bytes) -> None:
    with pytest.raises(FormatError, match="shutdown acknowledge"):
        messages.unpack_shutdown_acknowledge(data)


def test_more_holders_than_fit_are_many() -> None:
    data = messages.pack_shutdown_acknowledge(messages.ShutdownAcknowledge(messages.ShutdownStage.HELD, 1000))
    assert messages.unpack_shutdown_acknowledge(data).holders == 255
