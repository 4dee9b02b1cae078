"""The modes, a file each; `control.py` is the door to them (docs/control.md)."""
