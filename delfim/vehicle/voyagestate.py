"""What a boat knows of its own voyage, for the time after a restart. Data, no behaviour."""

from typing import Annotated, Literal

import msgspec

from delfim.base.modes import mode_named
from delfim.vehicle.control.memory import Memory
from delfim.vehicle.plans.mission import ROWS
from delfim.vehicle.state import Killed, Setpoint, Waypoint
from delfim.vehicle.target import BESIDE_MAX

TRACK_MAX = 1500  # points, as `control.home.points` allows
Rows = Annotated[int, msgspec.Meta(ge=0, le=1_000_000)]


class VoyageState(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Places are in metres of the local plane at `origin`, north and east."""

    mode: Annotated[str, msgspec.Meta(max_length=16)] = "idle"
    memory: Memory = Memory()  # of the mode
    paused: tuple[str, Memory] | None = None  # the mode that a hold interrupted
    has_left_idle: bool = False  # since the voyage began
    operator: Annotated[str, msgspec.Meta(max_length=100)] = ""
    helmsman: Annotated[str, msgspec.Meta(max_length=100)] = ""  # who does not get the boat back by itself
    killed: Killed = Killed()
    heading_rad: float = 0.0  # set points, as in `Setpoint`
    speed_mps: float = 0.0
    target: Waypoint | None = None
    via: tuple[Waypoint, ...] = ()
    override_mps: float | None = None
    end: Literal["hold", "idle"] = "hold"
    leg: int = 0
    origin: tuple[float, float] | None = None  # of the local plane: latitude and longitude, rad
    here: tuple[float, float] | None = None
    track: Annotated[tuple[tuple[float, float], ...], msgspec.Meta(max_length=TRACK_MAX)] = ()  # driven, oldest first
    spacing_m: Annotated[float, msgspec.Meta(gt=0.0)] = 5.0  # of its points
    behind: tuple[Rows, Rows] = (0, 0)  # legs and pieces of the mission that the fence forbids, and the boat had behind it
    stations: Annotated[tuple[tuple[Rows, bool], ...], msgspec.Meta(max_length=ROWS)] = ()  # as in `State`
    beside: Annotated[tuple[str, ...], msgspec.Meta(max_length=BESIDE_MAX)] = ()  # keys of vessels that came along

    def __post_init__(self) -> None:
        for name in (self.mode, self.paused[0] if self.paused is not None else self.mode):
            mode_named(name)

    def ended(self) -> "VoyageState":
        """What is left of a voyage that is over: who commands, a kill, the transponder aboard, what a fence forbade of the
        mission, its samples, and nothing that moves."""
        stations = self.stations
        return VoyageState(
            operator=self.operator, killed=self.killed, behind=self.behind, stations=stations, beside=self.beside
        )

    def wanted(self, now: Setpoint) -> Setpoint:
        """The set points of the voyage, with the plan that is aboard now."""
        return now._replace(
            heading_rad=self.heading_rad,
            speed_mps=self.speed_mps,
            target=self.target,
            via=self.via,
            override_mps=self.override_mps,
            end=self.end,
            leg=self.leg,
        )
