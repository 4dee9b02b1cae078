"""The troubles of other vessels: near, close, more than the boat can heed, and silence of their AIS."""

from delfim.base.modes import Mode
from delfim.vehicle.failsafe.troubles import Look
from delfim.vehicle.target import NEVER_S


def near(look: Look) -> str | None:
    """The guard has the hysteresis, and words of its own while it moves the boat."""
    return _of_level(look, "near")


def close(look: Look) -> str | None:
    return _of_level(look, "danger")


def _of_level(look: Look, level: str) -> str | None:
    now, place = look.state.traffic, look.state.reference
    if not now.dangers:
        return None
    if level == "near" and now.order is not None:
        away = f"; {place.distance_m:.0f} m from its place" if look.state.mode is Mode.HOLD and place.distance_m else ""
        return now.order.words + away
    words, cannot = [each.words for each in now.dangers if each.level == level], now.guard.startswith("cannot")
    if not words:
        return now.guard if cannot and level == "near" else None
    return f"{words[0]}{f', and {len(words) - 1} more' if len(words) > 1 else ''}{f'; {now.guard}' if cannot else ''}"


def unclear(look: Look) -> str | None:
    """The look-out and the guard have the words."""
    return look.state.traffic.unjudged or look.state.traffic.unclear or None


def silent(look: Look) -> str | None:
    now, limits = look.state.traffic, look.settings.failsafe.ais_silent
    own_age_s, age_s = look.now_s - now.own_s, look.now_s - now.heard_s
    if look.settings.traffic.mmsi and now.own_s == now.heard_s == NEVER_S and look.state.mode is not Mode.IDLE:
        return "AIS never heard, not even the own transponder: other vessels are not seen"
    if now.own_s > NEVER_S:
        is_silent = own_age_s > limits.own_s and age_s > limits.own_s
        return f"AIS silent: own transponder not heard for {own_age_s:.0f} s" if is_silent else None
    is_silent = now.heard_s > NEVER_S and age_s > limits.after_s
    return f"AIS silent for {age_s:.0f} s: other vessels are not seen" if is_silent else None
