"""Runs in lock step: scenarios, encounters, and runs drawn from a seed."""
