"""Pages that look by WebRTC, at the console's end: what the boat is asked, at what rate, and who hears its answer."""

import base64
from pathlib import Path

import msgspec
import pytest

from delfim.base.clock import ManualClock
from delfim.base.errors import Refused
from delfim.console.gateway import page_messages
from delfim.console.gateway.picturedesk import PictureDesk, PictureLooks
from delfim.console.pictures.picturelink import LiveLink, PageOffer, PictureLink
from delfim.console.pictures.picturerate import PictureRate
from delfim.console.tapes.replay import TapePlayer, open_tapes
from delfim.parts.camera import livewire, wire
from delfim.parts.camera.played import PlayedPictures
from tests.console.test_camera_page import logged
from tests.parts.camera.test_sending import KEY

PAGE = PageOffer(96, "ab" * 32, "abcd", "p" * 24)
OTHER = PAGE._replace(user="efgh")


def answer(stream: int, **more: object) -> livewire.LiveAnswer:
    ended = livewire.LiveAnswer(5, stream, livewire.WAITS, 0, 15000, 3, bytes(32), "user", "p" * 22, "")
    return ended._replace(**more)


def stream_of(live: LiveLink, at: int = 0) -> int:
    return live.offers(1, 1, 0, bytes(8))[at].stream


def test_a_page_has_one_stream_until_it_offers_another_connection() -> None:
    live = LiveLink()
    live.look(1, PAGE)
    first = stream_of(live)
    live.look(1, PAGE)
    assert stream_of(live) == first
    live.look(1, OTHER)
    assert stream_of(live) != first
    live.look(1, None)
    assert live.offers(1, 1, 0, bytes(8)) == []


def test_the_rate_is_shared_by_films_and_stills_and_never_zero() -> None:
    """0 would end a stream."""
    live = LiveLink()
    assert live.shares(900_000) == (900_000, 0)
    live.look(1, PAGE)
    assert live.shares(900_000) == (450_000, 450_000), "until it is shown, stills go on"
    live.is_shown = True
    assert live.shares(900_000) == (8_000, 892_000)
    live.look(2, OTHER)
    assert live.shares(900_000) == (8_000, 446_000)
    assert live.shares(8_000) == (8_000, 1)


def test_a_film_is_wise_on_a_good_link_alone() -> None:
    live, rate = LiveLink(), PictureRate()
    live.names = ("bow",)
    for bps, loss, wise in (
        (4e5, 0, False),
        (5e5, 0, True),
        (3e5, 0, True),
        (2e5, 0, False),
        (4e5, 0, False),
        (2e6, 0.2, False),
    ):
        rate.bps, rate.loss = bps, loss
        assert live.is_wise("bow", rate) is wise
        assert not live.is_wise("stern", rate)


def test_what_the_film_takes_counts_for_the_rate_and_only_once() -> None:
    live = LiveLink()
    live.look(1, PAGE)
    stream = stream_of(live)
    assert [live.heard(answer(stream, sent=sent)) for sent in (1000, 1000, 4000, 3000, 4500)] == [1000, 0, 3000, 0, 500]
    assert live.heard(answer(stream + 1, sent=9000)) == 0


def test_only_the_page_that_offered_hears_the_answer() -> None:
    live = LiveLink()
    live.look(1, PAGE)
    live.look(2, OTHER)
    assert live.told(answer(stream_of(live)), "10.0.0.5") is None, "the boat has not answered yet"
    page, told = live.told(answer(stream_of(live, 1), state=livewire.ANSWERED), "10.0.0.5") or (0, {})
    assert (page, told["of"], told["host"], told["port"], told["why"]) == (2, "efgh", "10.0.0.5", 15000, "")
    page, told = live.told(answer(stream_of(live), state=livewire.ENDED, why="it broke"), "10.0.0.5") or (0, {})
    assert (page, told["why"]) == (1, "it broke")
    assert live.told(answer(1234567, state=livewire.ANSWERED), "10.0.0.5") is None


def test_the_boat_is_told_twice_a_second_with_the_cookie_that_it_gave() -> None:
    sent = list[bytes]()
    link = PictureLink(KEY, sent.append, 100.0)
    link.hear(wire.told_bytes(KEY, wire.PictureTold(0, b"cookie!!", ("bow",), "", ("bow",))), 100.0)
    assert link.live.names == ("bow",)
    link.live.look(1, PAGE)
    for step in range(10):
        link.tick(100.0 + step * 0.1, hold=False)
    offers = [livewire.read_offer(KEY, each) for each in sent if each.startswith(livewire.OFFER)]
    assert [each.cookie for each in offers] == [b"cookie!!"] * 2
    assert (offers[0].payload, offers[0].certificate.hex(), offers[0].user) == (96, PAGE.certificate, PAGE.user)
    heard = link.hear_live(livewire.answer_bytes(KEY, answer(offers[0].stream, at_us=offers[1].at_us, sent=50_000)), 100.6)
    assert heard is not None
    assert link.rate._bits == 400_000
    assert link.hear_live(b"DcR1 and anything", 100.7) is None
    assert link.refused == 1


@pytest.mark.parametrize(
    "field",
    [
        {"certificate": "zz" * 32},
        {"certificate": "ab"},
        {"user": "a\r\nb"},
        {"password": "short"},
        {"payload": 128},
        {"more": 1},
    ],
)
def test_an_offer_of_another_form_is_refused(field: dict[str, object]) -> None:
    said = {"t": "see", "boat": 1, "live": PAGE._asdict() | {"shown": False} | field}
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(said, page_messages.See)
    msgspec.convert(said | {"live": PAGE._asdict()}, page_messages.See)


def test_a_page_keeps_the_picture_that_it_shows_and_nothing_else(tmp_path: Path) -> None:
    clock = ManualClock()
    tapes = open_tapes([logged(tmp_path, 1, 160)])
    desk = PictureDesk(TapePlayer(tapes, clock, lambda _: None), b"", clock, tmp_path)
    with pytest.raises(Refused, match="there is no picture"):
        desk.ask(1, page_messages.Snapshot(boat=1, jpeg="aaaa"), print)
    desk._looks[1] = PictureLooks(None)
    for wrong in ("no base64!", base64.b64encode(b"<svg>").decode()):
        with pytest.raises(Refused, match="that is no JPEG"):
            desk.ask(1, page_messages.Snapshot(boat=1, jpeg=wrong), print)
    jpeg = base64.b64encode(PlayedPictures(160, 88).picture(1)).decode()
    file = desk.ask(1, page_messages.Snapshot(boat=1, jpeg=jpeg, taken_s=86_400.25), print)
    assert file.endswith("-19700102-000000.250.jpg")
    assert Path(file).read_bytes().startswith(b"\xff\xd8\xff\xe1")
