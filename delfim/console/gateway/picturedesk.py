"""The pictures of boats, for pages that look: of the boats' cameras, or of the recording that is replayed."""

import base64
import binascii
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from delfim.base.clock import Clock
from delfim.base.errors import FormatError, Refused
from delfim.console.boats.boat import Boat
from delfim.console.boats.fleet import Fleet
from delfim.console.gateway import page_messages
from delfim.console.link.udp import Udp
from delfim.console.pictures.picturelink import HeardPicture, PageOffer, PictureLink
from delfim.console.pictures.snapshot import with_place
from delfim.console.tapes.replay import TapePlayer
from delfim.console.tapes.tape import Tape
from delfim.parts.camera import jpegblocks, livewire, wire
from delfim.parts.camera.kept import PicturesByTime, recorded
from delfim.parts.camera.table import PORTS

LOOK_S: Final = 3.0  # a page that looks says so each second
SAY_S: Final = 0.5  # between two words of why there is no picture
KEPT_S: Final = 10.0  # a picture of a recording that is older is none of this time
Tell = Callable[[dict[str, Any]], None]
Told = dict[str, Any]


class PictureLooks:
    """Pages that look at one boat."""

    def __init__(self, link: PictureLink | None) -> None:
        self.link = link
        self.pages = dict[int, tuple[Tell, float, bool]]()  # by number: until when, and whether it is seen by WebRTC
        self.last: tuple[bytes, int] | None = None  # the newest picture, and when it was taken, ms
        self.camera = ""
        self.said_s = 0.0

    def tell(self, told: Told) -> None:
        for tell, _, _ in self.pages.values():
            tell(told)

    def expect(self, now_s: float) -> None:
        """Pages that do not say again that they look are gone."""
        gone = [page for page, (_, until_s, _) in self.pages.items() if until_s < now_s]
        for page in gone:
            del self.pages[page]
            if self.link is not None:
                self.link.live.forget(page)
        if self.link is not None:
            self.link.live.is_shown = all(is_shown for _, _, is_shown in self.pages.values())


class PictureDesk:
    """`key` is the boats', empty without one. Snapshots go into `folder`."""

    def __init__(self, fleet: Fleet | TapePlayer, key: bytes, clock: Clock, folder: Path) -> None:
        self._fleet, self._key, self._clock, self._folder = fleet, wire.mac_key(key), clock, folder
        self.udp = Udp(self._hear)
        self.recorded = dict[int, dict[str, PicturesByTime]]()  # of a replay: by boat and camera
        self._shared = dict[int, bool]()  # whether its logs lie in one folder with those of another boat
        self._looks = dict[int, PictureLooks]()

    def replays(self, tapes: Sequence[Tape]) -> None:
        """The pictures beside these recordings. In a folder with the logs of several boats nobody knows whose they are. Raises
        OSError."""
        days = {number: tape.days for tape in tapes for number in tape.tracks if tape.days}
        several = Counter(day for each in days.values() for day in each)
        for number, its in days.items():
            self._shared[number] = any(several[day] > 1 for day in its)
            self.recorded[number] = recorded(day for day in its if several[day] == 1)

    def ask(self, page: int, asked: page_messages.See | page_messages.Snapshot, tell: Tell) -> str:
        """A page looks on for a while, or wants the picture as a file, whose name is returned. Raises Refused, OSError."""
        boat = self._fleet.boats.get(asked.boat)
        if boat is None:
            raise Refused(f"no boat {asked.boat}")
        if isinstance(asked, page_messages.Snapshot):
            return self._snapshot(boat, asked)
        looks = self._looks.get(boat.number) or self._begin(boat.number)
        live = asked.live
        looks.pages[page] = tell, self._clock.monotonic_s() + LOOK_S, live is not None and live.shown
        if looks.link is not None:
            offer = None if live is None else PageOffer(live.payload, live.certificate, live.user, live.password)
            looks.link.live.look(page, offer)
            looks.link.look(asked.camera)
            looks.camera = _name(looks.link.names, looks.link.camera)
        else:
            names = tuple(self.recorded.get(boat.number, {}))
            looks.camera = asked.camera if asked.camera in names else _name(names, 0)
        return ""

    def tick(self) -> None:
        """Often."""
        now_s = self._clock.monotonic_s()
        for number, looks in list(self._looks.items()):
            looks.expect(now_s)
            boat = self._fleet.boats.get(number)
            if not looks.pages or boat is None:
                del self._looks[number]
            elif looks.link is None:
                self._play(number, looks, now_s)
            else:
                assert isinstance(self._fleet, Fleet)
                looks.link.tick(now_s, hold=bool(self._fleet.is_busy(number)) or boat.has_weak_link(now_s))
                self._say(number, looks, looks.link.why(now_s), looks.link.names, now_s)

    def _begin(self, number: int) -> PictureLooks:
        link = None
        if isinstance(self._fleet, Fleet):
            address = self._fleet.address(number)
            if address[0] != "udp":
                raise Refused("this boat’s link carries no pictures: they need one by IP")
            place = ("udp", address[1], PORTS + number)
            link = PictureLink(self._key, partial(self.udp.send, place), self._clock.monotonic_s())
        self._looks[number] = PictureLooks(link)
        return self._looks[number]

    def _hear(self, address: Any, datagram: bytes) -> None:
        now_s, number = self._clock.monotonic_s(), address[2] - PORTS
        looks = self._looks.get(number)
        if looks is None or looks.link is None or not isinstance(self._fleet, Fleet):
            return
        if number not in self._fleet.boats or self._fleet.address(number)[1] != address[1]:
            return
        if livewire.is_answer(datagram):
            self._answer(number, looks, looks.link.hear_live(datagram, now_s), address[1])
            return
        picture = looks.link.hear(datagram, now_s)
        if picture is not None:
            looks.last = picture.jpeg, picture.taken_ms
            looks.camera = _name(looks.link.names, looks.link.camera)
            looks.tell(_told(number, looks, looks.link.names, looks.link.kbps) | _shown(picture, now_s))

    def _answer(self, number: int, looks: PictureLooks, answer: livewire.LiveAnswer | None, host: str) -> None:
        """The page that offered a connection hears what the boat says to it."""
        told = looks.link.live.told(answer, host) if looks.link is not None and answer is not None else None
        if told is not None and told[0] in looks.pages:
            looks.pages[told[0]][0](told[1] | {"boat": number})

    def _play(self, number: int, looks: PictureLooks, now_s: float) -> None:
        """The picture of the time that a replay shows."""
        assert isinstance(self._fleet, TapePlayer)
        kept, at_ms = self.recorded.get(number, {}), round(self._fleet.at_s * 1000)
        by_time = kept.get(looks.camera)
        found = by_time.at(at_ms) if by_time is not None else None
        if found is None or at_ms - found[0] > KEPT_S * 1000:
            why = "no picture of this time was kept" if kept else "no pictures were kept with this recording"
            if not kept and self._shared.get(number):
                why = "logs of several boats are in one folder: nobody knows whose pictures those are"
            self._say(number, looks, why, tuple(kept), now_s)
            return
        taken_ms, jpeg = found
        if looks.last is None or looks.last[1] != taken_ms:
            looks.last = jpeg, taken_ms
            width, height = jpegblocks.size_of(jpeg)
            picture = HeardPicture(jpeg, now_s - (at_ms - taken_ms) * 1e-3, taken_ms, 0, width, height)
            looks.tell(_told(number, looks, tuple(kept), 0) | _shown(picture, now_s))

    def _say(self, number: int, looks: PictureLooks, why: str, names: tuple[str, ...], now_s: float) -> None:
        if why and now_s - looks.said_s >= SAY_S:
            looks.said_s, looks.last = now_s, None
            looks.tell(_told(number, looks, names, 0) | {"why": why, "live": False})

    def _snapshot(self, boat: Boat, asked: page_messages.Snapshot) -> str:
        looks = self._looks.get(boat.number)
        if looks is None or (looks.last is None and not asked.jpeg):
            raise Refused("there is no picture")
        jpeg, taken_ms = (_read(asked.jpeg), round(asked.taken_s * 1000)) if asked.jpeg else looks.last or (b"", 0)
        self._folder.mkdir(parents=True, exist_ok=True)
        moment = time.strftime("%Y%m%d-%H%M%S", time.gmtime(taken_ms // 1000)) + f".{taken_ms % 1000:03}"
        file = self._folder / f"{''.join(each if each.isalnum() else '_' for each in boat.name)}-{looks.camera}-{moment}.jpg"
        words = f"{boat.name}, {looks.camera}"
        file.write_bytes(with_place(jpeg, boat.values.get("latitude_deg"), boat.values.get("longitude_deg"), taken_ms, words))
        return str(file)


def _read(coded: str) -> bytes:
    """A JPEG that a page brings. Raises Refused."""
    try:
        jpeg = base64.b64decode(coded, validate=True)
        jpegblocks.size_of(jpeg)
    except (binascii.Error, FormatError):
        raise Refused("that is no JPEG") from None
    return jpeg


def _name(names: tuple[str, ...], at: int) -> str:
    return names[at] if at < len(names) else ""


def _told(number: int, looks: PictureLooks, names: tuple[str, ...], kbps: int) -> Told:
    live = looks.link is not None and looks.link.is_live_wise
    return {"t": "picture", "boat": number, "camera": looks.camera, "cameras": names, "kbps": kbps, "why": "", "live": live}


def _shown(picture: HeardPicture, now_s: float) -> Told:
    return {
        "age_s": round(now_s - picture.taken_s, 3),
        "same_s": picture.same_s,
        "taken_s": picture.taken_ms / 1000,
        "jpeg": base64.b64encode(picture.jpeg).decode(),
    }
