"""Control modes, one file each, and the multiplexer `control.py` with the one door by which a mode is entered."""
