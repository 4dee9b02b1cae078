"""Parts: a folder is a thing that somebody owns, with its driver, source, sensor, simulated device and daemons, as it has them.

A row names it: of `OWN` in `delfim.base.parts`, or of `SERVICES` in `delfim.services.suite` (docs/decisions/0015-folders.md).
"""
