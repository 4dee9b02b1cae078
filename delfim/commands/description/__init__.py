"""Commands that describe a boat: its vehicle's file, keys and parts."""
