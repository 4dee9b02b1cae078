"""The twin of a boat that was found: it sails, and gains are chosen on it."""
