"""The voyage, as it is kept for a restart: what the operator sent, as the commands that send it again, and what the boat has
sailed since. Pure; `delfim/services/voyage_on_disk.py` writes it, `returning.py` acts on it.

The text of a kept voyage is a line of `KeptHead`, one of `VoyageState`, and one for each command: `rally`, `set` for each
changed key, and `upload` or `fence` for the plan.
"""

import hashlib
from typing import Final

import msgspec

from delfim import __version__, config
from delfim.base import tables
from delfim.base.clock import MADE_NS
from delfim.base.errors import FormatError
from delfim.base.input.unreadable import UNREADABLE
from delfim.vehicle import console
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.state import State
from delfim.vehicle.voyagestate import VoyageState

COMMANDS: Final = console.Rally | console.Set | console.Upload | console.SetFence  # besides the return


class KeptHead(msgspec.Struct, frozen=True):
    """Whose voyage it is, and when it was written last."""

    boat: str
    digest: str  # of the vehicle's file and the program
    boot: str  # of the computer, its identity
    t_ns: int
    monotonic_s: float  # of the same boot
    in_order: bool = False  # the program was told to end: the boat does not go on by itself


_kept = msgspec.json.Decoder(KeptHead)
_encode = msgspec.json.encode


def digest(settings: config.Vehicle) -> str:
    """Of all that decides what a kept voyage means: the program's version, and each value of the vehicle's file."""
    return hashlib.sha256(__version__.encode() + _encode(tables.shown(settings))).hexdigest()


def sailed(helm: Helm, state: State) -> VoyageState:
    """What the boat knows of its voyage now."""
    track, spacing_m = helm.track.remembered()
    setpoint, paused, origin = state.setpoint, helm.paused, state.origin
    return VoyageState(
        mode=state.mode.name.lower(),
        memory=helm.memory,
        paused=(paused.mode.name.lower(), paused.memory) if paused is not None else None,
        has_left_idle=state.has_left_idle,
        operator=state.operator,
        helmsman=state.helmsman,
        killed=state.killed._replace(held=()),
        heading_rad=setpoint.heading_rad,
        speed_mps=setpoint.speed_mps,
        target=setpoint.target,
        via=setpoint.via,
        override_mps=setpoint.override_mps,
        end="idle" if setpoint.end == "idle" else "hold",
        leg=setpoint.leg,
        origin=(origin.latitude_rad, origin.longitude_rad) if origin is not None else None,
        here=(state.motion.north_m, state.motion.east_m) if "position" in state.motion.has else None,
        track=track,
        spacing_m=spacing_m,
        behind=helm.plans.behind,
        stations=state.stations,
        beside=state.traffic.beside,
    )


def plan_command(helm: Helm) -> console.Plan | None:
    """The command that loads the plan aboard again. None: there is none."""
    plans = helm.plans
    if plans.mission is not None:
        return console.Upload(plans.mission)
    return console.SetFence(plans.zones) if plans.zones.keep_in or plans.zones.keep_out else None


def text(kept: KeptHead, helm: Helm, state: State, plan: bytes) -> bytes:
    """The kept voyage. `plan`: the line of `plan_command`, which is long; empty: none."""
    told = [_encode(sailed(helm, state)), _encode(console.Rally(helm.plans.rally))]
    told += [_encode(console.Set(key, value)) for key, value in helm.changed.items()]
    return b"\n".join([_encode(kept), *told, plan])


def ended(told: bytes) -> bytes:
    """The same record, of a program that was told to end. `told` was read before."""
    first, _, rest = told.partition(b"\n")
    return _encode(msgspec.structs.replace(_kept.decode(first), in_order=True)) + b"\n" + rest


class KeptVoyage(msgspec.Struct, frozen=True):
    """A kept voyage, read: what the boat is told at its start, in order."""

    back: console.Return
    sent: tuple[console.Commands, ...] = ()


def read(told: bytes, settings: config.Vehicle, own: KeptHead) -> KeptVoyage:
    """The commands of a kept voyage for this boat; `own`: this run's. A voyage that this boat must not go on with is a return
    that says why."""
    try:
        first, second, *lines = told.split(b"\n")
        kept, before = _kept.decode(first), msgspec.json.decode(second, type=VoyageState)
        sent = tuple(command for line in lines if line for command in (console.parse(line),))
    except (*UNREADABLE, FormatError, ValueError):
        return refused("the record of the voyage before it cannot be understood")
    if not all(isinstance(command, COMMANDS) for command in sent):
        return refused("the record of the voyage before it holds orders that no record has")
    has_fence = any(_fenced(command) for command in sent)
    if kept.boat != settings.boat.name:
        return refused(f"this is the disk of another boat, {kept.boat!r}: its voyage is not taken over", fence=False)
    if kept.digest != own.digest:
        words = "the boat's file or the program has changed: mission, zones, and changed parameters are not taken over"
        return refused(words, before, fence=has_fence and not kept.in_order)
    age_s = _age_s(kept, own)
    limits = settings.failsafe.restarted
    if kept.in_order or (age_s is not None and age_s > limits.within_s):
        ended = "it was ended in order" if kept.in_order else f"it was off for {age_s or 0.0:.0f} s"
        back = console.Return(before.ended(), kept.t_ns, age_s, why_not=ended if before.mode != "idle" else "")
    else:
        back = console.Return(before, kept.t_ns, age_s)
    return KeptVoyage(msgspec.structs.replace(back, fence=has_fence, mission=_mission(sent)), sent)


def refused(why: str, before: VoyageState | None = None, *, fence: bool = True) -> KeptVoyage:
    """A return that brings nothing back but a kill, and who moved as this boat does. `fence`: one was aboard, or may have
    been."""
    kept = VoyageState(killed=before.killed, beside=before.beside) if before is not None else VoyageState()
    return KeptVoyage(console.Return(kept, why_not=why, fence=fence, lost=True))


def _mission(sent: tuple[console.Commands, ...]) -> str:
    return next((command.mission.name for command in sent if isinstance(command, console.Upload)), "")


def _fenced(command: console.Commands) -> bool:
    zones = command.mission.fence if isinstance(command, console.Upload) else getattr(command, "zones", None)
    return zones is not None and bool(zones.keep_in or zones.keep_out)


def _age_s(kept: KeptHead, own: KeptHead) -> float | None:
    """How long nobody wrote; None: the clocks do not say."""
    if kept.boot == own.boot:
        return max(own.monotonic_s - kept.monotonic_s, 0.0)
    since_s = (own.t_ns - kept.t_ns) / 1e9
    return since_s if own.t_ns >= MADE_NS and since_s >= 0.0 else None
