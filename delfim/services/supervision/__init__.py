"""The supervisor, which is the dead-man: it starts, watches, stops and confines programs, and does the last act before the
power is cut."""
