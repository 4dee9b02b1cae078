"""The operator beside the boat: the local command socket, its two ends, and plans that are reviewed in slices."""
