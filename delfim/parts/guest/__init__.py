"""Guests by other protocols than that of the vehicle (docs/guest.md)."""
