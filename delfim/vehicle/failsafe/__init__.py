"""Troubles, what the boat does for each, and the checks before it leaves idle (docs/failsafe.md)."""
