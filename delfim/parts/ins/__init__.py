"""Inertial navigation systems on serial lines: VectorNav, Xsens, SBG Systems, Advanced Navigation (docs/ins.md)."""
