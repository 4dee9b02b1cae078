"""Uploads that get in each other's way, and clients that vanish at the worst instant: what has its name is whole, what takes
room is counted, and nothing stays open."""

import asyncio
import contextlib
import os
import random
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from delfim import config
from delfim.base.errors import DelfimError
from delfim.logging import free_space
from delfim.services.files import uploads as module
from delfim.services.files.threads import worked
from delfim.services.files.uploads import LOOK_BYTES, PART, NoRoom, Uploads
from delfim.services.page import files as webfiles
from delfim.services.page import httpd
from delfim.services.tables import Httpd
from tests.services.boat import served, vehicle_file
from tests.services.test_ftpd import CONTENT, files, there

__all__ = ["there"]
NEW = os.O_RDWR | os.O_CREAT
QUOTA, BLOCK = 3 << 20, 64 << 10
NAMES = ("a", "b", "a.part", "d/a", "d/b")


def opened(place: Path, **limits: int) -> Uploads:
    folder = Uploads(str(place), config.LogTable(directory=str(place), free_bytes_min=0, **limits))
    folder.prepare()
    return folder


@pytest.mark.parametrize("alone", [True, False], ids=["ftp", "sftp"])
def test_a_file_that_is_being_written_keeps_its_name(tmp_path, alone):
    """By another daemon, too. Bytes that go into a file without a name would be counted nowhere."""
    uploads, other = opened(tmp_path), opened(tmp_path)
    (tmp_path / "upload/mine").write_text("mine")
    fd = uploads.open("/upload/x.part", NEW, alone=alone)
    for do in (
        lambda: other.remove("/upload/x.part"),
        lambda: other.rename("/upload/x.part", "/upload/x"),
        lambda: other.rename("/upload/mine", "/upload/x.part"),
        lambda: other.open("/upload/x.part", NEW, alone=True),
        lambda: uploads.remove("/upload/x.part"),
    ):
        with pytest.raises(DelfimError, match="another client is writing it"):
            do()
    assert os.fstat(fd).st_nlink == 1
    os.close(fd)
    other.rename("/upload/mine", "/upload/x.part")
    other.remove("/upload/x.part")


def test_a_part_of_which_somebody_else_is_the_owner_is_not_cut(tmp_path):
    uploads = opened(tmp_path)
    fd = uploads.open("/upload/x.part", NEW, alone=True)
    uploads.write(fd, b"0123456789", 0)
    with pytest.raises(DelfimError, match="another client is writing it"):
        uploads.apply("/upload/x.part", lambda other: os.ftruncate(other, 1))
    uploads.finish(fd, "/upload/x")
    os.close(fd)
    assert (tmp_path / "upload/x").read_text() == "0123456789"


def test_a_part_that_becomes_whole_before_it_is_locked_is_not_written(tmp_path, monkeypatch):
    """Its first client is ready, and renames it, between the opening by the second one and his lock."""
    uploads = opened(tmp_path)
    (tmp_path / "upload/x.part").write_text("all of it")
    found = uploads._jail.open

    def slow(path: str, flags: int, mode: int) -> int:
        fd = found(path, flags, mode)
        (tmp_path / "upload/x.part").rename(tmp_path / "upload/x")
        return fd

    monkeypatch.setattr(uploads._jail, "open", slow)
    with pytest.raises((DelfimError, FileNotFoundError)):
        uploads.open("/upload/x.part", NEW, alone=True)
    assert (tmp_path / "upload/x").read_text() == "all of it"


@pytest.mark.parametrize("is_finished", [False, True])
def test_an_upload_that_begins_while_another_gets_its_name_keeps_it(tmp_path, monkeypatch, is_finished):
    """The name was free when the other one looked, and is taken before the rename."""
    first, other = opened(tmp_path), opened(tmp_path)
    found, begun = module._idle, list[int]()

    @contextlib.contextmanager
    def late(folder: int, name: str) -> Iterator[bool]:
        with found(folder, name) as is_free:
            if name == "new":
                begun.append(other.open("/upload/new", NEW, alone=True))
            yield is_free

    fd = first.open("/upload/new.part" if is_finished else "/upload/old", NEW, alone=True)
    first.write(fd, b"old", 0)
    monkeypatch.setattr(module, "_idle", late)
    if not is_finished:
        os.close(fd)
    with pytest.raises(DelfimError, match="another client is writing it"):
        first.finish(fd, "/upload/new") if is_finished else first.rename("/upload/old", "/upload/new")
    assert os.fstat(begun[0]).st_nlink == 1
    assert (tmp_path / "upload" / ("new.part" if is_finished else "old")).read_text() == "old"
    for each in (*begun, *[fd] * is_finished):
        os.close(each)


def test_the_part_of_somebody_else_does_not_get_the_name(tmp_path):
    """The folder goes away during the upload, and another one with half a file comes to its place."""
    uploads = opened(tmp_path)
    for name in ("d", "e"):
        uploads.make_folder(f"/upload/{name}")
    (tmp_path / "upload/e/x.part").write_text("ha")
    fd = uploads.open("/upload/d/x.part", NEW, alone=True)
    uploads.rename("/upload/d", "/upload/f")
    uploads.rename("/upload/e", "/upload/d")
    with pytest.raises(DelfimError, match="another file now"):
        uploads.finish(fd, "/upload/d/x")
    os.close(fd)
    assert sorted(path.name for path in (tmp_path / "upload/d").iterdir()) == ["x.part"]


async def test_an_upload_of_the_name_of_a_part_does_not_get_into_it(there):
    first, second = [await (await there.raw()).login("writer", "open") for _ in range(2)]
    links = [await client.passive() for client in (first, second)]
    for client, name in ((first, "x"), (second, "x.part")):
        assert (await client.say(f"STOR upload/{name}")).startswith("150")
    links[0][1].write(CONTENT)
    links[1][1].write(b"something else")
    links[1][1].close()
    assert await second.answer() == "426 another client is writing it\r\n"
    links[0][1].close()
    assert (await first.answer()).startswith("226")
    assert (there.staging / "x").read_bytes() == CONTENT


async def test_an_upload_whose_client_is_killed_is_a_part(there):
    """Its computer ends both connections at once, and of a data connection that is how a whole file ends, too."""
    for number in range(3):
        client = await (await there.raw()).login("writer", "open")
        _, data = await client.passive()
        assert (await client.say(f"STOR upload/{number}")).startswith("150")
        data.write(CONTENT[:1000])
        await data.drain()
        data.close()
        client.writer.close()
    async with asyncio.timeout(200):
        while in_use(there.staging):
            await asyncio.sleep(0.01)
    assert {path.name for path in there.staging.iterdir()} == {f"{number}.part" for number in range(3)}


async def vanished(client: asyncio.StreamWriter, doing: threading.Event, go_on: threading.Event) -> None:
    """A client that is gone while a worker is in the middle of its call."""
    await asyncio.to_thread(doing.wait, 60)
    client.transport.abort()
    for _ in range(20):
        await asyncio.sleep(0)
    go_on.set()


def held(do, doing, go_on):  # type: ignore[no-untyped-def]
    """A call that a slow disk holds, once."""

    def slow(*arguments):  # type: ignore[no-untyped-def]
        found = do(*arguments)
        doing.set()
        assert go_on.wait(200)
        return found

    return slow


async def test_a_client_that_vanishes_while_its_file_is_opened_leaves_it_to_the_next(tmp_path, monkeypatch):
    doing, go_on = threading.Event(), threading.Event()
    monkeypatch.setattr(Uploads, "_name", held(Uploads._name, doing, go_on))
    async with files(tmp_path) as there:
        first = await (await there.raw()).login("writer", "open")
        _, data = await first.passive()
        first.writer.write(b"STOR upload/x\r\n")
        await vanished(first.writer, doing, go_on)
        async with asyncio.timeout(200):
            second = await (await there.raw()).login("writer", "open")
            while (await second.say("DELE upload/x.part")).startswith("550 another"):
                await asyncio.sleep(0.01)
        data.transport.abort()
        assert not in_use(there.staging)


def in_use(folder: Path) -> list[str]:
    """The files below a folder that this process has open."""
    found = []
    for each in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            found += [name for name in (os.readlink(f"/proc/self/fd/{each}"),) if name.startswith(f"{folder}/")]
    return found


async def test_a_visitor_who_vanishes_while_his_file_is_opened_leaves_nothing_open(tmp_path, monkeypatch):
    """It is the vehicle's process that would have no descriptors left."""
    doing, go_on = threading.Event(), threading.Event()
    monkeypatch.setattr(webfiles, "opened", held(webfiles.opened, doing, go_on))
    settings = vehicle_file(tmp_path, httpd=Httpd(listen="127.0.0.1:0"))
    (tmp_path / "log/x.log").write_bytes(CONTENT)
    async with served(settings, httpd.serve, "httpd") as runtime:
        port = int(str(runtime.board["httpd"]()["address"]).strip("/").rpartition(":")[2])
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET /logs/x.log HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        await vanished(writer, doing, go_on)
        async with asyncio.timeout(200):
            while in_use(tmp_path / "log"):
                await asyncio.sleep(0.01)


async def test_who_is_cancelled_waits_for_the_call_that_has_begun_and_takes_back_the_others():
    """A descriptor that is closed during a write is somebody else's file at the end of it."""
    began, go_on, ended = threading.Event(), threading.Event(), list[str]()

    def call(name: str) -> None:
        began.set()
        go_on.wait(200)
        ended.append(name)

    with ThreadPoolExecutor(1) as workers:
        first, second = (asyncio.create_task(worked(workers, call, name)) for name in ("first", "second"))
        await asyncio.to_thread(began.wait, 60)
        first.cancel()
        second.cancel()
        await asyncio.wait([second])
        assert not first.done()
        go_on.set()
        await asyncio.wait([first])
    assert first.cancelled()
    assert ended == ["first"]


class Client:
    """One of several that upload, rename and remove a few names at once. A whole file says its length and is of one letter."""

    def __init__(self, uploads: Uploads, letter: int, over: threading.Barrier) -> None:
        self.uploads, self.letter, self.random, self.over = uploads, letter, random.Random(letter), over
        self.whole = self.refused = self.nameless = 0

    def content(self) -> bytes:
        size = self.random.choice((0, 10, BLOCK, 5 * BLOCK))
        return b"%08d" % size + bytes([self.letter]) * size

    def put(self, path: str) -> None:
        content = self.content()
        fd = self.uploads.open(path + PART, NEW, alone=True)
        try:
            os.ftruncate(fd, 0)
            for at in range(0, len(content), BLOCK):
                if self.random.random() < 0.05:
                    return  # it broke off
                self.uploads.write(fd, content[at : at + BLOCK], at)
                self.nameless += not os.fstat(fd).st_nlink
            self.uploads.finish(fd, path)
            self.whole += 1
        finally:
            os.close(fd)

    def work(self, count: int) -> None:
        self.over.wait(200)
        for _ in range(count):
            path, other = (f"/upload/{self.random.choice(NAMES)}" for _ in range(2))
            deeds = (
                lambda: self.put(path),  # noqa: B023
                lambda: self.put(other),  # noqa: B023
                lambda: self.uploads.remove(path),  # noqa: B023
                lambda: self.uploads.remove(path + PART),  # noqa: B023
                lambda: self.uploads.rename(path.removesuffix(PART), other),  # noqa: B023
                self.move,
            )
            try:
                self.random.choice(deeds)()
            except (DelfimError, OSError):
                self.refused += 1

    def move(self) -> None:
        with contextlib.suppress(DelfimError, OSError):
            self.uploads.make_folder("/upload/d")
        self.uploads.rename(*self.random.choice((("/upload/d", "/upload/e"), ("/upload/e", "/upload/d"))))


def test_whatever_clients_do_at_once_a_whole_file_is_whole_and_all_of_it_is_counted(tmp_path, mutations):
    """1,600 deeds; 400,000 with --mutations 10000."""
    daemons = [opened(tmp_path, upload_bytes_max=QUOTA, upload_names_max=100) for _ in range(2)]
    barrier = threading.Barrier(4)
    clients = [Client(daemons[number % 2], ord("a") + number, barrier) for number in range(4)]
    threads = [threading.Thread(target=client.work, args=(10 * mutations,)) for client in clients]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for path in (tmp_path / "upload").rglob("*"):
        if path.is_file() and path.suffix != PART:
            content = path.read_bytes()
            assert int(content[:8]) == len(content) - 8, path
            assert len(set(content[8:])) <= 1, path
    assert not sum(client.nameless for client in clients)
    assert sum(client.whole for client in clients) > mutations
    assert sum(client.refused for client in clients)
    assert free_space.used(str(tmp_path / "upload"))[0] <= QUOTA + LOOK_BYTES + len(clients) * BLOCK


def test_many_uploads_at_once_pass_their_quota_by_nothing_in_one_daemon_and_by_one_look_in_two(tmp_path):
    for count in (1, 2):
        place = tmp_path / str(count)
        place.mkdir()
        daemons = [opened(place, upload_bytes_max=QUOTA) for _ in range(count)]

        def grow(number: int, daemons: list[Uploads] = daemons) -> None:
            uploads = daemons[number % len(daemons)]
            with contextlib.ExitStack() as closing, contextlib.suppress(NoRoom):
                fd = uploads.open(f"/upload/{number}", NEW)
                closing.callback(os.close, fd)
                for at in range(0, 2 * QUOTA, BLOCK):
                    uploads.write(fd, bytes(BLOCK), at)

        with ThreadPoolExecutor(16) as pool:
            list(pool.map(grow, range(16)))
        assert QUOTA - 16 * BLOCK <= free_space.used(str(place / "upload"))[0] <= QUOTA + (count - 1) * LOOK_BYTES
