"""Logs read ashore: found, fetched, tabulated, plotted, exported, repaired."""
