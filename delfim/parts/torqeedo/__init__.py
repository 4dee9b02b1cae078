"""Torqeedo motors: on TQ bus, a serial line of RS-485 each, and on TorqLink, a CAN bus each (docs/torqeedo.md)."""
