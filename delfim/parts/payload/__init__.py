"""Outside programs that measure, and those that may command the boat."""
