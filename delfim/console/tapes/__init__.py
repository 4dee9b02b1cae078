"""Recordings on the console: sessions and logs of boats, played again."""
