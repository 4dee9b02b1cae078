"""The safety case: what could go wrong, what holds it, and the proof that a test would miss it (docs/safety-case.md)."""
