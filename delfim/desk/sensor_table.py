"""The table of `delfim sensors`: the device chosen for each kind, what was heard on each port and bus, and how often."""

import math
from collections.abc import Iterator
from typing import Any, Final

from delfim import config
from delfim.desk.listen import SensorsTold

KINDS: Final = {  # of a source, as they stand in the table
    "position": lambda v: f"{_place(v[0], 'NS')} {_place(v[1], 'EW')}",
    "velocity": lambda v: f"{math.hypot(*v):.2f} m/s" + _course(v),
    "heading": lambda v: f"{_degrees(v[0])} deg",
    "rate": lambda v: f"{math.degrees(v[0]):+.1f} deg/s",
    "quality": lambda v: f"fix {v[0]}, {v[1]} satellites",
}
STILL_MPS: Final = 0.1


def table(settings: config.Vehicle, where: str, before: SensorsTold, now: SensorsTold) -> list[str]:
    """Lines for the terminal; rates are computed between the two readings."""
    used = f"; it navigates by {now.source}" if now.source else ""
    lines = [f"{settings.boat.name}: {where}{used}", "", f"{'source':10} {'kind':14} {'believed':18} {'age':>7}  value"]
    for source in settings.navigation.sources:
        if source in now.troubles:
            lines.append(f"{source:10} {now.troubles[source]}")
        lines += _believed(source, now)
    lines += ["", f"{'heard on':22} {'from':18} {'age':>7}  a second"]
    passed_s = max(now.at_s - before.at_s, 1e-3)
    for name, figures in now.figures.items():
        lines += _devices(name, figures, before.figures.get(name, {}), passed_s, now.troubles)
    if now.measured:
        lines += ["", *(f"{name:24} {value:.3f}" for name, value in sorted(now.measured.items()))]
    return lines


def _believed(source: str, now: SensorsTold) -> Iterator[str]:
    """A row for each kind with a chosen device or a known value."""
    chosen = {kind: _who(told) for kind, told in now.figures.get(source, {}).get("kinds", {}).items()}
    for kind in dict.fromkeys([*chosen, *KINDS]):
        who, age_s = chosen.get(kind, (None, None))
        value = now.values.get((source, kind))
        if who is None and (value is None or chosen):
            continue
        said = KINDS[kind](value) if value is not None and kind in KINDS else ""
        yield f"{source:10} {kind:14} {'' if who is None else who!s:18} {_age(age_s)}  {said}".rstrip()


def _who(told: Any) -> tuple[Any, float | None]:
    """The chosen device and its age: sources name it in their own ways."""
    if isinstance(told, dict):
        return told.get("talker", told.get("node")), told.get("age_s")
    return told[0], told[1]


def _devices(
    name: str, now: dict[str, Any], before: dict[str, Any], passed_s: float, troubles: dict[str, str]
) -> Iterator[str]:
    """Rows of a source: its ports, or the devices on its bus."""
    for port, told in now.get("ports", {}).items():
        counted = before.get("ports", {}).get(port, {})
        ages = [age_s for talker, age_s in now.get("talkers", {}).items() if talker.startswith(f"{port}:")]
        rates = _rates(told["heard"], counted.get("heard", {}), passed_s)
        yield f"{f'{name} {port}':22} {'':18} {_age(min(ages, default=None))}  {rates or 'nothing'}"
        if refused := _rates(told["refused"], counted.get("refused", {}), passed_s):
            yield f"{'':49}  refused: {refused}"
        for trouble in filter(None, (told.get("garbled"), troubles.get(port))):
            yield f"{'':49}  {trouble}"
    for address, (age_s, frames, device) in now.get("sources", {}).items():
        rate = (frames - before.get("sources", {}).get(address, (0.0, 0, ""))[1]) / passed_s
        yield f"{f'{name} {address}':22} {device:18} {_age(age_s)}  {rate:.1f} messages"
    for node, device in now.get("devices", {}).items():
        yield f"{f'{name} {node}':22} {'':18} {_age(device['age_s'])}  health {device['health']}"
    for node, compass in now.get("compasses", {}).items():
        told, flat = compass["calibration"], " is taken to lie flat" if compass["flat"] else ""
        words = told if isinstance(told, str) else ", ".join(f"{key} = {value}" for key, value in told.items())
        yield f"{'':49}  compass {node}{flat}: {words}"
    if not any(key in now for key in ("ports", "sources", "devices")) and "messages" in now:
        yield f"{name:22} {'':18} {'':>7}  {(now['messages'] - before.get('messages', 0)) / passed_s:.1f} messages"


def _rates(now: dict[str, int], before: dict[str, int], passed_s: float) -> str:
    """The rate of each count, the silent ones left out."""
    rates = {name: (count - before.get(name, 0)) / passed_s for name, count in now.items()}
    return ", ".join(f"{name} {rate:.1f}" for name, rate in rates.items() if rate > 0.0)


def _age(age_s: float | None) -> str:
    return f"{'-':>7}" if age_s is None else f"{age_s:5.1f} s"


def _place(angle_rad: float, sides: str) -> str:
    return f"{abs(math.degrees(angle_rad)):.6f} {sides[angle_rad < 0.0]}"


def _course(v: tuple[float, ...]) -> str:
    return f" to {_degrees(math.atan2(v[1], v[0]))}" if math.hypot(*v) > STILL_MPS else ""


def _degrees(angle_rad: float) -> str:
    return f"{round(math.degrees(angle_rad) * 10.0) % 3600 / 10.0:05.1f}"
