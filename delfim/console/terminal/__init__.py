"""The operator's programs in a terminal: `delfim can`, `drive`, `describe`, and the live view."""
