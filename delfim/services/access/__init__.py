"""Admission to the boat: listeners, passwords, keys, and the files that `delfim commission` makes."""
