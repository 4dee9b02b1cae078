"""The second auditor: it judges logs by what the documents promise, and shares no code with the boat whose logs they are.

Everything here was written from docs/failsafe.md, docs/log-format.md and the pages that they link to, without a look at
delfim/vehicle, and imports nothing from there: a mistake in the boat's program is not made here again.
"""
