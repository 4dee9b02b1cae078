"""Parts: a folder is a thing that somebody owns; a row of `delfim.base.parts` or of the services names it
(docs/decisions/0015)."""
