"""What is sent to a browser's push service: the message, encrypted for that browser alone (RFC 8291, aes128gcm of RFC 8188),
and the word by which the service knows who sends it (VAPID, RFC 8292). No socket in here."""

import base64
import binascii
import json
import os
import re
import struct
from typing import TYPE_CHECKING, Annotated, Final
from urllib.parse import urlsplit

import msgspec

from delfim.base.errors import FormatError

if TYPE_CHECKING:  # asyncssh brings it; a console without a subscription does without
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey, EllipticCurvePublicKey

PLAIN_MAX: Final = 3000  # bytes of a message: services take 4096 with all that is around
RECORD: Final = 4096
LIFE_S: Final = 12 * 3600  # of a word for a service, which may last for a day
_NAME: Final = re.compile(r"[a-z0-9-]{1,63}(\.[a-z0-9-]{1,63})+", re.ASCII)  # another cannot be looked up
Coded = Annotated[str, msgspec.Meta(max_length=100)]  # bytes as base64url


class PushKeys(msgspec.Struct, frozen=True):
    p256dh: Coded  # the browser's public key
    auth: Coded  # its secret


class PushSubscription(msgspec.Struct, frozen=True):
    """As a browser gives it (W3C Push API). `by`: whose page asked for it, of consoles with operators."""

    endpoint: Annotated[str, msgspec.Meta(max_length=1024)]
    keys: PushKeys
    by: Annotated[str, msgspec.Meta(max_length=64)] = ""

    def check(self) -> None:
        """Raises FormatError for what no browser gives, and for an endpoint that is not at a public name by HTTPS."""
        try:
            place = urlsplit(self.endpoint)
            host, port = place.hostname or "", place.port
        except ValueError:
            raise FormatError("endpoint: not an address") from None
        is_name = _NAME.fullmatch(host) and not host.replace(".", "").isdigit()
        if place.scheme != "https" or port not in (None, 443) or not is_name or place.username is not None:
            raise FormatError("endpoint: only https at a public name")
        if len(decoded(self.keys.auth)) != 16:
            raise FormatError("auth: not 16 bytes")
        public_key(self.keys.p256dh)


def coded(data: bytes) -> str:
    """Base64url without padding."""
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def decoded(text: str) -> bytes:
    """Raises FormatError."""
    try:
        return base64.b64decode(text.rstrip("=") + "=" * (-len(text.rstrip("=")) % 4), altchars=b"-_", validate=True)
    except (binascii.Error, ValueError):
        raise FormatError("not base64url") from None


def public_key(text: str) -> "EllipticCurvePublicKey":
    """A point on P-256, uncompressed. Raises FormatError."""
    from cryptography.hazmat.primitives.asymmetric import ec

    try:
        return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), decoded(text))
    except ValueError:
        raise FormatError("p256dh: no point of P-256") from None


def private_key(text: str = "") -> "EllipticCurvePrivateKey":
    """The key of this number, or a new one. Raises FormatError."""
    from cryptography.hazmat.primitives.asymmetric import ec

    if not text:
        return ec.generate_private_key(ec.SECP256R1())
    try:
        return ec.derive_private_key(int.from_bytes(decoded(text)), ec.SECP256R1())
    except ValueError:
        raise FormatError("no key of P-256") from None


def number_of(key: "EllipticCurvePrivateKey") -> str:
    return coded(key.private_numbers().private_value.to_bytes(32))


def point_of(key: "EllipticCurvePublicKey") -> bytes:
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    return key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)


def encrypted(message: bytes, keys: PushKeys, own: "EllipticCurvePrivateKey | None" = None, salt: bytes | None = None) -> bytes:
    """The body for the service. `own` and `salt` are drawn anew for each message. Raises FormatError."""
    from cryptography.hazmat.primitives.asymmetric.ec import ECDH
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM

    if len(message) > PLAIN_MAX:
        raise FormatError(f"a message of {len(message)} bytes, more than {PLAIN_MAX}")
    own, salt, theirs = own or private_key(), salt or os.urandom(16), public_key(keys.p256dh)
    sender = point_of(own.public_key())
    shared = _derived(own.exchange(ECDH(), theirs), decoded(keys.auth), b"WebPush: info\0" + point_of(theirs) + sender, 32)
    key = _derived(shared, salt, b"Content-Encoding: aes128gcm\0", 16)
    nonce = _derived(shared, salt, b"Content-Encoding: nonce\0", 12)
    header = salt + struct.pack(">IB", RECORD, len(sender)) + sender
    return header + AESGCM(key).encrypt(nonce, message + b"\2", None)  # 2: the last record, without padding


def _derived(secret: bytes, salt: bytes, info: bytes, length: int) -> bytes:
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.hazmat.primitives.kdf.hkdf import HKDF

    return HKDF(SHA256(), length, salt, info).derive(secret)


def authorization(key: "EllipticCurvePrivateKey", endpoint: str, contact: str, now_s: float) -> str:
    """The header by which a service knows this sender again. `contact`: mailto: or https:, which some services ask for."""
    from cryptography.hazmat.primitives.asymmetric.ec import ECDSA
    from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature
    from cryptography.hazmat.primitives.hashes import SHA256

    claims = {"aud": f"https://{urlsplit(endpoint).netloc}", "exp": int(now_s) + LIFE_S} | ({"sub": contact} if contact else {})
    words = ".".join(coded(json.dumps(each).encode()) for each in ({"typ": "JWT", "alg": "ES256"}, claims))
    r, s = decode_dss_signature(key.sign(words.encode(), ECDSA(SHA256())))
    return f"vapid t={words}.{coded(r.to_bytes(32) + s.to_bytes(32))}, k={coded(point_of(key.public_key()))}"
