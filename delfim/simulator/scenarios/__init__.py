"""Runs in lock step: scenarios, encounters, mixed and searching seeds, and the watch over them."""
