"""The contracts of the design, measured on this machine: `delfim bench`. Runs from a checkout; a boat does not need it."""
