"""Two slots for the boat's image, so that a new one can be tried and the old one is still there (thesis 2.3).

The boot partition holds `a/` and `b/`, each with kernel, initramfs and the signed manifest that names their digests, and
`grub/grubenv`, three words that boot loader and boat share: `slot` is started, except that `trial`, when it is set, is started
once in its place: the boot loader clears it first and leaves it in `tried`. So whatever a new image does, even if it never
reaches its first program, the next start is that of the old one. Only `confirm` makes it stay. An image comes as one file, an
uncompressed tar archive of MEMBERS in this order; its manifest is signed as `ssh-keygen -Y sign` does. Whoever calls knows
that the boat is not under way. How it is used: docs/image.md.
"""

import base64
import binascii
import contextlib
import fcntl
import hashlib
import hmac
import os
import struct
import subprocess
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Annotated, Final, Literal

import msgspec

from delfim import config
from delfim.errors import FormatError, Refused
from delfim.outside import UNREADABLE, read_file

FORMAT: Final = 1
NAMESPACE: Final = "delfim-image"  # of the signature: one made for anything else is worth nothing here
PARTS: Final = ("vmlinuz", "initramfs.gz")
MANIFEST, SIGNATURE = "manifest.json", "manifest.json.sig"
MEMBERS: Final = (MANIFEST, SIGNATURE, *PARTS)
SLOTS: Final = ("a", "b")
PAPER_BYTES: Final = 64 << 10  # of manifest and signature, at most
BLOCK_BYTES: Final = 1 << 20
ENVIRONMENT_BYTES: Final = 1024  # of GRUB's environment block, always
ENVIRONMENT_HEAD: Final = "# GRUB Environment Block\n"
CONFIRMED: Final = "image-confirmed"  # in the run directory, until the next start
KEYS: Final = ("slot", "trial", "tried")
Slot = Literal["a", "b"]


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A file of an image."""

    bytes: Annotated[int, msgspec.Meta(gt=0, le=1 << 30)]
    sha256: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}\Z")]


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What an image is. `format` is 1."""

    format: Literal[1]
    version: Annotated[str, msgspec.Meta(pattern=r"^[0-9A-Za-z][0-9A-Za-z.+_-]{0,63}\Z")]
    files: dict[str, Part]


class Environment(msgspec.Struct, frozen=True):
    """What boot loader and boat tell each other: slots, "" for none."""

    slot: str = "a"
    trial: str = ""
    tried: str = ""


class Image:
    """A verified manifest, and who signed it."""

    def __init__(self, manifest: bytes, signature: bytes, signers: tuple[str, ...]) -> None:
        self.paper, self.signature = manifest, signature
        self.signer = verify_signature(manifest, signature, signers)
        self.manifest = parse_manifest(manifest)


def parse_manifest(text: bytes) -> Manifest:
    """Raises FormatError."""
    try:
        manifest = msgspec.json.decode(text, type=Manifest)
    except UNREADABLE as error:
        raise FormatError(f"{MANIFEST}: {error}") from None
    if set(manifest.files) != set(PARTS):
        raise FormatError(f"{MANIFEST}: it must name {' and '.join(PARTS)}, and nothing else")
    return manifest


def verify_signature(message: bytes, armoured: bytes, signers: tuple[str, ...]) -> str:
    """Who of the signers (public keys, as ssh-keygen writes them) signed it. Format: PROTOCOL.sshsig of OpenSSH.

    Raises FormatError for what is no signature, and Refused where it is not one of theirs or not of this message.
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
    """The public key, what was signed in place of the message, the signature. Raises FormatError."""
    begin, end = b"-----BEGIN SSH SIGNATURE-----", b"-----END SSH SIGNATURE-----"
    text = armoured.strip()
    if not text.startswith(begin) or not text.endswith(end):
        raise FormatError(f"{SIGNATURE}: no SSH signature")
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
    """As SSH packs them: each with its length (RFC 4251, 5)."""
    found, at = list[bytes](), 0
    for _ in range(count):
        length = int.from_bytes(blob[at : at + 4], "big")
        if at + 4 + length > len(blob):
            raise FormatError(f"{SIGNATURE}: cut short")
        found.append(blob[at + 4 : at + 4 + length])
        at += 4 + length
    if at != len(blob):
        raise FormatError(f"{SIGNATURE}: more than there should be")
    return found


# The file that is uploaded.


def pack(bundle: Path, parts: dict[str, Path], version: str, key: Path) -> None:
    """Write an image, signed with a private key by ssh-keygen. Raises Refused where that fails."""
    digests = {name: Part(path.stat().st_size, _digest(path)) for name, path in parts.items()}
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


def verify(bundle: Path, signers: tuple[str, ...], into: Path | None = None) -> Image:
    """Read all of an image, and write its files into a folder where one is given; they are on the disk when this returns.

    Raises FormatError for what is no image, Refused where signature or digest are wrong, OSError.
    """
    with bundle.open("rb") as file:
        try:
            members = _members(file)
        except (tarfile.TarError, UnicodeError) as error:
            raise FormatError(f"{bundle.name}: no image: {error}") from None
        manifest, signature = (_paper(file, name, *members[name]) for name in (MANIFEST, SIGNATURE))
        image = Image(manifest, signature, signers)
        for name in PARTS:
            offset, size = members[name]
            if size != image.manifest.files[name].bytes:
                raise Refused(f"{name}: not as long as its manifest says: the upload is not whole")
            file.seek(offset)
            if _copied(file, size, into / name if into else None) != image.manifest.files[name].sha256:
                raise Refused(f"{name}: its digest is not that of its manifest")
        return image


def _members(file: IO[bytes]) -> dict[str, tuple[int, int]]:
    """Offset and size of each. They fill the whole file: nothing travels with an image that nobody has signed.

    Raises FormatError, tarfile.TarError, UnicodeError.
    """
    found, at = dict[str, tuple[int, int]](), 0
    for name in MEMBERS:
        file.seek(at)
        header = tarfile.TarInfo.frombuf(file.read(tarfile.BLOCKSIZE), "utf-8", "strict")
        if header.name != name or not header.isreg() or header.size < 0:
            raise FormatError(f"no image: {name} is not where it should be")
        found[name] = at + tarfile.BLOCKSIZE, header.size
        padding = -header.size % tarfile.BLOCKSIZE
        at += tarfile.BLOCKSIZE + header.size + padding
        file.seek(at - padding)
        if any(file.read(padding)):
            raise FormatError(f"no image: there is something behind {name}")
    file.seek(at)
    rest = file.read(tarfile.RECORDSIZE + 1)
    if len(rest) > tarfile.RECORDSIZE or any(rest):
        raise FormatError(f"no image: it must hold {', '.join(MEMBERS)}, in this order, and nothing else")
    return found


def _paper(file: IO[bytes], name: str, offset: int, size: int) -> bytes:
    if size > PAPER_BYTES:
        raise FormatError(f"no image: {name} has more than {PAPER_BYTES} bytes")
    file.seek(offset)
    return file.read(size)


def _copied(source: IO[bytes], size: int, path: Path | None) -> str:
    """Read so much, and write it into a file where one is named. Returns the digest."""
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


# The boot partition.


@contextlib.contextmanager
def boot_partition(table: config.Image, *, write: bool) -> Iterator["Slots"]:
    """The slots, while the partition is mounted and nobody else writes. Raises Refused in words, OSError."""
    directory = Path(table.directory)
    if table.partition:
        _mounted("mount", "-o", "rw,noatime" if write else "ro", table.partition, str(directory))
    try:
        fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(fd, (fcntl.LOCK_EX if write else fcntl.LOCK_SH) | fcntl.LOCK_NB)
            yield Slots(directory)
        except BlockingIOError:
            raise Refused("another image is being installed at this moment") from None
        finally:
            os.close(fd)
    finally:
        if table.partition:
            _mounted("umount", str(directory))


def _mounted(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise Refused(f"the boot partition: {' '.join(words)}: {done.stderr.strip()}")


class Slots:
    """The two slots under a directory."""

    def __init__(self, directory: Path) -> None:
        self._directory, self._environment = directory, directory / "grub" / "grubenv"

    def environment(self) -> Environment:
        """Raises Refused where there is none, FormatError where it is damaged."""
        try:
            return parse_environment(read_file(self._environment, PAPER_BYTES))
        except FileNotFoundError:
            raise Refused(f"{self._environment} is not there: this computer has no slots (docs/image.md)") from None

    def manifest(self, slot: str) -> Manifest | None:
        """Of what is in a slot, None where nothing whole is. Raises FormatError."""
        try:
            return parse_manifest(read_file(self._directory / slot / MANIFEST, PAPER_BYTES))
        except FileNotFoundError:
            return None

    def damage(self, slot: str) -> str:
        """What is wrong with the files of a slot, read from the disk; "" when nothing is."""
        try:
            manifest = self.manifest(slot)
            for name, part in manifest.files.items() if manifest else ():
                if _digest_of_disk(self._directory / slot / name) != part.sha256:
                    return f"{name} is not what was installed"
        except (OSError, FormatError) as error:
            return str(error)
        return "" if manifest else "empty"

    def install(self, bundle: Path, signers: tuple[str, ...]) -> tuple[str, Image]:
        """Into the slot that is not confirmed, to be tried at the next start. Returns that slot. Raises as `verify`.

        At no instant is there a word that points to files that are not whole.
        """
        environment = self.environment()
        slot = SLOTS[environment.slot == SLOTS[0]]
        folder = self._directory / slot
        self._write(Environment(environment.slot))  # what is overwritten now is tried no more
        folder.mkdir(exist_ok=True)
        for name in MEMBERS:
            (folder / name).unlink(missing_ok=True)
        _sync(folder)
        image = verify(bundle, signers, folder)
        for name, text in ((SIGNATURE, image.signature), (MANIFEST, image.paper)):
            _replace(folder / name, text)
        if damage := self.damage(slot):
            raise Refused(f"slot {slot}: {damage}: the disk does not keep what is written to it")
        self._write(Environment(environment.slot, trial=slot))
        return slot, image

    def confirm(self, running: str) -> None:
        """The slot that runs is the one to start from now on; where that is the old one, the other's failure is forgotten.

        Raises Refused where there is nothing to confirm.
        """
        environment = self.environment()
        if running not in SLOTS:
            raise Refused("this computer was not started from a slot")
        if running == environment.slot and not environment.tried:
            raise Refused(f"slot {running} is confirmed already")
        if running not in (environment.slot, environment.tried):
            raise Refused(f"slot {running} was overwritten since it was started: start anew, then confirm")
        self._write(Environment(running, environment.trial))

    def _write(self, environment: Environment) -> None:
        _replace(self._environment, write_environment(environment))


def parse_environment(text: bytes) -> Environment:
    """GRUB's environment block. Raises FormatError."""
    lines = text.decode("ascii", "replace").split("\n")
    words = dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))
    environment = Environment(*(words.get(key, "") for key in KEYS))
    if len(text) != ENVIRONMENT_BYTES or lines[0] != ENVIRONMENT_HEAD.strip() or environment.slot not in SLOTS:
        raise FormatError("grubenv is damaged: it names no slot")
    if not {environment.trial, environment.tried} <= {*SLOTS, ""}:
        raise FormatError("grubenv is damaged: it names a slot that is none")
    return environment


def write_environment(environment: Environment) -> bytes:
    text = ENVIRONMENT_HEAD + "".join(f"{key}={getattr(environment, key)}\n" for key in KEYS)
    return text.encode().ljust(ENVIRONMENT_BYTES, b"#")


def _replace(path: Path, text: bytes) -> None:
    """The old text or the new one, whenever the power fails."""
    new = path.with_name(path.name + ".new")
    with new.open("wb") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)
    _sync(path.parent)


def _sync(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _digest_of_disk(path: Path) -> str:
    """Not of what the kernel still has in memory, as far as it lets go of that."""
    with path.open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        return hashlib.file_digest(file, "sha256").hexdigest()


# What the running boat knows without the partition.


def started(command_line: str) -> tuple[str, str]:
    """The slot that runs and the one that was tried last, as the boot loader told the kernel; "" for none."""
    words = dict(word.split("=", 1) for word in command_line.split() if "=" in word)
    slot, tried = (words.get(f"delfim.{key}", "") for key in ("slot", "tried"))
    return (slot if slot in SLOTS else ""), (tried if tried in SLOTS else "")


def notice(slot: str, tried: str) -> str:
    """What the operator should know about this start, in words; "" when it is an ordinary one."""
    if not slot or not tried:
        return ""
    if slot == tried:
        return f"the image in slot {slot} is on trial: confirm it, or the next start is that of the other one"
    return f"rolled back: the image in slot {tried} was tried and not confirmed; slot {slot} runs again"


def present_notice(run_directory: str) -> str:
    """`notice` of this computer, until `confirmed` was called."""
    try:
        command_line = Path("/proc/cmdline").read_text()
    except OSError:
        return ""
    said = notice(*started(command_line))
    return "" if not said or os.path.exists(os.path.join(run_directory, CONFIRMED)) else said


def confirmed(run_directory: str) -> None:
    """From now on there is nothing to tell."""
    Path(run_directory, CONFIRMED).touch()
