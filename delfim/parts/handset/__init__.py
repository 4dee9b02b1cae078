"""Operators aboard: the hand-set of a radio control, and a kill switch (docs/handset.md)."""
