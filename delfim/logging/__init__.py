"""Logs that survive: liblog, the state log, the black box, and the tools that read them afterwards."""
