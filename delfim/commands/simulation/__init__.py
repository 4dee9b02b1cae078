"""Commands that sail simulated boats."""
