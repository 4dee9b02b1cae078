"""The helm: the mode, changes of it, and the set points and plans that they need."""
