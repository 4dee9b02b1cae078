"""The state log: its fields, its records and events, and the figures of latency (docs/log-format.md)."""
