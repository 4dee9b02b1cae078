"""Boats with a computer of their own for the motors: Heron, Otter, and boards that speak MAVLink."""
