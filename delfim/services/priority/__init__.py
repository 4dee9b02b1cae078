"""Navigation goes first in the runtime: its event loop, its window of time, and when garbage is collected."""
