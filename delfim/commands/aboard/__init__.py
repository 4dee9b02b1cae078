"""Commands that run on the boat."""
