"""Tools that read logs ashore: they find, fetch, tabulate, plot, export and repair them."""
