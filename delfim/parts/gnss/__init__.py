"""Corrections for satellite receivers (RTK)."""
