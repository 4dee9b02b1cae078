"""A DroneCAN node with parameters and a boot loader, played by pydronecan.

    python -m tests.dronecan_device INTERFACE [frames of which one is lost, 0 for none]

Its bus can lose frames, it can fall silent, and it can find that its new program is none.
"""

import contextlib
import signal
import sys
import threading
import time
from typing import Any

import dronecan
from dronecan import uavcan
from dronecan.node import Node
from dronecan.transport import TransferError

from delfim.base.frames import Frame
from delfim.canproxy.dronecan.datatypes import ARMING_STATUS, OFF, ON, RAW_COMMAND, raw_command
from delfim.canproxy.dronecan.transfers import COMMAND, Publisher
from tests.esc_pair import Bus

NUMBER, BOAT, NAME = 42, 10, "org.example.esc"
PARAM = uavcan.protocol.param
STATUS = uavcan.protocol.NodeStatus()
AGAIN_S = 0.2  # after which it asks again for a piece that did not come


class LossyBus(Bus):
    """Loses each frame of these numbers, both ways: every `each`-th."""

    def __init__(self, interface: str) -> None:
        super().__init__(interface)
        self.each, self._count, self.lost = 0, 0, 0

    def _is_lost(self) -> bool:
        self._count += 1
        is_lost = bool(self.each) and self._count % self.each == 0
        self.lost += is_lost
        return is_lost

    def receive(self, timeout: float | None = None) -> Any:
        frame = super().receive(timeout)
        return None if frame is None or self._is_lost() else frame

    def send_frame(self, frame: Any) -> None:
        if not self._is_lost():
            super().send_frame(frame)


class Device:
    """A node in a thread of its own. `says` is what a boat says on its bus meanwhile: "", "idle" or "armed"."""

    def __init__(self, interface: str) -> None:
        info = uavcan.protocol.GetNodeInfo.Response(name=NAME)
        info.software_version.major = 1
        self.bus = LossyBus(interface)
        self.node = Node(self.bus, node_id=NUMBER, node_info=info)
        self.node.mode = STATUS.MODE_OPERATIONAL
        self.values: dict[str, Any] = {"ESC_INDEX": 0, "KP": 0.25, "BI_DIRECTIONAL": False, "NAME": "esc"}
        self.saved: dict[str, Any] | None = None
        self.fetched, self.path, self.says = b"", "", ""
        self.begins = 0  # the error by which it refuses an update
        self.silent_at = -1  # bytes of a new program, after which it says nothing any more
        self.wants_sound = self.is_silent = False
        self.is_mute = False  # the answer with which it begins an update gets lost, and it begins no second one
        self.restarts = 0
        self._update = 0
        for kind, answer in (
            (PARAM.GetSet, self._get_set),
            (PARAM.ExecuteOpcode, self._execute),
            (uavcan.protocol.RestartNode, self._restart),
            (uavcan.protocol.file.BeginFirmwareUpdate, self._begin),
        ):
            self.node.add_handler(kind, answer)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._arming, self._raw = (Publisher(kind, BOAT, COMMAND) for kind in (ARMING_STATUS, RAW_COMMAND))
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.node.close()

    def join(self) -> None:
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            if self.is_silent:
                self._stop.wait(0.05)
                continue
            if self.says:
                told = self._arming.frames(ON if self.says == "armed" else OFF) + self._raw.frames(raw_command([0.0]))
                for arb, data in told:
                    self.bus.can.sendmsg(Frame(arb, data))
            with contextlib.suppress(TransferError, ValueError):  # raised on what a device ignores: a transfer without a frame
                self.node.spin(0.01)

    def _get_set(self, event: Any) -> Any:
        name = event.request.name.decode()
        index = event.request.index
        if not name and index < len(self.values):
            name = list(self.values)[index]
        answer = PARAM.GetSet.Response()
        if name not in self.values:
            return answer
        asked = event.request.value
        kind = dronecan.get_active_union_field(asked)
        if kind != "empty":
            value = getattr(asked, kind)
            value = value.decode() if kind == "string_value" else bool(value) if kind == "boolean_value" else value
            if name != "KP" or value <= 1.0:
                self.values[name] = value
        value = self.values[name]
        fields = {bool: "boolean_value", int: "integer_value", float: "real_value", str: "string_value"}
        setattr(answer.value, fields[type(value)], value)
        if name == "ESC_INDEX":
            answer.min_value.integer_value, answer.max_value.integer_value = 0, 31
        answer.name = name
        return answer

    def _execute(self, event: Any) -> Any:
        self.saved = dict(self.values) if event.request.opcode == event.request.OPCODE_SAVE else None
        return PARAM.ExecuteOpcode.Response(ok=True)

    def _restart(self, event: Any) -> Any:
        is_meant = event.request.magic_number == event.request.MAGIC_NUMBER
        self.restarts += is_meant
        self.node.start_time_monotonic = time.monotonic()
        return uavcan.protocol.RestartNode.Response(ok=is_meant)

    def _begin(self, event: Any) -> Any:
        answer = uavcan.protocol.file.BeginFirmwareUpdate.Response(error=self.begins)
        if self.begins:
            return answer
        if self.is_mute and self._update:
            answer.error = answer.ERROR_IN_PROGRESS
            return answer
        self.node.mode, self.node.health = STATUS.MODE_SOFTWARE_UPDATE, STATUS.HEALTH_OK
        self.path, self.fetched = event.request.image_file_remote_path.path.decode(), b""
        self._update += 1
        self._fetch(event.request.source_node_id, self._update)
        return None if self.is_mute else answer

    def _fetch(self, server: int, update: int) -> None:
        """As a boot loader does: again where no answer came, and the next piece until one is short."""
        asked = uavcan.protocol.file.Read.Request(offset=len(self.fetched))
        asked.path.path = self.path

        def came(event: Any) -> None:
            if update != self._update:  # it was told to begin anew
                return
            if event is not None:
                data = bytes(event.response.data)
                self.fetched += data
                if 0 <= self.silent_at <= len(self.fetched):
                    self.is_silent = True
                    return
                if len(data) < 256:
                    self._end()
                    return
            self._fetch(server, update)

        self.node.request(asked, server, came, timeout=AGAIN_S)

    def _end(self) -> None:
        """It runs its new program, or stays in its boot loader where that is none: its first bytes must be `DELF`."""
        if self.wants_sound and self.fetched[:4] != b"DELF":
            self.node.mode, self.node.health = STATUS.MODE_MAINTENANCE, STATUS.HEALTH_CRITICAL
        else:
            self.node.mode, self.node.node_info.software_version.major = STATUS.MODE_OPERATIONAL, 2


def main() -> None:
    device = Device(sys.argv[1])
    device.bus.each = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    signal.signal(signal.SIGTERM, lambda *_: device._stop.set())
    print("there", flush=True)
    device.join()


if __name__ == "__main__":
    main()
