"""The critical program: navigation in, control, propulsion out. Start reading at `loop.py`."""
