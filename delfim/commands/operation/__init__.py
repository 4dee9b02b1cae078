"""Commands for those who operate boats."""
