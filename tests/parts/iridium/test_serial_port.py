"""The service as the boat runs it: a process at a serial port, with the played modem behind it; the vehicle is played, too."""

import os
import select
import signal
import socket
import subprocess
import sys
import tty
from pathlib import Path

import pytest

from delfim.base.clock import SystemClock
from delfim.base.input.keys import new_key, read_key
from delfim.parts.iridium import orders
from delfim.parts.mavlink.codec import ownorders, wire
from delfim.parts.mavlink.codec.signing import Signing
from delfim.parts.mavlink.codec.wire import dialect
from tests.parts.iridium.played import PlayedModem

pytestmark = [pytest.mark.long, pytest.mark.timeout(200)]  # half a minute until its first session
BOAT = 1


class Door:
    """The vehicle's door for consoles: it tells a report when it is asked, and obeys every order."""

    def __init__(self, key: bytes) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.obeyed: list[bytes] = []
        self.kinds = set[str]()
        self._pack = wire.Sender(BOAT, 1, key, Signing(key, SystemClock()).stamp).pack

    def hear(self) -> None:
        datagram, address = self.socket.recvfrom(2048)
        for frame in wire.frames(datagram)[0]:
            message = wire.decode(frame)
            assert message is not None
            self.kinds.add(message.get_type())
            if message.get_type() == "COMMAND_LONG":
                zeros = dict.fromkeys(dialect.MAVLink_high_latency2_message.fieldnames, 0)
                told = dialect.MAVLink_high_latency2_message(**zeros | {"latitude": 386_900_000, "longitude": -92_150_000})
                self.socket.sendto(self._pack(told), address)
            elif message.get_type() == "V2_EXTENSION" and message.message_type == ownorders.ORDER:
                number, words = ownorders.numbered(message)
                self.obeyed.append(words)
                self.socket.sendto(self._pack(ownorders.answer((orders.SATELLITE, orders.COMPONENT), number, "")), address)


def test_the_service_meets_a_modem_at_a_serial_port(tmp_path: Path) -> None:
    """A report goes out, an order comes in and is handed to the vehicle, its answer goes out at once; it ends in order."""
    new_key(tmp_path / "key")
    key = read_key(tmp_path / "key")
    modem, door = PlayedModem(), Door(key)
    modem.waiting = [orders.sealed(orders.WORDS["hold"], BOAT, 77, Signing(key, SystemClock()))]
    end, port = os.openpty()
    tty.setraw(port)
    file = tmp_path / "boat.toml"
    file.write_text(
        f'[boat]\nname = "a"\nid = {BOAT}\n[mavlink]\nkey = "{tmp_path}/key"\nlisten = "127.0.0.1:{door.port}"\n'
        f'[iridium]\ndevice = "{os.ttyname(port)}"\n[log]\ndirectory = "{tmp_path}"\n[runtime]\nrun_directory = "{tmp_path}"\n'
    )
    words = ["-m", "delfim", "run", str(file), "--service", "iridiumd"]
    with subprocess.Popen([sys.executable, "-P", *words], stderr=subprocess.PIPE) as process:
        while len(modem.out) < 2 and process.poll() is None:
            for fd in select.select([end, door.socket], [], [], 1.0)[0]:
                if fd is end:
                    os.write(end, modem.write(os.read(end, 4096)))
                else:
                    door.hear()
        process.send_signal(signal.SIGTERM)
        said = process.communicate(timeout=100)[1].decode()
        assert process.returncode == 0, said
    os.close(end)
    os.close(port)
    door.socket.close()
    first, second = ([wire.decode(frame) for frame in wire.frames(message)[0]] for message in modem.out)
    assert [each and each.get_type() for each in first] == ["HIGH_LATENCY2"]
    assert [each and each.get_type() for each in second] == ["HIGH_LATENCY2", "V2_EXTENSION"]
    assert second[1] is not None
    assert ownorders.numbered(second[1]) == (77, b"")
    assert len(door.obeyed) == 1
    assert "HEARTBEAT" in door.kinds, "since a session succeeded, somebody watches"
