"""Keys, certificates and passwords that `delfim commission` makes for a boat. Nothing here asks, prints or writes."""

import datetime
import secrets
from collections.abc import Sequence
from ipaddress import ip_address
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.x509.oid import NameOID

VALID = datetime.timedelta(days=3650)


class SshKey(NamedTuple):
    """An ed25519 key as ssh-keygen writes it, without a passphrase."""

    private: str
    public: str  # one line, "ssh-ed25519 KEY COMMENT"


def ssh_key(comment: str) -> SshKey:
    key, plain = ed25519.Ed25519PrivateKey.generate(), serialization.NoEncryption()
    private = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.OpenSSH, plain)
    public = key.public_key().public_bytes(serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH)
    return SshKey(private.decode(), f"{public.decode()} {comment}")


def public_ssh_key(text: bytes) -> str:
    """The line of a .pub file, ed25519 or any other kind that sshd takes. Raises ValueError."""
    try:
        serialization.load_ssh_public_key(text)
    except UnsupportedAlgorithm as error:
        raise ValueError(str(error)) from None
    return " ".join(text.decode().split())


class Certificate(NamedTuple):
    """A certificate of a boat by itself, PEM, and its private key."""

    certificate: str
    key: str


def certificate(name: str, addresses: Sequence[str], now: datetime.datetime) -> Certificate:
    """Make a certificate for these IP addresses, valid from a day before now, for clocks that differ."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    names = [x509.DNSName(name.replace("_", "-")), *(x509.IPAddress(ip_address(each)) for each in addresses)]
    made = (
        x509.CertificateBuilder(subject, subject, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + VALID)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    plain = serialization.NoEncryption()
    secret = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
    return Certificate(made.public_bytes(serialization.Encoding.PEM).decode(), secret.decode())


def password() -> str:
    """Draw a password of 96 bits, in 16 letters and digits."""
    return secrets.token_urlsafe(12)
