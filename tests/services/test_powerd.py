"""What powerd makes of frames, button and batteries; and the service on a bus, with and without a supervisor."""

import os
import random
import signal
import socket
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim import config
from delfim.base.clock import ManualClock, SystemClock
from delfim.base.frames import CAN_ERR, CAN_IDE, CAN_RTR, Frame
from delfim.canproxy.dsor import messages
from delfim.canproxy.dsor.messages import BatteriesStatus, Fault, Node, PropellerCommand, Shutdown, ShutdownStage, Status
from delfim.canproxy.opening import open_can
from delfim.canproxy.socket import CanAddress
from delfim.services import powerd
from delfim.services.powerd import EV_KEY, INPUT_EVENT, KEY_POWER, Button, Powerd
from delfim.services.runtime import LoadedService, Runtime
from delfim.services.supervision import shutdown
from delfim.services.tables import PowerdTable

OFF = Frame(messages.SHUTDOWN, messages.pack_shutdown(Shutdown(False)))
REBOOT = Frame(messages.SHUTDOWN, messages.pack_shutdown(Shutdown(True)))
DRIVEN = Frame(messages.PROPELLER_PORT, messages.pack_propeller_command(PropellerCommand(100, True, 0)))
IDLE = Frame(messages.PROPELLER_PORT, messages.pack_propeller_command(PropellerCommand(0, False, 0)))


def batteries(charge: float | None, node: Node = Node.BATTERIES_PORT) -> Frame:
    status = BatteriesStatus(Status.GOOD, Fault(0), 48.0, 1.0, charge, 20)
    return Frame(messages.sysstat_arb(node), messages.pack_batteries_status(status))


class Boat:
    """powerd and a clock."""

    def __init__(self, **settings: object) -> None:
        self.clock = ManualClock()
        self.powerd = Powerd(PowerdTable(**settings), self.clock)  # type: ignore[arg-type]

    def goes_on(self, seconds: float, *frames: Frame) -> str:
        """These frames each second for so long. Returns why the power is to be cut, or nothing."""
        for _ in range(round(seconds)):
            for frame in frames:
                self.powerd.on_frame(frame)
            self.powerd.look()
            self.clock.advance(1.0)
        self.powerd.look()
        return self.powerd.reason


@pytest.mark.parametrize(("frame", "order"), [(OFF, "off"), (REBOOT, "reboot")])
def test_the_shutdown_frame_is_obeyed(frame: Frame, order: str) -> None:
    boat = Boat()
    boat.powerd.on_frame(frame)
    assert (boat.powerd.order, boat.powerd.reason) == (order, "shutdown frame")


def test_the_first_order_counts() -> None:
    boat = Boat()
    boat.powerd.on_frame(OFF)
    boat.powerd.on_frame(REBOOT)
    assert boat.powerd.order == "off"


@given(st.sampled_from([OFF.arb, IDLE.arb, batteries(1.0).arb]), st.binary(max_size=8))
def test_no_other_bytes_end_a_voyage(arb: int, data: bytes) -> None:
    boat = Boat()
    boat.powerd.on_frame(Frame(arb, data))
    assert boat.powerd.order is None


def test_malformed_orders_are_counted() -> None:
    boat = Boat()
    boat.powerd.on_frame(Frame(messages.SHUTDOWN, b"\0" * 5))
    assert boat.powerd.report()["malformed"] == 1


def test_empty_batteries_end_a_boat_that_nobody_drives() -> None:
    boat = Boat(battery_s=10.0)
    assert boat.goes_on(9, IDLE, batteries(0.05)) == ""
    assert boat.goes_on(2, IDLE, batteries(0.05)) == "batteries at 5%"


def test_nobody_takes_the_boat_from_who_drives_it_by_its_last_charge() -> None:
    boat = Boat(battery_s=10.0)
    assert boat.goes_on(60, DRIVEN, batteries(0.01)) == ""
    assert boat.goes_on(12, IDLE, batteries(0.01)) == "batteries at 1%"


@pytest.mark.parametrize(
    "frames",
    [
        (batteries(0.055),),
        (batteries(None),),
        (),
    ],
    ids=["enough", "unknown", "silent"],
)
def test_batteries_that_do_not_say_that_they_are_empty_end_nothing(frames: tuple[Frame, ...]) -> None:
    boat = Boat(battery_s=10.0)
    boat.powerd.on_frame(batteries(0.01))
    assert boat.goes_on(60, IDLE, *frames) == ""


def test_either_side_is_enough() -> None:
    boat = Boat(battery_s=10.0)
    assert boat.goes_on(12, batteries(0.9), batteries(0.0, Node.BATTERIES_STARBOARD)) == "batteries at 0%"


def test_batteries_that_recover_begin_anew() -> None:
    boat = Boat(battery_s=10.0)
    assert boat.goes_on(8, batteries(0.05)) == ""
    assert boat.goes_on(1, batteries(0.06)) == ""
    assert boat.goes_on(8, batteries(0.05)) == ""


def test_a_level_of_zero_is_none() -> None:
    assert Boat(battery_s=10.0, battery_charge=0.0).goes_on(60, batteries(0.0)) == ""


def test_a_button_must_be_held(tmp_path: Path) -> None:
    value = tmp_path / "value"
    boat = Boat(button=str(value), button_s=2.0)
    for text, reason in (("0\n", ""), ("1\n", ""), ("0\n", ""), ("1\n", ""), ("1\n", ""), ("1\n", "button")):
        value.write_text(text)
        boat.powerd.look()
        assert boat.powerd.reason == reason
        boat.clock.advance(1.0)


def test_a_button_that_is_missing_is_told_and_tried_again(tmp_path: Path) -> None:
    button = Button(str(tmp_path / "value"), "1")
    assert not button.pressed()
    assert button.reason == "No such file or directory"
    (tmp_path / "value").write_text("1")
    assert button.pressed()
    assert button.reason == ""
    button.close()


def test_the_key_of_an_input_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "event0")
    button = Button(str(tmp_path / "event0"), "1")
    monkeypatch.setattr(button, "_is_device", True)
    assert not button.pressed()
    with (tmp_path / "event0").open("wb", buffering=0) as keyboard:
        other = INPUT_EVENT.pack(0, 0, EV_KEY, KEY_POWER + 1, 1)
        keyboard.write(other)
        assert not button.pressed()
        keyboard.write(INPUT_EVENT.pack(0, 0, EV_KEY, KEY_POWER, 1) + other)
        assert button.pressed()
        assert button.pressed(), "until it is released"
        keyboard.write(INPUT_EVENT.pack(0, 0, EV_KEY, KEY_POWER, 0))
        assert not button.pressed()
    button.close()


def test_input_events_are_as_long_as_the_kernel_makes_them() -> None:
    assert INPUT_EVENT.size == 2 * struct.calcsize("l") + 8


# The service.


def sail(tmp_path: Path, order: Frame, *, supervised: bool) -> tuple[int, bytes, list[bytes]]:
    """Run powerd on a bus on which the order is given. Returns exit code, request, and the acknowledges."""
    bus = f"canloop:powerd-{os.getpid()}-{tmp_path.name[-10:]}"
    settings = config.load(
        Path(__file__).parents[2] / "etc/delfimx.toml",
        [f'can.interface="{bus}"', f'runtime.run_directory="{tmp_path}"'],
    )
    runtime = Runtime(settings, SystemClock(), alone=True)
    with open_can(bus) as board, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        if supervised:
            supervisor.bind(str(shutdown.socket_path(tmp_path)))
        board.bind(CanAddress(messages.SHUTDOWN_ACKNOWLEDGE))
        board.settimeout(200.0)

        async def tell(runtime: Runtime) -> None:
            while "powerd" not in runtime.board:
                await powerd.asyncio.sleep(0)
            board.sendmsg(order)
            board.sendmsg(order)
            if supervised:
                supervisor.setblocking(False)
                told.append(await powerd.asyncio.get_running_loop().sock_recv(supervisor, 100))
                os.kill(os.getpid(), signal.SIGTERM)

        told: list[bytes] = []
        code = runtime.main([LoadedService("powerd", powerd.serve), LoadedService("power board", tell)])
        return code, b"".join(told), [board.recvmsg().data for _ in range(2)]


@pytest.mark.parametrize(("order", "asked"), [(OFF, b"off shutdown frame"), (REBOOT, b"reboot shutdown frame")])
def test_the_supervisor_is_asked_once_and_each_order_acknowledged(tmp_path: Path, order: Frame, asked: bytes) -> None:
    code, request, acknowledges = sail(tmp_path, order, supervised=True)
    assert (code, request) == (0, asked)
    assert acknowledges == [bytes([ShutdownStage.BEGUN, 0])] * 2


def test_without_supervisor_the_boat_is_stopped(tmp_path: Path) -> None:
    code, _, _ = sail(tmp_path, OFF, supervised=False)
    assert code == 0


def test_two_thousand_frames_of_a_flood_end_no_voyage_and_are_counted() -> None:
    """Orders with a byte changed, too short or too long, as extended, remote and error frames, and of other nodes."""
    chance, boat, kinds = random.Random(1), Boat(), (0, CAN_IDE, CAN_RTR, CAN_ERR)
    whole = (OFF, REBOOT, DRIVEN, IDLE, batteries(1.0), batteries(0.9, Node.BATTERIES_STARBOARD))
    for number in range(2000):
        frame = whole[number % len(whole)]
        data = bytearray(frame.data)
        match number // len(whole) % 4:
            case 0:
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
            case 1:
                del data[chance.randrange(len(data)) :]
            case 2:
                data += chance.randbytes(chance.randrange(1, 57))
            case 3:
                data = bytearray(chance.randbytes(8))
        mutated = Frame(frame.arb | kinds[number % len(kinds)], bytes(data))
        if not mutated.data.startswith(OFF.data[:4]):  # that is an order
            boat.powerd.on_frame(mutated)
            assert boat.powerd.order is None, mutated
        boat.clock.advance(0.001)
        boat.powerd.look()
    assert boat.powerd.order is None, boat.powerd.reason
    boat.powerd.on_frame(OFF)
    assert boat.powerd.order == "off"
