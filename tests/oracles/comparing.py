"""In words, what is not any more as it was kept, and where that began."""

import math
from collections.abc import Callable, Iterator
from difflib import SequenceMatcher
from functools import partial
from itertools import zip_longest
from typing import Final

from tests.oracles.keeping import Lines
from tests.oracles.traces import GROUPS, Row, Trace, commands

ALIKE: Final = {
    "true": "where the boat truly is",
    "sensed": "what it sensed",
    "decided": "what it decided",
    "commanded": "what it commanded",
}
LISTED: Final = 6  # fields named for one cycle
BEFORE: Final = 4  # words of a line that are repeated ...
SHORT: Final = 100  # ... and characters of one that is told to its end
NEAR: Final = 1e-3  # of values, or of one, between machines that compute otherwise


Explain = Callable[[str, str, Lines, Lines, str], str]  # two lines, all that was kept, all of now, name: their difference


def plain(then: str, now: str, kept: Lines, here: Lines, name: str) -> str:
    """No more words than the lines have."""
    return ""


def of_lines(kept: Lines, now: Lines, explain: Explain = plain) -> list[str]:
    """What differs first of each, by name."""
    found = list[str]()
    for name in [*kept, *(name for name in now if name not in kept)]:
        if name not in now:
            found.append(f"{name}: it was kept, and is not there any more")
        elif name not in kept:
            found.append(f"{name}: it is new: it was not kept")
        elif kept[name] != now[name]:
            found.append(f"{name}: {_line(kept[name], now[name], partial(explain, kept=kept, here=now, name=name))}")
    return found


def _line(kept: list[str], now: list[str], explain: Callable[[str, str], str]) -> str:
    """The first line that differs: it is new, or gone, or another one."""
    matcher = SequenceMatcher(None, kept, now, autojunk=False)
    changes = [each for each in matcher.get_opcodes() if each[0] != "equal"]
    what, i, _, j, _ = changes[0]
    many = sum(max(each[2] - each[1], each[4] - each[3]) for each in changes)
    more = f" (the first of {many} lines that differ)" if many > 1 else ""
    if what == "insert":
        return f"new, and was not kept: {now[j]}{more}"
    if what == "delete":
        return f"kept, and not there any more: {kept[i]}{more}"
    return f"{explain(kept[i], now[j]) or _parts(kept[i], now[j])}{more}"


def _parts(then: str, now: str) -> str:
    """The words that differ of two lines, after what they begin with; bytes in hexadecimal one by one."""
    a, b = then.split(" "), now.split(" ")
    place = next((i for i, pair in enumerate(zip(a, b, strict=False)) if pair[0] != pair[1]), min(len(a), len(b)))
    if len(a) != len(b) or not place:
        return f"kept {then!r}, now {now!r}"
    before, x, y = " ".join(a[: min(place, BEFORE)]), a[place], b[place]
    before = before.rstrip(":")
    if place == len(a) - 1 and len(x) == len(y) >= 4 and not set(x + y) - set("0123456789abcdef"):
        byte = next(i for i in range(0, len(x), 2) if x[i : i + 2] != y[i : i + 2])
        return f"{before}, byte {byte // 2}: kept {x[byte : byte + 2]}, now {y[byte : byte + 2]} (kept {x}, now {y})"
    if len(then) < SHORT:
        x, y = " ".join(a[place:]), " ".join(b[place:])
    return f"{before}: kept {x}, now {y}"


def of_trace(name: str, kept: Trace, now: Trace, same_arithmetic: bool) -> str:
    """What differs first between two traces of a voyage, as far as both go; empty: nothing. Where sine and logarithm have other
    last bits, values may differ a little, and words may not."""
    if missing := [each for each in kept.names if each not in now.names]:
        return f"{name}: there is no field {' nor '.join(missing[:LISTED])} any more"
    told = _told(kept, now)
    if not same_arithmetic:
        return f"{name}: {words}" if (words := _digits(kept, now) or told) else ""
    marks = [cycle for cycle in kept.marks if cycle in now.marks]
    if all(kept.marks[cycle][0] == now.marks[cycle][0] for cycle in marks):
        return f"{name}: {told}" if told else ""
    where = _where(kept, now) or f"before cycle {next(c for c in marks if kept.marks[c] != now.marks[c])}, nobody knows where"
    return f"{name}, {where}" + (f"; {told}" if told else "")


def _told(kept: Trace, now: Trace) -> str:
    """What was said first that was not said then, or the reverse."""
    end_s = min(kept.seconds, now.seconds)
    both = [[(at_s, text) for at_s, text in each.told if at_s < end_s] for each in (kept, now)]
    for then, here in zip_longest(*both):
        if then is None or here is None or (f"{then[0]:.3f}", then[1]) != (f"{here[0]:.3f}", here[1]):
            if then and here and then[1] == here[1]:
                return f"said {here[1]!r}: kept at {then[0]:.1f} s, now at {here[0]:.1f} s"
            a, b = (f"{each[1]!r} at {each[0]:.1f} s" if each else "nothing more" for each in (then, here))
            return f"said: kept {a}, now {b}"
    if kept.seconds == now.seconds and kept.failures != now.failures:
        return f"the run's failures: kept {kept.failures}, now {now.failures}"
    return ""


def _digits(kept: Trace, now: Trace) -> str:
    """The first value that is not near the kept one."""
    for cycle in sorted(kept.ends.keys() & now.ends.keys()):
        for field, then in kept.ends[cycle].items():
            here = now.ends[cycle][field]
            if not math.isclose(then, here, rel_tol=NEAR, abs_tol=NEAR) and not (math.isnan(then) and math.isnan(here)):
                return f"{_cycle(now, cycle)}, field {field}: kept {then:g}, now {here:g}"
    return ""


def _where(kept: Trace, now: Trace) -> str:
    """The first cycle and the first group in it that differ, and what is known of its fields."""
    first = 1
    for then, here in zip(kept.rows, now.rows, strict=False):
        if then.end != here.end:
            break
        if (then.letters, then.commands) != (here.letters, here.commands):
            return _row(kept, now, then, here, first)
        first = then.end + 1
    return ""


def _row(kept: Trace, now: Trace, then: Row, here: Row, first: int) -> str:
    size, last = len(GROUPS), then.end
    place = next((i for i, (a, b) in enumerate(zip(then.letters, here.letters, strict=False)) if a != b), None)
    if place is None:
        group = "commanded"
    else:
        group = GROUPS[place % size]
        if len(then.letters) == size * (last - first + 1):
            first = last = first + place // size
    if first < last and place is not None:
        changed = [ALIKE[each] for each, a, b in zip(GROUPS, then.letters, here.letters, strict=True) if a != b]
        return f"in cycles {first} to {last} (to t = {now.at_s[last - 1]:.1f} s), {', '.join(changed)}: " + "; ".join(
            _fields(kept, now, then, group, last)
        )
    span = _cycle(now, first) if first == last else f"by {_cycle(now, last)}"
    before = GROUPS[: GROUPS.index(group)]
    still = f" ({', '.join(ALIKE[each] for each in before)}: as before)" if before else ""
    fields = "; ".join(_fields(kept, now, then, group, last))
    return f"{span}, {ALIKE[group]}{still}: {fields or 'the fields are not known'}"


def _fields(kept: Trace, now: Trace, row: Row, group: str, cycle: int) -> Iterator[str]:
    """Fields that differ, with both values where they are known."""
    told = list(commands(row, kept.told_by))
    at = cycle if len(told) > 1 else row.end
    if group == "commanded" and told:
        both = [(name, value, float(now.columns[name][at - 1])) for name, value in told[at - row.end - 1].items()]
        changed = [each for each in both if abs(each[1] - each[2]) > 5e-4 * (math.pi if each[0].endswith("_angle") else 1.0)]
        for name, then, here in changed:
            yield f"{'' if at == cycle else f'at cycle {at} '}field {name}: kept {then:.3f}, now {here:.3f}"
        if changed:
            return
    mark = min((each for each in kept.marks if each >= cycle and each in now.marks), default=0)
    end = min((each for each in kept.ends if each >= cycle and each in now.ends), default=0)
    letters = zip(kept.names, kept.marks[mark][1], now.marks[mark][1], strict=True) if mark else ()
    names = [name for name, a, b in letters if a != b and name in kept.groups[group]]
    if len(names) > 1:
        yield f"one or more of {', '.join(names[:LISTED])}" + (f" and {len(names) - LISTED} more" * (len(names) > LISTED))
    for name in names[:LISTED]:
        if end and name in kept.ends[end]:
            yield f"at {_cycle(now, end)} field {name}: kept {kept.ends[end][name]:.5g}, now {now.ends[end][name]:.5g}"
        elif len(names) == 1:
            yield f"field {name}: now {now.columns[name][cycle - 1]}"


def _cycle(trace: Trace, cycle: int) -> str:
    return f"cycle {cycle} (t = {trace.at_s[cycle - 1]:.1f} s)"
