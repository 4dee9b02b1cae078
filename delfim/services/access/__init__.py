"""Who is let in: doors, passwords, keys, and the papers that `delfim commission` makes."""
