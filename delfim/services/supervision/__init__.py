"""The supervisor, which is the dead-man: programs started, watched, stopped and confined; the last act before the power is
cut."""
