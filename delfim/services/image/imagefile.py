"""The boat's image as one file: an uncompressed tar archive of MEMBERS in this order. Its manifest names the digests of the
others and is signed as `ssh-keygen -Y sign` does.
"""

import base64
import binascii
import contextlib
import hashlib
import hmac
import os
import struct
import subprocess
import tarfile
from pathlib import Path
from typing import IO, Annotated, Final, Literal

import msgspec

from delfim.base.errors import FormatError, Refused
from delfim.base.input.unreadable import UNREADABLE

FORMAT: Final = 1
NAMESPACE: Final = "delfim-image"  # of the signature: one made for anything else is worth nothing here
PARTS: Final = ("vmlinuz", "initramfs.gz")
MANIFEST, SIGNATURE = "manifest.json", "manifest.json.sig"
MEMBERS: Final = (MANIFEST, SIGNATURE, *PARTS)
PAPER_BYTES: Final = 64 << 10  # of manifest and signature, at most
BLOCK_BYTES: Final = 1 << 20
END_BYTES: Final = 2 * tarfile.BLOCKSIZE + tarfile.RECORDSIZE  # of zeros: the archive's end, filled up to a whole record


class ImagePart(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A file of an image."""

    bytes: Annotated[int, msgspec.Meta(gt=0, le=1 << 30)]
    sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}\Z")]


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The manifest of an image. `format` is 1."""

    format: Literal[1]
    version: Annotated[str, msgspec.Meta(pattern=r"^[0-9A-Za-z][0-9A-Za-z.+_-]{0,63}\Z")]
    files: dict[str, ImagePart]


class SignedImage:
    """A verified manifest, and its signer."""

    def __init__(self, manifest: bytes, signature: bytes, signers: tuple[str, ...]) -> None:
        self.paper, self.signature = manifest, signature
        self.signer = verify_signature(manifest, signature, signers)
        self.manifest = parse_manifest(manifest)


def parse_manifest(text: bytes) -> Manifest:
    """Parse a manifest. Raises FormatError."""
    try:
        manifest = msgspec.json.decode(text, type=Manifest)
    except UNREADABLE as error:
        raise FormatError(f"{MANIFEST}: {error}") from None
    if set(manifest.files) != set(PARTS):
        raise FormatError(f"{MANIFEST}: it must name {' and '.join(PARTS)}, and nothing else")
    return manifest


def verify_signature(message: bytes, armoured: bytes, signers: tuple[str, ...]) -> str:
    """Verify a signature; returns the signer (of these public keys, as ssh-keygen writes them). Format: PROTOCOL.sshsig of
    OpenSSH.

    Raises FormatError if it is not a signature, Refused if it is not one of theirs or not of this message.
    """
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    key, signed, signature = _parse_signature(armoured, message)
    for line in signers:
        kind, encoded, *name = line.split(None, 2)
        if kind == "ssh-ed25519" and hmac.compare_digest(_decoded(encoded.encode()), key):
            try:
                Ed25519PublicKey.from_public_bytes(_strings(key, 2)[1]).verify(signature, signed)
            except (InvalidSignature, ValueError):
                raise Refused("the signature is not of this image: it was changed, or damaged on the way") from None
            return name[0].strip() if name else encoded[-8:]
    raise Refused("it is signed by a key that the vehicle's file does not name in image.signers")


def _parse_signature(armoured: bytes, message: bytes) -> tuple[bytes, bytes, bytes]:
    """Parse a signature: the public key, the data signed in place of the message, the signature. Raises FormatError."""
    begin, end = b"-----BEGIN SSH SIGNATURE-----", b"-----END SSH SIGNATURE-----"
    text = armoured.strip()
    if not text.startswith(begin) or not text.endswith(end):
        raise FormatError(f"{SIGNATURE}: not an SSH signature")
    blob = _decoded(text[len(begin) : -len(end)])
    if not blob.startswith(b"SSHSIG\0\0\0\x01"):
        raise FormatError(f"{SIGNATURE}: an unknown version")
    key, namespace, reserved, digest, signature = _strings(blob[10:], 5)
    if namespace.decode("ascii", "replace") != NAMESPACE:
        raise FormatError(f"{SIGNATURE}: signed for {namespace!r}, not for {NAMESPACE!r}")
    if digest not in (b"sha256", b"sha512"):
        raise FormatError(f"{SIGNATURE}: unknown digest {digest!r}")
    kind, value = _strings(signature, 2)
    if kind != b"ssh-ed25519" or len(value) != 64:
        raise FormatError(f"{SIGNATURE}: {kind!r} is not ed25519")
    words = (namespace, reserved, digest, hashlib.new(digest.decode(), message).digest())
    return key, b"SSHSIG" + b"".join(struct.pack(">I", len(word)) + word for word in words), value


def _decoded(text: bytes) -> bytes:
    try:
        return base64.b64decode(b"".join(text.split()), validate=True)
    except binascii.Error as error:
        raise FormatError(f"{SIGNATURE}: {error}") from None


def _strings(blob: bytes, count: int) -> list[bytes]:
    """Unpack strings as SSH packs them: each with its length (RFC 4251, 5)."""
    found, at = list[bytes](), 0
    for _ in range(count):
        length = int.from_bytes(blob[at : at + 4], "big")
        if at + 4 + length > len(blob):
            raise FormatError(f"{SIGNATURE}: cut short")
        found.append(blob[at + 4 : at + 4 + length])
        at += 4 + length
    if at != len(blob):
        raise FormatError(f"{SIGNATURE}: extra data after its end")
    return found


def pack(bundle: Path, parts: dict[str, Path], version: str, key: Path) -> None:
    """Write an image, signed with a private key by ssh-keygen. Raises Refused where that fails."""
    digests = {name: ImagePart(path.stat().st_size, _digest(path)) for name, path in parts.items()}
    paper = msgspec.json.format(msgspec.json.encode(Manifest(FORMAT, version, digests)), indent=1) + b"\n"
    words = ["ssh-keygen", "-q", "-Y", "sign", "-n", NAMESPACE, "-f", str(key)]
    signed = subprocess.run(words, input=paper, capture_output=True)
    if signed.returncode:
        raise Refused(f"ssh-keygen: {signed.stderr.decode(errors='replace').strip()}")
    (bundle.parent / MANIFEST).write_bytes(paper)
    (bundle.parent / SIGNATURE).write_bytes(signed.stdout)
    with tarfile.open(bundle, "w", format=tarfile.USTAR_FORMAT) as archive:
        for name in MEMBERS:
            member = archive.gettarinfo(parts.get(name, bundle.parent / name), name)
            member.mode, member.uid, member.gid, member.uname, member.gname, member.mtime = 0o644, 0, 0, "root", "root", 0
            with parts.get(name, bundle.parent / name).open("rb") as file:
                archive.addfile(member, file)


def verify(bundle: Path, signers: tuple[str, ...], into: Path | None = None) -> SignedImage:
    """Read all of an image, and write its files into a folder where one is given; they are on the disk when this returns.

    Raises FormatError if it is not an image, Refused if signature or digest are wrong, OSError.
    """
    with bundle.open("rb") as file:
        try:
            members = _members(file)
        except (tarfile.TarError, UnicodeError) as error:
            raise FormatError(f"{bundle.name}: not an image: {error}") from None
        manifest, signature = (_paper(file, name, *members[name]) for name in (MANIFEST, SIGNATURE))
        image = SignedImage(manifest, signature, signers)
        for name in PARTS:
            offset, size = members[name]
            if size != image.manifest.files[name].bytes:
                raise Refused(f"{name}: not as long as its manifest says: upload it again")
            file.seek(offset)
            if _copied(file, size, into / name if into else None) != image.manifest.files[name].sha256:
                raise Refused(f"{name}: damaged, its digest is not that of its manifest: upload it again")
        return image


def _members(file: IO[bytes]) -> dict[str, tuple[int, int]]:
    """The offset and size of each member. They fill the whole file: an image carries nothing unsigned.

    Raises FormatError, tarfile.TarError, UnicodeError.
    """
    found, at = dict[str, tuple[int, int]](), 0
    for name in MEMBERS:
        file.seek(at)
        header = tarfile.TarInfo.frombuf(file.read(tarfile.BLOCKSIZE), "utf-8", "strict")
        if header.name != name or not header.isreg() or header.size < 0:
            raise FormatError(f"not an image: {name} is not where it should be")
        found[name] = at + tarfile.BLOCKSIZE, header.size
        padding = -header.size % tarfile.BLOCKSIZE
        at += tarfile.BLOCKSIZE + header.size + padding
        file.seek(at - padding)
        if any(file.read(padding)):
            raise FormatError(f"not an image: extra data after {name}")
    file.seek(at)
    rest = file.read(END_BYTES)
    if len(rest) == END_BYTES or any(rest):
        raise FormatError(f"not an image: it must hold {', '.join(MEMBERS)}, in this order, and nothing else")
    return found


def _paper(file: IO[bytes], name: str, offset: int, size: int) -> bytes:
    if size > PAPER_BYTES:
        raise FormatError(f"not an image: {name} has more than {PAPER_BYTES} bytes")
    file.seek(offset)
    return file.read(size)


def _copied(source: IO[bytes], size: int, path: Path | None) -> str:
    """Read so many bytes, and write them into a file where one is named. Returns the digest."""
    digest = hashlib.sha256()
    with contextlib.ExitStack() as files:
        target = files.enter_context(path.open("wb")) if path else None
        while size and (block := source.read(min(BLOCK_BYTES, size))):
            size -= len(block)
            digest.update(block)
            if target:
                target.write(block)
        if target:
            target.flush()
            os.fsync(target.fileno())
    return digest.hexdigest()


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
