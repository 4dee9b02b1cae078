"""Delfim: the complete onboard software of an autonomous surface vehicle."""

__version__ = "0.1.0"
