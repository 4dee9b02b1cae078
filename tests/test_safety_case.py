"""The safety case: what its check finds, when a proof is stale, and that its page is that of its records."""

import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from safety import page, proofs
from safety.case import KINDS, RECORDS, Case, Link, holes, read
from safety.proofs import digest, missing, prove, unproven

ROOT = Path(__file__).parents[1]


def test_page_and_pictures_are_what_the_records_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    assert page.stale(read()) == [], "run: make safety"
    files = page.made(read()).keys()
    assert set(page.PICTURES.glob("safety-*")) == files - {page.PAGE}


def told(*changes: tuple[str, Any]) -> Case:
    """A small case, with other values at these places."""
    link = {"code": "a.py", "change": "f | return x | return None", "test": "test_a.py::test_f"}
    unsafe = {"id": "U1", "kind": "given", "when": "w", "hazards": ["H1"], "constraint": "c", "held": [link]}
    others = dict.fromkeys(set(KINDS) - {"given"}, "because")
    case: dict[str, Any] = {
        "about": "a",
        "kept": "k",
        "limits": "l",
        "losses": {"L1": "a loss"},
        "hazards": {"H1": {"is": "a hazard", "losses": ["L1"]}},
        "controllers": {name: {"is": name, "place": [0, 0]} for name in ("loop", "boat")},
        "actions": {"thrust": {"by": "loop", "to": "boat", "does": "Turns", "unsafe": [unsafe], "harmless": others}},
    }
    for place, value in changes:
        *way, last = place.split("/")
        at = case
        for step in way:
            at = at[int(step)] if isinstance(at, list) else at[step]
        at[last] = value
    return msgspec.convert(case, Case)


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        ("hazards/H1/losses", ["L1", "L9"], ["hazard H1: there is no loss L9"]),
        ("losses/L2", "another", ["loss L2: no hazard leads to it"]),
        ("hazards/H2", {"is": "b", "losses": ["L1"]}, ["hazard H2: no unsafe action leads to it"]),
        ("actions/thrust/by", "nobody", ["thrust: there is no nobody"]),
        ("controllers/boat/hears", {"x": "y"}, ["boat: there is no x"]),
        ("actions/thrust/harmless", {}, [f"thrust: nothing about '{kind}'" for kind in KINDS if kind != "given"]),
        ("actions/thrust/harmless/given", "because", ["thrust: 'given' is harmless and is not"]),
        ("actions/thrust/unsafe/0/hazards", ["H1", "H7"], ["U1: there is no hazard H7"]),
        ("actions/thrust/unsafe/0/held", [], ["U1: no function and no test holds it: c"]),
        (
            "actions/thrust/unsafe",
            [msgspec.to_builtins(each) for each in told().actions["thrust"].unsafe] * 2,
            ["U1 stands twice"],
        ),
    ],
)
def test_what_the_records_leave_out_is_said(place: str, value: object, words: list[str]) -> None:
    assert holes(told()) == []
    assert holes(told((place, value))) == words


@pytest.mark.parametrize(
    ("place", "value"), [("held", [{}]), ("hazards", []), ("constraint", ""), ("kind", "sometimes"), ("by", "me")]
)
def test_what_is_no_record_is_refused(place: str, value: object) -> None:
    with pytest.raises(msgspec.ValidationError):
        told((f"actions/thrust/unsafe/0/{place}", value))


CODE = "def f(x):\n    return x + 1\n\n\ndef g(x):\n    return x\n"
TEST = """from a import f

ONE = 1

def two():
    return ONE + 1

def test_f():
    assert f(1) == two()

def test_g(): ...
"""


@pytest.fixture
def link(tmp_path: Path) -> Link:
    code, test = tmp_path / "a.py", tmp_path / "test_a.py"
    code.write_text(CODE)
    test.write_text(TEST)
    return Link(str(code), "f | return x + 1 | + → -", f"{test}::test_f")


@pytest.mark.parametrize(
    ("place", "was", "now", "words"),
    [
        ("code", "a.py", "b.py", "there is no file"),
        ("test", "test_a.py", "test_b.py", "there is no file"),
        ("change", "f |", "h |", "has no function h"),
        ("change", "x + 1", "x + 2", "has no change 'f | return x + 2 | + → -'"),
        ("change", "+ → -", "+ → *", "has no change"),
        ("test", "test_f", "test_h", "has no test test_h"),
        ("test", "::test_f", "", "has no test (none is named)"),
        ("test", "test_f", "two", "has no test two"),
    ],
)
def test_a_link_to_nothing_is_said(link: Link, place: str, was: str, now: str, words: str) -> None:
    assert missing(link) == ""
    wrong = msgspec.structs.replace(link, **{place: getattr(link, place)[::-1].replace(was[::-1], now[::-1], 1)[::-1]})
    assert words in missing(wrong)


@pytest.mark.parametrize(
    ("file", "was", "now", "is_stale"),
    [
        ("a.py", "x + 1", "1 + x", True),
        ("a.py", "return x\n", "return 2\n", False),
        ("a.py", "def f", "\n\ndef f", False),
        ("test_a.py", "f(1) ==", "f(1) >=", True),
        ("test_a.py", "ONE = 1", "ONE = 2", True),
        ("test_a.py", "ONE + 1", "1 + ONE", True),
        ("test_a.py", "def test_g(): ...", "def test_g(): assert True", False),
    ],
)
def test_a_proof_is_stale_when_its_function_or_what_its_test_uses_is_edited(link, tmp_path, file, was, now, is_stale):
    kept = {proofs.key(link): digest(link)}
    assert (unproven([link], kept), unproven([link], {})) == ([], [link])
    text = (tmp_path / file).read_text()
    (tmp_path / file).write_text(text.replace(was, now))
    proofs.source.cache_clear()
    assert unproven([link], kept) == ([link] if is_stale else [])


@pytest.mark.long
def test_a_change_that_the_test_does_not_notice_is_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    test = "tests/vehicle/test_gate.py::test_a_stop_is_immediate"
    noticed = "limited | if not run or len(thrust) != len(rates) or not math.isfinite(sum(thrust, dt_s)): | not run → run"
    unseen = "limited | part = was + change | + → -"
    links = [Link("delfim/vehicle/propulsion/gate.py", change, test) for change in (noticed, unseen)]
    assert [against for _, against in prove(links)] == ["", "the test does not notice the change"]


def test_the_records_are_of_forty_unsafe_actions_at_least_and_of_each_kind() -> None:
    case = msgspec.convert(tomllib.loads((ROOT / RECORDS).read_text()), Case)
    assert len(list(case.unsafe())) >= 40
    assert {each.kind for each in case.unsafe()} == set(KINDS)
