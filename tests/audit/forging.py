"""A forged run for the tests of the auditor: forty quiet seconds in heading mode, and whatever a test changes in them."""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from delfim import config
from delfim.audit.evidence import TROUBLES, Evidence, Sent
from delfim.base.modes import Mode

VEHICLE = Path(__file__).parents[2] / "etc/delfimx.toml"
COUNT, STEP_S, START_S = 200, 0.2, 100.0  # of records
BEGAN_NS = 1_262_304_000_000_000_000
LEFT_S = START_S + 2.0  # the boat left idle
HEADING = {"command": "heading", "heading_deg": 90.0, "speed_mps": 1.0}


@cache
def settings(*overrides: str) -> dict[str, Any]:
    told: dict[str, Any] = msgspec.to_builtins(config.load(VEHICLE, overrides))
    return told


class Forged:
    """`at(101.0)` is the place of the record of that time. What is set in `columns` and `events` is judged."""

    def __init__(self, *overrides: str) -> None:
        self.settings = settings(*overrides)
        self.t_s = START_S + STEP_S * np.arange(COUNT)
        stamp = BEGAN_NS + np.rint(self.t_s * 1e9).astype(np.int64)
        under_way = self.t_s >= LEFT_S
        unknown, ones = np.full(COUNT, np.nan), np.ones(COUNT)
        wave = 0.001 * np.sin(np.arange(COUNT))  # a sensor never says the same twice
        command = np.where(under_way, np.minimum(0.4, 0.1 * (1 + np.arange(COUNT) - self.at(LEFT_S))), 0.0)
        self.columns: dict[str, Any] = {
            **dict.fromkeys(("t0", "t1", "t2", "t3", "t4"), stamp),
            "monotonic_s": self.t_s,
            "cycle": 1 + np.arange(COUNT),
            "run": under_way,
            "troubles": np.zeros(COUNT, int),
            "mode": np.where(under_way, int(Mode.HEADING), int(Mode.IDLE)),
            "latitude": np.radians(38.69 * ones) + 1e-9 * wave,
            "longitude": np.radians(-9.21 * ones),
            "north": wave,
            "east": wave,
            "north_speed": wave,
            "east_speed": wave,
            "yaw_rate": wave,
            "heading": np.radians(90.0) + wave,
            "reference_heading": np.radians(90.0 * ones),
            "order_course": unknown,
            "satellites": 10 * ones,
            "fix": 3 * ones,
            "accuracy": unknown,
            "corrections_age": unknown,
            "starboard_charge": 0.9 * ones,
            "port_charge": 0.8 * ones,
            "starboard_voltage": 54.0 * ones,
            "console_s": self.t_s - 0.5,
            "guest_s": np.full(COUNT, -1e9),
            "watchdog_s": self.t_s - 0.1,
        }
        for name in ("starboard", "port"):
            self.columns |= {f"{name}_command": command.copy(), f"{name}_rpm": 1200.0 * command}
            self.columns[f"{name}_rpm_measured"] = 1200.0 * command
        self.events = list[dict[str, Any]]()
        self.order(LEFT_S, HEADING)
        self.mode(LEFT_S, "heading", "operator")
        self.boxes: dict[str, list[Sent]] = {}
        self.box_events: list[Mapping[str, Any]] = []

    def at(self, t_s: float) -> int:
        return round((t_s - START_S) / STEP_S)

    def since(self, t_s: float, until_s: float = 1e9) -> Any:
        """Which records are from this time on, and before the other."""
        return (self.t_s > t_s - 1e-6) & (self.t_s < until_s - 1e-6)

    def event(self, t_s: float, event: str, **more: Any) -> None:
        self.events.append({"event": event, "t_ns": BEGAN_NS + round(t_s * 1e9), "monotonic_s": t_s, **more})

    def order(self, t_s: float, value: Mapping[str, Any], refused: str = "", operator: str = "local") -> None:
        self.event(t_s, "command", at_s=t_s, value=value, refused=refused, operator=operator)

    def mode(self, t_s: float, name: str, reason: str) -> None:
        """The mode changed; records from then on say so. In idle nothing is commanded."""
        self.event(t_s, "mode", value=name, reason=reason)
        its = self.since(t_s)
        self.columns["mode"] = np.where(its, int(Mode[name.upper()]), self.columns["mode"])
        if name == "idle":
            self.command(t_s, 0.0)

    def command(self, t_s: float, part: float) -> None:
        """Both thrusters are commanded this from now on, and do it."""
        its = self.since(t_s)
        for name in ("starboard", "port"):
            for key, value in (("command", part), ("rpm", 1200.0 * part), ("rpm_measured", 1200.0 * part)):
                self.columns[f"{name}_{key}"] = np.where(its, value, self.columns[f"{name}_{key}"])
        self.columns["run"] = np.where(its, part != 0.0, self.columns["run"])

    def trouble(self, name: str, t_s: float, words: str, action: str, over_s: float = 0.0) -> None:
        """A note, and the bit of the records, to `over_s` or to the end."""
        self.event(t_s, "note", value=f"{name}: {words}: {action}")
        if over_s:
            self.event(over_s, "note", value=f"{name}: over")
        bit = 1 << TROUBLES.index(name)
        self.columns["troubles"] = np.where(
            self.since(t_s, over_s or 1e9), self.columns["troubles"] | bit, self.columns["troubles"]
        )

    def without(self, t_s: float, until_s: float, *, cycles_lost: bool = False) -> None:
        """There are no records in this time: navigation is silent, or the log was not written."""
        kept = ~self.since(t_s, until_s)
        cycle = self.columns["cycle"]
        self.columns = {name: column[kept] for name, column in self.columns.items()}
        self.t_s = self.t_s[kept]
        if not cycles_lost:
            self.columns["cycle"] = cycle[: len(self.t_s)]

    def frames(self) -> None:
        """A black box as the propellers of DelfimX fill it."""
        its = list[Sent]()
        for i, t_ns in enumerate(self.columns["t3"]):
            for address, name in enumerate(("starboard", "port")):
                rpm, measured = (round(float(self.columns[f"{name}_{key}"][i])) for key in ("rpm", "rpm_measured"))
                its.append(
                    Sent(
                        int(t_ns) - 150_000_000,
                        (0x1019_0001, 0x1019_1001)[address],
                        measured.to_bytes(2, "little", signed=True).rjust(4, b"\0") + bytes(4),
                    )
                )
                its.append(Sent(int(t_ns), 0x40 + address, rpm.to_bytes(2, "little", signed=True) + bytes([rpm != 0, i % 256])))
        self.boxes["can0"] = its

    def evidence(self) -> Evidence:
        start: Sequence[dict[str, Any]] = [{"event": "start", "t_ns": BEGAN_NS, "monotonic_s": 0.0, "settings": self.settings}]
        told = sorted(self.events, key=lambda each: float(each["t_ns"]))  # as they were written
        return Evidence("forged", self.columns, [*start, *told], self.boxes, self.box_events)
