"""etc/delfimx.dbc against the code's own layouts, in both directions and over the whole range."""

from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.base.frames import CAN_IDE, identifier
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Node, PropellerStatus, Status

DBC: Any = cantools.database.load_file(Path(__file__).parents[2] / "etc" / "delfimx.dbc")
SIDES = ("Starboard", "Port")
FAULTS = {
    "FaultOverheated": Fault.OVERHEATED,
    "FaultOvercurrent": Fault.OVERCURRENT,
    "FaultNoCommand": Fault.NO_COMMAND,
    "FaultLowVoltage": Fault.LOW_VOLTAGE,
    "FaultNoSignal": Fault.NO_SIGNAL,
    "FaultHardware": Fault.HARDWARE,
}

counter = st.integers(0, 255)
status = st.sampled_from(Status)
fault = st.builds(lambda low, high: Fault(low | high), st.integers(0, 31), st.sampled_from([0, Fault.HARDWARE]))
tenths = st.none() | st.integers(-32766, 32766).map(lambda i: i / 10)
temperature = st.none() | st.integers(-126, 126)


def check(name: str, data: bytes, signals: dict[str, object]) -> None:
    """These bytes mean these signals, and the other way round; None is the "unknown" of the value table."""
    expected = {key: "unknown" if value is None else value for key, value in signals.items()}
    decoded = DBC.get_message_by_name(name).decode(data)
    assert {k: v if isinstance(v, int | float) else str(v) for k, v in decoded.items()} == {
        k: pytest.approx(v) if isinstance(v, int | float) else v for k, v in expected.items()
    }
    assert DBC.get_message_by_name(name).encode(expected, strict=True) == data


def faults(value: Fault) -> dict[str, object]:
    return {name: int(bit in value) for name, bit in FAULTS.items()}


def test_every_short_frame_is_described_and_no_other() -> None:
    constants = [
        v for v in vars(messages).values() if type(v) is int and v and v & 0x1FFFFF == 0
    ]  # a standard identifier alone
    assert len(constants) == 8
    reporting = []
    for node in Node:
        try:
            messages.unpack_sysstat(node, bytes(8))
            reporting.append(messages.sysstat_arb(node))
        except FormatError:
            pass  # its status is longer than a frame, or it has none
    described = {(m.frame_id, m.is_extended_frame) for m in DBC.messages}
    assert described == {(identifier(arb), bool(arb & CAN_IDE)) for arb in constants + reporting}


@pytest.mark.parametrize(
    ("name", "arb"),
    [
        ("Time", messages.TIME_FRAME),
        ("Shutdown", messages.SHUTDOWN),
        ("ShutdownAcknowledge", messages.SHUTDOWN_ACKNOWLEDGE),
        ("PropellerStarboardCommand", messages.PROPELLER_STARBOARD),
        ("PropellerPortCommand", messages.PROPELLER_PORT),
        ("BatteriesStarboardCommand", messages.BATTERIES_STARBOARD),
        ("BatteriesPortCommand", messages.BATTERIES_PORT),
        ("PropellerStarboardStatus", messages.sysstat_arb(Node.PROPELLER_STARBOARD)),
        ("PropellerPortStatus", messages.sysstat_arb(Node.PROPELLER_PORT)),
        ("BatteriesStarboardStatus", messages.sysstat_arb(Node.BATTERIES_STARBOARD)),
        ("BatteriesPortStatus", messages.sysstat_arb(Node.BATTERIES_PORT)),
    ],
)
def test_names_stand_at_their_identifiers(name: str, arb: int) -> None:
    assert DBC.get_message_by_name(name).frame_id == identifier(arb)


@given(st.sampled_from(SIDES), st.integers(-32766, 32766), st.booleans(), counter)
def test_propeller_command(side: str, rpm: int, run: bool, count: int) -> None:
    command = messages.PropellerCommand(rpm, run, count)
    data = messages.pack_propeller_command(command)
    check(f"Propeller{side}Command", data, {"Rpm": rpm, "Run": "run" if run else "motor off", "Counter": count})
    assert messages.unpack_propeller_command(data) == command


@given(st.sampled_from(SIDES), st.booleans(), counter)
def test_batteries_command(side: str, connected: bool, count: int) -> None:
    command = messages.BatteriesCommand(connected, count)
    data = messages.pack_batteries_command(command)
    check(f"Batteries{side}Command", data, {"Connected": "closed" if connected else "open", "Counter": count})
    assert messages.unpack_batteries_command(data) == command


@given(st.integers(0, 2**64 - 1))
def test_time(utc_ns: int) -> None:
    assert DBC.get_message_by_name("Time").decode(messages.TIME.pack(utc_ns)) == {"Utc": utc_ns}
    assert DBC.get_message_by_name("Time").encode({"Utc": utc_ns}) == messages.TIME.pack(utc_ns)


@given(st.booleans())
def test_shutdown(reboot: bool) -> None:
    data = messages.pack_shutdown(messages.Shutdown(reboot))
    check("Shutdown", data, {"Key": messages.SHUTDOWN_KEY, "Reboot": "reboot" if reboot else "power off"})
    assert messages.unpack_shutdown(data) == messages.Shutdown(reboot)


@given(st.sampled_from(messages.ShutdownStage), counter)
def test_shutdown_acknowledge(stage: messages.ShutdownStage, holders: int) -> None:
    acknowledge = messages.ShutdownAcknowledge(stage, holders)
    data = messages.pack_shutdown_acknowledge(acknowledge)
    check("ShutdownAcknowledge", data, {"Stage": stage.name.lower(), "Holders": holders})
    assert messages.unpack_shutdown_acknowledge(data) == acknowledge


@given(
    st.sampled_from(SIDES),
    st.builds(PropellerStatus, status, fault, st.none() | st.integers(-32766, 32766), tenths, temperature, counter),
)
def test_propeller_status(side: str, s: PropellerStatus) -> None:
    data = messages.pack_propeller_status(s)
    signals = {"Status": s.status.name.lower(), "Rpm": s.rpm, "Current": s.current_a, "Temperature": s.temperature_c}
    check(f"Propeller{side}Status", data, {**signals, **faults(s.faults), "Counter": s.counter})
    assert messages.unpack_sysstat(Node.PROPELLER_PORT, data) == s


@given(
    st.sampled_from(SIDES),
    st.builds(
        BatteriesStatus,
        status,
        fault,
        st.none() | st.integers(0, 65534).map(lambda i: i / 100),
        tenths,
        st.none() | st.integers(0, 200).map(lambda i: i / 200),
        temperature,
    ),
)
def test_batteries_status(side: str, s: BatteriesStatus) -> None:
    data = messages.pack_batteries_status(s)
    percent = None if s.charge is None else s.charge * 100
    signals = {"Status": s.status.name.lower(), "Voltage": s.voltage_v, "Current": s.current_a, "Charge": percent}
    check(f"Batteries{side}Status", data, {**signals, **faults(s.faults), "Temperature": s.temperature_c})
    assert messages.unpack_sysstat(Node.BATTERIES_PORT, data) == s


def test_every_physical_signal_has_a_unit_and_every_signal_a_range() -> None:
    for message in DBC.messages:
        for signal in message.signals:
            assert signal.minimum is not None, f"{message.name}.{signal.name}"
            assert signal.maximum is not None, f"{message.name}.{signal.name}"
            plain = signal.length == 1 or signal.name in ("Status", "Counter", "Key", "Node", "Word", "Stage", "Holders")
            assert bool(signal.unit) != plain, f"{message.name}.{signal.name}"
