"""The base of every room: errors, clocks, CAN frames, angles, TOML tables, bounded input, cooperative work."""
