"""Connection limits: connections counted by address, delays after wrong passwords, passwords kept as hashes.

httpd, ftpd and sshd share this. All tables are bounded.
"""

import base64
import binascii
import hashlib
import hmac
import os
import socket
from collections import Counter, OrderedDict
from typing import Final

from delfim.base.errors import FormatError

IPTOS_THROUGHPUT: Final = 0x08  # after the console's packets on the radio (thesis 2.11)
UNSENT_BYTES: Final = 32 << 10  # in the kernel: new data must not wait behind old
PAUSE_S: Final = 1.0  # after the first wrong word; doubles with each
PAUSE_MAX_S: Final = 30.0
FORGIVEN_S: Final = 600.0  # without a wrong word
ADDRESSES_MAX: Final = 1000
SCRYPT: Final = {"n": 1 << 14, "r": 8, "p": 1, "dklen": 32}  # RFC 7914; 16 MiB and some 50 ms


class ConnectionLimits:
    """Connections that are open, and those that were refused."""

    def __init__(self, connections: int, connections_per_address: int) -> None:
        self._connections, self._per_address = connections, connections_per_address
        self.inside: Counter[str] = Counter()
        self.refused = 0

    def enter(self, address: str) -> bool:
        if self.inside.total() >= self._connections or self.inside[address] >= self._per_address:
            self.refused += 1
            return False
        self.inside[address] += 1
        return True

    def leave(self, address: str) -> None:
        self.inside[address] -= 1
        if not self.inside[address]:
            del self.inside[address]


class Patience:
    """The delay of an address until its next password is checked. Times are monotonic."""

    def __init__(self) -> None:
        self._failures: OrderedDict[str, tuple[int, float]] = OrderedDict()
        self.failures = 0  # altogether

    def failed(self, address: str, now_s: float) -> None:
        count, at_s = self._failures.pop(address, (0, now_s))
        self._failures[address] = (1 if now_s - at_s > FORGIVEN_S else count + 1), now_s
        if len(self._failures) > ADDRESSES_MAX:
            self._failures.popitem(last=False)
        self.failures += 1

    def succeeded(self, address: str) -> None:
        self._failures.pop(address, None)

    def pause_s(self, address: str, now_s: float) -> float:
        count, at_s = self._failures.get(address, (0, now_s))
        if not count:
            return 0.0
        return max(at_s + min(PAUSE_S * 2.0 ** (count - 1), PAUSE_MAX_S) - now_s, 0.0)


def hashed(password: str, salt: bytes | None = None) -> str:
    """Hash a password for a vehicle's file. Takes some 50 ms."""
    salt = os.urandom(16) if salt is None else salt
    digest = hashlib.scrypt(password.encode("utf-8", "surrogateescape"), salt=salt, **SCRYPT)
    return f"scrypt:{base64.b64encode(salt).decode()}:{base64.b64encode(digest).decode()}"


def matches(password: str, kept: str) -> bool:
    """Whether a password matches its hash. Takes some 50 ms, right or wrong. Raises FormatError where `kept` was not made by
    `hashed`."""
    try:
        method, salt, _ = kept.split(":")
        if method != "scrypt":
            raise ValueError
        return hmac.compare_digest(hashed(password, base64.b64decode(salt, validate=True)), kept)
    except (ValueError, binascii.Error):
        raise FormatError("this is not a password from `delfim password`") from None


def bulk(link: socket.socket, stall_s: float) -> None:
    """Set the options of a connection that carries much: behind the console, little in the kernel, closed if nobody reads."""
    link.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, IPTOS_THROUGHPUT)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000 * stall_s))
