"""Motors that are played, as their makers document them: no real one was at hand. Time is handed in."""

import struct

from pymavlink.dialects.v20 import ardupilotmega

from delfim.lines.nmea0183.framing import framed
from delfim.lines.nmea0183.proprietary import fields

NEVER = -1e9
VALUE = struct.Struct(">i")


FULL = {0: 0.95e5, 1: 20e3, 3: 1500.0 * 7}  # of a VESC's commands, as the tests' vehicle's file says it


class PlayedVesc:
    """A controller: duty, current or speed, electrical; released when it hears nothing for its time-out. `slip_rpm` is missing
    in what it reports."""

    def __init__(self, controller: int, timeout_s: float = 0.5) -> None:
        self.controller, self.timeout_s = controller, timeout_s
        self.heard_s, self.slip_rpm, self._effort = NEVER, 0.0, 0.0

    def hear(self, identifier: int, data: bytes, now_s: float) -> None:
        kind, controller = identifier >> 8, identifier & 0xFF
        if controller in (self.controller, 255) and kind in FULL and len(data) >= 4:
            self.heard_s, self._effort = now_s, VALUE.unpack_from(data)[0] / FULL[kind]

    def effort(self, now_s: float) -> float:
        """Of full command."""
        return self._effort if now_s - self.heard_s <= self.timeout_s else 0.0

    def status(self, now_s: float) -> list[tuple[int, bytes]]:
        """Status 1, 4 and 5: identifier, data. 31.4 degrees, 5.5 A out of the battery, 24.1 V."""
        rpm, duty = round(self.effort(now_s) * 10_500 - 7.0 * self.slip_rpm), round(self.effort(now_s) * 950)
        return [
            (9 << 8 | self.controller, struct.pack(">ihh", rpm, 120, duty)),
            (16 << 8 | self.controller, struct.pack(">hhhh", 314, -990, 55, 0)),
            (27 << 8 | self.controller, struct.pack(">ihh", 4200, 241, 0)),
        ]


class PlayedSeat:
    """An Otter or a Heron: it obeys PMARMAN for 3 s, and PYDIR for as long as it likes. `slip_rpm` is missing in what the
    starboard motor of the Otter reports."""

    def __init__(self, timeout_s: float) -> None:
        self.timeout_s, self.refused, self.slip_rpm, self.said = timeout_s, 0, 0.0, list[str]()
        self._heard_s, self._efforts, self._rest = NEVER, (0.0, 0.0), b""

    def hear(self, data: bytes, now_s: float) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            told = fields(line)
            if told is None:
                self.refused += 1
            elif told[0] == "PMARMAN":
                surge, _, yaw = map(float, told[1:])
                self._efforts = surge - yaw, surge + yaw
            elif told[0] == "PYDIR":
                port, starboard = map(float, told[1:])
                self._efforts = starboard / 100.0, port / 100.0
            elif told[0] == "PMARABT":
                self._efforts = 0.0, 0.0
            self.said += [told[0]] if told else []
            self._heard_s = now_s

    def efforts(self, now_s: float) -> tuple[float, float]:
        """Starboard and port, of full."""
        return self._efforts if now_s - self._heard_s <= self.timeout_s else (0.0, 0.0)

    def report(self, now_s: float) -> bytes:
        """What both boats say of their motors: revolutions, 1500 at full effort, 21 and 22 degrees, 15.2 V."""
        starboard, port = (round(1500.0 * each) for each in self.efforts(now_s))
        turns = f"PMAROTR,{port},{starboard - self.slip_rpm:.0f},22.0,21.0,50,60,110,2"
        return b"".join(map(framed, (turns, "PMARMOD,M,87", "CPRBS,134213.686,1,15.2,15.1,15.3,0")))


class PlayedTorqeedo:
    """A motor on TQ bus that obeys its master for half a second, and answers what it is asked: 1500 rpm at full effort, 24.1 V,
    5.5 A, windings of 31.4 degrees. `errors` are those that it tells, until it is told to forget them at rest."""

    def __init__(self, timeout_s: float = 0.5) -> None:
        self.timeout_s, self.errors, self.status, self.refused, self.told = timeout_s, 0, 0, 0, list[int]()
        self._heard_s, self._effort, self._rest = NEVER, 0.0, b""

    def hear(self, data: bytes, now_s: float) -> bytes:
        """What it answers."""
        *frames, self._rest = (self._rest + data).split(b"\xad")
        return b"".join(self._obey(self.plain(each), now_s) for each in frames)

    def effort(self, now_s: float) -> float:
        return self._effort if now_s - self._heard_s <= self.timeout_s else 0.0

    @property
    def stopped(self) -> bool:
        """Whether it was told so last."""
        return self._effort == 0.0

    def plain(self, frame: bytes) -> bytes:
        """Of a frame, without its last byte."""
        body, turned = bytearray(), 0
        for byte in frame[1:]:
            if byte == 0xAE:
                turned = 0x80
            else:
                body.append(byte ^ turned)
                turned = 0
        self.refused += frame[:1] != b"\xac" or self.crc(bytes(body)) != 0
        return bytes(body[:-1])

    def crc(self, data: bytes) -> int:
        """CRC-8/MAXIM by long division: each byte with its low bit first, polynomial 0x131. 0 over a whole message."""
        value = int("0" + "".join(f"{byte:08b}"[::-1] for byte in data), 2) << 8
        for bit in range(value.bit_length(), 8, -1):
            if value >> bit - 1 & 1:
                value ^= 0x131 << bit - 9
        return int(f"{value & 0xFF:08b}"[::-1], 2)

    def reply(self, data: bytes) -> bytes:
        body = b"\0\0" + data
        body += bytes((self.crc(body),))
        for byte in (b"\xae", b"\xac", b"\xad"):
            body = body.replace(byte, b"\xae" + bytes((byte[0] ^ 0x80,)))
        return b"\xac" + body + b"\xad"

    def _obey(self, body: bytes, now_s: float) -> bytes:
        self.told.append(body[1])
        if body[:2] == b"\x30\x82":
            _, _, flags, power, speed = struct.unpack(">BBBBh", body)
            self._heard_s, self._effort = now_s, speed / 1000.0 if flags & 1 and power else 0.0
            self.errors = 0 if flags & 4 else self.errors
            return self.reply(b"")
        if body == b"\x30\x01":
            return self.reply(struct.pack(">BH", self.status, self.errors))
        rpm = round(1500.0 * self.effort(now_s))
        return self.reply(struct.pack(">hHHHhh", rpm, 132, 2410, 55, 250, 314)) if body == b"\x30\x03" else b""


class PlayedTorqlink:
    """A motor on its TorqLink bus, as ArduPilot's script drives one: it obeys while it is ready, for half a second after each
    command, and says ten times a second whether it is. `turned` has each way that it was told to turn, with the time."""

    def __init__(self, timeout_s: float = 0.5) -> None:
        self.timeout_s, self.ready, self.turned = timeout_s, True, list[tuple[int, float]]()
        self.heard_s, self._speed, self._gear = NEVER, 0, 125

    def hear(self, identifier: int, data: bytes, now_s: float) -> None:
        if identifier == 0x0CF003D0:
            assert (len(data), min(data[1], 250)) == (8, data[1]), data.hex()
            self._speed = data[1]
        elif identifier == 0x0CF005D0:
            assert (len(data), data[0] in (124, 125, 126)) == (8, True), data.hex()
            self.heard_s, self._gear = now_s, data[0]
            if not self.turned or self.turned[-1][0] != self._gear - 125:
                self.turned.append((self._gear - 125, now_s))

    def effort(self, now_s: float) -> float:
        return (self._gear - 125) * self._speed / 250.0 if self.ready and now_s - self.heard_s <= self.timeout_s else 0.0

    @property
    def stopped(self) -> bool:
        """Whether it was told so last."""
        return (self._gear, self._speed) == (125, 0)

    def status(self) -> tuple[int, bytes]:
        """Identifier and data."""
        return 0x18FF1350, bytes((1, 2, 3, 4, 0x80 if self.ready else 0x7F, 6, 7, 8))


class PlayedRover:
    """A board with ArduRover, armed and in MANUAL: it obeys its ground station 255 for 3 s, and mixes two sides."""

    autopilot, shift = 3, 0

    def __init__(self) -> None:
        self.mode, self.armed, self.heartbeats = 0, True, 0
        self._heard_s, self._efforts = NEVER, (0.0, 0.0)
        self._parser, self._own = ardupilotmega.MAVLink(None), ardupilotmega.MAVLink(None, 1, 1)
        self._parser.robust_parsing = True

    def hear(self, data: bytes, now_s: float) -> None:
        for message in self._parser.parse_buffer(data) or ():
            if message.get_srcSystem() == 255 and message.get_type() == "MANUAL_CONTROL" and message.target == 1:
                throttle, steering = message.z / 1000.0, message.y / 1000.0
                self._heard_s, self._efforts = now_s, (throttle - steering, throttle + steering)
            self.heartbeats += message.get_type() == "HEARTBEAT"

    def efforts(self, now_s: float) -> tuple[float, float]:
        """Starboard and port, of full."""
        obeys = self.armed and self.mode == 0 and now_s - self._heard_s <= 3.0
        return self._efforts if obeys else (0.0, 0.0)

    def report(self, now_s: float) -> bytes:
        """Heartbeat and battery: 15.2 V, 4.5 A."""
        flags = 0x40 | (0x80 if self.armed else 0)
        told = (
            ardupilotmega.MAVLink_heartbeat_message(11, self.autopilot, flags, self.mode << self.shift, 4, 3),
            ardupilotmega.MAVLink_attitude_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            ardupilotmega.MAVLink_sys_status_message(0, 0, 0, 0, 15_200, 450, 80, 0, 0, 0, 0, 0, 0),
        )
        return b"".join(each.pack(self._own) for each in told)


class PlayedPx4(PlayedRover):
    """A board with PX4 1.16, a differential rover, armed and in Manual: z is its throttle from 0, full astern, to 1000. Without
    a command for `timeout_s` it disarms (COM_RC_LOSS_T, NAV_RCL_ACT 6); by the gesture of the left stick, too."""

    autopilot, shift = 12, 16

    def __init__(self, version: tuple[int, int] = (1, 16), timeout_s: float = 0.5) -> None:
        super().__init__()
        self.mode, self.version, self.timeout_s, self._is_asked = 1, version, timeout_s, False

    def hear(self, data: bytes, now_s: float) -> None:
        self._pass(now_s)
        for message in self._parser.parse_buffer(data) or ():
            if message.get_type() == "MANUAL_CONTROL" and message.target in (0, 1):
                throttle = message.z / 500.0 - 1.0 if 0 <= message.z <= 1000 else 0.0
                steering = message.y / 1000.0
                self._heard_s, self._efforts = now_s, (throttle - steering, throttle + steering)
                if throttle < -0.8 and abs(message.r) > 900 and abs(message.y) < 100:
                    self.armed = False
            elif message.get_type() == "COMMAND_LONG":
                self._is_asked |= (message.command, message.param1) == (512, 148.0)
                self.armed &= (message.command, message.param1) != (400, 0.0)
            self.heartbeats += message.get_type() == "HEARTBEAT"

    def efforts(self, now_s: float) -> tuple[float, float]:
        self._pass(now_s)
        return self._efforts if self.armed and self.mode == 1 else (0.0, 0.0)

    def report(self, now_s: float) -> bytes:
        """Its version, too, once it was asked for it."""
        major, minor = self.version
        told = ardupilotmega.MAVLink_autopilot_version_message(
            0, major << 24 | minor << 16 | 0xFF, 0, 0, 0, *[[0] * 8] * 3, 0, 0, 0
        )
        return super().report(now_s) + (told.pack(self._own) if self._is_asked else b"")

    def _pass(self, now_s: float) -> None:
        if self._heard_s > NEVER and now_s - self._heard_s > self.timeout_s:
            self.armed, self._heard_s, self._efforts = False, NEVER, (0.0, 0.0)
