"""`make docs`: the documentation as a site that needs no network, from docs/*.md and from what the code says of itself."""
