"""Cameras: pictures that take what the link leaves, and are kept aboard."""
