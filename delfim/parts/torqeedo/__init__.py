"""Torqeedo motors on TQ bus, a serial line of RS-485 each (docs/torqeedo.md)."""
