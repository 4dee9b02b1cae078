"""The operator's orders: what each does at the helm. A row in OBEYED for each command."""

import math
from collections.abc import Callable
from typing import Any, Final

from delfim import config
from delfim.base import geodesy
from delfim.base.errors import ConfigError, Refused, did_you_mean
from delfim.base.modes import Mode, mode_named
from delfim.vehicle import console
from delfim.vehicle.control.control import MODES, settings_of
from delfim.vehicle.control.modes import path
from delfim.vehicle.failsafe import failsafe
from delfim.vehicle.failsafe.failsafe import Action
from delfim.vehicle.failsafe.troubles import unstopped
from delfim.vehicle.helm import detour, setpoints
from delfim.vehicle.helm.helm import Helm
from delfim.vehicle.orders import kills
from delfim.vehicle.plans.underway import SAILS
from delfim.vehicle.state import Setpoint, TrialPieces

PUSHED_S = 1.0  # manual commands at shorter intervals are one push of the joystick


def obey(helm: Helm, command: console.Commands, now_s: float) -> None:
    """Raises DelfimError with the reason why not."""
    OBEYED[type(command)](helm, command, now_s)


def _halt(helm: Helm, command: console.Stop | console.ShutDown, now_s: float) -> None:
    """The vehicle does nothing else for a shutdown."""
    helm.taken = False
    helm.stop("operator")


def _kill(helm: Helm, command: console.Kill, now_s: float) -> None:
    helm.state.killed = after = kills.killed(helm.state.killed, command)
    if after.reason:
        helm.taken = False
        helm.stop("")


def _clear(helm: Helm, command: console.Clear, now_s: float) -> None:
    helm.state.killed = kills.cleared(helm.state.killed)
    helm.stop("operator cleared the kill")


def _leave(helm: Helm, command: console.Leave, now_s: float) -> None:
    if not command.lost:
        helm.stop(f"operator gave the boat back: {helm.state.operator or 'nobody'}")
    elif helm.state.mode is Mode.MANUAL:
        helm.release(f"no thrust: {command.lost}", now_s)


def _change_mode(helm: Helm, command: console.SetMode, now_s: float) -> None:
    wanted, setpoint = mode_named(command.mode), helm.state.setpoint
    if wanted is Mode.MANUAL:  # without thrust until a command comes
        helm.state.manual_s, setpoint = now_s, setpoint._replace(starboard=0.0, port=0.0)
    elif wanted in (Mode.HEADING, Mode.COURSE):
        setpoint = setpoints.onwards(wanted, helm.state, helm.settings.control.speed)
    elif wanted is Mode.GOTO:  # waits for a point
        setpoint = setpoint._replace(target=None, via=())
    elif wanted is Mode.TRIAL:  # an old manoeuvre is not played again
        setpoint = setpoint._replace(trial=None)
    elif command.line is not None and wanted is Mode.PATH:
        found = path.piece_before(setpoint.plan, command.line) if setpoint.plan is not None else None
        if found is None:
            raise Refused(f"path refused: the mission has no line {command.line}")
        setpoint = setpoint._replace(piece=found)
    elif command.piece is None and (way := helm.under_way()) is not None and way.is_paused and way.mode is wanted:
        _continue(helm, None, now_s)
        return
    elif wanted is Mode.PATH:
        setpoint = setpoint._replace(piece=command.piece or 0)
    helm.request(wanted, setpoint, now_s)


def _head(helm: Helm, command: console.Heading | console.Course, now_s: float) -> None:
    helm.request(*setpoints.headed(command, helm.state, helm.settings.control.speed), now_s)


def _set_speed(helm: Helm, command: console.SetSpeed, now_s: float) -> None:
    asked_mps, speeds = command.speed_mps, helm.settings.control.speed
    if command.speed_pct is not None:
        asked_mps = command.speed_pct / 100.0 * speeds.max_mps
    speed_mps = setpoints.speed(asked_mps, speeds)
    override_mps = None if asked_mps is None else speed_mps
    helm.state.setpoint = helm.state.setpoint._replace(speed_mps=speed_mps, override_mps=override_mps)


def _go(helm: Helm, command: console.Goto, now_s: float) -> None:
    target = setpoints.target(command, helm.state, helm.settings.control)
    _go_to(helm, helm.state.setpoint._replace(target=target, end=command.end or helm.settings.control.goto.end), now_s)


def _go_to(helm: Helm, setpoint: Setpoint, now_s: float) -> None:
    """Straight there, or, where zones are in the way, round them once a way is found: meanwhile goto waits."""
    setpoint = setpoint._replace(via=())
    found = detour.begun(helm.plans.fence, helm.state.motion, setpoint, helm.state.orderer)
    helm.request(Mode.GOTO, setpoint._replace(target=None) if found else setpoint, now_s)
    helm.detour = found
    if found is not None:
        helm.note(f"goto: {found.why}: a way round is looked for")


def _pause(helm: Helm, command: console.Pause, now_s: float) -> None:
    """Never refused under way: where the boat cannot hold, it stops."""
    state = helm.state
    if state.mode is Mode.IDLE:
        raise Refused("pause refused: the boat is idle")
    if state.mode is Mode.HOLD:
        return
    leg = f" on leg {helm.memory.leg + 1}" if state.mode is Mode.PLAY else ""
    why = f"{state.orderer} paused {state.mode.name.lower()}{leg}"
    mode, reason = failsafe.fallback(helm.possible(Action.HOLD), why, state.motion.has, state.setpoint)
    if not state.helmsman:
        helm.troubles, helm.taken = failsafe.overruled(helm.troubles), False
    helm.enter(mode, reason)


def _continue(helm: Helm, command: console.Continue | None, now_s: float) -> None:
    paused, setpoint = helm.paused, helm.state.setpoint
    if paused is None:
        raise Refused("continue refused: nothing is paused")
    mode, memory = paused.mode, paused.memory
    if mode is Mode.GOTO and setpoint.via:
        _go_to(helm, setpoint, now_s)
        return
    if mode in SAILS and (setpoint.plan is None or setpoint.plan.number != paused.number):
        raise Refused("continue refused: the mission has changed since the pause; choose the mode again")
    # The track grew, or another leg was chosen.
    afresh = mode is Mode.HOME or (mode is Mode.PLAY and setpoint.leg != memory.leg)
    helm.request(mode, setpoint, now_s, None if afresh else memory)


def _load(helm: Helm, command: console.Plan, now_s: float) -> None:
    if isinstance(command, console.LoadMission) and command.more:
        helm.plans.gather(command)
    else:
        helm.plans.accept(command)


def _reset(helm: Helm, command: console.Reset, now_s: float) -> None:
    if (turning := unstopped(helm.settings, helm.state, now_s)) or helm.state.mode is not Mode.IDLE:
        raise Refused(f"reset refused: {' and '.join(turning)} still turning" if turning else "reset refused: stop first")
    helm.propulsion.reset(command.node)


def _choose(helm: Helm, command: console.Leg, now_s: float) -> None:
    setpoint = helm.state.setpoint._replace(leg=command.leg)
    if (reason := MODES[Mode.PLAY].lacks(setpoint)) is not None:
        raise Refused(f"leg refused: {reason}")
    if helm.state.mode is Mode.PLAY:
        helm.request(Mode.PLAY, setpoint, now_s)
    helm.state.setpoint = helm.state.setpoint._replace(leg=command.leg)


def _push(helm: Helm, command: console.Manual, now_s: float) -> None:
    """Manual thrust. After the failsafe took it away, the operator first lets go: by silence, or by asking for none."""
    state, starboard, port = helm.state, command.starboard, command.port
    pushed, state.manual_s = now_s - state.manual_s < PUSHED_S, now_s
    if state.mode is Mode.MANUAL and not starboard and not port:
        helm.taken = False
    if helm.taken and (pushed or state.mode is Mode.MANUAL):
        raise Refused(f"manual refused: {state.reason}; release the joystick for {PUSHED_S:g} s or choose a mode")
    if state.mode is not Mode.MANUAL:
        helm.request(Mode.MANUAL, state.setpoint._replace(starboard=starboard, port=port), now_s)
    state.setpoint = state.setpoint._replace(starboard=starboard, port=port)


def _try(helm: Helm, command: console.Try, now_s: float) -> None:
    """A manoeuvre of a trial. One that does not begin the mode is refused once anything ended it."""
    state, rows = helm.state, helm.settings.thrusters
    if state.mode is not Mode.TRIAL and not command.begin:
        raise Refused(f"trial refused: the boat is in mode {state.mode.name.lower()}: {state.reason}")
    turning = sum(row.steer is not None for row in rows)
    if any(len(parts) != len(rows) + turning for _, parts in command.pieces):
        turns = f", and one for each of {turning} that turn" if turning else ""
        raise Refused(f"trial refused: each piece has a part for each of {len(rows)} thrusters{turns}")
    played = state.setpoint.trial
    if state.mode is Mode.TRIAL and played is not None and played.number == command.number:
        state.manual_s = now_s
        return
    if state.origin is None:
        raise Refused("trial refused: no position yet")
    middle = geodesy.to_plane(state.origin, math.radians(command.latitude_deg), math.radians(command.longitude_deg))
    turn_radps = math.radians(command.turn_dps)
    trial = TrialPieces(command.number, command.pieces, *middle, command.radius_m, turn_radps, command.comes_back)
    setpoint = state.setpoint._replace(trial=trial)
    if state.mode is not Mode.TRIAL:
        helm.request(Mode.TRIAL, setpoint, now_s)
    state.manual_s, state.setpoint = now_s, setpoint
    helm.memory = MODES[Mode.TRIAL].enter(state.motion, setpoint, helm.limits)


def _overrule(helm: Helm, command: console.Overrule, now_s: float) -> None:
    state, guard = helm.state, helm.settings.traffic.guard
    if not guard.enabled:
        raise Refused("overrule refused: the boat gives way to nobody, by its file")
    is_over = now_s < state.overruled_s
    state.overruled_s = now_s if is_over else now_s + guard.overruled_s
    helm.note(f"traffic: {'the guard works again' if is_over else f'overruled for {guard.overruled_s:.0f} s'}: {state.orderer}")


def _arm(helm: Helm, command: console.Arm, now_s: float) -> None:
    if helm.state.mode is Mode.IDLE and (reason := helm.unfit()) is not None:
        raise Refused(f"arm refused: {reason}")
    helm.state.armed = True


def _set(helm: Helm, command: console.Set, now_s: float) -> None:
    """A value of the tables that may change while the boat sails. Raises Refused with the allowed values."""
    try:
        helm.settings = settings = config.changed(helm.settings, command.key, command.value)
    except ConfigError as error:
        raise Refused(f"set refused: {error.key}: {error.reason}; {error.allowed}") from None
    helm.changed[command.key] = command.value
    helm.limits = helm.plans.limits = settings_of(settings)
    if command.key.startswith("failsafe."):
        helm.rules = failsafe.Rules(settings, helm.rules.of_parts)
    else:
        helm.rules.settings = settings


def _order(helm: Helm, command: console.PartOrder, now_s: float) -> None:
    """An order of a part; what that asks of the boat goes through the same door as the operator's own."""
    if helm.state.killed.reason:  # it may turn something that people are near
        raise Refused(f"order refused: kill: {helm.state.killed.reason}")
    if (found := helm.orders.get(command.name)) is None:
        others = did_you_mean(command.name, helm.orders) or f"; there are {', '.join(helm.orders) or 'none'}"
        raise Refused(f"order refused: there is no order {command.name!r}{others}")
    if (meant := found.carry_out(command.values, helm.settings, now_s)) is not None:
        obey(helm, meant, now_s)


OBEYED: Final[dict[type[console.Command], Callable[[Helm, Any, float], None]]] = {
    console.Alive: lambda helm, command, now_s: None,  # the loop has already noted that the console is there, ...
    console.Stop: _halt,
    console.Kill: _kill,
    console.Clear: _clear,
    console.Leave: _leave,
    console.SetMode: _change_mode,
    console.Manual: _push,
    console.Try: _try,
    console.Actuate: lambda helm, command, now_s: helm.alone.ask(command, now_s),
    console.Heading: _head,
    console.Course: _head,
    console.SetSpeed: _set_speed,
    console.Goto: _go,
    console.Pause: _pause,
    console.Continue: _continue,
    console.LoadMission: _load,
    console.Upload: _load,
    console.Play: lambda helm, command, now_s: helm.request(Mode.PLAY, helm.state.setpoint._replace(leg=command.leg), now_s),
    console.Leg: _choose,
    console.Unload: lambda helm, command, now_s: helm.plans.unload(),
    console.SetFence: _load,
    console.Rally: lambda helm, command, now_s: helm.plans.call_at(command.points),
    console.Take: lambda helm, command, now_s: None,  # ... or commands
    console.Overrule: _overrule,
    console.Arm: _arm,
    console.Reset: _reset,
    console.Set: _set,
    console.PartOrder: _order,
    console.ShutDown: _halt,
}
