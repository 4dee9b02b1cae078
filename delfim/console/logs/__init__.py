"""Logs of boats, fetched for the console."""
