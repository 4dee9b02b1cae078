"""The two slots of the boat's image: what is taken, what is refused, and what is left when the power fails in between."""

import contextlib
import io
import os
import random
import subprocess
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import DelfimError, FormatError, Refused
from delfim.services.image import imagefile, slots
from delfim.services.image.slots import Environment, Slots
from delfim.services.tables import Image


class Yard:
    """A boot partition with an image in slot a, a key, and images to install."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.boot = folder, folder / "boot"
        self.key = self._key("yard")
        self.signers = ((folder / "yard.pub").read_text(),)
        (self.boot / "grub").mkdir(parents=True)
        (self.boot / "grub" / "grubenv").write_bytes(slots.write_environment(Environment("b")))
        self.slots = Slots(self.boot)
        self.slots.install(self.bundle("1.0"), self.signers)
        self.state = Environment("a")

    def _key(self, name: str) -> Path:
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", name, "-f", self.folder / name], check=True)
        return self.folder / name

    @property
    def state(self) -> Environment:
        return self.slots.environment()

    @state.setter
    def state(self, environment: Environment) -> None:
        (self.boot / "grub" / "grubenv").write_bytes(slots.write_environment(environment))

    def bundle(self, version: str, key: str = "") -> Path:
        parts = {name: self.folder / name for name in imagefile.PARTS}
        for name, path in parts.items():
            path.write_bytes(f"{name} of {version}".encode() * 5000)
        imagefile.pack(self.folder / f"{version}.image", parts, version, self._key(key) if key else self.key)
        return self.folder / f"{version}.image"

    def start(self) -> str:
        """What the boot loader does. Returns the slot that runs."""
        state = self.state
        if state.trial:
            self.state = Environment(state.slot, "", state.trial)
            return state.trial
        return state.slot


@pytest.fixture(scope="module")
def made_yard(tmp_path_factory: pytest.TempPathFactory) -> Yard:
    return Yard(tmp_path_factory.mktemp("yard"))


@pytest.fixture
def yard(made_yard: Yard) -> Yard:
    made_yard.slots.install(made_yard.bundle("1.0"), made_yard.signers)
    made_yard.state = Environment(made_yard.slots.environment().trial)
    if made_yard.state.slot == "b":
        made_yard.slots.install(made_yard.bundle("1.0"), made_yard.signers)
        made_yard.state = Environment("a")
    return made_yard


def test_a_new_image_is_tried_once_and_stays_when_it_is_confirmed(yard: Yard) -> None:
    slot, image = yard.slots.install(yard.bundle("2.0"), yard.signers)
    assert (slot, image.manifest.version, image.signer) == ("b", "2.0", "yard")
    assert yard.start() == "b"
    yard.slots.confirm("b")
    assert [yard.start(), yard.start()] == ["b", "b"]
    assert yard.slots.manifest("b") == image.manifest
    assert yard.slots.damage("b") == ""


def test_an_image_of_any_length_is_read(yard: Yard, tmp_path: Path) -> None:
    """An archive ends at a whole record of 20 blocks: its end has up to 21."""
    parts = {name: tmp_path / name for name in imagefile.PARTS}
    for blocks in range(1, tarfile.RECORDSIZE // tarfile.BLOCKSIZE + 1):
        for path in parts.values():
            path.write_bytes(bytes(tarfile.BLOCKSIZE))
        parts["initramfs.gz"].write_bytes(bytes(blocks * tarfile.BLOCKSIZE))
        imagefile.pack(tmp_path / "new.image", parts, "2.0", yard.key)
        assert imagefile.verify(tmp_path / "new.image", yard.signers).signer == "yard"


def test_an_image_that_is_not_confirmed_is_rolled_back_and_that_is_told(yard: Yard) -> None:
    yard.slots.install(yard.bundle("2.0"), yard.signers)
    assert [yard.start(), yard.start(), yard.start()] == ["b", "a", "a"]
    assert yard.state == Environment("a", "", "b")
    assert slots.notice("b", "b").startswith("the image in slot b is on trial")
    assert slots.notice("a", "b").startswith("rolled back: the image in slot b was tried and not confirmed")
    assert slots.notice("a", "") == slots.notice("", "b") == ""
    yard.slots.confirm("a")
    assert yard.state == Environment("a")


def test_there_must_be_something_to_confirm(yard: Yard) -> None:
    with pytest.raises(Refused, match="not started from a slot"):
        yard.slots.confirm("")
    with pytest.raises(Refused, match="slot a is confirmed already"):
        yard.slots.confirm("a")
    yard.slots.install(yard.bundle("2.0"), yard.signers)
    running = yard.start()
    yard.slots.install(yard.bundle("3.0"), yard.signers)
    with pytest.raises(Refused, match="overwritten since it was started"):
        yard.slots.confirm(running)


def test_a_stranger_s_image_is_refused_before_anything_is_written(yard: Yard, tmp_path: Path) -> None:
    before = yard.slots.manifest("b")
    bundle = yard.bundle("6.6", key=f"stranger-{os.urandom(4).hex()}")
    with pytest.raises(Refused, match=r"does not name in image\.signers"):
        imagefile.verify(bundle, yard.signers)
    with pytest.raises(Refused, match=r"does not name in image\.signers"):
        imagefile.verify(yard.bundle("2.0"), ())
    assert yard.slots.manifest("b") == before


def changed(text: bytes, at: int) -> bytes:
    return text[:at] + bytes([text[at] ^ 1]) + text[at + 1 :]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (b'"version"', "no SSH|signature is not of this image|manifest"),
        (b"vmlinuz of 2.0vmlinuz of", "vmlinuz: damaged, its digest is not that of its manifest"),
        (b"initramfs.gz of 2.0initramfs", "initramfs.gz: damaged, its digest is not that of its manifest"),
    ],
)
def test_a_flipped_bit_is_found(yard: Yard, words: bytes, reason: str) -> None:
    bundle = yard.bundle("2.0")
    text = bundle.read_bytes()
    bundle.write_bytes(changed(text, text.index(words) + 1))
    with pytest.raises(DelfimError, match=reason):
        imagefile.verify(bundle, yard.signers)


def test_an_upload_that_broke_off_leaves_the_confirmed_image_and_tries_nothing(yard: Yard) -> None:
    bundle = yard.bundle("2.0")
    bundle.write_bytes(bundle.read_bytes()[:-60_000])
    with pytest.raises(DelfimError):
        yard.slots.install(bundle, yard.signers)
    assert yard.state == Environment("a")
    assert (yard.slots.damage("a"), yard.slots.damage("b")) == ("", "empty")


def test_at_no_call_that_fails_does_the_boot_loader_see_half_an_image(yard: Yard, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk fails at the N-th sync, for every N: what would be started is whole."""
    yard.slots.install(yard.bundle("1.5"), yard.signers)
    whole, calls = yard.bundle("2.0"), 0
    fsync = os.fsync

    def failing(number: int) -> Callable[[int], None]:
        def one(fd: int) -> None:
            nonlocal calls
            calls += 1
            if calls == number:
                raise OSError(5, "Input/output error")
            fsync(fd)

        return one

    for number in range(1, 30):
        calls = 0
        yard.state = Environment("a", "b")
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", failing(number))
            try:
                yard.slots.install(whole, yard.signers)
            except OSError:
                pass
            else:
                break
        state = yard.state
        assert yard.slots.damage("a") == ""
        assert state.slot == "a"
        assert not state.trial or yard.slots.damage("b") == ""
    assert 8 < number < 29
    assert yard.state == Environment("a", "b")


class Failing:
    """Files whose N-th change of the disk fails: a write in its middle, or a sync, a rename, a removal, a folder."""

    def __init__(self, patch: pytest.MonkeyPatch, number: int, error: BaseException) -> None:
        self.left, self._error = number, error
        for place, name in ((os, "fsync"), (Path, "replace"), (Path, "unlink"), (Path, "mkdir")):
            patch.setattr(place, name, self._before(getattr(place, name)))
        opened = Path.open

        def open_(path: Path, mode: str = "r") -> Any:
            file = opened(path, mode)
            return Writes(file, self) if "w" in mode else file

        patch.setattr(Path, "open", open_)

    def step(self) -> None:
        self.left -= 1
        if not self.left:
            raise self._error

    def _before(self, do: Callable[..., Any]) -> Callable[..., Any]:
        def one(*arguments: Any, **words: Any) -> Any:
            self.step()
            return do(*arguments, **words)

        return one


class Writes:
    """A file that takes half of a write before it fails."""

    def __init__(self, file: Any, failing: Failing) -> None:
        self._file, self._failing = file, failing

    def write(self, text: bytes) -> int:
        half = len(text) // 2
        self._file.write(text[:half])
        self._failing.step()
        return half + int(self._file.write(text[half:]))

    def __enter__(self) -> "Writes":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


class PowerCut(BaseException):
    """Nothing is tidied up after it."""


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), OSError(5, "Input/output error"), PowerCut()], ids=str
)
def test_wherever_an_installation_breaks_off_the_boat_starts_from_what_is_whole(yard, monkeypatch, error):
    """The disk is full or broken, or the power fails, at every change that an installation makes."""
    yard.slots.install(yard.bundle("1.5"), yard.signers)
    bundle = yard.bundle("2.0")
    for number in range(1, 100):
        yard.state = Environment("a", "b")
        with monkeypatch.context() as patch:
            failing = Failing(patch, number, error)
            try:
                yard.slots.install(bundle, yard.signers)
            except (OSError, PowerCut):
                assert not failing.left
            else:
                break
        state = yard.state
        assert state.slot == "a"
        assert yard.slots.damage("a") == ""
        assert not state.trial or yard.slots.damage("b") == ""
        assert yard.start() in ("a", "b")
    assert 20 < number < 99
    assert (yard.state, yard.slots.damage("b")) == (Environment("a", "b"), "")


def test_two_thousand_damaged_images_are_refused_or_are_the_same(yard: Yard, tmp_path: Path) -> None:
    """Bits turned, bytes put in and taken out, the end cut off. Some bytes of a tar header mean nothing."""
    chance = random.Random(1)
    text = yard.bundle("2.0").read_bytes()
    paper = imagefile.verify(yard.bundle("2.0"), yard.signers).paper
    bundle, taken, words = tmp_path / "damaged.image", 0, list[str]()
    head = 5 * 512  # with manifest and signature: where a change tells most
    for number in range(2000):
        at = chance.randrange(head if number % 2 else len(text))
        some = chance.randbytes(chance.choice((1, 2, 512)))
        bundle.write_bytes(
            (
                text[:at] + bytes([text[at] ^ 1 << chance.randrange(8)]) + text[at + 1 :],
                text[:at] + some + text[at + len(some) :],
                text[:at] + some + text[at:],
                text[:at] + text[at + len(some) :],
                text[:at],
            )[number % 5]
        )
        try:
            assert imagefile.verify(bundle, yard.signers).paper == paper
            taken += 1
        except DelfimError as error:
            words.append(str(error))
    assert taken < 100
    assert len(words) == 2000 - taken
    assert max(map(len, words)) < 300
    assert "\n" not in "".join(words)


def test_two_are_not_installed_at_once(yard: Yard) -> None:
    table = Image(directory=str(yard.boot))
    with (
        slots.boot_partition(table, write=True),
        pytest.raises(Refused, match="another image"),
        slots.boot_partition(table, write=True),
    ):
        pass


def test_a_computer_without_slots_says_so(tmp_path: Path) -> None:
    with (
        slots.boot_partition(Image(directory=str(tmp_path)), write=False) as both,
        pytest.raises(Refused, match="has no slots"),
    ):
        both.environment()
    with (
        pytest.raises(Refused, match="boot partition: mount"),
        slots.boot_partition(Image(partition="/dev/nothing", directory=str(tmp_path)), write=False),
    ):
        pass


def test_what_the_kernel_was_told_is_read_back() -> None:
    assert slots.started("quiet delfim.slot=b delfim.tried=b LOG=/dev/sda2\n") == ("b", "b")
    assert slots.started("quiet delfim.slot=a delfim.tried=\n") == ("a", "")
    assert slots.started("delfim.slot=../x") == ("", "")


def test_the_block_is_one_that_grub_reads_and_writes(tmp_path: Path) -> None:
    path = tmp_path / "grubenv"
    path.write_bytes(slots.write_environment(Environment("a", "b", "")))
    listing = subprocess.run(["grub-editenv", path, "list"], check=True, capture_output=True, text=True).stdout
    assert listing == "slot=a\ntrial=b\ntried=\n"
    subprocess.run(["grub-editenv", path, "set", "trial=", "tried=b"], check=True)
    assert slots.parse_environment(path.read_bytes()) == Environment("a", "", "b")


def with_extras(text: bytes, name: str) -> Iterator[bytes]:
    """An image with a member more, at each place where there could be one, and with bytes between and behind."""
    extra = tarfile.TarInfo(name)
    extra.size = 7
    more = extra.tobuf(tarfile.USTAR_FORMAT) + b"unsigned"[:7].ljust(512, b"\0")
    with tarfile.open(fileobj=io.BytesIO(text)) as archive:
        starts = [member.offset for member in archive.getmembers()]
        end = archive.getmembers()[-1].offset_data + -(-archive.getmembers()[-1].size // 512) * 512
    for at in (*starts, end, end + 512, len(text)):
        yield text[:at] + more + text[at:]
    for at in (starts[1] - 1, end - 1, end, len(text) - 1):
        yield changed(text, at)
    yield text + bytes(tarfile.RECORDSIZE)
    pax = tarfile.TarInfo("pax")
    pax.pax_headers = {"comment": "x" * 100_000}
    yield pax.tobuf(tarfile.PAX_FORMAT) + text


@pytest.mark.parametrize("name", ["extra", "../up", "/etc/passwd", "vmlinuz", imagefile.MANIFEST])
def test_what_nobody_has_signed_does_not_travel_with_an_image(yard: Yard, tmp_path: Path, name: str) -> None:
    text = yard.bundle("2.0").read_bytes()
    bundle = tmp_path / "more.image"
    for more in with_extras(text, name):
        bundle.write_bytes(more)
        with pytest.raises(FormatError, match="not an image"):
            imagefile.verify(bundle, yard.signers)
    bundle.write_bytes(text)
    assert imagefile.verify(bundle, yard.signers).manifest.version == "2.0"


@given(st.binary(max_size=2000) | st.binary(max_size=900).map(lambda text: b"# GRUB Environment Block\n" + text))
def test_any_bytes_are_an_environment_or_a_format_error(text: bytes) -> None:
    with contextlib.suppress(FormatError):
        slots.parse_environment(text)


@given(st.binary(max_size=300), st.binary(max_size=300), st.booleans())
def test_any_bytes_are_refused_as_signature_and_manifest(text: bytes, signature: bytes, armoured: bool) -> None:
    if armoured:
        signature = b"-----BEGIN SSH SIGNATURE-----" + signature + b"-----END SSH SIGNATURE-----"
    with pytest.raises((FormatError, Refused)):
        imagefile.verify_signature(text, signature, ("ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIA== nobody",))
    with pytest.raises(FormatError):
        imagefile.parse_manifest(text)


@given(
    st.dictionaries(st.sampled_from([*imagefile.MEMBERS, "other", "../up"]), st.binary(max_size=100)), st.binary(max_size=20)
)
def test_any_archive_is_refused_in_words(tmp_path_factory, members, end):
    held = io.BytesIO()
    with tarfile.open(fileobj=held, mode="w") as archive:
        for name, text in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(text)
            archive.addfile(member, io.BytesIO(text))
    path = tmp_path_factory.getbasetemp() / "any.image"
    path.write_bytes(held.getvalue()[: -len(end) or None] + end)
    with pytest.raises((FormatError, Refused)):
        imagefile.verify(path, ())
