"""A played Iridium modem, by the AT Command Reference, and the gateway that keeps messages for it and from it."""

import re

from delfim.parts.iridium.modem import summed


class PlayedModem:
    """`write` takes what the boat writes, and returns what the modem says. It echoes until it is told not to."""

    def __init__(self) -> None:
        self.out: list[bytes] = []  # messages that reached the gateway
        self.waiting: list[bytes] = []  # messages that wait there for the boat
        self.has_network = self.is_alive = True
        self.damages = False  # the next message to the boat on the line
        self.rings = False
        self._echoes, self._buffer, self._heard = True, b"", b""
        self._inbox = b""
        self._expected = 0  # bytes of a message that is being written
        self._number = 0

    def write(self, data: bytes) -> bytes:
        if not self.is_alive:
            return b""
        self._heard += data
        said = b"SBDRING\r\n" if self.rings else b""
        while True:
            if self._expected:
                if len(self._heard) < self._expected:
                    return said
                message, self._heard = self._heard[: self._expected], self._heard[self._expected :]
                self._expected = 0
                is_whole = summed(message[:-2]) == message
                self._buffer = message[:-2] if is_whole else b""
                said += b"0\r\n\r\nOK\r\n" if is_whole else b"2\r\n\r\nOK\r\n"
            line, found, rest = self._heard.partition(b"\r")
            if not found:
                return said
            self._heard = rest
            said += (line + b"\r" if self._echoes else b"") + self._obey(line)

    def _obey(self, line: bytes) -> bytes:
        if line == b"ATE0":
            self._echoes = False
            return b"\r\nOK\r\n"
        if line == b"AT&K0":
            return b"\r\nOK\r\n"
        if line == b"AT+SBDD0":
            self._buffer = b""
            return b"\r\n0\r\n\r\nOK\r\n"
        if told := re.fullmatch(rb"AT\+SBDWB=(\d+)", line):
            if not 1 <= int(told[1]) <= 340:
                return b"\r\n3\r\n\r\nOK\r\n"
            self._expected = int(told[1]) + 2
            return b"\r\nREADY\r\n"
        if line == b"AT+SBDIX":
            return self._meet()
        if line == b"AT+SBDRB":
            message = summed(self._inbox)
            if self.damages:
                self.damages, message = False, message[:-1] + bytes((message[-1] ^ 1,))
            return len(self._inbox).to_bytes(2) + message + b"\r\nOK\r\n"
        return b"\r\nERROR\r\n"

    def _meet(self) -> bytes:
        if not self.has_network:
            return b"\r\n+SBDIX: 32, %d, 2, 0, 0, 0\r\n\r\nOK\r\n" % self._number
        if self._buffer:
            self.out.append(self._buffer)
            self._number += 1
        self._inbox = self.waiting.pop(0) if self.waiting else b""
        told = self._number, int(bool(self._inbox)), self._number, len(self._inbox), len(self.waiting)
        return b"\r\n+SBDIX: 0, %d, %d, %d, %d, %d\r\n\r\nOK\r\n" % told
