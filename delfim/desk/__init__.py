"""Reads a boat's sensors at the desk, for `delfim sensors`."""
